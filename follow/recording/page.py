"""One self-contained HTML page: sections with tables and plots, no external files."""

import html
import io
import re
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; margin: 2em auto; max-width: 70em; padding: 0 1em; color: #222; }
h1 { font-size: 1.5em; } h2 { font-size: 1.15em; margin-top: 2em; border-bottom: 1px solid #ccc; }
table { border-collapse: collapse; } td, th { padding: .15em .8em .15em 0; text-align: left; vertical-align: top; }
th { font-weight: 600; border-bottom: 1px solid #ccc; } td.n { text-align: right; font-variant-numeric: tabular-nums; }
tr:nth-child(even) td { background: #f6f6f6; } svg { width: 100%; height: auto; } pre { font-size: .9em; }
.dot { display: inline-block; width: .8em; height: .8em; border-radius: 50%; margin-right: .4em; }
.lead { font-size: 1.1em; }
"""
Cell = str | float | int


class Page:
    """Gathers sections; `text` is the whole page."""

    def __init__(self, title: str, lead: str = "") -> None:
        self._title = title
        self._parts = [f"<h1>{html.escape(title)}</h1>"]
        if lead:
            self._parts.append(f'<p class="lead">{html.escape(lead)}</p>')

    def section(self, heading: str) -> None:
        """Begin a section."""
        self._parts.append(f"<h2>{html.escape(heading)}</h2>")

    def say(self, text: str) -> None:
        """Add a paragraph."""
        self._parts.append(f"<p>{html.escape(text)}</p>")

    def table(self, head: Sequence[str], rows: Iterable[Sequence[Cell]], dots: Sequence[str] = ()) -> None:
        """Add a table; numbers are aligned right; `dots` are the CSS colours of a dot before each row's first cell."""
        lines = ["<table><tr>" + "".join(f"<th>{html.escape(name)}</th>" for name in head) + "</tr>"]
        for n, row in enumerate(rows):
            dot = f'<span class="dot" style="background:{dots[n]}"></span>' if n < len(dots) else ""
            lines.append("<tr>" + "".join(_cell(cell, "" if k else dot) for k, cell in enumerate(row)) + "</tr>")
        self._parts.append("".join(lines) + "</table>")

    def plot(self, figure: "Figure") -> None:
        """Add a plot, as inline SVG."""
        import matplotlib as mpl  # noqa: PLC0415 - half a second that a flight does not need

        text = io.StringIO()
        with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": "page"}):
            figure.savefig(text, format="svg", metadata={"Date": None}, bbox_inches="tight")
        svg = text.getvalue()
        self._parts.append(re.sub(r"<metadata>.*?</metadata>", "", svg[svg.index("<svg") :], flags=re.DOTALL))

    def fold(self, summary: str, text: str) -> None:
        """Add a text that unfolds on a click."""
        self._parts.append(
            f"<details><summary>{html.escape(summary)}</summary><pre>{html.escape(text)}</pre></details>"
        )

    @property
    def text(self) -> str:
        """The page."""
        head = f'<meta charset="utf-8"><title>{html.escape(self._title)}</title><style>{STYLE}</style>'
        return f"<!doctype html><html><head>{head}</head><body>\n" + "\n".join(self._parts) + "\n</body></html>\n"


def _cell(value: Cell, before: str) -> str:
    if isinstance(value, str):
        return f"<td>{before}{html.escape(value)}</td>"
    shown = f"{value:d}" if isinstance(value, int) else f"{value:.4g}"
    return f'<td class="n">{before}{shown}</td>'
