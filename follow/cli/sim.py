"""`follow sim`: the closed loop without a drone, one flight or all of them."""

import math
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, cast

from follow.cli.commands import SimCommand, lens_of
from follow.cli.detector import check_detector, simulated_detector
from follow.cli.ground import video_address
from follow.cli.height import height_report
from follow.cli.layers import from_scene, no_scenario
from follow.cli.named import require_encoder
from follow.cli.page import page_options
from follow.cli.settings import as_toml
from follow.config import CameraConfig, Config, resolve
from follow.control.image_motion import ImageMotionMeter
from follow.control.servo import Servo
from follow.control.target import Target
from follow.disk import OnceEach, unwritten
from follow.flight.session import acquire, conclude, fly, keep_other_flight, kept_geometry, once, require_tracker
from follow.loop import follow
from follow.messages import Autopilot, Order, Tick
from follow.operator.terminal import Terminal, result, table
from follow.recording.exact import Setup
from follow.recording.folder import claimed, require_folder
from follow.recording.recorder import Recorder, RecordingError
from follow.recording.summary import Figures
from follow.safety.gate import Safety
from racf.box import Box
from racf.parallel import each
from racf.threads import one_core
from sim.camera import CameraSettings, SceneCamera
from sim.plot import Strip, draw
from sim.scenarios import SCENARIOS, Scenario, build
from sim.score import FlightScore, ScoredTick, score

OUT = Path("out/sim")
SEEDS = 5  # of each scenario with --all, unless --seeds says otherwise


@dataclass(frozen=True, slots=True)
class FlightSpec:
    """One simulated flight."""

    scenario: str
    seed: int
    autopilot: Autopilot
    tracker: str
    config: Config
    out: Path
    drawn: CameraConfig | None = None  # the true camera if it differs from the settings: for tests of a wrong mount
    scene: frozenset[str] = frozenset()  # names of the settings that come from the scenario
    view: str | None = None  # the live viewer
    detector: Path | None = None  # the network's file

    @property
    def name(self) -> str:
        """The name of the flight's folder."""
        return f"{self.scenario}-{self.autopilot.value}-{self.seed}"


class Referee:
    """Records the ground truth of each round of a flight through a drawn scene, and scores the flight."""

    def __init__(self, camera: SceneCamera) -> None:
        self.camera = camera
        self.rows: list[ScoredTick] = []

    def box(self, tick: Tick) -> Box | None:
        """Note the round; the target's true box in its frame, None without a frame or behind the camera."""
        row = ScoredTick.of(tick, self.camera)
        self.rows.append(row)
        return None if row.truth is None else row.truth.box

    def flown(self) -> list[ScoredTick]:
        """The rounds from the first setpoint to the last."""
        sent = [k for k, row in enumerate(self.rows) if row.setpoint is not None]
        return self.rows[sent[0] : sent[-1] + 1] if sent else []

    def figures(self, rows: Sequence[ScoredTick], config: Config) -> Figures:
        """The score of some rounds, with times from the flight's first round; empty if they have no frame."""
        if not any(row.truth for row in rows):
            return {}
        scored = score(rows, self.camera.settings.intrinsics, config.servo.standoff_m, asdict(config.limits))
        return rounded(replace(scored, worst_t_s=scored.worst_t_s - self.rows[0].t_s))


@dataclass(frozen=True, slots=True)
class FlownFlight:
    """The result of a simulated flight: its summary, whether it was flown to its end, the recording's failure."""

    figures: Figures
    finished: bool
    failure: str


def simulate(flight: FlightSpec, terminal: Terminal, *, bar: bool) -> FlownFlight:
    """Fly in the simulator, into the flight's folder.  Raises OSError if another program writes there."""
    with claimed(flight.out):
        return simulate_into(flight, terminal, bar=bar)


