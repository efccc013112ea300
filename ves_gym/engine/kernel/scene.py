"""What an environment asks of every state, compiled for a fixed number of simulations.

NumPy answers where nothing compiles.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ves_gym._util.params import Array
from ves_gym.engine.kernel.blocks import aligned, fill, unlane
from ves_gym.engine.kernel.build import Library, cached
from ves_gym.engine.kernel.emit import LANES
from ves_gym.engine.kernel.numbers import parameters, structure, symbolic_model
from ves_gym.engine.kernel.pieces import Piece, Program, emit_pieces
from ves_gym.engine.kernel.symbolic import column, symbols
from ves_gym.mechanics import equations
from ves_gym.mechanics.dynamics import inverse_dynamics, newton_euler
from ves_gym.mechanics.kinematics import frames, joint_positions
from ves_gym.mechanics.spatial import matvec, rotation
from ves_gym.system.energy import base_energy
from ves_gym.system.system import System

if TYPE_CHECKING:
    import casadi

_LIBRARIES: dict[str, Library] = {}


class _Map:
    """A graph (x ..., p) -> y at n points, over and over."""

    def __init__(self, system: System, n: int) -> None:
        self.system, self.n, self.ready = system, n, False
        self.blocks = -(-n // LANES)
        widths, height = self._sizes(system)
        self._x = [aligned(self.blocks, width, LANES) for width in widths]
        self._y = aligned(self.blocks, height, LANES)
        try:
            key = f"{type(self).__name__} {structure(system)}"
            if key not in _LIBRARIES:
                make = self.graph
                _LIBRARIES[key] = cached(key, lambda: emit_pieces({"point": make(system)}))
        except (ImportError, RuntimeError, OSError):
            return
        self.library = _LIBRARIES[key]
        _, values = parameters(system)
        self._p = aligned(1, len(values), LANES)
        self._p[:] = values[:, None]
        self._run = Program(self.library, [self.piece(self._x, self._y)])
        self.ready = True

    def piece(self, arguments: Sequence[Array], result: Array) -> Piece:
        """The map on rows of the caller's.

        Args:
            arguments: (blocks, width, LANES) each, in order.
            result: (blocks, height, LANES), written.
        """
        return Piece(self.library, "point", [*arguments, self._p, result])

    @staticmethod
    def _sizes(system: System) -> tuple[tuple[int, ...], int]:
        """Widths of the arguments, and of the result."""
        raise NotImplementedError

    @staticmethod
    def graph(system: System) -> casadi.Function:
        raise NotImplementedError

    def _evaluate(self, *x: Array) -> Array:
        for rows, values in zip(self._x, x, strict=True):
            fill(rows, values)
        self._run(0, self.blocks)
        return unlane(self._y, self.n)


class SceneMap(_Map):
    """Energy of the base and place of the tool (`core.energy`, `kinematics.frames`)."""

    @staticmethod
    def _sizes(system: System) -> tuple[tuple[int, ...], int]:
        size, m = 6 + system.arm.n, system.base.hidden
        return (size, size, 6, *((m, m) if m else ())), 8

    @staticmethod
    def graph(system: System) -> casadi.Function:
        import casadi as ca

        model, _, p = symbolic_model(system)
        size, hidden = 6 + system.arm.n, system.base.hidden
        sizes = {"z": size, "zd": size, "measured": 6}
        sizes |= {"u": hidden, "ud": hidden} if hidden else {}
        x = [symbols(name, (k,)) for name, k in sizes.items()]
        z, zd, measured, *modes = x
        u, ud = modes or (z[:0], z[:0])
        energies = equations.base_energy(model, z, zd, u, ud)
        reach = frames(model.arm, z[6:]).position[-1]
        tools = [y[:3] + rotation(y) @ reach for y in (z[:6], measured)]
        out = column(*energies, *tools)
        return ca.Function("scene", [column(k) for k in (*x, p)], [ca.cse(out)])

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
        `modes`: u and u' (n, m) of a base with internal modes.
        """
        if self.ready:
            z, zd = np.concatenate([y, q], axis=1), np.concatenate([yd, v], axis=1)
            out = self._evaluate(z, zd, measured, *(modes or ()))
        else:
            out = _scene(self.system, q, y, yd, measured, modes)
        return out[:, :2], out[:, 2:5], out[:, 5:]


def _scene(
    system: System,
    q: Array,
    y: Array,
    yd: Array,
    measured: Array,
    modes: tuple[Array, Array] | None,
) -> Array:
    energy = base_energy(system, q, y, yd, modes)
    reach = joint_positions(system.arm, q)[:, -1]
    tools = [pose[:, :3] + matvec(rotation(pose), reach) for pose in (y, measured)]
    return np.column_stack([energy.total, energy.strain, *tools])


class TorqueMap(_Map):
    """Joint torque of a motion on a base that stands still (`dynamics.inverse_dynamics`)."""

    @staticmethod
    def _sizes(system: System) -> tuple[tuple[int, ...], int]:
        return (3 * system.arm.n,), system.arm.n

    @staticmethod
    def graph(system: System) -> casadi.Function:
        import casadi as ca

        model, _, p = symbolic_model(system)
        x = symbols("x", (3, system.arm.n))
        torque, _ = newton_euler(model.arm, *x)
        return ca.Function("torque", [column(x), column(p)], [ca.cse(column(torque))])

    def __call__(self, motion: Array) -> Array:
        """(n, 3, joints) angle, rate and acceleration -> (n, joints) [N m]."""
        if self.ready:
            return self._evaluate(motion.reshape(self.n, -1))
        return inverse_dynamics(self.system.arm, *motion.swapaxes(0, 1))[0]
