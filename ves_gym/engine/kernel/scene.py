"""What an environment asks of every state, compiled for a fixed number of simulations.

Each map has the parameters of every simulation of its own, so that simulations may run
different systems of one structure. NumPy answers where nothing compiles.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from ves_gym._util.params import Array, Index
from ves_gym.engine.kernel import mechanics
from ves_gym.engine.kernel.blocks import aligned, fill, unlane
from ves_gym.engine.kernel.build import Library, cached
from ves_gym.engine.kernel.emit import LANES, emit_map
from ves_gym.engine.kernel.trace import _symbols, parameters, structure
from ves_gym.mechanics.dynamics import frames, inverse_dynamics, joint_positions, newton_euler
from ves_gym.mechanics.spatial import matvec, rotation
from ves_gym.system.energy import base_energy
from ves_gym.system.system import System

if TYPE_CHECKING:
    import casadi

_LIBRARIES: dict[str, Library] = {}


class _Map:
    """A graph (x, p) -> y at n points, over and over."""

    def __init__(self, system: System, n: int) -> None:
        self.systems = [system] * n
        self.n, self._ready = n, False
        joints = system.arm.n
        blocks = -(-n // LANES)
        width, height = self._sizes(joints)
        self._x, self._y = aligned(blocks, width, LANES), aligned(blocks, height, LANES)
        try:
            key = f"{type(self).__name__} {structure(system)}"
            if key not in _LIBRARIES:
                _LIBRARIES[key] = cached(key, lambda: emit_map(self._graph(system)))
        except (ImportError, RuntimeError, OSError):
            return
        self.names, values = parameters(system)
        self._p = aligned(blocks, len(values), LANES)
        self._p[:] = values[:, None]
        self._map = _LIBRARIES[key].map
        where = tuple(k.ctypes.data for k in (self._x, self._p, self._y))
        self._runs = [partial(self._map, *where, 0, blocks)]  # all by the first block's p
        self._ready = True

    @staticmethod
    def _sizes(joints: int) -> tuple[int, int]:
        raise NotImplementedError

    @staticmethod
    def _graph(system: System) -> casadi.Function:
        raise NotImplementedError

    def assign(self, ids: Index, systems: list[System]) -> None:
        """Give simulations the numbers of their own systems (`Simulator.assign`).

        Args:
            ids: (k,) which.
            systems: k of them.
        """
        for i, system in zip(ids.tolist(), systems, strict=True):
            self.systems[i] = system
            if self._ready:
                values = dict(zip(*parameters(system), strict=True))
                row = [values.get(name, 0.0) for name in self.names]
                self._p[i // LANES, :, i % LANES] = row
        if self._ready:
            self._runs = [
                partial(self._map, x.ctypes.data, p.ctypes.data, y.ctypes.data, 0, 1)
                for x, p, y in zip(self._x, self._p, self._y, strict=True)
            ]

    def _evaluate(self, x: Array) -> Array:
        fill(self._x, x)
        for run in self._runs:
            run()
        return unlane(self._y, self.n)

    def _per_simulation(self, work: Callable[..., Any], *parts: Array) -> Array:
        """`work(system, *rows)` in NumPy, system by system."""
        if len(set(map(id, self.systems))) == 1:
            return np.asarray(work(self.systems[0], *parts), dtype=np.float64)
        rows = [work(s, *(p[i : i + 1] for p in parts)) for i, s in enumerate(self.systems)]
        return np.concatenate(rows)


class SceneMap(_Map):
    """Energy of the base and place of the tool (`core.energy`, `dynamics.frames`)."""

    @staticmethod
    def _sizes(joints: int) -> tuple[int, int]:
        return 2 * (6 + joints) + 6, 8

    @staticmethod
    def _graph(system: System) -> casadi.Function:
        import casadi as ca

        model, symbols = _symbols(system)
        size = 6 + system.arm.n
        x = ca.SX.sym("x", 2 * size + 6)
        k = list(ca.vertsplit(x))
        z, zd, measured = k[:size], k[size : 2 * size], k[2 * size :]
        energy = mechanics.base_energy(model, z, zd, ca)
        force = mechanics.times(model.K, z[:6])
        strain = 0.5 * sum(a * b for a, b in mechanics.pairs(force, z[:6]))
        reach = frames(model.arm, z[6:], ca)[-1].position
        tools = []
        for y in (z[:6], measured):
            T, _ = mechanics._rates(y, ca)
            tools += [y[i] + sum(T[j][i] * reach[j] for j in range(3)) for i in range(3)]
        out = ca.vertcat(energy, strain, *tools)
        return ca.Function("scene", [x, ca.vertcat(*symbols)], [ca.cse(out)])

    def __call__(
        self, q: Array, v: Array, y: Array, yd: Array, measured: Array
    ) -> tuple[Array, Array, Array]:
        """E of the base and its strain energy (n, 2) [J], tool in space (n, 3) [m].

        The tool twice: with the base at its pose y, and at its `measured` pose (n, 6).
        """
        if self._ready:
            out = self._evaluate(np.concatenate([y, q, yd, v, measured], axis=1))
        else:
            out = self._per_simulation(_scene, q, y, yd, measured)
        return out[:, :2], out[:, 2:5], out[:, 5:]


def _scene(system: System, q: Array, y: Array, yd: Array, measured: Array) -> Array:
    energy = base_energy(system, q, y, yd)
    reach = joint_positions(system.arm, q)[:, -1]
    tools = [pose[:, :3] + matvec(rotation(pose), reach) for pose in (y, measured)]
    return np.column_stack([energy.total, energy.strain, *tools])


class TorqueMap(_Map):
    """Joint torque of a motion on a base that stands still (`dynamics.inverse_dynamics`)."""

    @staticmethod
    def _sizes(joints: int) -> tuple[int, int]:
        return 3 * joints, joints

    @staticmethod
    def _graph(system: System) -> casadi.Function:
        import casadi as ca

        model, symbols = _symbols(system)
        n = system.arm.n
        x = ca.SX.sym("x", 3 * n)
        k = list(ca.vertsplit(x))
        arm = mechanics.one_base(model.arm)
        torque, _, _ = newton_euler(arm, k[:n], k[n : 2 * n], k[2 * n :], xp=ca)
        return ca.Function("torque", [x, ca.vertcat(*symbols)], [ca.cse(ca.vertcat(*torque))])

    def __call__(self, motion: Array) -> Array:
        """(n, 3, joints) angle, rate and acceleration -> (n, joints) [N m]."""
        if self._ready:
            return self._evaluate(motion.reshape(self.n, -1))
        parts = motion.swapaxes(0, 1)
        return self._per_simulation(lambda s, *m: inverse_dynamics(s.arm, *m)[0], *parts)
