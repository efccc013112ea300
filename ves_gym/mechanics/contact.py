"""Contact of the tool with a body: shapes, a linear spring and damper, Coulomb friction.

Where two shapes overlap by a depth d, the normal force is max(0, stiffness d + damping d'), at
every contact point; friction opposes sliding by `friction` times that force. docs/physics.md
has the equations, and how the engine is given them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ves_gym._util.params import (
    Array,
    ParameterError,
    Vector,
    finite,
    freeze_arrays,
    require_choice,
    require_positive,
    unit,
)
from ves_gym.mechanics.serial_chain import Mount

FORMS = {"sphere": 1, "box": 3, "cylinder": 2, "capsule": 2}  # numbers of its size
CARRIERS = ("payload", "base", "space")
_AT_ORIGIN = Mount()


@dataclass(frozen=True, kw_only=True)
class ContactShape:
    """A body's surface, or a part of it.

    `size` of a sphere: its radius; of a box: its edges; of a cylinder or capsule: radius and
    length (of the straight part) along its z.
    """

    form: str
    size: Vector = unit("m")
    place: Mount = _AT_ORIGIN  # of its centre and axes in those of the body

    def __post_init__(self) -> None:
        freeze_arrays(self)
        require_choice(self, "form", tuple(FORMS))
        numbers = finite(self.size, (FORMS[self.form],), f"ContactShape.size of a {self.form}")
        if not (numbers > 0).all():
            raise ParameterError(f"ContactShape.size must be > 0 m, got {self.size}")

    @property
    def lever(self) -> float:
        """Distance of a normal on it from the body's origin, at most [m]."""
        size = np.array(self.size)
        around = {
            "sphere": 0.0,
            "box": np.linalg.norm(size) / 2,
            "cylinder": math.hypot(size[0], size[-1] / 2),
            "capsule": size[0] + size[-1] / 2,
        }[self.form]
        return float(np.linalg.norm(self.place.position) + around)


@dataclass(frozen=True, kw_only=True)
class Contact:
    """Shapes at the tool, shapes that they meet, and the law of the force between them.

    `on` says what the other shapes are fixed to: the system's payload, which floats freely
    until a latch closes; the base (platform axes); or space (inertial axes). Each contact
    point is a spring of its own: a box that lies flat on a box has four. A contact that
    should stick loses its slip with the time constant `slip_time`.
    """

    tool: tuple[ContactShape, ...]  # in the tool's frame
    target: tuple[ContactShape, ...]
    on: str = "payload"
    stiffness: float = unit("N/m")
    damping: float = unit("N s/m", default=0.0)
    friction: float = unit("1", default=0.0)
    slip_time: float = unit("s", default=0.01)

    def __post_init__(self) -> None:
        freeze_arrays(self)
        require_choice(self, "on", CARRIERS)
        require_positive(self, "stiffness", "slip_time")
        require_positive(self, "damping", "friction", zero=True)
        for name in ("tool", "target"):
            shapes = getattr(self, name)
            if not shapes or not all(isinstance(k, ContactShape) for k in shapes):
                raise ParameterError(
                    f"Contact.{name} must be one shape (ContactShape) or more, got {shapes!r}"
                )

    @property
    def points(self) -> int:
        """Contact points at once of two of its shapes that lie flat on each other."""
        round_ones = [
            all(k.form == "sphere" for k in part) for part in (self.tool, self.target)
        ]
        return 1 if any(round_ones) else 4


def rebound(mass: float, stiffness: float, damping: float) -> tuple[float, float]:
    """Return duration [s] and coefficient of restitution of a central impact.

    The force max(0, k d + c d') ends before the overlap does, where the acceleration is zero
    (Schwager and Poeschel, Granular Matter 9, 2007, 465-469).

    Args:
        mass: reduced mass of the two bodies along the normal [kg].
        stiffness: k [N/m].
        damping: c [N s/m].
    """
    natural, decay = math.sqrt(stiffness / mass), damping / (2 * mass)
    if decay < natural:
        omega = math.sqrt(natural**2 - decay**2)
        time = math.atan2(2 * decay * omega, decay**2 - omega**2) / omega
    elif decay == natural:
        time = 2 / decay
    else:
        omega = math.sqrt(decay**2 - natural**2)
        time = math.log((decay + omega) / (decay - omega)) / omega
    return time, math.exp(-decay * time)


def net_wrench(found: Array, tool: Array) -> Array:
    """Return the wrench on the tool of all contact points (..., 6), linear part first.

    Args:
        found: (..., k, 14) of each point: 1 or 0, force on the other body along normal and two
            tangents [N], overlap with a minus sign [m], place (3), normal from tool to body
            (3), first tangent (3).
        tool: (..., 3) place of the tool, about which the moment is taken [m].
    """
    normal, tangent = found[..., 8:11], found[..., 11:14]
    axes = np.stack([normal, tangent, np.cross(normal, tangent)], axis=-2)
    there = found[..., :1] > 0
    force = np.where(there, -np.einsum("...i,...ij->...j", found[..., 1:4], axes), 0.0)
    arm = np.where(there, found[..., 5:8] - tool[..., None, :], 0.0)
    out: Array = np.concatenate([force, np.cross(arm, force)], axis=-1).sum(axis=-2)
    return out


def spring_energy(found: Array, stiffness: float) -> Array:
    """Return what the springs of all contact points store (...,) [J].

    Args:
        found: see `net_wrench`.
        stiffness: of each point [N/m].
    """
    depth = np.where(found[..., 0] > 0, np.minimum(found[..., 4], 0.0), 0.0)
    out: Array = 0.5 * stiffness * np.sum(depth**2, axis=-1)
    return out
