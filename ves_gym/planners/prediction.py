"""Predict a motion's base energy without simulating it.

The joints follow the motion exactly and the base moves a little, so the base is linear:
with the joint momentum u(t) = H_bm(q) q' and P = M_t Y' + u,

    Y' = M_t^-1 (P - u),    P' = -D Y' - K Y.

`spectral_energy` is its undamped closed form (THEORY eq. 1). `predict` keeps damping,
servo compliance and the mean over the tail; with M_t frozen at one configuration, or along
one motion, E_mean is a quadratic function of u (`mean_energy`), which is what `direct`
minimises. A base that moves at the start (`BaseState`) adds its free response: a linear term
in u and a constant.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import scipy.linalg

from ves_gym._util.params import Array, ParameterError, Vector, finite, unit
from ves_gym.mechanics.base_model import BaseModel
from ves_gym.mechanics.dynamics import inertia
from ves_gym.mechanics.modes import Modes, natural_modes, sum_quadratic
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.servo import JointServo
from ves_gym.mechanics.spatial import matvec, quadratic
from ves_gym.system.energy import TAIL
from ves_gym.system.system import System

_DOUBLINGS = 24
_PER_SECOND = 60.0  # samples: six and more of a joint on its servo (10 Hz)
NODES = 96  # samples of a motion; energies converge to about 1e-3 (docs/physics.md)
FINE = 10  # parts of a sample for peaks, which may be as short as a joint's swing on its servo


@dataclass(frozen=True, kw_only=True)
class BaseState:
    """Motion of the base at one instant: pose and rate, and those of its internal modes.

    Without internal coordinates the modes move with the pose, as after a slow displacement.
    """

    y: Vector = unit("m, rad", default=(0.0,) * 6)  # (6,) pose
    yd: Vector = unit("m/s, rad/s", default=(0.0,) * 6)  # (6,) its rate
    u: Vector = unit("kg^0.5 m", default=())  # (m,) internal coordinates
    ud: Vector = unit("kg^0.5 m/s", default=())  # (m,) their rates

    def __post_init__(self) -> None:
        for name, size in (("y", 6), ("yd", 6), ("u", len(self.u)), ("ud", len(self.u))):
            finite(getattr(self, name), (size,), f"BaseState.{name}")

    def stacked(self, base: BaseModel) -> tuple[Array, Array]:
        """Coordinates (Y, u) of a base and their rates, (6 + m,) each.

        Raises:
            ParameterError: another number of internal coordinates than the base has.
        """
        y, yd = np.array(self.y), np.array(self.yd)
        if len(self.u) not in (0, base.m):
            raise ParameterError(
                f"BaseState.u must have {base.m} internal coordinates, got {len(self.u)}"
            )
        u, ud = (self.u, self.ud) if self.u else (base.attached(y), base.attached(yd))
        return np.r_[y, u], np.r_[yd, ud]


@dataclass(frozen=True)
class Prediction:
    """Predicted energies of a motion [J]; the measures of `system.energy`."""

    E_mean: float
    E_res: float
    E_peak: float

    def to_dict(self) -> dict[str, float]:
        """Plain numbers."""
        return asdict(self)


def spectral_energy(system: System, motion: Motion) -> float:
    """E_res = 1/2 sum_i omega_i^2 |int e^(-j omega_i t) g_i(q)^T q' dt|^2 [J].

    Undamped; modes frozen at the motion's middle configuration.
    """
    return float(modal_energies(system, motion)[1].sum())


def modal_energies(
    system: System, motion: Motion, nodes: int | None = None
) -> tuple[Modes, Array]:
    """Modes of the base at a motion's middle, and what the motion leaves in each [J].

    `nodes`: samples, by default sixteen per cycle of the fastest mode and at least 200.
    """
    T, linear = motion.duration, LinearBase(system)
    frozen = natural_modes(linear.K, linear.mass(inertia(system.arm, motion.at(T / 2).q)))
    if nodes is None:
        nodes = int(min(20_000, max(200, 16 * frozen.omega[-1] * T / (2 * np.pi))))
    t = np.linspace(0, T, nodes)
    momentum = joint_momentum(system, motion, t)  # vanishes at both ends: the trapezoid rule
    phase = np.exp(-1j * frozen.omega * t[:, None])  # is of high order there
    integral = np.trapezoid(phase * (momentum @ frozen.shapes[:6]), t, axis=0)
    return frozen, np.asarray(0.5 * frozen.omega**2 * np.abs(integral) ** 2, float)


def joint_momentum(system: System, motion: Motion, t: Array) -> Array:
    """Base momentum H_bm(q) q' of the moving joints at times t (N,): (N, 6), SI units."""
    s = motion.at(t)
    return matvec(inertia(system.arm, s.q)[..., :6, 6:], s.v)


