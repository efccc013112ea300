"""Where a tool goes along many joint motions at once, and the way back, compiled."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from ves_gym._util.params import Array
from ves_gym.engine.kernel.compiled_function import CompiledFunction
from ves_gym.engine.kernel.numbers import geometry
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.kinematics import frames, tool_motions

_CORRECTED = 2  # Newton steps to a point
_DAMPING = 1e-4  # m^2/rad^2, of the least squares near singular configurations


def tool_points(arm: Arm, q: Array) -> Array:
    """Return the tool in platform axes (..., 3) [m] at joint angles (..., joints)."""
    return _tool(arm)(q)


def pursued(arm: Arm, q: Array, point: Array) -> tuple[Array, Array]:
    """Return joint angles (..., joints) that bring the tool to points, from angles near by.

    Args:
        arm: whose tool.
        q: (..., joints) where the search starts [rad].
        point: (..., 3) in platform axes [m].

    Returns:
        The angles, and the gap (..., 3) that the last step was to close [m].
    """

    out = _pursuit(arm)(q, point)
    return out[..., : arm.n], out[..., arm.n :]


@lru_cache(maxsize=16)
def _tool(arm: Arm) -> CompiledFunction:
    def tool(q: Array) -> Array:
        return frames(arm, q).position[..., -1, :]

    return CompiledFunction.of(f"tool {geometry(arm)}", tool, arm.n)


@lru_cache(maxsize=16)
def _pursuit(arm: Arm) -> CompiledFunction:
    def pursue(q: Array, point: Array) -> Array:
        for _ in range(_CORRECTED):
            at = frames(arm, q)
            across = tool_motions(arm, at)[..., :3]  # the Jacobian's transpose
            gap = point - at.position[..., -1, :]
            A = np.swapaxes(across, -1, -2) @ across + _DAMPING * np.eye(3)
            load = np.linalg.solve(A, gap[..., None])
            q = q + (across @ load)[..., 0]
        return np.concatenate([q, gap], axis=-1)

    return CompiledFunction.of(f"pursue {geometry(arm)}", pursue, arm.n, 3)
