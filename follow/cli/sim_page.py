"""`follow sim SCENARIO --page --ground`: a simulated flight in real time, commanded from page or ground station."""

import logging
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial

from follow.camera.recent import RecentFrames
from follow.cli.commands import SimCommand
from follow.cli.detector import open_detector
from follow.cli.ground import carried_alone, ground_sides, video_address
from follow.cli.height import height_report
from follow.cli.page import PageOptions, consoles_of, desk_of, open_page
from follow.cli.settings import as_toml
from follow.cli.sim import FlightSpec, Referee, believed_camera, scene_camera
from follow.config import Config, resolve
from follow.control.image_motion import ImageMotionMeter
from follow.control.reach import why_out_of_reach
from follow.control.selector import Selector
from follow.control.servo import Servo
from follow.control.target import Target
from follow.flight.live_flight import LogForwarder, Parts, fly
from follow.flight.session import conclude, keep_other_flight, kept_geometry, tracker_of
from follow.geometry import Intrinsics
from follow.link.transports import parse_address
from follow.messages import Tick
from follow.operator.authority import Operator
from follow.operator.page.exchange import Exchange
from follow.operator.terminal import Terminal
from follow.recording.exact import Setup
from follow.recording.folder import claimed
from follow.recording.recorder import Recorder
from follow.recording.summary import Figures
from follow.safety.gate import Safety
from sim.camera import SceneCamera
from sim.piloted import PilotedLink, RealTimePace
from sim.scenarios import SCENARIOS, build

PATH_S = 1800.0  # length of the target's path: longer than anybody watches a demonstration
ROUND_S = 1 / 30


def fly_watched(command: SimCommand, flight: FlightSpec, page: PageOptions | None) -> None:
    """Fly in real time until a person ends the program, into the flight's folder."""
    if command.ground is not None:
        parse_address(command.ground)
    video_address(command)
    terminal = Terminal(waits=False)
    forwarder = LogForwarder(terminal.report)
    logging.getLogger("follow").addHandler(forwarder)
    try:
        with claimed(flight.out), open_page(page, flight.out, terminal, command.page_token) as exchange:
            terminal.report("starting: the scene is built and the tracker warms up, some 10 s")
            figures, failure = fly_in_real_time(command, flight, exchange, terminal)
        conclude(figures, flight.out, terminal, as_json=command.json, finished=True, failure=failure)
    finally:
        logging.getLogger("follow").removeHandler(forwarder)
        terminal.flush()


@dataclass(frozen=True, slots=True)
class RealTimeScene:
    """A drawn scene and its vehicle in real time; `lens` and `down_rad` are those that the flight assumes."""

    link: PilotedLink
    camera: SceneCamera
    lens: Intrinsics
    down_rad: float
    config: Config
    about: str


def scene_in_real_time(flight: FlightSpec) -> RealTimeScene:
    """The scene of a flight, with its resolved settings."""
    scenario = replace(SCENARIOS[flight.scenario], duration_s=PATH_S)
    believed = believed_camera(scenario, flight.autopilot, flight.config.camera)
    drawn = scene_camera(scenario, flight.autopilot, flight.drawn or flight.config.camera)
    _, still, world = build(scenario, flight.seed, flight.autopilot, drawn)
    link = PilotedLink(still.vehicle, world.target, scenario.standoff_m, scenario.height_m)
    camera = SceneCamera(world, RealTimePace(link), drawn, PATH_S, flight.seed)
    config = resolve(flight.config, believed.intrinsics, believed.down_rad, believed.latency_s)
    about = (
        f"# follow sim {flight.scenario} in real time\n\n{scenario.about}; seed {flight.seed}, {flight.autopilot.value}"
    )
    return RealTimeScene(link, camera, believed.intrinsics, believed.down_rad, config, about)


def fly_in_real_time(
    command: SimCommand, flight: FlightSpec, exchange: Exchange | None, terminal: Terminal
) -> tuple[Figures, str]:
    """Fly; returns the flight's figures, and the recording's failure."""
    scene = scene_in_real_time(flight)
    link, lens, down_rad, config, about = scene.link, scene.lens, scene.down_rad, scene.config, scene.about
    tracker_parts = tracker_of(flight.tracker)
    flown: Figures = {"scenario": flight.scenario, "seed": flight.seed, "autopilot": flight.autopilot.value}
    keep_other_flight(flight.out, flown, terminal)
    setup = Setup(lens, down_rad, as_toml(config), about=about)
    kept, referee = kept_geometry(config.servo, down_rad), Referee(scene.camera)
    record = partial(Recorder, waits=False, about=about, clock=time.time, desired=kept, setup=setup, view=flight.view)
    operator = Operator(terminal.report)
    target = Target(lens, down_rad, config.target)
    recent = RecentFrames(scene.camera)
    record_here = record(flight.out, config.record, terminal.report)
    with record_here as recorder, ThreadPoolExecutor(1, "click") as looks, ExitStack() as open_sides:
        recorder.settings(as_toml(flight.config, config, flight.scene))
        terminal.listeners.append(recorder.message)
        detector, snap = open_detector(flight.detector, open_sides)
        tracker = Selector(*tracker_parts, recent, operator.retarget, None, looks, snap)
        operator.forget = target.forget
        tracker.out_of_reach = partial(why_out_of_reach, target)
        servo, safety = Servo(down_rad, config.servo), Safety(config.limits)
        consoles = consoles_of(operator, tracker, terminal.report, servo, config.limits)
        operator.wanted = lambda: consoles.wanted
        sees: list[Callable[[Tick], object]] = [lambda tick: recorder.tick(tick, referee.box(tick)), consoles.see]
        carrier = carried_alone(lambda: link.vehicle.motion.t_s)
        with recent as frames, link, ExitStack() as sides:
            sees += sides.enter_context(ground_sides(command, carrier, lens, consoles, terminal.report))
            if exchange is not None:
                sees.append(sides.enter_context(desk_of(exchange, consoles, flight.out)).see)

            def see(tick: Tick) -> None:
                for take in sees:
                    take(tick)

            def pause() -> None:
                time.sleep(ROUND_S)
                link.advance(ROUND_S)

            if line := height_report(config):
                terminal.report(line)
            terminal.report("flying: a simulated pilot keeps the vehicle behind the target until you order FOLLOW")
            meter = ImageMotionMeter(lens, down_rad)
            fly(Parts(frames, link, tracker, target, servo, safety, meter, detector), operator, see, pause=pause)
        terminal.listeners.remove(recorder.message)
        scored = referee.figures(referee.flown(), config)
        figures = recorder.close({"tracker": flight.tracker, **scored, **flown})
    return figures, recorder.failure
