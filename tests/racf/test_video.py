"""Video files: every kind gives its frames in order with their own times, and what is missing is counted.

The referee is the number that each image shows.
"""

import itertools
import os
import shutil
import struct
from pathlib import Path

import av
import numpy as np
import pytest

from racf.errors import VideoError
from racf.video import Video, VideoImage
from racf.video_writer import VideoWriter
from tests.support.clips import clip, encode, number_in, numbered

QUIET_X265 = {"x265-params": "log-level=0"}
INTRA = {"g": "1"}
KINDS: dict[str, dict] = {
    "h264 with B-frames.mp4": {},
    "h265.mkv": {"codec": "libx265", "codec_options": QUIET_X265},
    "mjpeg.avi": {"codec": "mjpeg", "pix_fmt": "yuvj420p"},
    "av1.mp4": {"codec": "libsvtav1", "codec_options": {"preset": "12"}},
    "vp9.webm": {"codec": "libvpx-vp9"},
    "vp8 with hidden frames.webm": {
        "codec": "libvpx",
        "codec_options": {"auto-alt-ref": "1", "lag-in-frames": "16", "b": "300k"},
    },
    "mpeg2.ts": {"codec": "mpeg2video"},
    "prores 10 bit 422.mov": {"codec": "prores_ks", "pix_fmt": "yuv422p10le"},
    "grey 10 bit.mkv": {"codec": "ffv1", "pix_fmt": "gray10le"},
    "h264 10 bit.mp4": {"pix_fmt": "yuv420p10le"},
    "odd size.mp4": {"pix_fmt": "yuv444p", "size": (193, 121)},
    "palette.gif": {"codec": "gif", "pix_fmt": "rgb8", "rate": 25},
    "bare.h264": {},
    "yuv4mpeg.y4m": {"codec": "wrapped_avframe", "format_": "yuv4mpegpipe"},
    "flash.flv": {"codec": "flv1"},
    "mpeg4.avi": {"codec": "mpeg4"},
    "h264 with B-frames.avi": {},
    "windows.wmv": {"codec": "wmv2"},
    "png with alpha.mov": {"codec": "png", "pix_fmt": "rgba"},
    "raw nv12.nut": {"codec": "rawvideo", "pix_fmt": "nv12"},
    "broadcast.mxf": {"codec": "mpeg2video", "rate": 25},
}


def shown(path: Path) -> tuple[list[VideoImage], str]:
    with Video(path) as video:
        images = list(video.images())
        assert all(image.image.shape == (video.size[1], video.size[0], 3) for image in images)
        return images, str(video.missing)


def numbers(images: list[VideoImage]) -> list[int]:
    return [number_in(image.image) for image in images]


@pytest.mark.parametrize("name", KINDS)
def test_every_kind_of_file_gives_each_frame_once_in_order_at_its_time(tmp_path, name):
    how = KINDS[name]
    images, missing = shown(clip(tmp_path / name, **how))
    assert numbers(images) == [image.index for image in images] == list(range(20))
    rate = how.get("rate", 30)
    assert [image.t_s for image in images] == pytest.approx(np.arange(20) / rate, abs=1e-3)
    assert missing == ""


@pytest.mark.parametrize("name", ["a.mp4", "a.mkv", "a.gif", "a.ts", "a.webm"])
def test_variable_frame_rate_keeps_rows_with_frames_and_time_with_stamps(tmp_path, name):
    rng = np.random.default_rng(1)
    stamps = np.cumsum(rng.choice([0.04, 0.08, 0.12, 0.40], 24)) - 0.04  # GIF counts in hundredths of a second
    how = {"a.gif": {"codec": "gif", "pix_fmt": "rgb8"}, "a.webm": {"codec": "libvpx-vp9"}}.get(name, {})
    images, missing = shown(encode(tmp_path / name, map(numbered, range(24)), stamps_s=list(stamps), **how))
    assert numbers(images) == [image.index for image in images] == list(range(24))
    assert [image.t_s for image in images] == pytest.approx(stamps - stamps[0], abs=1.1e-3)
    assert missing == ""


