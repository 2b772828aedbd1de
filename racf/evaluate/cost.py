"""The cost of a frame: its share of a camera's time, processor cycles, and the least operations and bytes it needs.

Cycles over its clock are a first guess for another processor of the same kind: they do not carry over to one that does
more or fewer operations a cycle.  No processor is faster than the bytes over its memory's or cache's bandwidth.
"""

from pathlib import Path
from statistics import median

from racf.box import Box
from racf.evaluate import roofline
from racf.evaluate.figures import BenchFigures, CostFigures
from racf.evaluate.report import Table
from racf.params import Params

CAMERA_HZ = 30.0


def clock_hz() -> float | None:
    """The processor's clock as the system reports it; None where it does not."""
    highest = Path("/sys/devices/system/cpu/cpu0/cpufreq/cpuinfo_max_freq")
    if highest.is_file():
        return 1e3 * float(highest.read_text())
    cpus = Path("/proc/cpuinfo")
    lines = cpus.read_text().splitlines() if cpus.is_file() else []
    return next((1e6 * float(line.partition(":")[2]) for line in lines if line.startswith("cpu MHz")), None)


def cost_of(params: Params, fps: float, targets: list[Box]) -> CostFigures:
    """The cost of a frame at these frames per second: median over the targets of the least operations and bytes."""
    works = [roofline.work_of_stages(params, target) for target in targets]
    figures: CostFigures = {
        "share_of_30hz_percent": round(100 * CAMERA_HZ / fps, 2),
        "least_megaflops": round(median(sum(w.flops for w in work.values()) for work in works) / 1e6, 2),
        "least_megabytes": round(median(sum(w.moved_bytes for w in work.values()) for work in works) / 1e6, 2),
    }
    if (clock := clock_hz()) is not None:
        figures["megacycles"] = round(clock / fps / 1e6, 2)
    return figures


def cost_table(figures: BenchFigures) -> Table:
    """The same for the screen."""
    rows: list[tuple[str, ...]] = []
    for label, of in figures["tracker"].items():
        cost = of.get("cost")
        if cost is not None:
            cycles = f"{cost['megacycles']:.1f}" if "megacycles" in cost else "-"
            least = f"{cost['least_megaflops']:.1f}", f"{cost['least_megabytes']:.1f}"
            rows.append((label, f"{1000 / of['fps']:.2f}", f"{cost['share_of_30hz_percent']:.0f} %", cycles, *least))
    header = ("tracker", "ms", "share of a 30 Hz frame", "million cycles", "least Mflop", "least MB moved")
    return Table("A frame's cost", header, tuple(rows))
