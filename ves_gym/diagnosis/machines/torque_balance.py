"""The balance of torques at driven joints, told in the torque that the log holds."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from ves_gym._util.params import Array
from ves_gym.system.effect import Effect

SCALING = ("joint/drive_gain", "joint/load_friction")  # laws that multiply the torque
_PUSH = 1e-6  # relative, of a difference


def torque_residual(
    tau: Array, needed: Array, effects: Iterable[Effect], laws: Callable[[Array], Array]
) -> Array:
    """Return the torque logged less the torque that should have been (..., T, n).

    Not what acts less what is needed: a drive that gives less would seem to explain any
    residual by making all of it smaller.

    Args:
        tau: (..., T, n) logged [N m].
        needed: (..., T, n) that the motion takes, by the motors and by `laws`.
        effects: those in `laws`.
        laws: torque logged -> torque that the effects add to it.
    """
    added = laws(tau)
    balance = tau + added - needed
    if not any(e.kind in SCALING for e in effects):
        return balance
    push = _PUSH * np.maximum(np.abs(tau), 1.0)
    return np.asarray(balance / (1 + (laws(tau + push) - added) / push))
