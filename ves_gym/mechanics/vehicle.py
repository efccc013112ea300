"""Vehicles: what carries the arm. A flexible beam, a satellite, or any M, D, K.

A vehicle answers with `BaseModel`: the linear admittance M Y'' + D Y' + K Y = W of
thesis eq. 2.3 in Y = (x, y, z, phi_x, phi_y, phi_z), and, for a satellite, a rigid body
that turns with the base instead of a constant M.
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from ves_gym._util.params import (
    Array,
    Matrix,
    ParameterError,
    Vector,
    finite,
    freeze_arrays,
    from_plain,
    read_table,
    symmetric,
    unit,
)
from ves_gym._util.suggest import did_you_mean
from ves_gym.mechanics import pointing
from ves_gym.mechanics.base_model import BaseModel as BaseModel
from ves_gym.mechanics.base_model import InternalModes as InternalModes
from ves_gym.mechanics.base_model import Oscillator as Oscillator
from ves_gym.mechanics.base_model import Saved
from ves_gym.mechanics.carried import Appendage as Appendage
from ves_gym.mechanics.carried import Carried as Carried
from ves_gym.mechanics.carried import ReactionWheel as ReactionWheel
from ves_gym.mechanics.finite_elements import ALUMINIUM as ALUMINIUM
from ves_gym.mechanics.finite_elements import Material as Material
from ves_gym.mechanics.flexible_base import Beam as Beam
from ves_gym.mechanics.flexible_base import FlexibleBase as FlexibleBase
from ves_gym.mechanics.flexible_base import beam_line as beam_line
from ves_gym.mechanics.link import Inertial, diagonal, matrix
from ves_gym.mechanics.orbit import Orbit as Orbit
from ves_gym.mechanics.pointing import AttitudeControl as AttitudeControl
from ves_gym.mechanics.pointing import Jet as Jet
from ves_gym.mechanics.spatial import matvec


@dataclass(frozen=True, kw_only=True)
class MatrixVehicle(Saved):
    """The user's own M, D, K in Y; each symmetric and positive semidefinite.

    `drag`: damping that grows with speed, a force c |Y'| Y' along each axis. `extra`:
    masses on springs that it carries. `coupling`, `omega`, `internal_damping`: its internal
    modes, see `InternalModes`; M is then the mass beside them.
    """

    kind: ClassVar[str] = "matrices"
    M: Matrix = unit("kg, kg m, kg m^2")
    D: Matrix = unit("N s/m, N s, N m s")
    K: Matrix = unit("N/m, N, N m")
    drag: Vector | None = unit("N s^2/m^2, N m s^2", default=None)
    extra: tuple[Oscillator, ...] | None = None
    coupling: Matrix | None = unit("kg^(1/2), kg^(1/2) m", default=None)  # (6, m)
    omega: Vector | None = unit("rad/s", default=None)  # (m,)
    internal_damping: Matrix | None = unit("N s/m", default=None)  # (6 + m, 6 + m)
    source: str = "user"

    def __post_init__(self) -> None:
        freeze_arrays(self)
        for name in ("M", "D", "K"):
            symmetric(getattr(self, name), f"MatrixVehicle.{name}")
        self._modes()  # refuses what does not fit together
        if self.drag is not None and (finite(self.drag, (6,), "MatrixVehicle.drag") < 0).any():
            raise ParameterError(f"MatrixVehicle.drag must be >= 0, got {self.drag}")

    def base_model(self) -> BaseModel:
        """The matrices as given, symmetrised to rounding."""
        M, D, K = (symmetric(getattr(self, name), name) for name in "MDK")
        drag = None if self.drag is None else np.array(self.drag)
        internal = InternalModes.of(self.extra or ())
        modes = self._modes()
        if modes is not None:
            internal = modes.joined(internal)
        return BaseModel(M, D, K, drag=drag, internal=internal)

    def _modes(self) -> InternalModes | None:
        if self.omega is None:
            if self.coupling is not None or self.internal_damping is not None:
                raise ParameterError("MatrixVehicle.omega must be given with internal modes")
            return None
        m = len(self.omega)
        if not (finite(self.omega, (m,), "MatrixVehicle.omega") >= 0).all():
            raise ParameterError(f"MatrixVehicle.omega must be >= 0, got {self.omega}")
        coupling = finite(self.coupling, (6, m), "MatrixVehicle.coupling")
        size = 6 + m
        damping = np.zeros((size, size))
        if self.internal_damping is not None:
            damping = symmetric(self.internal_damping, "MatrixVehicle.internal_damping", size)
        return InternalModes(coupling, np.array(self.omega), damping)


@dataclass(frozen=True, kw_only=True)
class Satellite(Saved):
    """A rigid body in free space under the arm: K = D = 0.

    `thrusters` False is free-floating (no outside force), True is free-flying: any wrench may
    act (`Simulator.step(..., base_wrench=...)`). `jets` make that wrench by pulses. `wheels`
    exchange momentum with the body, whose inertia includes theirs; `appendages` come on top of
    it. With `pointing` wheels and jets hold the attitude of the start, or another that the
    simulator is given (`Simulator.point`). On an `orbit` the Earth's attraction differs from
    place to place: it turns the satellite, and what is apart drifts. `extra`: masses on springs
    along directions fixed in space, for a satellite that turns little.
    """

    kind: ClassVar[str] = "satellite"
    body: Inertial
    thrusters: bool = False
    wheels: tuple[ReactionWheel, ...] | None = None
    jets: tuple[Jet, ...] | None = None
    appendages: tuple[Appendage, ...] | None = None
    pointing: AttitudeControl | None = None
    extra: tuple[Oscillator, ...] | None = None
    orbit: Orbit | None = None
    source: str = "user"

    def __post_init__(self) -> None:
        freeze_arrays(self)
        if self.thrusters and self.jets:
            raise ParameterError(
                "Satellite: thrusters = true is any wrench; leave it out where jets are given"
            )
        if self.pointing is not None and not (self.wheels or self.jets or self.thrusters):
            raise ParameterError("Satellite.pointing needs wheels, jets or thrusters to act by")
        remainder = np.array(self.body.inertia, float)
        for wheel in self.wheels or ():
            remainder -= rotor_inertia(wheel)
        a, b, c = np.linalg.eigvalsh(remainder)
        if self.wheels and not (a > 0 and c <= a + b):
            raise ParameterError(
                "Satellite.body must include its wheels' inertia: without them principal"
                f" moments of {a:.3g}, {b:.3g}, {c:.3g} kg m^2 are left, no rigid body's"
            )

    def base_model(self) -> BaseModel:
        """Zero M, D, K, the body, what it carries (wheels, then appendages), its `extra`."""
        zero = np.zeros((6, 6))
        carried: tuple[Carried, ...] = (*(self.wheels or ()), *(self.appendages or ()))
        modes = InternalModes.of(self.extra or ())
        return BaseModel(zero, zero, zero, self.body, internal=modes, carried=carried)


def has_jets(vehicle: Vehicle) -> bool:
    """Return True of a vehicle on which jets of some kind may act."""
    return isinstance(vehicle, Satellite) and (vehicle.thrusters or bool(vehicle.jets))


def orbit_of(vehicle: Vehicle) -> Orbit | None:
    """Return the orbit that a vehicle is on; None where gravity is left out."""
    return vehicle.orbit if isinstance(vehicle, Satellite) else None


def act(
    vehicle: Satellite,
    dt: float,
    wrench: Array,
    torque: Array,
    speed: Array,
    owed: Array,
    remaining: Array,
    used: Array,
) -> tuple[Array, ...]:
    """Return what wheels and jets of a satellite do in a control period dt [s].

    Args:
        wrench: (n, 6) demanded of the jets in platform axes [N, N m].
        torque: (n, w) demanded of the wheels' motors [N m], at initial speed (n, w) [rad/s].
        owed, remaining: (n, k) see `pointing.pulses` [N s].
        used: (n, 1) propellant so far [kg].

    Returns:
        Torque (n, w) on the rotors, friction included, wrench (n, 6), then `owed`, `remaining`
        and `used` after it.
    """
    wheels, jets = vehicle.wheels or (), vehicle.jets or ()
    if jets:  # what their pulses make of it
        delivered, owed, remaining = pointing.pulses(
            jets, owed, remaining, pointing.allocated(jets, wrench), dt
        )
        wrench = matvec(pointing.wrench_matrix(jets), delivered) / dt
        used = used + pointing.propellant(jets, delivered)[:, None]
    elif not vehicle.thrusters:
        wrench = np.zeros_like(wrench)
    if wheels:
        torque = pointing.on_rotors(wheels, torque, speed, dt)
    return torque, wrench, owed, remaining, used


def rotor_inertia(wheel: ReactionWheel) -> Array:
    """Return the inertia (3, 3) that a wheel has at least: a thin disc's [kg m^2]."""
    axis = np.array(wheel.axis)
    return wheel.inertia / 2 * (np.eye(3) + np.outer(axis, axis))


