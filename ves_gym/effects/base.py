"""Base: what vehicle is really there."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import scipy

from ves_gym._util.params import Array, ParameterError, Vector
from ves_gym.mechanics.dynamics import inertia
from ves_gym.mechanics.spatial import AXES
from ves_gym.mechanics.vehicle import BaseModel, InternalModes, Oscillator, Satellite, has
from ves_gym.system.candidate import Candidate, Scope, number_of, placed
from ves_gym.system.effect import BaseEffect, parameter, register_effect
from ves_gym.system.system import System

_HELD = 1e-9  # of the largest stiffness per mass: less is none


def _require_held(effect: BaseEffect, system: System) -> None:
    fits = not isinstance(system.vehicle, Satellite)
    effect.require(fits, "a vehicle of M, D, K, got a satellite")


@register_effect("base/amplitude_damping")
class BaseAmplitudeDamping(BaseEffect):
    """A force `coefficient` |Y'| Y' along each axis against the vehicle's motion.

    A mode of amplitude A and angular frequency w loses as much to it as to a viscous damper
    8 / (3 pi) coefficient w A: its damping ratio grows in proportion to the amplitude
    (equivalent linearisation, derived here).
    """

    coefficient: Vector = parameter(
        "N s^2/m^2, N m s^2", bounds=(0.0, 1e6), shape=(6,), start=500.0
    )

    def check(self, system: System) -> None:
        """Nothing holds a satellite."""
        _require_held(self, system)

    def base(self, base: BaseModel) -> BaseModel:
        """Drag + coefficient."""
        if self.is_null:
            return base
        drag: Array = np.array(self.coefficient)
        return replace(base, drag=drag if base.drag is None else base.drag + drag)


@register_effect("base/damping")
class BaseDamping(BaseEffect):
    """The vehicle's damping is D (1 + `error`).

    Of what the admittance integrates, in the laboratory (derived here).
    """

    error: float = parameter("1", bounds=(-1.0, 10.0), start=1.0)

    def check(self, system: System) -> None:
        """A vehicle in free space has no damping."""
        self.require(has(system.vehicle, "D"), "a vehicle with damping")

    def base(self, base: BaseModel) -> BaseModel:
        """D (1 + error)."""
        return base if self.is_null else base.scaled(damping=1 + self.error)


@register_effect("base/stiffness")
class BaseStiffness(BaseEffect):
    """The vehicle's stiffness is K (1 + `error`), its damping as described.

    In the laboratory the vehicle is virtual: it is what the admittance integrates, while
    the payload compensation's arm stays as described (derived here).
    """

    error: float = parameter("1", bounds=(-0.9, 3.0), start=0.1)

    def check(self, system: System) -> None:
        """A vehicle in free space has no stiffness."""
        self.require(has(system.vehicle, "K"), "a vehicle with stiffness")

    def base(self, base: BaseModel) -> BaseModel:
        """K (1 + error)."""
        return base if self.is_null else base.scaled(stiffness=1 + self.error)


@register_effect("base/virtual_mass")
class BaseVirtualMass(BaseEffect):
    """The vehicle's mass matrix is M (1 + `error`), or its body that much heavier.

    Stiffness and damping as described; in the laboratory it is the mass that the admittance
    integrates (derived here).
    """

    error: float = parameter("1", bounds=(-0.9, 3.0), start=0.1)

    def base(self, base: BaseModel) -> BaseModel:
        """M (1 + error), and the same for a satellite's mass and inertia."""
        return base if self.is_null else base.scaled(mass=1 + self.error)


@register_effect("base/extra_mode")
class BaseExtraMode(BaseEffect):
    """The vehicle carries a `mass` on a spring along `direction`, of which nobody knows.

    `frequency` and `damping_ratio` are those of the mass on a vehicle at rest. In the
    laboratory the admittance integrates it (tuned mass: Den Hartog, Mechanical
    Vibrations). The direction is fixed in space: of a satellite that turns by an angle [rad]
    about that share of the mode's force points another way.
    """

    mass: float = parameter("kg", bounds=(0.0, 500.0), start=2.0)
    frequency: float = parameter(
        "Hz",
        bounds=(0.1, 30.0),
        null=None,
        default=3.0,
        start=tuple(np.geomspace(0.5, 6.0, 20).tolist()),
        search=(0.1, 6.5),  # above it a vehicle's own inner modes begin
    )
    damping_ratio: float = parameter("1", bounds=(0.0, 1.0), null=None, default=0.02)
    direction: Vector = parameter(
        "1", bounds=(-1.0, 1.0), null=None, shape=(3,), default=(1.0, 0.0, 0.0)
    )

    def check(self, system: System) -> None:
        """In the laboratory a satellite is its body alone."""
        if isinstance(system.vehicle, Satellite) and system.mode == "emulated":
            raise ParameterError(
                f"effect {self.kind} acts on a satellite in mode ideal, got mode emulated"
            )
        if not any(self.direction):
            raise ParameterError(
                f"{self.kind}.direction must not be zero, got {self.direction}"
            )

    @classmethod
    def candidates(cls, scope: Scope) -> Iterator[Candidate]:
        """Along each axis, mass and frequency."""
        numbers = [number_of(cls, "mass"), number_of(cls, "frequency")]
        for axis, way in zip(AXES, np.eye(3).tolist(), strict=False):

            def fields(x: Array, way: Any = tuple(way)) -> dict[str, Any]:
                return {"mass": float(x[0]), "frequency": float(x[1]), "direction": way}

            yield placed(cls, axis, numbers, fields)

    @property
    def oscillator(self) -> Oscillator:
        """The mass on its spring."""
        rate = 2 * np.pi * self.frequency
        way: Array = np.array(self.direction) / np.linalg.norm(self.direction)
        return Oscillator(
            mass=self.mass,
            stiffness=self.mass * rate**2,
            damping=2 * self.damping_ratio * self.mass * rate,
            direction=tuple(way.tolist()),
        )

    def base(self, base: BaseModel) -> BaseModel:
        """One oscillator more."""
        if not self.mass:
            return base
        mode = InternalModes.of((self.oscillator,))
        internal = mode if base.internal is None else base.internal.joined(mode)
        return replace(base, internal=internal)


