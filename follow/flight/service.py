"""A flight's notifications to systemd: ready, alive, stopping (sd_notify(3)).

Only the control loop feeds the watchdog, so systemd restarts a program that hangs; it starts in OBSERVE.
"""

import contextlib
import os
import socket

from follow.messages import NEVER

ALIVE_EVERY_S = 0.5  # a quarter of the shortest WatchdogSec that makes sense for a loop with rounds of 50 ms


class Service:
    """Notifies the service manager that started us, if one did.  `address` is the value of NOTIFY_SOCKET."""

    def __init__(self, address: str | None = None) -> None:
        address = os.environ.get("NOTIFY_SOCKET", "") if address is None else address
        self._socket: socket.socket | None = None
        self._alive_t_s = NEVER
        if address:
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
            self._socket.setblocking(False)
            self._address = "\0" + address[1:] if address.startswith("@") else address

    def ready(self) -> None:
        """The loop is about to begin."""
        self._say("READY=1")

    def alive(self, t_s: float, mode: str) -> None:
        """A round was completed at `t_s`."""
        if not 0.0 <= t_s - self._alive_t_s < ALIVE_EVERY_S:
            self._alive_t_s = t_s
            self._say(f"WATCHDOG=1\nSTATUS={mode}")

    def stopping(self) -> None:
        """The flight is being ended."""
        self._say("STOPPING=1")

    def close(self) -> None:
        """Close the socket."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _say(self, text: str) -> None:
        if self._socket is not None:
            with contextlib.suppress(OSError):  # never abort a flight because systemd is not listening
                self._socket.sendto(text.encode(), self._address)
