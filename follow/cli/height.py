"""The height that follows from stand-off and camera angle, reported before a flight."""

import math

from follow.config import Config
from follow.flight.session import kept_geometry


def height_line(config: Config) -> str:
    """How high the vehicle flies above a target that stands, and why; "" in a mode that keeps its present height."""
    standoff_m, height_m = _kept(config)
    if standoff_m is None or height_m is None:
        return ""
    why = f"{standoff_m:g} m away with the camera {math.degrees(config.camera.down_rad):.3g} degrees below the nose"
    return f"will fly about {height_m:.0f} m above a target that stands: {why}"


def height_conflict(config: Config) -> str:
    """Why that height is outside the altitude band, so that the servo would always fly against the gate; else ""."""
    (standoff_m, height_m), limits = _kept(config), config.limits
    if standoff_m is None or height_m is None or limits.floor_m <= height_m <= limits.ceiling_m:
        return ""
    beyond = f"below limits.floor_m {limits.floor_m:g}"
    if height_m > limits.ceiling_m:
        beyond = f"above limits.ceiling_m {limits.ceiling_m:g}"
    down_deg = math.degrees(config.camera.down_rad)
    return (
        f"camera.down_deg {down_deg:.3g} (in degrees) and servo.standoff_m {standoff_m:g} mean {height_m:.1f} m "
        f"above the target, {beyond}: the target would not stay in the image's middle; change one of them"
    )


def height_report(config: Config) -> str:
    """The conflict as a warning or else the height, for a simulated flight; "" in a mode that keeps its height."""
    conflict = height_conflict(config)
    return f"warning: {conflict}" if conflict else height_line(config)


def _kept(config: Config) -> tuple[float | None, float | None]:
    """The stand-off and the height above the target that the mode keeps, m."""
    kept = kept_geometry(config.servo, config.camera.down_rad)
    return kept.standoff_m, kept.height_m
