"""The paper's tables 2 to 5 as commands: which trackers they need, and how their results are laid out.

Table 2: precision and speed.  Table 3: success over ADMM iterations for three trackers.  Table 4: success over the
residue's weight and ADMM iterations.  Table 5: the components, and the scale refinement on other trackers.
All are over every start of a sequence, nominal and jittered.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from racf.evaluate import plots
from racf.evaluate.metrics import interval_of_mean, mean_score
from racf.evaluate.report import Report, ResultRow, Table
from racf.evaluate.trackers import opencv_has

ITERATIONS = (1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 15, 20, 25)  # the columns of Table 3 [Paper]
ETAS = (0.2, 0.4, 0.6, 0.8, 1.0, 1.2, 1.4, 1.6)  # the columns of Table 4 [Paper]
CONVERGING = ("bacf", "arcf-hc", "racf--")  # the rows of Table 3 [Paper]
WITHOUT = {"racf": "racf-", "racf-": "racf--"}  # a row of Table 5: the same without its component (`X,refine`: `X`)


@dataclass(frozen=True, slots=True)
class Sweep:
    """The values that tables 3 and 4 vary."""

    iterations: tuple[int, ...] = ITERATIONS
    etas: tuple[float, ...] = ETAS


def trackers_of(table: int, grid: Sweep) -> tuple[str, ...]:
    """The trackers whose results a table shows."""
    if table == 2:
        return ("racf", "racf-", "racf--", "bacf", "arcf-hc", *(peer for peer in ("csrt", "kcf") if opencv_has(peer)))
    if table == 3:
        return tuple(_iterated(name, n) for name in CONVERGING for n in grid.iterations)
    if table == 4:
        return tuple(_weighted(eta, n) for n in grid.iterations for eta in grid.etas)
    peer = "csrt" if opencv_has("csrt") else "mil"
    refined = (text for name in ("bacf", "arcf-hc", peer) for text in (name, f"{name},refine"))
    return (*refined, "racf--", "racf-", "racf")


def lay_out(table: int, report: Report, grid: Sweep) -> Table:
    """A table of the paper from a report on its trackers."""
    layouts: dict[int, Callable[[], Table]] = {
        2: lambda: _speed_and_precision(report),
        3: lambda: _over_iterations(report, grid),
        4: lambda: _over_weights(report, grid),
        5: lambda: _components(report),
    }
    return layouts[table]()


def draw(table: int | None, report: Report, grid: Sweep, folder: Path) -> list[Path]:
    """Tables 3 and 4 as a figure: success over iterations, a line for each tracker or weight."""
    if table == 3:
        lines = {name: [_auc(report, _iterated(name, n)) for n in grid.iterations] for name in CONVERGING}
    elif table == 4:
        lines = {f"eta {eta:g}": [_auc(report, _weighted(eta, n)) for n in grid.iterations] for eta in grid.etas}
    else:
        return []
    return plots.draw_lines(lines, list(grid.iterations), ("ADMM iterations", "AUC (%)"), folder / f"table{table}")


def _iterated(name: str, iterations: int) -> str:
    return f"{name},admm_iterations={iterations}"


def _weighted(eta: float, iterations: int) -> str:
    return f"racf--,residue={eta:g},admm_iterations={iterations}"


def _row(report: Report, label: str) -> ResultRow:
    return next(row for row in report.rows if row.label == label)


def _auc(report: Report, label: str) -> float:
    """Over all starts, nominal and jittered: whether one start survives an occlusion moves a mean of few sequences."""
    return _over_sequences(_row(report, label), report.counted)[0]


def _speed_and_precision(report: Report) -> Table:
    rows: list[tuple[str, ...]] = []
    for row in report.rows:
        by_benchmark = [_over_sequences(row, report.names(b))[1] for b in report.benchmarks()]
        fps = [row.fps[name] for name in report.counted if name in row.fps]
        cells = [f"{float(np.mean(by_benchmark)):.1f}", f"{float(np.mean(fps)):.1f}" if fps else "-"]
        every = _over_sequences(row, report.counted)[1]
        rows.append((row.label, *cells, *(f"{value:.1f}" for value in (*by_benchmark, every))))
    header = ("tracker", "precision, mean of benchmarks", "fps", *report.benchmarks(), "all sequences")
    return Table("Table 2: precision at 20 px (percent) and speed", header, tuple(rows))


def _over_iterations(report: Report, grid: Sweep) -> Table:
    rows = [(name, *_best_marked([_auc(report, _iterated(name, n)) for n in grid.iterations])) for name in CONVERGING]
    title = "Table 3: AUC (percent) over ADMM iterations, best of each tracker in bold"
    return Table(title, ("tracker", *map(str, grid.iterations)), tuple(rows))


def _over_weights(report: Report, grid: Sweep) -> Table:
    columns = [_best_marked([_auc(report, _weighted(eta, n)) for n in grid.iterations]) for eta in grid.etas]
    rows = [(str(n), *(column[i] for column in columns)) for i, n in enumerate(grid.iterations)]
    title = "Table 4: AUC (percent) of racf-- over ADMM iterations (rows) and eta (columns), best of each eta in bold"
    return Table(title, ("iterations", *(f"{eta:g}" for eta in grid.etas)), tuple(rows))


def _components(report: Report) -> Table:
    rows: list[tuple[str, ...]] = []
    for row in report.rows:
        pairs = [_over_sequences(row, report.names(b)) for b in report.benchmarks()]
        pairs.append((float(np.mean([p[0] for p in pairs])), float(np.mean([p[1] for p in pairs]))))
        pairs.append(_over_sequences(row, report.counted))
        rows.append((row.label, *(f"{auc:.1f} / {precision:.1f}" for auc, precision in pairs), _gain(report, row)))
    title = "Table 5: AUC / precision (percent) of the components; `refine` adds the scale refinement"
    header = ("tracker", *report.benchmarks(), "mean of benchmarks", "all sequences", "gain over all sequences, 95 %")
    return Table(title, header, tuple(rows))


def _gain(report: Report, row: ResultRow) -> str:
    """The effect of a component: a row minus the same tracker without it, paired by sequence; empty without one."""
    without = row.label.removesuffix(",refine") if row.label.endswith(",refine") else WITHOUT.get(row.label)
    if without not in {other.label for other in report.rows}:
        return ""
    base = _row(report, without)
    pairs = [(_of_sequence(row, name), _of_sequence(base, name)) for name in report.counted]
    gains = np.array([np.subtract(ours, theirs) for ours, theirs in pairs])
    ends = [interval_of_mean(column.tolist()) for column in gains.T]
    cells = (
        f"{mean:+.1f} ({low:+.1f}..{high:+.1f})" for mean, (low, high) in zip(gains.mean(axis=0), ends, strict=True)
    )
    return f"over `{without}`: {' / '.join(cells)}"


def _of_sequence(row: ResultRow, name: str) -> tuple[float, float]:
    """AUC and precision of one sequence, the mean over its starts."""
    mean = mean_score([judged.toolkit for judged in (row.nominal[name], *row.jittered.get(name, ()))])
    return mean.auc, mean.precision_20px


def _over_sequences(row: ResultRow, names: Iterable[str]) -> tuple[float, float]:
    """AUC and precision over these sequences, each counting alike however many starts it has."""
    auc, precision = np.mean([_of_sequence(row, name) for name in names], axis=0)
    return float(auc), float(precision)


def _best_marked(values: list[float]) -> tuple[str, ...]:
    return tuple(f"**{value:.2f}**" if value == max(values) else f"{value:.2f}" for value in values)
