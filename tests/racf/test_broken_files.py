"""Broken files of an evaluation: each is named in one sentence with what to do, or run again."""

import json
import struct
import zlib
from pathlib import Path

import pytest

import tests.support.rendered_benchmarks as rendered
from racf.box import Box
from racf.errors import TrackerError
from racf.evaluate import evaluate
from racf.evaluate.images import read_frame
from racf.evaluate.outcomes import read_outcomes
from racf.track import Track
from tests.racf.test_evaluate_runner import Matcher


class Steady(Matcher):
    """The matcher of the runner's tests, as a tracker of one's own."""

    def __init__(self) -> None:
        super().__init__(None)


class Answers(Steady):
    """Its answer to each image is the one it was built with."""

    def __init__(self, answer: object) -> None:
        super().__init__()
        self.answer = answer

    def update(self, image):
        return self.answer


@pytest.fixture
def data(tmp_path: Path) -> Path:
    return rendered.plain_folder(tmp_path / "data", ("walk",))


def test_an_image_whose_header_says_more_pixels_than_opencv_reads_is_named(tmp_path):
    def chunk(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    place = tmp_path / "huge.png"
    header = struct.pack(">IIBBBBB", 60_000, 60_000, 8, 2, 0, 0, 0)
    place.write_bytes(
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(b"")) + chunk(b"IEND", b"")
    )
    with pytest.raises(ValueError, match=r"huge\.png is not an image that OpenCV can read"):
        read_frame(place)


@pytest.mark.parametrize("text", ["{", "[1]", "5", '{"walk": "x"}', '{"walk": null}', '{"walk": NaN}'])
def test_a_broken_file_of_speeds_is_named(data, tmp_path, text):
    place = tmp_path / "stored" / "Theirs"
    place.mkdir(parents=True)
    (place / "walk.txt").write_text((data / "walk" / "groundtruth_rect.txt").read_text())
    (place / "fps.json").write_text('{"walk": 30, "other": 5}')
    fine = evaluate(data, imports=str(tmp_path / "stored"), progress=False)
    assert fine.figures()["Theirs"]["fps"] == 30
    (place / "fps.json").write_text(text)
    with pytest.raises(ValueError, match=r"fps\.json.*delete it"):
        evaluate(data, imports=str(tmp_path / "stored"), progress=False)


@pytest.mark.parametrize("change", [{"fps": "x"}, {"fps": None}, {"stage_ms": {"match": "x"}}, {"stage_ms": 3}])
def test_a_note_that_holds_no_numbers_is_run_again_and_named_by_an_import(data, tmp_path, change):
    out = tmp_path / "out"
    first = evaluate(data, trackers=Steady, out=out, jobs=1, progress=False)
    (note,) = (out / "runs").rglob("*.json")
    whole = json.loads(note.read_text())
    note.write_text(json.dumps(whole | change))
    with pytest.raises(ValueError, match=rf"{note.name}.* delete it"):
        read_outcomes(out, first.report.sequences)
    again = evaluate(data, trackers=Steady, out=out, jobs=1, progress=False)
    assert again.boxes["Steady"]["walk"].tolist() == first.boxes["Steady"]["walk"].tolist()
    assert json.loads(note.read_text())["stage_ms"] == whole["stage_ms"]


def track(**changed: object) -> Track:
    """A Track as a tracker gives it, with changes."""
    usual: dict[str, object] = {
        "box": Box(1, 2, 3, 4),
        "search": Box(1, 2, 3, 4),
        "psr": 9.0,
        "apce": 9.0,
        "confidence": 1.0,
    }
    return Track(**(usual | changed))  # type: ignore[arg-type] - wrong types are what is tested


@pytest.mark.parametrize(
    ("answer", "told"),
    [
        (track(box=(1, 2, 3, 4)), r"the box is a racf\.Box, not \(1, 2, 3, 4\)"),
        (track(box=Box(0, 0, 3e300, 4)), r"a box lies within 1e\+06 pixels, not 0,0,3e\+300,4"),
        (track(confidence=None), "confidence is a number, not None"),
        (track(stage_ms={"network": "fast"}), "the milliseconds of stage 'network' are a finite number, not 'fast'"),
        (track(stage_ms={"network": float("nan")}), "the milliseconds of stage 'network' are a finite number, not nan"),
        ((1e300, 0, 1, 1), r"a box lies within 1e\+06 pixels, not 1e\+300,0,1,1"),
    ],
)
def test_a_box_beyond_the_limits_of_a_file_is_named(data, answer, told):
    with pytest.raises(TrackerError, match=f"tracker odd: .*in frame 1 after the start.*{told}"):
        evaluate(data, trackers={"odd": lambda: Answers(answer)}, jobs=1, progress=False)


def test_a_track_of_unknown_sharpness_is_accepted(data, tmp_path):
    answer = track(psr=float("nan"), apce=float("nan"), stage_ms={"network": 3})
    for _ in range(2):
        figures = evaluate(
            data, trackers={"odd": lambda: Answers(answer)}, out=tmp_path, jobs=1, progress=False
        ).figures()
    assert figures["odd"]["sequences"]["walk"]["frames"] == 6
    assert read_outcomes(tmp_path, evaluate(data, imports=str(tmp_path), progress=False).report.sequences)
