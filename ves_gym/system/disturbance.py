"""Measures of how base and tool move in a run, beside its energy.

Acceleration and displacement are those of the arm's mount. The tool's error is its distance
from where the commanded joint angles put it on a base at rest. Means are over the motion and
the ten seconds after it, like `E_mean`; so are peaks, between the samples as well.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ves_gym._util.params import Array, ParameterError, unit
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.flexure import expand
from ves_gym.mechanics.kinematics import joint_positions
from ves_gym.mechanics.spatial import matvec, rotation, twist, twist_rate
from ves_gym.system.energy import TAIL, Internal, Measures, base_energy, internal_motion
from ves_gym.system.frequency_weight import FAST, FrequencyWeight
from ves_gym.system.system import System

_FINEST = 2.5e-3  # s between points at which peaks are looked for, at most


@dataclass(frozen=True, kw_only=True)
class Disturbance(Measures):
    """The disturbance measures of one run; without a suffix a root mean square."""

    acceleration: float = unit("m/s^2")
    acceleration_peak: float = unit("m/s^2")
    angular: float = unit("rad/s^2")  # angular acceleration of the base
    angular_peak: float = unit("rad/s^2")
    tip: float = unit("m")
    tip_peak: float = unit("m")
    tip_end: float = unit("m")  # at the end of the motion
    displacement_peak: float = unit("m")
    rotation_peak: float = unit("rad")
    attitude_end: float = unit("rad")  # angle that the base is turned by at the end
    E_weighted: float = unit("J")  # mean energy of the base's motion after a filter


class Watched(NamedTuple):
    """Accelerations that were watched more closely than the samples show them."""

    until: float = -1.0  # s, later the samples count
    acceleration_peak: float = 0.0  # m/s^2
    angular_peak: float = 0.0  # rad/s^2
    acceleration_square: float = 0.0  # its time integral until then [m^2/s^3]
    angular_square: float = 0.0  # rad^2/s^3


MEASURES = tuple(Disturbance.units())


def mount_of(arm: Arm) -> Array:
    """Place of an arm's mount in the platform-top frame (3,) [m]."""
    return np.zeros(3) if arm.mount is None else np.array(arm.mount.position, np.float64)


def mount_acceleration(arm: Arm, y: Array, yd: Array, ydd: Array) -> tuple[Array, Array]:
    """Linear acceleration of the arm's mount and angular acceleration of the base.

    Args:
        arm: for its mount.
        y, yd, ydd: (..., 6) pose [m, rad] and its derivatives.

    Returns:
        (..., 3) in inertial axes [m/s^2], and (..., 3) in platform axes [rad/s^2].
    """
    turning, rate = twist(y, yd)[..., 3:], twist_rate(y, yd, ydd)[..., 3:]
    lever = np.broadcast_to(mount_of(arm), turning.shape)
    about = np.cross(rate, lever) + np.cross(turning, np.cross(turning, lever))
    return ydd[..., :3] + matvec(rotation(y), about), rate


def mount_displacement(arm: Arm, y: Array) -> tuple[Array, Array]:
    """Way of the arm's mount from rest, and the angle that the base is turned by.

    Args:
        arm: for its mount.
        y: (..., 6) pose [m, rad].

    Returns:
        (..., 3) [m] and (...,) [rad].
    """
    turned = rotation(y) - np.eye(3)
    # |R - 1|^2 = 8 sin^2(angle / 2): exact for small angles, unlike the trace
    sine = np.sqrt(np.sum(turned**2, axis=(-2, -1)) / 8)
    angle = 2 * np.arcsin(np.minimum(sine, 1.0))
    return y[..., :3] + matvec(turned, np.broadcast_to(mount_of(arm), y[..., :3].shape)), angle


def tool_error(arm: Arm, q: Array, q_cmd: Array, y: Array, d: Array | None = None) -> Array:
    """Way of the tool from where the command puts it on a base at rest.

    Args:
        arm: n joints.
        q, q_cmd: (..., n) joint angles as they are and as commanded [rad].
        y: (..., 6) pose of the base [m, rad].
        d: (..., p) deflections of an arm that bends [rad]; None: none.

    Returns:
        (..., 3) [m].
    """
    reach = joint_positions(arm, q)[..., -1, :] if d is None else expand(arm).tool(q, d)
    place = matvec(rotation(y), reach) + y[..., :3]
    return place - joint_positions(arm, q_cmd)[..., -1, :]


