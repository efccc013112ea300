"""Payload: a body on the tool that is not described, by the ten numbers of a rigid body."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ves_gym._util.params import Array, ParameterError, Vector
from ves_gym.mechanics.arm import Arm, Inertial, matrix
from ves_gym.mechanics.body_numbers import (
    PARAMETER_UNITS,
    PARAMETERS,
    inertia_matrix,
    is_body,
    nearest_body,
)
from ves_gym.system.candidate import Candidate, Number, Scope, placed
from ves_gym.system.effect import ArmEffect, parameter, register

_RANGES = {  # of a payload: usual size, least, most
    "kg": (1.0, 0.0, 50.0),
    "kg m": (0.1, -20.0, 20.0),
    "kg m^2": (0.02, -10.0, 10.0),
}


@register("payload/body")
@dataclass(frozen=True, kw_only=True)
class PayloadBody(ArmEffect):
    """A rigid body is fixed to the last link, its numbers in that link's frame.

    Joints, base and force sensor feel it; gravity estimate and compensation know nothing of
    it. Forces are linear in the ten numbers (derived here).
    """

    modes = ("ideal", "emulated")
    port = "joint"
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
        whole = placed(cls, "", numbers, lambda x: {}, sparse=True)
        every = np.eye(10)
        yield dataclasses.replace(
            whole,
            make=_made,
            feasible=lambda x, precision: nearest_body(x, precision, every),
            least=4,  # mass and moment: less than that is a mass in a stated place
        )

    def arm(self, arm: Arm) -> Arm:
        """The last link with the body on it."""
        if self.is_null:
            return arm
        last = arm.links[-1]
        own = last.inertial
        mass = own.mass + self.mass
        first = own.mass * np.array(own.com) + self.moment
        centre = first / mass if mass else first
        spread = centre @ centre * np.eye(3) - np.outer(centre, centre)
        about = own.spatial()[3:, 3:] + inertia_matrix(self.parameters) - mass * spread
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


def _made(x: Array) -> PayloadBody:
    """Return the body with these numbers (10,), or the difference that they make."""
    m, *numbers = (float(value) for value in x)
    cls = PayloadBody if m > 0 and is_body(x) else _PartOfBody
    return cls(mass=m, moment=tuple(numbers[:3]), inertia=tuple(numbers[3:]))
