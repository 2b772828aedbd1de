"""Load on the operator's page: windows that confirm every image, one that never does, and a flood of clicks.

    python -m benchmarks.page_load 127.0.0.1:8080 --watchers 10 --clicks 1000 --seconds 60

Prints the images a second that the watchers got.
"""

import argparse
import contextlib
import json
import struct
import threading
import time
from collections.abc import Iterator

import numpy as np
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect


@contextlib.contextmanager
def opened(host: str, key: int) -> Iterator[ClientConnection]:
    """A window of the page."""
    with connect(f"ws://{host}/window", origin=f"http://{host}", compression=None) as window:
        window.send(f"{key:016x}")
        yield window


def watch(host: str, key: int, end_s: float, counts: list[int], *, shows: bool) -> None:
    """Receive all messages; with `shows` confirm each image, as the page does."""
    with contextlib.suppress(ConnectionClosed), opened(host, key) as window:
        while time.monotonic() < end_s:
            try:
                message = window.recv(0.5)
            except TimeoutError:
                continue
            if isinstance(message, bytes):
                counts[key] += 1
                (length,) = struct.unpack(">H", message[:2])
                if shows:
                    window.send(json.dumps({"do": "shown", "frame": json.loads(message[2 : 2 + length])["frame"]}))


def click(host: str, key: int, end_s: float, a_second: float) -> int:
    """Send clicks at this rate; opens the window again where the page has closed it."""
    sent, began_s = 0, time.monotonic()
    message = json.dumps({"do": "select", "frame": 1, "box": [0.5, 0.5, 0.0, 0.0]})
    while time.monotonic() < end_s:
        try:
            with opened(host, key) as window:
                while (now_s := time.monotonic()) < end_s:
                    while sent < a_second * (now_s - began_s):
                        window.send(message)
                        sent += 1
                    time.sleep(0.005)
        except ConnectionClosed:
            continue
        except OSError:  # the page has ended
            break
    return sent


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("host", metavar="HOST:PORT")
    parser.add_argument("--watchers", type=int, default=10)
    parser.add_argument("--clicks", type=float, default=1000.0, help="a second")
    parser.add_argument("--seconds", type=float, default=60.0)
    options = parser.parse_args()
    end_s, counts = time.monotonic() + options.seconds, [0] * (options.watchers + 1)
    threads = [
        threading.Thread(target=watch, args=(options.host, key, end_s, counts), kwargs={"shows": key > 0})
        for key in range(options.watchers + 1)
    ]
    for thread in threads:
        thread.start()
    sent = click(options.host, 1000, end_s, options.clicks) if options.clicks else 0
    for thread in threads:
        thread.join()
    rates = np.array(counts[1:]) / options.seconds
    print(
        f"{options.watchers} watchers: {rates.min():.1f} to {rates.max():.1f} images/s each, one that shows none got "
        f"{counts[0] / options.seconds:.1f}; {sent / options.seconds:.0f} clicks/s"
    )


if __name__ == "__main__":
    main()
