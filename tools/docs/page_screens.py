"""Fly `follow sim walker --page` as a person would, in headless Chromium, check what happens, and draw docs/page.jpg.

    python -m tools.docs.page_screens [--chromium /usr/bin/chromium] [--out DIR]

Needs Playwright (`pip install playwright`, in any environment that also holds this project's requirements) and a
Chromium (`apt install chromium`).  A desktop window and a phone's are open: the image updates, a dragged box selects,
the phone only watches, FOLLOW flies, CONFIRM is demanded for an old box, STOP on the phone stops, floods of taps are
sent, and at last the page's thread dies while the vehicle follows.  Exits 1 at the first thing that is not so.
"""

import argparse
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2

from tests.support.page_killer import flown_last

DOCS = Path(__file__).parents[2] / "docs"
PHONE = {"viewport": {"width": 360, "height": 640}, "device_scale_factor": 2.0, "has_touch": True, "is_mobile": True}
WITHOUT_S = 6.0  # flown on without the page
DESKTOP = {"viewport": {"width": 1280, "height": 800}}


def until(what: str, is_so: Callable[[], bool], seconds: float = 20.0) -> None:
    """Wait until something is so; exits if it does not come."""
    end_s = time.monotonic() + seconds
    while not is_so():
        if time.monotonic() > end_s:
            sys.exit(f"not within {seconds:g} s: {what}")
        time.sleep(0.05)
    print(f"ok: {what}", flush=True)


def state(page: Any) -> str:
    return page.inner_text("#state")


def shown(page: Any) -> int:
    return int(page.evaluate("shownFrame"))


FIND_WALKER = """() => {  // left, top, right, bottom of the blue shirt in fractions of the image that is shown now
  const canvas = document.getElementById("image"), [w, h] = [canvas.width, canvas.height];
  const data = canvas.getContext("2d").getImageData(0, 0, w, h).data, xs = [], ys = [];
  for (let n = 0; n < w * h; n++) {
    const [red, green, blue] = data.subarray(4 * n, 4 * n + 3);
    if (blue > red + 60 && blue > green + 40) { xs.push(n % w); ys.push(Math.floor(n / w)); }
  }
  const at = (values, part) => values.sort((a, b) => a - b)[Math.floor(part * (values.length - 1))];
  return xs.length < 20 ? null : [at(xs, .02) / w, at(ys, .02) / h, at(xs, .98) / w, at(ys, .98) / h];
}"""


FLOOD = """async seconds => {  // 1000 taps a second, all over the image
  for (const end = performance.now() + 1000 * seconds; performance.now() < end;) {
    for (let n = 0; n < 20; n++) send({ do: "select", frame: shownFrame, box: [Math.random(), Math.random(), 0, 0] });
    await new Promise(go => setTimeout(go, 20));
  }
}"""


def walkers_box(page: Any) -> tuple[float, float, float, float]:
    """Left, top, right, bottom of the walker by its shirt, in the window's pixels."""
    area, (left, top, right, bottom) = page.locator("#over").bounding_box(), page.evaluate(FIND_WALKER)
    high = bottom - top
    box = left - 0.003, top - 0.35 * high, right + 0.003, bottom + 1.25 * high
    x, y, w, h = (area[name] for name in ("x", "y", "width", "height"))
    return x + box[0] * w, y + box[1] * h, x + box[2] * w, y + box[3] * h


def is_on_walker(page: Any) -> bool:
    """Whether the shirt's middle lies in the box that the page draws."""
    shirt, box = page.evaluate(FIND_WALKER), page.evaluate("tracked")
    if shirt is None or box is None:
        return False
    x, y = (shirt[0] + shirt[2]) / 2, (shirt[1] + shirt[3]) / 2
    return bool(box[0] < x < box[0] + box[2] and box[1] < y < box[1] + box[3])


def top(page: Any, name: str) -> float:
    """The element's upper edge in the window's pixels."""
    return float(page.locator(name).bounding_box()["y"])


def bottom(page: Any, name: str) -> float:
    """The element's lower edge in the window's pixels."""
    return top(page, name) + float(page.locator(name).bounding_box()["height"])


def drag(page: Any) -> None:
    """Draw a box around the walker with the mouse."""
    left, top, right, bottom = walkers_box(page)
    page.mouse.move(left, top)
    page.mouse.down()
    page.mouse.move((left + right) / 2, (top + bottom) / 2, steps=3)
    page.mouse.move(right, bottom, steps=3)
    page.mouse.up()