def simulate_into(flight: FlightSpec, terminal: Terminal, *, bar: bool) -> FlownFlight:
    """Fly in the folder that is now claimed."""
    scenario, config = SCENARIOS[flight.scenario], flight.config
    believed = believed_camera(scenario, flight.autopilot, config.camera)
    drawn = scene_camera(scenario, flight.autopilot, flight.drawn or config.camera)
    camera, link, world = build(scenario, flight.seed, flight.autopilot, drawn)
    lens, down_rad = believed.intrinsics, believed.down_rad
    config = resolve(config, lens, down_rad, believed.latency_s)
    target, servo = Target(lens, down_rad, config.target), Servo(down_rad, config.servo)
    safety, meter = Safety(config.limits), ImageMotionMeter(lens, down_rad)
    about = f"# follow sim {flight.scenario}\n\n{scenario.about}; seed {flight.seed}, {flight.autopilot.value}"
    referee = Referee(camera)
    strip = Strip(scenario.duration_s)
    detector = simulated_detector(flight.detector)
    tracker = acquire(flight.tracker, camera.first()[1])  # this may refuse the flight, so it comes before the recording
    flown: Figures = {"scenario": flight.scenario, "seed": flight.seed, "autopilot": flight.autopilot.value}
    keep_other_flight(flight.out, flown, terminal)
    if bar and (line := height_report(config)):
        terminal.report(line)
    kept, setup = kept_geometry(config.servo, down_rad), Setup(lens, down_rad, as_toml(config), about=about)
    record = partial(Recorder, waits=True, about=about, desired=kept, setup=setup, view=flight.view)
    report_once = OnceEach(terminal.report)
    with camera, record(flight.out, config.record, report_once) as recorder:
        recorder.settings(as_toml(flight.config, config, flight.scene), flight.config.camera.calibration)

        def true_box(tick: Tick) -> Box | None:
            box = referee.box(tick)
            if tick.frame is not None:
                strip.add(tick.frame, box, tick.track.box if tick.track else None)
            return box

        with link:
            ticks = follow(camera, link, tracker, target, servo, safety, once(Order.FOLLOW), meter, detector)
            rounds = round(scenario.duration_s * max(scenario.frames_per_s, 30))
            if bar:
                terminal.listeners.append(recorder.message)
                ticks = terminal.progress(ticks, rounds, flight.name)
            finished = fly(ticks, recorder, terminal.report if bar else recorder.message, true_box)
        scored = referee.figures(referee.rows, config)
        figures = recorder.close({"tracker": flight.tracker, **scored, **flown})
    if any(row.truth for row in referee.rows):  # else it was stopped before its first frame
        path = flight.out / "flight.png"
        try:
            draw(path, flight.name, referee.rows, world, drawn.intrinsics, servo.config.standoff_m, strip)
        except OSError as error:
            path.unlink(missing_ok=True)
            report_once(unwritten(path, error))
    return FlownFlight(figures, finished, recorder.failure)


def scene_camera(scenario: Scenario, autopilot: Autopilot, camera: CameraConfig) -> CameraSettings:
    """The camera that a scene draws: by the settings, with the scenario's own mount unless they set another.

    A calibration does not change the drawn lens: that is the scenario's, with `fov_deg`.
    """
    down_rad = None if camera.down_deg is None else camera.down_rad
    return scenario.camera_settings(autopilot, math.radians(camera.fov_deg), down_rad, camera.delay_s)


def believed_camera(scenario: Scenario, autopilot: Autopilot, camera: CameraConfig) -> CameraSettings:
    """The camera that the flight assumes for a drawn scene: as drawn, but with the calibration's lens if there is one.

    Raises UsageError for a calibration that does not fit the drawn frames.
    """
    drawn = scene_camera(scenario, autopilot, camera)
    if not camera.calibration:
        return drawn
    return replace(drawn, intrinsics=lens_of(camera, drawn.intrinsics.width, drawn.intrinsics.height))


