"""Rows of the fault matrix about a camera that is not the one of the settings, and about people who are not the target.

The images show textured ground, as the true camera sees it; the program believes in a lens of 80 degrees, upright.
"""

import math
from collections.abc import Callable
from dataclasses import replace

from follow.geometry import Intrinsics
from tests.support.fault_expectations import goes_on, keeps
from tests.support.fault_rig import DOWN_RAD, FRAME_S, LENS, Rig
from tests.support.fault_rows import HOVER, Row, nothing
from tests.support.fault_rows_image import circle
from tests.support.fault_rows_motion import LEAST_M, away

PATHS = {"circles": circle, "runs away": away(3.0), "walks away": away(1.4)}
FROM_START: dict[str, object] = {"view": True, "fault_t_s": 0.01, "end_t_s": 30.0}


def lens(fov_deg: float) -> dict[str, object]:
    """A true lens of another field of view."""
    return {"lens": Intrinsics.from_fov(LENS.width, LENS.height, math.radians(fov_deg))}


CAMERAS: dict[str, dict[str, object]] = {
    "lens of 110 degrees told as 80": lens(110.0),
    "lens of 55 degrees told as 80": lens(55.0),
    "camera 10 degrees lower than told": {"true_down_rad": DOWN_RAD + math.radians(10.0)},
    "camera 10 degrees higher than told": {"true_down_rad": DOWN_RAD - math.radians(10.0)},
    "camera upside down": {"is_upside_down": True},
}

CAMERA_ROWS = tuple(
    Row(
        f"{camera}, target {how}",
        nothing,
        keeps(LEAST_M),
        {**FROM_START, **rig, "path": path},
        fast=camera == "camera upside down" and how == "circles",
        follows=False,
    )
    for camera, rig in CAMERAS.items()
    for how, path in PATHS.items()
)


def replaced(north_m: float, east_m: float, lost_s: float) -> Callable[[Rig], None]:
    """The target vanishes; somebody else, who stands that far from there, is seen after a while."""

    def inject(rig: Rig) -> None:
        north, east = rig.target_place(rig.t_s)
        rig.path = lambda _t_s: (north + north_m, east + east_m)
        rig.track = lambda track: track if rig.t_s > rig.fault_t_s + lost_s else replace(track, found=False)

    return inject


def chosen(hidden_s: float) -> Callable[[Rig], None]:
    """A person at a console chooses somebody else, who stands 6 m beside, and whom the tracker finds after a while."""

    def inject(rig: Rig) -> None:
        north, east = rig.target_place(rig.t_s)
        rig.operator.forget = rig.parts.target.forget
        rig.operator.retarget()
        rig.path = lambda _t_s: (north, east + 6.0)
        rig.track = lambda track: replace(track, found=rig.t_s > rig.fault_t_s + max(hidden_s, FRAME_S))

    return inject


OTHER_PERSON_ROWS = (
    *(
        Row(f"target lost, another person {where} after {lost_s:g} s", replaced(north_m, east_m, lost_s), HOVER)
        for where, north_m, east_m in (("18 m away", 10.0, 15.0), ("31 m away", 25.0, 18.0), ("36 m ahead", 33.0, 15.0))
        for lost_s in (2.0, 6.0)
    ),
    Row("another person is chosen in flight", chosen(0.0), goes_on(3.0), fast=True),
    Row("another person is chosen in flight, found after 0.5 s", chosen(0.5), goes_on(3.0)),
)
