"""Predict a motion's base energy without simulating it.

Base and whatever gives way move a little beside the motion of the joints, so they are linear:
with the joint momentum u(t) = H_bm(q) q' and P = M_t Y' + u,

    Y' = M_t^-1 (P - u),    P' = -D Y' - K Y,

and terms of first order in what the joints yield (`Transport`; docs/physics.md, section 6).
`spectral_energy` is the undamped closed form (THEORY eq. 1). `predict` keeps damping, servo
compliance and the mean over the tail; with M_t frozen at one configuration, or along a motion,
E_mean is a quadratic function of u (`mean_energy`), which is what `direct` minimises. A base
that moves at the start (`BaseState`) adds its free response: a linear term in u and a constant.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import scipy.integrate
import scipy.linalg

from ves_gym._util.params import Array, Index, ParameterError, Vector, finite, unit
from ves_gym.mechanics.carried import linear_joints
from ves_gym.mechanics.dynamics import inertia, inverse_dynamics
from ves_gym.mechanics.linear_motion import LinearMotion
from ves_gym.mechanics.modes import Modes, natural_modes, sum_quadratic
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.pointing import about_centre
from ves_gym.mechanics.servo import JointServo
from ves_gym.mechanics.spatial import matvec, quadratic
from ves_gym.planners.momentum import momentum, torque
from ves_gym.system.energy import TAIL
from ves_gym.system.system import System

_DOUBLINGS = 24
_HELD = 1200  # steps for the torque of held joints: to 1e-2 of its limit at 2 s, 1e-4 from 16 s
_PER_SECOND = 60.0  # samples: six and more of a joint on its servo (10 Hz)
NODES = 96  # samples of a motion; energies converge to about 1e-3 (docs/physics.md)
FINE = 10  # parts of a sample for peaks, which may be as short as a joint's swing on its servo


@dataclass(frozen=True, kw_only=True)
class BaseState:
    """Motion of the base at one instant: pose and rate, and those of what moves in it.

    Internal coordinates as a log's columns u: flexures of the arm, wheels and appendages,
    internal modes. Without them modes move with the pose, as after a slow displacement, and
    nothing else does.
    """

    y: Vector = unit("m, rad", default=(0.0,) * 6)  # (6,) pose
    yd: Vector = unit("m/s, rad/s", default=(0.0,) * 6)  # (6,) its rate
    u: Vector = unit("rad, m, kg^0.5 m", default=())  # (k,) internal coordinates
    ud: Vector = unit("rad/s, m/s, kg^0.5 m/s", default=())  # (k,) their rates

    def __post_init__(self) -> None:
        for name, size in (("y", 6), ("yd", 6), ("u", len(self.u)), ("ud", len(self.u))):
            finite(getattr(self, name), (size,), f"BaseState.{name}")

    def stacked(self, system: System) -> tuple[Array, Array]:
        """Coordinates (Y, u) of a system's base and their rates, (6 + k,) each.

        Raises:
            ParameterError: another number of internal coordinates than the base has.
        """
        base, bends = system.base, system.arm.bends
        y, yd = np.array(self.y), np.array(self.yd)
        if len(self.u) not in (0, bends + base.hidden):
            raise ParameterError(
                f"BaseState.u must have {bends + base.hidden} internal coordinates, got"
                f" {len(self.u)}"
            )
        straight = np.zeros(bends)
        if self.u:
            return np.r_[y, self.u], np.r_[yd, self.ud]
        return np.r_[y, straight, base.at_rest(y)], np.r_[yd, straight, base.at_rest(yd)]


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
    T, linear = motion.duration, LinearBase(system, start=motion.start)
    frozen = natural_modes(linear.K, linear.mass(linear.inertia(motion.at(T / 2).q)))
    if nodes is None:
        nodes = int(min(20_000, max(200, 16 * frozen.omega[-1] * T / (2 * np.pi))))
    t = np.linspace(0, T, nodes)
    load = linear.load(motion, t)  # vanishes at both ends: the trapezoid rule is of high order
    phase = np.exp(-1j * frozen.omega * t[:, None])
    integral = np.trapezoid(phase * (load @ frozen.shapes[linear.driven]), t, axis=0)
    return frozen, np.asarray(0.5 * frozen.omega**2 * np.abs(integral) ** 2, float)


class LinearBase:
    """Matrices of the linear base under joint motion; P = M x' + u, x' = M^-1 (P - u).

    x = (z, joint error, gears): the base's coordinates z (b) are its pose Y (6), deflections of
    the arm's flexures, and what is hidden in the base (appendages, internal modes). With a
    `servo` on motor drives the motors may give way: their error, with the servo gains as
    stiffness and damping (feed-forward supplies the torque on a base that stands still).
    Otherwise, and fed forward against the base as well, motors follow exactly. Last are
    deflections of geared links against their motors.

    A wheel keeps its speed about its axis, whatever the base does, so that its rotor's inertia
    there is none of the base's. A pointing law, whose moment wheels and jets give, is a spring
    and a damper about the satellite's axes; its gains go by the inertia about the centre of
    mass at the start.

    Args:
        system: arm and vehicle.
        servo: that moves the motors; None: they follow exactly.
        start: (n,) configuration at which the law began [rad]; default the middle of the range.
    """

    def __init__(
        self,
        system: System,
        servo: JointServo | None = None,
        start: npt.ArrayLike | None = None,
    ) -> None:
        self.system = system
        self.free = free = LinearMotion(system.arm, system.base)
        D, K = free.D, free.K
        if servo is not None and (system.drive != "motor" or servo.holds(system.arm)):
            servo = None
        moves = np.ones(free.size, bool)
        moves[free.motors] = servo is not None
        moves[free.wheels] = False
        if servo is not None:
            servo = servo.for_arm(system.arm, system.vehicle)
            K[free.motors, free.motors], D[free.motors, free.motors] = servo.kp, servo.kd
        self._at = np.flatnonzero(moves)
        at = self._at[:, None], self._at
        self.b = int(moves[: free.b].sum())
        self.base_stiffness = K[at][: self.b, : self.b]
        across, rotors, *_ = linear_joints(system.base.wheels)
        self._spun = np.zeros((len(self._at),) * 2)  # inertia that wheels do not share
        self._spun[:6, :6] = across @ (across / rotors).T
        self.pointing = _pointing(system, start)
        if self.pointing is not None:
            K[3:6, 3:6] += self.pointing[0]
            D[3:6, 3:6] += self.pointing[1]
        self.D, self.K, self.size = D[at], K[at], len(self._at)
        self.motors = np.flatnonzero(np.isin(self._at, free.motors))
        # of x, where the samples u act: on the pose, on flexures and gears
        self.driven = np.r_[:6, np.flatnonzero(np.isin(self._at, free.passive))]

    def inertia(self, q: npt.ArrayLike) -> Array:
        """Inertia of the arm (..., 6 + p + n, 6 + p + n) over base, p flexures and links."""
        return self.free.inertia(q)

    def mass(self, H: Array) -> Array:
        """Inertia of x (..., size, size) from the arm's `inertia`."""
        return self.free.mass(H)[..., self._at[:, None], self._at] - self._spun

    def tool(self, q: Array) -> Array:
        """Way of the tool (..., 3, size) per coordinate of x, joints at q (..., n) [m]."""
        return self.free.tool(q)[..., self._at]

    def transport(self, motion: Motion, t: Array) -> Transport:
        """Terms of first order in what the joints yield, at times t (N,) of a motion."""
        chain, s = self.free.links, motion.at(t)
        at = [chain.angles(part) for part in (s.q, s.v, s.a)]
        turned = momentum(chain.arm, *at[:2]).by_q
        by_q, by_v, _ = np.moveaxis(torque(chain.arm, *at).by, 1, 0)
        joints = self.free.joints[:, self._at]
        moved, damping, stiffness = np.zeros((3, len(t), self.size, self.size))
        moved[:, :6] = turned @ joints
        stiffness[:] = joints.T @ by_q @ joints
        damping[:] = joints.T @ (by_v - np.swapaxes(by_v, -1, -2)) @ joints / 2
        damping[:, :, :6] -= np.swapaxes(moved[:, :6], -1, -2)
        return Transport(moved, damping, stiffness)

    def base_mass(self, M: Array) -> Array:
        """Inertia of z (..., b, b) that makes the base's energy, from that of x: wheels count
        as locked."""
        return M[..., : self.b, : self.b] + self._spun[: self.b, : self.b]

    def load(self, motion: Motion, t: Array) -> Array:
        """Samples u (N, k) of a motion at even times from its start on, see `driven`.

        Momentum of the joints, then the torque that flexures and gears have to give, integrated
        over time [N m s].
        """
        s, arm = motion.at(t), self.system.arm
        across = self.inertia(s.q)[..., :6, 6 + arm.bends :]
        u = matvec(across, s.v)
        if len(self.driven) == 6:
            return u
        return np.hstack([u, running_integral(self.free.loads(s.q, s.v, s.a), t)])

    def coordinates(self, base: BaseState) -> tuple[Array, Array]:
        """z and z' (b,) of a motion of the base."""
        z, zd = (part[self._at[: self.b]] for part in base.stacked(self.system))
        return z, zd

    def base_state(self, z: Array, zd: Array) -> BaseState:
        """Motion of the base of coordinates z and z' (b,), its wheels at rest."""
        full = np.zeros((2, self.free.b))
        full[:, self._at[: self.b]] = z, zd
        (y, u), (yd, ud) = ((tuple(k[:6].tolist()), tuple(k[6:].tolist())) for k in full)
        return BaseState(y=y, yd=yd, u=u, ud=ud)

    def plant(self, M: Array, along: Transport | None = None) -> tuple[Array, Array]:
        """A, B of s' = A s + B u with s = (x, P), over leading axes of M.

        `along`: of the motion there; None: left out.
        """
        inverse, zero = np.linalg.inv(M), np.zeros(M.shape)
        moved, damping, stiffness = (zero,) * 3 if along is None else along
        D, K = self.D + damping, self.K + stiffness
        lost = D @ inverse
        A = np.block([[-inverse @ moved, inverse], [lost @ moved - K, -lost]])
        return A, np.concatenate([-inverse, lost], axis=-2)

    def weight(self, M: Array) -> Array:
        """C with base energy E = s^T C s while the joints are held."""
        row = np.linalg.inv(M)[: self.b]
        strain = np.zeros_like(M)
        strain[: self.b, : self.b] = self.base_stiffness
        kinetic = row.T @ self.base_mass(M) @ row
        return 0.5 * scipy.linalg.block_diag(strain, kinetic)

    def tail(self, M: Array) -> Array:
        """S with the integral of E over the tail = s^T S s, joints held."""
        return gramian(self.plant(M)[0], self.weight(M), TAIL)

    def begin(
        self, M: Array, base: BaseState | None, u: Array, along: Transport | None = None
    ) -> Array:
        """State s = (x, P) (2 size,) at the start, the joints on their command.

        Args:
            M: (size, size) inertia there.
            base: motion of the base; None: at rest.
            u: (k,) what drives it there, see `driven`.
            along: of the motion, from there on.
        """
        s = np.zeros(2 * self.size)
        if base is not None:
            z, zd = self.coordinates(base)
            s[: self.b], s[self.size :] = z, M[:, : self.b] @ zd
            if along is not None:
                s[self.size :] += along.momentum[0][:, : self.b] @ z
        s[self.size + self.driven] += u
        return s


