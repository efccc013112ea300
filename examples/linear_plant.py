"""A linear plant, x' = A x + B u, y = C x + D u, run on its measured input.

Signals: `input` (T, m), `output` (T, p). Every run has a start of its own. A structure by
M, D, K is the same with forces on some coordinates and some of them measured. A mapping file
(docs/own_machine.md) names it after

    ves-gym diagnose run.csv --import linear_plant.py --machine plant.toml
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy

import ves_gym as vg
from ves_gym import ParameterError
from ves_gym.diagnosis import (
    Parameter,
    Port,
    ResidualMachine,
    Run,
    register_machine,
    run_of_signals,
)

Array = npt.NDArray[Any]
Values = Mapping[str, Any]
Rows = tuple[tuple[float, ...], ...]
_DERIVATIVES = {"displacement": 0, "velocity": 1, "acceleration": 2}
_GRID = 16  # frequencies at which another mode is looked for
_ROUNDING = 1e-7  # of the largest pole: two poles at 0 come out so far from there
_SHARED = 1e-7  # product of a pole's left and right unit vectors below which it shares them
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
        poles = np.linalg.eigvals(self.A)
        fastest = float(poles.real.max(initial=0.0))
        if fastest > _ROUNDING * np.abs(poles).max(initial=0.0):
            raise ParameterError(
                f"the plant is unstable (pole at {fastest:.3g} 1/s): its output does not follow"
                " from its input"
            )

    @cached_property
    def modal(self) -> tuple[Array, Array, Array]:
        """Poles (n,), right vectors (n, n), left ones with l r = 1 or, of shared ones, 0."""
        poles, left, right = scipy.linalg.eig(self.A, left=True)
        scale = np.einsum("ij,ij->j", left.conj(), right)
        return poles, right, left.conj() / np.where(np.abs(scale) > _SHARED, scale, np.inf)

    @cached_property
    def modes(self) -> list[int]:
        """One pole of each mode, slow ones first; those that swing are complex.

        A body that moves freely has none: its poles are at 0, and share a vector.
        """
        poles, _, left = self.modal
        least = _ROUNDING * np.abs(poles).max(initial=0.0)
        moves = (np.abs(poles) > least) & (np.imag(poles) >= 0) & left.any(axis=0)
        return [k for k in np.argsort(np.abs(poles)).tolist() if moves[k]]

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
        poles, right, left = self.modal
        A, B, C, D = (x.astype(complex) for x in (self.A, self.B, self.C, self.D))
        rates = iter(decay)
        for k, f, part in zip(self.modes, hertz, share, strict=True):
            w, moved = 2 * np.pi * f, {k: complex(-2 * np.pi * f)}
            if self.swings(k):
                rate = next(rates)
                pole = complex(-rate, np.sqrt(max(w**2 - rate**2, 1e-12 * w**2)))
                twin = int(np.argmin(np.abs(poles - poles[k].conj())))
                moved = {k: pole, twin: pole.conjugate()}
            for at, pole in moved.items():
                r, l, old = right[:, at], left[:, at], poles[at]
                enters, leaves, turned = l @ self.B, self.C @ r, pole / old
                # 1 / (s^2 + 2 d s + w^2) keeps its 1
                grows = part * (old.imag / pole.imag if self.swings(at) else 1.0)
                A += (pole - old) * np.outer(r, l)
                B += (grows - 1) * np.outer(r, enters)
                if self.swings(at):
                    C += (turned**self.derivative - 1) * np.outer(leaves, l)
                if self.derivative:  # what a mode gives at once
                    D += (part - 1) * np.outer(leaves / old, enters)
        return replace(self, A=np.real(A), B=np.real(B), C=np.real(C), D=np.real(D))

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
        poles, right, left = self.modal
        if not left.any(axis=0).all():  # a body that moves freely
            t, matrices = dt * np.arange(len(u)), (self.A, self.B, self.C, self.D)
            y = scipy.signal.lsim(matrices, u, t, start, not held)[1]
            return np.asarray(y.reshape(len(u), -1))
        pushed, x, y = u @ (left.T @ self.B).T, left.T @ start, u @ self.D.T
        for k in range(len(poles)):
            grows, sooner, later = _sampled(poles[k] * dt, held)
            b = dt * np.array([later, sooner])
            begin = [x[k] - b[0] * pushed[0, k]]
            state = scipy.signal.lfilter(b, [1.0, -grows], pushed[:, k], zi=begin)[0]
            y = y + np.real(np.outer(state, self.C @ right[:, k]))
        return np.asarray(y)


def _sampled(z: complex, held: bool) -> tuple[complex, complex, complex]:
    """Return e^z and the weights of an input before and after a step, for x' = z x + u."""
    if abs(z) < 1e-4:  # series, where differences lose their digits
        total, late = 1 + z / 2 + z**2 / 6, 0.5 + z / 6 + z**2 / 24
    else:
        total = np.expm1(z) / z
        late = (total - 1) / z
    return np.exp(z), total if held else total - late, 0.0 if held else late


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
    if reads not in _DERIVATIVES:
        raise ParameterError(f"reads must be one of {', '.join(_DERIVATIVES)}, got {reads!r}")
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
        modes = [p.get(k, ()) for k in ("frequency", "decay", "share")]
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
    described = [nominal.get(k, ()) for k in ("frequency", "decay", "share")]
    return machine


