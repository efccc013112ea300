"""Common part of the optional GPU engines: MuJoCo's model on a device, its state kept here.

Single precision, and not bit-for-bit repeatable: never chosen by `auto`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np

from ves_gym._util.params import Array, Index, ParameterError
from ves_gym.engine.backends.base import MEANINGLESS, Remembering, Toucher
from ves_gym.engine.backends.mujoco import compile_model
from ves_gym.engine.mjcf import TO_Y
from ves_gym.system.effect import TorqueEffect
from ves_gym.system.effect_rows import EffectRows
from ves_gym.system.system import PRESCRIBED_INERTIA, System


class DeviceBackend(Remembering, ABC):
    """`Backend` whose subclasses run `_advance` and `_forward` on a device."""

    name = "device"
    has_actuators = False
    contact: Toucher | None = None
    state_names = ("_q", "_v", "_act", "_time", "_fault", "_bias")

    def __init__(self, system: System, n: int, threads: int) -> None:
        if any(isinstance(effect, TorqueEffect) for effect in system.effects):
            raise ParameterError(
                f"backend {self.name} has no torque laws of effects: use kernel or mujoco"
            )
        carried = system.base.m or system.base.drag is not None or system.base.carried
        if system.arm.geared or system.arm.bends or (carried and system.mode == "ideal"):
            raise ParameterError(
                f"backend {self.name} has no gears that give way, links that bend, drag,"
                " internal modes, wheels or appendages of the vehicle: use kernel or mujoco"
            )
        if system.integrator == "implicitfast":
            raise ParameterError(
                f"backend {self.name} has the integrators rk4 and euler, got implicitfast"
            )
        self.n, self.joints = n, system.arm.n
        self.prescribed = system.drive == "prescribed"
        self.dt = system.physics_dt
        self.host = compile_model(system)
        self._order = np.r_[TO_Y, 6 + np.arange(self.joints)]
        self._drives = self.host.nu - self.joints
        self._bias = np.tile(self.host.actuator_biasprm, (n, 1, 1))
        self._q, self._v = np.zeros((n, self.host.nq)), np.zeros((n, self.host.nv))
        self._act, self._push = np.zeros((n, self.host.nu)), np.zeros((n, self.host.nv))
        self._time, self._fault = np.zeros(n), np.zeros(n, bool)

    @abstractmethod
    def _advance(self, slopes: Array) -> tuple[Array, Array, Array, Array]:
        """Through slopes (n, k, nu) of the commands: q, v, act, sensors (n, k, m)."""

    @abstractmethod
    def _forward(self) -> tuple[Array, Array, Array]:
        """Acceleration, actuator force and sensors at this state."""

    def _play(self, slopes: Array, ids: Index | None) -> Array:
        q, v, act, sensed = self._advance(slopes)
        rows = np.arange(self.n) if ids is None else ids
        self._q[rows], self._v[rows], self._act[rows] = q[rows], v[rows], act[rows]
        self._time[rows] += slopes.shape[1] * self.dt
        for part in (self._q, self._v):
            self._fault |= ~(np.abs(part) < MEANINGLESS).all(axis=1)
        return sensed

    def read(self) -> tuple[Array, Array, Array]:
        return self._time.copy(), self._q[:, self._order], self._v[:, self._order]

    def write(self, ids: Index, time: Array, z: Array, zd: Array) -> None:
        self._q[np.ix_(ids, self._order)], self._v[np.ix_(ids, self._order)] = z, zd
        self._act[ids], self._time[ids], self._fault[ids] = 0.0, time, False

    def set_base(self, ids: Index, y: Array, yd: Array) -> None:
        self._q[np.ix_(ids, TO_Y)], self._v[np.ix_(ids, TO_Y)] = y, yd

    def set_gains(self, ids: Index, kp: Array, kd: Array) -> None:
        self._bias[ids, self._drives :, 1], self._bias[ids, self._drives :, 2] = -kp, -kd

    def assign(self, ids: Index, systems: Sequence[System]) -> None:
        raise ParameterError(
            f"backend {self.name} has one system for all simulations: use kernel or mujoco"
        )

    def assign_laws(self, ids: Index, rows: EffectRows) -> None:
        self.assign(ids, [rows.system(row).actual for row in range(len(rows))])

    def step(
        self,
        command: Array,
        until: Array | None,
        wrench: Array | None,
        substeps: int,
        ids: Index | None,
    ) -> None:
        self._act[:, self._drives :] = command
        if wrench is not None:
            self._push[:, TO_Y] = wrench
        slopes = np.zeros((self.n, substeps, self._act.shape[1]))
        if until is not None:
            slopes[..., self._drives :] = ((until - command) / (substeps * self.dt))[:, None]
        self._play(slopes, ids)
        self._push[:] = 0.0  # it acts in this period only

    def step_sequence(self, commands: Array, ids: Index | None) -> None:
        self._act[:] = commands[:, 0]
        self._play(np.diff(commands, axis=1) / self.dt, ids)

    def step_on_platform(self, commands: Array, base: Array, ids: Index | None) -> Array:
        nodes = np.concatenate([base[..., TO_Y], commands], axis=-1)
        self._act[:] = nodes[:, 0]
        out = np.empty((self.n, nodes.shape[1], 6))
        out[:, :-1] = -self._play(np.diff(nodes, axis=1) / self.dt, ids)
        out[:, -1] = -self._forward()[2]
        return out

    def set_gear_state(self, d: Array, rate: Array) -> None:
        raise ParameterError(f"backend {self.name} has no gears that give way")

    def set_carried(self, ids: Index, at: Array, rate: Array) -> None:
        raise ParameterError(f"backend {self.name} has no wheels and appendages")

    def set_actuators(self, ids: Index, wrench: Array | None, torque: Array | None) -> None:
        raise ParameterError(f"backend {self.name} has no jets that turn with the base")

    def internal_state(self) -> tuple[Array, Array]:
        return np.zeros((self.n, 0)), np.zeros((self.n, 0))

    def evaluate(self, command: Array) -> tuple[Array, Array]:
        self._act[:, self._drives :] = command
        acceleration, force, _ = self._forward()
        torque, zdd = force[:, self._drives :], acceleration[:, self._order]
        if self.prescribed:
            torque = torque - PRESCRIBED_INERTIA * zdd[:, 6:]
        return torque, zdd
