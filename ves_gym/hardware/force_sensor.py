"""The six-axis force sensor under the arm (thesis 3.2.4, App. D and F).

true wrench -> 20 Hz filter -> sensor frame -> strain signal (gains, cross-talk) -> noise,
drift, bias -> quantisation -> zero -> calibration matrix -> platform frame.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
import numpy.typing as npt
import scipy

from ves_gym._util.params import (
    Array,
    Index,
    Mask,
    Matrix,
    ParameterError,
    Vector,
    finite,
    require_positive,
    unit,
)
from ves_gym.mechanics.arm import matrix, skew
from ves_gym.mechanics.spatial import matvec

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


class LowPass:
    """Second-order Butterworth of a batch of signals, exact for inputs linear between nodes.

    State (n, channels, 2): the output and its rate.
    """

    def __init__(self, cutoff: Array, nodes: Array) -> None:
        """`cutoff` (n,) [Hz]; `nodes` (k + 1,) equally spaced instants from 0 [s]."""
        self._cutoff, self._nodes = cutoff.copy(), nodes
        kinds, which = np.unique(cutoff, return_inverse=True)
        parts = [_butterworth(float(f), nodes) for f in kinds]
        alike = len(kinds) == 1  # all alike: one matrix serves the batch
        pick = np.zeros(1, np.intp) if alike else which
        self._hold = np.stack([p[0] for p in parts])[pick]  # (1 or n, 2, 2)
        self._input = np.stack([p[1] for p in parts])[pick]  # (1 or n, 2, k + 1)

    def put(self, ids: Index, cutoff: Array) -> None:
        """Give some filters another cutoff.

        Args:
            ids: (m,) which.
            cutoff: (m,) [Hz].
        """
        changed = cutoff != self._cutoff[ids]
        if changed.any() and len(self._hold) == 1:
            n = len(self._cutoff)
            self._hold, self._input = (np.repeat(k, n, 0) for k in (self._hold, self._input))
        for i, f in zip(ids[changed].tolist(), cutoff[changed].tolist(), strict=True):
            self._hold[i], self._input[i] = _butterworth(f, self._nodes)
            self._cutoff[i] = f

    def advance(self, state: Array, nodes: Array) -> Array:
        """Return the state after one period.

        Args:
            state: (n, channels, order).
            nodes: (n, k + 1, channels) inputs at the period's nodes, linear between them.
        """
        driven = np.swapaxes(self._input @ nodes, -1, -2)  # (n, channels, 2)
        return state @ np.swapaxes(self._hold, -1, -2) + driven

    def carry(self, state: Array, nodes: Array, factor: Array, steady: Array) -> Array:
        """Return `advance` under inputs factor @ nodes + steady.

        Args:
            state, nodes: see `advance`.
            factor: (n, 6, 6).
            steady: (n, 6).
        """
        driven = np.swapaxes(self._input @ nodes, -1, -2)  # (n, 6, 2)
        total = self._input.sum(axis=-1)[:, None, :]  # of an input that holds
        response = state @ np.swapaxes(self._hold, -1, -2)
        out: Array = response + factor @ driven + steady[..., None] * total
        return out


def _butterworth(cutoff: float, nodes: Array) -> tuple[Array, Array]:
    """State transition (2, 2) over all nodes, and weights (2, k + 1) of the inputs there."""
    w, h, k = 2 * np.pi * cutoff, float(nodes[1] - nodes[0]), len(nodes) - 1
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


@dataclass
class SensorState:
    """Memory of n sensors."""

    filter: Array  # (n, 6, 2) platform frame
    noise: Array  # (n, 6, 2) unit-variance noise after the same filter
    drift: Array  # (n, 6) in units of its standard deviation
    zero: Array  # (n, 6) signal subtracted, sensor frame


class Sensor:
    """n force sensors at work; readings once per control period."""

    def __init__(self, sensor: ForceSensor, errors: SensorErrors, nodes: Array) -> None:
        n = len(errors.bias)
        self.spec, self.errors = sensor, errors
        self._low_pass = LowPass(errors.cutoff, nodes)
        self._to_signal = (np.eye(6) + errors.matrix) @ sensor.frame
        self._to_wrench = np.linalg.solve(sensor.frame, np.array(sensor.calibration))
        self._step = np.array([sensor.force_resolution] * 3 + [sensor.moment_resolution] * 3)
        self._noisy = errors.random()
        self._period = float(nodes[-1])
        self._noise_step = _noise_steps(errors.cutoff, self._period)
        self._drift_hold = np.exp(-nodes[-1] / errors.drift_time)[:, None]
        self.state = SensorState(*(np.zeros((n, 6, 2)) for _ in range(2)), *np.zeros((2, n, 6)))

    def silence(self) -> None:
        """No more noise and drift, for good."""
        self.errors.noise[:], self.errors.drift[:], self._noisy[:] = 0.0, 0.0, False

    def put(self, ids: Index, errors: SensorErrors) -> None:
        """Give some sensors other errors; their memory stays as it is.

        Args:
            ids: (m,) which.
            errors: of m sensors.
        """
        e = self.errors
        refiltered = ids[errors.cutoff != e.cutoff[ids]]
        for mine, changed in zip(e.parts(), errors.parts(), strict=True):
            mine[ids] = changed
        self._low_pass.put(ids, errors.cutoff)
        self._to_signal[ids] = (np.eye(6) + errors.matrix) @ self.spec.frame
        self._noisy[ids] = errors.random()
        if len(refiltered):
            (hold, kick), start = _noise_steps(e.cutoff[refiltered], self._period)
            (holds, kicks), starts = self._noise_step
            holds[refiltered], kicks[refiltered], starts[refiltered] = hold, kick, start
        self._drift_hold[ids] = np.exp(-self._period / errors.drift_time)[:, None]

    def reset(self, ids: Index, wrench: Array, generators: list[np.random.Generator]) -> None:
        """Put sensors to rest under a constant wrench; drift starts from zero.

        Args:
            ids: (m,) which.
            wrench: (m, 6) true wrench [N, N m].
            generators: one per sensor, of noise and drift.
        """
        s = self.state
        s.filter[ids] = np.stack([wrench, np.zeros_like(wrench)], axis=-1)
        s.drift[ids], s.noise[ids], s.zero[ids] = 0.0, 0.0, self.spec.zero
        _, start = self._noise_step
        for i in ids:
            if self._noisy[i]:  # start as noisy as it goes on
                draw = generators[i].standard_normal((6, 2))
                s.noise[i] = draw @ start[i].T

    def warm_up(self, generators: list[np.random.Generator]) -> None:
        """Drift as it is long after the sensor was reset."""
        draws = np.stack([g.standard_normal(6) for g in generators])
        self.state.drift = np.where(self.errors.drift > 0, draws, 0.0)

    def advance(self, nodes: Array, generators: list[np.random.Generator]) -> None:
        """Run one control period.

        Args:
            nodes: (n, k + 1, 6) true wrench at the period's nodes [N, N m].
            generators: one per sensor, of noise and drift.
        """
        s = self.state
        s.filter = self._low_pass.advance(s.filter, nodes)
        noisy = np.flatnonzero(self._noisy)
        if len(noisy):  # the others draw no numbers
            draws = np.stack([generators[i].standard_normal(18) for i in noisy])
            rows = noisy if len(noisy) < len(s.noise) else slice(None)
            hold, kick = (np.swapaxes(part[rows], -1, -2) for part in self._noise_step[0])
            s.noise[rows] = s.noise[rows] @ hold + draws[:, :12].reshape(-1, 6, 2) @ kick
            a = self._drift_hold[rows]
            s.drift[rows] = a * s.drift[rows] + np.sqrt(1 - a**2) * draws[:, 12:]

    def signal(self) -> Array:
        """(n, 6) strain signals in the sensor frame, as converted, before the zero."""
        s, e = self.state, self.errors
        true = np.matmul(self._to_signal, s.filter[..., 0, None])[..., 0]
        out = true + e.bias + e.noise * s.noise[..., 0] + e.drift * s.drift
        fine = self._step > 0
        if fine.any():
            out[:, fine] = np.round(out[:, fine] / self._step[fine]) * self._step[fine]
        return np.asarray(out, dtype=np.float64)

    def reading(self) -> Array:
        """(n, 6) wrench in the platform frame as the controller takes it."""
        return matvec(self._to_wrench, self.signal() - self.state.zero)

    def zero_to(self, ids: Index, wrench: Array) -> None:
        """Set the zero so that the present reading becomes `wrench` (App. E step 9).

        Args:
            ids: (m,) which sensors.
            wrench: (m, 6) [N, N m].
        """
        target = np.linalg.solve(self._to_wrench, wrench[..., None])[..., 0]
        self.state.zero[ids] = self.signal()[ids] - target


def _noise_steps(cutoff: Array, dt: float) -> tuple[tuple[Array, Array], Array]:
    """White noise through the filter, of unit variance, sampled every dt.

    Returns ((n, 2, 2) transition, (n, 2, 2) gain of fresh draws), (n, 2, 2) of the start.
    """
    kinds, which = np.unique(cutoff, return_inverse=True)
    holds, kicks, starts = [], [], []
    for f in kinds:
        w = 2 * np.pi * float(f)
        A = np.array([[0.0, 1.0], [-(w**2), -np.sqrt(2) * w]])
        # stationary: variance 1 of the output, w^2 of its rate, uncorrelated
        stationary = np.diag([1.0, w**2])
        hold = scipy.linalg.expm(A * dt)
        fresh = stationary - hold @ stationary @ hold.T
        holds.append(hold)
        kicks.append(np.linalg.cholesky(fresh + 1e-12 * stationary))
        starts.append(np.sqrt(stationary))
    return (np.stack(holds)[which], np.stack(kicks)[which]), np.stack(starts)[which]
