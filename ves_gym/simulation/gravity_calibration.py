"""The Model Method: weigh the arm and correct the force sensor at once (thesis 3.4.3 to 3.4.6).

Static poses of arm and platform give readings w. Unknown are the gravity model (M_total,
P), the correction C of the calibration matrix and the sensor's zero:
C w + offset = weight(q, y). Forces and moments of this are two separate problems.

Gauge. Every reading is explained as well when all forces, or all moments, are scaled
together with M_total, or P; or when the sensor is shifted by r, which adds r x F to the
moments and M_total r to P1..P3. Five numbers of C therefore cannot be observed and would
drift. They are taken from the manufacturer: the mean gain of the three forces, and of the
three moments, is right, and so is the sensor's place (the moment-from-force block of C has
no antisymmetric part). A scale error common to the real gains remains in M_total and P,
where it does no harm: estimate and reading share it.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import (
    Array,
    Matrix,
    ParameterError,
    Vector,
    finite,
    from_plain,
    read_table,
    unit,
)
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.gravity import GravityModel, MinimalModel, gravity_vector, minimal_model
from ves_gym.mechanics.link import matrix
from ves_gym.mechanics.spatial import skew

AXES = ("force x", "force y", "force z", "moment x", "moment y", "moment z")
# Smallest singular value, columns of unit length, at which poses still determine the mass
# parameters and the zero, and these with the matrix. `calibration_poses` give 0.06 and
# 0.003 (the matrix against the zero, quadratic in the tilt); a joint held still to 0.1 deg
# gives 0.001 or less, tilts of 0.01 rad 6e-5.
MODEL_DETERMINED, MATRIX_DETERMINED = 2e-3, 1e-4
STILL = np.deg2rad(1.0)  # a joint or tilt that varies by less is called still


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """Parameters of arm and force sensor from a set of poses. Residuals: estimate - reading."""

    arm: str
    model: GravityModel
    C: Matrix = unit("1, m, 1/m")  # (6, 6) true wrench = C reading + offset (eq. 3.14)
    offset: Vector = unit("N, N m")  # (6,) of the sensor's zero
    names: tuple[str, ...]  # of model.P
    poses: int
    iterations: int  # of the calibration matrix; 0: kept
    rms: Vector = unit("N, N m")  # (6,) of the residuals
    max: Vector = unit("N, N m")
    rms_before: Vector = unit("N, N m")  # the same, with the manufacturer's matrix
    max_before: Vector = unit("N, N m")
    history: Matrix = unit("N, N m")  # (iterations + 1, 6) rms
    condition: Vector = unit("1")  # of the mass parameters and zero; then with the matrix

    def __post_init__(self) -> None:
        finite(self.C, (6, 6), "Calibration.C")
        for name in ("offset", "rms", "max", "rms_before", "max_before"):
            finite(getattr(self, name), (6,), f"Calibration.{name}")
        finite(self.condition, (len(self.condition),), "Calibration.condition")
        finite(self.history, (len(self.history), 6), "Calibration.history")
        finite(self.model.P, (len(self.names),), "Calibration.model.P")

    def wrench(self, w: npt.ArrayLike) -> Array:
        """Return (..., 6) readings corrected by matrix and zero [N, N m]."""
        out: Array = np.asarray(w, float) @ np.array(self.C).T + np.array(self.offset)
        return out


def read_calibration(path: str | os.PathLike[str]) -> Calibration:
    """Read what `write_table(path, calibration)` wrote (.toml or .json)."""
    calibration: Calibration = from_plain(Calibration, read_table(path), str(path))
    return calibration


def calibration_poses(
    arm: Arm, count: int = 47, *, seed: int = 0, tilt: float = 0.15, margin: float = 0.05
) -> tuple[Array, Array]:
    """Poses that fill joint ranges and platform tilts evenly (the thesis took 47).

    Args:
        seed: start of the low-discrepancy sequence.
        tilt: largest |phi_x|, |phi_y| [rad]; phi_z and the position stay zero.
        margin: part of each joint's range left free at either limit.

    Returns:
        q (count, n) [rad] and y (count, 6) [m, rad].
    """
    if count < 1:
        raise ParameterError(f"count must be >= 1 poses, got {count}")
    if not (0 < tilt < np.pi / 2 and 0 <= margin < 0.5):
        raise ParameterError(
            f"need 0 < tilt < pi/2 rad and 0 <= margin < 0.5, got {tilt} and {margin}"
        )
    dimension = arm.n + 2
    root = 2.0  # of x^(d + 1) = x + 1: the golden ratio in d dimensions
    for _ in range(64):
        root = (1 + root) ** (1 / (dimension + 1))
    step = root ** -np.arange(1.0, dimension + 1)
    u = (np.random.default_rng(seed).random(dimension) + np.outer(np.arange(count), step)) % 1
    low, high = arm.column("q_min"), arm.column("q_max")
    q = low + (high - low) * (margin + (1 - 2 * margin) * u[:, : arm.n])
    y = np.zeros((count, 6))
    y[:, 3:5] = tilt * (2 * u[:, arm.n :] - 1)
    return q, y


# ------------------------------------------------------------------------------- fit


def fit(
    arm: Arm,
    q: npt.ArrayLike,
    y: npt.ArrayLike,
    w: npt.ArrayLike,
    *,
    iterations: int | None = 2,
    estimate_matrix: bool = True,
    estimate_offset: bool = True,
) -> Calibration:
    """Gravity model, sensor matrix and zero from static poses.

    Mass parameters and offset by least squares (eq. 3.5, 3.13), then the matrix with them
    held (eq. 3.17), in turns, from the manufacturer's matrix C = 1; after each turn the
    gauge (see the module) is set again, so nothing drifts.

    Args:
        q, y, w: (m, n) joint angles [rad], (m, 6) poses [m, rad] and readings [N, N m] in
            platform axes at the platform origin.
        iterations: turns; None solves for everything at once, which is where turns lead
            (exactly so without noise). The thesis took 2, which leaves a part of a large
            cross-talk: see `history`.
        estimate_matrix: False keeps the manufacturer's matrix.
        estimate_offset: False trusts the sensor's zero.

    Raises:
        ParameterError: wrong shapes, numbers that are not finite, or poses that leave
            something undetermined, which is named.
    """
    if iterations is not None and iterations < 1:
        raise ParameterError(f"iterations must be >= 1, got {iterations}")
    joints, pose, reading = _checked(arm, q, y, w)
    problem = _Problem(minimal_model(arm), joints, pose, estimate_offset)
    condition = [problem.require_model()]
    theta, offset = problem.masses(reading)
    C, turns, errors = np.eye(6), 0, [problem.weight(theta) - reading - offset]
    if estimate_matrix:
        condition.append(problem.require_matrix(theta))
        turns = iterations or 1
    for _ in range(turns):
        if iterations is None:
            theta, offset, C = problem.at_once(reading)
        else:
            C = _to_gauge(problem.sensor(theta, reading))
            theta, offset = problem.masses(reading @ C.T)
        errors.append(problem.weight(theta) - reading @ C.T - offset)
    if not theta[0] > 0:
        raise ParameterError(
            f"the readings give a mass of {theta[0]:.3g} kg: w must be the wrench of the arm"
            " on the base, in platform axes"
        )
    rms = np.sqrt(np.mean(np.square(errors), axis=1))
    largest = np.abs(errors).max(axis=1)
    return Calibration(
        arm=arm.name,
        model=GravityModel(
            mass=float(theta[0]),
            P=tuple(theta[1:].tolist()),
            source=f"calibration of {arm.name} with {len(joints)} poses",
        ),
        C=matrix(C),
        offset=tuple(offset.tolist()),
        names=minimal_model(arm).names,
        poses=len(joints),
        iterations=turns,
        rms=tuple(rms[-1].tolist()),
        max=tuple(largest[-1].tolist()),
        rms_before=tuple(rms[0].tolist()),
        max_before=tuple(largest[0].tolist()),
        history=matrix(rms),
        condition=tuple(condition),
    )


class LeftByNoise(NamedTuple):
    """Errors that the readings' noise leaves in a calibration, as weights of m standard normal
    numbers: an error is weights @ numbers, its covariance weights @ weights.T.
    """

    model: Array  # (1 + p, m) of M_total [kg] and P [kg m]
    C: Array  # (6, 6, m) of the matrix (eq. 3.14) [1, m, 1/m]


def left_by_noise(
    arm: Arm, q: npt.ArrayLike, y: npt.ArrayLike, noise: npt.ArrayLike
) -> LeftByNoise:
    """Errors of model and matrix after `fit(..., iterations=None)` that trusts the zero.

    The errors belong together: matrix and model have explained the same readings. Drawn each
    by itself they would leave a wrench several times too large. To first order.

    Args:
        arm: the arm, whose masses are taken as true.
        q, y: (m, n) joint angles [rad] and (m, 6) poses [m, rad], as for `fit`.
        noise: (6,) standard deviation of a reading [N, N m]; independent from pose to pose.
    """
    count = np.shape(q)[0] if np.ndim(q) else 0
    joints, pose, _ = _checked(arm, q, y, np.zeros((count, 6)))
    deviation = finite(noise, (6,), "noise")
    minimal = minimal_model(arm)
    problem = _Problem(minimal, joints, pose, offset=False)
    theta = np.concatenate([[arm.mass], minimal.parameters(arm)])
    problem.require_model()
    problem.require_matrix(theta)
    J = problem._columns(problem.weight(theta))
    size: Array = np.sqrt(np.sum(J**2, axis=0))
    answer = np.linalg.pinv(J / size) * np.tile(deviation, len(joints)) / size[:, None]
    # As many numbers as unknowns do, for 6 m readings. The symmetric root of the covariance:
    # singular vectors alone have signs, which are another processor's to choose.
    axes, lengths, _ = np.linalg.svd(answer, full_matrices=False)
    weights: Array = (axes * lengths) @ axes.T
    n = problem.A.shape[2]
    return LeftByNoise(weights[:n], np.tensordot(_FREE, weights[n:], axes=(0, 0)))


class Errors(NamedTuple):
    """Estimated minus measured wrench, per axis (thesis table 3-1)."""

    rms: Array  # (6,) N, N m
    max: Array  # (6,) of the absolute value


def predict_errors(
    calibration: Calibration,
    arm: Arm,
    q: npt.ArrayLike,
    y: npt.ArrayLike,
    w: npt.ArrayLike,
    *,
    rezero: bool = False,
) -> Errors:
    """Compare a calibration's prediction with other static readings.

    Args:
        calibration: from `fit`.
        arm, q, y, w: as for `fit`.
        rezero: the sensor has been zeroed since, so set its zero from the estimate in the
            first pose (thesis App. E step 9).
    """
    if calibration.names != minimal_model(arm).names:
        raise ParameterError(f"the calibration is of {calibration.arm}, not of {arm.name}")
    joints, pose, reading = _checked(arm, q, y, w)
    error = calibration.model.wrench(arm, joints, pose) - calibration.wrench(reading)
    if rezero:
        error = error - error[0]
    return Errors(np.sqrt(np.mean(error**2, axis=0)), np.abs(error).max(axis=0))


def _checked(
    arm: Arm, q: npt.ArrayLike, y: npt.ArrayLike, w: npt.ArrayLike
) -> tuple[Array, Array, Array]:
    """The three arrays, finite and of matching shapes."""
    count = np.shape(q)[0] if np.ndim(q) else 0
    if count < 1:
        raise ParameterError(f"q must have shape (m, {arm.n}) with m >= 1, got {np.shape(q)}")
    return (
        finite(q, (count, arm.n), "q"),
        finite(y, (count, 6), "y"),
        finite(w, (count, 6), "w"),
    )


# ------------------------------------------------------------------------ the gauge


def _gauge_directions() -> Array:
    """(5, 6, 6) changes of C that no reading shows: two scales and three shifts."""
    out = np.zeros((5, 6, 6))
    out[0, :3, :3] = out[1, 3:, 3:] = np.eye(3)
    for k, r in enumerate(np.eye(3)):
        out[2 + k, 3:, :3] = skew(r)
    return out


_GAUGE = _gauge_directions()
_FREE: Array = np.linalg.svd(_GAUGE.reshape(5, 36))[2][5:].reshape(31, 6, 6)


def _to_gauge(C: Array) -> Array:
    """The matrix L C, equivalent to C, whose gauge is that of the manufacturer's matrix."""
    projection = np.einsum("jab,kac,cb->jk", _GAUGE, _GAUGE, C)
    traces = np.einsum("jaa->j", _GAUGE)
    L = np.tensordot(np.linalg.solve(projection, traces), _GAUGE, axes=1)
    return L @ C


