"""Work of a satellite's wheels and jets in a run, for the account of its energy."""

from __future__ import annotations

import numpy as np
import scipy

from ves_gym._util.params import Array
from ves_gym.mechanics.spatial import twist
from ves_gym.system.runlog import RunLog
from ves_gym.system.system import System


def actuator_work(log: RunLog, system: System) -> Array:
    """Return the work of wheels' motors and jets since the first sample, (N,) [J].

    Both are held through a control period. So a motor's is its torque times the angle that the
    wheel turns, exactly, where records are no further apart than that; a jet's is the integral
    of wrench times twist, by Simpson's rule within each period.

    Args:
        log: with `u`, `motor` and `jet` of such a satellite.
        system: that it is of.
    """
    out = np.zeros(len(log.t))
    if log.motor is not None and log.u is not None:
        first = system.arm.bends
        turned = np.diff(log.u[:, first : first + log.motor.shape[1]], axis=0)
        out[1:] += np.cumsum(np.sum(log.motor[:-1] * turned, axis=1))
    if log.jet is not None and log.yd is not None:
        moving = twist(log.y, log.yd)
        step = (log.t[-1] - log.t[0]) / (len(log.t) - 1)
        each = max(1, round(system.control_dt / step))
        for first in range(0, len(log.t) - 1, each):
            part = slice(first, min(first + each, len(log.t) - 1) + 1)
            power = moving[part] @ log.jet[first]
            work = scipy.integrate.cumulative_simpson(power, x=log.t[part], initial=0.0)
            out[part.start + 1 :] += work[-1]
            out[part.start + 1 : part.stop] += work[1:] - work[-1]
    return out
