"""Notes on a plan: what the machine has that the linear base of `prediction` does not know."""

from __future__ import annotations

import numpy as np

from ves_gym._util.params import Array
from ves_gym.mechanics.linear_range import range_sentence
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.pointing import shares, strongest
from ves_gym.mechanics.vehicle import Satellite, has_jets, orbit_of
from ves_gym.planners.case import AIM, Query
from ves_gym.planners.prediction import NODES, LinearBase, joint_loads, respond
from ves_gym.system.system import System


def notes(query: Query, motion: Motion | None) -> tuple[str, ...]:
    """Return a sentence for everything that the plan left out, none where it left out nothing.

    Args:
        query: the query.
        motion: the answer, for what it asks of a pointing law; None: none.
    """
    system = query.system
    out = [*_of_the_arm(system), *_of_the_base(system)]
    if system.drive == "motor" and not query.servo.feedforward:
        out.append("a servo without feed-forward: planned as if it had one")
    gives_way = system.drive == "motor" and not query.servo.holds(system.arm)
    if motion is not None and gives_way:
        out += _of_the_servo(query, motion)
    if system.effects:
        kinds = ", ".join(effect.kind for effect in system.effects)
        out.append(f"effects {kinds}: planned for the machine as described")
    if system.mode == "emulated":
        out.append("the laboratory: planned for the space system that it emulates")
    if motion is not None and isinstance(system.vehicle, Satellite):
        out += _of_pointing(query, system.vehicle, motion)
    elif motion is not None:
        linear = LinearBase(system, query.servo, motion.start)
        y = respond(linear, motion, NODES, query.base).x[:, :6]
        out += filter(None, [range_sentence(system.vehicle, y)])
    return tuple(out)


def _of_the_arm(system: System) -> list[str]:
    arm, out = system.arm, []
    gaps = [(i, gear.gap) for i in arm.geared if (gear := arm.links[i].gear) and gear.gap]
    if gaps:
        most = max(gap for _, gap in gaps)
        joints = ", ".join(str(i + 1) for i, _ in gaps)
        out.append(f"play of gears at joints {joints}, up to {most:.3g} rad: taken as none")
    if arm.rubs:
        out.append("friction of the joints: taken as none")
    if system.payload is not None:
        mass = system.payload.inertial.mass
        out.append(f"a payload of {mass:g} kg beside the tool: planned with the hand empty")
    if system.contact is not None:
        out.append("contact at the tool: planned as if nothing touched")
    return out


def _of_the_servo(query: Query, motion: Motion) -> list[str]:
    """A servo that yields to the base by more than an answer may be beside the goal."""
    loads = joint_loads(query.system, motion, query.servo, query.base)
    miss = np.abs(loads.away[-1])
    if miss.max() <= AIM:
        return []
    j = int(miss.argmax())
    return [
        f"the servo gives way to the base: joint {j + 1} will be {miss[j]:.4f} rad from the"
        f" goal when the motion ends, at most {AIM:g} is an answer"
    ]


def _of_the_base(system: System) -> list[str]:
    base, vehicle, out = system.base, system.vehicle, []
    if base.drag is not None and base.drag.any():
        out.append("damping of the base that grows with speed: taken as none")
    if has_jets(vehicle) and getattr(vehicle, "pointing", None) is None:
        out.append("jets: taken as off")
    if (orbit := orbit_of(vehicle)) is not None:
        out.append(f"gravity gradient on an {orbit}: taken as none")
    return out


def _of_pointing(query: Query, vehicle: Satellite, motion: Motion) -> list[str]:
    """Return sentences on where a motion exceeds the pointing law, wheels and jets."""
    law = vehicle.pointing
    if law is None:
        return []
    linear = LinearBase(query.system, query.servo, motion.start)
    response = respond(linear, motion, NODES, query.base)
    turned, spin = response.x[:, 3:6], response.rate[:, 3:6]
    assert linear.pointing is not None
    stiffness, damping = linear.pointing
    moment: Array = turned @ stiffness + spin @ damping
    out, most = [], float(np.abs(moment).max())
    if most > law.moment_max:
        out.append(
            f"the pointing law would ask {most:.3g} N m, its limit is {law.moment_max:g}"
        )
    elif not vehicle.thrusters:
        remaining = _beyond_the_wheels(vehicle, moment)
        if remaining > 0:
            out.append(
                f"the pointing law asks {most:.3g} N m, {remaining:.3g} N m beyond what wheels"
                " and jets give"
            )
    rate = law.rate * float(np.linalg.norm(turned, axis=1).max())
    if rate > law.spin_max:
        out.append(
            f"the pointing law would turn back by {rate:.3g} rad/s, its limit is"
            f" {law.spin_max:g}"
        )
    return out


def _beyond_the_wheels(vehicle: Satellite, moment: Array) -> float:
    """Moment (N, 3) that wheels at their torque and jets leave, the largest [N m]."""
    wheels, remainder = vehicle.wheels or (), moment
    if wheels:
        torque, most = moment @ shares(wheels).T, np.array([k.torque_max for k in wheels])
        axes = np.array([k.axis for k in wheels])
        remainder = moment - np.clip(torque, -most, most) @ axes
    jets = vehicle.jets or ()
    give = strongest(jets, (0.0, 0.0, 0.0))[3:] if jets else np.zeros(3)
    return float(np.maximum(np.abs(remainder) - give - 1e-9, 0.0).max())
