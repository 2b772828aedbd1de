"""`--page`: builds the operator's page for `follow run` and `follow sim`."""

import contextlib
from collections.abc import Callable, Generator
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path

from follow.control.selector import Selector
from follow.control.servo import Servo
from follow.messages import Notify
from follow.operator.authority import Operator
from follow.operator.consoles import Consoles
from follow.operator.page.desk import PageDesk
from follow.operator.page.door import PageAddress, new_token, parse_page_address, read_token
from follow.operator.page.exchange import Exchange
from follow.operator.terminal import Terminal
from follow.safety.limits import Limits
from follow.selection import KeptStandoff
from racf.commandline import UsageError, plain

NEEDS = ("starlette", "uvicorn", "websockets")


@dataclass(frozen=True, slots=True)
class PageOptions:
    """The page's address, and its token (empty: not needed)."""

    address: PageAddress
    token: str


def page_options(page: str | None, token_file: Path | None) -> PageOptions | None:
    """The options of the command line; None without a page.  Raises UsageError."""
    if page is None:
        if token_file is not None:
            raise UsageError("--page-token needs --page HOST:PORT")
        return None
    if missing := [name for name in NEEDS if find_spec(name) is None]:
        raise UsageError(f"--page needs {', '.join(missing)}: pip install '.[page]' in the clone")
    try:
        address = parse_page_address(page)
        token = "" if token_file is None else read_token(token_file)
    except (OSError, ValueError) as error:
        raise UsageError(plain(error) if isinstance(error, OSError) else str(error)) from None
    return PageOptions(address, token or ("" if address.is_local else new_token()))


@contextlib.contextmanager
def open_page(
    options: PageOptions | None, out: Path, terminal: Terminal, token_file: Path | None = None
) -> Generator[Exchange | None, None, None]:
    """The page, from the start of the program to its end; None without one.  Raises OSError if it cannot listen."""
    if options is None:
        yield None
        return
    from follow.operator.page.server import PageServer  # noqa: PLC0415 - the extra `page`, which other flights do without

    exchange = Exchange()
    with PageServer(options.address, options.token, exchange, out, terminal.report):
        terminal.listeners.append(exchange.say)
        shown = "" if token_file is not None else options.token  # a token from a file is not printed
        rest = f" with ?token= and what {token_file} holds" if token_file is not None else ""
        urls = options.address.urls(shown)
        for url in urls:
            terminal.report(f"page: {url}{rest}")
        if not urls:
            there = replace(options.address, host="ADDRESS").urls(shown)[0]
            terminal.report(f"page: {there}{rest}, with this machine's ADDRESS once it is in a network")
        yield exchange


@contextlib.contextmanager
def desk_of(
    exchange: Exchange,
    consoles: Consoles,
    out: Path,
    *,
    is_dry: bool = False,
    charge: Callable[[], int | None] = lambda: None,
) -> Generator[PageDesk, None, None]:
    """The loop's side of the page while a flight is flown; `is_dry`: FOLLOW is only pretended."""
    desk = PageDesk(consoles, exchange, out.resolve().name, "(DRY RUN)" if is_dry else "", charge)
    try:
        yield desk
    finally:
        desk.close()


def consoles_of(operator: Operator, tracker: Selector, report: Notify, servo: Servo, limits: Limits) -> Consoles:
    """The consoles of a flight."""
    config = servo.settings
    consoles = Consoles(operator, tracker.choose, report, config.standoff_m, set_mode=config.mode.value)
    consoles.nearest, consoles.kept = nearest(servo, limits), lambda: servo.kept
    consoles.is_looking, tracker.decided = lambda: tracker.is_looking, consoles.decided
    return consoles


def nearest(servo: Servo, limits: Limits) -> KeptStandoff:
    """The least stand-off to which a person may trim, and what forbids a smaller one."""
    by_image = KeptStandoff(servo.nearest_m(), "nearer, its feet leave the image")
    by_limit = KeptStandoff(limits.min_standoff_m, f"limits.min_standoff_m {limits.min_standoff_m:g}")
    return max(by_image, by_limit, key=lambda kept: kept.standoff_m)
