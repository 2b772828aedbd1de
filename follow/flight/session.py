"""What replayed, simulated and real flights have in common around the loop."""

import json
import math
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray

from follow.control.acquire import Acquire
from follow.control.servo import STEEPEST_RAD, ServoConfig, ServoMode
from follow.messages import NO_INSTRUCTION, Cause, Instruction, Notify, Order, Reason, Tick
from follow.operator.mode_changes import ModeChanges
from follow.operator.terminal import Terminal, result
from follow.recording.folder import FILES, set_aside
from follow.recording.recorder import Recorder, RecordingError
from follow.recording.rows import Desired
from follow.recording.summary import Figures
from racf import Racf
from racf.box import Box
from racf.commandline import StopReported, UsageError
from racf.evaluate.own import load
from racf.evaluate.trackers import TrackerSpec
from racf.track import Track
from racf.tracker import warm_up

Start = Callable[[NDArray[np.uint8], Box], Track]
Update = Callable[[NDArray[np.uint8], Box | None], Track]


def require_tracker(name: str) -> None:
    """Raise UsageError for a name, a setting or a file that gives no tracker.

    One of the user's own is imported and not built, because that may take long or open something.
    """
    try:
        spec = TrackerSpec.parse(name).flown()
        _ = load(spec.name) if ":" in spec.name else spec.build()
    except ValueError as error:
        raise UsageError(f"--tracker: {error}") from None


def tracker_of(name: str) -> tuple[Start, Update]:
    """A warm tracker: how it learns a target, and how it finds it again.  Raises UsageError for an unknown name."""
    try:
        tracker = TrackerSpec.parse(name).flown().build()
    except ValueError as error:
        raise UsageError(f"--tracker: {error}") from None
    if isinstance(tracker, Racf):
        warm_up()
        return tracker.init, tracker.update
    return tracker.init, lambda image, _prior: tracker.update(image)


def acquire(name: str, box: Box) -> Acquire:
    """A warm tracker that starts on the box in the first frame.  Raises UsageError for an unknown name."""
    return Acquire(*tracker_of(name), box)


def once(order: Order) -> Callable[[], Instruction]:
    """An operator who gives one order, in the first round."""
    orders = iter((Instruction(order, Reason(Cause.FOLLOW_ORDERED, "the command line")),))
    return lambda: next(orders, NO_INSTRUCTION)


def keep_flight(out: Path, terminal: Terminal) -> None:
    """Move the recording in `out` aside, if there is one."""
    if moved := set_aside(out):
        terminal.report(f"the flight that was in {out} is now in {moved}")


def keep_other_flight(out: Path, flown: Figures, terminal: Terminal) -> None:
    """Move the recording in `out` aside, unless it is of the simulation that `flown` names: that can be flown again.

    A simulation in real time, which has a date, is always moved aside: a person may have commanded it.
    """
    try:
        before = cast(Mapping[str, object], json.loads((out / "summary.json").read_text(encoding="utf-8")))
        same = all(before.get(name) == value for name, value in flown.items()) and "started_utc" not in before
    except (OSError, ValueError, AttributeError):  # missing or incomplete
        same = False
    if not same or (out / "flight.tlog").exists():
        keep_flight(out, terminal)


def kept_geometry(servo: ServoConfig, down_rad: float) -> Desired:
    """The stand-off and the height above the target that the servo's mode keeps; the camera looks `down_rad` down.

    The target is in the middle row where height = stand-off x tan(angle below the nose).
    """
    if servo.mode not in (ServoMode.CHASE, ServoMode.ORBIT, ServoMode.PROFILE):
        return Desired()
    return Desired(servo.standoff_m, servo.standoff_m * math.tan(min(max(down_rad, 0.0), STEEPEST_RAD)))


def fly(
    ticks: Iterable[Tick],
    recorder: Recorder,
    report: Notify,
    truth: Callable[[Tick], Box | None],
    *,
    is_ordered: bool = True,
    start: Box | None = None,
) -> bool:
    """Record every tick and report every change of mode until the frames end.

    False if a person stopped it, or if FOLLOW `is_ordered` and never began; both are reported.  A box of `start` with
    too few pixels is reported even if the tracker does not find it.
    """
    changes, finished = ModeChanges(report), True
    if start is not None:
        changes.tell_tiny(start, 0.0)
    try:
        for tick in ticks:
            recorder.tick(tick, truth(tick))
            changes.see(tick)
    except KeyboardInterrupt:
        report("stopped: everything up to here is recorded")
        finished = False
    if line := changes.early_end():
        report(line)
    return finished and (changes.followed or not is_ordered)


def conclude(
    figures: Figures, out: Path, terminal: Terminal, *, as_json: bool, finished: bool, failure: str = ""
) -> None:
    """Print the figures and where the files are.

    Raises StopReported for a flight that is not `finished`, RecordingError with the `failure` of the recording.
    """
    terminal.flush()
    result(figures, as_json=as_json)
    files = [name for name in FILES if (out / name).exists() and (out / name).stat().st_size]
    look = f"; open it with: follow inspect {out}" if "flight.rrd" in files else ""
    terminal.report(f"recorded in {out}: {', '.join(files)}{look}")
    if not as_json:
        terminal.report("what each figure means: docs/after_a_flight.md, under Fields of summary.json")
    if failure:
        raise RecordingError(failure)
    if not finished:
        raise StopReported
