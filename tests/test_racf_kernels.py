"""Compiling is announced: a first start that seems to hang would be killed."""

import os
import subprocess
import sys

ONE_KERNEL = """
import numpy as np
import racf.tracker
from racf.features import _apply_window
_apply_window(np.ones((2, 2, 3), np.float32), np.ones((2, 2), np.float32))
"""


def said_with_cache_in(folder) -> str:
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(folder)}
    run = subprocess.run(
        [sys.executable, "-c", ONE_KERNEL], env=environment, capture_output=True, text=True, check=True, timeout=120
    )
    assert not run.stdout
    return run.stderr


def test_a_cold_cache_is_announced_in_one_line_and_a_warm_one_is_not(tmp_path):
    cold = said_with_cache_in(tmp_path)
    assert cold.count("\n") == 1
    assert cold.startswith("compiling the tracker's kernels")
    assert said_with_cache_in(tmp_path) == ""
