"""Simulations that left the meaningful range: which, and what they did before."""

from __future__ import annotations

import numpy as np

from ves_gym._util.params import Index, Mask
from ves_gym.engine.backends.base import MEANINGLESS, Backend
from ves_gym.mechanics.spatial import AXES, SINGULAR
from ves_gym.simulation.state import State
from ves_gym.system.system import System


class Divergence(ArithmeticError):
    """A simulation left the meaningful range; `ids` lists all of them."""

    def __init__(self, message: str, ids: Index) -> None:
        super().__init__(message)
        self.ids = ids


def tumbled(system: System, backend: Backend) -> Mask:
    """(n,) true where a satellite's attitude reached the end of its angles, phi_y = 90 deg."""
    _, z, _ = backend.read()  # in its chart, where it has one
    if system.base.body is None:
        return np.zeros(len(z), bool)
    tilt: Mask = np.cos(z[:, 4]) < SINGULAR  # or beyond: a step may jump over it
    return tilt


def describe(i: int, system: System, backend: Backend, last: State) -> str:
    """Name simulation, time and the worst coordinate while it was finite.

    Args:
        i: which simulation.
        system, backend: what is simulated, and the engine that runs it.
        last: the last state that was read.
    """
    time, z, zd = (part[i] for part in backend.read())
    which = f"simulation {i} of {len(last.time)} diverged at t = {time:.4f} s: "
    if tumbled(system, backend)[i]:
        return which + f"phi_y = {np.rad2deg(z[4]):.1f} deg, Z-Y-X angles end at 90 deg"
    if not (np.abs([z, zd]) < MEANINGLESS).all():  # soon every coordinate is
        z, zd = np.r_[last.y[i], last.q[i]], np.r_[last.yd[i], last.v[i]]
    size = np.maximum(np.abs(z), np.abs(zd))
    names = [*AXES, *(f"joint {k + 1}" for k in range(system.arm.n))]
    worst = int(size.argmax())
    return which + f"{names[worst]} = {z[worst]:.3g} moving at {zd[worst]:.3g}"
