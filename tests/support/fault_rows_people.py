"""Rows of the fault matrix about people: who orders and who flies, and who comes near.  See docs/hazards.md."""

import math
from collections.abc import Callable
from dataclasses import replace

from pymavlink.dialects.v20 import common as dialect

from follow.control.servo import ServoConfig, ServoMode
from follow.messages import Autopilot, Order
from follow.operator.consoles import RAISE_RANGE, STANDOFF_RANGE
from follow.selection import Wanted
from racf.box import Box
from racf.track import Track
from sim.autopilot.core import Result
from tests.support.bounds import REMOTE_TOLD_S, RUN_M_S, SILENT_S, STICK_SEEN_S, STREAM_LOSS_S, stop
from tests.support.fault_expectations import (
    falls_silent,
    gives_sticks,
    goes_on,
    keeps,
    lost_link,
    never_streams,
    pilot_has_it,
    stops,
)
from tests.support.fault_rig import Rig, Way
from tests.support.fault_rows import STOP, Row, lose, nothing
from tests.support.link_faults import deaf, number, uplink_lost_for

EXTENDED_SYS_STATE, BATTERY_STATUS, SYS_STATUS = 245, 147, 1
PILOTS_MODE = {Autopilot.PX4: "POSCTL", Autopilot.ARDUPILOT: "LOITER"}
BY_HAND = {"at_once": False, "path": lambda _t_s: (12.0, 0.0), "end_t_s": 27.0}

GROUNDED = {**BY_HAND, "height_m": 0.0, "fault_t_s": 5.0, "end_t_s": 10.5}


def order_in(mode: str) -> Callable[[Rig], None]:
    """The vehicle is in a mode that is not the pilot's; FOLLOW is ordered three times."""

    def inject(rig: Rig) -> None:
        rig.system.flight.enter(mode)
        for _ in range(3):  # before the mode is known: PX4 reports it up to a second late
            rig.operator.order(Order.FOLLOW, "key f")

    return inject


def ordering(rig: Rig) -> Way:
    """A connection that forwards everything and orders FOLLOW once a second."""
    given: list[float] = []

    def way(packets: list[bytes]) -> list[bytes]:
        if rig.t_s - rig.fault_t_s > len(given):
            given.append(rig.t_s)
            rig.operator.order(Order.FOLLOW, "key f")
        return packets

    return way


def on_the_ground(rig: Rig) -> None:
    """Armed, and not taking off."""
    flight = rig.system.flight
    flight.parameters.update({"COM_DISARM_PRFLT": 100.0} if rig.autopilot is Autopilot.PX4 else {"DISARM_DELAY": 100})
    if rig.autopilot is Autopilot.ARDUPILOT:
        flight.enter("GUIDED")
    assert flight.arm() is Result.ACCEPTED
    rig.to_client = ordering(rig)


def taking_off(rig: Rig) -> None:
    """It climbs from the ground to 10 m, for some 6 s."""
    on_the_ground(rig)
    assert rig.system.flight.take_off(10.0) is Result.ACCEPTED


def order_and_leave(rig: Rig) -> None:
    """FOLLOW is ordered while the target is not seen; the pilot changes the mode, and the target appears again."""
    rig.track = lambda track: replace(track, found=rig.t_s > rig.fault_t_s + 3.0)
    done: list[str] = []

    def way(packets: list[bytes]) -> list[bytes]:
        if rig.t_s > rig.fault_t_s + 1.0 and not done:
            done.append("order")
            rig.operator.order(Order.FOLLOW, "key f")
        if rig.t_s > rig.fault_t_s + 2.0 and len(done) == 1:
            done.append("mode")
            rig.system.flight.enter("POSCTL" if rig.autopilot is Autopilot.PX4 else "POSHOLD")
        return packets

    rig.to_client = way


