"""A program's standard output as a camera: rpicam-vid, nvgstcapture, gst-launch, ffmpeg, libcamera-vid.

The program gets its own session, so that Ctrl-C in the terminal reaches only us; it is ended with the camera, and if
this process is killed, SIGPIPE ends it.
"""

import contextlib
import fcntl
import os
import re
import select
import shlex
import signal
import subprocess
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from typing import Any

import av
import av.error

from follow.camera import CameraError
from follow.camera.capture import OPEN_S, QUICK, SILENT_S, Image, StreamCapture
from follow.camera.names import RAW_FORMATS, CameraName
from follow.camera.stream_clock import SteadyArrivals
from racf.video import ANY_TEXT, to_bgr

CHUNK = 1 << 20  # bytes in one read at most: a pipe holds 64 KiB unless it was made larger
USUAL_PIPE = 1 << 16  # assumed capacity of a pipe, bytes, if the system does not report it
LONGEST_LINE = 4096  # bytes; a longer line of error, such as progress without a line feed, is read in pieces
MOST_SAID = 300  # characters of it that are shown
END_S = 1.0  # grace period between SIGTERM and SIGKILL
SOI = b"\xff\xd8"  # JPEG's start of image
JPEG_END = re.compile(rb"\xff\xd9\0*(?=\xff\xd8|\Z)")
"""JPEG's end of image, with the zeros that some encoders pad it with, before another image or the end of the data.

Within the coded data 0xff is followed by 0x00 or a restart marker; a thumbnail's end is followed by another marker.
"""
LOOK_BACK = 64  # bytes before the new data that are searched again: an end marker may be split between two reads
MOST_JPEG = 16_000_000  # bytes of one image: 3840x2160 of the best quality takes 10 MB
PACKAGES = {
    "rpicam-vid": "rpicam-apps",
    "libcamera-vid": "rpicam-apps (which calls it rpicam-vid)",
    "gst-launch-1.0": "gstreamer1.0-tools",
    "ffmpeg": "ffmpeg",
    "srt-live-transmit": "srt-tools",
}
"""Program -> the package of Debian, Ubuntu and Raspberry Pi OS that has it."""
BARE_FPS = "30"  # a bare stream's nominal rate: its stamps are not used


class PipeArrivals:
    """A lower bound on the arrival time of a pipe's data, so that a late reader does not make old data look new.

    If a read had to wait, its data arrived then.  Otherwise they arrived after the pipe was last empty, and after the
    byte `holds` before their last one was read, because the pipe cannot hold more.
    """

    def __init__(self, holds: int, t_s: float) -> None:
        self._holds, self._position, self._empty_t_s = holds, 0, t_s
        self._reads: deque[tuple[int, float]] = deque()  # position before each read, and its time
        self.came_t_s = t_s

    def read(self, count: int, emptied: bool, waited: bool, t_s: float) -> None:
        """Note a read of `count` bytes that began at `t_s`; emptied: it left the pipe empty."""
        self._reads.append((self._position, t_s))
        self._position += count
        bound_t_s = max(self.came_t_s, self._empty_t_s)
        while self._reads and self._reads[0][0] < self._position - self._holds:
            bound_t_s = max(bound_t_s, self._reads.popleft()[1])
        self.came_t_s = t_s if waited else bound_t_s
        if emptied:
            self._empty_t_s = t_s


def _pipe_size(pipe: int) -> int:
    command = getattr(fcntl, "F_GETPIPE_SZ", None)  # Linux
    return USUAL_PIPE if command is None else fcntl.fcntl(pipe, command)


def words_of(name: CameraName) -> list[str]:
    """The program and its arguments.  Raises CameraError for quotes that do not match."""
    try:
        return shlex.split(name.address)
    except ValueError as error:
        raise CameraError(f"camera {name.text!r}: the program cannot be started: {error}") from None


def missing_program(name: CameraName) -> str:
    """The error for a program that is not there, with what installs it."""
    program = words_of(name)[0]
    package = PACKAGES.get(program)
    how = f"sudo apt install {package}" if package else "install it, or give its whole path"
    return f"camera {name.text!r}: there is no program {program!r} here: {how}"


