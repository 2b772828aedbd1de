"""The joint estimate: position, velocity, ground gradient and size of the target in one Kalman filter.

The state is x = (n, e, d, v_n, v_e, m_n, m_e, l, b_x, b_y, b_s):

- n, e, d: the middle of the target's box, local NED, metres;
- v_n, v_e: its velocity over the ground, m/s;
- m_n, m_e: the ground's gradient, metres down per metre north and east.  Walking along it moves the target down or up,
  so the ground's height becomes uncertain with the distance that the target went;
- l: the logarithm of its size in metres, a constant with a prior.  Size is sqrt(width x height) of the first box; later
  boxes are compared by height alone, because RACF's boxes keep their height and not their width (docs/estimate.md);
- b_x, b_y, b_s: the tracker's slowly varying errors, right and down in radians, and of the logarithm of height.

A box measures directions, and lengths in proportion to the size: boxes never tell the size itself.  (The vehicle's own
acceleration might, against a target that does not accelerate; with one that turns when the vehicle turns it is false.)
So the covariance is that for a known size, the size's variance is kept beside it, and only the ground corrects it.

Prediction is linear in these.  Correction is linear in another basis: the error along the line of sight as a logarithm
of range, and across it as two angles.  The covariance is turned into that basis for each correction and back after it
(an EKF in log-spherical coordinates; for why range and size then stay consistent see Aidala and Hammel, "Utilization of
modified polar coordinates for bearings-only tracking", IEEE Trans. AC 28(3), 1983).
"""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from follow.geometry import Array
from follow.ranges import require_numbers

SIZE = 11
N, E, D, VN, VE, MN, ME, L, BX, BY, BS = range(SIZE)
STIRRED = 6.0
"""Squared Mahalanobis distance (three degrees of freedom) of a box that counts as a manoeuvre: noise exceeds it in
11 % of frames."""

SURPRISE_M_S = 1.5
"""Standard deviation added to the velocity in a frame that shows a manoeuvre."""

STIR_KEPT = math.exp(-1 / 90)
"""Decay of `stir` per box that matches its prediction: a time constant of 90 boxes, 3 s."""

TREND_KEPT = math.exp(-1 / 10)
"""Decay of `trend` per box, over about 10: in a turn each box is off by less than its noise, but all to one side."""

CLEAR_M = 0.5
"""Lower limit of a line of sight's length: nearer, directions are meaningless."""


@dataclass(frozen=True, slots=True)
class Motion:
    """Process noise.  Raises ValueError for a number out of its range."""

    accel_psd: float = 0.4  # Spectral density of the target's acceleration, m²/s³: lower lags, higher is noisier.
    turn_psd: float = 0.05  # Added to accel_psd times the speed squared, 1/s: faster targets turn harder.
    calm: float = 0.02  # Fraction of accel_psd and turn_psd kept while the boxes match their prediction.
    slope_std: float = 0.06  # Standard deviation of the ground's gradient: most paths have 0 to 10 %, 20 % is rare.
    slope_length_m: float = 200.0  # Correlation length of the ground's gradient.
    vertical_psd: float = 1e-3  # Spectral density of other vertical motion, m²/s: gait, kerbs.
    angle_bias_std_rad: float = 0.007  # Slowly varying error of a bearing: a small autopilot's attitude, the box.
    size_bias_std: float = 0.1  # Slowly varying error of the box's height: RACF's was 0.09 RMS over thirty flights.
    bias_s: float = 30.0  # Correlation time of the slowly varying errors.

    def __post_init__(self) -> None:
        require_numbers("target motion setting", self, may_be_zero=("vertical_psd", "turn_psd"))


@dataclass(frozen=True, slots=True)
class JointFilter:
    """State of the filter at `t_s`: mean (11,) and covariance (11, 11) in the order of the module's docstring.

    The covariance is that for a known size: its row and column L are zero, and `size_var` is the variance of l.
    `stir` scales the process noise: 1 for a target that manoeuvres as hard as `Motion` expects, 0 for a steady one.
    `trend` (3,) is the sum of the past whitened innovations, each multiplied by TREND_KEPT per box.
    """

    t_s: float
    mean: Array
    covariance: Array
    size_var: float
    stir: float = 1.0
    trend: Array = field(default_factory=lambda: np.zeros(3))

    @property
    def size_m(self) -> float:
        """The target's sqrt(width x height)."""
        return math.exp(float(self.mean[L]))


@dataclass(frozen=True, slots=True)
class Sight:
    """One box as measured: unit vector (3,) to its middle in NED, and ln(size / distance).

    The size is the box's height over the square root of the first box's height over width.
    """

    toward: Array
    size_log: float


