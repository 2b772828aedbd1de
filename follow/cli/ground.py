"""The ground station's side of `follow run`: the camera that it points in, and the video that it shows."""

import contextlib
import math
import os
from collections.abc import Callable, Generator
from dataclasses import dataclass

from follow.cli.commands import RunCommand
from follow.geometry import Intrinsics
from follow.link import LinkError
from follow.link.connection import MavlinkLink
from follow.link.transports import Reach, open_transport, parse_address, reach_of
from follow.messages import Notify, Tick
from follow.operator.consoles import Consoles
from follow.operator.ground import DirectSide, GroundSide
from follow.operator.ground_camera import GroundCamera
from follow.operator.told import PilotTexts
from follow.operator.video_out import VideoAddress, VideoOut, description_of, parse_video
from racf.commandline import UsageError

LINK = "link"  # --ground: behind the autopilot
NO_VIDEO = "none"  # --video-out: none, also if a ground station is heard


def check_ground(command: RunCommand) -> None:
    """Raise UsageError or LinkError for options of the ground station that cannot be."""
    if command.ground not in (None, LINK):
        parse_address(command.ground)
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
    except LinkError:  # the link's notation is MAVSDK's own; it says so itself
        return False
    if kind != other_kind:
        return False
    if kind == "serial":
        return os.path.realpath(name) == os.path.realpath(other_name)
    hosts = {"127.0.0.1" if host == "localhost" else host for host in (name, other_name)}
    return number == other and (len(hosts) == 1 or (kind == "udpin" and "0.0.0.0" in hosts))


def video_address(command: RunCommand) -> VideoAddress | None:
    """Where the video goes, None for nowhere: by default to the ground stations that talk to us directly."""
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
    command: RunCommand, link: MavlinkLink, lens: Intrinsics, consoles: Consoles, report: Notify
) -> Generator[list[Callable[[Tick], object]], None, None]:
    """What takes each tick for the ground: its camera if --ground names one, else the pilot's texts, and the video."""
    with contextlib.ExitStack() as stack:
        sees: list[Callable[[Tick], object]] = []
        address, video = video_address(command), None
        if address is not None:
            video = VideoOut(address, command.config.video, report)
            stack.callback(video.close)
            sees.append(video.see)
        if command.ground is not None:
            ground = ground_side(command, link, lens, consoles, address, video)
            stack.callback(ground.close)
            sees.append(ground.see)
        elif command.page is not None:
            texts = PilotTexts(link.client)
            consoles.tell = texts.say
            sees.append(texts.see)
        if video is not None:
            sees.append(DelayWatch(video, command.ground_delay_s, report).see)
        yield sees


def ground_side(
    command: RunCommand,
    link: MavlinkLink,
    lens: Intrinsics,
    consoles: Consoles,
    address: VideoAddress | None,
    video: VideoOut | None,
) -> GroundSide:
    """The ground stations of this flight: behind the autopilot, and directly at the address that was given."""
    signing = link.client.packets.signing
    direct = DirectSide(open_transport(command.ground), signing) if command.ground not in (None, LINK) else None
    size, stream = (lens.width, lens.height), None
    if address is not None:
        stream = description_of(address, command.config.video, size, math.degrees(lens.horizontal_fov_rad))
    camera = GroundCamera(size, consoles.choose, stream, command.ground_delay_s, signing)
    camera.address(link.client.vehicle_id or 1)
    heard = video.hear_stations if video is not None else None
    texts = PilotTexts(link.client)
    consoles.tell = texts.say
    ground = GroundSide(link, camera, consoles, texts, direct, heard)
    link.listeners.append(ground.hear)
    return ground


@dataclass(slots=True)
class DelayWatch:
    """Reports once that the video leaves later than a person's selections are dated (--ground-delay-s)."""

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