Vehicle = Beam | FlexibleBase | MatrixVehicle | Satellite

# Thesis Appendix A: condensed to six modes, half the beam's mass at its tip.
STRAIGHT_VERTICAL_THESIS = Beam(
    segments=((0.0, 0.0, 12.0),),
    outer_diameter=0.07,
    wall=0.006,
    source="thesis App. A.3: 12 m aluminium tube, 70 x 6 mm, arm on top",
)
STRAIGHT_HORIZONTAL_THESIS = Beam(
    segments=((-12.0, 0.0, 0.0),),
    outer_diameter=0.07,
    wall=0.006,
    source="thesis App. A.3: the same tube lying along -x",
)
BENT_THESIS = Beam(
    segments=((-8.0, 0.0, 0.0), (0.0, 0.0, 8.0)),
    outer_diameter=0.18,
    wall=0.007,
    source="thesis App. A.5: 8 + 8 m; 'radius of 9 centimeters' read as 180 mm diameter",
)
DECOUPLED = MatrixVehicle(
    M=diagonal(500, 500, 500, 250, 250, 250),
    D=diagonal(500, 500, 500, 250, 250, 250),
    K=diagonal(1500, 2500, 4000, 1500, 1000, 2000),
    source="thesis Table 5-2",
)
# A nominal 500 kg satellite, a homogeneous cube of 1.5 m edge under the arm (this project).
_CUBE = Inertial(mass=500.0, com=(0.0, 0.0, -0.75), inertia=diagonal(187.5, 187.5, 187.5))
FREE_FLOATING = Satellite(body=_CUBE, source="nominal, this project: 500 kg cube, 1.5 m edge")
FREE_FLYING = Satellite(
    body=_CUBE, thrusters=True, source="nominal, this project: the same cube with jets"
)

