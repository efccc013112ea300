"""The ten numbers of a rigid body in which forces are linear, and which ten a body can have.

Mass, first moment of mass and inertia about the frame's origin: what a robot's motion tells of
a body is a linear function of these. A body can have them if its pseudo-inertia, the matrix of
the second moments of (x, y, z, 1) over its mass, has no negative eigenvalue (Wensing, Kim and
Slotine, IEEE RA-L 3, 2018).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import scipy

from ves_gym._util.params import Array
from ves_gym.mechanics.link import Inertial

PARAMETERS = (  # about the origin of the body's frame
    "mass",
    *(f"moment_{axis}" for axis in "xyz"),
    *(f"inertia_{axes}" for axes in ("xx", "xy", "yy", "xz", "yz", "zz")),
)
PARAMETER_UNITS = ("kg", *("kg m",) * 3, *("kg m^2",) * 6)
PLACES = ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))  # of the inertias in their matrix
_LEAST = 1e-3  # m: radius of gyration that every body has
REACH = 1.0  # m: the mass of what is fixed to a tool is on average no farther from its frame
_ROUNDING = 1e-9
_TRIES = 200
_LOWER = np.tril_indices(4)
# Masses of 1 kg, far and near along the axes and between them: their numbers span all ten.
POINT_MASSES = tuple(
    Inertial(mass=1.0, com=tuple(place), inertia=((0.0,) * 3,) * 3)
    for place in np.vstack([np.zeros(3), np.eye(3), -np.eye(3), 1 - np.eye(3)]).tolist()
)


def inertia_matrix(numbers: npt.ArrayLike) -> Array:
    """Return (3, 3) inertia about the frame's origin of (10,) `PARAMETERS` [kg m^2]."""
    out = np.zeros((3, 3))
    for (i, j), value in zip(PLACES, np.asarray(numbers, float)[4:], strict=True):
        out[i, j] = out[j, i] = value
    return out


def numbers_of_body(body: Inertial) -> Array:
    """Return (10,) numbers of a body in the order of `PARAMETERS`."""
    c = np.array(body.com)
    about = np.array(body.inertia) + body.mass * (c @ c * np.eye(3) - np.outer(c, c))
    return np.array([body.mass, *(body.mass * c), *(about[i, j] for i, j in PLACES)])


def per_number() -> Array:
    """Return (10, 10) shares of each of `POINT_MASSES` in one unit of each number."""
    return np.linalg.inv(np.stack([numbers_of_body(point) for point in POINT_MASSES]))


def pseudo_inertia(numbers: npt.ArrayLike) -> Array:
    """Return (4, 4) second moments of (x, y, z, 1) over the mass, of (10,) `PARAMETERS`."""
    x, about = np.asarray(numbers, float), inertia_matrix(numbers)
    out = np.empty((4, 4))
    out[:3, :3] = np.trace(about) / 2 * np.eye(3) - about
    out[:3, 3] = out[3, :3] = x[1:4]
    out[3, 3] = x[0]
    return out


def numbers_of_moments(moments: npt.ArrayLike) -> Array:
    """Return (10,) numbers of a pseudo-inertia (4, 4): the way back."""
    J = np.asarray(moments, float)
    about = np.trace(J[:3, :3]) * np.eye(3) - J[:3, :3]
    return np.array([J[3, 3], *J[:3, 3], *(about[i, j] for i, j in PLACES)])


def is_body(numbers: npt.ArrayLike) -> bool:
    """Return True for numbers (10,) that a rigid body can have."""
    J = pseudo_inertia(numbers)
    return bool(np.linalg.eigvalsh(J)[0] >= -_ROUNDING * max(float(np.abs(J).max()), 1e-300))


def nearest_body(
    numbers: npt.ArrayLike, precision: npt.ArrayLike, combinations: Array
) -> Array:
    """Return the identifiable numbers of the most probable body.

    Of (k,) estimated numbers, combinations (k, 10) of `PARAMETERS`, and the inverse (k, k) of
    their covariance: (k,) numbers that a body has, its radius of gyration 1 mm along each axis
    or more and, about the frame's origin, `REACH` or less.
    """
    x = np.asarray(numbers, float)
    weight = np.asarray(precision, float)
    scale = np.sqrt(np.maximum(np.diag(weight), 1e-12))
    parts, ways = np.linalg.eigh((weight + weight.T) / (2 * np.outer(scale, scale)))
    # of a covariance that is all but singular, rounding makes some parts negative
    root = np.sqrt(np.maximum(parts, 1e-12))[:, None] * ways.T * scale
    core = np.diag([_LEAST**2] * 3 + [0.0])

    def numbers_seen(J: Array) -> Array:
        return np.asarray(combinations @ numbers_of_moments(J + J[3, 3] * core))

    def within_reach(entries: Array) -> Array:
        L = np.zeros((4, 4))
        L[_LOWER] = entries
        far, near = float(np.linalg.norm(L[:3])), REACH * float(np.linalg.norm(L[3]))
        L[:3] *= min(1.0, near / far) if far else 1.0
        return L

    def miss(entries: Array) -> Array:
        L = within_reach(entries)
        return np.asarray(root @ (numbers_seen(L @ L.T) - x))

    guess = pseudo_inertia(np.linalg.pinv(combinations) @ x)
    value, axes = np.linalg.eigh(guess)
    size = max(float(value.max()), 1e-6)
    clipped = (axes * np.maximum(value, 1e-4 * size)) @ axes.T
    first = np.linalg.cholesky(clipped)[_LOWER]
    fit = scipy.optimize.least_squares(miss, first, x_scale="jac", max_nfev=_TRIES)
    L = within_reach(fit.x)
    return numbers_seen(L @ L.T)
