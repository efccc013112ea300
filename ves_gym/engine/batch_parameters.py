"""Systems of their own for the simulations of a batch: what may differ, where numbers go."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import partial
from typing import Any, NoReturn

import numpy as np

from ves_gym._util.params import Array, ParameterError, Rows
from ves_gym.engine.kernel.compiled_function import CompiledFunction
from ves_gym.engine.kernel.numbers import laws, parameters, structure
from ves_gym.hardware.admittance import admittance_matrices, require_admittance
from ves_gym.mechanics.gravity import GravityModel
from ves_gym.system.effect import TorqueEffect
from ves_gym.system.system import System

_SETTINGS = ("mode", "drive", "integrator", "physics_dt", "control_dt")
_GEOMETRY = ("d", "a", "alpha", "beta", "offset", "slides")
_SATELLITE = ("thrusters", "wheels", "jets", "appendages", "pointing", "orbit")


def require_alike(template: System, other: System, which: str) -> None:
    """Check that two systems differ in numbers only.

    Masses, centres of mass, inertias, rotors, torque limits, M, D, K, a satellite's body and
    the values of effects are numbers.

    Args:
        template: the simulator's system.
        other: the one to be assigned.
        which: its name in the message.

    Raises:
        ParameterError: names the difference.
    """

    theirs = _alike(other)
    for what, mine in _alike(template).items():
        if mine != theirs[what]:
            raise ParameterError(
                f"{which}: {what} must be the simulator's {mine}, got {theirs[what]}"
            )


def _alike(system: System) -> dict[str, Any]:
    """Return what systems of one batch must share, by name; number of joints first."""
    arm, actual, vehicle = system.arm, system.actual, system.vehicle
    out: dict[str, Any] = {
        "number of joints": arm.n,
        **{name: repr(getattr(system, name)) for name in _SETTINGS},
        "the kinds of effects": ", ".join(e.kind for e in system.effects) or "none",
        "damping": any(k.damping for k in arm.links),
        "friction": any(k.friction for k in arm.links),
        "mount": arm.mount,
        "the arms beside it": arm.beside,
        "joints that follow others": arm.followers,
        "joints whose gears give way": [i + 1 for i in actual.arm.geared] or "none",
        "the number of the vehicle's internal modes": actual.base.m,
        "the vehicle's kind": "a body" if system.base.body else "no body",
        "the payload": "none" if system.payload is None else "one",
        "contact": system.contact,
    }
    out |= {name: getattr(vehicle, name, None) for name in _SATELLITE}
    for i, link in enumerate(arm.links, start=1):
        out |= {f"{name} of link {i}": getattr(link, name) for name in _GEOMETRY}
    if system.mode == "emulated":
        settings = system.emulator_settings
        for field in dataclasses.fields(settings):
            out[f"emulator.{field.name}"] = getattr(settings, field.name)
    return out


def share_base(template: System, other: System) -> None:
    """Spare a system the computation of M, D, K where its vehicle is the same object.

    Args:
        template: has them.
        other: takes them.
    """
    if other.vehicle is template.vehicle:
        other.__dict__.setdefault("base", template.base)


def bodies_of(system: System) -> tuple[int, int]:
    """Which arm and vehicle these are: equal for the very same objects."""
    return id(system.arm), id(system.vehicle)


class ParameterRows:
    """Parameters of the kernel (`numbers.parameters`), by name, for systems of one structure.

    A number that is zero in the own system is no parameter of its code: zero it stays. One
    that is zero in another system is a parameter of value zero.
    """

    def __init__(self, system: System) -> None:
        self.system = system
        self.names, self.values = parameters(system)
        self._at = {name: k for k, name in enumerate(self.names)}
        self._laws = [
            (i, field.name, f"{effect.kind}#{i + 1}.{field.name}")
            for i, effect in enumerate(system.effects)
            if isinstance(effect, TorqueEffect)
            for field in dataclasses.fields(effect)  # type: ignore[arg-type]
        ]

    def of(self, system: System, which: str, laws: bool = True) -> Array:
        """(k,) values in the order of `names`; `which` is the system's name in errors.

        `laws`: with those of the effects' torque laws.

        Raises:
            ParameterError: a number that is zero in the own system is not in this one.
        """
        row = np.zeros(len(self.names))
        for name, value in zip(*parameters(system), strict=True):
            if laws or "#" not in name:
                self._put(row, name, value, which)
        return row

    def with_effects(self, row: Array, system: System, which: str) -> Array:
        """Return a row of the same arm and vehicle with the values of this system's effects.

        Args:
            row: (k,) parameters.
            system: whose effects.
            which: its name in messages.
        """
        row = row.copy()
        for i, field, label in self._laws:
            mine, value = (getattr(s.effects[i], field) for s in (self.system, system))
            if not isinstance(value, tuple):
                self._put(row, label, value, which)
                continue
            if len(value) != len(mine):
                raise ParameterError(
                    f"{which}: {label} must be {len(mine)} numbers, got {len(value)}"
                )
            for k, number in enumerate(value, start=1):
                self._put(row, f"{label}{k}", number, which)
        return row

    def place(self, name: str, values: Array) -> int | None:
        """Place of a parameter in a row; None where it is zero in the code and in `values`.

        Args:
            name: of the parameter.
            values: (k,) it is to take.
        """
        at = self._at.get(name)
        if at is None and values.any():
            self._refuse("a simulation's system", name, float(values[values != 0][0]))
        return at

    def _put(self, row: Array, name: str, value: float, which: str) -> None:
        at = self._at.get(name)
        if at is not None:
            row[at] = value
        elif value != 0:
            self._refuse(which, name, value)

    def _refuse(self, which: str, name: str, value: float) -> NoReturn:
        raise ParameterError(
            f"{which}: {name} is {value:g} but 0 in the simulator's own system, whose"
            " compiled code leaves it out: give the simulator a system in which it is not 0"
        )


@dataclass
class Bodies:
    """Arms and vehicles of emulated simulations, as the laboratory needs them.

    Leading axis = simulation.
    """

    M: Array  # (n, 6, 6) of the vehicle
    D: Array
    K: Array
    drag: Array  # (n, 6)
    wide: Array  # (n, 3, 6 + m, 6 + m) what m internal modes add to M, D, K
    body: Array  # (n, 6, 6) spatial inertia of a satellite, zero without one
    phi: Array  # (n, 12, 12) admittance, zero where it is not sampled beforehand
    gamma: Array  # (n, 12, 6)
    mass: Array  # (n,) of the arm [kg]
    P: Array  # (n, p) of its weight's moment [kg m]
    numbers: Array  # (n, k) of `numbers.parameters` as `trace.inertia_matrix` takes them

    @staticmethod
    def of(system: System, linear: bool, sampled: bool, numbers: Array) -> Bodies:
        """Return one row for a system.

        Args:
            system: arm and vehicle as they really are, but for the numbers.
            linear: the vehicle is a linear one.
            sampled: it is discretised beforehand.
            numbers: (k,) masses and the like.

        Raises:
            ParameterError: a linear vehicle that cannot be emulated.
        """
        base, weight = system.actual.base, GravityModel.of(system.actual.arm)
        phi, gamma = np.zeros((12, 12)), np.zeros((12, 6))
        form = system.emulator_settings.admittance_form
        if sampled:
            phi, gamma = admittance_matrices(base, system.control_dt, form)
        elif linear:
            require_admittance(base, form)
        body = np.zeros((6, 6)) if base.body is None else base.body.spatial()
        drag = np.zeros(6) if base.drag is None else base.drag
        wide = np.zeros((3, 6, 6))
        if base.internal is not None:
            wide = np.array(base.internal.matrices())
        row = (base.M, base.D, base.K, drag, wide, body, phi, gamma, weight.mass, weight.P)
        return Bodies(*(np.array([k]) for k in (*row, numbers)))

    def parts(self) -> list[Array]:
        """All arrays."""
        return [getattr(self, field.name) for field in dataclasses.fields(self)]

    def repeated(self, n: int) -> Bodies:
        """A single row, n times."""
        return Bodies(*(np.repeat(part, n, axis=0) for part in self.parts()))

    def rows(self, which: Rows) -> Bodies:
        """Some of the rows."""
        return Bodies(*(part[which] for part in self.parts()))

    def put(self, i: int, row: Bodies) -> None:
        """Replace a row.

        Args:
            i: which.
            row: a single one.
        """
        for mine, theirs in zip(self.parts(), row.parts(), strict=True):
            mine[i] = theirs[0]


class Laws:
    """Torque laws of n simulations whose effects differ in values (`effect.joint_torque`)."""

    def __init__(self, system: System, n: int) -> None:
        self._rows = ParameterRows(system)
        self._p = np.tile(self._rows.values, (n, 1))
        names = [f"limit{k + 1}" for k in range(system.arm.n)]
        self._limits = [self._rows.names.index(name) for name in names]
        self._torque = CompiledFunction(f"laws {structure(system)}", partial(laws, system))

    def row(self, system: System, which: str) -> Array:
        """Numbers of a system, `which` in messages."""
        row = self._rows.with_effects(self._rows.values, system, which)
        row[self._limits] = system.arm.column("tau_max")
        return row

    def put(self, i: int, row: Array) -> None:
        """Set the numbers of simulation i."""
        self._p[i] = row

    def torque(self, q: Array, v: Array, tau: Array) -> Array:
        """Return the torque of the laws.

        Args:
            q, v: (n, joints) angles [rad] and rates [rad/s].
            tau: (n, joints) motor torques [N m].

        Returns:
            (n, joints) [N m].
        """
        return self._torque(q, v, tau, self._p)