_SIDE = 0.75  # m, half the edge of the servicer's cube


def _pyramid() -> tuple[ReactionWheel, ...]:
    """Four wheels whose axes stand evenly: 35.3 deg above the plane, 90 deg apart."""
    part = math.sqrt(1 / 3)
    return tuple(
        ReactionWheel(
            axis=(x * part, y * part, part),
            inertia=0.02,
            torque_max=0.2,
            momentum_max=12.0,
            viscous=2e-5,
            coulomb=2e-3,
        )
        for x, y in ((1, 1), (-1, 1), (-1, -1), (1, -1))
    )


def _twelve_jets() -> tuple[Jet, ...]:
    """Two jets for each direction, beside the centre of mass: a couple about each axis."""
    out = []
    for axis in range(3):
        beside = (axis + 1) % 3
        for sign in (1.0, -1.0):
            for offset in (_SIDE, -_SIDE):
                direction, position = [0.0] * 3, [0.0, 0.0, -_SIDE]
                direction[axis] = sign
                position[axis] -= sign * _SIDE
                position[beside] += offset
                out.append(
                    Jet(
                        position=(position[0], position[1], position[2]),
                        direction=(direction[0], direction[1], direction[2]),
                        thrust=10.0,
                        specific_impulse=290.0,
                        min_impulse=0.05,
                    )
                )
    return tuple(out)


def _wing(side: float) -> Appendage:
    """A solar array of 4 x 1.5 m on a hinge along x at the side of the cube, 0.25 Hz."""
    span, width, mass = 4.0, 1.5, 20.0
    rate, about_hinge = 2 * math.pi * 0.25, mass * span**2 / 3
    return Appendage(
        joint="hinge",
        axis=(1.0, 0.0, 0.0),
        point=(0.0, side * _SIDE, -_SIDE),
        body=Inertial(
            mass=mass,
            com=(0.0, side * (_SIDE + span / 2), -_SIDE),
            inertia=diagonal(
                mass * span**2 / 12, mass * width**2 / 12, mass * (span**2 + width**2) / 12
            ),
        ),
        stiffness=about_hinge * rate**2,
        damping=2 * 0.005 * about_hinge * rate,
    )


def _propellant(axis: Vector) -> Appendage:
    """Propellant of 30 kg that sloshes along an axis at 0.4 Hz."""
    mass, rate = 30.0, 2 * math.pi * 0.4
    return Appendage(
        joint="slide",
        axis=axis,
        body=Inertial(mass=mass, com=(0.0, 0.0, -1.0), inertia=diagonal(0.0, 0.0, 0.0)),
        stiffness=mass * rate**2,
        damping=2 * 0.02 * mass * rate,
    )


