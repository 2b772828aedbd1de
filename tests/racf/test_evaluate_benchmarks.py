"""Each benchmark's own layout is read from a rendered tree, and what is broken in it is one sentence."""

import numpy as np
import pytest
from scipy.io import savemat

import tests.support.rendered_benchmarks as rendered
from racf.evaluate.benchmarks import read_benchmark
from racf.evaluate.boxfiles import read_boxes, write_boxes
from racf.evaluate.images import frames_of, read_frame
from racf.evaluate.stored import read_stored, trackers_in

LAYOUTS = {
    "folder": rendered.plain_folder,
    "dtb70": rendered.dtb70,
    "uav123": rendered.uav123,
    "uav123@10fps": lambda root: rendered.uav123(root, "UAV123_10fps"),
    "uavdt": rendered.uavdt,
    "visdrone2018": rendered.visdrone2018,
}


def where_the_target_is(image: np.ndarray) -> tuple[int, int]:
    """The first row and column with the bright target, 0-based: an answer from the pixels alone."""
    bright = np.argwhere(image.mean(axis=2) > 135)
    return int(bright[:, 1].min()), int(bright[:, 0].min())


@pytest.mark.parametrize("name", LAYOUTS)
def test_each_layout_pairs_every_frame_with_its_own_annotation(name, tmp_path):
    for sequence in read_benchmark(name, LAYOUTS[name](tmp_path)):
        assert len(sequence.frames) == len(sequence.truth) > 2
        for path, box in zip(sequence.frames, sequence.truth, strict=True):
            x, y = where_the_target_is(read_frame(path))
            assert (x, y) == pytest.approx((box[0] - 1, box[1] - 1), abs=2)  # JPEG blurs the edge


@pytest.mark.parametrize("name", LAYOUTS)
def test_the_hidden_files_that_macos_leaves_beside_each_file_are_passed_over(name, tmp_path):
    root = LAYOUTS[name](tmp_path)
    before = [(s.name, s.frames, s.truth.tolist()) for s in read_benchmark(name, root)]
    for path in [path for path in root.rglob("*") if path.is_file()]:
        path.with_name(f"._{path.name}").write_bytes(b"\x00\x05\x16\x07")
    assert [(s.name, s.frames, s.truth.tolist()) for s in read_benchmark(name, root)] == before


