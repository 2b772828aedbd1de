"""The recording's frames: an H.264 stream that decodes frame for frame, clear inside the target's box."""

import itertools
import math
from dataclasses import replace

import av
import numpy as np
import pytest

from examples.read_a_recording import images
from follow.messages import Frame
from follow.recording.recorder import RecordConfig, Recorder
from follow.recording.video_encoder import (
    KEY_S,
    Encoder,
    H264Encoder,
    JpegEncoder,
    Sample,
    bits_per_s,
    encoder,
    even,
)
from racf.box import Box
from tests.follow.test_record_flight import tick

rng = np.random.default_rng(4)


def texture(rows: int, columns: int) -> np.ndarray:
    """An image with detail at every scale, grey values in all three channels."""
    image = np.zeros((rows, columns))
    for size in (2, 8, 32):
        coarse = rng.normal(0, 20, (rows // size + 2, columns // size + 2))
        image += np.kron(coarse, np.ones((size, size)))[:rows, :columns]
    return np.repeat(np.clip(image + 128, 0, 255).astype(np.uint8)[..., None], 3, axis=2)


def moving(count: int, rows: int = 180, columns: int = 320) -> list[np.ndarray]:
    ground = texture(rows + 4 * count, columns + 4 * count)
    return [np.ascontiguousarray(ground[2 * n : 2 * n + rows, n : n + columns]) for n in range(count)]


def decoded(samples: list[Sample]) -> list[np.ndarray]:
    codec = av.CodecContext.create("h264", "r")
    frames = [frame for sample in samples for frame in codec.decode(av.Packet(sample.data))]
    return [frame.to_ndarray(format="gray") for frame in [*frames, *codec.decode(None)]]


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    return 10 * math.log10(255**2 / max(float(np.mean((a.astype(float) - b) ** 2)), 1e-9))


def test_each_frame_comes_back_in_order_with_its_own_time():
    images = moving(20)
    times = [n / 30 + 0.001 * (n % 3) for n in range(20)]  # a camera's stamps jitter
    coder = H264Encoder("libx264")
    samples = [s for image, t in zip(images, times, strict=True) for s in coder.encode(image, t)]
    samples += coder.finish()
    assert [s.t_s for s in samples] == times
    back = decoded(samples)
    assert len(back) == 20
    for n in (0, 7, 19):
        errors = [psnr(image[..., 0], back[n]) for image in images]
        assert int(np.argmax(errors)) == n


def test_each_frame_of_a_recording_is_read_back_with_its_own_time(tmp_path):
    moved = moving(40)
    with Recorder(tmp_path, RecordConfig(), print, waits=True) as recorder:
        for n, image in enumerate(moved):
            round_ = tick(n)
            recorder.tick(replace(round_, frame=Frame(image, n / 30, n)))
    back = list(images(tmp_path))
    assert [round(t_s * 30) for t_s, _ in back] == list(range(40))
    for n in (0, 17, 39):
        likeness = [psnr(image[..., 0], back[n][1][..., 0]) for image in moved]
        assert int(np.argmax(likeness)) == n


def test_the_target_is_clearer_than_the_rest():
    images, box = moving(30), Box(120, 60, 40, 60)
    coder = H264Encoder("libx264")
    back = decoded([s for n, image in enumerate(images) for s in coder.encode(image, n / 30, box)])
    inside = [psnr(a[60:120, 120:160, 0], b[60:120, 120:160]) for a, b in zip(images, back, strict=True)]
    outside = [psnr(a[..., 0], b) for a, b in zip(images, back, strict=True)]
    assert np.mean(inside) > np.mean(outside) + 2
    assert min(inside) > 36


def test_a_box_outside_the_image_is_no_error():
    coder = H264Encoder("libx264")
    (image,) = moving(1)
    for n, box in enumerate([Box(-90, -90, 20, 20), Box(400, 10, 5, 5), Box(-5, -5, 900, 900), Box(5, 5, 0.2, 0.2)]):
        assert [*coder.encode(image, n / 30, box)]


@pytest.mark.parametrize(("rows", "columns"), [(181, 320), (180, 321), (33, 17)])
def test_odd_sizes_are_made_even_by_repeating_the_edge(rows, columns):
    image = texture(rows, columns)
    assert even(image).shape == (rows + rows % 2, columns + columns % 2, 3)
    assert np.array_equal(even(image)[:rows, :columns], image)
    coder = H264Encoder("libx264")
    (back,) = decoded([*coder.encode(image, 0.0), *coder.finish()])
    assert back.shape == even(image).shape[:2]


def test_grey_images_and_another_size_are_encoded():
    coder = H264Encoder("libx264")
    small, large = texture(60, 80)[..., 0].copy(), texture(120, 160)
    samples = [*coder.encode(small, 0.0), *coder.encode(small, 0.1), *coder.encode(large, 0.2), *coder.finish()]
    assert [s.is_key for s in samples] == [True, False, True]
    assert [frame.shape for frame in decoded(samples)] == [(60, 80), (60, 80), (120, 160)]


def test_key_frames_come_by_time_whatever_the_frame_rate():
    coder = H264Encoder("libx264")
    (image,) = moving(1)
    samples = [s for n in range(20) for s in coder.encode(image, 0.5 * n)]  # two frames a second
    keys = [s.t_s for s in samples if s.is_key]
    assert all(later - earlier <= KEY_S + 1e-9 for earlier, later in itertools.pairwise(keys))
    middle = next(n for n, s in enumerate(samples) if s.is_key and n > 0)
    assert len(decoded(samples[middle:])) == len(samples) - middle  # a viewer can start there


def test_the_bit_rate_grows_slower_than_the_pixels():
    assert bits_per_s((640, 360)) * 60 / 8 < 6.5e6
    assert bits_per_s((1280, 720)) * 60 / 8 < 17e6
    assert bits_per_s((320, 180)) == pytest.approx(bits_per_s((640, 360)) / 4)


def test_noise_that_no_encoder_can_compress_keeps_to_the_bit_rate():
    coder = H264Encoder("libx264")
    noise = [rng.integers(0, 256, (180, 320, 3), dtype=np.uint8) for _ in range(5)]
    size = sum(len(s.data) for n in range(300) for s in coder.encode(noise[n % 5], n / 30))
    assert size * 8 / 10 < 1.25 * bits_per_s((320, 180))


def test_an_encoder_that_this_machine_lacks_is_an_error_by_name_and_auto_goes_on_without():
    with pytest.raises(OSError, match="h264_v4l2m2m does not open"):
        list(encoder(Encoder.V4L2, 75).encode(texture(60, 80), 0.0))
    assert [*encoder(Encoder.AUTO, 75).encode(texture(60, 80), 0.0)]
    assert isinstance(encoder(Encoder.JPEG, 75), JpegEncoder)