@pytest.mark.parametrize(
    ("name", "start_s"), [("a.ts", 36_000.0), ("a.mkv", 5.0), ("a.ts", 2**33 / 90_000 - 0.3), ("a.mp4", 2.0)]
)
def test_time_begins_with_the_first_frame_wherever_the_stream_began(tmp_path, name, start_s):
    """A transport stream from 10 h on, one whose 33-bit clock turns over after ten frames, late files."""
    path = encode(tmp_path / name, map(numbered, range(20)), options={"output_ts_offset": f"{start_s:.6f}"})
    images, missing = shown(path)
    assert [image.t_s for image in images] == pytest.approx(np.arange(20) / 30, abs=1e-3)
    assert (numbers(images), missing) == (list(range(20)), "")


def turned(path: Path, matrix: tuple[int, ...]) -> Path:
    """The file with another display matrix (a b u, c d v, x y w in 16.16) in its track's header."""
    data = bytearray(path.read_bytes())
    at = data.index(b"tkhd") + 4 + 40
    data[at : at + 36] = struct.pack(">9i", *matrix)
    path.write_bytes(data)
    return path


ONE = 1 << 16
TURNS = {
    "upright": ((ONE, 0, 0, 0, ONE, 0, 0, 0, 1 << 30), lambda image: image),
    "a quarter to the right": (
        (0, ONE, 0, -ONE, 0, 0, 0, 0, 1 << 30),
        lambda image: np.rot90(image, -1),
    ),
    "upside down": ((-ONE, 0, 0, 0, -ONE, 0, 0, 0, 1 << 30), lambda image: np.rot90(image, 2)),
    "a quarter to the left": ((0, -ONE, 0, ONE, 0, 0, 0, 0, 1 << 30), lambda image: np.rot90(image, 1)),
    "mirrored": ((-ONE, 0, 0, 0, ONE, 0, 0, 0, 1 << 30), lambda image: image[:, ::-1]),
    "mirrored upside down": ((ONE, 0, 0, 0, -ONE, 0, 0, 0, 1 << 30), lambda image: image[::-1]),
}


@pytest.mark.parametrize("how", TURNS)
def test_the_display_matrix_of_a_phone_is_applied(tmp_path, how):
    """x' = a x + c y, y' = b x + d y, y downward [ISO 14496-12, 6.2.2]: (0, 1, -1, 0) turns the first row rightmost."""
    matrix, expected = TURNS[how]
    plain = shown(clip(tmp_path / "plain.mp4", 3))[0][0].image
    images, _ = shown(turned(clip(tmp_path / "turned.mp4", 3), matrix))
    assert np.array_equal(images[0].image, expected(plain))


def woven(n: int) -> np.ndarray:
    """An interlaced image: its even rows of time n, its odd ones of half a frame later, with a bar that moves."""
    image = numbered(n)
    for field in (0, 1):
        x = 8 * n + 4 * field
        image[40 + field :: 2, x : x + 24] = 250
    return image


def test_interlaced_frames_are_deinterlaced_and_none_is_lost(tmp_path):
    interlaced = {"x264-params": "interlaced=1:tff=1", "flags": "+ildct+ilme"}
    path = encode(tmp_path / "a.mp4", map(woven, range(12)), codec_options=interlaced)
    images, missing = shown(path)
    assert numbers(images) == [image.index for image in images] == list(range(12))
    assert [image.t_s for image in images] == pytest.approx(np.arange(12) / 30, abs=1e-3)
    assert missing == ""

    def comb(image: np.ndarray) -> float:
        rows = image[48:112].astype(float).mean(2)
        return float(np.abs(rows[1:-1] - (rows[:-2] + rows[2:]) / 2).mean())

    assert max(comb(image.image) for image in images[2:]) < 0.3 * comb(woven(5))


@pytest.mark.parametrize("damaged", [0, 7, 19])
def test_a_frame_that_does_not_decode_keeps_its_row_and_is_counted(tmp_path, damaged):
    path = clip(tmp_path / "a.mp4", codec="png", pix_fmt="rgb24")
    with av.open(str(path)) as container:
        at = [(packet.pos, packet.size) for packet in container.demux(video=0) if packet.size][damaged]
    data = bytearray(path.read_bytes())
    data[at[0] : at[0] + at[1]] = bytes(at[1])
    path.write_bytes(data)
    images, missing = shown(path)
    kept = [n for n in range(20) if n != damaged]
    assert numbers(images) == kept
    rows = kept if damaged else list(range(19))  # what nothing shows before the first frame is no row
    assert [image.index for image in images] == rows
    assert missing == f"1 frame is missing (1 not decodable, first {damaged})"


