"""The open windows: each gets the newest image and status, and a person's acts in it go to the loop.

The next image is sent when the window has confirmed that it shows the last one, so that a slow phone skips images and
never lags.  Each status is complete, so nothing queues up for a window that does not read.
"""

# pyright: reportMissingImports=false
# The extra `page` may be missing where types are checked.

import asyncio
import contextlib
import json
import re
import struct
import time
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray
from starlette.websockets import WebSocket, WebSocketDisconnect

from follow.messages import Frame
from follow.operator.page.exchange import Act, Doing, Exchange, Shown, copied, read_act

IMAGES_PER_S = 20.0  # at most; the eye sees motion from 15 on
STATUS_PER_S = 10.0
IMAGE_TIMEOUT_S = 2.0  # an image that was not confirmed by then is lost: send the next one
WIDEST_PX = 960  # wider images are shrunk: a phone shows no more
JPEG_QUALITY = 70  # some 30 kB at 640x360
LARGEST_MESSAGE = 2048  # bytes from a window
WINDOWS = 24  # open at a time
KNOWN_WINDOWS = 200  # keys that are remembered, so that a window that reconnects keeps its name and the command
ACTS_PER_S, BURST = 10.0, 20.0  # rate limit of one window; a thumb presses 5 times a second
HELLO_S = 5.0
HEARD_S = 1.0  # least time between two signs of life passed on to the loop
CLOSE_S = 0.5  # timeout for a connection that may be dead
REPLACED = 4001  # close code that tells a window to take a new key
WINDOW = re.compile(r"[0-9a-f]{8,32}")

Closed = (WebSocketDisconnect, RuntimeError, OSError)
"""Errors of sending to a window that has just gone."""


@dataclass(slots=True, eq=False)
class PageWindow:
    """One open window."""

    name: str
    socket: WebSocket
    news: asyncio.Event = field(default_factory=asyncio.Event)
    sent_frame: int = -1
    waits_since_s: float | None = None  # when the image was sent that it has not yet confirmed
    seen_line: int = 0
    budget: float = BURST
    budget_s: float = 0.0
    heard_s: float = 0.0

    def may_act(self, now_s: float) -> bool:
        """Whether the rate limit (a token bucket) permits one more act now."""
        self.budget = min(self.budget + ACTS_PER_S * (now_s - self.budget_s), BURST)
        self.budget_s = now_s
        if self.budget < 1.0:
            return False
        self.budget -= 1.0
        return True


