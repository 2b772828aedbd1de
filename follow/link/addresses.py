"""Addresses of links: how they are written, and why one cannot be opened."""

import errno
import socket

from follow.link import LinkError
from racf.nearest import close, question

LAST_PORT = 65535
KINDS = ("udpin", "udpout", "tcp", "serial")
FORMS = "udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT, serial:DEVICE:BAUD or (--link only) mavsdk+udpin://HOST:PORT"


def parse_address(uri: str) -> tuple[str, str, int]:
    """Kind, host or device, and port or baud rate of an address.  Raises LinkError for a malformed one."""
    kind, _, rest = uri.partition(":")
    name, _, number = rest.rpartition(":")
    known = kind in KINDS
    if not known or not name or not number.isdecimal() or (kind != "serial" and "/" in name):
        near = "" if known else question(close(kind, KINDS))
        raise LinkError(f"a link is {FORMS}, not {uri!r}{f'; {near}' if near else ''}")
    if kind != "serial" and int(number) > LAST_PORT:
        raise LinkError(f"the port of a link is at most {LAST_PORT}, not {number}")
    return kind, name, int(number)


def why_not(error: Exception, name: str) -> str:
    """Why a host or device of that name cannot be opened, and what to do."""
    if isinstance(error, socket.gaierror):
        return f"no address is known for {name!r}: look at the spelling and the network, or give its numbers"
    number = error.args[0] if error.args else None
    why = (error.strerror if isinstance(error, OSError) else None) or str(error.args[-1] if error.args else error)
    advice = {
        errno.EADDRINUSE: "end the program that has it, or use another port",
        errno.EADDRNOTAVAIL: f"{name} is not an address of this machine; 0.0.0.0 listens at all that it has",
        errno.EACCES: f"join the group that may open {name}, as dialout; a port below 1024 needs root",
        errno.ENOENT: "look at its name and cable",
        errno.ENXIO: "look at its name and cable",
        errno.EIO: "look at its name and cable",
        errno.ENOTTY: f"{name} is not a serial line",
        errno.ETIMEDOUT: "look at address and network",
        errno.EHOSTUNREACH: "look at address and network",
        errno.ENETUNREACH: "look at address and network",
    }
    return ": ".join(filter(None, [why, advice.get(number) if isinstance(number, int) else None]))