def test_numbers_that_do_not_count_frames_are_only_an_order(tmp_path):
    rendered.plain_folder(tmp_path)
    for path in sorted((tmp_path / "walk").glob("*.png")):
        path.rename(path.with_name(f"{int(path.stem) * 33}.png"))
    (sequence,) = read_benchmark("folder", tmp_path)
    assert [int(path.stem) // 33 for path in sequence.frames] == [303, 304, 305, 306, 307, 308]


def test_a_first_box_is_the_annotation_in_0_based_pixels(tmp_path):
    (sequence,) = read_benchmark("folder", rendered.plain_folder(tmp_path))
    assert str(sequence.first_box()) == "30,40,24,20"


def test_uav123_cuts_named_sequences_from_one_folder_with_one_frame_in_common(tmp_path):
    by_name = {s.name: s for s in read_benchmark("uav123", rendered.uav123(tmp_path))}
    assert set(by_name) == {"walk_1", "walk_2", "car1_s"}
    assert by_name["walk_1"].frames[-1] == by_name["walk_2"].frames[0]
    assert by_name["walk_2"].frames[-1].name == "000009.jpg"
    assert by_name["car1_s"].frames[0].parent.name == "car1_s"


@pytest.mark.parametrize(
    ("name", "subset", "first"), [("uav123", "UAV123", 775), ("uav123-10fps", "UAV123_10fps", 259)]
)
def test_uav123_leaves_out_the_published_gap_at_either_frame_rate(name, subset, first, tmp_path):
    by_name = {s.name: s for s in read_benchmark(name, rendered.uav123(tmp_path, subset, gap_at=first))}
    assert by_name["bird1_2"].frames[0].name == f"{first:06d}.jpg"


@pytest.mark.parametrize(
    ("name", "attributes"),
    [("dtb70", ("SV", "FCM")), ("uav123", ("SV", "BC")), ("uavdt", ("BC", "LO")), ("visdrone2018", ("VC",))],
)
def test_attributes_are_read_where_the_benchmark_has_them(name, attributes, tmp_path):
    assert attributes in {s.attributes for s in read_benchmark(name, LAYOUTS[name](tmp_path))}


@pytest.mark.parametrize("spelling", ["UAV123@10fps", "UAV123_10fps", "uav123-10fps"])
def test_a_benchmark_is_known_however_it_is_spelled(spelling, tmp_path):
    assert len(read_benchmark(spelling, rendered.uav123(tmp_path, "UAV123_10fps"))) == 3


@pytest.mark.parametrize("benchmark", ["", "some_benchmark", "some/benchmark"])
def test_a_plain_folder_is_searched_a_few_levels_deep(benchmark, tmp_path):
    rendered.plain_folder(tmp_path, ("one", "two"), benchmark=benchmark)
    assert [s.name for s in read_benchmark("folder", tmp_path)] == ["one", "two"]


def test_sequences_of_one_name_are_told_apart_by_their_folder(tmp_path):
    rendered.plain_folder(tmp_path, ("walk",), benchmark="a")
    rendered.plain_folder(tmp_path, ("walk", "run"), benchmark="b")
    assert [s.name for s in read_benchmark("folder", tmp_path)] == ["a/walk", "run", "b/walk"]


def test_sequences_of_one_name_and_one_folder_name_are_told_apart_by_their_path(tmp_path):
    for where in ("A/train", "B/train"):
        rendered.plain_folder(tmp_path, ("car1",), benchmark=where)
    assert [s.name for s in read_benchmark("folder", tmp_path)] == ["A/train/car1", "B/train/car1"]


def test_annotations_of_one_name_are_told_apart_by_their_path(tmp_path):
    for where in ("x/anno", "y/anno", "anno"):
        rendered.write_truth(tmp_path / where / "walk.txt", rendered.path_of_target(4))
    assert {s.name for s in read_benchmark("folder", tmp_path)} == {"walk", "x/walk", "y/walk"}


@pytest.mark.parametrize("delimiter", [",", "\t", " ", ", "])
def test_annotations_may_be_apart_by_comma_blank_or_tab(delimiter, tmp_path):
    truth = rendered.path_of_target(4)
    truth[2] = np.nan
    rendered.write_truth(tmp_path / "boxes.txt", truth, delimiter)
    assert np.array_equal(read_boxes(tmp_path / "boxes.txt"), truth, equal_nan=True)


BROKEN = {
    "a frame is missing": (
        lambda root: (root / "walk" / "000305.png").unlink(),
        r"walk: one image is missing between 000304\.png and 000306\.png, .*: copy what is missing, or",
    ),
    "the last frame is missing": (
        lambda root: (root / "walk" / "000308.png").unlink(),
        r"groundtruth_rect\.txt: one annotation for each frame is needed, not 6 for 5 frames",
    ),
    "the annotation is short": (
        lambda root: rendered.write_truth(root / "walk" / "groundtruth_rect.txt", rendered.path_of_target(4)),
        r"groundtruth_rect\.txt: one annotation for each frame is needed, not 4 for 6 frames",
    ),
    "a row is short": (
        lambda root: (root / "walk" / "groundtruth_rect.txt").write_text("1,2,3,4\n1,2,3\n"),
        r"groundtruth_rect\.txt, row 2: a box has four numbers",
    ),
    "a row is prose": (
        lambda root: (root / "walk" / "groundtruth_rect.txt").write_text("1,2,3,4\nnone at all\n"),
        r"groundtruth_rect\.txt, line 2: not numbers: 'none at all'",
    ),
    "a number is none of an image": (
        lambda root: (root / "walk" / "groundtruth_rect.txt").write_text("1,2,3,4\n1,inf,3,4\n"),
        r"groundtruth_rect\.txt, row 2: a box lies within 1e\+06 pixels, inf does not",
    ),
    "the annotation is in another encoding": (
        lambda root: (root / "walk" / "groundtruth_rect.txt").write_bytes("1,2,3,4\n".encode("utf-16")),
        r"groundtruth_rect\.txt is not text in UTF-8 \(byte 1\)",
    ),
    "the annotation is empty": (
        lambda root: (root / "walk" / "groundtruth_rect.txt").write_text(""),
        r"groundtruth_rect\.txt: a file of boxes has a line for each frame; this one is empty",
    ),
    "there is no sequence": (
        lambda root: (root / "walk" / "groundtruth_rect.txt").unlink(),
        r"holds no sequence in the layout of 'folder'",
    ),
}


@pytest.mark.parametrize("what", BROKEN)
def test_what_is_broken_in_a_folder_is_named_in_one_sentence(what, tmp_path):
    damage, sentence = BROKEN[what]
    damage(rendered.plain_folder(tmp_path))
    with pytest.raises(ValueError, match=sentence) as error:
        read_benchmark("folder", tmp_path)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("name", "frame"),
    [
        ("uav123", "data_seq/UAV123/walk/000003.jpg"),
        ("uavdt", "S0101/img000003.jpg"),
        ("visdrone2018", "sequences/uav01_s/img0000003.jpg"),
    ],
)
def test_a_missing_frame_is_named_in_every_numbered_layout(name, frame, tmp_path):
    LAYOUTS[name](tmp_path)
    (tmp_path / frame).unlink()
    with pytest.raises(ValueError, match=frame.rpartition("/")[2]):
        read_benchmark(name, tmp_path)