def rounded(scored: FlightScore) -> Figures:
    """Fractions and metres with five decimals; fields that do not apply are left out."""
    known = {name: value for name, value in asdict(scored).items() if value is not None}
    rounded = {name: round(value, 5) if isinstance(value, float) else value for name, value in known.items()}
    return cast(Figures, rounded)


def sim(command: SimCommand, settings_of: Callable[[str], Config], bare: Any) -> None:
    """`follow sim`; `settings_of` gives the settings for a scenario, `bare` are those without any scenario."""
    terminal = Terminal()
    if command.list:
        sys.stdout.write("".join(f"{name:<20} {s.about}\n" for name, s in SCENARIOS.items()))
        return
    check(command)
    if command.all:
        sim_all(command, {name: settings_of(name) for name in SCENARIOS}, bare, terminal)
    else:
        autopilot = command.autopilot or Autopilot.PX4
        out = command.out or OUT / command.scenario
        flight = FlightSpec(command.scenario, command.seed, autopilot, command.tracker, command.config, out)
        flight = replace(flight, scene=from_scene(command.scenario, command.config, bare), view=command.view)
        flight = replace(flight, detector=command.detector)
        page = page_options(command.page, command.page_token)
        if page is not None or command.ground is not None:
            from follow.cli.sim_page import fly_watched  # noqa: PLC0415 - which imports this file

            fly_watched(command, flight, page)
            return
        flown = simulate(flight, terminal, bar=True)
        finished, failure = flown.finished, flown.failure
        conclude(flown.figures, flight.out, terminal, as_json=command.json, finished=finished, failure=failure)


def check(command: SimCommand) -> None:
    """Raise UsageError for errors that can be found before anything is opened."""
    if command.scenario not in SCENARIOS:
        raise no_scenario(command.scenario, SCENARIOS)
    require_folder(command.out or (OUT if command.all else OUT / command.scenario))
    if command.config.record.pictures and not command.all:
        require_encoder("record.encoder", command.config.record.encoder)
    if (command.page is not None or command.ground is not None) and video_address(command) is not None:
        require_encoder("video.encoder", command.config.video.encoder)
    require_tracker(command.tracker)
    check_detector(command.detector)


def sim_all(command: SimCommand, configs: Mapping[str, Config], bare: Any, terminal: Terminal) -> None:
    """Fly every scenario with several seeds and both vehicles; without recorded images, which would fill the disk."""
    scenarios = tuple(configs)
    configs = {name: replace(config, record=replace(config.record, pictures=False)) for name, config in configs.items()}
    autopilots = [command.autopilot] if command.autopilot else list(Autopilot)
    flights = [
        FlightSpec(scenario, seed, autopilot, command.tracker, configs[scenario], Path())
        for scenario in scenarios
        for autopilot in autopilots
        for seed in range(command.seed, command.seed + (command.seeds or SEEDS))
    ]
    out = command.out or OUT
    scenes = {name: from_scene(name, config, bare) for name, config in configs.items()}
    flights = [
        replace(flight, out=out / flight.name, scene=scenes[flight.scenario], detector=command.detector)
        for flight in flights
    ]
    flown = terminal.progress(each(simulate_quietly, flights, dask=command.dask), len(flights), "sim --all", "flights")
    done = sorted(flown, key=lambda f: (scenarios.index(f[0].scenario), f[0].autopilot.value, f[0].seed))
    summaries = [figures for _, figures in done]
    written = table(summaries)
    if command.json:
        result(summaries, as_json=True)
    else:
        sys.stdout.write(written)
    out.mkdir(parents=True, exist_ok=True)  # the flights of a cluster may be on other disks
    (out / "all.txt").write_text(written)


def simulate_quietly(flight: FlightSpec) -> Figures:
    """One flight of many, in a process of its own, here or on another machine."""
    one_core()
    flown = simulate(flight, Terminal(), bar=False)
    if flown.failure:
        raise RecordingError(f"{flight.name}: {flown.failure}")
    return flown.figures