@register_effect("base/mode")
class BaseMode(BaseEffect):
    """One mode of the vehicle under its arm is stiffer; the others are as described.

    Its stiffness is w^2 p p^T, p = M f its momentum per modal rate with f^T M f = 1 (modal
    expansion; Ewins, Modal Testing, 2000). In the laboratory a vehicle is what is integrated,
    to the last digit.
    """

    modes = ("ideal",)
    error: float = parameter("1", bounds=(-0.5, 1.0), start=0.03, name="frequency error")
    frequency: float = parameter("Hz", bounds=(1e-3, 1e3), null=None)
    momentum: Vector = parameter(
        "kg^(1/2), kg^(1/2) m", bounds=(-1e4, 1e4), null=None, shape=(6,)
    )

    def check(self, system: System) -> None:
        """Nothing holds a satellite, and no base has less stiffness than none."""
        _require_held(self, system)
        squares = np.linalg.eigvalsh(self.base(system.base).K)
        if squares[0] < -_HELD * squares[-1]:
            raise ParameterError(
                f"effect {self.kind} needs a mode that the base has, got {self.frequency:g} Hz"
                f" and a momentum along which error = {self.error:g} takes more stiffness than"
                " there is"
            )

    @classmethod
    def candidates(cls, scope: Scope) -> Iterator[Candidate]:
        """Each mode with the arm locked at zero, by its frequency and number."""
        system = scope.system
        if system is None or isinstance(system.vehicle, Satellite):
            return
        M, _, K = system.base.condensed()
        M = M + inertia(system.arm, np.zeros(system.arm.n))[:6, :6]
        for i, (frequency, momentum) in enumerate(modes_of(M, K), 1):

            def fields(x: Array, at: Any = (frequency, tuple(momentum))) -> dict[str, Any]:
                return {"error": float(x[0]), "frequency": at[0], "momentum": at[1]}

            yield placed(
                cls, f"{frequency:.3g} Hz, mode {i}", [number_of(cls, "error")], fields
            )

    def base(self, base: BaseModel) -> BaseModel:
        """K more along the mode."""
        if self.is_null:
            return base
        rate, p = 2 * np.pi * self.frequency, np.array(self.momentum)
        stiffer = (1 + self.error) ** 2 - 1
        return replace(base, K=base.K + stiffer * rate**2 * p[:, None] * p[None])


def modes_of(M: Array, K: Array) -> list[tuple[float, Array]]:
    """Return frequency [Hz] and momentum per modal rate (k,) of the modes of M, K (k, k).

    Modes of no stiffness are left out.
    """
    squares, ways = scipy.linalg.eigh(K, M)
    at = np.flatnonzero(squares > _HELD * squares.max())
    return [(float(np.sqrt(squares[i]) / (2 * np.pi)), M @ ways[:, i]) for i in at]


_FAR = (0.0, 1e9)


@register_effect("base/unknown")
class BaseUnknown(BaseEffect):
    """A force -(stiffness Y + damping Y') along each coordinate of the vehicle.

    A diagnosis writes it where something is missing at the base that is not in its library: of
    a joint of the structure that slips this is the equivalent linear law at the amplitudes
    seen (Krylov and Bogoliubov's harmonic balance). Neither is negative, so it never gives
    energy.
    """

    hidden = "it stands for what has no name; a diagnosis writes it where nothing else is left"
    stiffness: Vector = parameter("N/m, N m/rad", bounds=_FAR, shape=(6,), default=(0.0,) * 6)
    damping: Vector = parameter("N s/m, N m s/rad", bounds=_FAR, shape=(6,), default=(0.0,) * 6)

    def check(self, system: System) -> None:
        """Nothing holds a satellite."""
        _require_held(self, system)

    def base(self, base: BaseModel) -> BaseModel:
        """K and D more on the diagonal."""
        if self.is_null:
            return base
        return replace(
            base, D=base.D + _diagonal(self.damping), K=base.K + _diagonal(self.stiffness)
        )


def _diagonal(x: Vector) -> Array:
    """Numbers (6, ...) on the diagonal of a matrix (6, 6, ...)."""
    numbers: Array = np.array(x)
    ones = np.eye(6).reshape((6, 6) + (1,) * (numbers.ndim - 1))
    return np.asarray(ones * numbers[:, None])
