"""What the speed measurement must be to be fair: same images, turn by turn, ratios within a sequence."""

from itertools import pairwise, permutations
from pathlib import Path
from types import SimpleNamespace

import pytest

import tests.support.rendered_benchmarks as rendered
from racf.box import Box
from racf.evaluate import cost, roofline, speed
from racf.evaluate.benchmarks import read_benchmark
from racf.evaluate.figures import BenchFigures, CostFigures, SpeedFigures
from racf.evaluate.speed import Clip, Lap
from racf.evaluate.trackers import TrackerSpec
from racf.params import preset


def test_every_tracker_is_timed_on_every_image_after_the_first(tmp_path):
    (clip,) = speed.clips_of(read_benchmark("folder", rendered.plain_folder(tmp_path, frames=6)), frames=5)
    specs = [TrackerSpec.parse(name) for name in ("racf-", "bacf", "racf-,robust")]
    laps = speed.measure(specs, clip)
    assert list(laps) == ["racf-", "bacf", "racf-,robust"]
    for lap in laps.values():
        assert len(lap.frame_ms) == 4
        assert all(len(of) <= 4 for of in lap.stage_ms.values())
        assert min(lap.frame_ms) > 0


def test_every_tracker_has_its_turn_after_every_other_about_alike(monkeypatch):
    """Otherwise what one leaves in the processor's caches would always be the same other one's loss or gain."""
    order: list[str] = []

    class Named:
        def __init__(self, label: str) -> None:
            self.label = label

        def build(self):
            return self

        def init(self, image, target):
            pass

        def update(self, image):
            order.append(self.label)
            return SimpleNamespace(stage_ms={})

    monkeypatch.setattr(speed, "warm_up", lambda spec: None)
    monkeypatch.setattr(speed, "rendered", lambda target, count: iter(range(count)))
    speed.measure([Named(label) for label in "abcd"], Clip("x", Box(0, 0, 9, 9), count=301))
    rounds = [order[i : i + 4] for i in range(0, len(order), 4)]
    assert len(rounds) == 300
    assert all(sorted(of) == list("abcd") for of in rounds)
    for first, second in permutations("abcd", 2):
        after = sum((first, second) in pairwise(of) for of in rounds)
        assert 45 < after < 105  # 75 of 300, a deviation of 8


def test_a_sequence_of_one_frame_is_refused_in_one_sentence(tmp_path):
    with pytest.raises(ValueError, match="sequence walk has one frame"):
        speed.clips_of(read_benchmark("folder", rendered.plain_folder(tmp_path, frames=1)), frames=5)


def test_rendered_images_are_the_same_each_time_and_show_the_target_where_it_is_said_to_be():
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


def test_a_frames_cost_is_its_share_of_the_cameras_time_and_cycles_at_the_clock(monkeypatch):
    monkeypatch.setattr(cost, "clock_hz", lambda: 2.4e9)
    params, target = preset("racf-"), Box(0, 0, 40, 40)
    of = cost.cost_of(params, fps=300.0, targets=[target])
    assert of["share_of_30hz_percent"] == 10.0
    assert of.get("megacycles") == pytest.approx(8.0)
    flops = sum(work.flops for work in roofline.work_of_stages(params, target).values())
    assert of["least_megaflops"] == pytest.approx(flops / 1e6, abs=0.01)
    monkeypatch.setattr(cost, "clock_hz", lambda: None)
    assert "megacycles" not in cost.cost_of(params, fps=300.0, targets=[target])


def test_a_clip_without_files_is_rendered():
    assert sum(1 for _ in Clip("x", Box(400, 300, 20, 16), count=4).images()) == 4


def test_a_fresh_process_says_how_long_its_first_update_took_and_what_it_holds():
    figures = speed.first_call(TrackerSpec.parse("racf,robust"), {})
    assert figures["import_s"] > 0
    assert figures["init_s"] > 0
    assert figures["first_update_s"] > 0
    assert 0 < figures["memory_mb"] < 500


def test_a_process_that_goes_on_tracking_holds_no_more_memory():
    held = speed.memory_after(TrackerSpec.parse("racf,robust"), [50, 250])
    assert list(held) == ["50", "250"]
    assert 50 < held["50"] < 1000
    assert held["250"] < held["50"] + 5  # a thirtieth of a frame for each update would be 18


def test_the_least_work_grows_with_iterations_and_not_with_a_target_larger_than_the_sample():
    racf, target = preset("racf"), Box(0, 0, 40, 40)
    works = [roofline.work_of_stages(preset(name), target)["learn filter"].flops for name in ("racf--", "arcf-hc")]
    assert works[0] < works[1]  # two iterations, five iterations
    assert roofline.work_of_stages(racf, Box(0, 0, 400, 400)) == roofline.work_of_stages(racf, Box(0, 0, 800, 800))
    assert roofline.work_of_stages(preset("racf-"), target)["refine"].flops == 0


def test_a_stage_takes_no_less_than_the_slower_of_its_arithmetic_and_its_bytes():
    machine = roofline.Machine(flops_s=1e9, bytes_s=2e9)
    assert machine.ms(roofline.Work(flops=1e6, moved_bytes=1e6)) == pytest.approx(1.0)
    assert machine.ms(roofline.Work(flops=1e5, moved_bytes=1e6)) == pytest.approx(0.5)


def test_a_core_does_more_than_a_billion_operations_and_less_than_a_trillion():
    measured = roofline.machine()
    assert 1e9 < measured.flops_s < 1e13  # a product may use every core here; the command gives it one
    assert 1e8 < measured.bytes_s < 1e12


def test_the_documentation_names_every_figure_that_racf_bench_prints_as_json():
    page = (Path(__file__).parents[2] / "docs" / "evaluation.md").read_text()
    (described,) = (part for part in page.split("`") if part.startswith('{"tracker": {name: {"fps", "ms"'))
    for figures in (BenchFigures, SpeedFigures, CostFigures):
        assert [name for name in figures.__annotations__ if f'"{name}"' not in described] == []
