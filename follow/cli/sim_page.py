"""`follow sim SCENARIO --page`: one simulated flight in real time, commanded by a person in the operator's page."""

import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path

from follow.camera.recent import RecentFrames
from follow.cli.detector import open_detector
from follow.cli.page import PageOptions, consoles_of, desk_of, open_page
from follow.cli.settings import as_toml
from follow.cli.sim import FlightSpec, Referee, believed_camera, scene_camera
from follow.config import resolve
from follow.control.image_motion import ImageMotionMeter
from follow.control.reach import why_out_of_reach
from follow.control.selector import Selector
from follow.control.servo import Servo
from follow.control.target import Target
from follow.flight.live_flight import Parts, fly
from follow.flight.session import conclude, keep_other_flight, kept_geometry, tracker_of
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

LONG_S = 1800.0  # length of the target's path: nobody watches a demonstration for longer
ROUND_S = 1 / 30


def fly_watched(flight: FlightSpec, page: PageOptions, token_file: Path | None, *, as_json: bool) -> None:
    """Fly in real time until a person ends the program, into the flight's folder."""
    terminal = Terminal(waits=False)
    try:
        with claimed(flight.out), open_page(page, flight.out, terminal, token_file) as exchange:
            assert exchange is not None
            figures, failure = fly_in_real_time(flight, exchange, terminal)
        conclude(figures, flight.out, terminal, as_json=as_json, finished=True, failure=failure)
    finally:
        terminal.flush()


def fly_in_real_time(flight: FlightSpec, exchange: Exchange, terminal: Terminal) -> tuple[Figures, str]:
    """The flight's figures, and what broke in its recording."""
    scenario = replace(SCENARIOS[flight.scenario], duration_s=LONG_S)
    believed = believed_camera(scenario, flight.autopilot, flight.config.camera)
    drawn = scene_camera(scenario, flight.autopilot, flight.drawn or flight.config.camera)
    _, still, world = build(scenario, flight.seed, flight.autopilot, drawn)
    link = PilotedLink(still.vehicle, world.target, scenario.standoff_m, scenario.height_m)
    camera = SceneCamera(world, RealTimePace(link), drawn, LONG_S, flight.seed)
    lens, down_rad = believed.intrinsics, believed.down_rad
    config = resolve(flight.config, lens, down_rad, believed.latency_s)
    tracker_parts = tracker_of(flight.tracker)
    about = f"# follow sim {flight.scenario} --page\n\n{scenario.about}; seed {flight.seed}, {flight.autopilot.value}"
    flown: Figures = {"scenario": flight.scenario, "seed": flight.seed, "autopilot": flight.autopilot.value}
    keep_other_flight(flight.out, flown, terminal)
    setup = Setup(lens, down_rad, as_toml(config), about=about)
    kept, referee = kept_geometry(config.servo, down_rad), Referee(camera)
    record = partial(Recorder, waits=False, about=about, clock=time.time, desired=kept, setup=setup, view=flight.view)
    operator = Operator(terminal.report)
    target = Target(lens, down_rad, config.target)
    recent = RecentFrames(camera)
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
        with recent as frames, link, desk_of(exchange, consoles, flight.out) as desk:

            def see(tick: Tick) -> None:
                recorder.tick(tick, referee.box(tick))
                consoles.see(tick)
                desk.see(tick)

            def pause() -> None:
                time.sleep(ROUND_S)
                link.advance(ROUND_S)

            meter = ImageMotionMeter(lens, down_rad)
            fly(Parts(frames, link, tracker, target, servo, safety, meter, detector), operator, see, pause=pause)
        terminal.listeners.remove(recorder.message)
        scored = referee.figures(referee.flown(), config)
        figures = recorder.close({"tracker": flight.tracker, **scored, **flown})
    return figures, recorder.failure
