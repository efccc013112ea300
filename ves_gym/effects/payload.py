"""What the tool carries, or the compensation takes it to carry."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ves_gym._util.params import Array, ParameterError, Vector
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.body_numbers import (
    PARAMETER_UNITS,
    PARAMETERS,
    inertia_matrix,
    is_body,
    nearest_body,
)
from ves_gym.mechanics.link import Inertial, matrix
from ves_gym.mechanics.payload import carrying
from ves_gym.system.candidate import Candidate, Number, Scope, placed
from ves_gym.system.deviations import LoopParameters
from ves_gym.system.effect import ArmEffect, LaboratoryEffect, parameter, register_effect
from ves_gym.system.system import System

REACH = 0.03  # m, about which a payload sits otherwise than thought, and extends


def _farther(axis: int, effect: PayloadMass) -> PayloadMass:
    """Return a payload that sits farther along an axis of its link."""
    position = np.array(effect.position) + REACH * np.eye(3)[axis]
    return replace(effect, position=tuple(position.tolist()))


def _longer(along: tuple[float, ...], effect: PayloadMass) -> Rod:
    """Return a payload that extends along a direction of its link."""
    return Rod(mass=effect.mass, position=effect.position, along=along)


# Axes and what halves their angles: any second moments of mass are a sum of these.
_DIRECTIONS = (
    *((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
    *((0.5**0.5, 0.5**0.5, 0.0), (0.5**0.5, 0.0, 0.5**0.5), (0.0, 0.5**0.5, 0.5**0.5)),
)


@register_effect("payload/mass")
class PayloadMass(ArmEffect):
    """A point mass rides on the tool, `position` away from it in the last link's axes.

    Joints, base and force sensor feel it; gravity estimate and compensation know nothing of
    it (parallel axes: derived here). A diagnosis takes some distance along each axis, and some
    extent along each direction, as forms that it may have in part.
    """

    forms = (
        *(partial(_farther, axis) for axis in range(3)),
        *(partial(_longer, along) for along in _DIRECTIONS),
    )
    mass: float = parameter("kg", bounds=(0.0, 20.0), start=1.0)
    position: Vector = parameter(
        "m", bounds=(-1.0, 1.0), null=None, shape=(3,), default=(0.0, 0.0, 0.0)
    )

    def arm(self, arm: Arm) -> Arm:
        """The last link with the mass on it."""
        if not self.mass:
            return arm
        body = Inertial(mass=self.mass, com=self.position, inertia=matrix(self.inertia))
        return carrying(arm, body, np.zeros(3), np.eye(3))

    @property
    def inertia(self) -> Array:
        """(3, 3) about its own centre of mass, in the last link's axes [kg m^2]."""
        return np.zeros((3, 3))


@dataclass(frozen=True, kw_only=True)
class Rod(PayloadMass):
    """A mass whose parts are `REACH` from its centre, root mean square, along a direction."""

    along: Vector = parameter("1", bounds=(-1.0, 1.0), shape=(3,), default=_DIRECTIONS[0])

    @property
    def inertia(self) -> Array:
        """(3, 3) of a rod that thin: m r^2 (1 - u u^T)."""
        return self.mass * REACH**2 * (np.eye(3) - np.outer(self.along, self.along))


_RANGES = {  # of a payload: usual size, least, most
    "kg": (1.0, 0.0, 50.0),
    "kg m": (0.1, -20.0, 20.0),
    "kg m^2": (0.02, -10.0, 10.0),
}


