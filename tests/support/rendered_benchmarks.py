"""Rendered sequences in each benchmark's own layout: a textured square that walks over a textured ground."""

from pathlib import Path

import cv2
import numpy as np

ROWS, COLS = 120, 160


def picture(x: float, y: float, w: float, h: float) -> np.ndarray:
    """The scene with the target at 0-based `x, y, w, h`."""
    rng = np.random.default_rng(7)
    ground = cv2.resize(rng.integers(60, 120, (15, 20, 3), dtype=np.uint8), (COLS, ROWS))
    target = cv2.resize(rng.integers(150, 255, (4, 4, 3), dtype=np.uint8), (round(w), round(h)))
    ground[round(y) : round(y) + round(h), round(x) : round(x) + round(w)] = target
    return ground


def path_of_target(frames: int, begin: int = 0) -> np.ndarray:
    """Annotations in 1-based pixels, (frames, 4), beginning with step `begin` of the walk."""
    step = np.arange(begin, begin + frames)
    return np.stack([31 + 2 * step, 41 + step, np.full(frames, 24), np.full(frames, 20)], axis=1).astype(float)


def write_frames(folder: Path, pattern: str, truth: np.ndarray, first: int = 1) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for number, (x, y, w, h) in enumerate(truth, start=first):
        cv2.imwrite(str(folder / pattern.format(number)), picture(x - 1, y - 1, w, h))


def write_truth(path: Path, truth: np.ndarray, delimiter: str = ",") -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savetxt(path, truth, fmt="%g", delimiter=delimiter)


def plain_folder(root: Path, names: tuple[str, ...] = ("walk",), frames: int = 6, benchmark: str = "") -> Path:
    for begin, name in enumerate(names):
        truth = path_of_target(frames, begin)
        write_frames(root / benchmark / name, "{:06d}.png", truth, first=303)
        write_truth(root / benchmark / name / "groundtruth_rect.txt", truth)
    return root


def dtb70(root: Path) -> Path:
    truth = path_of_target(5)
    write_frames(root / "Walk1" / "img", "{:05d}.jpg", truth)
    write_truth(root / "Walk1" / "groundtruth_rect.txt", truth, "\t")
    write_truth(root / "att" / "Walk1.txt", np.array([[1, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0]]))
    return root


def uav123(root: Path, subset: str = "UAV123", gap_at: int = 0) -> Path:
    """`walk_1` and `walk_2` from one folder, `bird1_1` and, after a gap, `bird1_2`; `car1_s` with its own folder."""
    frames = path_of_target(9)
    write_frames(root / "data_seq" / subset / "walk", "{:06d}.jpg", frames)
    write_truth(root / "anno" / subset / "walk_1.txt", frames[:5])
    write_truth(root / "anno" / subset / "walk_2.txt", frames[4:])
    write_frames(root / "data_seq" / subset / "car1_s", "{:06d}.jpg", frames[:4])
    write_truth(root / "anno" / subset / "car1_s.txt", frames[:4])
    write_truth(root / "anno" / subset / "att" / "car1_s.txt", np.array([[1, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0]]))
    if gap_at:
        write_frames(root / "data_seq" / subset / "bird1", "{:06d}.jpg", frames[:3])
        write_frames(root / "data_seq" / subset / "bird1", "{:06d}.jpg", frames[3:6], first=gap_at)
        write_truth(root / "anno" / subset / "bird1_1.txt", frames[:3])
        write_truth(root / "anno" / subset / "bird1_2.txt", frames[3:6])
    return root


def uavdt(root: Path) -> Path:
    truth = path_of_target(5)
    write_frames(root / "S0101", "img{:06d}.jpg", truth)
    write_truth(root / "anno" / "S0101_gt.txt", truth)
    write_truth(root / "att" / "S0101_att.txt", np.array([[1, 0, 0, 0, 0, 0, 0, 0, 1]]))
    return root


def visdrone2018(root: Path) -> Path:
    truth = path_of_target(5)
    write_frames(root / "sequences" / "uav01_s", "img{:07d}.jpg", truth)
    write_truth(root / "annotations" / "uav01_s.txt", truth)
    write_truth(root / "attributes" / "uav01_s_attr.txt", np.array([[0] * 11 + [1]]))
    return root
