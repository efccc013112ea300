"""What could have made the thesis's identified weight differ from the measured one?

    python examples/thesis_weight/by_hand.py

Without the workflow: the formulas of thesis C.2, and least squares. For each physical cause
the part of the difference that it leaves, whatever its size, over 47 poses.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

import ves_gym as vg

Array = npt.NDArray[Any]

# Thesis C.3: kg, kg m. Sign of the measured P5 restored (docs/errata.md).
IDENTIFIED = np.array(
    [95.065, 0.1028, 0.8352, 45.7104, 0.1593, -5.8440, 4.6137, 0.1298, 2.2527, -0.0738]
)
MEASURED = np.array([93.678, 0, 0, 54.54, 0, -5.308, 5.065, 0.1044, 2.617, 0])
LENGTHS = {"d1": 0.22844 + 0.672, "d2": -0.2435, "d3": 0.098, "a2": 0.4318, "a3": 0.4331}
LIMIT = np.array([1.0] * 3 + [1.5] * 3)  # N, N m: what the thesis allows (3.2.3)
_STEP = 1e-6  # rad, of differences


def gravity(y: Array) -> Array:
    """(m, 3) free fall in platform axes (eq. 3.4)."""
    x, z = y[:, 3], y[:, 4]
    return 9.81 * np.stack([np.sin(z), -np.sin(x) * np.cos(z), -np.cos(x) * np.cos(z)], -1)


def directions(q: Array) -> Array:
    """(m, 3, 9) along which each minimal parameter lies (C.2)."""
    c1, c2, c23 = np.cos(q[:, 0]), np.cos(q[:, 1]), np.cos(q[:, 1] + q[:, 2])
    s1, s2, s23 = np.sin(q[:, 0]), np.sin(q[:, 1]), np.sin(q[:, 1] + q[:, 2])
    o, l = np.zeros(len(q)), np.ones(len(q))
    columns = [
        (l, o, o),
        (o, l, o),
        (o, o, l),
        (c1, s1, o),
        (s1, -c1, o),
        (c1 * c2, s1 * c2, s2),
        (-c1 * s2, -s1 * s2, c2),
        (c1 * c23, s1 * c23, s23),
        (-c1 * s23, -s1 * s23, c23),
    ]
    return np.stack([np.stack(k, -1) for k in columns], -1)


def weight(x: Array, q: Array, y: Array) -> Array:
    """(m, 6) force and moment of an arm with mass and parameters x (10,) (eq. 3.3a, 3.9)."""
    g = gravity(y)
    return np.hstack([x[0] * g, np.cross(directions(q) @ x[1:], g)])


def causes(x: Array, q: Array, y: Array) -> Iterator[tuple[str, list[Array]]]:
    """Name and the wrenches (m, 6) per unit of each free number of a cause, to first order."""
    w = weight(x, q, y)
    force, moment = w * [1, 1, 1, 0, 0, 0], w * [0, 0, 0, 1, 1, 1]
    zero = [np.tile(row, (len(q), 1)) for row in np.eye(6)]
    matrix = [np.outer(w[:, j], row) for row in np.eye(6) for j in range(6)]
    place = [np.hstack([0 * w[:, :3], np.cross(r, w[:, :3])]) for r in np.eye(3)]
    mass = [weight(row, q, y) for row in np.eye(10)]
    a = LENGTHS
    at_tool = np.array([1, 0, 0, a["d1"], 0, a["d2"] + a["d3"], a["a2"], 0, a["a3"], 0])
    tool, tool_com = weight(at_tool, q, y), [mass[8], mass[9], mass[5]]

    def turned(k: int) -> Array:
        r = np.eye(3)[k]
        return np.hstack([np.cross(w[:, :3], r), np.cross(w[:, 3:], r)])

    def tilted(k: int) -> Array:
        return (weight(x, q, y + _STEP * np.eye(6)[3 + k]) - w) / _STEP

    def moved(k: int) -> Array:
        return (weight(x, q + _STEP * np.eye(3)[k], y) - w) / _STEP

    joints = [moved(k) for k in range(3)]
    yield "turn of the sensor", [turned(k) for k in range(3)]
    yield "error of the platform's tilt", [tilted(0), tilted(1)]
    yield "zeros of the joints", joints
    yield "tool's centre of mass", tool_com
    yield "payload at the tool", [tool]
    yield "payload anywhere on the last link", [tool, *tool_com]
    yield "one gain for forces, one for moments", [force, moment]
    yield "six gains", [w * row for row in np.eye(6)]
    yield "zero of the sensor", zero
    yield "two gains, place of the sensor", [force, moment, *place]
    yield "the same, zeros of the joints", [force, moment, *place, *joints]
    yield "any matrix and zero of the sensor", [*matrix, *zero]
    yield "mass and centre of mass of the foot", mass[:4]
    yield "the same, tool's centre of mass", [*mass[:4], *tool_com]
    yield "all mass parameters", mass


def left(difference: Array, columns: list[Array]) -> tuple[Array, Array]:
    """Sizes (k,) of a cause that fit best, and what they leave (m, 6)."""
    A = np.stack([(c / LIMIT).ravel() for c in columns], 1)
    x = np.linalg.lstsq(A, (difference / LIMIT).ravel())[0]
    return x, difference - np.tensordot(x, np.array(columns), axes=1)


def size(w: Array) -> tuple[float, float]:
    """Root mean square of forces [N] and of moments [N m]."""
    return float(np.sqrt(np.mean(w[:, :3] ** 2))), float(np.sqrt(np.mean(w[:, 3:] ** 2)))


def explained(described: Array = MEASURED) -> dict[str, tuple[int, Array, float, float]]:
    """Cause -> how many numbers, their sizes, and what they leave [N], [N m]."""
    q, y = vg.simulation.calibration_poses(vg.PUMA_560, 47, tilt=np.deg2rad(5))
    difference = weight(IDENTIFIED - described, q, y)
    out = {"nothing": (0, np.zeros(0), *size(difference))}
    for name, columns in causes(described, q, y):
        x, rest = left(difference, columns)
        out[name] = (len(x), x, *size(rest))
    return out


def main() -> None:
    """Print what every cause leaves."""
    print(f"{'cause':40s} numbers  force left [N]  moment left [N m]")
    for name, (k, x, force, moment) in explained().items():
        sizes = " ".join(f"{v:.4g}" for v in x) if k < 6 else ""
        print(f"{name:40s} {k:7d} {force:15.2f} {moment:18.2f}  {sizes}")


if __name__ == "__main__":
    main()
