"""Common part of the engines that run our own compiled equations: parameters, hidden states."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np

from ves_gym._util.params import Array, Index, Mask
from ves_gym.engine.backends.base import ContactEngine
from ves_gym.engine.batch_parameters import ParameterRows, bodies_of
from ves_gym.mechanics.base_model import BaseModel
from ves_gym.system.effect_rows import EffectRows
from ves_gym.system.system import System


class CompiledBackend(ABC):
    """Sizes of state, input and output, and the systems of the simulations.

    The state x stacks (Y, q), what is hidden (deflections of gears, oscillators of the
    vehicle) and the rates of both; see `trace.Equations`.
    """

    contact: ContactEngine | None = None
    state_names: ClassVar[tuple[str, ...]]  # the arrays that a simulation's state lies in
    _fault: Mask

    def __init__(self, system: System, n: int) -> None:
        self.n, self.joints = n, system.arm.n
        self.emulated = system.mode == "emulated"
        self.prescribed = system.drive == "prescribed"
        self.dt = system.physics_dt
        self.rows = ParameterRows(system)
        self.names = self.rows.names
        by_controllers = ("kp", "kd", "jet", "motor")  # set by a controller, not by a system
        self._gains = np.array([name.startswith(by_controllers) for name in self.names])
        self._systems = [system] * n
        self._own_bases: set[int] = set()  # simulations with another than their system's
        size = 6 + self.joints
        self._extras = 0 if self.emulated else system.base.m
        self._carried = 0 if self.emulated else len(system.base.carried)
        self._gears = len(system.arm.geared) + system.arm.bends  # passive joints
        # coordinates: (Y, q), then what is hidden
        self._order = size + self._gears + self._carried + self._extras
        self._nx, self._nu = 2 * self._order, size
        self._ny = size + self.joints + (6 if self.emulated else 0)

    @abstractmethod
    def _row(self, i: int) -> Array:
        """Parameters of a simulation, in place."""

    @abstractmethod
    def _set_parameter(self, at: int, ids: Index, values: Array) -> None:
        """Set one parameter of some simulations.

        Args:
            at: which, as in `names`.
            ids: (k,) of the simulations.
            values: (k,).
        """

    def states_of(self, ids: Index, z: Array, zd: Array) -> Array:
        """(k, nx) states: gears relaxed, oscillators at rest on the vehicle.

        Args:
            ids: (k,) which simulations.
            z, zd: (k, 6 + joints) coordinates and rates.
        """
        if self._order == 6 + self.joints:
            return np.hstack([z, zd])
        parts = []
        for part in (z, zd):
            modes = self._gears + self._carried
            hidden = np.zeros((len(ids), modes + self._extras))
            if self._extras:
                systems = [self._systems[i] for i in ids.tolist()]
                if all(system is systems[0] for system in systems):
                    hidden[:, modes:] = systems[0].base.attached(part[:, :6])
                else:
                    attached = zip(systems, part[:, :6], strict=True)
                    hidden[:, modes:] = [k.base.attached(y) for k, y in attached]
            parts += [part, hidden]
        return np.hstack(parts)

    def set_gains(self, ids: Index, kp: Array, kd: Array) -> None:
        """See `Backend`."""
        for name, values in (("kp", kp), ("kd", kd)):
            for i in range(self.joints):
                self._set_parameter(self.names.index(f"{name}{i + 1}"), ids, values[:, i])

    def set_last_link(self, ids: Index, mass: Array, com: Array, inertia: Array) -> None:
        """See `Backend`."""
        link = f"link{self.joints}"
        numbers = {f"{link}.mass": mass}
        numbers |= {f"{link}.com{k + 1}": com[:, k] for k in range(3)}
        for i, j in zip(*np.triu_indices(3), strict=True):
            numbers[f"{link}.I{i + 1}{j + 1}"] = inertia[:, i, j]
        for name, values in numbers.items():
            self._set_parameter(self.names.index(name), ids, values)

    def set_actuators(self, ids: Index, wrench: Array | None, torque: Array | None) -> None:
        """See `Backend`."""
        for name, values in (("jet{}", wrench), ("motorcarried{}", torque)):
            for i in range(0 if values is None else values.shape[1]):
                at = self.names.index(name.format(i + 1))
                self._set_parameter(at, ids, values[:, i])  # type: ignore[index]

    def assign(self, ids: Index, systems: Sequence[System]) -> None:
        """See `Backend`."""
        pairs = list(zip(ids.tolist(), systems, strict=True))
        rows_of: dict[tuple[int, int], Array] = {}  # rows of the arms and vehicles seen
        rows = []
        for i, system in pairs:
            which, bodies = f"system of simulation {i}", bodies_of(system)
            if bodies not in rows_of:
                same = i not in self._own_bases and bodies == bodies_of(self._systems[i])
                rows_of[bodies] = self._row(i) if same else self.rows.of(system, which)
            rows.append(self.rows.with_effects(rows_of[bodies], system, which))
        for (i, system), row in zip(pairs, rows, strict=True):
            self._row(i)[:] = np.where(self._gains, self._row(i), row)
            self._systems[i] = system
            self._own_bases.discard(i)

    def assign_bases(self, ids: Index, bases: BaseModel) -> None:
        """Give simulations vehicles of their own; arms and laws stay.

        Args:
            ids: (k,) which.
            bases: M, D, K (k, 6, 6) and drag (k, 6).
        """
        if self.emulated:  # the engine knows a platform only
            return
        assert bases.drag is not None
        numbers = {f"drag{i + 1}": bases.drag[:, i] for i in range(6)}
        for name, part in (("M", bases.M), ("D", bases.D), ("K", bases.K)):
            for i, j in zip(*np.triu_indices(6), strict=True):
                numbers[f"{name}{i + 1}{j + 1}"] = part[:, i, j]
        places = [(self.rows.place(name, values), values) for name, values in numbers.items()]
        for at, values in places:
            if at is not None:
                self._set_parameter(at, ids, values)
        self._own_bases.update(ids.tolist())

    def assign_laws(self, ids: Index, rows: EffectRows) -> None:
        """See `Backend`."""
        for name, values in rows.laws().items():
            at = self.rows.place(name, values)
            if at is not None:
                self._set_parameter(at, ids, values)

    def faults(self) -> Mask:
        """See `Backend`."""
        return self._fault.copy()

    def get_state(self) -> dict[str, Array]:
        """See `Backend`."""
        return {name.strip("_"): getattr(self, name).copy() for name in self.state_names}

    def set_state(self, state: Mapping[str, Array]) -> None:
        """See `Backend`."""
        for name in self.state_names:
            getattr(self, name)[:] = state[name.strip("_")]
