"""Compiling is announced: otherwise a user would take a slow first start for a hang and kill it."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import racf

ONE_KERNEL = """
import numpy as np
import racf.tracker
from racf.response import correlate
correlate(*np.ones((2, 2, 2, 2, 2, 1), np.float32), np.empty((2, 2), np.complex64))
"""


FEATURES_OVER_SCALES = """
import numpy as np
from racf import Box, Params
from racf.scale import ScaleFilter
image = np.random.default_rng(0).integers(0, 256, (60, 60), dtype=np.uint8)
print(abs(ScaleFilter(Params(), 20, 20).sample(image, Box(20, 20, 20, 20))).sum())
"""


def fresh_process(program: str, cache: Path, root: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Run a program with numba's cache in a folder, on the package of another root if there is one."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(cache)}
    command = [sys.executable, "-c", program]
    return subprocess.run(command, env=environment, cwd=root, capture_output=True, text=True, check=True, timeout=120)


def said_with_cache_in(folder) -> str:
    run = fresh_process(ONE_KERNEL, folder)
    assert not run.stdout
    return run.stderr


def test_a_cold_cache_is_announced_in_one_line_and_a_warm_one_is_not(tmp_path):
    cold = said_with_cache_in(tmp_path)
    assert cold.count("\n") == 1
    assert cold.startswith("compiling the tracker's kernels")
    assert said_with_cache_in(tmp_path) == ""


def test_compiling_leaves_garbage_collection_as_it_was(tmp_path):
    for was in ("enable", "disable"):
        program = f"import gc; gc.{was}()\n{ONE_KERNEL}\nprint(gc.isenabled())"
        assert fresh_process(program, tmp_path / was).stdout == f"{was == 'enable'}\n"


def test_an_edit_of_another_kernels_file_leaves_no_stale_machine_code(tmp_path):
    shutil.copytree(Path(racf.__file__).parent, tmp_path / "racf", ignore=shutil.ignore_patterns("__pycache__"))
    hog = tmp_path / "racf" / "hog.py"

    def features() -> str:
        return fresh_process(FEATURES_OVER_SCALES, tmp_path / "cache", tmp_path).stdout

    before, source = features(), hog.read_text()
    assert features() == before
    assert "CLIP = 0.2" in source
    hog.write_text(source.replace("CLIP = 0.2", "CLIP = 0.1"))
    assert features() != before


def test_a_callers_own_kernel_that_has_no_module_compiles_unannounced(tmp_path):
    """Listeners hear of every compilation in the process, and what `exec` makes may have no module."""
    program = """
import numba
import racf.tracker
names = {}
exec("def twice(x): return 2 * x", names)
assert names["twice"].__module__ is None or names["twice"].__module__ == "builtins"
names["twice"].__module__ = None
print(numba.njit(names["twice"])(3))
"""
    run = fresh_process(program, tmp_path)
    assert (run.stdout, run.stderr) == ("6\n", "")


FAILED = """
import gc
import racf.tracker
from racf.kernels import compiled
def nonsense(x): return x.nonsense
nonsense.__module__ = "racf.nonsense"
for collecting in (True, False):
    gc.enable() if collecting else gc.disable()
    try:
        compiled(nonsense)(1.0)
    except Exception as error:
        print(type(error).__name__, gc.isenabled() == collecting)
"""


def test_garbage_collection_is_as_it_was_after_a_kernel_that_does_not_compile(tmp_path):
    assert fresh_process(FAILED, tmp_path).stdout == "TypingError True\n" * 2


UNCACHED = """
import numpy as np
from racf import Box, Racf
image = np.random.default_rng(0).integers(0, 256, (60, 60, 3), dtype=np.uint8)
tracker = Racf("racf-,scales=3,sample_max_px=16,sample_min_px=16")
tracker.init(image, Box(20, 20, 20, 20))
print(tracker.update(image).box.w > 0)
"""


def test_an_install_that_cannot_be_written_without_a_home_runs_and_says_in_one_line_that_it_compiles_each_time(
    tmp_path,
):
    shutil.copytree(Path(racf.__file__).parent, tmp_path / "racf", ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("home", "racf/__pycache__"):  # a file, since root may write into every folder
        (tmp_path / name).touch()
    environment = {key: value for key, value in os.environ.items() if not key.startswith(("NUMBA_", "XDG_"))}
    environment |= {"PYTHONDONTWRITEBYTECODE": "1", "HOME": str(tmp_path / "home" / "none")}
    command = [sys.executable, "-c", UNCACHED]
    run = subprocess.run(
        command, env=environment, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=120
    )
    assert run.returncode == 0, run.stderr
    assert run.stdout == "True\n"
    assert run.stderr.count("\n") == 1
    assert "NUMBA_CACHE_DIR" in run.stderr
