"""MAVSDK's Camera client finds our camera, selects, reads the status and stops: directly and through an autopilot."""

import contextlib
import threading
import time
from types import SimpleNamespace

import pytest
from mavsdk.plugins.camera.camera import CameraError

from follow.link.connection import connect
from follow.link.transports import open_transport
from follow.messages import Autopilot
from follow.operator.ground import DirectSide, GroundSide
from follow.operator.ground_camera import GroundCamera, StreamDescription
from follow.selection import Selection, TrackingState, TrackingStatus
from sim.autopilot.program import UdpPort, run
from sim.autopilot.system import AutopilotSystem
from sim.dynamics import Vehicle, VehicleTruth
from tests.support.camera_client import CameraClient
from tests.support.real_flight import free_ports, until
from tests.test_examples import example

SIZE = (640, 360)
STREAM = StreamDescription("5600", True, 30.0, SIZE, 2_000_000, 70.0)


class Tracked:
    """What a person chose and what is tracked since: a box that moves to the right."""

    def __init__(self):
        self.chosen, self.box, self.why, self.t_s = [], None, "", 0.0

    def choose(self, choice):
        self.chosen.append(choice)
        if self.why:
            return self.why
        is_box = isinstance(choice, Selection)
        self.box = (choice.left, choice.top, choice.width, choice.height) if is_box else None
        return ""

    @property
    def status(self):
        return TrackingStatus(TrackingState.ACTIVE if self.box else TrackingState.IDLE, self.box, self.t_s)


@contextlib.contextmanager
def flying(ground):
    """An autopilot, our link to it, the ground's side in rounds; yields the choices and the ground station's port."""
    (direct_port,) = free_ports(1)
    system = AutopilotSystem(Autopilot.ARDUPILOT, Vehicle(Autopilot.ARDUPILOT, VehicleTruth(down_m=-10.0)), links=2)
    ports = [UdpPort("udpin:127.0.0.1:0"), UdpPort("udpin:127.0.0.1:0")]
    ended, tracked = threading.Event(), Tracked()
    server = threading.Thread(target=run, args=(system, ports, ended.is_set))
    server.start()

    def rounds(link, side):
        while not ended.is_set():
            state = link.state()
            tracked.t_s = state.t_s
            side.see(SimpleNamespace(state=state))
            time.sleep(0.02)

    with contextlib.ExitStack() as stack:
        stack.callback(lambda: [port.close() for port in ports])
        stack.callback(server.join)
        stack.callback(ended.set)
        link = stack.enter_context(connect(f"udpout:127.0.0.1:{ports[0].socket.getsockname()[1]}"))
        link.wait_for_vehicle(20.0)
        camera = GroundCamera(SIZE, tracked.choose, STREAM)
        camera.address(1)
        direct = DirectSide(open_transport(f"udpin:127.0.0.1:{direct_port}")) if ground == "direct" else None
        side = GroundSide(link, camera, tracked, SimpleNamespace(see=lambda _tick: None), direct)
        link.listeners.append(side.hear)
        stack.callback(side.close)
        thread = threading.Thread(target=rounds, args=(link, side))
        thread.start()
        stack.callback(thread.join)
        stack.callback(ended.set)
        yield tracked, direct_port if direct else ports[1].socket.getsockname()[1]


@pytest.mark.parametrize("ground", ["direct", "behind the autopilot"])
def test_mavsdk_finds_the_camera_selects_reads_the_status_and_stops(ground):
    with flying(ground) as (tracked, port), CameraClient(f"udpout://127.0.0.1:{port}") as client:
        (information,) = client.cameras
        assert information.component_id == 100
        assert (information.vendor_name, information.model_name) == ("follow-me", "RACF")
        assert (information.horizontal_resolution_px, information.vertical_resolution_px) == SIZE
        client.track(0.25, 0.5, 0.375, 0.75)
        (selection,) = tracked.chosen
        assert (selection.left, selection.top, selection.width, selection.height) == (0.25, 0.5, 0.125, 0.25)
        until("told the state", lambda: len(client.statuses) > 5)
        told = client.statuses[-1]
        assert told["tracking_status"] == 1
        assert [told[name] for name in ("rec_top_x", "rec_top_y", "rec_bottom_x", "rec_bottom_y")] == [
            0.25, 0.5, 0.375, 0.75]  # fmt: skip
        client.stop()
        until("told the end", lambda: client.statuses[-1]["tracking_status"] == 0)
        client.track_point(0.5, 0.25, 0.02)
        assert tracked.chosen[-1].is_point


def test_a_refusal_reaches_mavsdk_with_its_reason():
    with flying("direct") as (tracked, port), CameraClient(f"udpout://127.0.0.1:{port}") as client:
        tracked.why = "nothing to hold on to"
        with pytest.raises(CameraError):
            client.track(0.25, 0.5, 0.375, 0.75)
        until("told why", lambda: any("nothing to hold on to" in text for text in client.texts))


def test_the_example_chooses_reads_what_is_tracked_and_stops(capsys):
    module = example("select_with_mavsdk")
    with flying("direct") as (tracked, port):
        url = f"udpout://127.0.0.1:{port}"
        assert module.main(url, (0.25, 0.5, 0.375, 0.75), 1.0) > 0
        assert "tracked 0.250 0.500 0.375 0.750" in capsys.readouterr().out
        selection, cleared = tracked.chosen
        assert (selection.left, selection.top, selection.width, selection.height) == (0.25, 0.5, 0.125, 0.25)
        assert not isinstance(cleared, Selection)
        tracked.why = "nothing to hold on to"
        with pytest.raises(module.CameraError):
            module.main(url, (0.5, 0.5), 1.0)
        assert tracked.chosen[2].is_point
        assert len(tracked.chosen) == 3, "who was refused stops nobody else's flight"
        assert tracked.why in capsys.readouterr().out