def _parameters(
    plant: StateSpace, names: tuple[str, ...], units: tuple[str, ...], start: Any
) -> dict[str, Parameter]:
    poles = [plant.modal[0][k] for k in plant.modes]
    hertz = tuple(float(abs(p)) / (2 * np.pi) for p in poles)
    numbered = [f"{i + 1} ({f:.3g} Hz)" for i, f in enumerate(hertz)]
    swings = [plant.swings(k) for k in plant.modes]
    rates = tuple(float(-p.real) for p, yes in zip(poles, swings, strict=True) if yes)
    at = [name for name, yes in zip(numbered, swings, strict=True) if yes]
    tried = hertz or (1.0,)
    grid = np.geomspace(0.3 * min(tried), 5.0 * max(tried), _GRID)

    def of_modes(
        unit: str, nominal: tuple[float, ...], usual: float, exact: float, of: Any
    ) -> Parameter:
        scale = np.maximum(nominal, 1e-4)
        return Parameter(
            unit=unit,
            nominal=nominal,
            usual=usual * scale,
            tolerance=tuple((exact * scale).tolist()),
            entries=tuple(of),
            each=True,
            low=0.0,
        )

    parts = {
        "frequency": of_modes("Hz", hertz, 0.03, 0.002, numbered),
        "decay": of_modes("1/s", rates, 0.03, 0.02, at),
        "share": of_modes("1", (1.0,) * len(hertz), 0.05, 0.002, numbered),
    }
    extra = partial(Parameter, cause="extra mode")
    return {
        "gain": Parameter(
            unit="1", nominal=1.0, usual=0.05, tolerance=0.002, low=0.1, high=11.0
        ),
        "delay": Parameter(unit="s", usual=2e-3, low=0.0, high=1.0),
        "offset": Parameter(
            unit=units, nominal=(0.0,) * len(names), usual=1.0, entries=names, each=True
        ),
        **{key: p for key, p in parts.items() if p.entries},
        "extra_frequency": extra(
            unit="Hz", nominal=None, usual=1.0, low=1e-3, high=1e4, starts=tuple(grid.tolist())
        ),
        "extra_damping": extra(
            unit="1", nominal=None, usual=0.02, low=1e-4, high=1.0, starts=(0.02,)
        ),
        "extra_gain": extra(unit="1", usual=_usual_gain(plant, tried)),
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
class DescribedPlant:
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


def pushed(plant: StateSpace, seed: int) -> Run:
    """A run of 20 s at 100 Hz under a random force, with noise of 2e-6 of the output."""
    rng = np.random.default_rng(seed)
    t = 0.01 * np.arange(2000)
    low = scipy.signal.butter(3, 8.0, fs=100.0)
    u = scipy.signal.lfilter(*low, 50 * rng.standard_normal((2000, 1)), axis=0)
    y = plant.output(u, 0.01, np.zeros(len(plant.A)), False)
    y = y + 2e-6 * rng.standard_normal(y.shape)
    return run_of_signals(
        t, {"input": u, "output": y}, f"run {seed}", meta={"noise_std": {"output": 2e-6}}
    )


if __name__ == "__main__":
    M, D, K = np.diag([10.0, 5.0]), 6.0 * np.eye(2), np.array([[6e3, -2e3], [-2e3, 2e3]])
    described = structure(M, D, K, np.eye(2)[:, :1], np.eye(2)[1:], "displacement")
    actual = described.with_mode(6.0, 0.01, 0.02)
    found = vg.diagnose(
        [pushed(actual, k) for k in range(3)], linear_machine(described, [("x2", "m")])
    )
    print(found.sentence)
