"""Bases: what M, D, K a description's `[vehicle]` means.

Beams are frames of Euler-Bernoulli elements with consistent mass and rotary inertia, clamped at
the root and reduced to the flange and their slowest inner modes (Craig and Bampton 1968).
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg as sla

from benchmarks.trial.arm import Array, Bodies, Table

ELEMENTS = 12  # per member


@dataclass(frozen=True)
class Base:
    """M z'' + D z' + K z = (W, 0), z = (Y, eta); `body`: a satellite's rigid body, or none."""

    M: Array  # (6 + m, 6 + m)
    D: Array
    K: Array
    body: Table | None = None

    @property
    def inner(self) -> int:
        """Number of inner modes."""
        return len(self.M) - 6


def _element(length: float, tube: Table, material: Table) -> tuple[Array, Array]:
    """Stiffness and mass (12, 12) of a tube's element along its own x axis."""
    outer = tube["outer_diameter"]
    inner = outer - 2 * tube["wall"]
    area = np.pi / 4 * (outer**2 - inner**2)
    second = np.pi / 64 * (outer**4 - inner**4)  # of area, about a diameter
    E, G, rho = material["youngs_modulus"], material["shear_modulus"], material["density"]
    K, M = np.zeros((12, 12)), np.zeros((12, 12))
    spring = np.array([[1.0, -1.0], [-1.0, 1.0]])
    bar = np.array([[2.0, 1.0], [1.0, 2.0]]) * length / 6
    for freedom, stiff, heavy in (
        (0, E * area, rho * area),
        (3, G * 2 * second, rho * 2 * second),
    ):
        at = np.ix_([freedom, freedom + 6], [freedom, freedom + 6])
        K[at] += stiff / length * spring
        M[at] += heavy * bar
    L = length
    bend = np.array(
        [
            [12, 6 * L, -12, 6 * L],
            [6 * L, 4 * L**2, -6 * L, 2 * L**2],
            [-12, -6 * L, 12, -6 * L],
            [6 * L, 2 * L**2, -6 * L, 4 * L**2],
        ]
    )
    move = np.array(
        [
            [156, 22 * L, 54, -13 * L],
            [22 * L, 4 * L**2, 13 * L, -3 * L**2],
            [54, 13 * L, 156, -22 * L],
            [-13 * L, -3 * L**2, -22 * L, 4 * L**2],
        ]
    )
    tilt = np.array(
        [
            [36, 3 * L, -36, 3 * L],
            [3 * L, 4 * L**2, -3 * L, -(L**2)],
            [-36, -3 * L, 36, -3 * L],
            [3 * L, -(L**2), -3 * L, 4 * L**2],
        ]
    )
    for freedoms, sign in (([1, 5, 7, 11], 1.0), ([2, 4, 8, 10], -1.0)):
        flip = np.diag([1.0, sign, 1.0, sign])  # turning about y lowers z along x
        at = np.ix_(freedoms, freedoms)
        K[at] += flip @ (E * second / L**3 * bend) @ flip
        M[at] += flip @ (rho * area * L / 420 * move + rho * second / (30 * L) * tilt) @ flip
    return K, M


def _axes(direction: Array) -> Array:
    """Rows: an orthonormal frame whose first axis is `direction`."""
    x = direction / np.linalg.norm(direction)
    side = np.eye(3)[int(np.argmin(np.abs(x)))]
    y = np.cross(side, x)
    y /= np.linalg.norm(y)
    return np.array([x, y, np.cross(x, y)])


def _body_mass(part: Table) -> Array:
    """Mass matrix (6, 6) at its corner of a rigid body."""
    m, c = part["mass"], np.asarray(part["com"], float)
    cross = np.array([[0.0, -c[2], c[1]], [c[2], 0.0, -c[0]], [-c[1], c[0], 0.0]])
    about = np.asarray(part["inertia"], float) + m * cross @ cross.T
    return np.block([[m * np.eye(3), m * cross.T], [m * cross, about]])


