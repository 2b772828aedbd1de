"""Two seconds of garbage into each reader of bytes and files; `make faults` gives each a minute."""

import subprocess
import sys
from pathlib import Path

FUZZ = Path(__file__).parents[1] / "benchmarks" / "fuzz_inputs.py"


def test_garbage_and_mutations_are_refused_in_one_line():
    call = [sys.executable, str(FUZZ), "--seconds", "1"]
    done = subprocess.run(call, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert len(done.stdout.splitlines()) == 10
