"""The six-axis force sensor under the arm (thesis 3.2.4, App. D and F).

true wrench -> 20 Hz filter -> sensor frame -> strain signal (gains, cross-talk) -> noise,
drift, bias -> quantisation -> zero -> calibration matrix -> platform frame.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import lru_cache

import numpy as np
import numpy.typing as npt
import scipy

from ves_gym._util.params import (
    Array,
    Mask,
    Matrix,
    ParameterError,
    Vector,
    finite,
    require_positive,
    unit,
)
from ves_gym.mechanics.link import matrix
from ves_gym.mechanics.spatial import skew

_UNIT_MATRIX = matrix(np.eye(6))


@dataclass(frozen=True, kw_only=True)
class ForceSensor:
    """Six-axis force sensor, and how its signals are read.

    The sensor frame is turned by pi about x against the platform-top frame and its origin
    lies at `offset` in platform axes (App. D, sign of the last term of M_z corrected).
    """

    cutoff: float = unit("Hz", default=20.0)  # second-order Butterworth, App. F
    offset: Vector = unit("m", default=(-0.001, -0.00066, 0.18944))  # App. D
    calibration: Matrix = unit("1", default=_UNIT_MATRIX)  # signals -> wrench, eq. 3.14
    zero: Vector = unit("N, N m", default=(0.0,) * 6)  # signals under no load, sensor frame
    force_resolution: float = unit("N", default=0.0)  # 0: not quantised
    moment_resolution: float = unit("N m", default=0.0)

    def __post_init__(self) -> None:
        require_positive(self, "cutoff")
        require_positive(self, "force_resolution", "moment_resolution", zero=True)
        finite(self.offset, (3,), "ForceSensor.offset")
        finite(self.zero, (6,), "ForceSensor.zero")
        square = finite(self.calibration, (6, 6), "ForceSensor.calibration")
        if np.linalg.cond(square) > 1e8:
            raise ParameterError(
                "ForceSensor.calibration must be invertible, got a condition number of"
                f" {np.linalg.cond(square):.3g}"
            )

    @property
    def frame(self) -> Array:
        """(6, 6): wrench in the sensor frame = frame @ wrench in the platform frame."""
        turn = np.diag([1.0, -1.0, -1.0])
        out = np.zeros((6, 6))
        out[:3, :3] = out[3:, 3:] = turn
        out[3:, :3] = -turn @ skew(np.array(self.offset))
        return out

    def calibrated(self, C: npt.ArrayLike, offset: npt.ArrayLike) -> ForceSensor:
        """The sensor read so that its wrench becomes C w + offset (eq. 3.14).

        Args:
            C: (6, 6) and offset: (6,), platform frame, as `calibration.fit` finds them.
        """
        correction = finite(C, (6, 6), "C")
        signals = self.frame @ correction @ np.linalg.solve(self.frame, self.calibration)
        out = replace(self, calibration=matrix(signals))  # refuses what has no inverse
        shift = np.linalg.solve(signals, self.frame @ finite(offset, (6,), "offset"))
        return replace(out, zero=tuple((np.array(self.zero) - shift).tolist()))

    @property
    def lag(self) -> float:
        """Delay of a slow signal [s]: sqrt(2) / w of the filter."""
        return float(np.sqrt(2) / (2 * np.pi * self.cutoff))


@dataclass
class SensorErrors:
    """Departures of n sensors from their description; leading axis n."""

    matrix: Array  # (n, 6, 6) relative gain errors and cross-talk of the signals
    bias: Array  # (n, 6) constant offset of the signals, sensor frame [N, N m]
    noise: Array  # (n, 6) standard deviation of the filtered signals
    drift: Array  # (n, 6) standard deviation of the slow drift
    drift_time: Array  # (n,) its correlation time [s]
    cutoff: Array  # (n,) of the filter [Hz]

    def random(self) -> Mask:
        """(n,) whether there is noise or drift."""
        return np.asarray(((self.noise > 0) | (self.drift > 0)).any(axis=-1), bool)

    def parts(self) -> list[Array]:
        """All arrays, in the order of the fields."""
        return [getattr(self, field.name) for field in fields(self)]

    @staticmethod
    def none(sensor: ForceSensor, n: int) -> SensorErrors:
        """Return the errors of n sensors as described: none.

        Args:
            sensor: the description.
            n: how many.
        """
        return SensorErrors(
            matrix=np.zeros((n, 6, 6)),
            bias=np.zeros((n, 6)),
            noise=np.zeros((n, 6)),
            drift=np.zeros((n, 6)),
            drift_time=np.full(n, 60.0),
            cutoff=np.full(n, sensor.cutoff),
        )


def low_pass(cutoff: Array, nodes: Array) -> tuple[Array, Array]:
    """Return second-order Butterworth filters, exact for inputs linear between nodes.

    The state is the output and its rate.

    Args:
        cutoff: (n,) [Hz].
        nodes: (k + 1,) equally spaced instants from 0 [s].

    Returns:
        Transition (n, 2, 2) over all nodes, and weights (n, 2, k + 1) of the inputs there.
    """
    h, k = float(nodes[1] - nodes[0]), len(nodes) - 1
    transition, weights = _of_each(cutoff, lambda f: _butterworth(f, h, k))
    return transition, weights


def _of_each(cutoff: Array, make: Callable[[float], tuple[Array, ...]]) -> list[Array]:
    """Matrices (n, ...) of filters, made once for those that are alike."""
    if (cutoff == cutoff[0]).all():
        parts = make(float(cutoff[0]))
        return [np.broadcast_to(part, (len(cutoff), *part.shape)) for part in parts]
    kinds, which = np.unique(cutoff, return_inverse=True)
    filters = [make(f) for f in kinds.tolist()]
    return [np.stack(part)[which] for part in zip(*filters, strict=True)]


@lru_cache(maxsize=1024)  # a reset asks for the same again
def _butterworth(cutoff: float, h: float, k: int) -> tuple[Array, Array]:
    """State transition (2, 2) over k steps of h, and weights (2, k + 1) of the inputs there."""
    w = 2 * np.pi * cutoff
    generator = np.zeros((4, 4))  # output, its rate, input, slope of the input
    generator[0, 1] = generator[2, 3] = 1.0
    generator[1, :3] = -(w**2), -np.sqrt(2) * w, w**2
    step = scipy.linalg.expm(generator * h)
    A = step[:2, :2]
    ahead = step[:2, 3] / h  # weight of the input at the end of a step
    present = step[:2, 2] - ahead
    weights = np.zeros((2, k + 1))
    hold = np.eye(2)
    for j in reversed(range(k)):
        weights[:, j] += hold @ present
        weights[:, j + 1] += hold @ ahead
        hold = hold @ A
    return hold, weights


def noise_steps(cutoff: Array, dt: float) -> tuple[tuple[Array, Array], Array]:
    """Return white noise through the filter, of unit variance, sampled.

    Args:
        cutoff: (n,) [Hz].
        dt: sample time [s].

    Returns:
        ((n, 2, 2) transition, (n, 2, 2) gain of fresh draws), (n, 2, 2) of the start.
    """
    holds, kicks, starts = _of_each(cutoff, lambda f: _noise_step(f, dt))
    return (holds, kicks), starts


@lru_cache(maxsize=1024)
def _noise_step(cutoff: float, dt: float) -> tuple[Array, Array, Array]:
    """Transition (2, 2) of one filter's noise, gain (2, 2) of fresh draws, and of the start."""
    w = 2 * np.pi * cutoff
    A = np.array([[0.0, 1.0], [-(w**2), -np.sqrt(2) * w]])
    # stationary: variance 1 of the output, w^2 of its rate, uncorrelated
    stationary = np.diag([1.0, w**2])
    hold = scipy.linalg.expm(A * dt)
    fresh = stationary - hold @ stationary @ hold.T
    kick = np.linalg.cholesky(fresh + 1e-12 * stationary)
    return hold, kick, np.sqrt(stationary)
