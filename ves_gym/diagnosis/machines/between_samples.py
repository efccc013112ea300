"""What happens between two samples of a log, and leaves its mark on them.

A platform that answers the steps of its command swings within each period, in time with the
samples, so that neither pose nor angles nor reading show it as what it is: aliased, it looks
like a slow motion. What the arm makes of it follows from the platform as described.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import scipy

from ves_gym._util.params import Array
from ves_gym._util.signals import differentiated
from ves_gym.diagnosis.data.measured_run import Kinematics, Run
from ves_gym.diagnosis.machines.arm_load import Load, MeasuredMotion, base_motion
from ves_gym.diagnosis.machines.platform import path_of, ridden
from ves_gym.hardware.force_sensor import low_pass
from ves_gym.mechanics.dynamics import inertia
from ves_gym.mechanics.spatial import matvec
from ves_gym.system.system import System

_STEADY = 1e-3  # rad/s: a swing that turns no friction round, a tenth of its creep
_ROUNDS = 3  # of what the swing itself changes
_EVERY = 2  # nodes of a period at which rates are given


@dataclass(frozen=True)
class BetweenSamples:
    """True values at the samples less those of the smooth motion that leads through them."""

    torque: Array  # (T, n) that motors give [N m]
    rate: Array  # (T, n) of the joints [rad/s]
    wrench: Array  # (T, k + 1, 6) on the base at the nodes of each period [N, N m]
    step: float = 0.0  # s between nodes
    swings: tuple[Array, ...] = ()  # (T, n) each, of the rate inside the period that ends there
    joints: tuple[Kinematics, ...] = ()  # at the nodes: smooth, and with their swing

    def on(self, run: Run, system: System) -> BetweenSamples:
        """Return the same on another platform; joints hardly swing otherwise, the wrench does.

        Args:
            run: see `between_samples`.
            system: with the platform.
        """
        if not self.joints:
            return self
        path = path_of(run, system)
        smooth = _smooth(path.x[:, -1], run, path.x.shape[1])
        slow, swinging = self.joints
        wrench = _load(system, swinging, path)[1] - _load(system, slow, smooth)[1]
        return replace(self, wrench=wrench)

    def reading(self, cutoff: float) -> Array:
        """Return what the sensor reads of it (T, 6) behind its filter [N, N m].

        Args:
            cutoff: of the filter [Hz].
        """
        return _filtered(self.wrench, cutoff, self.step) if self.step else self.wrench[:, -1]


def between_samples(run: Run, described: System) -> BetweenSamples:
    """Return what the platform's swing does between the samples of a log; zeros if unknown.

    Args:
        run: with q, y; known where it has y_cmd, too, and one row per control period.
        described: the system.
    """
    n = described.arm.n
    path = ridden(run, described) if described.mode == "emulated" and "y_cmd" in run else None
    if path is None:
        return BetweenSamples(np.zeros(n), np.zeros(n), np.zeros((1, 1, 6)))
    at_samples = path.x[:, -1], run["q"].reshape(-1, run.length, n)[0]
    smooth, joints = (_smooth(x, run, path.x.shape[1]) for x in at_samples)
    still = _load(described, joints, smooth)
    torque, swing = np.zeros(n), Kinematics(*(np.zeros_like(x) for x in joints))
    swings: tuple[Array, ...] = ()
    if described.drive == "motor":
        torque, swing = _giving_way(run, described, joints, path, still[0])
        if np.abs(swing.v).max() > _STEADY:
            swings = tuple(swing.v[:, :-1:_EVERY].swapaxes(0, 1))
    swinging = Kinematics(*(x + y for x, y in zip(joints, swing, strict=True)))
    wrench = _load(described, swinging, path)[1] - still[1]
    step = described.physics_dt
    return BetweenSamples(torque, swing.v[:, -1], wrench, step, swings, (joints, swinging))


def _giving_way(
    run: Run, described: System, joints: Kinematics, path: Kinematics, still: Array
) -> tuple[Array, Kinematics]:
    """Return the servos' answer to the platform's swing (T, n), and the swing of the joints.

    The equation of `_driven` has the mean inertia of each period. What inertia changes within
    it, and what joints do that swing, follow in rounds.

    Args:
        run, described: see `between_samples`.
        joints: their smooth motion at the nodes.
        path: the platform's true motion there.
        still: (T, k + 1, n) torque along its smooth one [N m].
    """
    n, nodes = described.arm.n, joints.x.shape[1]
    kp, kd = (np.zeros(n) for _ in range(2))
    if "controller" in run:
        kp, kd = (np.array(run.meta["controller"][k], float) for k in ("kp", "kd"))
    inner = inertia(described.arm, joints.x)[..., 6:, 6:]
    mean = inner.mean(axis=1)
    moved, remainder = joints, np.zeros(())
    for _ in range(_ROUNDS):
        push = _load(described, moved, path)[0] - still + remainder
        response = _driven(mean, kp, kd, push, described.physics_dt)
        slow = _smooth(response.x[:, -1], run, nodes)
        swing = Kinematics(*(x - y for x, y in zip(response, slow, strict=True)))
        moved = Kinematics(joints.x + swing.x, joints.v + swing.v, joints.a)
        remainder = matvec(inner - mean[:, None], response.a)
    torque = -kp * response.x[:, -1] - kd * response.v[:, -1] - matvec(inner, slow.a)[:, -1]
    return torque, swing


def _load(described: System, joints: Kinematics, base: Kinematics) -> Load:
    """Torque (T, k + 1, n) and wrench (T, k + 1, 6) of a motion at the nodes."""
    balanced = described.emulator_settings.joint_balance
    motion = MeasuredMotion(joints, base.x, base_motion(base), True, balanced)
    return motion.load(described.arm)


def _smooth(x: Array, run: Run, nodes: int) -> Kinematics:
    """Return the smooth motion through samples (T, c) at the nodes of each period."""
    return Kinematics(*(_at_nodes(k, nodes) for k in differentiated(x, run.dt, run.band)))


def _at_nodes(x: Array, nodes: int) -> Array:
    """Return a smooth signal (N, c) of samples at the nodes of each period (N, nodes, c).

    Each sample ends a period; the first one has none before it and holds.
    """
    instants = np.arange(len(x))[:, None] - 1 + np.linspace(0, 1, nodes)
    spline = scipy.interpolate.CubicSpline(np.arange(len(x)), x)
    return np.asarray(spline(np.maximum(instants, 0)), dtype=np.float64)


def _driven(inner: Array, kp: Array, kd: Array, push: Array, h: float) -> Kinematics:
    """Return how joints move that start from rest: inner r'' + kd r' + kp r = -push.

    Args:
        inner: (N, n, n) inertia of the joints, one per period [kg m^2].
        kp, kd: (n,) [N m/rad, N m s/rad].
        push: (N, k + 1, n) torque at the nodes of the periods, linear between [N m].
        h: s between nodes.
    """
    N, nodes, n = push.shape
    inverse = np.asarray(np.linalg.inv(inner), dtype=np.float64)
    drive = -matvec(inverse[:, None], push)
    generator = np.zeros((N, 4 * n, 4 * n))  # of r, r', drive, its slope
    a, b, c, d = (slice(k * n, (k + 1) * n) for k in range(4))
    generator[:, a, b] = generator[:, b, c] = generator[:, c, d] = np.eye(n)
    generator[:, b, a], generator[:, b, b] = -inverse * kp, -inverse * kd
    step = scipy.linalg.expm(generator * h)[:, : 2 * n]
    state, out = np.zeros(2 * n), np.empty((N, nodes, 2 * n))
    slope = np.diff(drive, axis=1) / h
    for k in range(N):
        forced = drive[k, :-1] @ step[k, :, c].T + slope[k] @ step[k, :, d].T
        hold = step[k, :, : 2 * n]
        out[k, 0] = state
        for j in range(nodes - 1):
            out[k, j + 1] = state = hold @ state + forced[j]
    angle, rate = out[..., :n], out[..., n:]
    acceleration: Array = drive - matvec(inverse[:, None], kp * angle + kd * rate)
    return Kinematics(angle, rate, acceleration)


def _filtered(wrench: Array, cutoff: float, h: float) -> Array:
    """Return what the sensor's filter makes of a wrench (N, 6), from rest.

    Args:
        wrench: (N, k + 1, 6) at the nodes of each period, linear between [N, N m].
        cutoff: Hz.
        h: s between nodes.
    """
    nodes = np.arange(wrench.shape[1]) * np.float64(h)
    hold, weights = low_pass(np.array([cutoff]), nodes)
    driven = np.swapaxes(weights[0] @ wrench, -1, -2)  # (N, 6, 2)
    state, out = np.zeros((6, 2)), np.empty((len(wrench), 6))
    for k, part in enumerate(driven):
        state = state @ hold[0].T + part
        out[k] = state[:, 0]
    return out


def butterworth(x: Array, cutoff: float, dt: float) -> Array:
    """Second-order low-pass along time of signals in the band (..., T, c), from rest."""
    b, a, zi = _coefficients(cutoff, dt)
    x = _between_lines(x)
    start = np.moveaxis(x[..., :1, :], -2, -1)  # at rest under the first value
    shape = (*x.shape[:-2], 2, x.shape[-1])
    initial = np.broadcast_to(zi[:, None] * np.swapaxes(start, -1, -2), shape)
    return np.asarray(scipy.signal.lfilter(b, a, x, axis=-2, zi=initial)[0])


def _between_lines(x: Array) -> Array:
    """Signals (..., T, c) whose straight lines from sample to sample are them, inside the band.

    Lines take away a part of what swings: with u = 2 sin(w dt / 2) they leave u^2 / (w dt)^2 of
    it. The inverse is 1 + u^2 / 12 + u^4 / 90 + u^6 / 560 + ...; -u^2 is a second difference.
    """
    out, bend = x, x
    for share in (1 / 12, 1 / 90, 1 / 560, 1 / 3150):
        ends = (
            2 * bend[..., :1, :] - bend[..., 1:2, :],
            2 * bend[..., -1:, :] - bend[..., -2:-1, :],
        )
        bend = -np.diff(np.concatenate([ends[0], bend, ends[1]], axis=-2), 2, axis=-2)
        out = out + share * bend
    return out


@lru_cache(maxsize=64)
def _coefficients(cutoff: float, dt: float) -> tuple[Array, Array, Array]:
    w = 2 * np.pi * cutoff
    system = ([w**2], [1.0, np.sqrt(2) * w, w**2])
    b, a, _ = scipy.signal.cont2discrete(system, dt, method="foh")
    b, a = np.ravel(b), np.ravel(a)
    return b, a, scipy.signal.lfilter_zi(b, a)
