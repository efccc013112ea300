"""E_mean of a joint momentum as a convex functional, and its conjugate.

A linear base (M, D, K) of b coordinates, at rest before an arm pushes on its first six with the
momentum u(t), has with z = (Y, P), P = M Y' + B u and the mean over duration and tail

    z' = A z + B_z u,    J(u) = E_mean = int (z, u)^T L (z, u) / 2 dt + z(T)^T F z(T) / 2.

J stays convex when the form of `local_part`, 1/2 int u^T R u dt, is taken off; `require_convex`
proves it for a given R. The rest J_R has the conjugate J_R*(l) = max_u int l^T u dt - J_R(u),
which `conjugate` gives exactly for l linear between nodes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy.linalg
import scipy.sparse
import scipy.sparse.linalg

from ves_gym._util.params import Array, ParameterError
from ves_gym.mechanics.modes import sum_quadratic
from ves_gym.system.energy import TAIL

_PUSHED = 6  # coordinates of the base that the arm acts on
_WITHIN = 0.5  # |G| h of a step: (exp(0.5) - 1) sqrt(2) < 1
_GROWTH = 6.0  # a step's exponent: e^12 times rounding is lost of the conjugate
_FINEST, _MOST = 13, 8_000  # halvings and steps, before a form is taken for not convex
_SHARE = 0.95  # of the largest R that a mode allows
_HATS = 40  # nodes of the momenta that a mode's share of R is found with


@dataclass(frozen=True, eq=False)
class MomentumCost:
    """J of u, with 1/2 int u^T R u dt taken off. State (Y, P), in normal coordinates."""

    A: Array  # (2b, 2b)
    B: Array  # (2b, 6)
    Q: Array  # (2b, 2b) of z z
    N: Array  # (2b, 6) of z u
    C: Array  # (6, 6) of u u, R not yet taken off
    F: Array  # (2b, 2b) of z(T)
    R: Array  # (6, 6)
    duration: float

    @property
    def remainder(self) -> Array:
        """C - R (6, 6)."""
        return self.C - self.R

    def less(self, R: Array) -> MomentumCost:
        """The same with another R (6, 6) [J / (kg m/s)^2 / s]."""
        return MomentumCost(self.A, self.B, self.Q, self.N, self.C, self.F, R, self.duration)


def momentum_cost(M: Array, D: Array, K: Array, duration: float) -> MomentumCost:
    """J of a base, R = 0; Y and P in its normal coordinates.

    Args:
        M: (b, b) inertia [kg, kg m, kg m^2], the arm's included; b >= 6.
        D: (b, b) damping. K: (b, b) stiffness.
        duration: of the motion [s].

    Returns:
        The functional.
    """
    b = len(M)
    if M.shape != (b, b) or D.shape != M.shape or K.shape != M.shape or b < _PUSHED:
        raise ParameterError(
            f"M, D and K must be square, of one size >= {_PUSHED}, got {M.shape}, {D.shape}"
            f" and {K.shape}"
        )
    squares, shapes = scipy.linalg.eigh(K, M)
    squares, damping = np.maximum(squares, 0.0), shapes.T @ D @ shapes
    return _cost(squares, damping, shapes[:_PUSHED].T, duration)


def _cost(squares: Array, damping: Array, pushed: Array, duration: float) -> MomentumCost:
    """J of unit-mass oscillators: angular frequencies^2 (b,), damping (b, b), input (b, m)."""
    b, share = len(squares), 1 / (duration + TAIL)
    zero, identity = np.zeros((b, b)), np.eye(b)
    A = np.block([[zero, identity], [-np.diag(squares), -damping]])
    B = np.vstack([-pushed, damping @ pushed])
    Q = share * np.diag(np.r_[squares, np.ones(b)])
    N = share * np.vstack([np.zeros_like(pushed), -pushed])
    C = share * pushed.T @ pushed
    return MomentumCost(A, B, Q, N, C, _tail(A, Q), np.zeros_like(C), duration)


def _tail(A: Array, Q: Array, doublings: int = 26) -> Array:
    """int_0^TAIL exp(A^T t) Q exp(A t) dt, by doubling from an exact short step."""
    h = TAIL / 2**doublings
    S, _ = sum_quadratic(scipy.linalg.expm(A * h), _integral(A, Q, h), doublings)
    return np.asarray((S + S.T) / 2)


def _integral(A: Array, Q: Array, h: float) -> Array:
    """int_0^h exp(A^T t) Q exp(A t) dt (Van Loan 1978)."""
    n = len(A)
    E = scipy.linalg.expm(np.block([[-A.T, Q], [np.zeros_like(A), A]]) * h)
    out: Array = E[n:, n:].T @ E[:n, n:]
    return out


# ---------------------------------------------------------------------- the convex remainder


def local_part(cost: MomentumCost) -> Array:
    """R (6, 6), large, such that J less 1/2 int u^T R u dt is convex.

    Mode by mode: where the damping does not couple modes, J is a sum of costs of the scalar
    momenta that push them, each at least r_i of its own part of C. Where it
    does, all are lowered until `is_convex` holds.

    Args:
        cost: of the base.

    Returns:
        R [J / (kg m/s)^2 / s].
    """
    b = len(cost.A) // 2
    squares, damping = -np.diag(cost.A[b:, :b]), -np.diag(cost.A[b:, b:])
    pushed, share = -cost.B[:b], 1 / (cost.duration + TAIL)
    part = np.array(
        [
            _largest(_cost(s, d, np.ones((1, 1)), cost.duration))
            for s, d in zip(squares[:, None], damping[:, None, None], strict=True)
        ]
    )
    full = np.asarray(share * _SHARE * (pushed.T * part) @ pushed, float)
    for scale in (1.0, 0.9, 0.75, 0.5, 0.25):
        if is_convex(cost.less(scale * full)):
            return scale * full
    return np.zeros_like(full)


def _largest(cost: MomentumCost) -> float:
    """The largest r <= 1 for which J of a scalar less r C is convex, from hats at nodes.

    J >= r C / 2 int u^2 for all u if and only if J* <= int l^2 / (2 r C) for all l.
    """
    nodes, h = _HATS + 1, cost.duration / _HATS
    hats = scipy.linalg.toeplitz(np.r_[2 / 3, 1 / 6, np.zeros(nodes - 2)]) * h
    hats[0, 0] = hats[-1, -1] = h / 3
    steepest = scipy.linalg.eigh(conjugate(cost, _HATS), hats, eigvals_only=True)[-1]
    return min(1.0, 1 / float(steepest * cost.C[0, 0]))


def is_convex(cost: MomentumCost) -> bool:
    """True if J_R >= 0 for every u is proved.

    That is so if C - R > 0 and Riccati's equation has a solution S from S(T) = F back to 0, for
    then J_R = 1/2 int |(C - R)^1/2 (u + (C - R)^-1 (B^T S + N^T) z)|^2 dt. Over a step of h,
    S = V U^-1 with (U, V)' = G (U, V), exact by the exponential of G; it exists where U is
    regular, and |U - 1| <= (exp(|G| h) - 1) |(1, S)| < 1 within every step makes it so. The
    norms are taken with z scaled so that F's diagonal is 1, and S to its own size.
    """
    if np.linalg.eigvalsh(cost.remainder)[0] <= 1e-9 * np.abs(cost.C).max():
        return False
    size, root = len(cost.A), np.sqrt(_scales(cost))
    inverse = np.linalg.inv(cost.remainder)
    within = (cost.A - cost.B @ inverse @ cost.N.T) * root[:, None] / root
    across = -(cost.B @ inverse @ cost.B.T) * root[:, None] * root
    back = -(cost.Q - cost.N @ inverse @ cost.N.T) / root[:, None] / root
    G = -np.block([[within, across], [back, -within.T]])  # time runs backwards
    norms = [float(np.linalg.norm(k, 2)) for k in (within, across, back)]
    S, remaining, steps = cost.F / root[:, None] / root, 1.0, 0
    flows: dict[int, Array] = {}
    while remaining > 0:
        scale = max(float(np.linalg.norm(S, 2)), norms[2] / (norms[0] + 1.0))
        rate = cost.duration * (norms[0] + norms[1] * scale + norms[2] / scale)
        halvings = max(0, math.ceil(math.log2(rate / _WITHIN)))
        while remaining % 0.5**halvings:  # steps end on the dyadic grid that they start on
            halvings += 1
        steps += 1
        if halvings > _FINEST or steps > _MOST:
            return False
        if halvings not in flows:
            flows[halvings] = scipy.linalg.expm(G * cost.duration / 2**halvings)
        U, V = np.split(flows[halvings] @ np.vstack([np.eye(size), S]), 2)
        S = np.asarray(np.linalg.solve(U.T, V.T).T, float)
        S, remaining = (S + S.T) / 2, remaining - 0.5**halvings
    return True


def _scales(cost: MomentumCost) -> Array:
    """(2b,) sizes of S's entries; a mode without stiffness gets a tenth per duration."""
    size = np.diag(cost.F).copy()
    half = len(size) // 2
    size[:half] = np.maximum(size[:half], size[half:] * (0.1 / cost.duration) ** 2)
    return size