def fly(desk: Any, phone: Any, shots: Path) -> None:
    """The whole test, with a screenshot at each stage."""
    until("the desktop shows images", lambda: shown(desk) > 5)
    until("the phone shows images", lambda: shown(phone) > 5)
    wide = phone.evaluate("document.documentElement.scrollWidth")
    until(f"the phone's page is no wider than the phone ({wide} px)", lambda: wide <= 360, 0.0)
    desk.screenshot(path=shots / "start.png")
    before = shown(desk)
    until("the image updates", lambda: shown(desk) > before + 20)
    drag(desk)
    until("a dragged box selects", lambda: state(desk) == "TRACKING")
    desk.screenshot(path=shots / "tracking.png")
    desk.click("#follow")
    until("FOLLOW flies", lambda: state(desk) == "FOLLOWING")
    until("the second window only watches", lambda: phone.is_disabled("#follow") and phone.is_enabled("#stop"))
    time.sleep(6.0)
    until("the box is on the walker", lambda: is_on_walker(desk), 1.0)
    desk.screenshot(path=shots / "following.png")
    phone.screenshot(path=shots / "phone_watches.png")
    phone.tap("#stop")
    until("STOP on the phone stops", lambda: state(desk) == "STOPPED", 3.0)
    desk.click("#hand-over")
    until("the command is handed over", lambda: phone.is_enabled("#follow"))
    time.sleep(14.0)  # longer than a drawn box counts as just drawn; the pilot has brought the vehicle back
    until("the walker is found again", lambda: is_on_walker(phone))
    phone.tap("#follow")
    until("an old box must be confirmed", lambda: phone.is_visible("#confirm"))
    time.sleep(0.3)
    until("CONFIRM is in sight above STOP", lambda: bottom(phone, "#confirm") <= top(phone, "#stopbar"), 1.0)
    phone.screenshot(path=shots / "phone_confirm.png")
    phone.tap("#confirm")
    until("CONFIRM flies", lambda: state(phone) == "FOLLOWING")
    until("now the desktop watches", lambda: desk.is_disabled("#follow"))
    time.sleep(6.0)
    phone.screenshot(path=shots / "phone_follows.png")
    phone.screenshot(path=shots / "phone_whole.png", full_page=True)
    desk.evaluate(FLOOD, 3.0)
    until("a flood of taps in a window that watches changes nothing", lambda: state(phone) == "FOLLOWING", 0.0)
    until("the box is still on the walker", lambda: is_on_walker(phone), 1.0)
    desk.keyboard.press("Escape")
    until("Esc stops", lambda: state(phone) == "STOPPED", 3.0)
    time.sleep(12.0)  # the pilot has brought the vehicle back
    phone.evaluate(FLOOD, 3.0)
    phone.tap("#stop")
    until("STOP acts behind a flood of taps of its own window", lambda: state(phone) == "STOPPED", 3.0)


def end_the_page(desk: Any, phone: Any, flight: subprocess.Popen[str], shots: Path) -> None:
    """Follow, and make the page's thread raise: the flight must go on."""
    phone.click("#hand-over")
    drag(desk)
    until("the desktop selects again", lambda: desk.inner_text("#reply") == "target selected")
    desk.click("#follow")
    until("it follows", lambda: state(desk) == "FOLLOWING")
    time.sleep(2.0)
    flight.send_signal(signal.SIGUSR2)
    until("the windows show that the page is gone", lambda: state(desk) == state(phone) == "NO CONNECTION", 10.0)
    desk.screenshot(path=shots / "no_connection.png")
    time.sleep(WITHOUT_S)


def as_it_was(folder: Path) -> None:
    """The flight's rows: it flew on without the page, and sent in every round, until the program was ended."""
    modes, sent = flown_last(folder, WITHOUT_S / 2)  # a loaded machine flies slower than the clock
    until(f"it flew on without the page {sorted(modes)}", lambda: sent and modes <= {"follow", "coast", "brake"}, 0.0)


def sheet(shots: Path) -> None:
    """The desktop and two phones beside each other."""
    height = 760
    parts = []
    for name in ("following", "phone_confirm", "phone_follows"):
        image = cv2.imread(str(shots / f"{name}.png"))
        width = round(image.shape[1] * height / image.shape[0])
        framed = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
        parts += [cv2.copyMakeBorder(framed, 8, 8, 8, 8, cv2.BORDER_CONSTANT, value=(90, 90, 90))]
    cv2.imwrite(str(DOCS / "page.jpg"), cv2.hconcat(parts), (cv2.IMWRITE_JPEG_QUALITY, 85))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--chromium", default="/usr/bin/chromium")
    parser.add_argument("--address", default="127.0.0.1:8088")
    parser.add_argument("--out", type=Path, default=Path("out/page"))
    options = parser.parse_args()
    from playwright.sync_api import sync_playwright  # noqa: PLC0415 - the help does without it

    options.out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        words = [
            sys.executable,
            "-m",
            "tests.support.page_killer",
            "sim",
            "walker",
            "--page",
            options.address,
            "--out",
            f"{folder}/now",
        ]
        flight = subprocess.Popen(words, stdin=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        try:
            url = next(found[1] for line in flight.stderr or () if (found := re.search(r"page: (\S+)", line)))
            with sync_playwright() as play:
                browser = play.chromium.launch(executable_path=options.chromium, args=["--no-sandbox"])
                desk, phone = browser.new_page(**DESKTOP), browser.new_page(**PHONE)
                wrong: list[str] = []
                for page in (desk, phone):
                    page.on("pageerror", lambda error: wrong.append(str(error)))
                    page.goto(url)
                fly(desk, phone, options.out)
                end_the_page(desk, phone, flight, options.out)
                browser.close()
                until(f"no error in the page {wrong}", lambda: not wrong, 0.0)
        finally:
            flight.send_signal(signal.SIGTERM)
            _, said = flight.communicate(timeout=60.0)
        until("the program says that the page has ended", lambda: "the page has ended" in said, 0.0)
        as_it_was(Path(folder) / "now")
    sheet(options.out)
    return flight.returncode


if __name__ == "__main__":
    sys.exit(main())
