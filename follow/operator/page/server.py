"""The page's thread: an HTTP and WebSocket server with its own event loop, beside a flight that never waits for it."""

# pyright: reportMissingImports=false
# The extra `page` may be missing where types are checked.

import asyncio
import contextlib
import errno
import html
import logging
import os
import socket
import threading
from collections.abc import Awaitable, Callable, MutableMapping
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import uvicorn
from starlette.applications import Starlette
from starlette.datastructures import Headers
from starlette.requests import Request
from starlette.responses import FileResponse, HTMLResponse, JSONResponse, PlainTextResponse, RedirectResponse, Response
from starlette.routing import Route, WebSocketRoute
from typing_extensions import Self
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from websockets.frames import Frame

from follow.messages import Notify
from follow.operator.page.door import Door, PageAddress, Refusal, network_addresses, require_token
from follow.operator.page.exchange import Exchange
from follow.operator.page.recordings import FlightShelf
from follow.operator.page.reports import Reports
from follow.operator.page.windows import LARGEST_MESSAGE, Windows

CLOSE_S = 3.0  # timeout for the thread to end
CONNECTIONS = 64  # at a time; a window has one, a browser opens a few more for files
CONNECTIONS_OF_ONE = 32  # from one address: even without a token one client must not keep the others out
REQUEST_S = 5.0  # timeout of a new connection's first request
BYTES_PER_S = 128_000  # rate limit of a window; 20 confirmations, 5 taps and a sign of life a second are 2 kB
BYTES_AT_ONCE = 64_000  # burst after a stalled network; pings of this size take some 40 ms
MESSAGE_BYTES = 32  # each message costs this much of the budget besides its bytes
FRAGMENTS = 64  # most fragments of a message; a browser does not fragment one of the permitted size
FLOOD = "too many bytes or messages"
FLOOD_CLOSE_S = 0.5  # time for the reason to arrive
SERVER_LOG = logging.getLogger("uvicorn")
HTML = Path(__file__).with_name("page.html")
REPORTS_POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:; sandbox"
REFUSED = """<!doctype html><meta name="viewport" content="width=device-width, initial-scale=1"><title>Follow</title>
<p style="font: bold 20px sans-serif; overflow-wrap: anywhere">{words}</p>
"""
NO_TOKEN = Refusal(403, "open the page by the whole address with ?token=... that was printed or is in your token file")
WRONG_TOKEN = Refusal(
    403,
    "this token is wrong, or of an earlier start: open the page by the whole address with ?token=... that was printed "
    "by this start or is in your token file",
)

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[MutableMapping[str, Any]]]
Send = Callable[[MutableMapping[str, Any]], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]


def guarded_by(door: Door, app: App) -> App:
    """An application that is reached only through the door."""

    async def guard(scope: Scope, receive: Receive, send: Send) -> None:
        is_socket = scope["type"] == "websocket"
        headers = Headers(scope=scope)
        refused = door.refusal(headers, changes=is_socket or scope.get("method") not in ("GET", "HEAD"))
        if refused is not None:
            await refuse(is_socket, refused, scope, receive, send)
            return
        cookie = door.token_of(scope["query_string"].decode("latin-1"))
        if cookie:
            await RedirectResponse("/", 303, {"set-cookie": cookie, **fixed(headers)})(scope, receive, send)
        elif cookie == "" or not door.is_let_in(headers):
            await refuse(is_socket, WRONG_TOKEN if cookie == "" else NO_TOKEN, scope, receive, send)
        else:
            await app(scope, receive, with_headers(send, fixed(headers)))

    return guard


async def refuse(is_socket: bool, refusal: Refusal, scope: Scope, receive: Receive, send: Send) -> None:
    """Refuse a request with a page that a phone can show; a WebSocket before it is accepted, which gives status 403."""
    if is_socket:
        await send({"type": "websocket.close", "code": 1008})
    else:
        page = REFUSED.format(words=html.escape(refusal.words))
        await HTMLResponse(page, refusal.status, {"content-security-policy": REPORTS_POLICY})(scope, receive, send)


def fixed(headers: Headers) -> dict[str, str]:
    """The headers of every response: no content from elsewhere, no frame of another site, no caching."""
    socket_url = f"ws://{headers.get('host', '')}"
    return {
        "content-security-policy": (
            "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src 'self' blob: data:; "
            f"connect-src 'self' {socket_url}; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
        ),
        "x-frame-options": "DENY",
        "x-content-type-options": "nosniff",
        "referrer-policy": "no-referrer",
        "cross-origin-resource-policy": "same-origin",
        "cache-control": "no-store",
    }


