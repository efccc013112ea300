"""What a measured motion takes: torque at the joints, and the wrench of the arm on its base.

Both are linear in the ten numbers of a body. A diagnosis asks for a payload again and again,
at many masses and places, on every run and on its copies with noise: so what one unit of each
number of the last link's body takes is computed once per run, and so is what bodies take that
other rotors, gears and limits move.
"""

from __future__ import annotations

import math
from collections.abc import Hashable
from dataclasses import replace
from typing import Any

import numpy as np

from ves_gym._util.params import Array
from ves_gym.diagnosis.data.measured_run import Kinematics, forget
from ves_gym.engine.kernel.maps import motion_loads
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.body_numbers import POINT_MASSES, per_number
from ves_gym.mechanics.dynamics import newton_euler
from ves_gym.mechanics.gravity import gravity_vector, mass_parameters, moment_regressor
from ves_gym.mechanics.link import Inertial
from ves_gym.mechanics.spatial import twist, twist_rate

_MANY = 300  # instants from which compiled code is faster than NumPy
_NOTHING = Inertial(mass=0.0, com=(0.0,) * 3, inertia=((0.0,) * 3,) * 3)

BaseMotion = tuple[Array, Array, Array]
Load = tuple[Array, Array]


def base_motion(base: Kinematics) -> BaseMotion:
    """Spin, its rate, and acceleration of the platform's origin, platform axes; (..., T, 3)."""
    y, yd, ydd = base
    v, vd = twist(y, yd), twist_rate(y, yd, ydd)
    spin, turn = v[..., 3:], vd[..., 3:]
    return spin, turn, vd[..., :3] + np.cross(spin, v[..., :3])


def motion_load(
    arm: Arm, joints: Kinematics, base: BaseMotion, fall: Array | None = None
) -> Load:
    """Torque (..., T, n) and wrench on the base (..., T, 6) of a measured motion.

    Args:
        arm: the arm; its links follow its motors.
        joints: of its links, (..., T, n).
        base: of `base_motion`.
        fall: (..., T, 3) free fall in platform axes [m/s^2]; none in space.
    """
    spin, turn, accel = base
    if fall is not None:
        accel = accel - fall
    batch = np.broadcast_shapes(*(k.shape[:-1] for k in (joints.x, spin, turn, accel)))
    if math.prod(batch) < _MANY:
        tau, wrench = newton_euler(arm, *joints, spin=spin, turn=turn, accel=accel)
        return tau, -wrench
    parts = (np.broadcast_to(k, (*batch, k.shape[-1])) for k in (*joints, spin, turn, accel))
    tau, wrench = motion_loads(arm, *parts)
    return tau, -wrench


def weight_torque(arm: Arm, q: Array, pose: Array) -> Array:
    """Joint torque (..., T, n) that carries the links."""
    still = Kinematics(q, np.zeros_like(q), np.zeros_like(q))
    zeros = np.zeros((*pose.shape[:-1], 3))
    return motion_load(arm, still, (zeros, zeros, zeros), gravity_vector(pose))[0]


def weight_wrench(arm: Arm, moments: Array, fall: Array) -> Array:
    """Wrench of the weight on the base (..., T, 6) (thesis eq. 3.8).

    Args:
        arm: the arm.
        moments: (..., T, 3, k) of `moment_regressor`.
        fall: (..., T, 3) free fall in platform axes [m/s^2].
    """
    mass = arm.base.mass + sum(link.inertial.mass for link in arm.links)
    moment = np.cross(moments @ mass_parameters(arm), fall)
    return np.concatenate([mass * fall, moment], axis=-1)


class MeasuredMotion:
    """A motion of joints and base, and what rigid links take in it.

    Args:
        joints: (..., T, n).
        pose: (..., T, 6) of the base.
        base: its motion.
        weighty: on Earth.
        balanced: what carries the weight is at the links themselves, not in the motors.
    """

    def __init__(
        self, joints: Kinematics, pose: Array, base: BaseMotion, weighty: bool, balanced: bool
    ) -> None:
        self.joints, self.base = joints, base
        self.fall = gravity_vector(pose) if weighty else None
        self.balanced = balanced and weighty
        self._moments: dict[Any, Array] = {}
        self._last: dict[Any, Array] = {}  # per number of the last body, by lengths
        self._loads: dict[Any, Load] = {}  # without rotors, by bodies

    def load(self, arm: Arm) -> Load:
        """Torque that the motors give (..., T, n), and wrench of the arm (..., T, 6)."""
        key = bodies_of(arm)
        if key not in self._loads:
            self._loads[key] = self._load_without_rotors(arm)
            forget(self._loads)
        tau, wrench = self._loads[key]
        return tau + arm.column("rotor_inertia") * self.joints.a, wrench

    def _load_without_rotors(self, arm: Arm) -> Load:
        links = tuple(replace(k, rotor_inertia=0.0, gear=None) for k in arm.links)
        arm = replace(arm, links=links)
        if not self.balanced or self.fall is None:
            return motion_load(arm, self.joints, self.base, self.fall)
        key = _lengths(arm)
        if key not in self._moments:
            self._moments[key] = moment_regressor(arm, self.joints.x)
        tau, wrench = motion_load(arm, self.joints, self.base)
        return tau, wrench + weight_wrench(arm, self._moments[key], self.fall)

    def load_of_last(self, arm: Arm, beyond: Array) -> Load:
        """Return what more of the last link's body takes.

        Args:
            arm: the arm.
            more: (10,) numbers of the body, in the order of `body_numbers.PARAMETERS`.
        """
        key = _lengths(arm)
        if key not in self._last:
            empty = replace(
                arm,
                base=_NOTHING,
                links=tuple(replace(k, inertial=_NOTHING) for k in arm.links),
            )
            loads = [
                np.concatenate(self._load_without_rotors(with_last(empty, point)), axis=-1)
                for point in POINT_MASSES
            ]
            self._last[key] = np.tensordot(per_number(), np.stack(loads), 1)
        both = np.tensordot(beyond, self._last[key], 1)
        return both[..., : arm.n], both[..., arm.n :]


def with_last(arm: Arm, body: Inertial) -> Arm:
    """Return the arm with another body as its last link."""
    return replace(arm, links=(*arm.links[:-1], replace(arm.links[-1], inertial=body)))


def bodies_of(arm: Arm) -> Hashable:
    """Return all that the load of an arm without rotors depends on: bodies and their places."""
    return _lengths(arm), arm.base, tuple(k.inertial for k in arm.links)


def _lengths(arm: Arm) -> Hashable:
    """What the numbers of bodies are multiplied by, beside the motion."""
    lengths = tuple((k.d, k.a, k.alpha, k.beta, k.offset, k.slides) for k in arm.links)
    return arm.mount, arm.beside, lengths
