"""What a measured motion takes: torque at the joints, and the wrench of the arm on its base.

A diagnosis asks for them again and again, on every run and on its copies with noise: what
bodies take that other rotors, gears and limits move is computed once per run.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import replace
from typing import Any

import numpy as np

from ves_gym._util.params import Array
from ves_gym.diagnosis.data.measured_run import Kinematics, cached
from ves_gym.engine.kernel.maps import motion_loads
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.gravity import gravity_vector
from ves_gym.mechanics.spatial import twist, twist_rate

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
    parts = (np.broadcast_to(k, (*batch, k.shape[-1])) for k in (*joints, spin, turn, accel))
    tau, wrench = motion_loads(arm, *parts)
    return tau, -wrench


def weight_torque(arm: Arm, q: Array, pose: Array) -> Array:
    """Joint torque (..., T, n) that carries the links."""
    still = Kinematics(q, np.zeros_like(q), np.zeros_like(q))
    zeros = np.zeros((*pose.shape[:-1], 3))
    return motion_load(arm, still, (zeros, zeros, zeros), gravity_vector(pose))[0]


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
        self._memory: dict[Any, Any] = {}

    def load(self, arm: Arm) -> Load:
        """Torque that the motors give (..., T, n), and wrench of the arm (..., T, 6)."""

        def load() -> Load:
            links = tuple(replace(k, rotor_inertia=0.0, gear=None) for k in arm.links)
            bare = replace(arm, links=links)
            tau, wrench = motion_load(bare, self.joints, self.base, self.fall)
            if self.balanced:
                tau = motion_load(bare, self.joints, self.base)[0]
            return tau, wrench

        tau, wrench = cached(self._memory, "loads without rotors", bodies_of(arm), load)
        return tau + arm.column("rotor_inertia") * self.joints.a, wrench


def bodies_of(arm: Arm) -> Hashable:
    """Return all that the load of an arm without rotors depends on: bodies and their places."""
    lengths = tuple((k.d, k.a, k.alpha, k.beta, k.offset, k.slides) for k in arm.links)
    return arm.mount, arm.beside, lengths, arm.base, tuple(k.inertial for k in arm.links)
