"""`follow refly`: runs a recorded flight through estimate, servo and gate again, and compares both."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import chain
from pathlib import Path

from follow.cli.commands import ReflyCommand
from follow.cli.layers import flown_with
from follow.cli.named import require_encoder
from follow.cli.settings import as_toml, layered
from follow.config import Config
from follow.control.footage import FootageTarget
from follow.control.servo import Servo
from follow.control.target import Target
from follow.flight.live_flight import ramping_down
from follow.flight.session import conclude, fly, keep_flight, kept_geometry
from follow.loop import follow
from follow.messages import Tick
from follow.operator.terminal import Terminal
from follow.recording.comparison import Difference, write_comparison
from follow.recording.exact import ExactFlight, digest, read_exact
from follow.recording.flight_table import FlightTable, setting_values
from follow.recording.folder import claimed, require_folder
from follow.recording.recorder import Recorder
from follow.recording.refly import RecordedFlight, RecordedMeter, RecordedTracker
from follow.recording.summary import Figures
from follow.safety.gate import Safety
from follow.safety.limits import LONG_S, NEVER_S
from racf.commandline import UsageError

NOT_FLOWN = (
    "other settings: the recorded vehicle did not fly what is sent now, so nothing ends because it does not obey or "
    "does not reach its target"
)


def refly(command: ReflyCommand) -> None:
    """`follow refly`.  Raises ValueError if the recorded settings do not give the recorded outcome."""
    out = command.out or command.flight / "refly"
    if out.resolve() == command.flight.resolve():
        raise UsageError(f"--out {str(out)!r} is the recorded flight itself: give another folder")
    require_folder(out)
    if command.config.record.pictures:
        require_encoder("record.encoder", command.config.record.encoder)
    recorded = read_exact(command.flight / "messages.jsonl.gz")
    flown, was = as_toml(command.config), as_toml(layered(flown_with(command.flight)))
    refuse_another_camera(was, flown)
    same = without_record(flown) == without_record(was)
    config = command.config if same else unanswered(command.config)
    terminal = Terminal()
    with claimed(out):
        keep_flight(out, terminal)
        if not same:
            terminal.report(NOT_FLOWN)
        difference = Difference(len(recorded.rounds))
        setup = replace(recorded.setup, settings=as_toml(config))
        clock = None if recorded.unix_s is None else lambda: recorded.unix_s or 0.0
        record = Recorder(
            out,
            command.config.record,
            terminal.report,
            waits=True,
            about=f"{recorded.setup.about}\n\nflown again from {command.flight}",
            clock=clock,
            desired=kept_geometry(command.config.servo, recorded.setup.down_rad),
            setup=setup,
        )
        with record as recorder:
            terminal.listeners.append(recorder.message)
            recorder.settings(flown, command.config.camera.calibration)
            flight = RecordedFlight(recorded.rounds)
            ticks = terminal.progress(
                compared(again(recorded, flight, config), recorded, difference), flight.left, "refly"
            )
            finished = fly(ticks, recorder, terminal.report, lambda _tick: flight.truth(), is_ordered=False)
            figures = recorder.close(Figures(refly_differs=difference.rounds))
        terminal.report(difference.sentence(same=same))
        compare_pages(command.flight, out, difference, settings_changed(was, flown), terminal, same=same)
    conclude(figures, out, terminal, as_json=command.json, finished=finished, failure=recorder.failure)
    if same and difference.rounds:
        raise ValueError(f"the recorded settings do not give the recorded outcome: {difference.sentence(same=True)}")


def unanswered(config: Config) -> Config:
    """The settings without the checks of the vehicle's response to setpoints: a recorded vehicle does not respond."""
    return replace(config, limits=replace(config.limits, disobey_after_s=NEVER_S, out_of_reach_s=LONG_S))


def compare_pages(
    flight: Path,
    out: Path,
    difference: Difference,
    changed: dict[str, tuple[str, str]],
    terminal: Terminal,
    *,
    same: bool,
) -> None:
    """Write `refly.html`, or report why not: it needs `ticks.csv`, which the refly itself does not."""
    try:
        rows = len(FlightTable(flight).t_s)
        if rows > difference.total:
            terminal.report(f"messages.jsonl.gz holds {difference.total} of {rows} rounds; the rest is not flown again")
        write_comparison(flight, out, difference.sentence(same=same), changed)
    except ValueError as error:
        terminal.report(f"refly.html is not written: {error}")


def again(recorded: ExactFlight, flight: RecordedFlight, config: Config) -> Iterator[Tick]:
    """The rounds of the recorded flight through the loop, and those after the order to leave through the ramp."""
    setup = recorded.setup
    target = Target(setup.lens, setup.down_rad, config.target)
    flight.forget = target.forget
    moves_view = setup.moves_view
    estimator = target if moves_view is None else FootageTarget(target, moves_view=moves_view)
    servo, safety = Servo(setup.down_rad, config.servo), Safety(config.limits)
    tracker, meter = RecordedTracker(flight), RecordedMeter(flight)
    loop = follow(flight, flight, tracker, estimator, servo, safety, flight.instruct, meter)
    return chain(loop, leaving(flight, safety))


def leaving(flight: RecordedFlight, safety: Safety) -> Iterator[Tick]:
    """The rounds from the order to leave on, if there are any."""
    if flight.left:
        why = flight.rounds[flight.flown].instruction.reason
        yield from ramping_down(flight, safety, why, rounds=flight.left)


def compared(ticks: Iterator[Tick], recorded: ExactFlight, difference: Difference) -> Iterator[Tick]:
    """Pass the ticks on, comparing each with the recorded outcome of its round.

    Their stage times omit the tracker, which did not run.
    """
    for tick, was in zip(ticks, recorded.rounds, strict=False):
        difference.add(tick.state.t_s - recorded.rounds[0].state.t_s, equal=digest(tick) == was.outcome)
        yield replace(tick, stage_ms={name: ms for name, ms in tick.stage_ms.items() if name != "tracker"})


def refuse_another_camera(before: str, after: str) -> None:
    """Raise UsageError for a changed camera setting: the frames were taken with the recorded camera."""
    changed = [name for name in settings_changed(before, after) if name.startswith("camera.")]
    if changed:
        raise UsageError(f"{changed[0]} cannot be changed: a recorded flight has its camera's frames behind it")


def without_record(toml: str) -> dict[str, str]:
    """Settings by dotted name, without those of the recording, which change no outcome."""
    return {name: value for name, value in setting_values(toml).items() if not name.startswith("record.")}


def settings_changed(before: str, after: str) -> dict[str, tuple[str, str]]:
    """Dotted name -> both values, for each setting that differs."""
    old, new = without_record(before), without_record(after)
    return {name: (old.get(name, ""), new.get(name, "")) for name in {**old, **new} if old.get(name) != new.get(name)}
