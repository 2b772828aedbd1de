"""The same rules for every Link.  To add one, write a builder and name it in LINKS.

A builder is a context manager that opens the link to a vehicle hovering at 10 m and gives a Rig.  On leaving it closes
the link first and everything behind it then.
"""

import contextlib
import math
import select
import socket
import statistics
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import pytest
from pymavlink.dialects.v20 import common as dialect

from follow.link import Link
from follow.link.connection import connect
from follow.link.replay import ReplayLink
from follow.messages import HOVER, Autopilot, Setpoint, VehicleState
from sim.autopilot.program import UdpPort, run
from sim.autopilot.system import AutopilotSystem
from sim.dynamics import Vehicle, VehicleTruth
from sim.link import SimLink
from tests.support.autopilot_pair import CONTROL, HOLD, STEP_S, Pair
from tests.support.machine import against_the_clock


@dataclass
class Rig:
    """A link under test.  `pass_time` lets the vehicle fly; `mode` is its true mode, read without the link.

    `in_time` turns failures into LateError where the link runs in real time.
    """

    link: Link
    pass_time: Callable[[float], None]
    mode: Callable[[], str]
    take_control: Callable[[], None]
    in_time: Callable[[], contextlib.AbstractContextManager[None]] = contextlib.nullcontext

    def stream(
        self, seconds: float, setpoint: Setpoint | None, enough: Callable[[VehicleState], bool] = lambda _: False
    ) -> VehicleState:
        """Send the setpoint for `seconds`, or until the vehicle's state is enough."""
        state = self.link.state()
        end_s = state.t_s + seconds
        while state.t_s < end_s and not enough(state):
            self.link.send(setpoint)
            self.pass_time(0.03)
            state = self.link.state()
        return state


class MemoryLink:
    """A Link over the client and the autopilot wired in memory, on the pair's own clock."""

    def __init__(self, pair: Pair):
        self.pair = pair

    def state(self) -> VehicleState:
        return self.pair.state

    def send(self, setpoint: Setpoint | None) -> None:
        self.pair.client.send_setpoint(setpoint, self.pair.t_s)
        self.pair.setpoint = setpoint

    def __enter__(self) -> "MemoryLink":
        return self

    def __exit__(self, *_error: object) -> None:
        self.pair.setpoint = None
        self.pair.client.hold()
        self.pair.run(0.5)


@contextlib.contextmanager
def in_memory(autopilot: Autopilot) -> Iterator[Rig]:
    pair = Pair(autopilot)
    pair.run(2.0)
    with MemoryLink(pair) as link:
        yield Rig(link, lambda _s: pair.run(STEP_S), lambda: pair.system.flight.mode, pair.client.take_control)


@contextlib.contextmanager
def served(autopilot: Autopilot, uri: Callable[[int], str]) -> Iterator[Rig]:
    """A link over UDP; `uri` makes its address from the port where the autopilot waits."""
    system = AutopilotSystem(autopilot, Vehicle(autopilot, VehicleTruth(down_m=-10.0)))
    port = UdpPort("udpin:127.0.0.1:0")
    ended = threading.Event()
    server = threading.Thread(target=run, args=(system, [port], ended.is_set))
    server.start()
    try:
        with connect(uri(port.socket.getsockname()[1])) as link:
            link.wait_for_vehicle(10.0)
            yield Rig(link, time.sleep, lambda: system.flight.mode, link.take_control, against_the_clock)
    finally:
        ended.set()
        server.join()
        port.close()


def over_udp(autopilot: Autopilot):
    return served(autopilot, lambda port: f"udpout:127.0.0.1:{port}")


def over_mavsdk(autopilot: Autopilot):
    return served(autopilot, lambda port: f"mavsdk+udpout://127.0.0.1:{port}")


@contextlib.contextmanager
def simulated(autopilot: Autopilot) -> Iterator[Rig]:
    with SimLink(Vehicle(autopilot, VehicleTruth(down_m=-10.0))) as link:
        yield Rig(link, link.advance, lambda: link.state().mode, lambda: None)


@contextlib.contextmanager
def replayed(autopilot: Autopilot) -> Iterator[Rig]:
    with ReplayLink(30.0, 10.0, autopilot) as link:  # its time passes as setpoints are sent
        yield Rig(link, lambda _s: None, lambda: link.state().mode, lambda: None)


LINKS = {"memory": in_memory, "udp": over_udp, "mavsdk": over_mavsdk, "sim": simulated, "replay": replayed}
PRETENDED = {"sim", "replay"}  # they are in control from the start and have no other mode to end in
BOTH = pytest.mark.parametrize("autopilot", list(Autopilot))


@pytest.fixture(params=list(LINKS))
def opened(request):
    return LINKS[request.param]


@pytest.fixture(params=[name for name in LINKS if name not in PRETENDED])
def opened_by_mavlink(request):
    return LINKS[request.param]


@BOTH
@pytest.mark.parametrize("name", sorted(PRETENDED))
def test_a_simulated_link_obeys_and_ends_in_hover(name, autopilot):
    with LINKS[name](autopilot) as rig:
        state = rig.stream(8.0, Setpoint(forward_m_s=1.0), lambda state: state.body_velocity_m_s()[0] > 0.5)
        assert state.in_control
        assert state.body_velocity_m_s()[0] > 0.5
    state = rig.stream(8.0, None, lambda state: abs(state.body_velocity_m_s()[0]) < 0.1)
    assert abs(state.body_velocity_m_s()[0]) < 0.1


