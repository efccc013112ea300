"""Flexible bases: the thesis's condensed beam, and a beam by finite elements of its own.

Euler-Bernoulli frame elements with Hermite shapes and consistent mass (Przemieniecki, Theory of
Matrix Structural Analysis, 1968, ch. 5 and 11; rotary inertia as in his eq. 11.36), fixed-
interface reduction (Craig and Bampton, AIAA J. 6(7), 1968), one damping ratio for every mode.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import eigh


@dataclass
class Base:
    """M, D, K (6+m, 6+m) over (Y, u): six of the flange, then modes of unit mass."""

    M: np.ndarray
    D: np.ndarray
    K: np.ndarray

    @property
    def modes(self) -> int:
        return len(self.M) - 6


def read(table: dict[str, Any]) -> Base:
    if table["kind"] == "beam":
        return thesis_beam(table)
    return flexible(table)


def modal_damping(M: np.ndarray, K: np.ndarray, ratio: np.ndarray | float) -> np.ndarray:
    """D that gives every mode of (M, K) the ratio: M Phi diag(2 zeta w) Phi^T M."""
    w2, phi = eigh(K, M)
    Q = M @ phi
    return Q * (2.0 * ratio * np.sqrt(w2)) @ Q.T


def tube(outer: float, wall: float) -> tuple[float, float, float]:
    """Area, second moment of area, polar moment of a round tube [m^2, m^4, m^4]."""
    inner = outer - 2.0 * wall
    I = np.pi / 64.0 * (outer**4 - inner**4)
    return np.pi / 4.0 * (outer**2 - inner**2), I, 2.0 * I


def axes_along(direction: np.ndarray) -> np.ndarray:
    """Rows: unit vectors along a member and across it."""
    e = direction / np.linalg.norm(direction)
    helper = np.eye(3)[np.argmin(np.abs(e))]
    f = np.cross(e, helper)
    f /= np.linalg.norm(f)
    return np.stack([e, f, np.cross(e, f)])


def element(L: float, outer: float, wall: float, mat: dict[str, Any]) -> tuple[Any, Any]:
    """K and M (12, 12) of one element along x: u v w rx ry rz at each end."""
    E, G, rho = mat["youngs_modulus"], mat["shear_modulus"], mat["density"]
    A, I, J = tube(outer, wall)
    K, M = np.zeros((12, 12)), np.zeros((12, 12))
    bar_k, bar_m = np.array([[1, -1], [-1, 1]]), np.array([[2, 1], [1, 2]]) / 6.0
    for dof, k, m in ((0, E * A / L, rho * A * L), (3, G * J / L, rho * J * L)):
        at = np.ix_([dof, dof + 6], [dof, dof + 6])
        K[at], M[at] = k * bar_k, m * bar_m
    bend = np.array(
        [[12, 6 * L, -12, 6 * L], [6 * L, 4 * L**2, -6 * L, 2 * L**2],
         [-12, -6 * L, 12, -6 * L], [6 * L, 2 * L**2, -6 * L, 4 * L**2]]
    )  # fmt: skip
    mass = np.array(
        [[156, 22 * L, 54, -13 * L], [22 * L, 4 * L**2, 13 * L, -3 * L**2],
         [54, 13 * L, 156, -22 * L], [-13 * L, -3 * L**2, -22 * L, 4 * L**2]]
    )  # fmt: skip
    rotary = np.array(
        [[36, 3 * L, -36, 3 * L], [3 * L, 4 * L**2, -3 * L, -(L**2)],
         [-36, -3 * L, 36, -3 * L], [3 * L, -(L**2), -3 * L, 4 * L**2]]
    )  # fmt: skip
    for dofs, sign in (([1, 5, 7, 11], 1.0), ([2, 4, 8, 10], -1.0)):
        flip = np.outer(s := np.array([1, sign, 1, sign]), s)  # theta_y = -dw/dx
        at = np.ix_(dofs, dofs)
        K[at] = E * I / L**3 * bend * flip
        M[at] = (rho * A * L / 420.0 * mass + rho * I / (30.0 * L) * rotary) * flip
    return K, M


def members(table: dict[str, Any]) -> list[tuple[np.ndarray, float, float, dict[str, Any]]]:
    """Vector, outer diameter, wall, material of every member, from the clamp to the flange."""
    if table["kind"] == "beam":
        section = table["outer_diameter"], table["wall"]
        return [(np.array(v), *section, table["material"]) for v in table["segments"]]
    return [
        (
            np.array(k["vector"]),
            k["section"]["outer_diameter"],
            k["section"]["wall"],
            k["material"],
        )
        for k in table["structure"]["members"]
    ]


def assemble(table: dict[str, Any], parts: int = 12) -> tuple[np.ndarray, np.ndarray]:
    """K and M of the clamped beam, its last six freedoms the flange's; `parts` a member."""
    pieces = [(v / parts, o, w, m) for v, o, w, m in members(table) for _ in range(parts)]
    size = 6 * (len(pieces) + 1)
    K, M = np.zeros((size, size)), np.zeros((size, size))
    for k, (v, outer, wall, material) in enumerate(pieces):
        T = np.kron(np.eye(4), axes_along(v))
        Ke, Me = element(float(np.linalg.norm(v)), outer, wall, material)
        at = slice(6 * k, 6 * k + 12)
        K[at, at] += T.T @ Ke @ T
        M[at, at] += T.T @ Me @ T
    return K[6:, 6:], M[6:, 6:]


