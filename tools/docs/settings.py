"""Write docs/service/settings.toml and docs/limits.md from the settings and the sentences beside them in the code.

    python -m tools.docs.settings

A test checks that both files agree with the code.
"""

import math
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path

from follow.cli.described import sentences, summary, unit
from follow.cli.settings import literal
from follow.config import MOUNT_DEG, PRESETS, Config
from follow.safety.limits import LEAST, MAY_BE_ZERO, MOST, Limits

DOCS = Path(__file__).parents[2] / "docs"
HEAD = """\
# Install as /etc/follow-me.toml: `--settings /etc/follow-me.toml` for follow run, replay and sim.
#
# Each line that is not a comment counts as chosen: it overrides the scenario and --for, and an option of the command
# line overrides it (--limits.fence-m 100).  Lines that begin with # hold what follows from something else: from the
# camera, the drawn scene or the kind of target (--for car).  Remove the # to choose the value yourself.  All values are
# the defaults; those that a flight was flown with are in its folder, as settings.toml.
#
# Generated from the code by `python -m tools.docs.settings`.
"""
_LENS = Config().camera.intrinsics(640, 480)
DERIVED = {
    "camera.down_deg": MOUNT_DEG,
    "servo.top_rad": math.atan(_LENS.cy / _LENS.fy),
    "limits.half_view_rad": _LENS.horizontal_fov_rad / 2,
    "limits.latency_s": 0.0,
}
"""The derived settings for a camera at its defaults."""
BELOW = {f"{branch}.{name}" for layer in PRESETS.values() for branch, held in layer.items() for name in held}


def table(branch: object, path: str) -> Iterator[str]:
    """A branch of the settings and its sub-branches, as TOML with a sentence after each value."""
    texts = sentences(type(branch))
    values = {f.name: getattr(branch, f.name) for f in fields(branch)}
    leaves = {name: value for name, value in values.items() if not is_dataclass(value)}
    if leaves:
        yield f"\n[{path}]  # {summary(type(branch), whole=False)}"
    lines = {name: DERIVED.get(f"{path}.{name}", value) for name, value in leaves.items()}
    for name, value in lines.items():
        follows = f"{path}.{name}" in {*DERIVED, *BELOW}
        begin = f"{'#' * follows}{name} = {literal(value)}"
        yield f"{begin:<28}  # {': '.join(filter(None, (unit(name), texts[name])))}"
    for name, value in values.items():
        if name not in leaves:
            yield from table(value, f"{path}.{name}" if path else name)


def settings_file() -> str:
    """Every setting at its default, with its unit and its sentence."""
    return HEAD + "\n".join(table(Config(), "")) + "\n"


def limits_page() -> str:
    """Each limit with its default, its unit and its sentence."""
    lines = [
        "# Limits of the gate",
        "",
        "Generated from `follow/safety/limits.py` by `python -m tools.docs.settings`. On the command line: "
        "`--limits.speed-m-s 2`.",
        "",
        "A value beyond its largest is refused: it is usually one in another unit. A value below its least is refused: "
        "that of `floor_m` and `min_standoff_m` keeps the vehicle off ground and people.",
        "",
        "| limit | default | least | largest | meaning and source |",
        "|---|---|---|---|---|",
    ]
    defaults = Limits()
    for name, sentence in sentences(Limits).items():
        default = getattr(defaults, name)
        shown = "derived" if default is None else f"{default:g} {unit(name)}".strip()
        most = f"{MOST[name]:g}" if name in MOST else "any"
        least = f"{LEAST[name]:g}" if name in LEAST else "0" if name in MAY_BE_ZERO else "above 0"
        lines.append(f"| `{name}` | {shown} | {least} | {most} | {sentence} |")
    return "\n".join(lines) + "\n"


PAGES = {"service/settings.toml": settings_file, "limits.md": limits_page}

if __name__ == "__main__":
    for page, text in PAGES.items():
        (DOCS / page).write_text(text())
