"""The fault matrix in lockstep, as data: the fault, what must happen and its bound."""

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from follow.camera import CameraError
from follow.messages import Autopilot, Frame, Setpoint
from follow.safety.gate import Limits
from racf.box import Box
from racf.track import Track
from tests.support.bounds import (
    RUN_M_S,
    SILENT_S,
    STALE_FRAME_S,
    STALE_HEARTBEAT_S,
    STALE_POSITION_S,
    STICK_SEEN_S,
    STREAM_LOSS_S,
    coast,
    stop,
)
from tests.support.fault_expectations import (
    Expectation,
    either,
    falls_silent,
    goes_on,
    hovers,
    lost_link,
    pilot_has_it,
    stands,
    stops,
    within,
)
from tests.support.fault_rig import FAULT_S, Outcome, Rig, outcome
from tests.support.link_faults import (
    ATTITUDE,
    HEARTBEAT,
    POSITION,
    another_vehicle,
    deaf,
    drop_for,
    garble,
    lose_a_third,
    second_sender,
    shuffle,
)


@dataclass(frozen=True)
class Row:
    """One fault.  `rig` holds the flight's own settings; `fast` marks the rows that every test run flies."""

    name: str
    inject: Callable[[Rig], None]
    expect: Expectation
    rig: dict[str, object] = field(default_factory=dict)
    fast: bool = False
    follows: bool = True  # before the fault
    autopilots: tuple[Autopilot, ...] = tuple(Autopilot)

    def fly(self, autopilot: Autopilot) -> "Result":
        """Fly it once and judge."""
        rig = Rig(autopilot, self.inject, **self.rig).fly()  # type: ignore[arg-type] - rows are data
        seen = outcome(rig)
        wrong = [] if seen.followed is self.follows else [f"it followed before the fault: {seen.followed}"]
        return Result(self, autopilot, seen, tuple(wrong + self.expect.judge(seen, autopilot)), tuple(rig.lines))


@dataclass(frozen=True)
class Result:
    """A row flown under one rule set; it passed when nothing is wrong."""

    row: Row
    autopilot: Autopilot
    outcome: Outcome
    wrong: tuple[str, ...]
    lines: tuple[str, ...]


# Faults


def hold_up_for(seconds: float) -> Callable[[Rig], None]:
    """A network that stalls, then delivers all frames, three a round: the newest of them, with its own time."""

    def inject(rig: Rig) -> None:
        waiting: deque[tuple[Frame, Box]] = deque()
        seen: list[Box] = []

        def see(frame: Frame | None) -> Frame | None:
            if frame is not None and (box := rig.true_box()) is not None:
                waiting.append((frame, box))
            if rig.t_s < rig.fault_t_s + seconds or not waiting:
                return None
            newest = [waiting.popleft() for _ in range(min(3, len(waiting)))][-1]
            seen[:] = [newest[1]]
            return newest[0]

        rig.see = see
        rig.track = lambda track: replace(track, box=seen[0], search=seen[0].scaled(3))

    return inject


def freeze(rig: Rig) -> None:
    held: list[Frame] = []

    def see(frame: Frame | None) -> Frame | None:
        if frame is not None and not held:
            held.append(frame)
        return frame and replace(frame, image=held[0].image)

    rig.see = see


def black(rig: Rig) -> None:
    """All zero, with fresh times; with noise on it, the tracker must report the target lost."""
    rig.see = lambda frame: frame and replace(frame, image=np.zeros_like(frame.image))


def stall(rig: Rig) -> None:
    rig.see = lambda _frame: None


def decoder_error(rig: Rig) -> None:
    def see(_frame: Frame | None) -> Frame | None:
        raise CameraError("the stream cannot be decoded any more")

    rig.see = see


def lose(rig: Rig) -> None:
    rig.track = lambda track: replace(track, found=False, confidence=0.0)


def lose_for(seconds: float) -> Callable[[Rig], None]:
    def inject(rig: Rig) -> None:
        rig.track = lambda track: replace(track, found=rig.t_s > rig.fault_t_s + seconds)

    return inject


