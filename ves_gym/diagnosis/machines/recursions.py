"""The parts of a port that go from sample to sample: how a gear gives, how friction grows."""

from __future__ import annotations

import numpy as np
from numba import njit

from ves_gym._util.params import Array

_PARTS = 8  # of the time between samples, in which a link crosses its gap
_NEWTON, _NEAR = 40, 1e-15  # steps at most to where a spring that hardens stands; rad, the last


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
    rows = np.ascontiguousarray(torque).reshape(-1, torque.shape[-1])
    if hard < np.inf:
        rows = _wound(rows, stiffness, damping / dt, hard)
    else:
        rows = _deflection(rows, stiffness, damping / dt, half)
    return np.asarray(rows).reshape(torque.shape)


@njit(cache=True)
def _deflection(torque: Array, k: float, c: float, half: float) -> Array:
    out = np.empty_like(torque)
    for row in range(torque.shape[0]):
        first = torque[row, 0]
        x = first / k + half * np.sign(first)
        for t in range(torque.shape[1]):
            push = torque[row, t] + c * x
            x = push / c if c > 0.0 else 0.0  # between the teeth, unless it is beyond them
            above, below = (push + k * half) / (c + k), (push - k * half) / (c + k)
            if above > half:
                x = above
            elif below < -half:
                x = below
            out[row, t] = x
    return out


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
    rows = np.ascontiguousarray(load).reshape(-1, load.shape[-1])
    heavy = np.ascontiguousarray(inertia)
    return np.asarray(_crossing(rows, heavy, damping, half, dt / _PARTS)).reshape(load.shape)


@njit(cache=True)
def _crossing(load: Array, inertia: Array, c: float, half: float, h: float) -> Array:
    out = np.empty_like(load)
    for row in range(load.shape[0]):
        side = np.sign(load[row, 0])  # on which teeth meet; 0: none do
        x, v = half * side, 0.0
        out[row, 0] = x
        for t in range(1, load.shape[1]):
            for part in range(_PARTS):
                share = (part + 0.5) / _PARTS
                push = (1 - share) * load[row, t - 1] + share * load[row, t]
                M = (1 - share) * inertia[t - 1] + share * inertia[t]
                if side * push < 0.0:
                    side = 0.0
                if side == 0.0:
                    v = (M * v + h * push) / (M + h * c)
                    x += h * v
                    if abs(x) >= half:
                        side = np.sign(x)
                        x, v = half * side, 0.0
            out[row, t] = x
    return out


@njit(cache=True)
def _wound(torque: Array, k: float, c: float, hard: float) -> Array:
    out = np.empty_like(torque)
    for row in range(torque.shape[0]):
        x = 0.0
        for t in range(torque.shape[1]):
            thick = c if t else 0.0  # it begins at rest
            push = torque[row, t] + thick * x
            for _ in range(_NEWTON):
                square = (x / hard) ** 2
                imbalance = k * x * (1 + square) + thick * x - push
                newton = imbalance / (k * (1 + 3 * square) + thick)
                x -= newton
                if abs(newton) < _NEAR:
                    break
            out[row, t] = x
    return out


@njit(cache=True)
def stepped(step: Array, pushes: Array, begin: Array) -> Array:
    """Return the states (m, T, n) of x[t + 1] = step x[t] + pushes[t].

    Args:
        step: (n, n).
        pushes: (m, T, n).
        begin: (m, n) the first states.
    """
    out = np.empty_like(pushes)
    for row in range(pushes.shape[0]):
        out[row, 0] = begin[row]
        for t in range(pushes.shape[1] - 1):
            out[row, t + 1] = step @ out[row, t] + pushes[row, t]
    return out


@njit(cache=True)
def follow(law: Array, part: Array) -> Array:
    """Return rows that go a part of the way to their law in every sample.

    Args:
        law: (m, T, n).
        part: (m, T, n) of the way, 0 to 1.
    """
    out = law.copy()
    for row in range(law.shape[0]):
        for t in range(1, law.shape[1]):
            for j in range(law.shape[2]):
                before = out[row, t - 1, j]
                out[row, t, j] = before + part[row, t, j] * (law[row, t, j] - before)
    return out


@njit(cache=True)
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

    Found is how much of each of n forces makes the second step end at the target; the
    response is linear, so one force of each beside none tells it.

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
    rows, length, _ = target.shape
    s, n = M.shape[1], ways.shape[1]
    states = np.empty((rows, length, 2 * s))
    sent, missed = np.empty((rows, length, 12)), np.empty((rows, length, 6))
    amounts = np.empty((rows, length, n))
    y, v, W = np.zeros((s, 1 + n)), np.zeros((s, 1 + n)), np.zeros((s, 1 + n))
    W[:6, 1:] = ways
    share = np.ones(1 + n)
    for row in range(rows):
        x = start[row].copy()
        for t in range(length):
            states[row, t] = x
            y[:, 0], v[:, 0], W[:, 0] = x[:s], x[s:], offset[t]
            W[:6, 0] += applied[row, t]
            y1, v1 = _implicit(M[t], D[t], K[t], y, v, W, dt)
            y2, v2 = _implicit(M[t], D[t], K[t], y1, v1, W, ahead)
            reply = np.dot(output, np.ascontiguousarray(y2[:6]))
            share[1:] = np.linalg.solve(
                np.ascontiguousarray(reply[:, 1:]), np.dot(output, target[row, t]) - reply[:, 0]
            )
            x[:s], x[s:] = np.dot(y1, share), np.dot(v1, share)
            amounts[row, t] = share[1:]
            sent[row, t, :6] = target[row, t]
            sent[row, t, 6:] = np.dot(v2, share)[:6]
            missed[row, t] = target[row, t] - np.dot(y2, share)[:6]
            correction = np.dot(back, missed[row, t])
            x[:6] += correction[:6]
            x[s : s + 6] += correction[6:]
    return states, sent, amounts, missed


@njit(cache=True)
def _implicit(
    M: Array, D: Array, K: Array, y: Array, v: Array, W: Array, dt: float
) -> tuple[Array, Array]:
    """Advance columns (s, c) as `hardware.admittance.implicit_step` advances one."""
    loss = dt / 2 * D + dt**2 / 4 * K
    rate = np.linalg.solve(M + loss, np.dot(M - loss, v) + dt * (W - np.dot(K, y)))
    return y + dt / 2 * (v + rate), rate
