"""Ground stations in flight: who finds the camera, draws a box and stops, over UDP; each writes down what passed.

`direct` talks to us; otherwise the station is behind the autopilot, on the pilot's own connection.
"""

import contextlib
import socket
import threading
import time
from dataclasses import replace
from functools import cache

from follow.messages import Autopilot
from sim.camera import SceneCamera
from sim.scenarios import SCENARIOS
from tests.support.camera_client import CameraClient
from tests.support.ground_station import GroundStation
from tests.support.real_flight import until

FOUND_S = 30.0


class Scripted:
    """The scripted station of one dialect (`GroundStation`) with its socket."""

    def __init__(self, dialect, port, pilot):
        self.station = GroundStation(dialect)
        self.pilot, self.direct = pilot, port is not None
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.settimeout(0.05)
        self.address = ("127.0.0.1", port)
        self.ending = threading.Event()
        self.thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self):
        if not self.direct:
            self.pilot.hears = lambda packet: self.station.hear(packet, time.monotonic())
        self.thread.start()
        until("the camera was found", lambda: bool(self.station.camera), FOUND_S)
        until("its answers came", lambda: "STORAGE_INFORMATION" in self.station.heard, FOUND_S)
        return self

    def __exit__(self, *_error):
        self.ending.set()
        self.thread.join()
        self.socket.close()

    def draw(self, box):
        self.station.drag(time.monotonic(), *box)
        until("selected", lambda: (2005, 0) in self.station.acks, 5.0)

    def stop(self):
        self.station.stop(time.monotonic())
        until("stopped", lambda: (2010, 0) in self.station.acks, 5.0)

    @property
    def boxes(self):
        """How many boxes it could draw."""
        return len(self.station.boxes)

    @property
    def errors(self):
        return self.station.errors

    @property
    def log(self):
        return self.station.log

    def _send(self, packet):
        if self.direct:
            self.socket.sendto(packet, self.address)
        else:
            self.pilot.link.write(packet)

    def _run(self):
        beat_s = 0.0
        while not self.ending.is_set():
            now = time.monotonic()
            if now - beat_s > 0.5:
                beat_s = now
                self._send(self.station.heartbeat())
            for packet in self.station.take():
                self._send(packet)
            if self.direct:
                with contextlib.suppress(TimeoutError, ConnectionError):
                    self.station.hear(self.socket.recv(65536), now)
            else:
                time.sleep(0.05)
            self.station.step(now)


class Shared:
    """A port at which another program shares the pilot's connection to the autopilot."""

    def __init__(self, pilot):
        self.pilot, self.peer = pilot, None
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(0.1)
        self.port = self.socket.getsockname()[1]
        self.ending = threading.Event()
        self.thread = threading.Thread(target=self._run, daemon=True)
        self.thread.start()

    def close(self):
        self.pilot.hears = lambda _packet: None
        self.ending.set()
        self.thread.join()
        self.socket.close()

    def _run(self):
        self.pilot.hears = lambda packet: self.peer and self.socket.sendto(packet, self.peer)
        while not self.ending.is_set():
            with contextlib.suppress(TimeoutError, ConnectionError):
                data, self.peer = self.socket.recvfrom(65536)
                self.pilot.link.write(data)


class ByMavsdk:
    """MAVSDK's Camera client; a refused or unanswered call raises."""

    errors = ()

    def __init__(self, port, pilot):
        self.shared = Shared(pilot) if port is None else None
        self.client = CameraClient(f"udpout://127.0.0.1:{port or self.shared.port}")
        self.log = []

    def __enter__(self):
        self.client.__enter__()
        found = self.client.cameras[0]
        size = f"{found.horizontal_resolution_px}x{found.vertical_resolution_px}"
        self._note(f"camera_list: component {found.component_id}, {found.vendor_name} {found.model_name}, {size}")
        return self

    def __exit__(self, *error):
        self.client.__exit__(*error)
        if self.shared is not None:
            self.shared.close()

    def draw(self, box):
        self.client.track(*box)
        self._note("track_rectangle {:.3f} {:.3f} {:.3f} {:.3f}: SUCCESS".format(*box))

    def stop(self):
        self.client.stop()
        self._note("track_stop: SUCCESS")

    @property
    def boxes(self):
        return sum(status["tracking_status"] == 1 for status in self.client.statuses)

    def _note(self, words):
        self.log.append((time.monotonic(), words))


class Standing:
    def __init__(self, place):
        self.place = place

    def advance(self, dt_s):
        self.place = replace(self.place, t_s=self.place.t_s + dt_s)
        return self.place


@cache
def standing_camera(rules):
    """The walker's scene as seen from its start; building it takes most of a second."""
    scenario = SCENARIOS["walker"]
    world = scenario.world(0)
    place = scenario.start(world, 0)
    return SceneCamera(world, Standing(place), scenario.camera_settings(Autopilot(rules))), place


def walkers_box(rules, since_s):
    """Where the walker appears in shares of the image, seen from the scenario's start, with a person's margin."""
    camera, place = standing_camera(rules)
    _, seen = camera._draw(replace(place, t_s=since_s), since_s, 0)
    box = seen[0].box.scaled(1.15)
    return box.x / 640, box.y / 360, (box.x + box.w) / 640, (box.y + box.h) / 360
