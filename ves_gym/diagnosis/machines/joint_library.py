"""Candidates of a machine of joints: the library's laws in the units of each joint, rates
logged otherwise than they were, coupled shafts and payloads.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ves_gym._util.params import Array, ParameterError, require_positive, unit
from ves_gym.diagnosis.inference.candidates import Candidate, library
from ves_gym.diagnosis.machines.causes import COULOMB_MOST, VISCOUS_MOST, arm_friction
from ves_gym.diagnosis.machines.joint_changes import CarriedBody, RateError, Shaft
from ves_gym.effects import JointStribeck, JointVelocityLag
from ves_gym.mechanics.body_numbers import PARAMETER_UNITS, PARAMETERS, nearest_body
from ves_gym.system.effect import EFFECTS, Effect, TorqueEffect

_BESIDE_LAWS = ("joint/measurement_delay", "joint/rotor_inertia", "joint/velocity_lag")
_ON_RACK = {  # unit of a turning joint -> unit of a slide, power of the radius between them
    "N m": ("N", -1),
    "N m s/rad": ("N s/m", -2),
    "kg m^2": ("kg", -2),
    "rad/s": ("m/s", 1),
    "rad": ("m", 1),
}
_LAGS = (0.02, 0.005, 0.2)  # s, where fits of a low-pass begin
_BREAKAWAY, _STUCK = 2.0, 30.0  # N m above Coulomb's: where fits begin, and most
_FADED = 0.1  # rad/s: what fades later is not of standstill but Coulomb's by another name
_INERTIA_MOST = 10.0  # kg m^2
_PAYLOAD = {"kg": (1.0, 0.0, 50.0), "kg m": (0.1, -20.0, 20.0), "kg m^2": (0.02, -10.0, 10.0)}


@dataclass(frozen=True)
class MjcfJoint:
    """A joint as the laws of the library see it."""

    name: str
    type: str = "hinge"  # or "slide"
    radius: float = unit("m", default=1.0)  # of the pinion that a slide is seen on
    rotor: float = unit("kg m^2", default=0.0)  # beside the model's, at the joint; slides: kg
    gain_unknown: bool = False  # the force logged has no scale of its own

    def __post_init__(self) -> None:
        if self.type not in ("hinge", "slide"):
            raise ParameterError(
                f"joint {self.name}: type must be hinge or slide, got {self.type!r}"
            )
        require_positive(self, "radius")
        if not self.rotor >= 0:
            raise ParameterError(f"joint {self.name}: rotor must be >= 0, got {self.rotor}")
        if self.type == "hinge" and self.radius != 1.0:
            raise ParameterError(
                f"joint {self.name}: radius is of slides, this is a hinge, got {self.radius}"
            )


def is_computed(cls: type[Effect]) -> bool:
    """Return True for what such a machine can compute; the rest is another machine's.

    Args:
        cls: effect of the library.
    """
    if issubclass(cls, TorqueEffect):
        return cls.kind != "joint/torque_limit"  # a mapping file states none of the motors
    return cls.kind in _BESIDE_LAWS


def joint_candidates(joints: Sequence[MjcfJoint], ports: Sequence[str]) -> list[Candidate]:
    """Return the library as far as it applies, each effect in the units of its joint.

    Args:
        joints: in the order of the columns.
        ports: names.
    """
    n = len(joints)
    every = library(n, ports)
    slots = {f"joint {i + 1}": i for i in range(n)}
    out = []
    for candidate in (c for c in every if c.kind in EFFECTS and is_computed(EFFECTS[c.kind])):
        candidate = dataclasses.replace(candidate, blurs=())  # one form of every law here
        if candidate.kind == "joint/stribeck":
            candidate = _excess(candidate, slots[candidate.slot], n)
        at = slots.get(candidate.slot)
        scaled = at is not None and joints[at].gain_unknown
        if candidate.kind == "joint/drive_gain" and scaled:
            continue  # it is an unknown of the description already
        out.append(candidate if at is None else _placed(candidate, joints[at]))
    for i, joint in enumerate(joints):
        only = tuple(float(k == i) for k in range(n))
        out += [_rates(kind, joint.name, only) for kind in ("gain", "delay")]
    if n > 1:  # one firmware in all drives
        out += [_rates(kind, "", (1.0,) * n) for kind in ("delay", "lag")]
    if "joint" in ports:
        out += arm_friction([j.name for j in joints], [j.radius for j in joints])
    return out


def coupled_shaft(joints: Sequence[MjcfJoint], ratio: Sequence[float]) -> Candidate:
    """Return friction and inertia of a shaft that several joints turn, as one cause.

    Args:
        joints: all.
        ratio: (n,) rate of the shaft per rate of each joint.
    """
    names = [j.name for j, r in zip(joints, ratio, strict=True) if r]
    turns = tuple(float(r) for r in ratio)
    return Candidate(
        kind="shaft/friction",
        slot=" and ".join(names),
        ports=("joint",),
        names=("coulomb", "viscous", "inertia"),
        units=("N m", "N m s/rad", "kg m^2"),
        starts=((2.0, 1.0, 0.1),),
        low=(0.0,) * 3,
        high=(COULOMB_MOST, VISCOUS_MOST, _INERTIA_MOST),
        make=lambda x: Shaft(turns, *(float(k) for k in x)),
        factors=(0, 1, 2),
    )


def payload_candidate(visible: Sequence[int], observable: Array) -> Candidate:
    """Return mass, centre and inertia of a payload as one cause.

    Args:
        visible: which k of `PARAMETERS` the forces can tell.
        seen: (k, 10) what each shows of all ten; a rigid body must have numbers that do.
    """
    ranges = [_PAYLOAD[PARAMETER_UNITS[k]] for k in visible]

    def make(x: Array) -> CarriedBody:
        every = np.zeros(10)
        every[list(visible)] = x
        m, mx, my, mz, *inertia = (float(value) for value in every)
        return CarriedBody(m, (mx, my, mz), tuple(inertia))

    return Candidate(
        kind="payload/body",
        slot="",
        ports=("joint",),
        names=tuple(PARAMETERS[k] for k in visible),
        units=tuple(PARAMETER_UNITS[k] for k in visible),
        starts=(tuple(x[0] for x in ranges),),
        low=tuple(x[1] for x in ranges),
        high=tuple(x[2] for x in ranges),
        make=make,
        factors=tuple(range(len(visible))),
        sparse=True,
        feasible=lambda x, precision: nearest_body(x, precision, observable),
    )


def _excess(candidate: Candidate, joint: int, n: int) -> Candidate:
    """Of Stribeck friction what is beside Coulomb's, a candidate of its own: no name holds
    another, and the simpler comes first."""

    def make(x: Array) -> Effect:
        level = tuple(float(x[0]) if i == joint else 0.0 for i in range(n))
        return JointStribeck(coulomb=(0.0,) * n, stiction=level, fade_speed=float(x[1]))

    return dataclasses.replace(
        candidate,
        names=("breakaway", "fade_speed"),
        units=("N m", "rad/s"),
        starts=((_BREAKAWAY, _FADED / 2), (_BREAKAWAY, _FADED)),
        low=(0.0, candidate.low[-1]),
        high=(_STUCK, _FADED),
        make=make,
        factors=(0,),
    )


def _rates(what: str, slot: str, where: tuple[float, ...]) -> Candidate:
    """A way in which the joints marked with 1 in `where` (n,) report their rates."""
    none = (0.0,) * len(where)

    def make(x: Array) -> Any:
        values = tuple(float(x[0]) * w for w in where)
        if what == "lag":
            return JointVelocityLag(time_constant=values)
        return RateError(values, none) if what == "gain" else RateError(none, values)

    name, symbol, starts, low, high = {
        "gain": ("gain", "1", (0.05,), -0.5, 0.5),
        "delay": ("delay", "s", (0.01, 0.1), 0.0, 0.5),
        "lag": ("time_constant", "s", _LAGS, 0.0, 1.0),
    }[what]
    return Candidate(
        kind="joint/velocity_lag" if what == "lag" else f"velocity/{what}",
        slot=slot,
        ports=("velocity",),
        names=(name,),
        units=(symbol,),
        starts=tuple((x,) for x in starts),
        low=(low,),
        high=(high,),
        make=make,
        factors=(0,),
    )


def _placed(candidate: Candidate, joint: MjcfJoint) -> Candidate:
    """A candidate under its joint's name; of a slide in m and N."""
    if joint.type == "hinge":
        return dataclasses.replace(candidate, slot=joint.name)
    units, powers = zip(*(_ON_RACK.get(u, (u, 0)) for u in candidate.units), strict=True)
    factor = joint.radius ** np.array(powers, float)

    def scaled(values: Sequence[float]) -> tuple[float, ...]:
        return tuple((np.array(values) * factor).tolist())

    return dataclasses.replace(
        candidate,
        slot=joint.name,
        units=units,
        starts=tuple(scaled(s) for s in candidate.starts),
        low=scaled(candidate.low),
        high=scaled(candidate.high),
        make=lambda x: candidate.make(
            np.clip(np.asarray(x) / factor, candidate.low, candidate.high)
        ),
    )
