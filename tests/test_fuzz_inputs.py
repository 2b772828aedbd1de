"""Two seconds of garbage into each reader of bytes and files; `make faults` gives each a minute."""

import subprocess
import sys


def test_garbage_and_mutations_are_refused_in_one_line():
    call = [sys.executable, "-m", "tools.fuzz.inputs", "--seconds", "1"]
    done = subprocess.run(call, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert len(done.stdout.splitlines()) == 11
