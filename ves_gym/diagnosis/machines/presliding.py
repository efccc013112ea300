"""`Presliding`: friction that builds up over a distance after every reversal.

The laws of the library know the speed alone. Real contacts give way elastically first, like
bristles (Canudas de Wit et al., IEEE Trans. Automatic Control 40(3), 1995): the torque F then
follows its law over the distance travelled, dF/dt = (law - F) |v| / length, however slowly. How
a friction does this is no other effect, so a fit may have some of it with every friction it
tries: over three distances, which make others together.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial

import numpy as np

from ves_gym._util.params import Array
from ves_gym.diagnosis.data.measured_run import Run
from ves_gym.diagnosis.machines.recursions import follow
from ves_gym.effects import JointMemory
from ves_gym.system.deviations import contacts, friction
from ves_gym.system.effect import Effect

_SLIDES = 3.0  # times the rate over which a law builds up from rest: there it has
_NOISE = 3.0  # standard deviations of a rate's noise, about which it is no motion


@dataclass(frozen=True)
class Presliding:
    """A friction, and the distance [rad] over which it builds up."""

    effect: Effect
    length: float = 1e-3  # of geared joints (Armstrong-Helouvry et al., Automatica 30(7), 1994)

    def sliding(self, v: Array) -> Array:
        """Return rates (..., T, n) at which the law has built up, of the same sign [rad/s].

        The bristles stand for what a law of the rate does about rest to have no corner.
        """
        creep = getattr(self.effect, "creep", 0.0)
        return np.copysign(np.maximum(np.abs(v), _SLIDES * creep), v)

    def built_up(self, torque: Array, v: Array, dt: float) -> Array:
        """Return the law's torque as it builds up from sample to sample.

        Args:
            torque: (..., T, n) of the law, at rates that slide [N m].
            v: (..., T, n) joint rates [rad/s].
            dt: between samples [s].
        """
        part = -np.expm1(-np.abs(v) * dt / self.length)
        flat = (-1, *torque.shape[-2:])
        rows = follow(torque.reshape(flat), np.broadcast_to(part, torque.shape).reshape(flat))
        return np.asarray(rows).reshape(torque.shape)


# in which a friction may be in part; the last is of an elastic gear, or a soft seal
FORMS = (Presliding, partial(Presliding, length=3e-4), partial(Presliding, length=4e-3))


def remembered_friction(run: Run, effects: Iterable[Effect]) -> Array | float:
    """Return the torque (..., T, n) of friction that depends on how joints have moved.

    Rates are those logged, where they are: a reversal lies between two samples, and rates
    from angles up to the band smear it. A rate that noise may be is taken for rest, or it would
    bend bristles back and forth.
    """
    memories = [e.levels for e in effects if isinstance(e, JointMemory)]
    if not memories:
        return 0.0

    def states() -> tuple[Array, Array]:
        if "v" not in run:
            return contacts(run.joints.v, run.dt)
        v = run["v"]
        size = np.maximum(_NOISE * run.noise["v"].std, 1e-12)
        return contacts(-v * np.expm1(-np.square(v / size)), run.dt)

    bristle, age = run.derived("contacts", frozenset({"q", "v"}), states)
    return friction(np.sum(memories, axis=0), bristle, age)