# --------------------------------------------------------------------- least squares


class _Problem:
    """C w + offset = A theta over m poses, theta = (M_total, P)."""

    def __init__(self, model: MinimalModel, q: Array, y: Array, offset: bool) -> None:
        self.q, self.y, self.count = q, y, len(q)
        g = gravity_vector(y)
        self.A = np.zeros((self.count, 6, 1 + model.size))
        self.A[:, :3, 0] = g
        self.A[:, 3:, 1:] = model.G(q, g)
        self.zero = np.eye(6)[:, : 6 if offset else 0]
        self.names = [
            "M_total",
            *(f"P{j} ({name})" for j, name in enumerate(model.names, start=1)),
            *(f"zero of {axis}" for axis in AXES if offset),
        ]

    def weight(self, theta: Array) -> Array:
        """(m, 6) gravity wrench."""
        return self.A @ theta

    def masses(self, wrench: Array) -> tuple[Array, Array]:
        """theta and offset (6,) from true wrenches up to that offset (eq. 3.5, 3.13)."""
        x = np.linalg.lstsq(self._columns(), wrench.ravel())[0].astype(np.float64)
        return self._split(x)

    def sensor(self, theta: Array, reading: Array) -> Array:
        """Return C (6, 6) from readings of known weights (eq. 3.17, with a zero beside it)."""
        ones = np.ones((self.count, min(1, self.zero.shape[1])))
        x = np.linalg.lstsq(np.hstack([reading, ones]), self.weight(theta))[0]
        out: Array = x[:6].T
        return out

    def at_once(self, reading: Array) -> tuple[Array, Array, Array]:
        """theta, offset and C together: where the turns lead in the end."""
        J = self._columns(reading)
        size: Array = np.sqrt(np.sum(J**2, axis=0))
        x: Array = np.linalg.lstsq(J / size, reading.ravel())[0] / size
        return *self._split(x), np.eye(6) + np.tensordot(x[-31:], _FREE, axes=1)

    def _split(self, x: Array) -> tuple[Array, Array]:
        n, k = self.A.shape[2], self.zero.shape[1]
        return x[:n], self.zero @ x[n : n + k]

    def _columns(self, reading: Array | None = None) -> Array:
        """Jacobian (6 m, ...) of A theta - offset - (C - 1) w."""
        blocks = [self.A, np.broadcast_to(-self.zero, (self.count, *self.zero.shape))]
        if reading is not None:
            blocks.append(-np.einsum("kab,mb->mak", _FREE, reading))
        return np.concatenate(blocks, axis=2).reshape(6 * self.count, -1)

    # ------------------------------------------------------------- identifiability

    def require_model(self) -> float:
        """Condition number of the mass parameters and zero, or what is undetermined."""
        condition, null, _ = _null_space(self._columns(), MODEL_DETERMINED)
        if len(null):
            self._refuse([self.names[j] for j in _large(np.linalg.norm(null, axis=0))])
        return condition

    def require_matrix(self, theta: Array) -> float:
        """The same together with C. From the weights: noise would hide a missing direction."""
        J = self._columns(self.weight(theta))
        condition, null, size = _null_space(J, MATRIX_DETERMINED)
        if len(null):
            hidden = np.tensordot((null / size)[:, -31:], _FREE, axes=1)
            axes = [AXES[j] for j in _large(np.linalg.norm(hidden, axis=(0, 1)))]
            self._refuse([f"the calibration matrix's answer to {' and '.join(axes)}"])
        return condition

    def _refuse(self, missing: list[str]) -> None:
        others = f" and {len(missing) - 4} more" if len(missing) > 4 else ""
        joints = [str(i + 1) for i in np.flatnonzero(np.std(self.q, axis=0) < STILL)]
        tilts = [
            f"phi_{k}" for k, v in zip("xy", self.y.T[3:5], strict=True) if np.std(v) < STILL
        ]
        advice = [f"vary joint {' and '.join(joints)}"] if joints else []
        advice += [f"tilt the platform in {' and '.join(tilts)}"] if tilts else []
        raise ParameterError(
            f"the {self.count} poses do not determine {', '.join(missing[:4])}{others}:"
            f" {'; '.join(advice) or 'take more poses, spread further'}"
        )


def _large(share: Array) -> list[int]:
    return np.flatnonzero(share > 0.3 * share.max()).tolist()


def _null_space(J: Array, least: float) -> tuple[float, Array, Array]:
    """With the columns of J scaled to unit length: its condition number, the directions
    (k, n) whose singular value is below `least`, and the lengths (n,).
    """
    size = np.linalg.norm(J, axis=0)
    size[size == 0] = 1.0
    values, vectors = np.linalg.eigh((J / size).T @ (J / size))
    singular = np.sqrt(np.clip(values, 0.0, None))
    condition = singular[-1] / max(singular[0], np.finfo(float).tiny)
    return float(condition), vectors.T[singular < least], size
