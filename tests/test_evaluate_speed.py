"""What the speed measurement must be to be fair: same pictures, turn by turn, ratios within a sequence."""

import pytest
import rendered_benchmarks as rendered

from racf.box import Box
from racf.evaluate import speed
from racf.evaluate.benchmarks import read_benchmark
from racf.evaluate.speed import Clip, Lap
from racf.evaluate.trackers import TrackerSpec


def test_every_tracker_is_timed_on_every_picture_after_the_first(tmp_path):
    (clip,) = speed.clips_of(read_benchmark("folder", rendered.plain_folder(tmp_path, frames=6)), frames=5)
    specs = [TrackerSpec.parse(name) for name in ("racf-", "bacf", "racf-,robust")]
    laps = speed.measure(specs, clip)
    assert list(laps) == ["racf-", "bacf", "racf-,robust"]
    for lap in laps.values():
        assert len(lap.frame_ms) == 4
        assert all(len(of) <= 4 for of in lap.stage_ms.values())
        assert sum(sum(of) for of in lap.stage_ms.values()) <= sum(lap.frame_ms)  # stages are parts of the whole


def test_rendered_pictures_are_the_same_each_time_and_show_the_target_where_it_is_said_to_be():
    target = Box(400, 300, 48, 36)
    first, again = (list(speed.rendered(target, 3)) for _ in range(2))
    assert all((a == b).all() for a, b in zip(first, again, strict=True))
    assert first[0][300:336, 400:448].mean() > first[0][200:236, 400:448].mean() + 20


def test_ratios_are_taken_within_a_sequence_so_that_a_slow_minute_cancels():
    def lap(ms: float) -> Lap:
        return Lap([ms] * 10, {"all": [ms] * 10})

    slow_minutes = {"a": 1.0, "b": 7.0, "c": 2.0}
    laps = {clip: {"ours": lap(4 * slow), "csrt": lap(20 * slow)} for clip, slow in slow_minutes.items()}
    figures = speed.summary(laps, ["csrt"])
    assert figures["tracker"]["ours"]["times_as_fast_as"] == {"csrt": 5.0}
    assert figures["tracker"]["ours"]["fps"] == pytest.approx(125.0)  # of the middle one
    assert figures["tracker"]["ours"]["ms"] == {"all": 8.0}
    assert figures["peers"] == {"csrt": {"fps": 25.0}}


def test_a_clip_without_files_is_rendered():
    assert sum(1 for _ in Clip("x", Box(400, 300, 20, 16), count=4).pictures()) == 4


def test_a_fresh_process_says_how_long_its_first_update_took_and_what_it_holds():
    figures = speed.first_call(TrackerSpec.parse("racf,robust"), {})
    assert figures["import_s"] > 0
    assert figures["first_update_s"] > 0
    assert 0 < figures["memory_mb"] < 500
