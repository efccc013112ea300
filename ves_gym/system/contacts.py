"""Energy that goes into contact at the tool, from a run log."""

from __future__ import annotations

import numpy as np
import scipy

from ves_gym._util.params import Array, Mask
from ves_gym.mechanics.attitude import rotate, to_matrix
from ves_gym.mechanics.kinematics import tool_frame, tool_twists
from ves_gym.mechanics.spatial import matvec, rotation, twist
from ves_gym.system.runlog import RunLog
from ves_gym.system.system import System


def contact_energies(log: RunLog, system: System) -> tuple[Array, Array]:
    """Return what contact has stored and what it has dissipated since the first sample [J].

    What it takes from the bodies is the integral of force times relative velocity. The force
    jumps where a contact begins, between two samples. So on a payload its impulse from sample
    to sample is taken from the payload's momentum, exactly; elsewhere the trapezoid rule has
    to do.

    Args:
        log: with `contact` and `contact_energy`.
        system: that it is of.

    Returns:
        (N,) each; the second one grows, but for the error of the quadrature.
    """
    assert log.contact is not None and log.contact_energy is not None
    place, moving = _tool(log, system)
    if system.contact is not None and system.contact.on == "payload":
        touching: Mask = np.asarray(log.contact.any(axis=1))
        steps = np.where(
            touching[1:] | touching[:-1], _from_payload(log, system, place, moving), 0
        )
        taken = np.r_[0.0, np.cumsum(steps)]
    else:
        power = -np.sum(log.contact * moving, axis=1)
        taken = scipy.integrate.cumulative_trapezoid(power, x=log.t, initial=0.0)
    stored = log.contact_energy[:, 0] - log.contact_energy[0, 0]
    return stored, np.asarray(taken - stored, np.float64)


def _tool(log: RunLog, system: System) -> tuple[Array, Array]:
    """Place (N, 3) and twist (N, 6) of the tool in inertial axes; against the base where that
    is touched."""
    assert system.contact is not None and log.v is not None and log.yd is not None
    place, _ = tool_frame(system.arm, log.q)
    R, base = rotation(log.y), twist(log.y, log.yd)
    out = matvec(tool_twists(system.arm, log.q), log.v)
    if system.contact.on != "base":
        out += base
        out[:, :3] += np.cross(base[:, 3:], place)
    out = np.concatenate([matvec(R, out[:, :3]), matvec(R, out[:, 3:])], axis=1)
    return log.y[:, :3] + matvec(R, place), out


def _from_payload(log: RunLog, system: System, place: Array, moving: Array) -> Array:
    """(N - 1,) energy that tool and payload lose to their contact from sample to sample [J]."""
    assert system.payload is not None and log.p is not None and log.pd is not None
    body, velocity = system.payload.inertial, log.pd[:, :3]
    com = log.p[:, :3] + rotate(log.p[:, 3:], np.array(body.com))
    turn = to_matrix(log.p[:, 3:])
    spin = matvec(turn, log.pd[:, 3:])
    momentum = matvec(turn, matvec(np.array(body.inertia), log.pd[:, 3:]))
    force, moment = body.mass * np.diff(velocity, axis=0), np.diff(momentum, axis=0)

    def mean(values: Array) -> Array:
        return (values[1:] + values[:-1]) / 2

    at_tool = moment + np.cross(mean(com - place), force)
    against = mean(velocity - moving[:, :3]), mean(spin), mean(moving[:, 3:])
    out: Array = np.sum(force * against[0] + moment * against[1] - at_tool * against[2], axis=1)
    return -out
