"""What an environment asks of every state, for at most n simulations, over and over."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache, partial
from typing import TYPE_CHECKING

import numpy as np

from ves_gym._util.params import Array
from ves_gym.engine.kernel.compiled_function import CompiledFunction, Piece, everywhere
from ves_gym.engine.kernel.numbers import parameters, structure, symbolic_model
from ves_gym.engine.kernel.symbolic import column, symbols
from ves_gym.mechanics import equations
from ves_gym.mechanics.dynamics import newton_euler
from ves_gym.mechanics.kinematics import frames
from ves_gym.mechanics.spatial import rotation
from ves_gym.system.system import System

if TYPE_CHECKING:
    import casadi


@lru_cache(maxsize=64)
def scene_function(system: System) -> CompiledFunction:
    """(z, z', measured pose, modes, their rates, p) -> E, strain energy, tool twice (8).

    Energy of the base [J] and place of the tool in space [m] (`system.energy`,
    `kinematics.frames`), with the base at its pose and at the measured one. Modes are the arm's
    flexures and what the base has, where there are any.
    """
    return CompiledFunction(f"scene {structure(system)}", partial(_scene, system))


@lru_cache(maxsize=64)
def torque_function(system: System) -> CompiledFunction:
    """((angles, rates, accelerations), p) -> joint torque on a base that stands still [N m]."""
    return CompiledFunction(f"torque {structure(system)}", partial(_torque, system))


class _SystemMap:
    """A function of n simulations whose last argument is a system's parameters."""

    def __init__(self, function: CompiledFunction, system: System, n: int) -> None:
        self.function, self._p = function, parameters(system)[1]
        self._values = function.buffered(n, self._p)

    def piece(self, arguments: Sequence[Array], result: Array) -> Piece:
        """The map on rows of the caller's.

        Args:
            arguments: (blocks, width, LANES) each, in order.
            result: (blocks, height, LANES), written.
        """
        return self.function.piece(*arguments, everywhere(self._p), result)


class SceneMap(_SystemMap):
    """Energy of the base and place of the tool of n simulations (`scene_function`)."""

    def __init__(self, system: System, n: int) -> None:
        super().__init__(scene_function(system), system, n)

    def __call__(
        self,
        q: Array,
        v: Array,
        y: Array,
        yd: Array,
        measured: Array,
        modes: tuple[Array, Array] | None = None,
    ) -> tuple[Array, Array, Array]:
        """E of the base and its strain energy (n, 2) [J], tool in space (n, 3) [m].

        The tool twice: with the base at its pose y, and at its `measured` pose (n, 6).
        `modes`: u and u' (n, m) of flexures and of the base's internal modes.
        """
        z, zd = np.concatenate([y, q], axis=1), np.concatenate([yd, v], axis=1)
        out = self._values(z, zd, measured, *(modes or ()))
        return out[:, :2], out[:, 2:5], out[:, 5:]


class TorqueMap(_SystemMap):
    """Joint torque of n motions on a base that stands still (`torque_function`)."""

    def __init__(self, system: System, n: int) -> None:
        super().__init__(torque_function(system), system, n)

    def __call__(self, motion: Array) -> Array:
        """(n, 3, joints) angle, rate and acceleration -> (n, joints) [N m]."""
        return self._values(motion.reshape(len(motion), -1))


def _scene(system: System) -> casadi.Function:
    import casadi as ca

    model, _, p = symbolic_model(system)
    size, bends = 6 + system.arm.n, system.arm.bends
    hidden = bends + system.base.hidden
    sizes = {"z": size, "zd": size, "measured": 6}
    sizes |= {"u": hidden, "ud": hidden} if hidden else {}
    x = [symbols(name, (k,)) for name, k in sizes.items()]
    z, zd, measured, *modes = x
    u, ud = modes or (z[:0], z[:0])
    energies = equations.base_energy(model, z, zd, u, ud)
    arm, joints = model.arm, z[6:]
    if bends:
        arm, joints = model.chain, model.along(joints, u[:bends])
    reach = frames(arm, joints).position[-1]
    tools = [y[:3] + rotation(y) @ reach for y in (z[:6], measured)]
    out = column(*energies, *tools)
    return ca.Function("scene", [column(k) for k in (*x, p)], [ca.cse(out)])


def _torque(system: System) -> casadi.Function:
    import casadi as ca

    model, _, p = symbolic_model(system)
    x = symbols("x", (3, system.arm.n))
    torque, _ = newton_euler(model.arm, *x)
    return ca.Function("torque", [column(x), column(p)], [ca.cse(column(torque))])
