"""The parts of a port that go from sample to sample: how a gear gives, how friction grows."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np

from ves_gym._util.params import Array
from ves_gym.engine.kernel.compiled_function import CompiledFunction

_PARTS = 8  # of the time between samples, in which a link crosses its gap


@lru_cache
def _function(text: Callable[..., Any], *widths: int) -> CompiledFunction:
    """(x, u, p) -> (x at the next sample, y) of NumPy text on rows."""
    return CompiledFunction.of((text.__name__, widths), text, *widths, in_place=True)


def deflection(
    torque: Array,
    stiffness: float,
    damping: float,
    half: float,
    dt: float,
    hard: float = np.inf,
) -> Array:
    """Return the angle x by which a rotor leads its link: d x' + k free(x) = torque.

    free(x) is what x has beyond half the gap on either side. A spring without a gap may harden:
    its free(x) is x (1 + (x / hard)^2). The torque is the one that goes
    through the gear, which the log holds; driven by the motion instead, a light link would
    ring, and make much of noise (derived in docs/diagnosis.md).

    Args:
        torque: (..., T) through the gear [N m].
        stiffness, damping, half: k [N m/rad], d [N m s/rad], half the gap [rad].
        dt: between samples [s].
        hard: [rad].

    Returns:
        (..., T) rad.
    """
    rows, c = torque.reshape(-1, torque.shape[-1], 1), damping / dt
    first = rows[:, 0]
    if hard < np.inf:
        thick = np.full(rows.shape, c)
        thick[:, 0] = 0.0  # it begins at rest
        u, p = np.concatenate([rows, thick], axis=2), np.array([stiffness, hard])
        out = _function(_wound, 1, 2, 2).over_time(0 * first, u, p)
    else:
        p = np.array([stiffness, c, half])
        begin = first / stiffness + half * np.sign(first)
        out = _function(_within_teeth, 1, 1, 3).over_time(begin, rows, p)
    return out.reshape(torque.shape)


def _within_teeth(x: Array, torque: Array, p: Array) -> tuple[Array, Array]:
    k, c, half = (p[:, i : i + 1] for i in range(3))
    push = torque + c * x
    # between the teeth, unless it is beyond them
    between = np.where(c > 0.0, push / np.where(c > 0.0, c, 1.0), 0.0)
    above, below = (push + k * half) / (c + k), (push - k * half) / (c + k)
    x = np.where(above > half, above, np.where(below < -half, below, between))
    return x, x


def _wound(x: Array, u: Array, p: Array) -> tuple[Array, Array]:
    """The real root of k x (1 + (x / hard)^2) + c x = push: a hyperbolic sine (Vieta)."""
    torque, c, k, hard = u[:, :1], u[:, 1:], p[:, :1], p[:, 1:]
    push = torque + c * x
    linear, size = k + c, np.abs(push)
    scale = 2 * hard * np.sqrt(linear / (3 * k))
    z = 3 * size / (linear * scale)
    third = np.log(z + np.sqrt(z * z + 1)) / 3
    x = scale / 2 * (np.exp(third) - np.exp(-third))
    for _ in range(2):  # the logarithm of about 1 has no digits of a small angle
        square = (x / hard) ** 2
        x = x - (k * x * (1 + square) + c * x - size) / (k * (1 + 3 * square) + c)
    x = np.where(push < 0.0, -x, x)
    return x, x


def crossing(load: Array, inertia: Array, damping: float, half: float, dt: float) -> Array:
    """Return the angle x (..., T) by which a rotor leads its link between teeth.

    In the gap M x'' + d x' = load: nothing holds the link, which falls behind as its rotor goes
    on. It stays where teeth meet as long as the load presses it there (derived in
    docs/diagnosis.md, What a gear does at a port).

    Args:
        load: (..., T) torque that the link would take if it followed its rotor [N m].
        inertia: (T,) M of the link about its joint, others held [kg m^2].
        damping: d of the oil in the gap [N m s/rad].
        half: the gap [rad].
        dt: between samples [s].
    """
    rows = load.reshape(-1, load.shape[-1])
    u = np.stack([rows, np.broadcast_to(inertia, rows.shape)], axis=2)
    side = np.sign(rows[:, :1])  # on which teeth meet; 0: none do
    # x, x', side, and load and inertia at the sample before
    begin = np.concatenate([half * side, 0 * side, side, u[:, 0]], axis=1)
    p = np.array([damping, half, dt / _PARTS])
    out = _function(_crossed, 5, 2, 3).over_time(begin, u[:, 1:], p)[..., 0]
    return np.concatenate([begin[:, :1], out], axis=1).reshape(load.shape)


def _crossed(state: Array, u: Array, p: Array) -> tuple[Array, Array]:
    x, v, side, load, inertia = (state[:, i : i + 1] for i in range(5))
    c, half, h = (p[:, i : i + 1] for i in range(3))
    for part in range(_PARTS):
        share = (part + 0.5) / _PARTS
        push = (1 - share) * load + share * u[:, :1]
        M = (1 - share) * inertia + share * u[:, 1:]
        side = np.where(side * push < 0.0, 0.0, side)
        free = side == 0.0
        v = np.where(free, (M * v + h * push) / (M + h * c), v)
        x = np.where(free, x + h * v, x)
        lands = free & (np.abs(x) >= half)
        side = np.where(lands, np.sign(x), side)
        x, v = np.where(lands, half * side, x), np.where(lands, 0.0, v)
    return np.concatenate([x, v, side, u], axis=1), x


def stepped(step: Array, pushes: Array, begin: Array) -> Array:
    """Return the states (m, T, n) of x[t + 1] = step x[t] + pushes[t].

    Args:
        step: (n, n).
        pushes: (m, T, n).
        begin: (m, n) the first states.
    """
    n = len(step)
    return _function(_linear, n, n, n * n).over_time(begin, pushes, step.ravel())


def _linear(x: Array, push: Array, step: Array) -> tuple[Array, Array]:
    n = x.shape[1]
    return (step.reshape(-1, n, n) @ x[..., None])[..., 0] + push, x


def follow(law: Array, part: Array) -> Array:
    """Return rows that go a part of the way to their law in every sample.

    Args:
        law: (m, T, n).
        part: (m, T, n) of the way, 0 to 1.
    """
    m, length, n = law.shape
    u = np.moveaxis(np.stack([law, part]), 3, 1).reshape(2, n * m, length)
    out = _function(_followed, 1, 2).over_time(u[0, :, :1], np.moveaxis(u, 0, 2))
    return np.moveaxis(out.reshape(n, m, length), 0, 2)


def _followed(x: Array, u: Array) -> tuple[Array, Array]:
    x = x + u[:, 1:] * (u[:, :1] - x)
    return x, x


def wrenches(
    M: Array,
    D: Array,
    K: Array,
    offset: Array,
    applied: Array,
    ways: Array,
    output: Array,
    back: Array,
    target: Array,
    start: Array,
    dt: float,
    ahead: float,
) -> tuple[Array, Array, Array, Array]:
    """Invert a period of `implicit_step` and one of length `ahead` under the same force.

    Found is how much of each of n forces makes the second step end at the target. All is
    linear in state, force and target, so one matrix per period takes a state to the next.

    Args:
        M, D, K: (N, s, s) of each period.
        offset: (N, s) force, and applied: (r, N, 6), on the first six coordinates.
        ways: (6, n) forces on them.
        output: (n, 6) measures of a pose that are brought to the target's.
        back: (12, 6) correction of the state by what is missed all the same.
        target: (r, N, 6) poses at the end of the step ahead [m, rad].
        start: (r, 2 s) coordinates and rates.
        dt, ahead: s.

    Returns:
        States (r, N, 2 s) before each period, poses and rates (r, N, 12) ahead, how much of
        each force (r, N, n), and what the pose ahead misses (r, N, 6).
    """
    length, s, _ = M.shape
    measured = np.r_[:6, s : s + 6]
    A, B = implicit_matrices(M, D, K, dt)
    # the pose ahead and its rate, by the state and by the force
    further, push = implicit_matrices(M, D, K, ahead, 6)
    further, push = further @ A, further @ B + push
    reply = push[:, :6, :6] @ ways
    measures = np.broadcast_to(output, (length, *output.shape))
    gain = np.asarray(np.linalg.solve(output @ reply, measures), np.float64)
    force = np.repeat(offset[None], len(target), axis=0)
    force[..., :6] += applied
    # poses that forces other than those found leave to be done, but for the state
    missing = target - _times(push[:, :6], force)
    miss = np.eye(6) - reply @ gain
    onward = B[:, :, :6] @ ways @ gain
    onward[:, measured] += back @ miss
    # x[t + 1] = A x + B force + onward (wanted - further x)
    flow, known = A - onward @ further[:, :6], _times(B, force) + _times(onward, missing)
    states = np.empty((len(target), length, 2 * s))
    x = start
    for t in range(length):
        states[:, t] = x
        x = x @ flow[t].T + known[:, t]
    missing = missing - _times(further[:, :6], states)
    amounts = _times(gain, missing)
    force[..., :6] += amounts @ ways.T
    rates = _times(further[:, 6:], states) + _times(push[:, 6:], force)
    return states, np.concatenate([target, rates], axis=2), amounts, _times(miss, missing)


def _times(matrices: Array, rows: Array) -> Array:
    """(N, a, b) of every instant times (r, N, b)."""
    return np.asarray((matrices @ rows[..., None])[..., 0])


def implicit_matrices(
    M: Array, D: Array, K: Array, dt: float, rows: int | None = None
) -> tuple[Array, Array]:
    """`hardware.admittance.implicit_step` as matrices of the state and of the force.

    Args:
        M, D, K: (N, s, s).
        dt: s.
        rows: the first so many coordinates and their rates; None: all.

    Returns:
        (N, 2 rows, 2 s) and (N, 2 rows, s).
    """
    s = M.shape[-1]
    k = rows or s
    loss = dt / 2 * D + dt**2 / 4 * K
    # rows of the inverse are columns of the transpose's: in turning frames D and K are not
    # symmetric
    columns = np.broadcast_to(np.eye(s)[:, :k], (len(M), s, k))
    inverse = np.swapaxes(np.linalg.solve(np.swapaxes(M + loss, 1, 2), columns), 1, 2)
    rate = np.concatenate([-dt * inverse @ K, inverse @ (M - loss)], axis=2)
    identity = np.eye(2 * s)
    pose = identity[:k] + dt / 2 * (identity[s : s + k] + rate)
    state = np.concatenate([pose, rate], axis=1)
    return state, np.concatenate([dt**2 / 2 * inverse, dt * inverse], axis=1)
