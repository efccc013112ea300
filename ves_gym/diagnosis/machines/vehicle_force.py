"""Force that a vehicle in space takes: along a measured motion, and by frequency."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy

from ves_gym._util.params import Array
from ves_gym.diagnosis.data.measured_run import Run
from ves_gym.diagnosis.machines.recursions import stepped
from ves_gym.mechanics.spatial import body_wrench, matvec, rate_matrix
from ves_gym.mechanics.vehicle import BaseModel, InternalModes

_FADES = 0.4  # of the samples at a run's ends that derivatives guess at
_LINE = 1.6e-3  # s, the longest straight line: 0.1 % of a tone of 12 Hz


def vehicle_gap(run: Run, base: BaseModel) -> Array:
    """Return what a run with y and w has of wrench less what moves the vehicle (..., T, 6)."""
    turn, force = along_rates(run)
    y, yd, ydd = run.base
    force = force - (ydd @ base.M.T + yd @ base.D.T + y @ base.K.T)
    if base.body is not None:
        force = force - matvec(turn, body_wrench(base.body.spatial(), y, yd, ydd))
    if base.drag is not None:
        force = force - base.drag * np.abs(yd) * yd
    if base.internal is not None:
        force = force + force_of_states(base.internal, _driven(base.internal, run), yd)
    return np.asarray(force)


def dynamic_stiffness(base: BaseModel, turn: Array, w: Array) -> Array:
    """Return the force per motion of a base (K, 6, 6) at w (K,) rad/s, without drag.

    `turn` (6, 6) makes the twist from rates of the pose.
    """
    s = 1j * w[:, None, None]
    mass = base.M if base.body is None else base.M + turn.T @ base.body.spatial() @ turn
    out = base.K + s * base.D + s**2 * mass
    if base.internal is not None:
        out = out - _internal(base.internal, w)
    return np.asarray(out)


def _internal(modes: InternalModes, w: Array) -> Array:
    """Force of internal modes (K, 6, 6) per motion of the base; as `vehicle_gap` has it."""
    m, P, C = modes.m, modes.coupling, modes.damping
    s = 1j * w[:, None, None]
    drive = -(s**2) * P.T - s * (C[6:, :6] + C[6:, 6:] @ P.T)
    e = np.linalg.solve(s**2 * np.eye(m) + s * C[6:, 6:] + np.diag(modes.omega**2), drive)
    lost = s * C[:6, :6] + C[:6, 6:] @ (s * e + s * P.T)
    return np.asarray((P * modes.omega**2) @ e - lost)


def along_rates(run: Run) -> tuple[Array, Array]:
    """Return the map (..., T, 6, 6) from w to forces along the rates of y, and the force."""

    def make() -> tuple[Array, Array]:
        turn = np.swapaxes(rate_matrix(run.base.x), -1, -2)
        return turn, matvec(turn, run["w"])

    return run.derived("along rates", ("y", "w"), make)


@dataclass(frozen=True)
class InnerStart:
    """One of the 2 m states of a vehicle's internal modes that a run began with, 1 of its unit.

    States are the ways of the modes against the vehicle [m kg^1/2], then their rates.
    """

    run: str
    state: int

    def force(self, run: Run, base: BaseModel) -> Array:
        """Return the force (T, 6) of the free decay on the vehicle; zeros in other runs."""
        modes, still = base.internal, np.zeros((run["y"].shape[-2], 6))
        if run.name != self.run or modes is None:
            return still
        value, vector = np.linalg.eig(_free(modes) * run.dt)
        share = np.linalg.inv(vector)[:, self.state]
        states = (np.exp(value * np.arange(len(still))[:, None]) * share) @ vector.T
        return force_of_states(modes, states.real, still)


def inner_sizes(run: Run, modes: InternalModes) -> Array:
    """Return (2 m,) the largest states of internal modes in a run; it may rest for long."""
    states = _driven(modes, run)
    return np.asarray(np.abs(states.reshape(-1, *states.shape[-2:])[0]).max(axis=0))


def force_of_states(modes: InternalModes, states: Array, yd: Array) -> Array:
    """Return the force (..., T, 6) of m internal modes on a base of rates yd (..., T, 6).

    States (..., T, 2 m) are ways against the base, then their rates.
    """
    m, P, C = modes.m, modes.coupling, modes.damping
    rate = states[..., m:] + yd @ P
    lost = yd @ C[:6, :6].T + rate @ C[:6, 6:].T
    return np.asarray(states[..., :m] @ (P * modes.omega**2).T - lost)


def _free(modes: InternalModes) -> Array:
    """Generator (2 m, 2 m) of the states of internal modes on a base at rest."""
    m = modes.m
    return np.block(
        [[np.zeros((m, m)), np.eye(m)], [-np.diag(modes.omega**2), -modes.damping[6:, 6:]]]
    )


def _driven(modes: InternalModes, run: Run) -> Array:
    """States (..., T, 2 m) of internal modes on a base that moves as measured, from rest.

    What is guessed at where a run begins would ring on through it: it is faded in.
    Their way against the base, e = u - P^T Y, is driven by it and comes to lie in a few states
    that decay by themselves. Lines between points of a spline through the samples are so short
    that they take nothing away (of a tone they take (w dt)^2 / 12).
    """
    m, P, C, dt = modes.m, modes.coupling, modes.damping, run.dt
    begun = np.clip(np.arange(run.length) / max(_FADES * run.window.skip, 1), 0.0, 1.0)
    begun = np.sin(np.pi / 2 * begun)[:, None] ** 2
    _, *rates = run.base
    yd, ydd = (x * begun for x in rates)
    drive = -(ydd @ P) - yd @ (C[6:, :6] + C[6:, 6:] @ P.T).T
    finer, T = math.ceil(dt / _LINE), yd.shape[-2]
    if finer > 1:
        spline = scipy.interpolate.CubicSpline(np.arange(T), drive, axis=-2)
        drive, dt = spline(np.arange((T - 1) * finer + 1) / finer), dt / finer
    B = np.vstack([np.zeros((m, m)), np.eye(m)])
    step, at, _, direct, _ = scipy.signal.cont2discrete(
        (_free(modes), B, np.eye(2 * m), np.zeros((2 * m, m))), dt, method="foh"
    )
    pushes = (drive @ at.T).reshape(-1, drive.shape[-2], 2 * m)
    moved = stepped(step, pushes, 0 * pushes[:, 0]).reshape(*drive.shape[:-1], 2 * m)
    return np.asarray((moved + drive @ direct.T)[..., ::finer, :])
