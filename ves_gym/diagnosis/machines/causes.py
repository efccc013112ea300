"""Physical causes that several effects of the library stand for, as one candidate each.

A joint that rubs may be a fault of that joint; an arm whose joints all rub was described
without friction, and that is one thing to say. A cause has the numbers of all its parts, and
costs those that are clear, one a place at least. What it adds to a description are its parts,
so that any machine that computes them computes the cause.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from ves_gym._util.params import Array
from ves_gym.diagnosis.machines.presliding import FORMS, Presliding
from ves_gym.effects import JointCoulomb, JointViscous
from ves_gym.system.candidate import Candidate
from ves_gym.system.effect import Effect

ARM = 3  # joints from which friction of all of them is one cause
FRICTION = "joint/friction"
COULOMB_MOST, VISCOUS_MOST = 50.0, 50.0  # N m, N m s/rad
_COULOMB, _VISCOUS = 2.0, 1.0  # usual: N m, N m s/rad


@dataclass(frozen=True)
class CompositeCause:
    """Effects that are one physical cause."""

    effects: tuple[Any, ...]


def split(effects: Any) -> tuple[Any, ...]:
    """Return effects with those inside `CompositeCause` one by one."""
    out: list[Any] = []
    for effect in effects:
        out += split(effect.effects) if isinstance(effect, CompositeCause) else [effect]
    return tuple(out)


def arm_friction(
    places: Sequence[str], radius: Sequence[float] = (), builds_up: bool = False
) -> Iterator[Candidate]:
    """Yield viscous and Coulomb friction of all joints as one cause; nothing for a few joints.

    Args:
        places: names of the joints.
        radius: of the pinion that each is seen on; slides have one that is not 1 [m].
        builds_up: a form in which Coulomb friction builds up over a distance is allowed for.
    """
    n = len(places)
    if n < ARM:
        return
    r = np.array(radius or (1.0,) * n)
    viscous_units = tuple("N m s/rad" if k == 1.0 else "N s/m" for k in r)
    coulomb_units = tuple("N m" if k == 1.0 else "N" for k in r)

    def make(x: Array) -> CompositeCause:
        viscous, coulomb = np.split(np.asarray(x), 2)
        return CompositeCause(
            (
                JointViscous(damping=tuple((viscous * r**2).tolist())),
                JointCoulomb(torque=tuple((coulomb * r).tolist())),
            )
        )

    yield Candidate(
        kind=FRICTION,
        slot="all joints",
        ports=("joint",),
        names=(*(f"viscous of {k}" for k in places), *(f"coulomb of {k}" for k in places)),
        units=(*viscous_units, *coulomb_units),
        starts=((*(_VISCOUS / r**2), *(_COULOMB / r)),),
        low=(0.0,) * (2 * n),
        high=(*(VISCOUS_MOST / r**2), *(COULOMB_MOST / r)),
        make=make,
        factors=tuple(range(2 * n)),
        blurs=tuple(partial(_building_up, form) for form in FORMS) if builds_up else (),
        sparse=True,
        parts=(
            *((JointViscous.kind, k) for k in places),
            *((JointCoulomb.kind, k) for k in places),
        ),
    )


def _building_up(form: Callable[[Effect], Presliding], cause: CompositeCause) -> CompositeCause:
    """Return a friction whose Coulomb part builds up over a distance."""
    grown = (form(e) if isinstance(e, JointCoulomb) else e for e in cause.effects)
    return dataclasses.replace(cause, effects=tuple(grown))
