"""Potentials over joint space and time that bound a linear functional of a motion.

For a multiplier l(t) and the joint momentum u = H(q) q' of a motion within speed limits,

    int l^T u + 1/2 u^T R u dt >= f(0, start) - f(T, goal) - int e dt

holds for every function f(t, q) and field y(t, q) with, wherever a motion can be at time t,

    e + f_t - |y|^2 / 2 - sum_i v_i |f_i + (H^T (l + R^1/2 y))_i| >= 0,

since u^T R u / 2 >= y^T R^1/2 u - |y|^2 / 2 and |q_i'| <= v_i: integrate df/dt along a motion.
Here f is a cubic in q and a part along the arm's first moment, whose gradient is the linear
part of H exactly; y is affine in q; all are linear in time over a slab, where the left side is
concave, so that only the ends of slabs matter. `residual_floor` finds a rigorous e.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from ves_gym._util.params import Array, ParameterError
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.dynamics import inertia

_DEGREE = 3  # of f in q: higher ones gained less than 2 % of the bound at 1 to 4 s
_GRID = 16  # samples of a turn of every joint, for bounds of derivatives of H
_ROWS = 6  # of H


@dataclass(frozen=True, eq=False)
class ReachableSet:
    """Angles and speeds that joints can have between two instants of rest."""

    start: Array  # (n,) rad
    goal: Array  # (n,) rad
    low: Array  # (n,) rad, joint limits
    high: Array
    speed: Array  # (n,) rad/s
    duration: float  # s

    def box(self, begin: float, end: float) -> tuple[Array, Array]:
        """Least box (n,), (n,) that holds q(t), begin <= t <= end [s]."""
        T, v = self.duration, self.speed
        shift = (self.goal - self.start) / v  # the two cones meet at (T +- shift) / 2
        sides = []
        for sign in (-1, 1):
            corner = np.clip((T + sign * shift) / 2, begin, end)
            times = np.stack([np.full_like(corner, begin), corner, np.full_like(corner, end)])
            leaving, coming = self.start + sign * v * times, self.goal + sign * v * (T - times)
            side = np.maximum(leaving, coming) if sign < 0 else np.minimum(leaving, coming)
            sides.append(side.min(axis=0) if sign < 0 else side.max(axis=0))
        return np.maximum(sides[0], self.low), np.minimum(sides[1], self.high)


class Shapes:
    """Functions of q that potentials are made of: cubic monomials, then the first moment."""

    def __init__(self, arm: Arm, centre: Array, half: Array) -> None:
        self.arm, self.centre, self.half = arm, centre, half
        n = arm.n
        powers = [
            e for e in itertools.product(range(_DEGREE + 1), repeat=n) if sum(e) <= _DEGREE
        ]
        self.powers = np.array(sorted(powers, key=sum)[1:])  # a constant in q is e's
        self.monomials = len(self.powers)
        self.count = self.monomials + 3

    def at(self, q: Array) -> tuple[Array, Array, Array, Array]:
        """Values at configurations q (P, n).

        Args:
            q: (P, n) [rad].

        Returns:
            The functions (P, count), their gradients (P, n, count), H^T (P, n, 6) and the
            affine functions (P, n + 1).
        """
        x = (q - self.centre) / self.half
        coupling = coupling_of(self.arm)
        across, moment = coupling.split(coupling.waves(q) @ coupling.table)
        value = np.hstack([self._monomials(x, self.powers), moment])
        slope = [
            self._monomials(x, *self._derived(i)) / self.half[i] for i in range(self.arm.n)
        ]
        gradient = np.concatenate([np.stack(slope, axis=1), across[:, :, :3]], axis=2)
        return value, gradient, across, np.hstack([np.ones((len(x), 1)), x])

    def _monomials(self, x: Array, powers: Array, factor: Array | float = 1.0) -> Array:
        table = x[:, None, :] ** np.arange(_DEGREE + 1)[None, :, None]  # (P, degree + 1, n)
        out = np.ones((len(x), len(powers)))
        for i in range(x.shape[1]):
            out *= table[:, powers[:, i], i]
        return np.asarray(out * factor)

    def _derived(self, i: int, powers: Array | None = None) -> tuple[Array, Array]:
        """Powers and factors of the monomials derived by x_i."""
        of = self.powers if powers is None else powers
        less = of.copy()
        less[:, i] = np.maximum(of[:, i] - 1, 0)
        return less, of[:, i].astype(float)

    def second(self, q: Array, k: int) -> Array:
        """Second derivatives of the monomials by q_k at q (P, n): (P, monomials), affine."""
        once, factor = self._derived(k)
        twice, second_derivative = self._derived(k, once)
        x = (q - self.centre) / self.half
        return self._monomials(x, twice, factor * second_derivative / self.half[k] ** 2)

    @cached_property
    def third(self) -> Array:
        """d^3 / dq_k dq_k dq_i of the monomials: (n, n, monomials), constants."""
        n = self.arm.n
        out = np.zeros((n, n, self.monomials))
        for k, i in itertools.product(range(n), repeat=2):
            once, a = self._derived(k)
            twice, b = self._derived(k, once)
            thrice, c = self._derived(i, twice)
            scale = self.half[k] ** 2 * self.half[i]
            out[k, i] = np.where(thrice.sum(axis=1) == 0, a * b * c, 0.0) / scale
        return out


class CouplingBounds:
    """H (6, n) and the first moment m c (3,) of an arm as trigonometric polynomials.

    Their entries are of degree 2 at most in every joint, so a 5^n table holds them exactly, and
    all their derivatives. Bounds over all q are from values at evenly spaced points: such a
    polynomial of degree d is nowhere larger than its largest value at N points of a turn over
    cos(pi d / N) (M. Riesz: near its maximum it is at least the maximum times cos(d x)).
    """

    def __init__(self, arm: Arm) -> None:
        n = self.n = arm.n
        turn = np.arange(_GRID) * 2 * np.pi / _GRID
        self._grid = np.array(list(itertools.product(turn, repeat=n)))
        full = inertia(arm, self._grid)
        H = np.swapaxes(full[:, :_ROWS, _ROWS:], 1, 2).reshape(len(full), -1)
        moment = np.stack([full[:, 1, 5], full[:, 2, 3], full[:, 0, 4]], axis=1)
        values = np.hstack([H, moment])
        waves = self.waves(self._grid)
        self.table = waves.T @ values / (waves**2).sum(axis=0)[:, None]  # orthogonal columns
        if np.abs(waves @ self.table - values).max() > 1e-9 * np.abs(values).max():
            raise ParameterError(f"{arm.name}: its coupling is of a degree above 2 in a joint")

    def waves(self, q: Array) -> Array:
        """Products of 1, cos, sin, cos 2, sin 2 of the joints (P, 5^n)."""
        out = np.ones((len(q), 1))
        for x in q.T:
            c, s = np.cos(x), np.sin(x)
            basis = np.stack([np.ones_like(x), c, s, c * c - s * s, 2 * c * s], axis=1)
            out = (out[:, :, None] * basis[:, None, :]).reshape(len(q), -1)
        return out

    def derived(self, *joints: int) -> Array:
        """Table of the derivative by joints, repeated ones included."""
        change = np.zeros((5, 5))  # of 1, cos, sin, cos 2, sin 2
        change[2, 1], change[1, 2], change[4, 3], change[3, 4] = -1, 1, -2, 2
        out = self.table.reshape(*[5] * self.n, -1)
        for k in joints:
            out = np.moveaxis(np.tensordot(change, out, axes=(1, k)), 0, k)
        return out.reshape(len(self.table), -1)

    def split(self, values: Array) -> tuple[Array, Array]:
        """H^T (P, n, 6) and the first moment (P, 3) from waves @ table."""
        return values[:, :-3].reshape(len(values), self.n, _ROWS), values[:, -3:]

    def most(self, *joints: int) -> tuple[Array, Array]:
        """Bounds of a derivative: of H_i's linear and angular rows (n, 2), of the moment.

        In 2-norms, over all q.
        """
        across, moment = self.split(self.waves(self._grid) @ self.derived(*joints))
        room = (1 + 1e-9) / np.cos(2 * np.pi / _GRID) ** self.n
        parts = [
            np.linalg.norm(across[:, :, s], axis=2).max(axis=0) for s in (_LINEAR, _ANGULAR)
        ]
        return room * np.stack(parts, axis=1), room * np.linalg.norm(moment, axis=1).max()


_LINEAR, _ANGULAR = slice(0, 3), slice(3, 6)


class Bends:
    """Derivatives of `CouplingBounds` and their bounds, for remainders."""

    def __init__(self, coupling: CouplingBounds) -> None:
        n = coupling.n
        self.coupling = coupling
        self.first = [coupling.derived(k) for k in range(n)]
        self.second = [coupling.derived(k, k) for k in range(n)]
        self.most_second = [[coupling.most(k, j) for j in range(n)] for k in range(n)]
        self.most_third = [[coupling.most(k, k, j) for j in range(n)] for k in range(n)]


@lru_cache(maxsize=4)
def coupling_of(arm: Arm) -> CouplingBounds:
    """`CouplingBounds` of an arm."""
    return CouplingBounds(arm)


@lru_cache(maxsize=4)
def bends_of(arm: Arm) -> Bends:
    """`Bends` of an arm."""
    return Bends(coupling_of(arm))


@dataclass(frozen=True, eq=False)
class Potential:
    """f, y and l at the ends of slabs."""

    f: Array  # (N + 1, count)
    y: Array  # (N + 1, 6, n + 1)
    l: Array  # (N + 1, 6)


@dataclass(frozen=True, eq=False)
class Setting:
    """Criteria that a potential is judged by."""

    reach: ReachableSet
    shapes: Shapes
    root: Array  # (6, 6) R^1/2
    slabs: int

    @property
    def step(self) -> float:
        """Length of a slab [s]."""
        return self.reach.duration / self.slabs

    def box(self, k: int) -> tuple[Array, Array]:
        """Box of slab k."""
        return self.reach.box(k * self.step, (k + 1) * self.step)

    def residual(self, p: Potential, k: int, q: Array) -> tuple[Array, Array]:
        """Left side less e, at both ends of slab k.

        Args:
            p: the potential.
            k: slab.
            q: (P, n) [rad].

        Returns:
            (2, P) [W], and the 2-norms (2, P, 2) of the linear and angular rows of what
            multiplies H, the first moment's part of f included.
        """
        value, slope, across, affine = self.shapes.at(q)
        rate = value @ (p.f[k + 1] - p.f[k]) / self.step
        out, sizes = [], []
        for e in (k, k + 1):
            y = affine @ p.y[e].T
            push = p.l[e] + y @ self.root
            g = slope @ p.f[e] + np.einsum("pij,pj->pi", across, push)
            out.append(rate - 0.5 * (y**2).sum(axis=1) - np.abs(g) @ self.reach.speed)
            push[:, :3] += p.f[e, -3:]
            sizes.append(
                np.stack(
                    [np.linalg.norm(push[:, s], axis=1) for s in (slice(0, 3), slice(3, 6))], 1
                )
            )
        return np.array(out), np.array(sizes)


def residual_floor(
    setting: Setting, p: Potential, k: int, tolerance: float, most: int = 60_000
) -> tuple[float, float]:
    """A number that the left side less e exceeds over all of slab k, and a value it takes.

    Boxes of q are halved until none can hold much less than the least value seen. Within a box
    of sides h the arguments of the concave left side differ from the multilinear interpolation
    of their values at its corners by at most sum_k h_k^2 / 8 max |d^2 / dq_k^2|.

    Args:
        setting: reach, shapes and R.
        p: the potential.
        k: slab.
        tolerance: between the two numbers [W], where `most` boxes are enough for it.
        most: boxes at one level.

    Returns:
        Lower bound and least value seen.
    """
    low, high = setting.box(k)
    n = len(low)
    counts = np.full(n, 5)
    h = (high - low) / counts
    lows = low + h * np.array(list(itertools.product(*[range(c) for c in counts])))
    corners = np.array(list(itertools.product((0.0, 1.0), repeat=n)))
    least, floor = np.inf, np.inf
    while True:
        q = lows[:, None, :] + h * corners
        bound, sampled, errors = _cells(setting, p, k, q.reshape(-1, n), h, len(lows))
        least = min(least, sampled)
        active = bound < least - tolerance
        if (~active).any():
            floor = min(floor, float(bound[~active].min()))
        if not active.any():
            break
        if active.sum() * len(corners) > most:
            floor = min(floor, float(bound.min()))
            break
        shares = errors[:, active].mean(axis=1)
        halved = shares > 0.4 * shares.max()  # only sides that matter
        h = np.where(halved, h / 2, h)
        halves = np.unique(corners * halved, axis=0)
        lows = (lows[active][:, None, :] + h * halves).reshape(-1, n)
    return floor, least


def _cells(
    setting: Setting, p: Potential, k: int, q: Array, h: Array, cells: int
) -> tuple[Array, float, Array]:
    """Lower bounds (cells,) from values at corners q (cells 2^n, n), and the least value.

    And the remainders (n, cells), by the joint whose side of the boxes they come from.
    """
    value, size = setting.residual(p, k, q)
    shapes, v, n = setting.shapes, setting.reach.speed, len(h)
    bends = bends_of(shapes.arm)
    centre = q.reshape(cells, -1, n).mean(axis=1)
    waves = bends.coupling.waves(centre)
    affine = np.hstack([np.ones((cells, 1)), (centre - shapes.centre) / shapes.half])
    change = (p.f[k + 1] - p.f[k]) / setting.step
    moved = float(np.linalg.norm(change[-3:]))
    pushes, spreads, turns = [], [], []  # what multiplies H: at the centre, its largest, slopes
    for e in (k, k + 1):
        push = p.l[e] + (affine @ p.y[e].T) @ setting.root
        push[:, :3] += p.f[e, -3:]
        pushes.append(push)
        spreads.append(size[e - k].reshape(cells, -1, 2).max(axis=1))  # convex: at a corner
        turns.append(setting.root @ p.y[e][:, 1:] / shapes.half)  # (6, n)
    error = np.zeros((2, n, cells))
    for j in range(n):
        across, moment = bends.coupling.split(waves @ bends.second[j])
        slope = bends.coupling.split(waves @ bends.first[j])[0]
        rate = (shapes.second(q, j) @ change[:-3]).reshape(cells, -1)  # affine in q
        rate = np.abs(rate + (moment @ change[-3:])[:, None]).max(axis=1)
        rate = rate + moved * sum(h[m] / 2 * bends.most_third[j][m][1] for m in range(n))
        for e in (0, 1):
            bent = shapes.third[j] @ p.f[k + e, :-3]  # (n,)
            bent = bent + np.einsum("pij,pj->pi", across, pushes[e])
            bent = np.abs(bent + 2 * slope @ turns[e][:, j])
            turned = _parts(turns[e])  # (n, 2)
            for m in range(n):
                second, third = bends.most_second[j][m][0], bends.most_third[j][m][0]
                basis = bends.most_second[j][j][0]
                shift = spreads[e] @ third.T + basis @ turned[m] + 2 * second @ turned[j]
                bent = bent + h[m] / 2 * shift
            error[e, j] = h[j] ** 2 / 8 * (rate + bent @ v)
    return (
        (value.reshape(2, cells, -1).min(axis=2) - error.sum(axis=1)).min(axis=0),
        float(value.min()),
        error.max(axis=0),
    )


def _parts(columns: Array) -> Array:
    """Lengths of the linear and angular rows of columns (6, n): (n, 2)."""
    return np.stack([np.linalg.norm(columns[s], axis=0) for s in (_LINEAR, _ANGULAR)], axis=1)
