"""Commanded motions: smooth to acceleration, at rest for REST seconds first and at the end."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import BPoly

REST = 2.0  # s at the beginning of every run
SHARE = {"q": 0.55, "v": 0.75, "a": 0.4}  # of the limits that a motion may use


@dataclass
class Motion:
    """q(t), v(t), a(t), each (T, n), from times (T, n): every joint may have its own clock."""

    pieces: list[Any]  # n polynomials in t
    duration: float  # s, until the command stands still

    def __call__(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        t = np.clip(t, 0.0, self.duration)
        out = [[p(t[:, j], k) for j, p in enumerate(self.pieces)] for k in range(3)]
        q, v, a = (np.stack(column, axis=1) for column in out)
        return q, v, a * (t < self.duration)

    @staticmethod
    def through(t: np.ndarray, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> Motion:
        """Quintic pieces through positions, rates and accelerations (T, n) at t (T,)."""
        rows = [np.stack([q[:, j], v[:, j], a[:, j]], axis=1) for j in range(q.shape[1])]
        return Motion([BPoly.from_derivatives(t, r) for r in rows], float(t[-1]))


def window(t: np.ndarray, start: float, end: float, ramp: float) -> np.ndarray:
    """0, quintic up in `ramp` seconds, 1, down, 0; twice differentiable."""
    up, down = np.clip((t - start) / ramp, 0, 1), np.clip((end - t) / ramp, 0, 1)
    s = lambda u: u**3 * (10 - 15 * u + 6 * u * u)  # noqa: E731
    return s(up) * s(down)


def scaled(t: np.ndarray, q0: np.ndarray, d: np.ndarray, limits: dict[str, Any]) -> Motion:
    """The offsets d (T, n) as large as joint limits allow, about q0."""
    v, a = np.gradient(d, t, axis=0, edge_order=2), None
    a = np.gradient(v, t, axis=0, edge_order=2)
    room = SHARE["q"] * np.minimum(limits["q_max"], -limits["q_min"])
    peak = lambda x: np.abs(x).max(axis=0) + 1e-9  # noqa: E731
    gain = np.minimum.reduce(
        [
            room / peak(d) * 0.8,
            SHARE["v"] * limits["v_max"] / peak(v),
            SHARE["a"] * limits["a_max"] / peak(a),
        ]
    )
    return Motion.through(t, q0 + gain * d, gain * v, gain * a)


def multisine(rng: np.random.Generator, limits: dict[str, Any], length: float) -> Motion:
    """Five sines a joint, 0.08 to 1.1 Hz, of random phase, faded in and out."""
    n = len(limits["q_max"])
    t = np.arange(0, length + 1e-9, 0.004)
    f = np.geomspace(0.08, 1.1, 5) * rng.uniform(0.85, 1.15, (n, 5))
    weight = rng.uniform(0.5, 1.0, (n, 5)) / f**0.7
    wave = np.sin(2 * np.pi * t[:, None, None] * f + rng.uniform(0, 2 * np.pi, (n, 5)))
    d = (weight * wave).sum(axis=2) * window(t, REST, length, 1.5)[:, None]
    return scaled(t, middle(rng, limits), d, limits)


def chirp(rng: np.random.Generator, limits: dict[str, Any], length: float) -> Motion:
    """A sine a joint whose frequency rises or falls between 0.1 and 0.9 Hz."""
    n = len(limits["q_max"])
    t = np.arange(0, length + 1e-9, 0.004)
    low, high = rng.uniform(0.1, 0.25, n), rng.uniform(0.5, 0.9, n)
    swap = rng.random(n) < 0.5
    low[swap], high[swap] = high[swap], low[swap]
    u = np.maximum(t - REST, 0)[:, None]
    phase = 2 * np.pi * (low * u + (high - low) * u**2 / (2 * (length - REST)))
    d = np.sin(phase + rng.uniform(0, 2 * np.pi, n)) * window(t, REST, length, 1.5)[:, None]
    return scaled(t, middle(rng, limits), d, limits)


def moves(
    rng: np.random.Generator, limits: dict[str, Any], length: float, count: int = 4
) -> Motion:
    """Quintic moves from pose to pose with stops between them, joints leaving one by one."""
    n = len(limits["q_max"])
    room = SHARE["q"] * np.minimum(limits["q_max"], -limits["q_min"])
    share = (length - REST) / count
    pieces = []
    for j in range(n):
        at, q = [0.0, REST], [rng.uniform(-room[j], room[j]) * 0.6]
        q.append(q[0])
        for k in range(count):
            start = REST + share * (k + rng.uniform(0, 0.15))
            end = REST + share * (k + rng.uniform(0.8, 0.97))
            if k == 0:
                at[1] = start
            else:
                at.append(start)
                q.append(q[-1])
            reach = (end - start) * SHARE["v"] * limits["v_max"][j] / 1.875
            reach = min(reach, (end - start) ** 2 * SHARE["a"] * limits["a_max"][j] / 5.77)
            step = rng.choice([-1, 1]) * rng.uniform(0.4, 1.0) * min(reach, room[j])
            goal = q[-1] + step if abs(q[-1] + step) < room[j] else q[-1] - step
            at.append(end)
            q.append(float(np.clip(goal, -room[j], room[j])))
        rows = np.stack([q, np.zeros(len(q)), np.zeros(len(q))], axis=1)
        pieces.append(BPoly.from_derivatives([*at, length], [*rows, rows[-1]]))
    return Motion(pieces, length)


def middle(rng: np.random.Generator, limits: dict[str, Any]) -> np.ndarray:
    """A start away from the stretched arm, where the base moves in all axes."""
    room = np.minimum(limits["q_max"], -limits["q_min"])
    return rng.uniform(0.08, 0.2, len(room)) * room * rng.choice([-1, 1], len(room))


FIRST = (multisine, moves, multisine, moves)  # three runs and the one held back
SECOND = (chirp, moves, multisine, chirp)
