"""One frozen tree of settings; each part owns its own branch and says why its numbers are what they are."""

import math
from collections.abc import Mapping, Set
from dataclasses import dataclass, field, fields, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, TypeVar

from follow.control.servo import ServoConfig
from follow.control.target import TargetConfig
from follow.geometry import Intrinsics
from follow.recording.recorder import RecordConfig
from follow.safety.limits import Limits

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

BranchT = TypeVar("BranchT", bound="DataclassInstance")


@dataclass(frozen=True, slots=True)
class CameraConfig:
    """How the camera sees, how late, and how it is mounted.  Raises ValueError for what no camera has."""

    fov_deg: float = 70.0  # horizontal; common FPV and action cameras, undistorted, lie between 60 and 90
    down_deg: float = 30.0  # optical axis below the nose: 10 m up, the middle of the picture is 17 m ahead
    delay_s: float = 0.0  # a device's or stream's, from exposure to arrival; RTSP on one machine: 0.01 JPEG, 0.05 H.264

    def __post_init__(self) -> None:
        if not 1 <= self.fov_deg <= 170:
            raise ValueError(f"a pinhole's horizontal field of view lies in 1..170 degrees, not {self.fov_deg:g}")
        if not 0 <= self.delay_s <= 1:
            raise ValueError(f"a camera's delay lies in 0..1 s, not {self.delay_s:g}")
        if not -90 <= self.down_deg <= 90:
            raise ValueError(f"a camera looks -90..90 degrees below the nose, not {self.down_deg:g}")

    @property
    def down_rad(self) -> float:
        """The mounting angle in radians."""
        return math.radians(self.down_deg)

    def intrinsics(self, width: int, height: int) -> Intrinsics:
        """The pinhole for pictures of this size."""
        return Intrinsics.from_fov(width, height, math.radians(self.fov_deg))


@dataclass(frozen=True, slots=True)
class Config:
    """Every setting of a flight."""

    camera: CameraConfig = field(default_factory=CameraConfig)
    target: TargetConfig = field(default_factory=TargetConfig)
    servo: ServoConfig = field(default_factory=ServoConfig)
    limits: Limits = field(default_factory=Limits)
    record: RecordConfig = field(default_factory=RecordConfig)


def beneath(branch: str, chosen: BranchT, suggested: Mapping[str, Any], named: Set[str]) -> BranchT:
    """The settings of a branch with suggested values, except where a person chose: see `named` of `suited`.

    Raises TypeError for a suggestion that is not a setting.
    """
    unknown = set(suggested) - {f.name for f in fields(chosen)}
    if unknown:
        raise TypeError(f"{type(chosen).__name__} has no setting {', '.join(sorted(unknown))}")
    return replace(chosen, **{name: value for name, value in suggested.items() if f"{branch}.{name}" not in named})


def suited(
    chosen: Config,
    named: Set[str],
    lens: Intrinsics,
    suggested: Mapping[str, Mapping[str, float]] = MappingProxyType({}),
) -> Config:
    """The settings to fly with: what a person chose, above what a scenario suggests, above what the lens does.

    `named` are the settings of `chosen` that a person gave, as "branch.name"; `suggested` holds settings by branch.
    Raises TypeError for a suggestion that is not a setting.
    """
    limits = {"half_view_rad": lens.horizontal_fov_rad / 2, **suggested.get("limits", {})}
    branches = {**suggested, "limits": limits}
    return replace(
        chosen, **{name: beneath(name, getattr(chosen, name), values, named) for name, values in branches.items()}
    )
