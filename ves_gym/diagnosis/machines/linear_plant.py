"""A linear plant with inputs and outputs, x' = A x + B u, y = C x + D u, as a machine.

It is run on the measured input, from a start that every run has of its own. A structure given
by M, D, K is the same with a force on some coordinates and some of them measured.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
import scipy

from ves_gym._util.params import Array, ParameterError, require_positive, unit
from ves_gym.diagnosis.data.measured_run import Run
from ves_gym.diagnosis.inference.candidates import Candidate
from ves_gym.diagnosis.machines.base import Nuisance, Port
from ves_gym.diagnosis.machines.plant import (
    Effects,
    PlantEffect,
    PlantMachine,
    Size,
    candidate_of,
    of_kind,
    plant_effect,
)

_DERIVATIVES = {"displacement": 0, "velocity": 1, "acceleration": 2}
_GRID = 8  # frequencies at which another mode is looked for
_LARGE = 3.0  # start of a run, by what it moves the output, over the output's own movement


@dataclass(frozen=True, eq=False)
class StateSpace:
    """x' = A x + B u, y = C x + D u."""

    A: Array  # (n, n)
    B: Array  # (n, m)
    C: Array  # (p, n)
    D: Array  # (p, m)
    derivative: int = 0  # that outputs are of displacements: 0, 1, 2

    def __post_init__(self) -> None:
        n, m, p = len(self.A), self.B.shape[1], len(self.C)
        shapes = [x.shape for x in (self.A, self.B, self.C, self.D)]
        if shapes != [(n, n), (n, m), (p, n), (p, m)]:
            raise ParameterError(f"A, B, C, D do not fit one another: shapes {shapes}")
        fastest = float(np.linalg.eigvals(self.A).real.max(initial=0.0))
        if fastest > 1e-9:
            raise ParameterError(
                f"the plant is unstable (pole at {fastest:.3g} 1/s): its output does not follow"
                " from its input"
            )


def structure(
    mass: Array, damping: Array, stiffness: Array, force: Array, measured: Array, reads: str
) -> StateSpace:
    """Return M x'' + D x' + K x = F u with output S x or its derivative.

    Args:
        mass, damping, stiffness: (n, n).
        force: (n, m) of each input on each coordinate.
        measured: (p, n).
        reads: displacement, velocity or acceleration.

    Raises:
        ParameterError: shapes, or a mass that is not positive definite.
    """
    n = len(mass)
    square = [x.shape for x in (mass, damping, stiffness)]
    if square != [(n, n)] * 3 or force.shape[0] != n or measured.shape[1] != n:
        raise ParameterError(
            f"M, D, K, force, output do not fit: {square}, {force.shape}, {measured.shape}"
        )
    if reads not in _DERIVATIVES:
        raise ParameterError(f"reads must be {', '.join(_DERIVATIVES)}, got {reads!r}")
    if not np.linalg.eigvalsh((mass + mass.T) / 2)[0] > 0:
        raise ParameterError("M must be positive definite")
    inverse = np.linalg.inv(mass)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ stiffness, -inverse @ damping]])
    B = np.vstack([np.zeros_like(force), inverse @ force])
    C, D = np.hstack([measured, np.zeros_like(measured)]), np.zeros((len(measured), B.shape[1]))
    for _ in range(_DERIVATIVES[reads]):
        C, D = C @ A, C @ B
    return StateSpace(A, B, C, D, _DERIVATIVES[reads])


@plant_effect("plant/gain")
@dataclass(frozen=True)
class PlantGain(PlantEffect):
    """Outputs that are larger than described."""

    error: float  # relative


@plant_effect("plant/delay")
@dataclass(frozen=True)
class PlantDelay(PlantEffect):
    """Outputs that are later than described."""

    delay: float  # s


@plant_effect("plant/offset")
@dataclass(frozen=True)
class PlantOffset(PlantEffect):
    """A constant added to an output."""

    output: int
    offset: float