def test_a_link_reports_finite_states_with_monotonic_time_and_accepts_finite_setpoints(opened):
    with opened(Autopilot.ARDUPILOT) as rig:
        before = rig.link.state()
        took_s = []
        for _ in range(20):
            rig.pass_time(0.02)
            began_s = time.perf_counter()
            state = rig.link.state()
            took_s.append(time.perf_counter() - began_s)
            assert state.t_s >= before.t_s
            before = state
        assert statistics.median(took_s) < 0.1, "it does not wait for anything; a single one may be interrupted"
        # A group that was never measured says so by its time.
        numbers = (getattr(state, name) for name in VehicleState.__slots__ if not name.endswith("_t_s"))
        assert all(math.isfinite(value) for value in numbers if isinstance(value, float))
        with rig.in_time():
            assert state.t_s - state.attitude_t_s < 0.5
        assert state.down_m == pytest.approx(-10.0, abs=0.2)
        assert state.armed
        assert state.in_air
        with pytest.raises(ValueError, match="finite"):
            rig.link.send(Setpoint(down_m_s=math.nan))


@BOTH
def test_a_flight_over_a_link_is_obeyed_and_ends_in_hover(opened_by_mavlink, autopilot):
    with opened_by_mavlink(autopilot) as rig:
        before = rig.mode()
        rig.stream(0.3, HOVER)
        assert rig.mode() == before  # never unasked
        rig.take_control()
        with rig.in_time():  # a stream with a hole in it is not obeyed, and should not be
            state = rig.stream(8.0, HOVER, lambda state: state.in_control)
            assert rig.mode() == CONTROL[autopilot]
            assert state.in_control
            assert state.mode == CONTROL[autopilot]
            state = rig.stream(8.0, Setpoint(forward_m_s=1.0), lambda state: state.body_velocity_m_s()[0] > 0.5)
            assert state.body_velocity_m_s()[0] > 0.5
    assert rig.mode() == HOLD[autopilot]


def test_a_vehicle_that_is_not_ours_is_left_alone(opened_by_mavlink):
    with opened_by_mavlink(Autopilot.PX4) as rig:
        before = rig.mode()
        rig.stream(0.2, None)
    assert rig.mode() == before


def test_an_exception_in_flight_still_ends_in_hover():
    with contextlib.suppress(ZeroDivisionError), over_udp(Autopilot.ARDUPILOT) as rig:
        rig.take_control()
        rig.stream(8.0, HOVER, lambda state: state.in_control)
        with rig.in_time():
            assert rig.mode() == "GUIDED"
        _ = 1 / 0
    assert rig.mode() == "BRAKE"


@pytest.mark.parametrize("uri", ["udpin:14540", "carrier-pigeon:1:2", "tcp:host:port", "serial:/dev/null", ""])
def test_a_link_written_wrongly_is_named(uri):
    with pytest.raises(RuntimeError, match="a link is"):
        connect(uri)


def test_a_device_that_is_not_there_is_named(tmp_path):
    with pytest.raises(RuntimeError, match="cannot be opened"):
        connect(f"serial:{tmp_path / 'ttyNONE'}:57600")


def test_a_camera_of_the_same_system_does_not_become_the_addressee():
    link = connect("udpin:127.0.0.1:0")
    with link, ends_of(link) as (vehicle, camera):
        until_sent(link, vehicle)
        for stranger in (camera, camera, camera):
            stranger.say(100, dialect.MAV_TYPE_CAMERA)
        until_sent(link, vehicle)
        assert not camera.hears()


@dataclass
class End:
    """A UDP socket that speaks MAVLink to the link."""

    socket: socket.socket
    to: tuple[str, int]

    def say(self, component: int, kind: int) -> None:
        mav = dialect.MAVLink(None, 1, component)
        autopilot = 12 if component == 1 else 8
        self.socket.sendto(mav.heartbeat_encode(kind, autopilot, 1, 0, 4).pack(mav), self.to)

    def hears(self) -> bool:
        return bool(select.select([self.socket], [], [], 0.0)[0])


@contextlib.contextmanager
def ends_of(link) -> Iterator[tuple[End, End]]:
    with contextlib.ExitStack() as stack:
        ends = []
        for _ in range(2):
            end = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            end.bind(("127.0.0.1", 0))
            ends.append(End(end, ("127.0.0.1", link._transport.port)))
        yield ends[0], ends[1]


def until_sent(link, vehicle: End) -> None:
    """The vehicle sends until it receives a packet; that packet is discarded."""
    for _ in range(500):
        vehicle.say(1, dialect.MAV_TYPE_QUADROTOR)
        link.state()
        link.send(HOVER)
        if vehicle.hears():
            while vehicle.hears():
                vehicle.socket.recv(1000)
            return
        time.sleep(0.01)
    raise AssertionError("the vehicle was never spoken to")


def test_without_a_vehicle_the_wait_ends_and_names_what_is_missing():
    with connect("udpin:127.0.0.1:0") as link, pytest.raises(RuntimeError, match="no heartbeat"):
        link.wait_for_vehicle(0.1)