def frame(structure: Table, elements: int = ELEMENTS) -> tuple[Array, Array]:
    """Return K and M of a clamped polyline of tubes, the flange's six freedoms last."""
    members = structure["members"]
    size = 6 * (elements * len(members) + 1)
    K, M = np.zeros((size, size)), np.zeros((size, size))
    node = 0
    for member in members:
        vector = np.asarray(member["vector"], float)
        R = np.kron(np.eye(4), _axes(vector))
        ke, me = _element(
            float(np.linalg.norm(vector)) / elements, member["section"], member["material"]
        )
        ke, me = R.T @ ke @ R, R.T @ me @ R
        for _ in range(elements):
            part = slice(6 * node, 6 * node + 12)
            K[part, part] += ke
            M[part, part] += me
            node += 1
    for body in structure.get("bodies") or ():
        at = 6 * elements * body["corner"]
        M[at : at + 6, at : at + 6] += _body_mass(body["inertial"])
    return K[6:, 6:], M[6:, 6:]


def reduced(structure: Table, modes: int) -> tuple[Array, Array]:
    """Return K and M over the flange and the slowest inner modes (6 + modes, 6 + modes)."""
    K, M = frame(structure)
    i, b = slice(0, -6), slice(-6, None)
    shapes = -np.linalg.solve(K[i, i], K[i, b])
    squares, phi = sla.eigh(K[i, i], M[i, i], subset_by_index=[0, max(modes, 1) - 1])
    phi = phi[:, :modes]
    signs = np.sign(phi[np.argmax(np.abs(phi), axis=0), np.arange(modes)])
    phi = phi * signs
    basis = np.zeros((len(K), 6 + modes))
    basis[b, :6] = np.eye(6)
    basis[i, :6], basis[i, 6:] = shapes, phi
    stiff, mass = basis.T @ K @ basis, basis.T @ M @ basis
    stiff[:6, 6:] = stiff[6:, :6] = 0.0  # statics leave nothing there but rounding
    stiff[6:, 6:] = np.diag(squares[:modes])
    return (stiff + stiff.T) / 2, (mass + mass.T) / 2


def modal_damping(M: Array, K: Array, ratio: float) -> Array:
    """D that gives every mode of (K, M) the same damping ratio."""
    squares, V = sla.eigh(K, M)
    return M @ V @ np.diag(2 * ratio * np.sqrt(np.maximum(squares, 0.0))) @ V.T @ M


def read_base(vehicle: dict[str, Any], extra_modes: int = 0) -> Base:
    """Return the base that a description's `[vehicle]` means.

    Args:
        vehicle: of kind `matrices`, `flexible` (polyline of tubes) or `satellite` (body
            alone). A machine as it is may have `scales`, factors of M, D and K.
        extra_modes: inner modes beyond those that the description keeps.
    """
    kind, scales = vehicle["kind"], vehicle.get("scales") or {"M": 1.0, "D": 1.0, "K": 1.0}
    none, body = np.zeros((6, 6)), None
    if kind == "matrices":
        M, D, K = (np.asarray(vehicle[name], float) for name in "MDK")
    elif kind == "flexible":
        K, M = reduced(vehicle["structure"], vehicle["modes"] + extra_modes)
        D = modal_damping(M, K, vehicle["damping_ratio"])
    elif kind == "satellite" and not vehicle.get("wheels") and not vehicle.get("appendages"):
        M, D, K = none, none, none
        part = vehicle["body"]
        inertia = scales["M"] * np.asarray(part["inertia"], float)
        body = {"mass": scales["M"] * part["mass"], "com": part["com"], "inertia": inertia}
    else:
        raise ValueError(f"vehicle: got {kind!r}, expected matrices, flexible, plain satellite")
    return Base(scales["M"] * M, scales["D"] * D, scales["K"] * K, body)


def base_body(base: Base) -> Bodies | None:
    """The satellite's body as MuJoCo sees it, or none."""
    return None if base.body is None else Bodies(base.body, ())
