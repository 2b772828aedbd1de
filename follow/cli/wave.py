"""`follow doctor --wave`: mount, field of view and delay, from a vehicle that is turned by hand."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

from follow.camera import Camera, CameraError
from follow.camera.filter import CameraFilter
from follow.camera.live import LiveVideo
from follow.camera.names import is_live
from follow.cli.commands import DoctorCommand, lens_of
from follow.cli.layers import SCENE
from follow.cli.sim import scene_camera
from follow.config import CameraConfig
from follow.flight.finding import Finding, Health
from follow.flight.wave import WaveError, gather, measure
from follow.flight.wave_findings import Believed, judge
from follow.link import Link, LinkError
from follow.link.connection import connect
from follow.link.signing import Signing
from follow.messages import Autopilot, Frame, VehicleState
from follow.operator.terminal import Terminal
from racf.commandline import UsageError
from sim.camera import SceneCamera
from sim.scenarios import SCENARIOS, build_live

VEHICLE_S = 30.0  # an autopilot boots in less
HOW = (
    "turn the vehicle for {:g} s, about once a second: nose left and right, nose up and down, roll left and right, by "
    "20 to 40 degrees, before a far background; it need not be fast"
)


def wave(command: DoctorCommand, terminal: Terminal, drawn: CameraConfig | None = None) -> Sequence[Finding]:
    """Measure while the vehicle is turned.  `drawn`: a scene's true camera if not as in the settings, for tests."""
    assert command.camera is not None
    assert command.link is not None
    signing = Signing(command.signing_key) if command.signing_key is not None else None
    try:
        with connect(command.link, command.system_id, signing=signing) as link:
            link.wait_for_vehicle(VEHICLE_S, terminal.report)
            if (refusal := unsafe(link.state())) is not None:
                return [refusal]
            return waved(command, link, terminal, drawn)
    except (LinkError, CameraError, WaveError) as error:
        return [Finding("wave", Health.RED, str(error), "fix that, and wave again")]


def unsafe(state: VehicleState) -> Finding | None:
    """A red finding for an armed vehicle: nobody may hold turning propellers."""
    if state.armed and not state.in_air:
        return Finding("wave", Health.RED, "the vehicle is armed", "disarm it, and take the propellers off")
    return None


def waved(command: DoctorCommand, link: Link, terminal: Terminal, drawn: CameraConfig | None) -> Sequence[Finding]:
    """Gather, measure and judge."""
    mount = command.config.camera
    with opened(command, link, terminal, drawn) as camera:
        terminal.report(HOW.format(command.wave))
        gathered = gather(disarmed(camera, link), link.state, command.wave or 0.0)
    if gathered.frames == 0:
        raise WaveError("no frame came: check that the camera delivers")
    lens = lens_of(mount, *gathered.size)
    terminal.report(f"{gathered.frames} frames, {len(gathered.attitude_t_s)} attitudes: measuring")
    fov_deg = math.degrees(lens.horizontal_fov_rad)
    return judge(
        measure(gathered, lens), Believed(math.degrees(mount.down_rad), fov_deg, mount.delay_s, mount.calibration)
    )


def disarmed(camera: Camera, link: Link) -> Iterator[Frame | None]:
    """The camera's frames; raises WaveError when somebody arms the vehicle meanwhile."""
    for frame in camera.frames():
        if unsafe(link.state()) is not None:
            raise WaveError("the vehicle was armed: put it down, disarm it, and take the propellers off")
        yield frame


def opened(command: DoctorCommand, link: Link, terminal: Terminal, drawn: CameraConfig | None) -> Camera:
    """The camera, its frames stamped with their arrival."""
    assert command.camera is not None
    if command.camera.startswith(SCENE):
        name = command.camera.removeprefix(SCENE)
        if name not in SCENARIOS:
            raise UsageError(f"there is no scene {name!r}; there are {', '.join(SCENARIOS)}")
        scenario, autopilot = SCENARIOS[name], link.state().autopilot or Autopilot.PX4
        mount = scene_camera(scenario, autopilot, drawn or command.config.camera)
        return AsTheyCome(build_live(scenario, 0, autopilot, link, mount)[0])
    if not is_live(command.camera):
        raise UsageError(f"--wave needs a live camera, not {command.camera!r}: this vehicle does not film a file now")
    return LiveVideo(command.camera, terminal.report)


class AsTheyCome(CameraFilter[SceneCamera]):
    """A drawn scene's camera as a device: its frames have the time of their arrival, not that of their exposure."""

    def frames(self) -> Iterator[Frame | None]:
        """Yield what the camera yields, stamped later by its delay."""
        for frame in self._camera.frames():
            yield None if frame is None else replace(frame, t_s=frame.t_s + self._camera.settings.latency_s)
