"""Predict a motion's base energy without simulating it.

The joints follow the motion exactly and the base moves a little, so the base is linear:
with the joint momentum u(t) = H_bm(q) q' and P = M_t Y' + u,

    Y' = M_t^-1 (P - u),    P' = -D Y' - K Y.

`spectral_energy` is its undamped closed form (THEORY eq. 1). `predict` keeps damping,
servo compliance and the mean over the tail; with M_t frozen at one configuration, E_mean
is a quadratic form in u (`MeanEnergy`), which is what `direct` minimises.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
import numpy.typing as npt
import scipy.linalg

from ves_gym._util.params import Array
from ves_gym.mechanics.dynamics import inertia
from ves_gym.mechanics.modes import sum_quadratic
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.servo import JointServo
from ves_gym.mechanics.spatial import matvec, quadratic
from ves_gym.planners.coupling import modes
from ves_gym.system.energy import TAIL
from ves_gym.system.system import System

NODES = 96  # samples of a motion; energies converge to about 1e-3 (docs/physics.md)


@dataclass(frozen=True)
class Prediction:
    """Predicted energies of a motion [J]; the measures of `system.energy`."""

    E_mean: float
    E_res: float
    E_peak: float

    def to_dict(self) -> dict[str, float]:
        """Plain numbers."""
        return asdict(self)


def spectral_energy(system: System, motion: Motion, nodes: int | None = None) -> float:
    """E_res = 1/2 sum_i omega_i^2 |int e^(-j omega_i t) g_i(q)^T q' dt|^2.

    Undamped; modes frozen at the motion's middle configuration.

    Args:
        system: arm and vehicle.
        motion: of the joints.
        nodes: samples; default sixteen per cycle of the fastest mode, at least 200.

    Returns:
        The energy [J].
    """
    T = motion.duration
    frozen = modes(system, motion.at(T / 2).q)
    if nodes is None:
        nodes = int(min(20_000, max(200, 16 * frozen.omega[-1] * T / (2 * np.pi))))
    t = np.linspace(0, T, nodes)
    momentum = joint_momentum(system, motion, t)  # vanishes at both ends: the trapezoid rule
    phase = np.exp(-1j * frozen.omega * t[:, None])  # is of high order there
    integral = np.trapezoid(phase * (momentum @ frozen.shapes), t, axis=0)
    return float(0.5 * np.sum(frozen.omega**2 * np.abs(integral) ** 2))


def joint_momentum(system: System, motion: Motion, t: Array) -> Array:
    """Base momentum H_bm(q) q' of the moving joints.

    Args:
        system: its arm moves.
        motion: of the joints.
        t: (N,) times [s].

    Returns:
        (N, 6) [kg m/s, kg m^2/s].
    """
    s = motion.at(t)
    return matvec(inertia(system.arm, s.q)[..., :6, 6:], s.v)


class LinearBase:
    """Matrices of the linear base under joint motion; P = M x' + u, x' = M^-1 (P - u).

    With a `servo` on motor drives the joints may give way: x = (Y, joint error), with
    the full inertia matrix and the servo gains as joint stiffness and damping
    (feed-forward supplies the nominal joint torque). Otherwise the joints follow exactly
    and x = Y.
    """

    def __init__(self, system: System, servo: JointServo | None = None) -> None:
        self.system, self.base = system, system.base
        self.size = 6
        self.D, self.K = self.base.D, self.base.K
        if servo is not None and system.drive == "motor":
            self.size += system.arm.n
            self.D = scipy.linalg.block_diag(self.D, np.diag(servo.kd))
            self.K = scipy.linalg.block_diag(self.K, np.diag(servo.kp))

    def mass(self, H: Array) -> Array:
        """Inertia of x (..., size, size) from the arm's inertia matrices."""
        M = H[..., : self.size, : self.size].copy()
        M[..., :6, :6] += self.base.mass_matrix
        return M

    def plant(self, M: Array) -> tuple[Array, Array]:
        """A, B of z' = A z + B u with z = (x, P), over leading axes of M."""
        inverse = np.linalg.inv(M)
        zero = np.zeros_like(inverse)
        K = np.broadcast_to(self.K, M.shape)
        A = np.block([[zero, inverse], [-K, -self.D @ inverse]])
        return A, np.concatenate([-inverse, self.D @ inverse], axis=-2)

    def weight(self, M: Array) -> Array:
        """C with base energy E = z^T C z while the joints are held."""
        row = np.linalg.inv(M)[:6]
        strain = np.zeros_like(M)
        strain[:6, :6] = self.base.K
        return 0.5 * scipy.linalg.block_diag(strain, row.T @ M[:6, :6] @ row)

    def tail(self, M: Array) -> Array:
        """S with the integral of E over the tail = z^T S z, joints held."""
        return _gramian(self.plant(M)[0], self.weight(M), TAIL)


