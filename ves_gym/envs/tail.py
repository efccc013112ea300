"""Energy the base keeps after an episode, in closed form: the linearised motion's integral.

With the joints held by their servos, x' = A x for x = (Y, dq, Y', q'), and the integral of
x^T W x over N samples is x_0^T P x_0 with P = sum (A_h^k)^T W A_h^k, by doubling.
Within 1 % of the simulated tail (tests/envs/test_tail.py).
"""

from __future__ import annotations

import numpy as np

from ves_gym._util.params import Array
from ves_gym.mechanics.dynamics import inertia
from ves_gym.mechanics.modes import sum_quadratic
from ves_gym.mechanics.spatial import matvec
from ves_gym.system.system import System

_DOUBLINGS = 10  # 1024 samples: 10 ms apart over 10 s
_HALVINGS = 4  # of the sample step, for the series of the exponential


def tail_energy(
    system: System, q: Array, x: Array, kp: Array, kd: Array, *, seconds: float
) -> tuple[Array, Array]:
    """Time integrals of E and of the strain energy over the tail [J s].

    Args:
        system: mode ideal.
        q: (k, joints) joint angles.
        x: (k, 2 (6 + joints)) base pose, distance of the joints from where they are held, and
            the rates of both.
        kp, kd: (k, joints) gains that hold the joints.
    """
    k, base, m = len(q), system.base, q.shape[1]
    size = 6 + m
    H = inertia(system.arm, q)
    H[:, :6, :6] += base.mass_matrix
    K, D = np.zeros((2, k, size, size))
    K[:, :6, :6], D[:, :6, :6] = base.K, base.D
    joints = np.arange(6, size)
    K[:, joints, joints], D[:, joints, joints] = kp, kd
    if system.drive == "prescribed":  # perfect servos: the joints are locked
        x = np.concatenate([x[:, :6], x[:, size : size + 6]], axis=1)
        H, K, D, size = H[:, :6, :6], base.K[None], base.D[None], 6
    A = np.zeros((k, 2 * size, 2 * size))
    A[:, :size, size:] = np.eye(size)
    A[:, size:, :size] = -np.linalg.solve(H, np.broadcast_to(K, H.shape))
    A[:, size:, size:] = -np.linalg.solve(H, np.broadcast_to(D, H.shape))
    h = seconds / 2**_DOUBLINGS
    step = _exponential(A * (h / 2**_HALVINGS))
    for _ in range(_HALVINGS):
        step = step @ step
    strain = np.zeros((k, 2 * size, 2 * size))
    strain[:, :6, :6] = base.K / 2
    total = strain.copy()
    total[:, size : size + 6, size : size + 6] = H[:, :6, :6] / 2
    weights = np.stack([total, strain])
    sums, step = sum_quadratic(step, weights, _DOUBLINGS)
    end = matvec(step, x)
    out = []
    for W, P in zip(weights, sums, strict=True):
        first, last, inner = (
            np.einsum("ki,kij,kj->k", z, B, z) for z, B in ((x, W), (end, W), (x, P))
        )
        out.append(h * (inner + (last - first) / 2))  # trapezoids
    return out[0], out[1]


def _exponential(A: Array) -> Array:
    """exp of small matrices (k, n, n) by its series."""
    eye = np.eye(A.shape[-1])
    out = eye
    for order in range(8, 0, -1):
        out = eye + A @ out / order
    return np.asarray(out, dtype=np.float64)
