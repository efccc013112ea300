"""The balance of torques at driven joints, told in the torque that the log holds."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import lru_cache

import numpy as np

from ves_gym._util.params import Array
from ves_gym.system.effect import Effect, TorqueEffect, joint_torque

_PUSH = 1e-6  # relative, of a difference
_TRIED = 4  # random states in which a law is asked about the torque
_NO_LIMIT = 1e9  # N m


@lru_cache(maxsize=1024)
def scales(effect: Effect) -> bool:
    """Return True for a law that changes with the torque, short of a limit of it."""
    if not isinstance(effect, TorqueEffect):
        return False
    widths = [np.size(x) for x in vars(effect).values() if np.size(x) > 1]
    q, v, tau = np.random.default_rng(0).normal(size=(3, _TRIED, min(widths, default=1)))
    most = np.full(q.shape[-1], _NO_LIMIT)
    weak, strong = (joint_torque([effect], q, v, k * tau, most) for k in (1.0, 2.0))
    return bool((weak != strong).any())


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
    if not any(map(scales, effects)):
        return balance
    push = _PUSH * np.maximum(np.abs(tau), 1.0)
    return np.asarray(balance / (1 + (laws(tau + push) - added) / push))