def with_headers(send: Send, headers: dict[str, str]) -> Send:
    """A `send` that adds the headers to each response that does not set them itself."""

    async def sending(message: MutableMapping[str, Any]) -> None:
        if message["type"] == "http.response.start":
            there = {name.lower() for name, _ in message["headers"]}
            new = [(n.encode(), v.encode("latin-1")) for n, v in headers.items() if n.encode() not in there]
            message = {**message, "headers": [*message["headers"], *new]}
        await send(message)

    return sending


def application(door: Door, exchange: Exchange, flights: FlightShelf) -> App:
    """The page's routes behind its door."""
    body, windows, reports = HTML.read_bytes(), Windows(exchange), Reports(flights, exchange)

    def page(_request: Request) -> Response:
        return Response(body, media_type="text/html; charset=utf-8")

    def listing(_request: Request) -> Response:
        return JSONResponse([flight.as_json for flight in flights.listed()])

    def download(request: Request) -> Response:
        path = flights.file(request.path_params["name"], request.path_params["file"])
        if path is None:
            return PlainTextResponse("no such recording\n", 404)
        if path.suffix == ".html":
            return FileResponse(path, headers={"content-security-policy": REPORTS_POLICY})
        return FileResponse(path, filename=f"{request.path_params['name'].replace('/', '-')}-{path.name}")

    async def report(request: Request) -> Response:
        why = await reports.write(request.path_params["name"])
        return PlainTextResponse(why or "written", 200 if not why else 409)

    routes = [
        Route("/", page),
        Route("/recordings", listing),
        Route("/recordings/{name:path}/report", report, methods=["POST"]),
        Route("/recordings/{name:path}/{file}", download),
        WebSocketRoute("/window", windows.serve),
    ]
    app = Starlette(routes=routes)
    app.router.redirect_slashes = False
    return guarded_by(door, app)


def listening(address: PageAddress) -> socket.socket:
    """A socket that listens there; port 0 takes a free one.  Raises OSError with a sentence for a person."""
    family = socket.AF_INET6 if ":" in address.host else socket.AF_INET
    try:
        return socket.create_server((address.host, address.port), family=family, backlog=CONNECTIONS)
    except OSError as error:
        raise OSError(
            f"--page {address.host}:{address.port} cannot be opened: {why_not_listening(error, address)}"
        ) from None


def why_not_listening(error: OSError, address: PageAddress) -> str:
    """Why nothing can listen there, and what to do."""
    if isinstance(error, socket.gaierror):
        return f"no address is known for {address.host!r}: give 0.0.0.0, for all of this machine"
    if error.errno == errno.EADDRNOTAVAIL:
        own = ("127.0.0.1", *network_addresses(":" in address.host))
        return f"{address.host} is not an address of this machine: give 0.0.0.0, for all it has, or {' or '.join(own)}"
    why = os.strerror(error.errno) if error.errno else str(error)
    advice = {
        errno.EADDRINUSE: ": give another port, or end the program that has it",
        errno.EACCES: ": give a port above 1023",
    }
    return f"{why}{advice.get(error.errno or 0, '')}"


class BoundedHttp(H11Protocol):
    """HTTP of one connection, which is closed at once if there are too many, or after REQUEST_S without a request.

    Each connection takes a file descriptor of the process that flies, even before any token is checked.
    """

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override] - as uvicorn's own
        """Accept the connection, or close it if there are too many."""
        super().connection_made(transport)
        peers = [peer_of(other) for other in self.connections]
        if len(peers) > CONNECTIONS or peers.count(peer_of(self)) > CONNECTIONS_OF_ONE:
            transport.abort()
        else:
            self.loop.call_later(REQUEST_S, self._close_silent)

    def _close_silent(self) -> None:
        if self in self.connections and cast("object", self.cycle) is None:  # neither a window nor a request yet
            self.transport.abort()


