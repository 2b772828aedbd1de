"""Two seconds of garbage into each entrance of the page; `make faults` gives each a minute."""

import subprocess
import sys


def test_garbage_and_mutations_leave_the_page_serving():
    call = [sys.executable, "-m", "tools.fuzz.page", "--seconds", "2"]
    done = subprocess.run(call, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert [line.split(": ")[0] for line in done.stdout.splitlines()] == [
        *("messages", "messages in whole frames", "frames", "requests")
    ]