def predicted(f: JointFilter, t_s: float, m: Motion) -> JointFilter:
    """The filter predicted to `t_s`; an earlier `t_s` returns it unchanged.

    White acceleration of density q: Q = q [[t³/3, t²/2], [t²/2, t]] on each axis (Bar-Shalom et al., 2001, §6.2.2).
    The gradient and the biases are first-order Gauss-Markov processes (ibid. §8.2), over distance and over time.
    """
    dt = t_s - f.t_s
    if dt <= 0:
        return f
    mean, v = f.mean.copy(), f.mean[VN : VE + 1]
    distance_m = dt * math.sqrt(float(v @ v) + f.covariance[VN, VN] + f.covariance[VE, VE])
    keep_slope, keep_bias = math.exp(-distance_m / m.slope_length_m), math.exp(-dt / m.bias_s)
    step = np.eye(SIZE)
    step[N, VN] = step[E, VE] = dt
    step[D, VN : VE + 1] = dt * mean[MN : ME + 1]
    step[D, MN : ME + 1] = dt * v
    step[MN, MN] = step[ME, ME] = keep_slope
    step[BX, BX] = step[BY, BY] = step[BS, BS] = keep_bias
    mean[N] += dt * mean[VN]
    mean[E] += dt * mean[VE]
    mean[D] += dt * float(mean[MN : ME + 1] @ v)
    mean[MN : ME + 1] *= keep_slope
    mean[BX:] *= keep_bias
    covariance = step @ f.covariance @ step.T + process_noise(v, distance_m, f.stir, dt, m)
    return replace(f, t_s=t_s, mean=mean, covariance=covariance)


def process_noise(v: Array, distance_m: float, stir: float, dt: float, m: Motion) -> Array:
    """(11, 11) covariance added in `dt` to a target that moves `distance_m` along v."""
    noise = np.zeros((SIZE, SIZE))
    q = (m.calm + (1 - m.calm) * stir) * (m.accel_psd + m.turn_psd * float(v @ v))
    for position, speed in ((N, VN), (E, VE)):
        noise[position, position] = q * dt**3 / 3
        noise[position, speed] = noise[speed, position] = q * dt**2 / 2
        noise[speed, speed] = q * dt
    per_m = 2 * m.slope_std**2 / m.slope_length_m
    course = v / max(float(np.linalg.norm(v)), 1e-3)
    noise[D, D] = per_m * distance_m**3 / 3 + m.vertical_psd * dt
    noise[D, MN : ME + 1] = noise[MN : ME + 1, D] = per_m * distance_m**2 / 2 * course
    forgotten = m.slope_std**2 * -math.expm1(-2 * distance_m / m.slope_length_m)
    noise[MN, MN] = noise[ME, ME] = forgotten
    bias = -math.expm1(-2 * dt / m.bias_s)
    noise[BX, BX] = noise[BY, BY] = bias * m.angle_bias_std_rad**2
    noise[BS, BS] = bias * m.size_bias_std**2
    return noise


def sight_axes(away: Array) -> tuple[float, Array]:
    """Length of a vector (3,) in NED, and its axes (3, 3) in columns: right (level), down across it, and along it."""
    length = max(float(np.linalg.norm(away)), CLEAR_M)
    along = away / max(float(np.linalg.norm(away)), 1e-9)
    level = math.hypot(along[0], along[1])
    right = np.array([-along[1], along[0], 0.0]) / level if level > 1e-6 else np.array([0.0, 1.0, 0.0])
    return length, np.stack([right, np.cross(along, right), along], axis=1)


def in_sight(covariance: Array, length: float, axes: Array, *, back: bool = False) -> Array:
    """The covariance with position as (angle right, angle down, ln range) instead of (n, e, d), or back."""
    turn = np.eye(SIZE)
    turn[:3, :3] = length * axes if back else axes.T / length
    return turn @ covariance @ turn.T


@dataclass(frozen=True, slots=True)
class Innovation:
    """A box minus its prediction: (3,) right, down (radians) and ln size, and its covariance (3, 3)."""

    residual: Array
    covariance: Array

    @property
    def distance2(self) -> float:
        """Squared Mahalanobis distance, of three degrees of freedom."""
        return float(self.residual @ np.linalg.solve(self.covariance, self.residual))

    @property
    def whitened(self) -> Array:
        """The innovation (3,) as three independent numbers of standard deviation 1."""
        return np.linalg.solve(np.linalg.cholesky(self.covariance), self.residual).astype(np.float64)


OBSERVE = np.zeros((3, SIZE))
OBSERVE[0, [0, BX]] = OBSERVE[1, [1, BY]] = 1.0
OBSERVE[2, [2, BS]] = -1.0, 1.0


def innovation(f: JointFilter, camera_ned: Array, sight: Sight, noise: Array) -> Innovation:
    """A box minus its prediction; `noise` (3,) holds the standard deviations of its white errors."""
    length, axes = sight_axes(f.mean[:3] - camera_ned)
    p = in_sight(f.covariance, length, axes)
    right, down, along = axes.T @ sight.toward
    along = max(float(along), 0.1)
    expected = f.mean[L] - math.log(length) + f.mean[BS]
    residual = np.array([right / along - f.mean[BX], down / along - f.mean[BY], sight.size_log - expected])
    return Innovation(residual, OBSERVE @ p @ OBSERVE.T + np.diag(noise**2))


