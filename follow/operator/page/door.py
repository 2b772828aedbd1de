"""Who may open the page: the address it listens on, its token, and the checks of each request.

Another site can abuse a user's browser in three ways.  It opens a WebSocket here: its Origin is not ours.  It points
its own name here (DNS rebinding): the Host is not an address of this machine.  It shows the page in a frame and lets
the user click in it (clickjacking): frames are forbidden.  An address that other machines can reach also needs a token,
once in the URL, from then on in a cookie that no other site can use.
"""

import contextlib
import fcntl
import hashlib
import hmac
import ipaddress
import re
import secrets
import socket
import stat
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from http.cookies import CookieError, SimpleCookie
from pathlib import Path
from urllib.parse import parse_qs, urlencode

from follow.link.addresses import LAST_PORT
from follow.link.transports import Reach, reach_of

LEAST_TOKEN = 16  # letters: what `secrets.token_urlsafe(12)` has, 96 bits
COOKIE_S = 30 * 24 * 3600  # so that a phone need not scan the address before each flight

MAKES_TOKEN = "python3 -c 'import secrets; print(secrets.token_urlsafe(18))'"

INTERFACES = Path("/sys/class/net")
SIOCGIFADDR = 0x8915  # netdevice(7): the address of an interface


@dataclass(frozen=True, slots=True)
class PageAddress:
    """Where the page listens."""

    host: str
    port: int

    @property
    def is_local(self) -> bool:
        """Whether only programs on this machine reach it."""
        return reach_of(self.host) is Reach.LOOPBACK

    @property
    def is_everywhere(self) -> bool:
        """Whether it listens at every address of this machine."""
        return self.host in ("0.0.0.0", "::")

    def urls(self, token: str = "") -> tuple[str, ...]:
        """The URLs for a browser: one for each address of this machine that another device can reach.

        They hold addresses, because a phone in the field has no name server that knows this machine's name.  Empty
        without a network.
        """
        hosts = network_addresses(":" in self.host) if self.is_everywhere else (self.host,)
        query = f"?{urlencode({'token': token})}" if token else ""
        return tuple(f"http://{f'[{host}]' if ':' in host else host}:{self.port}/{query}" for host in hosts)


def network_addresses(is_ipv6: bool = False, interfaces: Path = INTERFACES) -> tuple[str, ...]:
    """This machine's addresses on networks, those of wireless interfaces first, virtual ones (containers) last."""
    found: list[tuple[bool, bool, int, str]] = []
    for index, name in socket.if_nameindex():
        folder = interfaces / name
        kind = not (folder / "wireless").exists(), not (folder / "device").exists(), index
        found += [(*kind, address) for address in (ipv6_of(name) if is_ipv6 else ipv4_of(name))]
    return tuple(address for *_kind, address in sorted(found) if reach_of(address) is Reach.NETWORK)


def ipv4_of(interface: str) -> tuple[str, ...]:
    """The interface's first IPv4 address; empty if it has none or is down."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe, contextlib.suppress(OSError):
        answer = fcntl.ioctl(probe, SIOCGIFADDR, struct.pack("256s", interface.encode()[:15]))
        return (socket.inet_ntoa(answer[20:24]),)
    return ()


def ipv6_of(interface: str, table: Path = Path("/proc/net/if_inet6")) -> tuple[str, ...]:
    """The interface's IPv6 addresses, without link-local ones: they need a zone name, which browsers do not accept."""
    lines = table.read_text().splitlines() if table.exists() else []
    rows = [line.split() for line in lines]
    return tuple(str(ipaddress.ip_address(bytes.fromhex(r[0]))) for r in rows if r[5] == interface and r[3] == "00")


def parse_page_address(text: str) -> PageAddress:
    """Read `HOST:PORT`.  Raises ValueError."""
    host, colon, port = text.rpartition(":")
    host = host.removeprefix("[").removesuffix("]")
    if not colon or not host or not (port.isascii() and port.isdigit()) or not 1 <= int(port) <= LAST_PORT:
        raise ValueError(f"--page {text!r} must be HOST:PORT with a port from 1 to {LAST_PORT}, as 127.0.0.1:8080")
    return PageAddress(host, int(port))


