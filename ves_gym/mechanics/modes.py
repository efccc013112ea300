"""Modes of the base with the joints locked, sums over their decay, and a quintic's spectrum."""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import scipy

from ves_gym._util.params import Array


class InertiaBlocks(NamedTuple):
    """Inertia blocks of arm and vehicle at Y = 0, over leading axes; b base coordinates."""

    Mt: Array  # (..., b, b) base mass with the joints locked, M + H_b
    Hbm: Array  # (..., b, n) base momentum per unit joint rate, zero of internal modes
    Hm: Array  # (..., n, n) joint inertia


def blocks_of(H: Array, mass: Array) -> InertiaBlocks:
    """Return the inertia blocks of an arm of inertia (..., 6 + n, 6 + n) (`dynamics.inertia`)
    on a vehicle of mass (b, b), its internal modes after the pose."""
    b, n = len(mass), H.shape[-1] - 6
    if b == 6:
        return InertiaBlocks(H[..., :6, :6] + mass, H[..., :6, 6:], H[..., 6:, 6:])
    Mt, Hbm = np.zeros((*H.shape[:-2], b, b)), np.zeros((*H.shape[:-2], b, n))
    Mt[:] = mass
    Mt[..., :6, :6] += H[..., :6, :6]
    Hbm[..., :6, :] = H[..., :6, 6:]
    return InertiaBlocks(Mt, Hbm, H[..., 6:, 6:])


def sum_quadratic(step: Array, W: Array, doublings: int) -> tuple[Array, Array]:
    """Sum W (..., k, k) over 2^doublings states of x+ = A x by doubling: x_0^T P x_0 = sum
    x_k^T W x_k; return P and the power of A that leads past the last state."""
    P = W
    for _ in range(doublings):
        P = P + step.swapaxes(-1, -2) @ P @ step
        step = step @ step
    return P, step


class Modes(NamedTuple):
    """Natural modes, slowest first."""

    omega: Array  # (..., k) rad/s
    shapes: Array  # (..., k, k) columns, normalised so that shapes^T M shapes = 1


def natural_modes(K: Array, M: Array) -> Modes:
    """Solve K x = omega^2 M x by M's Cholesky factor, K (k, k) symmetric, M (..., k, k)
    symmetric positive definite."""
    root = np.linalg.cholesky(M)
    half = np.linalg.solve(root, np.broadcast_to(K, M.shape))
    reduced = np.linalg.solve(root, np.swapaxes(half, -1, -2))
    squares, vectors = np.linalg.eigh((reduced + np.swapaxes(reduced, -1, -2)) / 2)
    shapes = np.linalg.solve(np.swapaxes(root, -1, -2), vectors)
    return Modes(np.sqrt(np.maximum(squares, 0.0)), shapes)


def modal_damping(M: Array, K: Array, ratios: float | Array) -> Array:
    """Return the D (k, k) that gives the modes of K and M (k, k) these damping ratios [1]: one
    for all, or (k,), slowest first."""
    omega, shapes = natural_modes(K, M)
    half = M @ shapes
    out: Array = (half * (2 * np.broadcast_to(ratios, omega.shape) * omega)) @ half.T
    return (out + out.T) / 2


# -------------------------------------------------- without a decision, to be compiled

_TINY = 1e-300  # keeps 0 / 0 away where two axes are alike and uncoupled


def inverted_root(M: Array) -> Array:
    """Return L of M = L L^T (..., k, k), the inverse of each number on its diagonal; M's lower
    triangle is read."""
    L, k = 0 * M, M.shape[-1]
    for j in range(k):
        row = L[..., j, :j]
        inverse = 1 / np.sqrt(M[..., j, j] - (row * row).sum(axis=-1))
        L[..., j, j] = inverse
        column = M[..., j + 1 :, j] - (L[..., j + 1 :, :j] * row[..., None, :]).sum(axis=-1)
        L[..., j + 1 :, j] = column * inverse[..., None]
    return L


def forward(L: Array, b: Array) -> Array:
    """Return L^-1 b (..., k, c), L as `inverted_root` gives it."""
    out = 0 * b
    for i in range(L.shape[-1]):
        solved = (L[..., i, :i, None] * out[..., :i, :]).sum(axis=-2)
        out[..., i, :] = (b[..., i, :] - solved) * L[..., i, i, None]
    return out


def reduced(K: Array, M: Array, b: Array) -> tuple[Array, Array]:
    """Return L^-1 K L^-T (..., k, k) and L^-1 b (..., k, c), where M = L L^T, K and M (..., k,
    k) symmetric; M's lower triangle is read."""
    L = inverted_root(M)
    half = np.swapaxes(forward(L, K), -1, -2)
    return np.swapaxes(forward(L, half), -1, -2), forward(L, b)


def jacobi_sweep(A: Array, b: Array) -> tuple[Array, Array]:
    """Return V^T A V (..., k, k) and V^T b (..., k, c), V a rotation in the plane of each pair
    of axes in turn (Golub and Van Loan, Matrix Computations, 4th ed., 8.5)."""
    A, b = A.copy(), b.copy()
    for i, j in itertools.combinations(range(A.shape[-1]), 2):
        across, half = A[..., i, j], (A[..., j, j] - A[..., i, i]) / 2
        size = np.abs(half) + np.sqrt(half * half + across * across) + _TINY
        t = np.where(half < 0, -across, across) / size  # tangent of the smaller angle
        cosine = (1 / np.sqrt(1 + t * t))[..., None]
        sine, moved = t[..., None] * cosine, t * across
        ends = A[..., i, i] - moved, A[..., j, j] + moved
        x, y = A[..., i].copy(), A[..., j].copy()
        A[..., i] = A[..., i, :] = cosine * x - sine * y
        A[..., j] = A[..., j, :] = sine * x + cosine * y
        A[..., i, i], A[..., j, j] = ends
        A[..., i, j] = A[..., j, i] = 0.0
        x, y = b[..., i, :].copy(), b[..., j, :].copy()
        b[..., i, :], b[..., j, :] = cosine * x - sine * y, sine * x + cosine * y
    return A, b


def root(K: Array) -> Array:
    """R (..., k, k) with R^T R = K, its rows along the axes of K, which is positive
    semidefinite."""
    values, vectors = np.linalg.eigh(K)
    out: Array = np.sqrt(np.maximum(values, 0.0))[..., None] * vectors.swapaxes(-1, -2)
    return out


def quintic_spectrum(x: npt.ArrayLike) -> Array:
    """Return |int_0^1 e^(-j x u) s'(u) du| of the rest-to-rest quintic s, x = omega T.

    Closed form 15 j_2(x/2) / (x/2)^2 with the spherical Bessel function j_2, by
    Poisson's integral (derived in docs/physics.md).
    """
    half = np.asarray(x, float) / 2
    small = np.abs(half) < 1e-2  # there the series is exact to rounding
    safe = np.where(small, 1.0, half)
    series = 1 - half**2 / 14 + half**4 / 504
    return np.where(small, series, np.abs(15 * scipy.special.spherical_jn(2, safe) / safe**2))