def tracker_raises(rig: Rig) -> None:
    def track(_track: Track) -> Track:
        raise RuntimeError("a defect in the tracker")

    rig.track = track


def forged(value: float) -> Callable[[Rig], None]:
    """A box with numbers that the constructor refuses."""

    def inject(rig: Rig) -> None:
        def track(true: Track) -> Track:
            box = object.__new__(Box)
            for name in Box.__slots__:
                object.__setattr__(box, name, value)
            return replace(true, box=box)

        rig.track = track

    return inject


def refused(rig: Rig) -> None:
    rig.track = lambda track: replace(track, box=Box(math.nan, 0.0, 1.0, 1.0))


def jump(rig: Rig) -> None:
    """The tracker reports something else with full confidence, five times as large and far off."""
    rig.track = lambda track: replace(track, box=Box.around(80.0, 60.0, 5 * track.box.w, 5 * track.box.h))


def hop(rig: Rig) -> None:
    """The box jumps to and fro by more than its width at every frame."""

    def track(true: Track) -> Track:
        return replace(true, box=true.box.moved(2.5 * true.box.w * rig.chance.choice((-1, 1)), 0.0))

    rig.track = track


def pilot(rig: Rig) -> None:
    rig.system.flight.enter("POSCTL" if rig.autopilot is Autopilot.PX4 else "LOITER")


def disarm(rig: Rig) -> None:
    rig.system.flight.disarm(force=True)


def low_battery(rig: Rig) -> None:
    rig.system.flight.parameters.update(
        {"COM_LOW_BAT_ACT": 3} if rig.autopilot is Autopilot.PX4 else {"BATT_FS_LOW_ACT": 2}
    )
    rig.system.flight.battery = 0.05


def autopilots_fence(rig: Rig) -> None:
    px4 = {"GF_ACTION": 3, "GF_MAX_HOR_DIST": 5.0}
    rig.system.flight.parameters.update(px4 if rig.autopilot is Autopilot.PX4 else {"FENCE_RADIUS": 5.0})


def vehicle_clock(by_s: float) -> Callable[[Rig], None]:
    def inject(rig: Rig) -> None:
        rig.system._boot_s += by_s

    return inject


def our_clock(by_s: float) -> Callable[[Rig], None]:
    def inject(rig: Rig) -> None:
        rig.jump_s += by_s

    return inject


def desired(setpoint: Setpoint) -> Callable[[Rig], None]:
    def inject(rig: Rig) -> None:
        rig.desired = lambda _desired: setpoint

    return inject


def wild_desired(rig: Rig) -> None:
    """The servo returns anything."""
    rig.desired = lambda _desired: Setpoint(
        *(rig.chance.choice((math.nan, math.inf, 1e9, -1e9, 5.0)) for _ in range(4))
    )


def stick(rig: Rig) -> None:
    """The remote control appears with its sticks at rest; a second later the pilot pushes one."""

    def way(packets: list[bytes]) -> list[bytes]:
        pushed = rig.t_s > rig.fault_t_s + 1.0
        rig.system.flight.sticks = (0.0, 0.8 if pushed else 0.0, 0.0, 0.0)
        return packets

    rig.to_client = way


def nothing(_rig: Rig) -> None:
    """No fault: the limit itself is what the row tests."""


GIVEN_UP_S = Limits().give_up_after_s + Limits().hold_timeout_s + 5.0
NEAR = replace(Limits(), fence_m=30.0)
LOW = replace(Limits(), ceiling_m=11.0)
PILOT_HAS_IT = pilot_has_it(STICK_SEEN_S)
STOP = stops(stop(RUN_M_S, STALE_FRAME_S))
HOVER = hovers(coast(RUN_M_S))
WITHIN_SPEED = within("exceeds no limit, in control", "8 m/s + 0.5 m/s", lambda o: o.fastest_m_s, lambda v: v < 8.5)

