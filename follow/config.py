"""One frozen tree of settings; each module defines its own branch, with the reason for each number.

A derived setting is None until it is set; `resolve` fills in the rest once the camera is known.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from pathlib import Path
from types import MappingProxyType

from follow.camera.calibration import fitted, read_calibration
from follow.control.servo import ServoConfig
from follow.control.target import TargetConfig
from follow.geometry import Intrinsics
from follow.operator.video_out import VideoConfig
from follow.ranges import require_at_most
from follow.recording.recorder import RecordConfig
from follow.safety.limits import Limits

Layer = Mapping[str, Mapping[str, float]]
"""Settings by branch and name, from a scenario or a kind of target."""

MOST_OF_TARGET = {
    "size_m": 10.0,  # A lorry from the side is 16 m long and 4 m high: sqrt(16 x 4) is 8.
    "middle_fraction": 1.0,  # The box's upper edge.
    "speed_std_m_s": 50.0,  # 180 km/h.
}
"""Largest plausible values: larger ones are in another unit, such as a height in cm."""

MOUNT_DEG = 30.0
"""Default mounting angle of a camera: from a height of 10 m the image's middle is 17 m ahead."""


@dataclass(frozen=True, slots=True)
class CameraConfig:
    """The camera's lens, mount and delay.  Raises ValueError for implausible values."""

    fov_deg: float = 70.0
    """Horizontal field of view of the undistorted image; most action and FPV cameras have 60 to 90."""
    calibration: str = ""
    """File that describes the lens in place of fov_deg: OpenCV's or ROS's YAML, as `follow calibrate` writes it."""
    down_deg: float | None = None
    """Angle of the optical axis below the nose. Derived: that of the drawn scene, else 30 degrees."""
    delay_s: float = 0.0
    """Delay from exposure to arrival of a device, stream or drawn scene; `follow doctor --wave` measures it."""

    def __post_init__(self) -> None:
        if not 1 <= self.fov_deg <= 170:
            raise ValueError(f"a pinhole's horizontal field of view lies in 1..170 degrees, not {self.fov_deg:g}")
        if not 0 <= self.delay_s <= 1:
            raise ValueError(f"a camera's delay lies in 0..1 s, not {self.delay_s:g}")
        if self.down_deg is not None and not -90 <= self.down_deg <= 90:
            raise ValueError(f"a camera looks -90..90 degrees below the nose, not {self.down_deg:g}")
        if self.calibration:
            read_calibration(Path(self.calibration))  # so that a bad file is refused before anything starts

    @property
    def down_rad(self) -> float:
        """The mounting angle in radians."""
        return math.radians(MOUNT_DEG if self.down_deg is None else self.down_deg)

    def intrinsics(self, width: int, height: int) -> Intrinsics:
        """The lens for images of this size.  Raises ValueError for a calibration of another aspect ratio."""
        if self.calibration:
            return fitted(read_calibration(Path(self.calibration)), width, height)
        return Intrinsics.from_fov(width, height, math.radians(self.fov_deg))


@dataclass(frozen=True, slots=True)
class Config:
    """Every setting of a flight.  Raises ValueError for an implausible target."""

    camera: CameraConfig = field(default_factory=CameraConfig)
    target: TargetConfig = field(default_factory=TargetConfig)
    servo: ServoConfig = field(default_factory=ServoConfig)
    limits: Limits = field(default_factory=Limits)
    record: RecordConfig = field(default_factory=RecordConfig)
    video: VideoConfig = field(default_factory=VideoConfig)

    def __post_init__(self) -> None:
        require_at_most("target setting", self.target, MOST_OF_TARGET)


class TargetKind(str, Enum):
    """What is followed: sets size, stand-off and speed limit together."""

    PERSON = "person"
    CYCLIST = "cyclist"
    CAR = "car"


PRESETS: Mapping[TargetKind, Layer] = MappingProxyType(
    {
        TargetKind.PERSON: {
            "target": {"size_m": 1.2, "middle_fraction": 0.5},  # sqrt(0.8 m x 1.8 m)
            "servo": {"standoff_m": 12.0},
            "limits": {"speed_m_s": 8.0, "clear_distance": 1.0},
        },
        TargetKind.CYCLIST: {
            # sqrt(w h) between 1.0 m (from behind) and 1.8 m (from the side); seen from above the box reaches over the
            # ground behind, and its middle is lower: 0.39 in the drawn scenes, 30 degrees below the horizon
            "target": {"size_m": 1.4, "middle_fraction": 0.4},
            "servo": {"standoff_m": 12.0},
            # A vehicle on a road does not vanish through a door; stopping within 12 m would allow 5.5 m/s.
            "limits": {
                "speed_m_s": 12.0,
                "clear_distance": 0.0,
            },  # 8 m/s, and half of it to catch up: as the scenario `cyclist` is flown
        },
        TargetKind.CAR: {
            "target": {"size_m": 2.5, "middle_fraction": 0.15},  # sqrt(4.2 m x 1.5 m); roof and bonnet fill the box
            "servo": {"standoff_m": 22.0},
            "limits": {
                "speed_m_s": 20.0,
                "clear_distance": 0.0,
            },  # 15 m/s, and a third of it to catch up: as the scenario `car` is flown
        },
    }
)
"""Size, stand-off and speed limit by kind of target, below a settings file and the command line."""


def resolve(config: Config, lens: Intrinsics, down_rad: float, delay_s: float) -> Config:
    """The settings with each derived one filled in unless it is set; the result has no None.

    `lens`, `down_rad` (below the nose) and `delay_s` (from exposure to arrival) are those of the camera flown with.
    """
    camera, servo, limits = config.camera, config.servo, config.limits
    return replace(
        config,
        camera=replace(camera, down_deg=_given(camera.down_deg, math.degrees(down_rad))),
        servo=replace(servo, top_rad=_given(servo.top_rad, math.atan(lens.cy / lens.fy))),
        limits=replace(
            limits,
            half_view_rad=_given(limits.half_view_rad, lens.horizontal_fov_rad / 2),
            latency_s=_given(limits.latency_s, delay_s),
        ),
    )


def _given(value: float | None, derived: float) -> float:
    return derived if value is None else value
