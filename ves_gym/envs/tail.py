"""Energy the base keeps after an episode, in closed form: the linearised motion's integral.

With the joints held by their servos, x' = A x for x = (Y, dq, Y', q'), and the integral of
x^T W x over N samples is x_0^T P x_0 with P = sum (A_h^k)^T W A_h^k, by doubling.
Within 1 % of the simulated tail (tests/envs/test_tail.py).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ves_gym._util.params import Array
from ves_gym.mechanics.dynamics import inertia
from ves_gym.mechanics.modes import sum_quadratic
from ves_gym.mechanics.spatial import solve_symmetric
from ves_gym.system.system import System

_DOUBLINGS = 10  # 1024 samples: 10 ms apart over 10 s
_HALVINGS = 4  # of the sample step, for the series of the exponential


def free_decay_energy(
    system: System, q: Array, x: Array, kp: Array, kd: Array, *, seconds: float
) -> tuple[Array, Array]:
    """Time integrals of E and of the strain energy over the tail [J s].

    Args:
        system: mode ideal.
        q: (k, joints) joint angles.
        x: (k, 2 (b + joints)) base pose and internal modes, b of them, distance of the joints
            from where they are held, and the rates of all.
        kp, kd: (k, joints) gains that hold the joints.
    """
    (M, D, K), blocks = system.base.full(), inertia(system.arm, q)
    b, n = len(M), system.arm.n
    H = np.zeros((len(q), b + n, b + n))
    at = np.r_[:6, b : b + n]
    H[:, at[:, None], at] = blocks
    H[:, :b, :b] += M
    eye = np.eye(2 * (b + n))
    locked = system.drive == "prescribed"
    return integrals(H, K, D, x, kp, kd, eye, seconds=seconds, locked=locked)


def integrals(
    H: Any, K: Any, D: Any, x: Any, kp: Any, kd: Any, eye: Any, *,
    seconds: float, locked: bool,
) -> tuple[Any, Any]:  # fmt: skip
    """`free_decay_energy` by operators alone: arrays of NumPy, or torch's on their device.

    Args:
        H: (k, s, s) inertia of base and joints, s = b + joints.
        K, D: (b, b) of the vehicle.
        x, kp, kd: see `free_decay_energy`.
        eye: (2 s, 2 s) identity.
        seconds: length of the tail [s].
        locked: perfect servos hold the joints.

    Returns:
        (k,) each [J s].
    """
    size, b = H.shape[-1], len(K)
    if locked:
        x = x[:, [*range(b), *range(size, size + b)]]
        H, kp, kd, size = H[:, :b, :b], kp[:, :0], kd[:, :0], b
        eye = eye[: 2 * b, : 2 * b]
    half = eye[:size, :size]
    to_base, to_joints = half[:, :b], half[:, b:]

    def matrix(base: Any, joints: Any) -> Any:
        return to_base @ base @ to_base.T + (to_joints * joints[:, None]) @ to_joints.T

    A = 0 * H[:, :1, :1] * eye
    A[:, :size, size:] = half
    A[:, size:, :size] = -solve_symmetric(H, 0 * H + matrix(K, kp))
    A[:, size:, size:] = -solve_symmetric(H, 0 * H + matrix(D, kd))
    h = seconds / 2**_DOUBLINGS
    step = _exponential(A * (h / 2**_HALVINGS), eye)
    for _ in range(_HALVINGS):
        step = step @ step
    pose, rate = eye[:, :b], eye[:, size : size + b]
    strain = 0 * step + pose @ (K / 2) @ pose.T
    total = strain + rate @ (H[:, :b, :b] / 2) @ rate.T
    out = []
    for W in (total, strain):
        P, ahead = sum_quadratic(step, W, _DOUBLINGS)
        end = (ahead @ x[..., None])[..., 0]
        first, last, inner = (_form(B, z) for B, z in ((W, x), (W, end), (P, x)))
        out.append(h * (inner + (last - first) / 2))  # trapezoids
    return out[0], out[1]


def _form(B: Any, z: Any) -> Any:
    """z^T B z (k,) of B (k, n, n) and z (k, n)."""
    return (z[:, None, :] @ B @ z[..., None])[:, 0, 0]


def _exponential(A: Any, eye: Any) -> Any:
    """exp of small matrices (k, n, n) by its series."""
    out = eye
    for order in range(8, 0, -1):
        out = eye + A @ out / order
    return out