def refuse(rig: Rig) -> None:
    """The autopilot refuses our mode; two seconds later the operator orders OBSERVE."""
    ask = rig.system.flight.ask_mode
    control = (6, 0) if rig.autopilot is Autopilot.PX4 else (4, 0)

    def refused(mode: int, sub: int) -> list[Result]:
        return [Result.TEMPORARILY_REJECTED] if (mode, sub) == control else ask(mode, sub)

    rig.system.flight.ask_mode = refused  # type: ignore[method-assign] - the fault
    rig.operator.order(Order.FOLLOW, "key f")
    began_t_s, given = rig.t_s, list[float]()

    def way(packets: list[bytes]) -> list[bytes]:
        if rig.t_s > began_t_s + 4.0 and not given:
            given.append(rig.t_s)
            rig.operator.order(Order.OBSERVE, "key o")
        return packets

    rig.to_client = way


def pilot_and_switch(rig: Rig) -> None:
    """The pilot takes over by his mode and, 0.3 s later, also switches FOLLOW off."""
    rig.system.flight.enter(PILOTS_MODE[rig.autopilot])
    taken_t_s, given = rig.t_s, list[float]()

    def way(packets: list[bytes]) -> list[bytes]:
        if rig.t_s > taken_t_s + 0.3 and not given:
            given.append(rig.t_s)
            rig.operator.order(Order.OBSERVE, "the switch")
        return packets

    rig.to_client = way


def stick_with_orders_waiting(rig: Rig) -> None:
    """FOLLOW was typed five times by mistake when the pilot moves a stick."""
    for _ in range(5):
        rig.operator.order(Order.FOLLOW, "key f")

    def way(packets: list[bytes]) -> list[bytes]:
        rig.system.flight.sticks = (0.0, 0.8 if rig.t_s > rig.fault_t_s + 1.0 else 0.0, 0.0, 0.0)
        return packets

    rig.to_client = way


def receivers_failsafe(rig: Rig) -> None:
    """The transmitter is lost and the receiver sets its failsafe sticks, which the autopilot takes for a pilot's."""
    rig.system.flight.sticks = (0.0, 0.0, 0.0, 0.0)
    began_t_s = rig.t_s

    def way(packets: list[bytes]) -> list[bytes]:
        rig.system.flight.sticks = (0.0, 0.0, 1.0 if rig.t_s > began_t_s + 1.0 else 0.0, 0.0)
        return packets

    rig.to_client = way


def stick_after_the_end(rig: Rig) -> None:
    """OBSERVE is ordered; 3 s later, in Hold or BRAKE, the pilot moves a stick."""
    rig.operator.order(Order.OBSERVE, "key o")

    def way(packets: list[bytes]) -> list[bytes]:
        pushed = min(max(rig.t_s - rig.fault_t_s - 3.0, 0.0), 0.8)  # within 0.8 s
        rig.system.flight.sticks = (0.0, pushed, 0.0, 0.0)
        return packets

    rig.to_client = way


def stick_after_a_refusal(rig: Rig) -> None:
    """OBSERVE is ordered; 2 s later FOLLOW, which BRAKE refuses; 1 s later the pilot moves a stick."""
    stick_after_the_end(rig)
    push = rig.to_client
    ordered: list[float] = []

    def way(packets: list[bytes]) -> list[bytes]:
        if rig.t_s > rig.fault_t_s + 2.0 and not ordered:
            rig.operator.order(Order.FOLLOW, "key f")
            ordered.append(rig.t_s)
        return push(packets)

    rig.to_client = way


def ground_stations_stick(pushed_after_s: float) -> Callable[[Rig], None]:
    """A ground station sends MANUAL_CONTROL, at rest and then not; only this link hears it."""

    def inject(rig: Rig) -> None:
        mav = dialect.MAVLink(None, srcSystem=255, srcComponent=190)

        def way(packets: list[bytes]) -> list[bytes]:
            roll = 700 if rig.t_s > rig.fault_t_s + pushed_after_s else 0
            message = dialect.MAVLink_manual_control_message(1, 0, roll, 500, 0, 0)
            return [*packets, message.pack(mav)] if packets else packets

        rig.to_client = way

    return inject