class Windows:
    """Every window's connection; runs in the page's thread."""

    def __init__(self, exchange: Exchange) -> None:
        self._exchange = exchange
        self._open: set[PageWindow] = set()
        self._names: dict[str, str] = {}
        self._answered: dict[str, int] = {}  # by name, the newest reply that was sent, also before a reconnection
        self._count = 0
        self._jpeg: tuple[Frame | None, bytes] = None, b""
        self._status: tuple[Shown | None, str] = None, ""

    async def serve(self, socket: WebSocket) -> None:
        """One window, from its first message to its end."""
        await socket.accept()
        if len(self._open) >= WINDOWS:
            await socket.close(1013, "too many windows are open")
            return
        self._listen()
        window = await self._hello(socket)
        if window is None:
            return
        await self._replace(window.name)
        self._open.add(window)
        sending = asyncio.create_task(self._send(window))
        try:
            await self._receive(window)
        finally:
            self._open.discard(window)
            sending.cancel()
            with contextlib.suppress(asyncio.CancelledError, *Closed):
                await sending

    async def _replace(self, name: str) -> None:
        """Close the windows open under that name: a duplicated browser tab has the same key."""
        for other in [window for window in self._open if window.name == name]:
            with contextlib.suppress(asyncio.TimeoutError, *Closed):
                await asyncio.wait_for(other.socket.close(REPLACED, "this window was opened again"), CLOSE_S)

    def _listen(self) -> None:
        """Let the control loop wake this thread's event loop."""
        loop = asyncio.get_running_loop()
        is_woken = [False]

        def news() -> None:
            is_woken[0] = False
            for window in self._open:
                window.news.set()

        def wake() -> None:
            if not is_woken[0]:
                is_woken[0] = True
                with contextlib.suppress(RuntimeError):  # the event loop has ended
                    loop.call_soon_threadsafe(news)

        self._exchange.wake = wake

    async def _hello(self, socket: WebSocket) -> PageWindow | None:
        """The window, once it has sent its key; None for a connection that does not."""
        with contextlib.suppress(asyncio.TimeoutError, *Closed):
            message = await asyncio.wait_for(socket.receive(), HELLO_S)
            text = message.get("text") or ""
            if message["type"] == "websocket.receive" and WINDOW.fullmatch(text):
                return PageWindow(self._name(text), socket)
            await socket.close(1008, "a window begins with its own number")
        return None

    def _name(self, key: str) -> str:
        """The name of the window with that key; it stays the same after a reconnection."""
        if key not in self._names:
            if len(self._names) >= KNOWN_WINDOWS:
                self._answered.pop(self._names.pop(next(iter(self._names))), None)
            self._count += 1
            self._names[key] = f"page {self._count}"
        return self._names[key]

    async def _receive(self, window: PageWindow) -> None:
        """Take the window's messages until it closes."""
        while True:
            message = await window.socket.receive()
            if message["type"] != "websocket.receive":
                return
            now_s = time.monotonic()
            try:
                act = read_act(message.get("text") or "", window.name)
            except ValueError as error:
                if window.may_act(now_s):
                    self._exchange.reply(window.name, str(error), done=False)
                continue
            self._take(window, act, now_s)

    def _take(self, window: PageWindow, act: Act, now_s: float) -> None:
        """Pass one act on to the loop."""
        if now_s - window.heard_s >= HEARD_S:
            window.heard_s = now_s
            self._exchange.hear(window.name)
        if act.doing is Doing.SHOWN:
            if act.frame == window.sent_frame:
                window.waits_since_s = None
                window.news.set()
        elif act.doing is not Doing.HERE and (act.is_stop or window.may_act(now_s)):
            if self._exchange.is_flying:
                self._exchange.act(act)
            else:
                self._exchange.reply(window.name, "not flying: nothing can be ordered yet", done=False)

    async def _send(self, window: PageWindow) -> None:
        """Send the newest image and status whenever there is news."""
        loop = asyncio.get_running_loop()
        await window.socket.send_text(json.dumps({"you": window.name, "path": copied(self._exchange.path)}))
        status_s = image_s = 0.0
        while True:
            with contextlib.suppress(asyncio.TimeoutError):
                await asyncio.wait_for(window.news.wait(), 0.5)
            window.news.clear()
            shown, now_s = self._exchange.shown, loop.time()
            if now_s - status_s >= 1 / STATUS_PER_S:
                status_s = now_s
                await window.socket.send_text(self._state(window, shown))
            if now_s - image_s >= 1 / IMAGES_PER_S and self._takes_image(window, shown, now_s):
                image_s = now_s
                assert shown.frame is not None
                window.sent_frame, window.waits_since_s = shown.frame.index, now_s
                await window.socket.send_bytes(self._image(shown, shown.frame))

    def _takes_image(self, window: PageWindow, shown: Shown, now_s: float) -> bool:
        """Whether there is a new image and the window has confirmed the last one."""
        if shown.frame is None or shown.frame.index == window.sent_frame:
            return False
        return window.waits_since_s is None or now_s - window.waits_since_s > IMAGE_TIMEOUT_S

    def _state(self, window: PageWindow, shown: Shown) -> str:
        """The status for one window: the part common to all, and the lines and replies that are new to it."""
        if self._status[0] is not shown:
            self._status = shown, json.dumps(shown.status, allow_nan=False)
        lines = [line for line in copied(self._exchange.lines) if line.n > window.seen_line]
        answered = self._answered.get(window.name, 0)
        replies = [r for r in copied(self._exchange.replies) if r.n > answered and r.by == window.name]
        if replies:
            self._answered[window.name] = replies[-1].n
        window.seen_line = lines[-1].n if lines else window.seen_line
        own = {
            "you": window.name,
            "lines": [line.text for line in lines],
            "replies": [[reply.done, reply.text] for reply in replies],
            "windows": len(self._open),
        }
        return f'{{"own": {json.dumps(own)}, "status": {self._status[1]}}}'

    def _image(self, shown: Shown, frame: Frame) -> bytes:
        """A frame as the page reads it: its header's length, the header, the JPEG."""
        if self._jpeg[0] is not frame:
            self._jpeg = frame, jpeg_of(frame.image)
        header = {"frame": frame.index, "box": shown.box, "tracking": shown.tracking, "found": shown.found}
        text = json.dumps(header).encode()
        return struct.pack(">H", len(text)) + text + self._jpeg[1]


def jpeg_of(image: NDArray[np.uint8]) -> bytes:
    """An image as JPEG, no wider than WIDEST_PX."""
    if image.shape[1] > WIDEST_PX:
        rows = round(image.shape[0] * WIDEST_PX / image.shape[1])
        image = np.asarray(cv2.resize(image, (WIDEST_PX, rows), interpolation=cv2.INTER_AREA), np.uint8)
    return cv2.imencode(".jpg", image, (cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY))[1].tobytes()
