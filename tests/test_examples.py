"""Each example runs, for a second or two of its own time, and does what it says."""

import importlib.util
import math
from pathlib import Path

import numpy as np
import pytest

from follow.cli.program import main as follow
from follow.messages import HOVER, Cause, Decision, Estimate, Mode, Reason, Tick, VehicleState
from follow.recording.rows import COLUMNS, header, row
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


def test_an_own_link_is_sent_setpoints_and_follows_the_walker(capsys):
    ticks = example("own_link").main(seconds=8.0)
    assert {tick.decision.mode for tick in ticks[60:]} == {Mode.FOLLOW}
    assert all(tick.decision.setpoint is not None for tick in ticks[60:])
    start, end = ticks[0].state, ticks[-1].state
    assert math.hypot(end.north_m - start.north_m, end.east_m - start.east_m) > 4.0  # it hovered where it started
    assert all(tick.estimate.range_m == pytest.approx(9.0, abs=1.0) for tick in ticks[60:])
    assert "setpoints sent" in capsys.readouterr().out


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


def test_a_recording_is_read_back_whatever_words_are_in_it(tmp_path):
    """Words with a comma are what a flight has in which something went wrong; older recordings quote them."""
    estimate = Estimate(0.0, 0.0, 0.3, 9.0, 1.0, contradiction='by "size", 9.0 m')
    reason = Reason(Cause.ORDER_VOID, "by the ground's motion 0.8 m, by its size 9.0 m")
    decision = Decision(None, Mode.OBSERVE, ("old; late, and slow",), reason)
    written = row(0, Tick(None, None, VehicleState(0.0), estimate, HOVER, decision))
    assert written.count(",") == len(COLUMNS) - 1  # numpy's genfromtxt knows no quotes
    (tmp_path / "ticks.csv").write_text(header() + written + written.replace("old; late", '"old, late"'))
    module = example("read_a_recording")
    ticks = module.columns(tmp_path)
    assert list(ticks) == list(COLUMNS)
    assert list(ticks["tick"]) == [0, 0]
    assert np.isnan(ticks["setpoint_forward_m_s"]).all()
    assert {name for name, of in ticks.items() if of.dtype.kind == "U"} == set(module.WORDS)
    assert "0.8 m" in ticks["reason"][0]
    assert "late; and slow" in ticks["notes"][0]


def test_every_example_has_a_test_and_runs_as_it_says():
    tests = "".join(path.read_text() for path in Path(__file__).parent.rglob("test_*.py"))
    for path in EXAMPLES.glob("*.py"):
        assert f'"{path.stem}"' in tests or f'"{path.name}"' in tests, path.name
        assert f"python examples/{path.name}" in path.read_text(), path.name