def spoken(make: Callable[[Rig], dialect.MAVLink_message]) -> Callable[[Rig], Way]:
    """A connection that adds a message of the vehicle's autopilot to each batch."""

    def way(rig: Rig) -> Way:
        mav = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
        return lambda packets: [*packets, make(rig).pack(mav)] if packets else packets

    return way


def low_battery_warns(rig: Rig) -> None:
    """The autopilot calls its battery low and does nothing."""
    low = dialect.MAVLink_battery_status_message(
        0, 0, 0, 0, [0] * 10, -1, -1, -1, 20, charge_state=dialect.MAV_BATTERY_CHARGE_STATE_LOW
    )
    keep = spoken(lambda _rig: low)(rig)
    rig.to_client = lambda packets: keep([p for p in packets if number(p) != BATTERY_STATUS])


def remote_lost(rig: Rig) -> None:
    """The autopilot knows a remote control and reports it unhealthy after 2 s, and does nothing."""
    rc = dialect.MAV_SYS_STATUS_SENSOR_RC_RECEIVER

    def status(_rig: Rig) -> dialect.MAVLink_message:
        healthy = rc if rig.t_s < rig.fault_t_s + 2.0 else 0
        return dialect.MAVLink_sys_status_message(rc, rc, healthy, 100, 12000, 100, 80, 0, 0, 0, 0, 0, 0)

    keep = spoken(status)(rig)
    rig.to_client = lambda packets: keep([p for p in packets if number(p) != SYS_STATUS])


def same_id(rig: Rig) -> None:
    """A second vehicle with the same system id, elsewhere."""
    mav = dialect.MAVLink(None, srcSystem=1, srcComponent=1)

    def way(packets: list[bytes]) -> list[bytes]:
        ms = round((rig.t_s + 317.0) * 1e3)
        place = dialect.MAVLink_local_position_ned_message(ms, 60.0, 20.0, -30.0, 0.0, 0.0, 0.0)
        return [*packets, place.pack(mav)]

    rig.to_client = way


def trims(wanted: Wanted) -> Callable[[Rig], None]:
    """A person at a console wants the vehicle to fly so."""

    def inject(rig: Rig) -> None:
        rig.operator.wanted = lambda: wanted

    return inject


def toward(speed_m_s: float) -> dict[str, object]:
    """The target stands for 8 s, then comes straight at the vehicle and past it."""
    end = 15.0 + 24.0 / speed_m_s + 3.0
    return {"path": lambda t_s: (12.0 - speed_m_s * max(t_s - 15.0, 0.0), 0.0), "end_t_s": end}


def covered_then_lost(rig: Rig) -> None:
    """Whoever comes is covered more and more from below, to a half within a second, and then not found any more."""
    began_t_s = rig.t_s

    def track(track: Track) -> Track:
        seen = 1.0 - min(rig.t_s - began_t_s, 1.0) / 2
        box = Box(track.box.x, track.box.y, track.box.w * seen, track.box.h * seen)
        return replace(track, box=box, found=track.found and rig.t_s < began_t_s + 1.0)

    rig.track = track


def hides(speed_m_s: float) -> dict[str, object]:
    """The target runs away, vanishes behind a wall at 22 s and stands there."""
    path = lambda t_s: (12.0 + speed_m_s * max(min(t_s, 22.0) - 6.0, 0.0), 0.0)  # noqa: E731
    return {"path": path, "fault_t_s": 22.0, "end_t_s": 37.0}