def flange_stiffness(table: dict[str, Any]) -> np.ndarray:
    K, _ = assemble(table, parts=1)
    inner, flange = K[:-6, :-6], K[-6:, -6:]
    if not len(inner):
        return flange
    return flange - K[-6:, :-6] @ np.linalg.solve(inner, K[:-6, -6:])


def thesis_beam(table: dict[str, Any]) -> Base:
    """Thesis Appendix A: half the mass at the tip, m L^2 about each axis."""
    K = flange_stiffness(table)
    M = thesis_mass(table)
    return Base(M, modal_damping(M, K, table["damping_ratio"]), K)


def thesis_mass(table: dict[str, Any]) -> np.ndarray:
    """Thesis A.2 and A.4: m_eq, and about each axis m_eq times the squared lengths across it.

    An axis along all of the beam gets the tube's own rotation in torsion, rho J L / 3.
    """
    parts = members(table)
    mass, inertia = 0.0, np.zeros(3)
    for v, outer, wall, mat in parts:
        mass += 0.5 * tube(outer, wall)[0] * mat["density"] * float(np.linalg.norm(v))
    for axis, e in enumerate(np.eye(3)):
        across = sum(float(np.sum(np.cross(v, e) ** 2)) for v, *_ in parts)
        twist = sum(
            m["density"] * tube(o, w)[2] * np.linalg.norm(v) / 3 for v, o, w, m in parts
        )
        inertia[axis] = mass * across if across > 0 else twist
    return np.diag([mass] * 3 + list(inertia))


def flexible(table: dict[str, Any]) -> Base:
    """(Y, u): static shapes of the flange and the slowest modes with the flange held."""
    K, M = assemble(table)
    Kii, Mii, Kib, Mib = K[:-6, :-6], M[:-6, :-6], K[:-6, -6:], M[:-6, -6:]
    psi = -np.linalg.solve(Kii, Kib)
    w2, phi = eigh(Kii, Mii, subset_by_index=[0, table["modes"] - 1])
    Mc = M[-6:, -6:] + Mib.T @ psi + psi.T @ Mib + psi.T @ Mii @ psi
    Kb = K[-6:, -6:] + Kib.T @ psi
    P = (Mib.T + psi.T @ Mii) @ phi  # (6, m)
    P = canonical(P, w2)
    return from_reduction(Mc, Kb, P, w2, table["damping_ratio"])


def from_reduction(
    Mc: np.ndarray, Kb: np.ndarray, P: np.ndarray, w2: np.ndarray, ratio: float
) -> Base:
    """Carries (Y, eta) to (Y, u = eta + P^T Y)."""
    m = len(w2)
    Kz = np.block([[Kb, np.zeros((6, m))], [np.zeros((m, 6)), np.diag(w2)]])
    Mz = np.block([[Mc, P], [P.T, np.eye(m)]])
    Dz = modal_damping(Mz, Kz, ratio)
    back = np.block([[np.eye(6), np.zeros((6, m))], [-P.T, np.eye(m)]])  # eta = u - P^T Y
    M, D, K = (back.T @ A @ back for A in (Mz, Dz, Kz))
    return Base(*(0.5 * (A + A.T) for A in (M, D, K)))


def canonical(P: np.ndarray, w2: np.ndarray) -> np.ndarray:
    """Mode participations (6, m), made unique.

    Modes of equal frequency are turned so that each carries the first axis of the flange that
    is left; the largest entry of each is positive (found from the example runs).
    """
    P, i = P.copy(), 0
    while i < len(w2):
        j = i + int(np.sum(np.abs(w2[i:] / w2[i] - 1) < 1e-6))
        for first in range(i, j - 1):
            block = P[:, first:j]
            row = block[int(np.argmax(np.linalg.norm(block, axis=1) > 1e-6 * np.abs(P).max()))]
            Q, _ = np.linalg.qr(np.column_stack([row, np.eye(len(row))]))
            P[:, first:j] = block @ Q
        i = j
    return P * np.sign(P[np.argmax(np.abs(P), axis=0), np.arange(P.shape[1])])
