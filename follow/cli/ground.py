"""The ground station's part of `follow run` and `follow sim`: the camera for selecting targets, and the video."""

import contextlib
import math
import os
import socket
import time
from collections.abc import Callable, Generator
from dataclasses import dataclass
from functools import partial
from typing import Protocol

from follow.cli.commands import RunCommand
from follow.cli.named import require_link
from follow.config import Config
from follow.geometry import Intrinsics
from follow.link import LinkError
from follow.link.addresses import parse_address
from follow.link.connection import MavlinkLink
from follow.link.packets import Message
from follow.link.signing import Signing
from follow.link.transports import Reach, open_transport, reach_of
from follow.messages import Notify, Tick
from follow.operator.consoles import Consoles
from follow.operator.ground import CarriesPackets, DirectSide, GroundSide, LoneVehicle
from follow.operator.ground_camera import GroundCamera
from follow.operator.told import PilotTexts, TextLink
from follow.operator.video_out import VideoAddress, VideoOut, description_of, parse_video
from racf.commandline import UsageError

LINK = "link"  # --ground: behind the autopilot
NO_VIDEO = "none"  # --video-out: no video, even with a ground station


class GroundCommand(Protocol):
    """A command's options about the ground station; RunCommand and SimCommand have them."""

    @property
    def ground(self) -> str | None: ...  # noqa: D102 - as their options' help says
    @property
    def video_out(self) -> str | None: ...  # noqa: D102
    @property
    def ground_delay_s(self) -> float: ...  # noqa: D102
    @property
    def ground_follows(self) -> bool: ...  # noqa: D102
    @property
    def page(self) -> str | None: ...  # noqa: D102
    @property
    def config(self) -> Config: ...  # noqa: D102


@dataclass(frozen=True, slots=True)
class Carrier:
    """The link for the ground's messages besides the direct side: the autopilot's link, or none (`lone`)."""

    link: CarriesPackets
    pilot: TextLink
    system_id: int
    signing: Signing | None = None
    listen: Callable[[Callable[[Message, float], object]], object] = lambda _hear: None
    clock: Callable[[], float] = time.monotonic
    lone: LoneVehicle | None = None


def carried_by(link: MavlinkLink) -> Carrier:
    """The autopilot's link as the carrier."""
    client = link.client
    return Carrier(link, client, client.vehicle_id or 1, client.packets.signing, link.listeners.append)


def carried_alone(clock: Callable[[], float]) -> Carrier:
    """The carrier of a simulated vehicle without an autopilot; `clock` is the loop's clock."""
    vehicle = LoneVehicle()
    return Carrier(vehicle, vehicle, vehicle.system_id, clock=clock, lone=vehicle)


def check_ground(command: RunCommand) -> None:
    """Raise UsageError for invalid options of the ground station."""
    if command.ground not in (None, LINK):
        require_link("--ground", command.ground)
        if is_same_place(command.link.removeprefix("mavsdk+").replace("://", ":"), command.ground):
            raise UsageError(
                f"--ground {command.ground} and --link {command.link} are one place, and only one of them can have it: "
                "give --ground another port, or --ground link for a ground station behind the autopilot"
            )
        host = command.ground.partition(":")[2].rpartition(":")[0]
        is_open = command.ground.startswith("udp") and reach_of(host) is Reach.NETWORK
        if is_open and command.signing_key is None and (command.ground_follows or not command.ground_unsigned):
            raise UsageError(
                f"--ground {command.ground} hears everybody on the network, who must not choose the target or order "
                "FOLLOW: give --signing-key (or --ground-unsigned, which allows the choice but not --ground-follows)"
            )
    video_address(command)