def test_annotations_alone_can_be_judged_but_not_run(tmp_path):
    rendered.write_truth(tmp_path / "anno" / "walk.txt", rendered.path_of_target(4))
    for name in LAYOUTS:
        if name not in {"uav123", "uav123@10fps"}:
            continue
        (sequence,) = read_benchmark(name, tmp_path)
        assert len(sequence.truth) == 4
        with pytest.raises(FileNotFoundError, match="sequence walk has no frames"):
            sequence.need_frames()


def test_a_first_annotation_that_is_no_box_is_named(tmp_path):
    rendered.write_truth(tmp_path / "anno" / "walk.txt", np.array([[np.nan] * 4, [1, 2, 3, 4]]))
    (sequence,) = read_benchmark("folder", tmp_path)
    with pytest.raises(ValueError, match="sequence walk: the first annotation cannot start a tracker"):
        sequence.first_box()


def test_stored_boxes_are_found_in_every_known_arrangement(tmp_path):
    (sequence,) = read_benchmark("folder", rendered.plain_folder(tmp_path / "data", benchmark="Bench"))
    places = ["walk.txt", "T/walk.txt", "Bench/T/walk.txt", "Bench/walk.txt", "results/T/walk.txt"]
    for number, place in enumerate([*places, "Bench/results/T/walk.txt"]):
        folder = tmp_path / str(number)
        (folder / place).parent.mkdir(parents=True)
        write_boxes(folder / place, sequence.truth)
        assert np.array_equal(read_stored(folder, "T", [sequence]).boxes["walk"], sequence.truth)
        if "T" in place:
            assert trackers_in(folder, [sequence]) == ["T"]


def test_the_toolkits_matlab_files_give_the_boxes_of_their_first_run(tmp_path):
    (sequence,) = read_benchmark("folder", rendered.plain_folder(tmp_path / "data"))
    runs = np.empty((1, 2), dtype=object)
    runs[0, 0] = {"type": "rect", "res": sequence.truth, "fps": 30.0}
    runs[0, 1] = {"type": "rect", "res": sequence.truth + 9, "fps": 30.0}
    savemat(tmp_path / "walk_T.mat", {"results": runs})
    assert np.array_equal(read_stored(tmp_path, "T", [sequence]).boxes["walk"], sequence.truth)
    numbered = np.column_stack([np.arange(6), sequence.truth])  # VisDrone's toolkit counts the frames
    savemat(tmp_path / "walk_T.mat", {"results": {"res": numbered}})
    assert np.array_equal(read_stored(tmp_path, "T", [sequence]).boxes["walk"], sequence.truth)
    savemat(tmp_path / "walk_T.mat", {"speed": 3.0})
    with pytest.raises(ValueError, match=r"walk_T\.mat: neither results"):
        read_stored(tmp_path, "T", [sequence])


def test_a_stored_result_that_is_too_short_is_named(tmp_path):
    (sequence,) = read_benchmark("folder", rendered.plain_folder(tmp_path / "data"))
    write_boxes(tmp_path / "walk.txt", sequence.truth[:4])
    with pytest.raises(ValueError, match=r"walk\.txt: 6 boxes are needed, one a frame, not 4"):
        read_stored(tmp_path, "T", [sequence])


def test_frames_come_from_a_folder_or_fail_with_its_name(tmp_path):
    rendered.plain_folder(tmp_path)
    assert len(list(frames_of(tmp_path / "walk"))) == 6
    (tmp_path / "walk" / "000304.png").write_bytes(b"no image")
    with pytest.raises(ValueError, match=r"000304\.png is not an image"):
        list(frames_of(tmp_path / "walk"))
    with pytest.raises(ValueError, match="without images"):
        next(frames_of(tmp_path))
