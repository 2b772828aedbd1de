"""A detector in an ONNX file: its three shapes of output give the same boxes, and a click becomes the box there."""

import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from follow.cli.commands import RunCommand
from follow.cli.detector import check_detector
from follow.cli.run import check
from follow.control import detector
from follow.control.detector import CONSIDERED, MOST, STRIDES, WINDOW, Detector, input_size, squares
from follow.control.selector import meant
from follow.selection import Selection
from racf.box import Box
from racf.commandline import UsageError
from tests.support.onnx_files import field, network, node, value

SIDE = 160
CELLS = sum((SIDE // stride) ** 2 for stride in STRIDES)
OBJECTS = [(Box(60.0, 50.0, 40.0, 60.0), 0.9), (Box(70.0, 60.0, 20.0, 20.0), 0.5), (Box(5.0, 5.0, 30.0, 30.0), 0.8)]
IMAGE = np.full((360, 640, 3), 90, np.uint8)


def yolov8(objects):
    rows = np.zeros((CELLS, 6), np.float32)
    for k, (box, score) in enumerate(objects):
        rows[7 * k] = box.centre_x, box.centre_y, box.w, box.h, 0.01, score
    return rows.T[None]


def yolox(objects):
    rows = np.zeros((CELLS, 7), np.float32)
    rows[:, 2:4] = -3.0
    first = (SIDE // 8) ** 2  # of the cells of 16 pixels
    for box, score in objects:
        across, down = int(box.centre_x // 16), int(box.centre_y // 16)
        place = box.centre_x / 16 - across, box.centre_y / 16 - down
        rows[first + down * (SIDE // 16) + across] = *place, np.log(box.w / 16), np.log(box.h / 16), 0.95, 0.0, score
    return rows[None]


def ssd(objects):
    rows = [
        (0, 1, score, box.x / SIDE, box.y / SIDE, (box.x + box.w) / SIDE, (box.y + box.h) / SIDE)
        for box, score in objects
    ]
    return np.array(rows, np.float32)[None, None]


FAMILIES = pytest.mark.parametrize("family", [yolov8, yolox, ssd])


@pytest.fixture
def made(tmp_path):
    def make(output, **how):
        path = tmp_path / "network.onnx"
        path.write_bytes(network(output, **how))
        return Detector(path)

    return make


@FAMILIES
def test_every_detector_family_returns_the_encoded_boxes_and_scores(family, made):
    found = sorted(made(family(OBJECTS)).detect(np.zeros((SIDE, SIDE, 3), np.uint8)), key=lambda d: -d.score)
    for detection, (box, score) in zip(found, sorted(OBJECTS, key=lambda o: -o[1]), strict=True):
        assert detection.box.iou(box) > 0.99
        assert detection.score == pytest.approx(score * (0.95 if family is yolox else 1.0), abs=1e-3)


def test_of_too_many_boxes_the_best_scores_are_kept(made):
    scores = np.linspace(0.3, 0.9, 50_000)
    flood = np.zeros((1, 1, 50_000, 7), np.float32)
    flood[0, 0, :, 2] = scores
    flood[0, 0, :, 3:] = np.random.default_rng(0).uniform((0, 0, 0.5, 0.5), (0.5, 0.5, 1, 1), (50_000, 4))
    detector = made(flood)
    found = detector.detect(np.zeros((SIDE, SIDE, 3), np.uint8))
    assert [d.score for d in found] == pytest.approx(scores[::-1][:CONSIDERED])
    assert len(detector.find(IMAGE)) <= MOST


@FAMILIES
@pytest.mark.parametrize("shape", [(), (1,), (1, 4), (1, 7, 3), (1, 1, 4, 6), (2, 2, 2, 2, 2), (0, 0, 0)])
def test_an_output_that_changes_its_shape_is_refused_in_one_line(family, shape, made):
    detector = made(family(OBJECTS))
    detector._run = lambda _blob: np.zeros(shape, np.float32)
    for look in (lambda: detector.find(IMAGE), lambda: detector.snap(IMAGE, 320, 200)):
        with pytest.raises(ValueError, match=r"shape") as refused:
            look()
        assert "\n" not in str(refused.value)


def test_a_network_that_is_not_there_is_named():
    with pytest.raises(UsageError, match=r"^--detector 'none\.onnx': No such file or directory$"):
        check_detector(Path("none.onnx"))


@FAMILIES
def test_a_click_gives_the_best_box_at_its_place_in_the_images_pixels(family, made):
    snap = made(family(OBJECTS)).snap
    scale = WINDOW * IMAGE.shape[0] / SIDE
    x, y = 320.0, 200.0
    box = snap(IMAGE, x, y)
    want, _ = OBJECTS[0]
    middle = SIDE / 2
    left, top = x + (want.x - middle) * scale, y + (want.y - middle) * scale
    assert box is not None
    assert box.iou(Box(left, top, want.w * scale, want.h * scale)) > 0.97


def test_at_the_images_edge_and_in_grey_it_works_as_well(made):
    snap = made(yolov8(OBJECTS)).snap
    inner, edge = snap(IMAGE, 320, 200), snap(IMAGE, 2, 358)
    assert edge is not None
    assert (edge.x + 318, edge.y - 158) == pytest.approx((inner.x, inner.y), abs=1.0)
    assert snap(IMAGE[:, :, 0], 320, 200) == inner


@pytest.mark.parametrize("bad", [np.nan, np.inf, -1.0, 7.0])
def test_numbers_that_are_no_box_or_no_score_are_left_out(bad, made):
    output = yolov8(OBJECTS)
    output[0, 2, 0] = bad if bad != 7.0 else 40.0
    output[0, 5, 0] = 0.9 if bad != 7.0 else bad
    assert len(made(output).detect(np.zeros((SIDE, SIDE, 3), np.uint8))) == 2


def test_a_whole_image_is_searched_in_tiles_and_each_object_is_returned_once(made):
    """The network returns the same three boxes for each of two tiles; two of the six nearly coincide."""
    again = Box(61.0, 51.0, 40.0, 60.0), 0.6
    found = made(yolov8([*OBJECTS, again])).find(IMAGE)
    scale = 360 / SIDE
    want = [
        (Box(left + box.x * scale, box.y * scale, box.w * scale, box.h * scale), score)
        for left in (0, 280)
        for box, score in OBJECTS
    ]
    assert len(found) == len(want)
    for detection, (_, score) in zip(found, sorted(want, key=lambda w: -w[1]), strict=True):
        assert detection.score == pytest.approx(score, abs=1e-3)
        assert max(detection.box.iou(b) for b, s in want if s == score) > 0.99


def test_of_an_object_cut_by_a_tile_only_the_whole_box_is_kept(made):
    """Its left part is at the left border of the second square; the first one shows it whole."""
    scale = 360 / SIDE
    part, whole = Box(0.5, 40.0, 20.0, 60.0), Box(280 / scale - 8.0, 40.0, 30.0, 60.0)
    boxes = [d.box for d in made(yolov8([(part, 0.8), (whole, 0.7)])).find(IMAGE)]
    assert any(box.iou(whole.zoomed(scale)) > 0.97 for box in boxes)
    assert not any(box.iou(part.zoomed(scale).moved(280, 0)) > 0.9 for box in boxes)
    assert any(box.iou(part.zoomed(scale)) > 0.97 for box in boxes), "what the image's own border cuts stays"


@pytest.mark.parametrize(("rows", "columns"), [(360, 640), (640, 360), (480, 480), (200, 1300), (1080, 1920)])
def test_the_tiles_cover_the_image_and_lie_in_it(rows, columns):
    seen = np.zeros((rows, columns), bool)
    for left, top, side in squares(rows, columns):
        assert side == min(rows, columns)
        assert left >= 0 <= top
        assert left + side <= columns
        assert top + side <= rows
        seen[top : top + side, left : left + side] = True
    assert seen.all()


@pytest.mark.parametrize("absurd", [Box(0.0, 0.0, 6e30, 6e30), Box(-4e3, 0.0, 5e3, 400.0), Box(1e30, 1e30, 10.0, 10.0)])
def test_a_click_takes_no_box_that_lies_outside_the_image(made, absurd):
    click = Selection(320 / 640, 200 / 360, 0.0, 0.0, 0.0, "the page")
    assert meant(click, IMAGE, lambda _image, _x, _y: absurd) == meant(click, IMAGE)
    assert made(yolov8([(absurd, 0.9)])).find(IMAGE) == ()


def test_a_click_beside_every_object_falls_back_to_what_stands_out(made):
    image = IMAGE.copy()
    cv2.rectangle(image, (300, 180), (340, 220), (20, 20, 230), -1)
    nothing = made(yolov8([(Box(5.0, 5.0, 10.0, 10.0), 0.9)])).snap
    click = Selection(320 / 640, 200 / 360, 0.0, 0.0, 0.0, "the page")
    assert nothing(image, 320, 200) is None
    assert meant(click, image, nothing) == meant(click, image)
    with ThreadPoolExecutor(1) as looks:
        snapped = looks.submit(meant, click, image, made(yolov8(OBJECTS)).snap).result()
    assert snapped == made(yolov8(OBJECTS)).snap(image, 320, 200)


def test_the_input_size_is_read_from_the_file_and_a_free_one_is_the_usual_one():
    assert input_size(network(yolov8(OBJECTS))) == SIDE
    assert input_size(network(yolov8(OBJECTS), sides=(0, 0))) == 0


@pytest.mark.parametrize(
    ("data", "why"),
    [(b"", "not an ONNX network"), (b"\xff" * 40, "not an ONNX file"), (b"GIF89a" * 20, "not an ONNX"),
     (network(yolov8(OBJECTS), sides=(160, 320)), "its input is 320x160 pixels"),
     (network(np.zeros((1, 5, 5))), r"its output has the shape \(1, 5, 5\), not \(1, 525"),
     (field(7, field(11, value("x", (1, 3, 160, 160)))), "cannot be used")],
)  # fmt: skip
def test_a_file_that_is_no_detector_is_refused_in_one_sentence(data, why, tmp_path):
    path = tmp_path / "network.onnx"
    path.write_bytes(data)
    command = RunCommand("udpin:127.0.0.1:14540", camera="scene:walker", detector=path)
    with pytest.raises(UsageError, match=why) as refused:
        check(command)
    assert "\n" not in str(refused.value)


UNKNOWN = field(7, field(1, node("NoSuchOperator", ["x"], "y")) + field(11, value("x", (1, 3, SIDE, SIDE))))


def test_a_network_that_opencv_cannot_run_is_refused_with_the_alternative(tmp_path, monkeypatch):
    path = tmp_path / "network.onnx"
    path.write_bytes(UNKNOWN)
    monkeypatch.setattr(detector, "has_onnx_runtime", lambda: False)
    with pytest.raises(ValueError, match=r"OpenCV cannot run it.*pip install '\.\[detector\]'") as refused:
        Detector(path)
    assert "\n" not in str(refused.value)


def test_a_network_that_opencv_cannot_run_is_run_by_onnx_runtime(tmp_path, monkeypatch):
    """A stub module with ONNX Runtime's interface, because the extra is not installed for the tests."""
    asked = []

    class Session:
        def __init__(self, model, options, providers):
            assert model == UNKNOWN
            assert providers == ["CPUExecutionProvider"]
            assert options.intra_op_num_threads == max(cv2.getNumThreads(), 1)

        def get_inputs(self):
            return [SimpleNamespace(name="x")]

        def run(self, outputs, inputs):
            assert outputs is None
            asked.append(inputs["x"])
            if inputs["x"].max() > 1.0 and len(asked) > 1:
                raise RuntimeError("out of\nmemory")
            return [yolov8(OBJECTS)]

    fake = SimpleNamespace(InferenceSession=Session, SessionOptions=SimpleNamespace)
    monkeypatch.setitem(sys.modules, "onnxruntime", fake)
    monkeypatch.setattr(detector, "has_onnx_runtime", lambda: True)
    path = tmp_path / "network.onnx"
    path.write_bytes(UNKNOWN)
    used = Detector(path)
    found = used.detect(np.full((SIDE, SIDE, 3), 255, np.uint8))
    assert len(found) == len(OBJECTS)
    assert (asked[-1].dtype, asked[-1].shape, asked[-1].max()) == (np.float32, (1, 3, SIDE, SIDE), 1.0)
    with pytest.raises(ValueError, match="out of memory"):
        used._run(np.full((1, 3, SIDE, SIDE), 2.0, np.float32))


def test_a_detector_that_is_not_there_is_refused(tmp_path):
    command = RunCommand("udpin:127.0.0.1:14540", camera="scene:walker", detector=tmp_path / "none.onnx")
    with pytest.raises(UsageError, match="No such file"):
        check(command)