def _pointing(system: System, start: npt.ArrayLike | None) -> tuple[Array, Array] | None:
    """Stiffness and damping (3, 3) of a satellite's pointing law; None without one."""
    law = getattr(system.vehicle, "pointing", None)
    if law is None:
        return None
    middle = (system.arm.column("q_min") + system.arm.column("q_max")) / 2
    H = inertia(system.arm, middle if start is None else start)
    return law.gains(about_centre(H[:6, :6] + system.base.rigid()))


class Transport(NamedTuple):
    """Terms of first order in what joints yield beside their motion (N, size, size).

    P = M x' + u + momentum x and P' = -(D + damping) x' - (K + stiffness) x: the load u is that
    of where the joints are. It is the derivative of dT/dx' by x, whose transpose is that of
    dT/dx by x'; the joints' own rows are derivatives of inverse dynamics.
    """

    momentum: Array
    damping: Array
    stiffness: Array


class Response(NamedTuple):
    """Linear motion of base and joints while a motion is played, at evenly spaced times."""

    t: Array  # (N,) s
    x: Array  # (N, size) base coordinates, then joint angles less their command (with a servo)
    rate: Array  # (N, size)
    M: Array  # (N, size, size) inertia of x
    motors: Index  # (n,) places of the motors' errors in x


