"""Fly `follow sim walker --page` as a person would, in headless Chromium, check what happens, and draw docs/page.jpg.

    python -m tools.docs.page_screens [--chromium /usr/bin/chromium] [--out DIR]

Needs Playwright (`pip install playwright`, in any environment that also holds this project's requirements) and a
Chromium (`apt install chromium`).  A desktop window and a phone's are open: the image updates, a dragged box selects,
the phone only watches, FOLLOW flies, CONFIRM is demanded for an old box, STOP on the phone stops.  Exits 1 at the first
thing that is not so.
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
import numpy as np

DOCS = Path(__file__).parents[2] / "docs"
PHONE = {"viewport": {"width": 360, "height": 740}, "device_scale_factor": 2.0, "has_touch": True, "is_mobile": True}
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


def walkers_box(page: Any) -> tuple[float, float, float, float]:
    """Left, top, right, bottom of the walker by its blue shirt, in the window's pixels."""
    area = page.locator("#view").bounding_box()
    image = cv2.imdecode(np.frombuffer(page.locator("#view").screenshot(), np.uint8), cv2.IMREAD_COLOR).astype(int)
    rows, columns = np.nonzero((image[..., 0] > image[..., 2] + 60) & (image[..., 0] > image[..., 1] + 40))
    left, right = np.percentile(columns, (2, 98))
    top, bottom = np.percentile(rows, (2, 98))
    scale, high = area["width"] / image.shape[1], bottom - top
    box = np.array([left - 3, top - 0.4 * high, right + 3, bottom + 1.35 * high]) * scale
    return tuple(float(v) for v in box + np.array([area["x"], area["y"]] * 2))


def drag(page: Any) -> None:
    """Draw a box around the walker with the mouse."""
    left, top, right, bottom = walkers_box(page)
    page.mouse.move(left, top)
    page.mouse.down()
    page.mouse.move((left + right) / 2, (top + bottom) / 2, steps=3)
    page.mouse.move(right, bottom, steps=3)
    page.mouse.up()


def fly(desk: Any, phone: Any, shots: Path) -> None:
    """The whole walk, with a screenshot at each station."""
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
    desk.screenshot(path=shots / "following.png")
    phone.screenshot(path=shots / "phone_watches.png")
    phone.tap("#stop")
    until("STOP on the phone stops", lambda: state(desk) == "STOPPED", 3.0)
    desk.click("#hand-over")
    until("the command is handed over", lambda: phone.is_enabled("#follow"))
    time.sleep(10.5)  # longer than a drawn box counts as just drawn
    phone.tap("#follow")
    until("an old box must be confirmed", lambda: phone.is_visible("#confirm"))
    time.sleep(0.3)
    phone.screenshot(path=shots / "phone_confirm.png")
    phone.tap("#confirm")
    until("CONFIRM flies", lambda: state(phone) == "FOLLOWING")
    until("now the desktop watches", lambda: desk.is_disabled("#follow"))
    time.sleep(6.0)
    phone.screenshot(path=shots / "phone_follows.png")
    phone.screenshot(path=shots / "phone_whole.png", full_page=True)
    desk.keyboard.press("Escape")
    until("Esc stops", lambda: state(phone) == "STOPPED", 3.0)


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
    parser.add_argument("--follow", default=str(Path(sys.executable).with_name("follow")), help="the program `follow`")
    parser.add_argument("--address", default="127.0.0.1:8088")
    parser.add_argument("--out", type=Path, default=Path("out/page"))
    options = parser.parse_args()
    from playwright.sync_api import sync_playwright  # noqa: PLC0415 - the help does without it

    options.out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        words = [options.follow, "sim", "walker", "--page", options.address, "--out", f"{folder}/now"]
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
                browser.close()
                until(f"no error in the page {wrong}", lambda: not wrong, 0.0)
        finally:
            flight.send_signal(signal.SIGTERM)
            flight.communicate(timeout=60.0)
    sheet(options.out)
    return flight.returncode


if __name__ == "__main__":
    sys.exit(main())
