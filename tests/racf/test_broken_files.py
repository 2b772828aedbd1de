"""Broken files of an evaluation: each is named in one sentence with what to do, or run again."""

import json
import struct
import zlib
from pathlib import Path

import pytest

import tests.support.rendered_benchmarks as rendered
from racf.evaluate import evaluate
from racf.evaluate.images import read_frame
from racf.evaluate.outcomes import read_outcomes
from racf.track import Track
from tests.racf.test_evaluate_runner import Matcher


class Steady(Matcher):
    """The matcher of the runner's tests, as a tracker of one's own."""

    def __init__(self) -> None:
        super().__init__(None)


class TupleInTrack(Steady):
    """Its Track holds a tuple."""

    def update(self, image):
        return Track((1, 2, 3, 4), (1, 2, 3, 4), 0.0, 0.0, 1.0)  # type: ignore[arg-type]


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


def test_the_box_of_a_track_that_is_no_box_is_named(data):
    with pytest.raises(ValueError, match=r"TupleInTrack: the box of a racf\.Track is a racf\.Box, not \(1, 2, 3, 4\)"):
        evaluate(data, trackers=TupleInTrack, jobs=1, progress=False)
