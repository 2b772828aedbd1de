"""Garbage and mutations into the operator's page, over its real socket: HTTP requests, WebSocket frames, messages.

    python -m tools.fuzz.page --seconds 60 --seed 0

Each kind is fuzzed for that long against one running page, beside a running loop.  Exits 1 with the input as a Python
literal at the first violation: an error inside the server, a server that no longer serves a window, a selection outside
the image, or an act that does not exist.
"""

import argparse
import json
import os
import random
import socket
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from follow.operator.page.exchange import Act, read_act
from follow.selection import Selection
from tests.support.page_rig import PageRig
from tools.fuzz.inputs import mutated

ANSWER_S = 0.02  # wait for a reply before the next input
CHECK_EVERY = 100  # inputs between two checks that a window is still served
KEY = b"0123456789abcdef"

Send = Callable[[PageRig, bytes], None]


def masked(opcode: int, payload: bytes, mask: bytes) -> bytes:
    """A client's WebSocket frame."""
    length = bytes([0x80 | len(payload)]) if len(payload) < 126 else b"\xfe" + len(payload).to_bytes(2, "big")
    return bytes([0x80 | opcode]) + length + mask + bytes(b ^ mask[i % 4] for i, b in enumerate(payload))


def handshake(rig: PageRig) -> bytes:
    lines = (
        *("GET /window HTTP/1.1", f"Host: {rig.host}", "Upgrade: websocket", "Connection: Upgrade"),
        *("Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==", "Sec-WebSocket-Version: 13", f"Origin: http://{rig.host}"),
    )
    return ("\r\n".join(lines) + "\r\n\r\n").encode()


def over_tcp(rig: PageRig, data: bytes) -> None:
    """Send bytes over a connection of their own, and read what comes back within a moment."""
    with socket.create_connection(("127.0.0.1", rig.port), timeout=2.0) as wire:
        wire.settimeout(ANSWER_S)
        try:
            wire.sendall(data)
            wire.recv(65536)
        except (TimeoutError, ConnectionError):
            pass  # no reply, or a refusal


def after_handshake(rig: PageRig, data: bytes) -> None:
    """Send bytes on an open WebSocket after its greeting."""
    over_tcp(rig, handshake(rig) + masked(1, KEY, b"\0\0\0\0") + data)


def http_seeds(rig: PageRig) -> list[bytes]:
    paths = ("/", "/recordings", "/recordings/before/ticks.csv", "/recordings/now/earlier-1/flight.rrd", "/?token=abc")
    lines = [f"GET {path} HTTP/1.1\r\nHost: {rig.host}\r\nCookie: a=b; follow_{rig.port}=x\r\n\r\n" for path in paths]
    lines.append(f"POST /recordings/x/report HTTP/1.1\r\nHost: {rig.host}\r\nOrigin: http://{rig.host}\r\n\r\n")
    lines.append(f"HEAD / HTTP/1.1\r\nHost: {rig.host}\r\nRange: bytes=0-1\r\n\r\n")
    return [line.encode() for line in lines] + [handshake(rig)]


def messages() -> list[bytes]:
    acts = [{"do": "here"}, {"do": "clear"}, {"do": "hand-over"}, {"do": "shown", "frame": 3}]
    acts += [{"do": "order", "order": order} for order in ("follow", "stop", "nearer", "top-down")]
    acts += [
        {"do": "select", "frame": 5, "box": [0.4, 0.3, 0.1, 0.2]},
        {"do": "select", "frame": 5, "box": [1, 1, 0, 0]},
    ]
    return [json.dumps(act).encode() for act in acts]


def read_one(_rig: PageRig, data: bytes) -> None:
    """The reader of messages alone: an act, or a ValueError of one line."""
    try:
        act = read_act(data.decode(errors="replace"), "page 1")
    except ValueError as error:
        if "\n" in str(error) or not str(error):
            raise AssertionError(f"not one line: {error!r}") from None
    else:
        assert isinstance(act, Act)


def kinds(rig: PageRig, rng: random.Random) -> dict[str, tuple[list[bytes], Send]]:
    mask = rng.randbytes(4)
    frames = [masked(1, message, mask) for message in messages()]
    frames += [
        masked(2, b"\0\1\2", mask),
        masked(8, b"\x03\xe8", mask),
        masked(9, b"ping", mask),
        masked(10, b"", mask),
    ]
    return {
        "messages": (messages(), read_one),
        "messages in whole frames": (messages(), lambda rig, data: after_handshake(rig, masked(1, data[:60000], mask))),
        "frames": (frames, after_handshake),
        "requests": (http_seeds(rig), over_tcp),
    }


def check(rig: PageRig) -> str:
    """What is wrong with the page now; empty if nothing is."""
    bad = [line for line in rig.lines if "could not serve" in line or "has ended" in line]
    for choice in rig.chosen:
        if isinstance(choice, Selection):
            inside = 0.0 <= choice.left <= choice.left + choice.width <= 1.0 + 1e-9
            if not (inside and 0.0 <= choice.top <= choice.top + choice.height <= 1.0 + 1e-9):
                bad.append(f"{choice} was selected")
    rig.chosen.clear()
    rig.operator.waiting.clear()
    rig.lines.clear()
    if bad:
        return bad[0]
    try:
        with rig.window("ffffffffffffffff") as window:
            window.until(lambda w: w.images and w.status)
    except Exception as error:  # noqa: BLE001 - whatever it is, the page no longer serves
        return f"a window is no longer served: {type(error).__name__}: {error}"
    return ""


def fuzz(
    rig: PageRig, name: str, seeds: list[bytes], send: Send, seconds: float, rng: random.Random
) -> tuple[str, str]:
    """Fuzz one kind; returns a line of figures and the violation, if any."""
    sent: list[bytes] = []
    count, end_s = 0, time.monotonic() + seconds
    while time.monotonic() < end_s:
        data = mutated(rng.choice(seeds), rng)
        sent.append(data)
        try:
            send(rig, data)
        except AssertionError as error:
            return "", f"{name}: {error}, input {data!r}"
        rig.round()
        count += 1
        if send is not read_one and count % CHECK_EVERY == 0:
            if wrong := check(rig):
                return "", f"{name}: {wrong}; one of {sent!r}"
            sent.clear()
    wrong = check(rig)
    return f"{name}: {count} inputs, the page serves on", f"{name}: {wrong}; one of {sent!r}" if wrong else ""


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0, help="for each kind")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(argv)
    rng, failed = random.Random(options.seed), False
    with tempfile.TemporaryDirectory() as folder:
        before = Path(folder) / "before"
        before.mkdir()
        (before / "ticks.csv").write_text("t_s\n")
        with PageRig(Path(folder) / "now") as rig:
            for name, (seeds, send) in kinds(rig, rng).items():
                figures, wrong = fuzz(rig, name, seeds, send, options.seconds, rng)
                print(wrong[:4000] or figures, flush=True)
                failed |= bool(wrong)
        assert sorted(os.listdir(folder)) == ["before"], "the page wrote somewhere"
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