@register_effect("payload/body")
class PayloadBody(ArmEffect):
    """A rigid body is fixed to the last link, its numbers in that link's frame.

    Joints, base and force sensor feel it; gravity estimate and compensation know nothing of
    it. Forces are linear in the ten numbers (derived here).
    """

    within = "payload/mass"
    mass: float = parameter("kg", bounds=(0.0, 50.0))
    moment: Vector = parameter("kg m", bounds=(-20.0, 20.0), shape=(3,))  # mass x centre
    # xx xy yy xz yz zz about the frame's origin
    inertia: Vector = parameter("kg m^2", bounds=(-10.0, 10.0), shape=(6,))

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.physical and not is_body(self.parameters):
            raise ParameterError(
                f"{self.kind} must have the numbers of a rigid body (second moments of mass"
                f" without a negative eigenvalue), got mass {self.mass:g} kg, moment"
                f" {self.moment} kg m, inertia {self.inertia} kg m^2"
            )

    @property
    def physical(self) -> bool:
        """True: the numbers must be those of a body."""
        return True

    @property
    def parameters(self) -> Array:
        """(10,) in the order of `PARAMETERS`."""
        return np.array([self.mass, *self.moment, *self.inertia])

    @property
    def centre(self) -> tuple[float, ...]:
        """Centre of mass in the frame of the last link [m]; without mass its origin."""
        return tuple(m / self.mass if self.mass else 0.0 for m in self.moment)

    @classmethod
    def candidates(cls, scope: Scope) -> Iterator[Candidate]:
        """All ten numbers together, those of a body; most do not show."""
        numbers = []
        for name, unit in zip(PARAMETERS, PARAMETER_UNITS, strict=True):
            usual, low, high = _RANGES[unit]
            numbers.append(Number(name, unit, (low, high), (usual,)))
        candidate = placed(cls, "", numbers, lambda x: {}, sparse=True)
        every = np.eye(10)
        yield dataclasses.replace(
            candidate,
            make=_body,
            feasible=lambda x, precision: nearest_body(x, precision, every),
            least=4,  # mass and moment: less than that is a mass in a stated place
        )

    def arm(self, arm: Arm) -> Arm:
        """The last link with the body on it."""
        if self.is_null:
            return arm
        last = arm.links[-1]
        described = last.inertial
        mass = described.mass + self.mass
        first = described.mass * np.array(described.com) + self.moment
        centre = first / mass if mass else first
        spread = centre @ centre * np.eye(3) - np.outer(centre, centre)
        about = described.spatial()[3:, 3:] + inertia_matrix(self.parameters) - mass * spread
        cls = Inertial if self.physical else _Difference
        both = cls(mass=mass, com=tuple(centre.tolist()), inertia=matrix((about + about.T) / 2))
        return replace(arm, links=(*arm.links[:-1], replace(last, inertial=both)))


class _Difference(Inertial):
    """Mass properties of a link with part of a body: no body need have them."""

    def __post_init__(self) -> None:
        pass


class _PartOfBody(PayloadBody):
    """Single numbers of a body, in which forces are linear: computed, and never written."""

    @property
    def physical(self) -> bool:
        return False


def _body(x: Array) -> PayloadBody:
    """Return the body with these numbers (10,), or the difference that they make."""
    m, *numbers = (float(value) for value in x)
    cls = PayloadBody if m > 0 and is_body(x) else _PartOfBody
    return cls(mass=m, moment=tuple(numbers[:3]), inertia=tuple(numbers[3:]))


@register_effect("payload/com")
class PayloadCom(ArmEffect):
    """The last link's centre of mass lies `offset` away from where it is described.

    In the link's axes; mass and inertia about the centre as described (derived here).
    """

    offset: Vector = parameter(
        "m", bounds=(-0.3, 0.3), shape=(3,), start=0.02, search=(-0.2, 0.2)
    )

    def arm(self, arm: Arm) -> Arm:
        """The last link with its centre of mass moved."""
        if self.is_null:
            return arm
        last = arm.links[-1]
        com = tuple((np.array(last.inertial.com) + self.offset).tolist())
        moved = replace(last, inertial=replace(last.inertial, com=com))
        return replace(arm, links=(*arm.links[:-1], moved))


@register_effect("payload/inertia")
class PayloadInertia(LaboratoryEffect):
    """The compensation takes the arm's inertia for larger by the fraction `error`."""

    port = "admittance"
    error: float = parameter("1", bounds=(-0.9, 2.0), start=0.05)

    def check(self, system: System) -> None:
        """Only a compensated loop has a model of the arm's inertia."""
        self.require(system.emulator_settings.payload_compensation, "payload_compensation")

    def edit(self, p: LoopParameters) -> None:
        p.payload_scale = p.payload_scale + self.error