# ------------------------------------------------------------------------------- conjugate


def conjugate(cost: MomentumCost, slabs: int) -> Array:
    """W with J_R*(l) = 1/2 l^T W l, exact for l linear between slabs + 1 nodes.

    The maximum is where u = (C - R)^-1 (l + B^T p - N^T z) and p' = Q z + N u - A^T p,
    p(T) = -F z(T): a linear boundary value problem, solved at the nodes by exact steps.

    Args:
        cost: with a convex J_R.
        slabs: number of equal parts of the duration.

    Returns:
        (6 (slabs + 1), 6 (slabs + 1)), nodes first, symmetric.
    """
    size, m = len(cost.A), cost.B.shape[1]
    A, width = _extremal(cost), 2 * size
    fastest = float(np.abs(np.linalg.eigvals(A).real).max())
    parts = max(1, math.ceil(fastest * cost.duration / slabs / _GROWTH))  # for rounding
    steps = slabs * parts
    h, nodes = cost.duration / steps, steps + 1
    l = np.kron(_prolonged(slabs, parts), np.eye(m)).reshape(nodes, m, -1)
    E = scipy.linalg.expm(A * h)
    step, level, slope = E[:width, :width], E[:width, width:-m], E[:width, -m:] / h
    rhs = np.zeros((width * nodes, l.shape[2]))
    rhs[size:-size] = ((level - slope) @ l[:-1] + slope @ l[1:]).reshape(steps * width, -1)
    eye = scipy.sparse.eye_array
    matrix = scipy.sparse.vstack(
        [
            eye(size, width * nodes),
            scipy.sparse.kron(eye(steps, nodes, k=1), np.eye(width))
            - scipy.sparse.kron(eye(steps, nodes), step),
            scipy.sparse.hstack([eye(size, width * steps) * 0, cost.F, np.eye(size)]),
        ]
    )
    columns = np.tile(np.r_[np.ones(size), np.full(size, np.abs(cost.C).max())], nodes)
    matrix = matrix @ scipy.sparse.diags_array(columns)
    rows = 1 / abs(matrix).max(axis=1).toarray().ravel()
    solver = scipy.sparse.linalg.splu((scipy.sparse.diags_array(rows) @ matrix).tocsc())
    x = columns[:, None] * solver.solve(rhs * rows[:, None])
    # J* = 1/2 int l^T u dt over (z, p, l, l')
    form = np.zeros_like(A)
    form[width:-m, :] = _optimum(cost)
    gram = _integral(A, (form + form.T) / 2, h)
    states = np.concatenate(
        [x.reshape(nodes, width, -1)[:-1], l[:-1], np.diff(l, axis=0) / h], axis=1
    )
    weighted = (gram @ states).reshape(-1, l.shape[2])
    W: Array = states.reshape(-1, l.shape[2]).T @ weighted
    return (W + W.T) / 2


def _prolonged(slabs: int, parts: int) -> Array:
    """Values at the nodes of slabs parts from those of slabs: (slabs parts + 1, slabs + 1)."""
    at = np.arange(slabs * parts + 1) / parts
    return np.maximum(0.0, 1 - np.abs(at[:, None] - np.arange(slabs + 1)))


def _optimum(cost: MomentumCost) -> Array:
    """u of (z, p, l, l'): (6, 4b + 12)."""
    inverse = np.linalg.inv(cost.remainder)
    zero = np.zeros_like(inverse)
    return np.hstack([-inverse @ cost.N.T, inverse @ cost.B.T, inverse, zero])


def _extremal(cost: MomentumCost) -> Array:
    """Generator of (z, p, l, l') for l linear in time."""
    size, m = len(cost.A), cost.B.shape[1]
    u = _optimum(cost)
    out = np.zeros((2 * size + 2 * m, 2 * size + 2 * m))
    out[:size] = cost.B @ u
    out[:size, :size] += cost.A
    out[size : 2 * size] = cost.N @ u
    out[size : 2 * size, :size] += cost.Q
    out[size : 2 * size, size : 2 * size] -= cost.A.T
    out[2 * size : -m, -m:] = np.eye(m)
    return out