class LinearBase:
    """Matrices of the linear base under joint motion; P = M x' + u, x' = M^-1 (P - u).

    The base's coordinates z (b) start with its pose Y (6); only these feel the arm. With a
    `servo` on motor drives the joints may give way: x = (z, joint error), with the full
    inertia matrix and the servo gains as joint stiffness and damping (feed-forward supplies
    the nominal joint torque). Otherwise the joints follow exactly and x = z.
    """

    def __init__(self, system: System, servo: JointServo | None = None) -> None:
        self.system = system
        self.base_mass, self.D, self.K = system.base.full()
        self.base_stiffness = self.K
        self.b = self.size = len(self.K)
        if servo is not None and system.drive == "motor":
            servo = servo.for_arm(system.arm, system.vehicle)
            self.size += system.arm.n
            self.D = scipy.linalg.block_diag(self.D, np.diag(servo.kd))
            self.K = scipy.linalg.block_diag(self.K, np.diag(servo.kp))
        # of x, what the arm's inertia matrix (6 + n) acts on
        self.coupled = np.r_[np.arange(6), np.arange(self.b, self.size)]

    def mass(self, H: Array) -> Array:
        """Inertia of x (..., size, size) from the arm's inertia matrices."""
        M = np.zeros((*H.shape[:-2], self.size, self.size))
        k = len(self.coupled)
        M[..., self.coupled[:, None], self.coupled] = H[..., :k, :k]
        M[..., : self.b, : self.b] += self.base_mass
        return M

    def plant(self, M: Array) -> tuple[Array, Array]:
        """A, B of s' = A s + B u with s = (x, P), over leading axes of M."""
        inverse = np.linalg.inv(M)
        zero = np.zeros_like(inverse)
        K = np.broadcast_to(self.K, M.shape)
        A = np.block([[zero, inverse], [-K, -self.D @ inverse]])
        return A, np.concatenate([-inverse, self.D @ inverse], axis=-2)

    def weight(self, M: Array) -> Array:
        """C with base energy E = s^T C s while the joints are held."""
        row = np.linalg.inv(M)[: self.b]
        strain = np.zeros_like(M)
        strain[: self.b, : self.b] = self.base_stiffness
        kinetic = row.T @ M[: self.b, : self.b] @ row
        return 0.5 * scipy.linalg.block_diag(strain, kinetic)

    def tail(self, M: Array) -> Array:
        """S with the integral of E over the tail = s^T S s, joints held."""
        return gramian(self.plant(M)[0], self.weight(M), TAIL)

    def begin(self, M: Array, base: BaseState | None, u: Array) -> Array:
        """State s = (x, P) (2 size,) at the start, the joints on their command.

        Args:
            M: (size, size) inertia there.
            base: motion of the base; None: at rest.
            u: (6,) momentum of the joints there.
        """
        s = np.zeros(2 * self.size)
        if base is not None:
            z, zd = base.stacked(self.system.base)
            s[: self.b], s[self.size :] = z, M[:, : self.b] @ zd
        s[self.size : self.size + 6] += u
        return s


class Response(NamedTuple):
    """Linear motion of base and joints while a motion is played, at evenly spaced times."""

    t: Array  # (N,) s
    x: Array  # (N, size) base coordinates, then joint angles less their command (with a servo)
    rate: Array  # (N, size)
    M: Array  # (N, size, size) inertia of x

    def at(self, t: Array, servo: JointServo) -> tuple[Array, Array]:
        """Servo torque beyond feed-forward [N m] and the joints' yielding [rad/s], (N, n)."""
        n = len(servo.kp)
        away, rate = self.x[:, -n:], self.rate[:, -n:]
        torque = -(away * np.array(servo.kp) + rate * np.array(servo.kd))
        torques, rates = (
            np.stack([np.interp(t, self.t, column) for column in part.T], axis=1)
            for part in (torque, rate)
        )
        return torques, rates


def steps_of_joints(duration: float) -> int:
    """Return steps of `respond` that show how joints yield in a motion of a duration [s]."""
    return max(NODES, math.ceil(_PER_SECOND * duration))