def read_token(path: Path) -> str:
    """The token in a file.  Raises ValueError if others may read it or it is too short, OSError."""
    if not path.exists():
        raise FileNotFoundError(f"there is no page's token {path}: {MAKES_TOKEN} > {path}; chmod 600 {path}")
    mode = stat.S_IMODE(path.stat().st_mode)
    if mode & 0o077:
        raise ValueError(f"the page's token {path} must be readable by its owner only, not {mode:03o}: chmod 600 it")
    token = path.read_text(encoding="utf-8", errors="replace").strip()
    if len(token) < LEAST_TOKEN or not re.fullmatch(r"[A-Za-z0-9_-]+", token):
        raise ValueError(
            f"the page's token {path} must be at least {LEAST_TOKEN} letters, digits, - or _: {MAKES_TOKEN} makes one"
        )
    return token


def new_token() -> str:
    """A token for this start of the program."""
    return secrets.token_urlsafe(18)


def require_token(address: PageAddress, token: str) -> None:
    """Raise ValueError for an address that other machines can reach, without a token."""
    if not token and not address.is_local:
        raise ValueError(f"the page on {address.host} needs a token: others reach that address")


@dataclass(frozen=True, slots=True)
class Refusal:
    """Why a request is refused."""

    status: int
    words: str


class Door:
    """The checks of each request.  An empty `token`, allowed only on a loopback address, skips its check."""

    def __init__(self, address: PageAddress, token: str) -> None:
        require_token(address, token)
        self.address, self.token = address, token
        self.cookie_name = f"follow_{address.port}"  # browsers send a cookie to every port of a host
        self._cookie = hashlib.sha256(f"follow page {token}".encode()).hexdigest() if token else ""
        name = socket.gethostname().lower()
        self._names = {"localhost"} if address.is_local else {"localhost", name, f"{name}.local", address.host.lower()}

    def refusal(self, headers: Mapping[str, str], *, changes: bool) -> Refusal | None:
        """Why a request with these headers is refused, apart from its token; `changes` is a WebSocket or a POST."""
        host = headers.get("host", "")
        if not self._is_ours(host):
            return Refusal(403, f"this page has no name {host[:80]!r}: open it by the address that was printed")
        if changes and headers.get("origin", "") != f"http://{host}":
            return Refusal(403, f"another site ({headers.get('origin', 'none')[:80]!r}) may not order here")
        return None

    def is_let_in(self, headers: Mapping[str, str]) -> bool:
        """Whether the request has the cookie."""
        if not self.token:
            return True
        try:
            cookie = SimpleCookie(headers.get("cookie", "")).get(self.cookie_name)
        except CookieError:
            return False
        given = cookie.value if cookie is not None else ""
        return hmac.compare_digest(given.encode(), self._cookie.encode())

    def token_of(self, query: str) -> str | None:
        """The cookie to set if the query has the right token, "" for a wrong one, None if it has no token."""
        try:
            given = parse_qs(query, max_num_fields=10).get("token")
        except ValueError:
            return ""
        if not given or not self.token:
            return None
        if not hmac.compare_digest(given[0].encode(), self.token.encode()):
            return ""
        return f"{self.cookie_name}={self._cookie}; HttpOnly; SameSite=Strict; Path=/; Max-Age={COOKIE_S}"

    def _is_ours(self, host: str) -> bool:
        """Whether a Host header names this machine: an address, which no foreign name server can give, or its name."""
        name = host.rpartition("]")[0].removeprefix("[") if host.startswith("[") else host.partition(":")[0]
        try:
            ip = ipaddress.ip_address(name)
        except ValueError:
            return name.lower() in self._names
        return ip.is_loopback or not self.address.is_local