@plant_effect("plant/mode")
@dataclass(frozen=True)
class PlantMode(PlantEffect):
    """A mode of the plant of another frequency or damping, its residue the same: another
    stiffness or damping of what it moves."""

    mode: int
    frequency: float = 0.0  # relative error
    damping: float = 0.0  # relative error


@plant_effect("plant/extra_mode")
@dataclass(frozen=True)
class PlantExtraMode(PlantEffect):
    """A mode besides those described, between the first input and the first output."""

    frequency: float  # Hz
    damping_ratio: float
    gain: float  # static, output per input


@dataclass(frozen=True)
class StartState(PlantEffect):
    """State in which a run begins."""

    kind = "plant/start"
    run: str
    state: tuple[float, ...]


@dataclass(frozen=True)
class PlantTolerance:
    """Usual errors of a plant's description, standard deviations."""

    gain: float = unit("1", default=0.002)
    frequency: float = unit("1", default=0.002)
    damping: float = unit("1", default=0.02)
    unexplained: float = unit("1", default=0.0)

    def __post_init__(self) -> None:
        require_positive(self, "gain", "frequency", "damping")


class LinearMachine(PlantMachine):
    """Port `output` of a linear plant.

    Args:
        name: of the machine.
        plant: as described.
        outputs: names and units, (p,).
        tolerance: of the description.
        effects: that the description has.
        input_exact: the input is what the plant was given; else it is measured, with noise.
        held: the input is held from sample to sample; else it is a line between them.
        known: sizes of single tolerances.
    """

    effects = (PlantGain, PlantDelay, PlantOffset, PlantMode, PlantExtraMode)

    def __init__(
        self,
        name: str,
        plant: StateSpace,
        outputs: Sequence[tuple[str, str]],
        tolerance: PlantTolerance | None = None,
        effects: Sequence[PlantEffect] = (),
        *,
        input_exact: bool = True,
        held: bool = False,
        known: Mapping[str, float] | None = None,
    ) -> None:
        self.plant, self.tolerance = plant, tolerance or PlantTolerance()
        self.held = held
        super().__init__(name, effects, known, self.tolerance.unexplained)
        if len(outputs) != len(plant.C):
            raise ParameterError(
                f"{len(plant.C)} outputs are described, {len(outputs)} have columns"
            )
        self.ports = (
            Port(
                "output",
                "output less that of the plant on its measured input",
                tuple(k for k, _ in outputs),
                tuple(u for _, u in outputs),
                ("input", "output"),
                ("input",) if input_exact else (),
                signal="output",
            ),
        )

    @cached_property
    def modes(self) -> list[int]:
        """Poles that stand for a mode each: one of every pair, and real ones."""
        poles = self._modal[0]
        return [k for k in np.argsort(np.abs(poles)).tolist() if poles[k].imag >= 0]

    @cached_property
    def _modal(self) -> tuple[Array, Array]:
        poles, shapes = np.linalg.eig(self.plant.A)
        return poles, shapes

    def tolerances(self) -> list[Nuisance]:
        """Return errors of gain and of every mode."""
        allowed, port = self.tolerance, ("output",)
        out = [Nuisance("gain", port, self.model([PlantGain(0.01)]), 0.01, allowed.gain)]
        for i, k in enumerate(self.modes):
            for what, std in (("frequency", allowed.frequency), ("damping", allowed.damping)):
                if what == "damping" and not self._swings(k):
                    continue
                model = self.model([_mode(i, what, np.array([0.01]))])
                out.append(Nuisance(f"{what} of mode {i + 1}", port, model, 0.01, std))
        return out

    def unknowns(self, run: Run) -> Sequence[Nuisance]:
        """Return the state at the start of a run, direction by direction."""
        size = np.maximum(run["output"].std(axis=-2).max(), 1e-300)
        out = []
        for k in range(len(self.plant.A)):
            start = np.eye(len(self.plant.A))[k]
            moved = self._free(self.plant, run, start)
            std = _LARGE * float(size / np.maximum(np.sqrt(np.square(moved).mean()), 1e-300))
            model = self.model([StartState(run.name, tuple((std * start).tolist()))])
            name = f"start of {run.name}, state {k + 1}"
            out.append(Nuisance(name, ("output",), model, 1.0, 1.0))
        return out

    def candidates(self) -> tuple[Candidate, ...]:
        """Return gain, delay, offsets, errors of every mode, another mode."""
        port = ("output",)
        far = 0.9
        gain, delay = Size("error", "1", 0.05, -far, 10.0), Size("delay", "s", 2e-3, 0.0, 1.0)
        out = [
            candidate_of(PlantGain, port, [gain], lambda x: PlantGain(float(x[0]))),
            candidate_of(PlantDelay, port, [delay], lambda x: PlantDelay(float(x[0]))),
        ]
        ((names, units),) = ((p.channels, p.units) for p in self.ports)
        for i, (name, symbol) in enumerate(zip(names, units, strict=True)):
            number = Size("offset", symbol, 1.0, -1e9, 1e9)
            out.append(
                candidate_of(
                    PlantOffset,
                    port,
                    [number],
                    partial(_offset, i),
                    name,
                )
            )
        for i, k in enumerate(self.modes):
            hertz = abs(self._modal[0][k]) / (2 * np.pi)
            for what in ("frequency", "damping"):
                if not self._swings(k) and what == "damping":
                    continue
                number = Size(what, "1", 0.03, -far, 10.0 if what == "damping" else 2.0)
                out.append(
                    candidate_of(
                        PlantMode,
                        port,
                        [number],
                        partial(_mode, i, what),
                        f"{what} of mode {i + 1} ({hertz:.3g} Hz)",
                    )
                )
        numbers = [
            Size("frequency", "Hz", 1.0, 1e-3, 1e4),
            Size("damping_ratio", "1", 0.02, 1e-4, 1.0),
            Size("gain", "1", self._static, -1e9, 1e9),
        ]
        swinging = [abs(self._modal[0][k]) for k in self.modes] or [1.0]
        tried = np.geomspace(0.3 * min(swinging), 5.0 * max(swinging), _GRID) / (2 * np.pi)
        out.append(
            candidate_of(
                PlantExtraMode,
                port,
                numbers,
                lambda x: PlantExtraMode(*(float(k) for k in x)),
                starts=[(f, 0.02, 0.1 * self._static) for f in tried.tolist()],
                factors=[2],
            )
        )
        return tuple(out)

    def residual(self, run: Run, port: str, effects: Effects) -> Array:
        """Return the output less that of the plant, (..., T, p)."""
        plant = self._changed(effects)
        y = self._forced(plant, run)
        for start in of_kind(effects, StartState):
            if start.run == run.name:
                y = y + self._free(plant, run, np.array(start.state))
        late = sum(e.delay for e in of_kind(effects, PlantDelay))
        if late:
            t = run.dt * np.arange(run.length)
            at = np.maximum(t - late, 0.0)
            y = scipy.interpolate.CubicSpline(t, y, axis=-2)(at)
        y = y * (1 + sum(e.error for e in of_kind(effects, PlantGain)))
        for e in of_kind(effects, PlantOffset):
            y = y + e.offset * np.eye(len(plant.C))[e.output]
        return np.asarray(run["output"] - y)

    @property
    def _static(self) -> float:
        """Gain at rest of the first input on the first output, or of a plant without one 1."""
        p = self.plant
        if np.linalg.cond(p.A) > 1e12:
            return 1.0
        gain = float((p.D - p.C @ np.linalg.solve(p.A, p.B))[0, 0])
        return abs(gain) or float(np.abs(p.D[0, 0])) or 1.0

    def _swings(self, k: int) -> bool:
        return abs(self._modal[0][k].imag) > 1e-9 * abs(self._modal[0][k])

    def _changed(self, effects: Effects) -> StateSpace:
        """The plant with other modes."""
        plant = self.plant
        changes = of_kind(effects, PlantMode)
        if changes:
            plant = self._with_modes(changes)
        for e in of_kind(effects, PlantExtraMode):
            w = 2 * np.pi * e.frequency
            inner = np.array([[0.0, 1.0], [-(w**2), -2 * e.damping_ratio * w]])
            enters = np.zeros((2, plant.B.shape[1]))
            enters[1, 0] = e.gain * w**2
            leaves = np.zeros((len(plant.C), 2))
            leaves[0, 0] = 1.0
            plant = StateSpace(
                scipy.linalg.block_diag(plant.A, inner),
                np.vstack([plant.B, enters]),
                np.hstack([plant.C, leaves]),
                plant.D,
                plant.derivative,
            )
        return plant

    def _with_modes(self, changes: Sequence[PlantMode]) -> StateSpace:
        """The plant with other poles: what a mode moves and is moved by stays the same."""
        plant, (poles, shapes) = self.plant, self._modal
        new, into, out = poles.copy(), np.linalg.inv(shapes) @ plant.B, plant.C @ shapes
        for e in changes:
            k = self.modes[e.mode]
            if not self._swings(k):
                new[k] *= 1 + e.frequency
                continue
            twin = int(np.argmin(np.abs(poles - poles[k].conj())))
            w, decay = abs(new[k]) * (1 + e.frequency), -new[k].real * (1 + e.damping)
            moved = complex(-decay, np.sqrt(max(w**2 - decay**2, 1e-12 * w**2)))
            for at, pole in ((k, moved), (twin, moved.conjugate())):
                into[at] *= new[at].imag / pole.imag  # 1 / (s^2 + 2 d s + w^2) keeps its 1
                out[:, at] *= (pole / new[at]) ** plant.derivative
                new[at] = pole
        back = np.linalg.inv(shapes)
        return replace(
            plant,
            A=(shapes @ np.diag(new) @ back).real,
            B=(shapes @ into).real,
            C=(out @ back).real,
        )

    def _forced(self, plant: StateSpace, run: Run) -> Array:
        """Output from rest (..., T, p) on the measured input."""
        u = run["input"]
        n, m = plant.B.shape
        G = np.zeros((n + 2 * m, n + 2 * m))
        G[:n, :n], G[:n, n : n + m] = plant.A * run.dt, plant.B * run.dt
        G[n : n + m, n + m :] = np.eye(m)
        step = scipy.linalg.expm(G)
        A, first, slope = step[:n, :n], step[:n, n : n + m], step[:n, n + m :]
        if self.held:
            slope = np.zeros_like(slope)
        pushed = u[..., :-1, :] @ (first - slope).T + u[..., 1:, :] @ slope.T
        x = np.zeros((*u.shape[:-2], n))
        states = np.empty((*u.shape[:-1], n))
        states[..., 0, :] = x
        for k in range(u.shape[-2] - 1):
            x = x @ A.T + pushed[..., k, :]
            states[..., k + 1, :] = x
        return np.asarray(states @ plant.C.T + u @ plant.D.T)

    def _free(self, plant: StateSpace, run: Run, start: Array) -> Array:
        """Output (T, p) from a start (n,) without input."""
        A = scipy.linalg.expm(plant.A * run.dt)
        x = np.zeros(len(plant.A))
        x[: len(start)] = start
        out = np.empty((run.length, len(plant.C)))
        for k in range(run.length):
            out[k] = plant.C @ x
            x = A @ x
        return out


def _offset(output: int, x: Array) -> PlantOffset:
    return PlantOffset(output, float(x[0]))


def _mode(mode: int, what: str, x: Array) -> PlantMode:
    value = float(x[0])
    return PlantMode(mode, value) if what == "frequency" else PlantMode(mode, 0.0, value)