AUTHORITY_ROWS = (
    *(
        Row(f"FOLLOW ordered in {mode}", order_in(mode), never_streams(), BY_HAND, mode == "RTL", follows=False)
        for mode in ("RTL", "LAND")
    ),
    Row("FOLLOW ordered during the take-off", taking_off, never_streams(), GROUNDED, True, follows=False),
    Row("FOLLOW ordered on the ground, armed", on_the_ground, never_streams(), GROUNDED, follows=False),
    Row("FOLLOW ordered, then the pilot changes the mode", order_and_leave, never_streams(), BY_HAND, follows=False),
    Row("our mode refused, then OBSERVE ordered", refuse, falls_silent(4.0, asked=1), BY_HAND, True, follows=False),
    Row(
        "landed state unknown",
        deaf(EXTENDED_SYS_STATE),
        never_streams(),
        {"fault_t_s": 0.01, "end_t_s": 12.0},
        True,
        follows=False,
    ),
    Row("FOLLOW ordered below the floor", nothing, never_streams(), {"height_m": 1.5, "end_t_s": 22.0}, follows=False),
    Row("pilot's mode, then the switch off", pilot_and_switch, falls_silent(SILENT_S, ("POSCTL", "LOITER")), fast=True),
    Row("pilot's stick with orders waiting", stick_with_orders_waiting, pilot_has_it(STICK_SEEN_S)),
    Row(
        "a receiver's failsafe moves a stick",
        receivers_failsafe,
        falls_silent(STICK_SEEN_S, ("BRAKE",), asked=1),
        fast=True,
        autopilots=(Autopilot.ARDUPILOT,),
    ),
    Row("pilot's stick in the Hold or BRAKE afterwards", stick_after_the_end, gives_sticks(0.5), fast=True),
    Row(
        "FOLLOW refused in BRAKE, then the pilot's stick",
        stick_after_a_refusal,
        gives_sticks(0.5),
        fast=True,
        autopilots=(Autopilot.ARDUPILOT,),
    ),
    Row("a ground station's stick moves", ground_stations_stick(1.0), pilot_has_it(STICK_SEEN_S), fast=True),
    Row("a ground station's stick rests", ground_stations_stick(math.inf), goes_on(3.0)),
    Row("uplink alone lost for 5 s", uplink_lost_for(5.0), lost_link(stop(RUN_M_S, STREAM_LOSS_S)), fast=True),
    Row("battery low, the autopilot only warns", low_battery_warns, STOP, fast=True),
    Row("remote control lost, the autopilot does nothing", remote_lost, stops(stop(RUN_M_S, REMOTE_TOLD_S))),
    Row("two vehicles with the same id", same_id, STOP),
)

DISTANCE_ROWS = (
    *(
        Row(f"target comes at {speed:g} m/s", nothing, keeps(least), toward(speed), speed == 6.0)
        for speed, least in ((1.4, 4.0), (3.0, 4.0), (6.0, 3.0))
    ),
    # The gate keeps the height above the head from which a run is evaded, whatever depression is wanted.
    Row("target comes at 6 m/s, camera 11 degrees down", nothing, keeps(3.0), {**toward(6.0), "down_rad": 0.2}),
    *(
        Row(
            f"target comes at 3 m/s, servo {mode.value}",
            nothing,
            keeps(4.0),
            {**toward(3.0), "servo": ServoConfig(mode=mode)},
        )
        for mode in (ServoMode.SPOTLIGHT, ServoMode.ORBIT, ServoMode.PROFILE)
    ),
    *(
        Row(
            f"target comes at {speed:g} m/s, trims near and low",
            trims(Wanted(standoff_factor=STANDOFF_RANGE[0], raise_rad=RAISE_RANGE[0])),
            keeps(least),
            {**toward(speed), "fault_t_s": 5.0},
        )
        for speed, least in ((3.0, 4.0), (6.0, 3.0))
    ),
    # Seen smaller he seems farther away, and unseen he may come under a vehicle that is low.
    *(
        Row(
            f"target comes at {speed:g} m/s, half covered, then lost",
            covered_then_lost,
            keeps(least),
            {**toward(speed), "down_rad": 0.2, "height_m": 3.0},
            speed == 3.0,
        )
        for speed, least in ((1.4, 4.0), (3.0, 4.0), (6.0, 3.0))
    ),
    *(
        Row(f"target hides at {speed:g} m/s and stands there", lose, keeps(0.5), hides(speed))
        for speed in (3.0, 5.0, 7.0)
    ),
)