def respond(
    linear: LinearBase,
    motion: Motion,
    nodes: int,
    base: BaseState | None = None,
    parts: int = 1,
) -> Response:
    """Simulate the linear base, its inertia as the arm moves.

    Exponential midpoint steps: exact where the inertia is constant and the momentum
    linear over a step, second order in the change of inertia.

    Args:
        linear, motion: the base under the arm that moves, and how it does.
        nodes, parts: steps, and their parts, in which the momentum is linear and the inertia
            that of the step.
        base: its motion at the start; None: at rest.
    """
    size, count = linear.size, nodes * parts
    t = np.linspace(0, motion.duration, 2 * count + 1)
    s = motion.at(t)
    H = inertia(linear.system.arm, s.q)
    M = linear.mass(H)
    u = np.zeros((len(t), size))
    u[:, :6] = matvec(H[:, :6, 6:], s.v)

    A, B = linear.plant(M[parts :: 2 * parts])
    Phi, begin, end = hold(A, B[..., :6], motion.duration / count)
    begin, end = (np.repeat(G, parts, axis=0) for G in (begin, end))
    pushes = matvec(begin, u[:-2:2, :6]) + matvec(end, u[2::2, :6])
    z = np.zeros((count + 1, 2 * size))
    z[0] = linear.begin(M[0], base, u[0, :6])
    for k, push in enumerate(pushes):
        z[k + 1] = Phi[k // parts] @ z[k] + push

    M, x = M[::2], z[:, :size]
    rate = np.asarray(np.linalg.solve(M, (z[:, size:] - u[::2])[..., None])[..., 0], float)
    return Response(t[::2], x, rate, M)


def predict(
    system: System,
    motion: Motion,
    servo: JointServo | None = None,
    *,
    base: BaseState | None = None,
    parts: int = 1,
) -> Prediction:
    """Predict the energies of a motion on the linear base, its inertia as the arm moves.

    Args:
        system: arm and vehicle.
        motion: of the joints.
        servo: that moves them; None: they follow exactly.
        base: its motion at the start; None: at rest.
        parts: of each step (`respond`).
    """
    linear = LinearBase(system, servo)
    b = linear.b
    t, x, rate, M = respond(linear, motion, NODES, base, parts)
    E = quadratic(M[:, :b, :b], rate[:, :b]) + quadratic(linear.base_stiffness, x[:, :b])
    final = np.concatenate([x[-1], M[-1] @ rate[-1]])
    total = np.trapezoid(E, t) + final @ linear.tail(M[-1]) @ final
    mean = total / (motion.duration + TAIL)
    return Prediction(E_mean=float(mean), E_res=float(E[-1]), E_peak=float(E.max()))


def inertia_along(
    linear: LinearBase, at: npt.ArrayLike | Motion, t: Array
) -> tuple[Array, Array]:
    """Inertia of x at the nodes t (N,) and in the middle of every step.

    Of a motion; one of each where `at` is a configuration (n,) [rad], as it is then constant.
    """
    if not isinstance(at, Motion):
        M = linear.mass(inertia(linear.system.arm, at))[None]
        return M, M
    half = np.linspace(0, t[-1], 2 * len(t) - 1)
    M = linear.mass(inertia(linear.system.arm, at.at(half).q))
    return M[::2], M[1::2]


def hold(A: Array, B: Array, dt: float) -> tuple[Array, Array, Array]:
    """Exact steps of z' = A z + B u with u linear over a step: Phi, G0 (start), G1 (end).

    Args:
        A: (..., n, n). B: (..., n, m).
        dt: of the step [s].
    """
    n, m = B.shape[-2:]
    block = np.zeros((*A.shape[:-2], n + 2 * m, n + 2 * m))
    block[..., :n, :n], block[..., :n, n : n + m] = A * dt, B * dt
    block[..., n : n + m, n + m :] = np.eye(m)
    E = scipy.linalg.expm(block)
    slope = E[..., :n, n + m :]
    return E[..., :n, :n], E[..., :n, n : n + m] - slope, slope


def gramian(A: Array, C: Array, span: float) -> Array:
    """int_0^span exp(A^T t) C exp(A t) dt, by doubling from a short Simpson step."""
    h = span / 2**_DOUBLINGS
    half = scipy.linalg.expm(A * h / 2)
    full = half @ half
    first = h / 6 * (C + 4 * half.T @ C @ half + full.T @ C @ full)
    S, _ = sum_quadratic(full, first, _DOUBLINGS)
    return np.asarray((S + S.T) / 2)