class BoundedWebSocket(WebSocketsSansIOProtocol):
    """WebSocket of one window, which is closed if it sends far more than the page does.

    Pings, pongs and fragments never reach the window's own reader, but parsing them takes the interpreter lock that the
    control loop needs.  A frame from a window has at least 6 bytes, so the budget of bytes also limits the frames.
    """

    _left, _left_s = float(BYTES_AT_ONCE), 0.0
    _is_flooded = False

    def data_received(self, data: bytes) -> None:
        """Parse the data if the budget permits it."""
        now_s = self.loop.time()
        self._left = min(self._left + BYTES_PER_S * (now_s - self._left_s), BYTES_AT_ONCE)
        self._left_s = now_s
        if self._pays(len(data)):
            super().data_received(data)

    def send_receive_event_to_app(self) -> None:
        """Pass one message on if the budget permits it."""
        if self._pays(MESSAGE_BYTES):
            super().send_receive_event_to_app()

    def handle_cont(self, event: Frame) -> None:
        """Add a fragment to a message unless it has too many: even empty ones take memory."""
        if self._pays(0 if len(self.frames) < FRAGMENTS else BYTES_AT_ONCE):
            super().handle_cont(event)

    def _pays(self, cost: int) -> bool:
        """Take a cost from the budget; a window that exceeds it gets the reason, is no longer read, and is cut off."""
        self._left -= cost
        if self._left < 0.0 and not self._is_flooded:
            self._is_flooded = True
            self.logger.error(f"{peer_of(self)} sent {FLOOD} and was cut off")
            self.conn.fail(1008, FLOOD)
            self.transport.write(b"".join(self.conn.data_to_send()))
            self.queue.put_nowait({"type": "websocket.disconnect", "code": 1008})
            self.close_sent, self.read_paused = True, False  # otherwise the queue's reader resumes reading
            self.transport.pause_reading()
            self.close_timer = self.loop.call_later(FLOOD_CLOSE_S, self.transport.abort)
        return not self._is_flooded


def peer_of(connection: object) -> str:
    """The address at the other end of a connection."""
    transport = cast("asyncio.Transport | None", getattr(connection, "transport", None))
    peer = transport.get_extra_info("peername") if transport is not None else None
    return str(peer[0]) if peer else ""


class ErrorLines(logging.Handler):
    """Reports an error inside the page as one line, the same one once."""

    def __init__(self, report: Notify) -> None:
        super().__init__(logging.ERROR)
        self._report = report
        self._told: set[str] = set()

    def emit(self, record: logging.LogRecord) -> None:
        """Report one record."""
        error = record.exc_info[1] if record.exc_info else None
        words = f"{type(error).__name__}: {error}" if error is not None else record.getMessage()
        if words not in self._told:
            self._told.add(words)
            self._report(f"the page could not serve a window ({words}): the flight goes on")


class PageServer:
    """Serves the page from a thread of its own until it is closed.

    Raises OSError, with a sentence for a person, if it cannot listen at the address, ValueError without a token at an
    address that others reach.
    """

    def __init__(self, address: PageAddress, token: str, exchange: Exchange, out: Path, report: Notify) -> None:
        self._report, self._exchange = report, exchange
        require_token(address, token)
        self._socket = listening(address)
        self.address = replace(address, port=self._socket.getsockname()[1])
        app = application(Door(self.address, token), exchange, FlightShelf(out))
        self._log = ErrorLines(report)
        SERVER_LOG.addHandler(self._log)
        SERVER_LOG.propagate = False
        config = uvicorn.Config(
            app,
            log_config=None,
            access_log=False,
            lifespan="off",
            http=BoundedHttp,
            ws=BoundedWebSocket,
            ws_max_size=LARGEST_MESSAGE,
            ws_per_message_deflate=False,
            ws_ping_interval=5.0,
            ws_ping_timeout=10.0,
            limit_concurrency=CONNECTIONS,
            timeout_graceful_shutdown=1,
            server_header=False,
        )
        self._server = uvicorn.Server(config)
        self._thread = threading.Thread(target=self._run, name="page", daemon=True)
        self._thread.start()

    @property
    def is_alive(self) -> bool:
        """Whether the page's thread runs."""
        return self._thread.is_alive()

    def _run(self) -> None:
        """Run the server; the page's thread."""
        try:
            self._server.run([self._socket])
        except (Exception, SystemExit) as error:  # noqa: BLE001 - whatever it was, the flight goes on without the page
            self._report(f"the page has ended ({type(error).__name__}: {error}): the flight goes on without it")
        finally:
            self._exchange.wake = lambda: None
            SERVER_LOG.removeHandler(self._log)
            with contextlib.suppress(OSError):
                self._socket.close()

    def close(self) -> None:
        """End the thread; after the timeout it is left running."""
        self._server.should_exit = True
        self._thread.join(CLOSE_S)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()
