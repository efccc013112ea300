"""The flexible base as a finite-element frame, seen from its tip.

Each tube is cut into Euler-Bernoulli elements with consistent mass. The assembly is reduced
to the tip's six coordinates and the first modes of the frame with the tip held
(Craig and Bampton, AIAA Journal 6(7), 1968). A lumped 6x6 model has no such inner modes.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy

from ves_gym._util.params import Array

ELEMENTS = 6  # per tube
MODES = 4  # inner modes kept
FRAME_SHARE = 0.15  # of the beam's mass in the frame; the rest is a body at the tip


class BaseMatrices(NamedTuple):
    """M Z'' + D Z' + K Z = (wrench, 0), Z = (tip pose, inner modes), size 6 + m."""

    M: Array
    D: Array
    K: Array


def base_of(vehicle: dict[str, Any], modes: int = MODES) -> BaseMatrices:
    """Return the base that a vehicle description of kind "beam" stands for.

    The stated 6x6 mass is that of a light frame and of a body at its tip: base and
    description move alike where the frame's inner modes do not matter.

    Args:
        vehicle: description, plain data.
        modes: inner modes of the frame.
    """
    K, M = assembled(vehicle)
    lumped = stated_mass(vehicle, reduced(K, M, 0)[1])
    Kr, Mr = reduced(K, FRAME_SHARE * M, modes)
    Mr[:6, :6] = lumped
    ratio = float(vehicle["damping_ratio"])
    D = np.zeros_like(Kr)
    D[:6, :6] = modal(lumped, Kr[:6, :6], ratio)
    inner = np.arange(6, 6 + modes)
    D[inner, inner] = 2 * ratio * np.sqrt(Kr[inner, inner])
    return BaseMatrices(Mr, D, Kr)


def section(vehicle: dict[str, Any]) -> tuple[float, float]:
    """Return area [m^2] and second moment [m^4] of the tube."""
    outer = float(vehicle["outer_diameter"])
    inner = outer - 2 * float(vehicle["wall"])
    return np.pi / 4 * (outer**2 - inner**2), np.pi / 64 * (outer**4 - inner**4)


def assembled(vehicle: dict[str, Any], elements: int = ELEMENTS) -> tuple[Array, Array]:
    """Return stiffness and mass of the clamped frame, 6 rows per node, the tip's last.

    Args:
        vehicle: description, plain data.
        elements: per tube.
    """
    area, second = section(vehicle)
    material = vehicle["material"]
    E, G, rho = (material[k] for k in ("youngs_modulus", "shear_modulus", "density"))
    segments = [np.asarray(s, float) for s in vehicle["segments"]]
    count = elements * len(segments)
    K, M = np.zeros((2, 6 * (count + 1), 6 * (count + 1)))
    for i in range(count):
        along = segments[i // elements] / elements
        length = float(np.linalg.norm(along))
        k, m = element(length, E * area, E * second, G * 2 * second, rho * area)
        m[np.ix_([3, 9], [3, 9])] = rho * 2 * second * length / 6 * np.array([[2, 1], [1, 2]])
        turn = np.kron(np.eye(4), axes(along / length))
        rows = slice(6 * i, 6 * i + 12)
        K[rows, rows] += turn.T @ k @ turn
        M[rows, rows] += turn.T @ m @ turn
    return K[6:, 6:], M[6:, 6:]


def axes(along: Array) -> Array:
    """Return (3, 3) rows: an element's own axes, the first along it."""
    helper = np.eye(3)[int(np.argmin(np.abs(along)))]
    second = np.cross(along, helper)
    second /= np.linalg.norm(second)
    return np.stack([along, second, np.cross(along, second)])


def element(
    length: float, EA: float, EI: float, GJ: float, line_density: float
) -> tuple[Array, Array]:
    """Return stiffness and mass (12, 12) of a frame element, its own axes, twist inertia aside.

    Args:
        length: m.
        EA, EI, GJ: stiffness in tension [N], bending and twist [N m^2].
        line_density: mass per length [kg/m].

    Returns:
        Rows: displacement and rotation (6) of either end.
    """
    k, m = np.zeros((2, 12, 12))
    pair = np.array([[1.0, -1.0], [-1.0, 1.0]])
    k[np.ix_([0, 6], [0, 6])] = EA / length * pair
    k[np.ix_([3, 9], [3, 9])] = GJ / length * pair
    m[np.ix_([0, 6], [0, 6])] = line_density * length / 6 * np.array([[2, 1], [1, 2]])
    a = length
    bend = np.array(
        [
            [12, 6 * a, -12, 6 * a],
            [6 * a, 4 * a**2, -6 * a, 2 * a**2],
            [-12, -6 * a, 12, -6 * a],
            [6 * a, 2 * a**2, -6 * a, 4 * a**2],
        ]
    )
    heavy = np.array(
        [
            [156, 22 * a, 54, -13 * a],
            [22 * a, 4 * a**2, 13 * a, -3 * a**2],
            [54, 13 * a, 156, -22 * a],
            [-13 * a, -3 * a**2, -22 * a, 4 * a**2],
        ]
    )
    for w, slope, sign in ((1, 5, 1.0), (2, 4, -1.0)):  # a rise along z turns about -y
        rows = np.ix_([w, slope, w + 6, slope + 6], [w, slope, w + 6, slope + 6])
        flip = np.diag([1, sign, 1, sign])
        k[rows] += EI / length**3 * flip @ bend @ flip
        m[rows] += line_density * length / 420 * flip @ heavy @ flip
    return k, m


def reduced(K: Array, M: Array, modes: int) -> tuple[Array, Array]:
    """Reduce a frame to its tip's coordinates and its modes with the tip held.

    Args:
        K, M: stiffness and mass of the clamped frame.
        modes: how many.

    Returns:
        K, M, (6 + modes, 6 + modes).
    """
    inner = slice(0, len(K) - 6)
    shapes = -np.linalg.solve(K[inner, inner], K[inner, -6:])
    _, fixed_modes = scipy.linalg.eigh(K[inner, inner], M[inner, inner])
    basis = np.zeros((len(K), 6 + modes))
    basis[inner, :6], basis[-6:, :6] = shapes, np.eye(6)
    basis[inner, 6:] = fixed_modes[:, :modes]
    out = [basis.T @ matrix @ basis for matrix in (K, M)]
    return (out[0] + out[0].T) / 2, (out[1] + out[1].T) / 2


def stated_mass(vehicle: dict[str, Any], consistent: Array) -> Array:
    """Return (6, 6) mass at the tip as the description's mass model has it.

    Args:
        vehicle: description, plain data.
        consistent: (6, 6) mass of the frame reduced to its tip.
    """
    if vehicle["mass_model"] == "consistent":
        return consistent
    segments = np.asarray(vehicle["segments"], float)
    area, second = section(vehicle)
    rho = float(vehicle["material"]["density"])
    lengths = np.linalg.norm(segments, axis=1)
    half = rho * area * lengths.sum() / 2
    reach = segments.sum(axis=0)
    lever = reach @ reach - reach**2
    twist = rho * 2 * second / 3 * (segments**2 / lengths[:, None]).sum(axis=0)
    return np.diag([half] * 3 + np.where(lever > 0, half * lever, twist).tolist())


def modal(M: Array, K: Array, ratio: float) -> Array:
    """Return the damping matrix that gives every mode the same ratio.

    Args:
        M, K: mass and stiffness.
        ratio: damping ratio.
    """
    squares, shapes = scipy.linalg.eigh(K, M)
    weighted = M @ shapes
    return np.asarray(weighted @ np.diag(2 * ratio * np.sqrt(squares)) @ weighted.T)