class RunningProgram:
    """A program with its standard output as a file, its last line of error, and the arrival time of its data."""

    def __init__(self, name: CameraName, clock: Callable[[], float]) -> None:
        self._name, self._clock = name, clock
        self.last_error = ""
        self.timeout_s = OPEN_S
        try:
            self._process = subprocess.Popen(
                words_of(name),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                start_new_session=True,
            )
        except FileNotFoundError:
            raise CameraError(missing_program(name)) from None
        except OSError as error:
            why = error.strerror or str(error)
            raise CameraError(f"camera {name.text!r}: the program cannot be started: {why}") from None
        assert self._process.stdout is not None
        self._output = self._process.stdout.fileno()
        self._arrivals = PipeArrivals(_pipe_size(self._output), clock())
        self._listener = threading.Thread(target=self._listen, name="camera errors", daemon=True)
        self._listener.start()
        self._peeked = b""

    def peek(self) -> bytes:
        """The first bytes, which `read` returns again.  Raises CameraError after the timeout."""
        self._peeked = self._peeked or self._from_pipe(CHUNK)
        return self._peeked

    def _listen(self) -> None:
        assert self._process.stderr is not None
        while line := self._process.stderr.readline(LONGEST_LINE):
            parts = [part.strip() for part in line.decode(errors="replace").split("\r")]  # progress overwrites itself
            if any(parts):
                self.last_error = next(part for part in reversed(parts) if part)[:MOST_SAID]

    def read(self, size: int) -> bytes:
        """The available data, at most `size` bytes; b"" at the end.  Raises CameraError after the timeout."""
        if self._peeked:
            data, self._peeked = self._peeked[:size], self._peeked[size:]
            return data
        return self._from_pipe(size)

    def _from_pipe(self, size: int) -> bytes:
        waited = not select.select([self._output], [], [], 0.0)[0]
        if waited and not select.select([self._output], [], [], self.timeout_s)[0]:
            raise CameraError(f"nothing came for {self.timeout_s:g} s{self.said()}")
        now_t_s = self._clock()  # taken before the read: data that arrive later are newer
        data = os.read(self._output, min(size, CHUNK))
        self._arrivals.read(len(data), len(data) < min(size, CHUNK), waited, now_t_s)
        return data

    @property
    def read_t_s(self) -> float:
        """The earliest time at which the data last read can have arrived."""
        return self._arrivals.came_t_s

    def said(self) -> str:
        """How it ended and its last line of error, to append to a reason."""
        status = self._process.poll()
        self._listener.join(timeout=0.2 if status is not None else 0.0)
        ended = f"; the program ended with status {status}" if status is not None else ""
        return ended + (f": {self.last_error}" if self.last_error else "")

    def wait_end(self) -> None:
        """Wait up to END_S for a program that has closed its output."""
        end_s = time.monotonic() + END_S
        while self._process.poll() is None and time.monotonic() < end_s:
            time.sleep(0.01)

    def interrupt(self) -> None:
        """Tell the program to end."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGTERM)

    def end(self) -> None:
        """End the program and everything it started."""
        for number in (signal.SIGTERM, signal.SIGKILL):
            try:
                os.killpg(self._process.pid, number)
            except (ProcessLookupError, PermissionError):
                break
            self.wait_end()
            if self._process.poll() is not None and number is signal.SIGTERM:
                continue  # its child processes may still run

    def close(self) -> None:
        """End the program and close its pipes; no thread may read them any more."""
        self.end()
        for pipe in (self._process.stdout, self._process.stderr):
            if pipe is not None:
                pipe.close()
        self._process.wait()


class ProgramCapture:
    """A program whose output FFmpeg demuxes: H.264, H.265, raw images, or a container with stamps."""

    def __init__(self, name: CameraName, program: RunningProgram) -> None:
        self._name, self._program = name, program
        self._container = self._open()
        self._capture, self.shrink = StreamCapture(self._container, lambda: program.read_t_s), 1
        self.size = self._capture.size

    def _open(self) -> Any:
        options, format_ = dict(QUICK), self._name.options.get("format")
        if format_ in RAW_FORMATS:
            assert self._name.size is not None
            options = {"pixel_format": format_, "video_size": self._name.options["size"]}
            options["framerate"] = self._name.options.get("fps", BARE_FPS)
            format_ = "rawvideo"
        try:
            return av.open(self._program, format=format_, options=options, **ANY_TEXT)
        except (av.error.FFmpegError, OSError, ValueError, CameraError) as error:
            self._program.wait_end()
            ended = "" if isinstance(error, CameraError) else self._program.said()
            raise CameraError(f"{getattr(error, 'strerror', None) or error}{ended}") from None

    def images(self) -> Iterator[tuple[Image, float | None]]:
        """Yield the program's images until it ends."""
        self._capture.shrink = self.shrink
        try:
            yield from self._capture.images()
        except CameraError as error:
            self._program.wait_end()
            raise CameraError(f"{error}{self._program.said()}") from None

    def interrupt(self) -> None:
        """Tell the program to end."""
        self._program.interrupt()
        self._capture.interrupt()

    def close(self) -> None:
        """End the program."""
        self._program.end()
        self._capture.close()
        self._program.close()