# Wheels of the class of 12 N m s, jets of the class of 10 N: sizes are round numbers.
SERVICER = Satellite(
    body=Inertial(mass=800.0, com=(0.0, 0.0, -_SIDE), inertia=diagonal(300.0, 300.0, 300.0)),
    wheels=_pyramid(),
    jets=_twelve_jets(),
    pointing=AttitudeControl(),
    source="nominal, this project: 800 kg cube, 1.5 m edge, 4 wheels, 12 jets",
)
SERVICER_FLEXIBLE = replace(
    SERVICER,
    appendages=(
        _wing(1.0),
        _wing(-1.0),
        _propellant((1.0, 0.0, 0.0)),
        _propellant((0.0, 1.0, 0.0)),
    ),
    source="nominal, this project: the servicer with two solar arrays and sloshing propellant",
)

# The same tubes by finite elements. Modes: scripts/modes_needed.py, frequencies below 20 Hz and
# E_mean within 1 %.
BENT = FlexibleBase.of(BENT_THESIS, modes=5)
STRAIGHT_VERTICAL = FlexibleBase.of(STRAIGHT_VERTICAL_THESIS, modes=8)
STRAIGHT_HORIZONTAL = FlexibleBase.of(STRAIGHT_HORIZONTAL_THESIS, modes=8)

VEHICLES: dict[str, Vehicle] = {
    "bent": BENT,
    "straight-vertical": STRAIGHT_VERTICAL,
    "straight-horizontal": STRAIGHT_HORIZONTAL,
    "bent-thesis": BENT_THESIS,
    "straight-vertical-thesis": STRAIGHT_VERTICAL_THESIS,
    "straight-horizontal-thesis": STRAIGHT_HORIZONTAL_THESIS,
    "decoupled": DECOUPLED,
    "free-floating": FREE_FLOATING,
    "free-flying": FREE_FLYING,
    "servicer": SERVICER,
    "servicer-flexible": SERVICER_FLEXIBLE,
}


def has(vehicle: Vehicle, name: str) -> bool:
    """Return True if a vehicle's "D" or "K", internal modes included, is other than zero."""
    if isinstance(vehicle, Beam):
        return name != "D" or vehicle.damping_ratio > 0
    if isinstance(vehicle, Satellite):
        return False
    base = vehicle.base_model()
    modes = base.internal
    within = modes is not None and bool(np.any(modes.damping if name == "D" else modes.omega))
    return within or bool(np.any(getattr(base, name)))


def altered(vehicle: Vehicle, base: BaseModel) -> Vehicle:
    """Return the vehicle whose base model is another of the same kind (with or without a
    body)."""
    if base.body is not None:
        if isinstance(vehicle, Satellite):
            extra = None if base.internal is None else base.internal.oscillators()
            return replace(vehicle, body=base.body, extra=extra)
        return Satellite(body=base.body, source=vehicle.source)
    parts: dict[str, Any] = {name: matrix(getattr(base, name)) for name in "MDK"}
    drag = None if base.drag is None else tuple(base.drag.tolist())
    if base.internal is not None:
        parts |= {
            "coupling": matrix(base.internal.coupling),
            "omega": tuple(base.internal.omega.tolist()),
            "internal_damping": matrix(base.internal.damping),
        }
    return MatrixVehicle(**parts, drag=drag, source=vehicle.source)


def vehicle_from_plain(plain: Any, where: str = "vehicle") -> Vehicle:
    """Rebuild a vehicle from plain data with an entry `kind`; `where` is its path in
    messages."""
    vehicle: Vehicle = from_plain(Vehicle, plain, where)
    return vehicle


def vehicle_name(vehicle: Vehicle) -> str:
    """Return the name of a vehicle that comes with the package, else its kind."""
    names = [name for name, shipped in VEHICLES.items() if shipped == vehicle]
    return names[0] if names else vehicle.kind


def get_vehicle(name: str | os.PathLike[str]) -> Vehicle:
    """A vehicle by name, or from a .toml or .json file."""
    text = os.fspath(name)
    if text in VEHICLES:
        return VEHICLES[text]
    if text.endswith((".toml", ".json")):
        return vehicle_from_plain(read_table(text), text)
    raise ParameterError(
        f"vehicle must be one of {', '.join(VEHICLES)}, or a .toml or .json file (of a"
        f" finite-element model `ves-gym structure` writes one), got {text!r}"
        f"{did_you_mean(text, VEHICLES)}"
    )