def corrected(f: JointFilter, camera_ned: Array, sight: Sight, noise: Array) -> JointFilter:
    """The filter after a box seen from `camera_ned` (3,): Kalman's update in Joseph's form, for a known size."""
    length, axes = sight_axes(f.mean[:3] - camera_ned)
    p = in_sight(f.covariance, length, axes)
    step = innovation(f, camera_ned, sight, noise)
    trend = TREND_KEPT * f.trend + step.whitened
    together2 = (1 - TREND_KEPT**2) * float(trend @ trend)
    stir = max(f.stir * STIR_KEPT, min(max(step.distance2, together2) / STIRRED, 1.0))
    gain = np.linalg.solve(step.covariance, OBSERVE @ p).T
    keep = np.eye(SIZE) - gain @ OBSERVE
    p = keep @ p @ keep.T + (gain * noise**2) @ gain.T
    change = gain @ step.residual
    toward = axes @ np.array([change[0], change[1], 1.0])
    away = toward / np.linalg.norm(toward) * length * math.exp(min(max(change[2], -1.0), 1.0))
    mean = f.mean + change
    mean[:3] = camera_ned + away
    if step.distance2 > STIRRED:  # the target turned or set off: widen its velocity on both axes
        p[[VN, VE], [VN, VE]] += SURPRISE_M_S**2
    return replace(f, mean=mean, covariance=in_sight(p, *sight_axes(away), back=True), stir=stir, trend=trend)


def height_row(f: JointFilter, camera_ned: Array, middle: float) -> tuple[float, Array]:
    """The camera's height over the ground under the target, and its derivative (11,) by the state.

    `middle` is how high the middle of the box lies over that ground, in sizes.
    """
    row = np.zeros(SIZE)
    row[[D, L]] = 1.0, middle * f.size_m
    return float(f.mean[D] - camera_ned[2]) + middle * f.size_m, row


def scaled(f: JointFilter, camera_ned: Array, velocity: Array, change: float) -> JointFilter:
    """The filter with the size, the range and the velocity relative to the camera multiplied by exp(change).

    `velocity` (2,) is the camera's own, north and east.
    """
    mean, length, axes = f.mean.copy(), *sight_axes(f.mean[:3] - camera_ned)
    factor = math.exp(change)
    mean[:3] = camera_ned + factor * (f.mean[:3] - camera_ned)
    mean[VN : VE + 1] = velocity + factor * (f.mean[VN : VE + 1] - velocity)
    mean[L] += change
    p = in_sight(in_sight(f.covariance, length, axes), factor * length, axes, back=True)
    return replace(f, mean=mean, covariance=p)


def with_size(f: JointFilter, camera_ned: Array, velocity: Array) -> Array:
    """The covariance (11, 11) including the size's variance, which scales all lengths together."""
    derivative = np.zeros(SIZE)  # of the state by l
    derivative[:3] = f.mean[:3] - camera_ned
    derivative[VN : VE + 1] = f.mean[VN : VE + 1] - velocity
    derivative[L] = 1.0
    return f.covariance + f.size_var * np.outer(derivative, derivative)


def started(
    t_s: float,
    camera_ned: Array,
    sight: Sight,
    velocity: Array,
    speed_std_m_s: float,
    size_m: float,
    size_std: float,
    noise: Array,
    m: Motion,
) -> JointFilter:
    """The filter after the first box, by the size's prior alone; `size_std` is relative."""
    length, axes = sight_axes(sight.toward * size_m / math.exp(sight.size_log))
    mean = np.zeros(SIZE)
    mean[:3] = camera_ned + length * axes[:, 2]
    mean[VN : VE + 1] = velocity
    mean[L] = math.log(size_m)
    angle = m.angle_bias_std_rad**2
    # The first box defines the size, its error included: b_s begins at zero.
    p = np.diag(
        [
            *(noise[:2] ** 2 + angle),
            noise[2] ** 2,
            *[speed_std_m_s**2] * 2,
            *[m.slope_std**2] * 2,
            0.0,
            angle,
            angle,
            0.0,
        ]
    )
    p[0, BX] = p[BX, 0] = p[1, BY] = p[BY, 1] = -angle
    return JointFilter(t_s, mean, in_sight(p, length, axes, back=True), size_std**2)


def moved(f: JointFilter, jump_ned: Array) -> JointFilter:
    """The filter after the vehicle's own position estimate jumped by (3,) metres: the target jumps with it."""
    mean = f.mean.copy()
    mean[:3] += jump_ned
    return replace(f, mean=mean)