class JpegCapture:
    """A program that writes a series of JPEGs: each is complete at its end marker, without waiting for the next one."""

    def __init__(self, program: RunningProgram) -> None:
        self._program = program
        self._context: Any = av.CodecContext.create("mjpeg", "r")
        self._taken, self.shrink = SteadyArrivals(), 1
        first = next(self._decoded(), None)
        if first is None:
            raise CameraError("no JPEG came")
        self.size = (first[0].shape[1], first[0].shape[0])

    def _decoded(self) -> Iterator[tuple[Image, float | None]]:
        held, image_t_s = b"", self._program.read_t_s
        while data := self._program.read(CHUNK):
            looked = max(len(held) - LOOK_BACK, 0)
            held += data
            ends = [end.end() for end in JPEG_END.finditer(held, looked)]
            taken_t_s = None
            for _ in ends:
                taken_t_s = self._taken.taken_at(0.0, self._program.read_t_s)
            # Of several waiting images only the last is useful; it starts where the one before ended.
            newest = held[([0, *ends])[-2] : ends[-1]] if ends else b""
            held = held[ends[-1] :] if ends else held
            for image in self._image(newest):
                image_t_s = self._program.read_t_s
                yield image, taken_t_s
            if len(held) > MOST_JPEG or self._program.read_t_s - image_t_s > self._program.timeout_s:
                raise CameraError("it writes no JPEG that can be decoded")

    def _image(self, jpeg: bytes) -> Iterator[Image]:
        """The decoded image; nothing if it cannot be decoded."""
        try:
            frames = self._context.decode(av.Packet(jpeg)) if jpeg else []
        except av.error.FFmpegError:
            return
        yield from (to_bgr(frame, self.shrink) for frame in frames)

    def images(self) -> Iterator[tuple[Image, float | None]]:
        """Yield the newest image of each read until the program ends."""
        yield from self._decoded()
        self._program.wait_end()
        raise CameraError(f"it ended{self._program.said()}")

    def interrupt(self) -> None:
        """Tell the program to end."""
        self._program.interrupt()

    def close(self) -> None:
        """End the program."""
        self._program.close()


def open_program(name: CameraName, clock: Callable[[], float]) -> ProgramCapture | JpegCapture:
    """Start a program and wait for its first image.  Raises CameraError with its last line of error."""
    program = RunningProgram(name, clock)
    try:
        jpeg = name.options.get("format") == "mjpeg" or ("format" not in name.options and program.peek()[:2] == SOI)
        capture = JpegCapture(program) if jpeg else ProgramCapture(name, program)
    except CameraError as error:
        program.wait_end()
        ended = "" if "; the program ended" in str(error) else program.said()
        program.close()
        raise CameraError(f"camera {name.text!r} cannot be opened: {error}{ended}") from None
    program.timeout_s = SILENT_S
    return capture