def is_same_place(link: str, ground: str) -> bool:
    """Whether two addresses, the first perhaps in MAVSDK's notation, cannot both be opened: a port or a device."""
    try:
        (kind, name, number), (other_kind, other_name, other) = parse_address(link), parse_address(ground)
    except LinkError:  # another notation of MAVSDK; opening the link reports errors
        return False
    if kind != other_kind:
        return False
    if kind == "serial":
        return os.path.realpath(name) == os.path.realpath(other_name)
    hosts = {numeric(host) for host in (name, other_name)}
    return number == other and (len(hosts) == 1 or (kind == "udpin" and "0.0.0.0" in hosts))


def numeric(host: str) -> str:
    """The usual form of an IPv4 address: 127.1, 127.000.000.001 and localhost are 127.0.0.1, and 0 is 0.0.0.0."""
    if host.lower() == "localhost":
        return "127.0.0.1"
    try:
        return socket.inet_ntoa(socket.inet_aton(host))
    except OSError:  # a name
        return host


def video_address(command: GroundCommand) -> VideoAddress | None:
    """The video's destination, None for no video; by default the directly connected ground stations."""
    if command.video_out is None:
        is_direct = command.ground is not None and command.ground.startswith("udp")
        return VideoAddress() if is_direct else None
    if command.video_out == NO_VIDEO:
        return None
    try:
        return parse_video(command.video_out)
    except ValueError as error:
        raise UsageError(f"--video-out: {error}") from None


@contextlib.contextmanager
def ground_sides(
    command: GroundCommand, carrier: Carrier, lens: Intrinsics, consoles: Consoles, report: Notify
) -> Generator[list[Callable[[Tick], object]], None, None]:
    """The consumers of ticks for the ground: the camera with --ground, else the pilot's texts, and the video."""
    with contextlib.ExitStack() as stack:
        sees: list[Callable[[Tick], object]] = []
        address, video = video_address(command), None
        if address is not None:
            video = VideoOut(address, command.config.video, report, carrier.clock)
            stack.callback(video.close)
            sees.append(video.see)
        if command.ground is not None:
            ground = ground_side(command, carrier, lens, consoles, address, video)
            stack.callback(ground.close)
            sees.append(ground.see)
        elif command.page is not None and carrier.lone is None:
            texts = PilotTexts(carrier.pilot)
            consoles.tell = texts.say
            sees.append(texts.see)
        if video is not None:
            sees.append(DelayWatch(video, command.ground_delay_s, report).see)
        yield sees


def ground_side(
    command: GroundCommand,
    carrier: Carrier,
    lens: Intrinsics,
    consoles: Consoles,
    address: VideoAddress | None,
    video: VideoOut | None,
) -> GroundSide:
    """The ground stations of this flight: behind the autopilot, and direct ones at the address of --ground."""
    signing = carrier.signing
    direct = DirectSide(open_transport(command.ground), signing) if command.ground not in (None, LINK) else None
    size, stream = (lens.width, lens.height), None
    if address is not None:
        stream = description_of(address, command.config.video, size, math.degrees(lens.horizontal_fov_rad))
    choose = partial(consoles.choose, flies=command.ground_follows)  # a box on the page never flies by itself
    camera = GroundCamera(size, choose, stream, command.ground_delay_s, signing)
    camera.address(carrier.system_id)
    heard = video.hear_stations if video is not None else None
    texts = PilotTexts(carrier.pilot)
    consoles.tell = texts.say
    ground = GroundSide(carrier.link, camera, consoles, texts, direct, heard, carrier.lone)
    carrier.listen(ground.hear)
    return ground


@dataclass(slots=True)
class DelayWatch:
    """Reports once if the video's delay exceeds the one assumed for a person's selections (--ground-delay-s)."""

    video: VideoOut
    assumed_s: float
    report: Notify
    has_reported: bool = False

    def see(self, _tick: Tick) -> None:
        """Take one round."""
        delay_s = self.video.delay_s
        if delay_s > self.assumed_s and not self.has_reported:
            self.has_reported = True
            self.report(
                f"video: frames leave {delay_s:.2f} s after they were taken, but --ground-delay-s is "
                f"{self.assumed_s:g}: what is selected will be looked for too late; lower video.width or video.rate_hz"
            )
