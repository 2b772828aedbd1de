"""Each example runs, for a second or two of its own time, and does what it says."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from follow.cli.program import main as follow
from sim.clip import write

EXAMPLES = Path(__file__).parents[1] / "examples"


def example(name: str):
    """The module of an example, which is no package."""
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_an_own_camera_is_tracked():
    errors = example("own_camera").main(seconds=2.0)
    assert len(errors) == 60
    assert max(errors) < 5.0


def test_an_own_link_is_flown_to_the_stand_off():
    assert example("own_link").main(seconds=2.0) == pytest.approx(9.0, abs=1.0)


def test_an_own_tracker_steers():
    scored = example("own_tracker").main(seconds=2.0)
    assert scored.precision_20px > 95
    assert 80 < scored.auc < 100  # 100 would be the true boxes themselves


def test_a_recording_is_read_back(tmp_path, capsys):
    write(tmp_path / "clip.mp4", 12)
    assert (
        follow(["replay", str(tmp_path / "clip.mp4"), "--target", "309,192,22,48", "--out", str(tmp_path / "out")]) == 0
    )
    module = example("read_a_recording")
    ticks = module.columns(tmp_path / "out")
    assert list(ticks["tick"]) == list(range(12))
    assert np.all(np.diff(ticks["t_s"]) > 0)
    rows = (tmp_path / "out/ticks.csv").read_text().splitlines()
    quoted = [rows[0], *(row.rpartition(",")[0] + ',"one, and another"' for row in rows[1:])]
    (tmp_path / "ticks.csv").write_text("\n".join(quoted))
    assert set(module.columns(tmp_path)["notes"]) == {"one, and another"}
    pytest.importorskip("rerun.chunk", reason="Rerun for Python 3.10 has no reader of recordings")
    seen = list(module.images(tmp_path / "out"))
    assert [t_s for t_s, _ in seen] == pytest.approx(list(ticks["t_s"]), abs=1e-6)
    assert {image.shape for _, image in seen} == {(360, 640, 3)}
    capsys.readouterr()
    module.main(tmp_path / "out")
    assert "12 rounds" in capsys.readouterr().out


def test_every_example_has_a_test_and_runs_as_it_says():
    tests = "".join(path.read_text() for path in Path(__file__).parent.rglob("test_*.py"))
    for path in EXAMPLES.glob("*.py"):
        assert f'"{path.stem}"' in tests or f'"{path.name}"' in tests, path.name
        assert f"python examples/{path.name}" in path.read_text(), path.name