class JointLoads(NamedTuple):
    """Torque and motion of the joints beyond those on a base that stands still, (N, n) each."""

    t: Array  # (N,) s
    torque: Array  # N m
    away: Array  # rad from the command
    rate: Array  # rad/s

    def at(self, t: Array) -> Array:
        """Torque (k, n) at times t (k,) [s]."""
        return np.stack([np.interp(t, self.t, column) for column in self.torque.T], axis=1)


def joint_loads(
    system: System, motion: Motion, servo: JointServo, base: BaseState | None = None
) -> JointLoads:
    """Predict what the moving base makes joints on their servo do while a motion is played.

    They yield by their gains or, fed forward against the base, need its motion's torque.

    Args:
        system, motion, servo: motors.
        base: its motion at the start; None: at rest.
    """
    linear, steps = LinearBase(system, servo, motion.start), steps_of_joints(motion.duration)
    holds = servo.holds(system.arm)
    # a joint is held against the base's acceleration: short motions shake faster modes
    run = respond(linear, motion, steps, base, math.ceil(_HELD / steps) if holds else 1)
    if not holds:
        away, rate = run.x[:, run.motors], run.rate[:, run.motors]
        torque = -(away * np.array(servo.kp) + rate * np.array(servo.kd))
        return JointLoads(run.t, torque, away, rate)
    s, accel = motion.at(run.t), np.gradient(run.rate[:, :6], run.t[1], axis=0, edge_order=2)
    moved, still = (
        inverse_dynamics(system.arm, s.q, s.v, s.a, base=at)[0]
        for at in ((run.x[:, :6], run.rate[:, :6], accel), ())
    )
    return JointLoads(run.t, moved - still, 0 * s.q, 0 * s.q)


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
    M = linear.mass(linear.inertia(motion.at(t).q))
    u = np.zeros((len(t), size))
    u[:, linear.driven] = linear.load(motion, t)

    A, B = linear.plant(M[parts :: 2 * parts], linear.transport(motion, t[parts :: 2 * parts]))
    Phi, begin, end = hold(A, B[..., linear.driven], motion.duration / count)
    begin, end = (np.repeat(G, parts, axis=0) for G in (begin, end))
    pushes = matvec(begin, u[:-2:2, linear.driven]) + matvec(end, u[2::2, linear.driven])
    z = np.zeros((count + 1, 2 * size))
    along = linear.transport(motion, t[::2])
    z[0] = linear.begin(M[0], base, u[0, linear.driven], along)
    for k, push in enumerate(pushes):
        z[k + 1] = Phi[k // parts] @ z[k] + push

    M, x = M[::2], z[:, :size]
    momentum = z[:, size:] - u[::2] - matvec(along.momentum, x)
    rate = np.asarray(np.linalg.solve(M, momentum[..., None])[..., 0], float)
    return Response(t[::2], x, rate, M, linear.motors)


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
    linear = LinearBase(system, servo, motion.start)
    b = linear.b
    t, x, rate, M, _ = respond(linear, motion, NODES, base, parts)
    E = quadratic(linear.base_mass(M), rate[:, :b]) + quadratic(linear.base_stiffness, x[:, :b])
    final = np.concatenate([x[-1], M[-1] @ rate[-1]])
    total = np.trapezoid(E, t) + final @ linear.tail(M[-1]) @ final
    mean = total / (motion.duration + TAIL)
    return Prediction(E_mean=float(mean), E_res=float(E[-1]), E_peak=float(E.max()))


def running_integral(samples: Array, t: Array) -> Array:
    """Integrate samples (N, ...) at times t (N,) from the first on.

    Simpson: trapezoids hide what a good motion leaves of a boom's swing.
    """
    out = scipy.integrate.cumulative_simpson(samples, x=t, axis=0, initial=0.0)
    return np.asarray(out, np.float64)


def inertia_along(
    linear: LinearBase, at: npt.ArrayLike | Motion, t: Array
) -> tuple[Array, Array]:
    """Inertia of x at the nodes t (N,) and in the middle of every step.

    Of a motion; one of each where `at` is a configuration (n,) [rad], as it is then constant.
    """
    if not isinstance(at, Motion):
        M = linear.mass(linear.inertia(at))[None]
        return M, M
    half = np.interp(np.arange(2 * len(t) - 1) / 2, np.arange(len(t)), t)
    M = linear.mass(linear.inertia(at.at(half).q))
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
