"""A linear plant, x' = A x + B u, y = C x + D u, run on its measured input.

Signals: `input` (T, m), `output` (T, p). Every run has a start of its own. A structure by
M, D, K is the same with forces on some coordinates and some of them measured.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import scipy

from ves_gym._util.params import Array, ParameterError, require_choice
from ves_gym.diagnosis.data.measured_run import Run
from ves_gym.diagnosis.machines.base import Port
from ves_gym.diagnosis.machines.residual import (
    Parameter,
    ResidualMachine,
    Values,
    register_machine,
)

Rows = tuple[tuple[float, ...], ...]
_DERIVATIVES = {"displacement": 0, "velocity": 1, "acceleration": 2}
_GRID = 16  # frequencies at which another mode is looked for
_DEFECTIVE = 1e8  # condition of the shapes from which a plant is not a sum of modes
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

    @cached_property
    def modal(self) -> tuple[Array, Array]:
        """Poles (n,) and their shapes (n, n)."""
        return np.linalg.eig(self.A)

    @cached_property
    def modes(self) -> list[int]:
        """One pole of each mode, slow ones first; those that swing are complex."""
        poles = self.modal[0]
        return [k for k in np.argsort(np.abs(poles)).tolist() if poles[k].imag >= 0]

    def swings(self, k: int) -> bool:
        """Return True for a pole with a twin."""
        pole = self.modal[0][k]
        return bool(abs(pole.imag) > 1e-9 * abs(pole))

    @property
    def gain(self) -> float:
        """Size of the first output at rest per first input, or 1 without such."""
        if np.linalg.cond(self.A) > 1e12:
            return 1.0
        static = self.D - self.C @ np.linalg.solve(self.A, self.B)
        return float(abs(static[0, 0]) or abs(self.D[0, 0]) or 1.0)

    def with_modes(self, hertz: Array, decay: Array, share: Array) -> StateSpace:
        """Return the plant with other poles; what a mode moves and is moved by stays the same.

        Args:
            hertz: |pole| / 2 pi of all modes.
            decay: rates of those that swing [1/s]; dampers keep them where stiffness changes.
            share: factors of what all modes contribute.
        """
        poles, shapes = self.modal
        new, back, C = poles.copy(), np.linalg.inv(shapes), self.C @ shapes
        into, rates, D = back @ self.B, iter(decay), self.D
        for k, f, part in zip(self.modes, hertz, share, strict=True):
            w, twins = 2 * np.pi * f, {k: complex(-2 * np.pi * f)}
            if self.swings(k):
                rate = next(rates)
                moved = complex(-rate, np.sqrt(max(w**2 - rate**2, 1e-12 * w**2)))
                twin = int(np.argmin(np.abs(poles - poles[k].conj())))
                twins = {k: moved, twin: moved.conjugate()}
            for at, pole in twins.items():
                if self.derivative:  # what a mode gives at once
                    D = D + ((part - 1) * np.outer(C[:, at] / poles[at], into[at])).real
                into[at] *= part
                if self.swings(at):
                    into[at] *= (
                        poles[at].imag / pole.imag
                    )  # 1 / (s^2 + 2 d s + w^2) keeps its 1
                    C[:, at] *= (pole / poles[at]) ** self.derivative
                new[at] = pole
        A = (shapes @ np.diag(new) @ back).real
        return replace(self, A=A, B=(shapes @ into).real, C=(C @ back).real, D=D)

    def with_mode(self, hertz: float, damping: float, gain: float) -> StateSpace:
        """Return the plant with one more mode, between the first input and the first output."""
        w, enters = 2 * np.pi * hertz, np.zeros((2, self.B.shape[1]))
        inner = np.array([[0.0, 1.0], [-(w**2), -2 * damping * w]])
        enters[1, 0] = gain
        leaves, D = np.zeros((len(self.C), 2)), self.D.copy()
        leaves[0, 0] = 1.0
        for _ in range(self.derivative):
            leaves, D = leaves @ inner, D + leaves @ enters
        A = scipy.linalg.block_diag(self.A, inner)
        B, C = np.vstack([self.B, enters]), np.hstack([self.C, leaves])
        return replace(self, A=A, B=B, C=C, D=D)

    def output(self, u: Array, dt: float, start: Array, held: bool) -> Array:
        """Return the output (T, p) on an input that is a line between samples, or held.

        Args:
            u: (T, m).
            dt: step [s].
            start: (n,) state of the first sample.
            held: from sample to sample.
        """
        poles, shapes = self.modal
        if np.linalg.cond(shapes) > _DEFECTIVE:  # poles that share a shape: two integrators
            t, matrices = dt * np.arange(len(u)), (self.A, self.B, self.C, self.D)
            y = scipy.signal.lsim(matrices, u, t, start, not held)[1]
            return np.asarray(y.reshape(len(u), -1))
        back = np.linalg.inv(shapes)
        pushed, x, y = u @ (back @ self.B).T, back @ start, u @ self.D.T
        for k in range(len(poles)):
            grows, sooner, later = _sampled(poles[k] * dt, held)
            b = dt * np.array([later, sooner])
            begin = [x[k] - b[0] * pushed[0, k]]
            state = scipy.signal.lfilter(b, [1.0, -grows], pushed[:, k], zi=begin)[0]
            y = y + np.outer(state, self.C @ shapes[:, k]).real
        return np.asarray(y)


def _sampled(z: complex, held: bool) -> tuple[complex, complex, complex]:
    """Return e^z and the weights of an input before and after a step, for x' = z x + u."""
    if abs(z) < 1e-4:  # series, where differences lose their digits
        whole, late = 1 + z / 2 + z**2 / 6, 0.5 + z / 6 + z**2 / 24
    else:
        whole = np.expm1(z) / z
        late = (whole - 1) / z
    return np.exp(z), whole if held else whole - late, 0.0 if held else late


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
    if not np.linalg.eigvalsh((mass + mass.T) / 2)[0] > 0:
        raise ParameterError("M must be positive definite")
    inverse = np.linalg.inv(mass)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ stiffness, -inverse @ damping]])
    B = np.vstack([np.zeros_like(force), inverse @ force])
    C, D = np.hstack([measured, np.zeros_like(measured)]), np.zeros((len(measured), B.shape[1]))
    for _ in range(_DERIVATIVES[reads]):
        C, D = C @ A, C @ B
    return StateSpace(A, B, C, D, _DERIVATIVES[reads])