ROWS = (
    Row("camera stalls", stall, STOP, fast=True),
    Row("network delays frames by 0.8 s", hold_up_for(0.8), goes_on(3.0)),
    Row("camera repeats one frame", freeze, STOP, fast=True),
    Row("image goes black", black, STOP),
    Row("decoder error", decoder_error, STOP),
    Row("target lost", lose, HOVER, fast=True),
    Row("target lost for 1 s", lose_for(1.0), goes_on(3.0)),
    Row("target lost until HOLD ends", lose, stops(coast(RUN_M_S)), {"end_t_s": FAULT_S + GIVEN_UP_S}),
    Row("tracker raises", tracker_raises, STOP, fast=True),
    Row("NaN box, refused by its constructor", refused, STOP),
    Row("NaN box, forged", forged(math.nan), HOVER, fast=True),
    Row("infinite box, forged", forged(math.inf), HOVER),
    Row("box jumps to something else", jump, HOVER, fast=True),
    Row("box hops to and fro", hop, goes_on(3.0)),
    Row("telemetry stops", deaf(), stands(stop(RUN_M_S, STALE_FRAME_S)), fast=True),
    Row("attitude stops", deaf(ATTITUDE), STOP),
    Row("position stops", deaf(POSITION), stops(stop(RUN_M_S, STALE_POSITION_S))),
    Row("heartbeat stops", deaf(HEARTBEAT), stands(stop(RUN_M_S, STALE_HEARTBEAT_S))),
    Row("link drops for 0.3 s", drop_for(0.3), goes_on(3.0)),
    Row("link drops for 5 s and returns", drop_for(5.0), lost_link(stop(RUN_M_S, STREAM_LOSS_S)), fast=True),
    Row("30 % loss both ways", lose_a_third, goes_on(3.0), fast=True),
    Row("packets duplicated and reordered", shuffle, goes_on(3.0)),
    Row("garbage bytes", garble, goes_on(3.0), fast=True),
    Row("another system id on the link", another_vehicle, goes_on(3.0)),
    Row(
        "pilot takes over by a mode",
        pilot,
        falls_silent(SILENT_S, ("POSCTL", "LOITER")),
        fast=True,
    ),
    Row("pilot moves a stick", stick, PILOT_HAS_IT),
    Row("disarm", disarm, falls_silent(SILENT_S)),
    Row("second sender", second_sender, STOP, fast=True),
    Row("vehicle's clock jumps +100 s", vehicle_clock(100.0), goes_on(3.0)),
    Row("vehicle's clock jumps -50 s", vehicle_clock(-50.0), goes_on(3.0)),
    Row("vehicle's clock jumps -0.5 s", vehicle_clock(-0.5), either(STOP, goes_on(3.0))),
    Row("our clock jumps +5 s", our_clock(5.0), STOP),
    Row("our clock jumps -5 s", our_clock(-5.0), WITHIN_SPEED),
    Row("servo returns NaN, inf and 10^9", wild_desired, WITHIN_SPEED),
    Row("low battery failsafe of the autopilot", low_battery, falls_silent(SILENT_S, ("RTL", "LAND"))),
    Row("autopilot's fence reached", autopilots_fence, falls_silent(SILENT_S, ("RTL", "LAND"))),
    Row(
        "our fence reached",
        nothing,
        within("stays inside, in control", "30 m + 1 m", lambda o: o.farthest_m, lambda v: v < 31.0),
        {"limits": NEAR},
        fast=True,
    ),
    Row(
        "altitude floor reached",
        desired(Setpoint(down_m_s=2.0)),
        within("stays above", "2 m - 0.3 m", lambda o: o.lowest_m, lambda v: v > 1.7),
        fast=True,
    ),
    Row(
        "altitude ceiling reached",
        desired(Setpoint(down_m_s=-2.0)),
        within("stays below", "11 m + 0.3 m", lambda o: o.highest_m, lambda v: v < 11.3),
        {"limits": LOW},
    ),
)