def predict(
    system: System, motion: Motion, servo: JointServo | None = None, nodes: int = NODES
) -> Prediction:
    """Predict the energies of a motion on the linear base, its inertia as the arm moves.

    Exponential midpoint steps: exact where the inertia is constant and the momentum
    linear over a step, second order in the change of inertia.

    Args:
        system: arm and vehicle.
        motion: of the joints.
        servo: that moves them; None: they follow exactly.
        nodes: steps.

    Returns:
        E_mean, E_res and E_peak [J].
    """
    linear = LinearBase(system, servo)
    size = linear.size
    t = np.linspace(0, motion.duration, 2 * nodes + 1)
    s = motion.at(t)
    H = inertia(system.arm, s.q)
    M = linear.mass(H)
    u = np.zeros((len(t), size))
    u[:, :6] = matvec(H[:, :6, 6:], s.v)

    A, B = linear.plant(M[1::2])
    dt = motion.duration / nodes
    start, end = u[:-2:2], u[2::2]
    block = np.zeros((nodes, 2 * size + 2, 2 * size + 2))
    block[:, :-2, :-2] = A * dt
    block[:, :-2, -2] = matvec(B, end - start) * dt
    block[:, :-2, -1] = matvec(B, start) * dt
    block[:, -2, -1] = 1.0
    steps = scipy.linalg.expm(block)
    z = np.zeros((nodes + 1, 2 * size))
    for k in range(nodes):
        z[k + 1] = steps[k, :-2, :-2] @ z[k] + steps[k, :-2, -1]

    M, x = M[::2], z[:, :size]
    rate = np.asarray(np.linalg.solve(M, (z[:, size:] - u[::2])[..., None])[..., 0], float)
    E = quadratic(M[:, :6, :6], rate[:, :6]) + quadratic(linear.base.K, x[:, :6])
    final = np.concatenate([x[-1], M[-1] @ rate[-1]])
    total = np.trapezoid(E, t[::2]) + final @ linear.tail(M[-1]) @ final
    mean = total / (motion.duration + TAIL)
    return Prediction(E_mean=float(mean), E_res=float(E[-1]), E_peak=float(E.max()))


class MeanEnergy:
    """E_mean of a motion as a quadratic form, with the inertia frozen at `at`.

    E_mean = 1/2 u^T W u over the samples u (N + 1, 6) of the joint momentum H_bm(q) q'
    at the times `t`; u is held linear between them.
    """

    def __init__(
        self,
        system: System,
        at: npt.ArrayLike,
        duration: float,
        servo: JointServo | None = None,
        nodes: int = NODES,
    ) -> None:
        linear = LinearBase(system, servo)
        self.t = np.linspace(0, duration, nodes + 1)
        self.system = system
        self.hessian = self._hessian(linear, linear.mass(inertia(system.arm, at)))

    def of(self, motion: Motion) -> float:
        """E_mean of a motion [J]."""
        u = joint_momentum(self.system, motion, self.t).ravel()
        return 0.5 * float(u @ self.hessian @ u)

    def _hessian(self, linear: LinearBase, M: Array) -> Array:
        """W: (6(N + 1), 6(N + 1)) [J / (kg m/s)^2]."""
        N, size, duration = len(self.t), linear.size, float(self.t[-1])
        A, B = linear.plant(M)
        Phi, first_step, second_step = _hold(A, B[:, :6], self.t[1])
        first, second = np.empty((N, 2 * size, 6)), np.empty((N, 2 * size, 6))
        first[0], second[0] = first_step, second_step
        for k in range(1, N):
            first[k], second[k] = Phi @ first[k - 1], Phi @ second[k - 1]
        # response of the state at node k to u at node j: as the end of one step (second)
        # and as the start of the next (first)
        lagged = second.copy()
        lagged[1:] += first[:-1]
        states = np.zeros((N, 2 * size, N, 6))
        for k in range(1, N):
            states[k, :, 1 : k + 1] = lagged[:k][::-1].transpose(1, 0, 2)
            states[k, :, 0] = first[k - 1]
        # E_k = 1/2 |R_K Y|^2 + 1/2 |R_M Y'|^2 with Y' = (M^-1 (P - u))[:6]
        pose = _root(linear.base.K)
        speed = _root(M[:6, :6]) @ np.linalg.inv(M)[:6]
        rows = np.empty((N, 12, N, 6))
        rows[:, :6] = np.einsum("ab,kbjc->kajc", pose, states[:, :6])
        rows[:, 6:] = np.einsum("ab,kbjc->kajc", speed, states[:, size:])
        nodes = np.arange(N)
        rows[nodes, 6:, nodes] -= speed[:, :6]
        weight = np.full(N, self.t[1])
        weight[[0, -1]] /= 2
        rows *= np.sqrt(weight / (duration + TAIL))[:, None, None, None]
        flat = rows.reshape(12 * N, 6 * N)
        last = states[-1].reshape(2 * size, 6 * N)
        out: Array = flat.T @ flat + last.T @ (2 / (duration + TAIL) * linear.tail(M)) @ last
        return out


def _hold(A: Array, B: Array, dt: float) -> tuple[Array, Array, Array]:
    """Exact step of z' = A z + B u with u linear over the step: Phi, G0 (start), G1 (end)."""
    n, m = B.shape
    block = np.zeros((n + 2 * m, n + 2 * m))
    block[:n, :n], block[:n, n : n + m] = A * dt, B * dt
    block[n : n + m, n + m :] = np.eye(m)
    E = scipy.linalg.expm(block)
    slope = E[:n, n + m :]
    return E[:n, :n], E[:n, n : n + m] - slope, slope


def _gramian(A: Array, C: Array, span: float, doublings: int = 24) -> Array:
    """int_0^span exp(A^T t) C exp(A t) dt, by doubling from a short Simpson step."""
    h = span / 2**doublings
    half = scipy.linalg.expm(A * h / 2)
    full = half @ half
    S, _ = sum_quadratic(
        full, h / 6 * (C + 4 * half.T @ C @ half + full.T @ C @ full), doublings
    )
    out: Array = (S + S.T) / 2
    return out


def _root(K: Array) -> Array:
    """R with R^T R = K for a symmetric positive semidefinite K."""
    values, vectors = np.linalg.eigh(K)
    return np.sqrt(np.maximum(values, 0))[:, None] * vectors.T