def linear_machine(
    plant: StateSpace,
    outputs: Sequence[tuple[str, str]],
    *,
    input_exact: bool = True,
    held: bool = False,
) -> ResidualMachine:
    """Return the machine of a plant: gain, delay, offsets, its modes, one mode more.

    Args:
        plant: as described.
        outputs: names and units, (p,).
        input_exact: the input is what the plant was given; else it is measured, with noise.
        held: the input is held from sample to sample; else it is a line between them.
    """
    if len(outputs) != len(plant.C):
        raise ParameterError(f"{len(plant.C)} outputs are described, {len(outputs)} are named")
    names, units = (tuple(k) for k in zip(*outputs, strict=True))
    title, exact = "output less that of the plant on its input", ("input",) * input_exact
    port = Port("output", title, names, units, ("input", "output"), exact, signal="output")

    def output(p: Values, u: Array, dt: float) -> Array:
        changed, start = plant, p["start"]
        modes = p["frequency"], p["decay"], p["share"]
        if not all(map(np.array_equal, modes, described)):
            changed = plant.with_modes(*modes)
        if p["extra_gain"]:
            changed = changed.with_mode(
                p["extra_frequency"], p["extra_damping"], p["extra_gain"]
            )
            start = np.concatenate([start, np.zeros(2)])
        y = changed.output(u, dt, start, held)
        if p["delay"]:
            t = dt * np.arange(len(u))
            y = scipy.interpolate.CubicSpline(t, y)(np.maximum(t - p["delay"], 0.0))
        return np.asarray(p["gain"] * y + p["offset"])

    def residual(p: Values, run: Run) -> dict[str, Array]:
        return {"output": run["output"] - output(p, run["input"], run.dt)}

    def start(run: Run) -> Array:
        """States (n,), each of which moves the output by several times its own movement."""
        still, n = np.zeros_like(run["input"]), len(plant.A)
        moved = [output({**nominal, "start": k}, still, run.dt) for k in np.eye(n)]
        size = np.array([np.sqrt(np.square(y).mean()) for y in moved])
        return np.asarray(_LARGE * run["output"].std(axis=0).max() / np.maximum(size, 1e-300))

    parameters = _parameters(plant, names, units, start)
    machine = ResidualMachine("linear plant", residual, (port,), parameters)
    nominal = machine.values(())
    described = nominal["frequency"], nominal["decay"], nominal["share"]
    return machine