def disturbance(
    system: System,
    t: Array,
    q: Array,
    q_cmd: Array,
    y: Array,
    yd: Array,
    ydd: Array | None = None,
    *,
    duration: float,
    tail: float = TAIL,
    internal: Internal | None = None,
    weight: FrequencyWeight = FAST,
    watched: Watched | None = None,
) -> Disturbance:
    """Disturbance measures of one run.

    Args:
        system: arm and vehicle.
        t: (N,) s from the start of the motion; must reach duration + tail.
        q, q_cmd: (N, n) joint angles as they were and as commanded [rad].
        y, yd: (N, 6) pose of the base and its rate.
        ydd: (N, 6) its acceleration; default the slope of `yd`.
        duration: of the motion [s].
        tail: time after it that counts [s].
        internal: u and u' (N, m) of a base with internal modes; estimated from y and yd where
            they are not given.
        weight: filter of `E_weighted`.
        watched: what was seen of the accelerations between the samples.

    Raises:
        ParameterError: a run that is too short.
    """
    from scipy.interpolate import CubicSpline  # heavy, and no environment asks for it

    clock = t - t[0]
    if clock[-1] < duration + tail - 1e-6:
        raise ParameterError(
            f"disturbance covers the motion and {tail:g} s after it ({duration + tail:g} s),"
            f" got a run of {clock[-1]:g} s"
        )
    arm = system.arm
    count = int(np.count_nonzero(clock <= duration + tail + 1e-9))
    parts = max(1, int(np.ceil(clock[count - 1] / (count - 1) / _FINEST - 1e-9)))
    fine = np.linspace(0.0, clock[count - 1], (count - 1) * parts + 1)
    end = int(np.searchsorted(fine, duration - 1e-9))
    if ydd is None:
        ydd = CubicSpline(clock, yd)(clock, 1)
    hides = bool(system.base.hidden + arm.bends)  # motion beside pose and joints
    if not hides:
        internal = np.zeros((len(t), 0)), np.zeros((len(t), 0))
    elif internal is None:
        arm.require_rigid("an estimate of internal modes")
        internal = internal_motion(system.base, t, y, yd)
    error = tool_error(arm, q, q_cmd, y, internal[0][:, : arm.bends] if arm.bends else None)
    # one spline for all: between samples 12.5 ms apart a peak at 14 Hz may be 15 % higher
    columns = np.hstack([y, yd, ydd, error, q, *internal])
    at = CubicSpline(clock, columns)(fine)
    edges = np.cumsum([6, 6, 6, 3, arm.n, internal[0].shape[1]])
    y, yd, ydd, missed, angles, u, ud = np.split(at, edges, axis=1)

    linear, angular = mount_acceleration(arm, y, yd, ydd)
    moved, turned = mount_displacement(arm, y)
    z, zd = weight.apply(fine[1], np.hstack([y, u]), np.hstack([yd, ud]))
    observed = Watched() if watched is None else watched
    later = fine > observed.until - 1e-9  # what the samples alone tell
    coarse = slice(None, None, parts)
    pose, rate, hidden = z[coarse, :6], zd[coarse, :6], (z[coarse, 6:], zd[coarse, 6:])
    energy = base_energy(system, angles[coarse], pose, rate, hidden if hides else None)

    def mean(values: Array, times: Array, extra: float = 0.0) -> float:
        return (extra + float(np.trapezoid(values, times))) / float(fine[-1])

    def squares(values: Array) -> Array:
        return np.asarray(np.sum(values**2, axis=-1), np.float64)

    fast, turning = squares(linear[later]), squares(angular[later])
    return Disturbance(
        acceleration=mean(fast, fine[later], observed.acceleration_square) ** 0.5,
        acceleration_peak=float(max(fast.max() ** 0.5, observed.acceleration_peak)),
        angular=mean(turning, fine[later], observed.angular_square) ** 0.5,
        angular_peak=float(max(turning.max() ** 0.5, observed.angular_peak)),
        tip=mean(squares(missed), fine) ** 0.5,
        tip_peak=float(squares(missed).max()) ** 0.5,
        tip_end=float(np.linalg.norm(missed[end])),
        displacement_peak=float(squares(moved).max()) ** 0.5,
        rotation_peak=float(turned.max()),
        attitude_end=float(turned[end]),
        E_weighted=mean(energy.total, fine[coarse]),
    )


def disturbance_to_plain(measured: Disturbance | None) -> dict[str, Any]:
    """Return columns of a table: the measures, or None for each where there are none."""
    return dict.fromkeys(MEASURES) if measured is None else measured.to_dict()
