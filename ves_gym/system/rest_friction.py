"""States of a joint's contact: how far its bristles are bent, and for how long it has rested.

Bristles follow the way travelled (Dahl, 1968), and friction grows with the time of rest
(Rabinowicz, Proc. Phys. Soc. 71, 1958; Armstrong-Helouvry et al., Automatica 30(7), 1994),
which a short way forgets. Both are exact for a rate that stays as it is over a step.
"""

from __future__ import annotations

import numpy as np

from ves_gym._util.params import Array

BENT = 1e-3  # rad over which bristles bend
FORGOTTEN = 1e-2  # rad of travel after which a rest is forgotten
RESTING = (0.5, 1.5, 5.0)  # s: times over which friction grows at rest


def fresh(shape: tuple[int, ...]) -> tuple[Array, Array]:
    """Return the states of contacts that have rested for long: bristles (...), ages (..., K).

    Args:
        shape: of the contacts.
    """
    return np.zeros(shape), np.ones((*shape, len(RESTING)))


def advanced(bristle: Array, age: Array, v: Array, dt: float) -> tuple[Array, Array]:
    """Return the states a step later.

    Args:
        bristle: (...) between -1 and 1.
        age: (..., K) between 0 and 1.
        v: (...) rate during the step [rad/s].
        dt: of the step [s].
    """
    way, pace = np.sign(v), np.abs(v)
    bristle = way * pace_part(pace * dt / BENT) + bristle * np.exp(-pace * dt / BENT)
    grows = 1 / np.array(RESTING)
    rate = grows + pace[..., None] / FORGOTTEN
    age = grows / rate * pace_part(rate * dt) + age * np.exp(-rate * dt)
    return bristle, age


def pace_part(x: Array) -> Array:
    """Return 1 - exp(-x): the part of the way to where a state goes."""
    return np.asarray(-np.expm1(-x))


def friction(levels: Array, bristle: Array, age: Array) -> Array:
    """Return the torque (...) on the joints [N m]; it never pushes a bristle further.

    Args:
        levels: (..., 1 + K) lasting, and per time of rest [N m].
        bristle: (...).
        age: (..., K).
    """
    level = levels[..., 0] + np.sum(levels[..., 1:] * age, axis=-1)
    return np.asarray(-bristle * np.maximum(level, 0.0))


def contacts(v: Array, dt: float) -> tuple[Array, Array]:
    """Return bristles (..., T, n) and ages (..., T, n, K) along measured rates.

    Args:
        v: (..., T, n) rad/s.
        dt: between samples [s].
    """
    x = fresh((*v.shape[:-2], v.shape[-1]))
    bristles, ages = [], []
    for k in range(v.shape[-2]):
        x = advanced(*x, v[..., k, :], dt)
        bristles.append(x[0])
        ages.append(x[1])
    return np.stack(bristles, axis=-2), np.stack(ages, axis=-3)