def _parameters(
    plant: StateSpace, names: tuple[str, ...], units: tuple[str, ...], start: Any
) -> dict[str, Parameter]:
    poles = [plant.modal[0][k] for k in plant.modes]
    swinging = [p for p, k in zip(poles, plant.modes, strict=True) if plant.swings(k)]
    hertz = tuple(float(abs(p)) / (2 * np.pi) for p in poles)
    rates = tuple(float(-p.real) for p in swinging)
    numbered = [f"{i + 1} ({f:.3g} Hz)" for i, f in enumerate(hertz)]
    at = [numbered[poles.index(p)] for p in swinging]
    tried = [f for f in hertz if f > 0] or [1.0]
    grid = np.geomspace(0.3 * min(tried), 5.0 * max(tried), _GRID)
    extra: dict[str, Any] = {"cause": "extra mode"}

    def share(of: tuple[float, ...], part: float) -> tuple[float, ...]:
        return tuple(part * max(x, 1e-4) for x in of)

    return {
        "gain": Parameter(
            unit="1", nominal=1.0, usual=0.05, tolerance=0.002, low=0.1, high=11.0
        ),
        "delay": Parameter(unit="s", usual=2e-3, low=0.0, high=1.0),
        "offset": Parameter(
            unit=units, nominal=(0.0,) * len(names), usual=1.0, entries=names, each=True
        ),
        "frequency": Parameter(
            unit="Hz",
            nominal=hertz,
            usual=share(hertz, 0.03),
            tolerance=share(hertz, 0.002),
            low=0.0,
            entries=tuple(numbered),
            each=True,
        ),
        "share": Parameter(
            unit="1",
            nominal=(1.0,) * len(hertz),
            usual=0.05,
            tolerance=0.002,
            low=-10.0,
            high=10.0,
            entries=tuple(numbered),
            each=True,
        ),
        "decay": Parameter(
            unit="1/s",
            nominal=rates,
            usual=share(rates, 0.03),
            tolerance=share(rates, 0.02),
            low=0.0,
            entries=tuple(at),
            each=True,
        ),
        "extra_frequency": Parameter(
            unit="Hz",
            nominal=None,
            usual=1.0,
            low=1e-3,
            high=1e4,
            starts=tuple(grid.tolist()),
            **extra,
        ),
        "extra_damping": Parameter(
            unit="1", nominal=None, usual=0.02, low=1e-4, high=1.0, starts=(0.02,), **extra
        ),
        "extra_gain": Parameter(unit="1", usual=_usual_gain(plant, tried), **extra),
        "start": Parameter(
            unit="1",
            nominal=(0.0,) * len(plant.A),
            usual=start,
            entries=tuple(str(k + 1) for k in range(len(plant.A))),
            per_run=True,
        ),
    }


def _usual_gain(plant: StateSpace, hertz: Sequence[float]) -> float:
    """A tenth of the plant's own, of a mode's acceleration per input."""
    return 0.1 * plant.gain * (2 * np.pi * min(hertz)) ** (2 - plant.derivative)


@dataclass(frozen=True)
class StructureMatrices:
    """M x'' + D x' + K x = force u; the output reads `output` times x or its derivative."""

    M: Rows
    D: Rows
    K: Rows
    force: Rows  # (n, inputs)
    output: Rows  # (outputs, n)
    reads: str = "displacement"

    def __post_init__(self) -> None:
        require_choice(self, "reads", tuple(_DERIVATIVES))

    def plant(self) -> StateSpace:
        """Return the plant."""
        M, D, K = _matrix(self.M), _matrix(self.D), _matrix(self.K)
        return structure(M, D, K, _matrix(self.force), _matrix(self.output), self.reads)


@dataclass(frozen=True)
class SystemMatrices:
    """x' = A x + B u, y = C x + D u."""

    A: Rows
    B: Rows
    C: Rows
    D: Rows

    def plant(self) -> StateSpace:
        """Return the plant."""
        return StateSpace(_matrix(self.A), _matrix(self.B), _matrix(self.C), _matrix(self.D))


@register_machine("linear plant")
@dataclass(frozen=True)
class LinearPlant:
    """A linear plant by one of two sets of matrices."""

    outputs: tuple[tuple[str, str], ...]  # name and unit of each
    structure: StructureMatrices | None = None
    matrices: SystemMatrices | None = None
    input_exact: bool = True
    held: bool = False

    def machine(self, folder: Path | None = None) -> ResidualMachine:
        """Return the machine.

        Raises:
            ParameterError: none or both sets, matrices that do not fit.
        """
        described = self.structure or self.matrices
        if described is None or (self.structure is not None and self.matrices is not None):
            raise ParameterError("give structure (M, D, K) or matrices (A, B, C, D)")
        return linear_machine(
            described.plant(), self.outputs, input_exact=self.input_exact, held=self.held
        )


def _matrix(rows: Rows) -> Array:
    """Return (n, m) of rows, which must be of one length."""
    if not rows or len({len(row) for row in rows}) > 1:
        raise ParameterError(f"a matrix needs rows of one length, got {rows}")
    return np.array(rows, float)