@pytest.mark.parametrize(
    ("name", "options"),
    [("a.mp4", {"movflags": "frag_keyframe+empty_moov"}), ("a.mp4", {"movflags": "faststart"}), ("a.avi", {})],
)
def test_a_file_cut_at_its_end_gives_what_is_there_and_counts_the_rest(tmp_path, name, options):
    how = {"a.avi": {"codec": "mjpeg", "pix_fmt": "yuvj420p"}}.get(name, {"codec_options": INTRA})
    path = clip(tmp_path / name, 40, options=options, **how)
    with av.open(str(path)) as container:
        cut = [packet.pos for packet in container.demux(video=0) if packet.size][25] + 100
    os.truncate(path, cut)
    images, missing = shown(path)
    assert numbers(images)[:24] == list(range(24))
    assert len(images) in (25, 26), "half a frame may be shown"
    if options.get("movflags", "").startswith("frag"):
        assert missing in ("", "1 frame is missing (1 not decodable, first 25)"), (
            "it does not say how many it was to hold"
        )
    else:
        assert missing.startswith(f"{40 - len(images)} frames are missing")


def test_a_matroska_file_cut_at_its_end_says_how_much_of_its_length_is_missing(tmp_path):
    path = clip(tmp_path / "a.mkv", 120, codec_options=INTRA)
    os.truncate(path, path.stat().st_size // 2)
    images, missing = shown(path)
    assert numbers(images) == list(range(len(images)))
    left_s = 4.0 - len(images) / 30
    assert missing == f"it ends {left_s:.1f} s before the length that it says"


@pytest.mark.parametrize(
    "make", ["empty", "text", "sound", "index at the end, cut off", "zeros", "header alone", "codec"]
)
def test_a_file_of_which_no_frame_decodes_is_refused_in_one_sentence(tmp_path, make):
    path = tmp_path / "a.mp4"
    whole = clip(tmp_path / "whole.mp4").read_bytes()
    if make == "sound":
        path = tmp_path / "a.wav"
        with av.open(str(path), "w") as container:
            stream = container.add_stream("pcm_s16le", rate=8000, layout="mono")
            sound = av.AudioFrame.from_ndarray(np.zeros((1, 800), np.int16), layout="mono")
            sound.sample_rate = 8000
            container.mux(stream.encode(sound))
    else:
        contents = {
            "empty": b"",
            "text": b"x,y,w,h\n" * 400,
            "index at the end, cut off": whole[: len(whole) // 2],
            "zeros": bytes(4096),
            "header alone": whole[:64],
            "codec": clip(tmp_path / "a.avi", codec="mjpeg", pix_fmt="yuvj420p").read_bytes().replace(b"MJPG", b"QJPX"),
        }
        path.write_bytes(contents[make])
    for name in (path, path.rename(path.with_suffix(".txt"))) if make == "text" else (path,):
        with pytest.raises(VideoError) as refusal:
            Video(name)
        assert name.name in str(refusal.value)
        assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    "name",
    [
        "2024-06-01T12:30:05.mp4",
        "http:clip.mp4",
        "with spaces and 'quotes'.mp4",
        "-begins with a dash.mp4",
        "pattern%03d.mp4",
        "question?mark#hash&.mp4",
        "größe.mp4",
        os.fsdecode(b"latin1_\xfc.mp4"),
        "two\nlines.mp4",
        "no suffix",
    ],
)
def test_a_name_is_only_a_name(tmp_path, monkeypatch, name):
    shutil.copy(clip(tmp_path / "plain.mp4", 5), tmp_path / name)
    monkeypatch.chdir(tmp_path)
    for path in (Path(name), tmp_path / name):
        assert numbers(shown(path)[0]) == list(range(5))


def test_a_link_is_followed_and_a_pipe_a_folder_and_nothing_are_refused(tmp_path):
    (tmp_path / "link.mp4").symlink_to(clip(tmp_path / "plain.mp4", 5))
    assert len(shown(tmp_path / "link.mp4")[0]) == 5
    (tmp_path / "dangling.mp4").symlink_to(tmp_path / "nowhere")
    os.mkfifo(tmp_path / "pipe.mp4")
    for name in ("dangling.mp4", "pipe.mp4", "nothing.mp4"):
        with pytest.raises(VideoError, match="is not a file"):
            Video(tmp_path / name)
    with pytest.raises(VideoError, match="is a folder: read its images one by one"):
        Video(tmp_path)


def test_sound_beside_the_video_and_a_tag_that_is_not_utf8_do_no_harm(tmp_path):
    path = tmp_path / "a.mkv"
    with av.open(str(path), "w") as container:
        container.metadata["title"] = "XXXX"  # replaced below by bytes that are not UTF-8
        video = container.add_stream("libx264", rate=30)
        video.width, video.height, video.pix_fmt = 192, 120, "yuv420p"
        audio = container.add_stream("pcm_s16le", rate=8000, layout="mono")
        for n in range(10):
            container.mux(video.encode(av.VideoFrame.from_ndarray(numbered(n), format="bgr24")))
            sound = av.AudioFrame.from_ndarray(np.zeros((1, 267), np.int16), layout="mono")
            sound.sample_rate, sound.pts = 8000, 267 * n
            container.mux(audio.encode(sound))
        container.mux(video.encode(None))
    path.write_bytes(path.read_bytes().replace(b"XXXX", b"\xfc\xfe\xff\xf6"))
    images, missing = shown(path)
    assert (numbers(images), missing) == (list(range(10)), "")


def test_two_recordings_joined_have_one_time_that_only_grows(tmp_path):
    late = encode(tmp_path / "late.ts", map(numbered, range(10, 20)), options={"output_ts_offset": "5000"})
    early = encode(tmp_path / "early.ts", map(numbered, range(10)))
    for order in ((early, late), (late, early)):
        joined = tmp_path / "joined.ts"
        joined.write_bytes(b"".join(path.read_bytes() for path in order))
        images, missing = shown(joined)
        assert sorted(numbers(images)) == list(range(20))
        steps = [b.t_s - a.t_s for a, b in itertools.pairwise(images)]
        assert min(steps) > 0
        assert max(steps) < 0.5
        assert missing == "its time jumps 1 time"


def test_a_size_that_changes_is_counted_and_not_given(tmp_path):
    clip(tmp_path / "a.ts", 10)
    clip(tmp_path / "b.ts", 10, size=(240, 160), options={"output_ts_offset": "0.333333"})
    (tmp_path / "c.ts").write_bytes((tmp_path / "a.ts").read_bytes() + (tmp_path / "b.ts").read_bytes())
    images, missing = shown(tmp_path / "c.ts")
    assert numbers(images) == list(range(10))
    assert missing == "10 frames are missing (10 of another size, first 10)"


@pytest.mark.parametrize("suffix", [".mp4", ".mkv", ".avi"])
@pytest.mark.parametrize("size", [(192, 120), (193, 121)])
def test_what_is_written_is_read_again(tmp_path, suffix, size):
    path = tmp_path / f"new/a{suffix}"
    with VideoWriter(path, 29.97) as writer:
        for n in range(15):
            writer.put(numbered(n, size))
    with Video(path) as video:
        assert (video.size, video.fps) == (size, pytest.approx(29.97, abs=1e-3))
        images = list(video.images())
    assert numbers(images) == list(range(15))
    assert [image.t_s for image in images] == pytest.approx(np.arange(15) / 29.97, abs=1e-3)
    errors = [np.abs(image.image.astype(float) - numbered(n, size)).mean() for n, image in enumerate(images)]
    assert max(errors) < 8


def test_a_video_that_cannot_be_written_is_one_sentence(tmp_path):
    (tmp_path / "taken.mp4").mkdir()
    with pytest.raises(VideoError, match="cannot be written"), VideoWriter(tmp_path / "taken.mp4", 30) as writer:
        writer.put(numbered(0))
    with pytest.raises(VideoError, match="ends in"):
        VideoWriter(tmp_path / "a.gif", 30)
