"""How high the vehicle flies, for the floor and the ceiling: above home, and by a rangefinder.  Pure functions.

The estimator's z = 0 may be metres above or below the start's ground, so z alone counts only while home is unknown.
"""

from follow.messages import NEVER, VehicleState

FRESH_S = 1.0
"""A height counts as unknown after this; at the maximum climb speed it is 2 m off by then."""

FAR_M = 1e6
"""A height beyond this, or one that is not a number, is invalid."""


def heights_above_home(state: VehicleState) -> list[float]:
    """Each known height above home: by home's position and by the autopilot's own report, m."""
    known: list[float] = []
    if state.home_t_s > NEVER and abs(state.home_down_m) <= FAR_M:
        known.append(state.home_down_m - state.down_m)
    if abs(state.t_s - state.above_home_t_s) <= FRESH_S and abs(state.above_home_m) <= FAR_M:
        known.append(state.above_home_m)
    return known or [-state.down_m]


def least_height_m(state: VehicleState) -> float:
    """The lowest known height, including the rangefinder's, for the floor."""
    known = heights_above_home(state)
    if abs(state.t_s - state.above_ground_t_s) <= FRESH_S and abs(state.above_ground_m) <= FAR_M:
        known.append(state.above_ground_m)
    return min(known)


def greatest_height_m(state: VehicleState) -> float:
    """The highest of the heights above home, for the ceiling."""
    return max(heights_above_home(state))
