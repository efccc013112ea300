"""Common part of the engines that run our own compiled equations: parameters, hidden states."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import ClassVar

import numpy as np

from ves_gym._util.params import Array, Index, Mask
from ves_gym.engine.batch_parameters import ParameterRows, bodies_of
from ves_gym.engine.kernel.compiled_function import CompiledFunction
from ves_gym.engine.kernel.maps import system_function
from ves_gym.mechanics.attitude import conjugate, rotate, to_matrix
from ves_gym.mechanics.contact import FLOATING, payload_coordinates, payload_of
from ves_gym.system.effect_rows import EffectRows
from ves_gym.system.system import System


def accounted(system: System) -> bool:
    """True where the engine keeps an account of energy: in space, by RK4, no loose payload."""
    loose = system.contact is not None and system.contact.on == "payload"
    return system.mode == "ideal" and system.integrator == "rk4" and not loose


class CompiledBackend(ABC):
    """Sizes of state, input and output, and the systems of the simulations.

    The state x stacks (Y, q), what is hidden (deflections of gears, oscillators of the
    vehicle) and the rates of both; see `trace.Equations`.
    """

    contact: EngineContact | None
    state_names: ClassVar[tuple[str, ...]]  # the arrays that a simulation's state lies in
    _start: Array  # (n,) s
    _ticks: Index  # (n,) physics steps since
    _fault: Mask

    def __init__(self, system: System, n: int) -> None:
        self.n, self.joints = n, system.arm.n
        self.emulated = system.mode == "emulated"
        self.dt = system.physics_dt
        self.rows = ParameterRows(system)
        self.names = self.rows.names
        # set by a controller or by who handles payloads, not by a system
        by_controllers = ("kp", "kd", "jet", "motor", "tide", "frame", "payload", "touching")
        self._gains = np.array([name.startswith(by_controllers) for name in self.names])
        self._systems = [system] * n
        size = 6 + self.joints
        self._extras = 0 if self.emulated else system.base.m
        self._carried = 0 if self.emulated else len(system.base.carried)
        self._gears = len(system.arm.geared) + system.arm.bends  # passive joints
        floats = system.contact is not None and system.contact.on == "payload"
        self.floating = FLOATING if floats else 0
        # coordinates: (Y, q), then what is hidden, a payload that is touched the last
        self._order = size + self._gears + self._carried + self._extras + self.floating
        # behind the rates: work of all forces, the kinetic energy at first included, of drives
        self.accounted = accounted(system)
        self._nx, self._nu = 2 * self._order + 2 * self.accounted, size
        self._kinetic = system_function("momentum", system) if self.accounted else None
        self._ny = size + self.joints + (6 if self.emulated else 0)
        self.contact = None if system.contact is None else EngineContact(self, system)

    @abstractmethod
    def _row(self, i: int) -> Array:
        """Parameters of a simulation, in place."""

    @abstractmethod
    def _parameters(self) -> Array:
        """(n, np) a copy."""

    @abstractmethod
    def _set_parameter(self, at: int, ids: Index, values: Array) -> None:
        """Set one parameter, by its place in `names`, of simulations (k,)."""

    @abstractmethod
    def _states(self) -> Array:
        """(n, nx) a copy."""

    @abstractmethod
    def _put(self, ids: Index, columns: slice, values: Array) -> None:
        """Write some columns of the states of simulations (k,)."""

    def _put_both(self, ids: Index, first: int, at: Array, rate: Array) -> None:
        """Write coordinates (k, c) from the first on, and their rates."""
        for start, values in ((first, at), (self._order + first, rate)):
            self._put(ids, slice(start, start + values.shape[1]), values)

    def read(self) -> tuple[Array, Array, Array]:
        x, size, order = self._states(), 6 + self.joints, self._order
        time = self._start + self._ticks * self.dt
        return time, x[:, :size], x[:, order : order + size]

    def internal_state(self) -> tuple[Array, Array]:
        x, first, order = self._states(), 6 + self.joints, self._order
        end = order - self.floating
        return x[:, first:end], x[:, order + first : order + end]

    def set_gear_state(self, d: Array, rate: Array) -> None:
        self._put_both(np.arange(self.n), 6 + self.joints, d, rate)

    def set_carried(self, ids: Index, at: Array, rate: Array) -> None:
        first = 6 + self.joints + self._gears
        self._jump(ids, lambda: self._put_both(ids, first, at, rate))

    def set_base(self, ids: Index, y: Array, yd: Array) -> None:
        self._put_both(ids, 0, y, yd)

    def set_rates(self, ids: Index, zd: Array, gears: Array) -> None:
        rates = np.hstack([zd, gears])
        columns = slice(self._order, self._order + rates.shape[1])
        self._jump(ids, lambda: self._put(ids, columns, rates))

    def energy_gap(self, ids: Index) -> Array:
        """Kinetic energy (k,) less what all forces have made of it, which integration that goes
        wrong leaves open, and the drives' work (k,), |torque times rate|, both [J].

        Args:
            ids: (k,) simulations of an engine that is `accounted`.
        """
        x = self._states()[ids]
        return np.stack([self._energy(x[:, :-2], ids) - x[:, -2], x[:, -1]])

    def _energy(self, x: Array, ids: Index) -> Array:
        """Kinetic energy (k,) in states (k, 2 order) of simulations (k,) [J]."""
        size, order = 6 + self.joints, self._order
        if self._kinetic is None or not x[:, order:].any():
            return np.zeros(len(x))
        at, rate = x[:, :order], x[:, order:]
        modes = rate[:, order - self._extras :]
        parts = at[:, :size], rate[:, :size], at[:, size:], rate[:, size:]
        p = np.stack([self._row(i) for i in ids.tolist()])
        out: Array = self._kinetic(*parts, p)[:, 6] + 0.5 * np.sum(modes**2, axis=1)
        return out

    def _jump(self, ids: Index, change: Callable[[], None]) -> None:
        """Make a change that is no motion: the account stays as open as it was."""
        gap = self.energy_gap(ids)[0] if self.accounted else np.zeros(len(ids))
        change()
        if self.accounted:
            x = self._states()[ids]
            work = self._energy(x[:, :-2], ids) - gap
            self._put(ids, slice(self._nx - 2, self._nx - 1), work[:, None])

    def _accelerations(self, observed: Array) -> tuple[Array, Array]:
        """Drive torque and zdd (`Backend.evaluate`) from what is observed (n, ny)."""
        size = 6 + self.joints
        return observed[:, size : size + self.joints], observed[:, :size]

    def states_of(self, ids: Index, z: Array, zd: Array) -> Array:
        """(k, nx) states: gears relaxed, oscillators at rest on the vehicle, account closed.

        Args:
            ids: (k,) which simulations.
            z, zd: (k, 6 + joints) coordinates and rates.
        """
        parts = []
        first = self._gears + self._carried
        modes = slice(first, first + self._extras)
        for part in (z, zd):
            hidden = np.zeros((len(ids), self._order - 6 - self.joints))
            if self._extras:
                systems = [self._systems[i] for i in ids.tolist()]
                if all(system is systems[0] for system in systems):
                    hidden[:, modes] = systems[0].base.attached(part[:, :6])
                else:
                    attached = zip(systems, part[:, :6], strict=True)
                    hidden[:, modes] = [k.base.attached(y) for k, y in attached]
            parts += [part, hidden]
        x = np.hstack(parts)
        if not self.accounted:
            return x
        return np.hstack([x, self._energy(x, ids)[:, None], np.zeros((len(x), 1))])

    def set_gains(self, ids: Index, kp: Array, kd: Array) -> None:
        for name, values in (("kp", kp), ("kd", kd)):
            for i in range(self.joints):
                self._set_parameter(self.names.index(f"{name}{i + 1}"), ids, values[:, i])

    def set_last_link(self, ids: Index, mass: Array, com: Array, inertia: Array) -> None:
        link = f"link{self.joints}"
        self._jump(ids, lambda: self.set_mass(link, ids, mass, com, inertia))

    def set_mass(self, body: str, ids: Index, mass: Array, com: Array, inertia: Array) -> None:
        """Change mass properties (k,), (k, 3), (k, 3, 3) of a body by its name in p."""
        numbers = {f"{body}.mass": mass}
        numbers |= {f"{body}.com{k + 1}": com[:, k] for k in range(3)}
        for i, j in zip(*np.triu_indices(3), strict=True):
            numbers[f"{body}.I{i + 1}{j + 1}"] = inertia[:, i, j]
        for name, values in numbers.items():
            self._set_parameter(self.names.index(name), ids, values)

    def set_actuators(self, ids: Index, wrench: Array | None, torque: Array | None) -> None:
        for name, values in (("jet{}", wrench), ("motorcarried{}", torque)):
            for i in range(0 if values is None else values.shape[1]):
                at = self.names.index(name.format(i + 1))
                self._set_parameter(at, ids, values[:, i])  # type: ignore[index]

    def set_tide(self, ids: Index, up: Array, place: Array) -> None:
        """Set the gravity gradient of simulations (k,), see `orbit.Tide`.

        Args:
            ids: which.
            up, place: (k, 3) in the engine's axes.
        """
        for name, values in (("up", up), ("place", place)):
            first = self.names.index(f"tide.{name}1")
            for i in range(3):
                self._set_parameter(first + i, ids, values[:, i])

    def assign(self, ids: Index, systems: Sequence[System]) -> None:
        pairs = list(zip(ids.tolist(), systems, strict=True))
        rows_of: dict[tuple[int, int], Array] = {}  # rows of the arms and vehicles seen
        rows = []
        for i, system in pairs:
            which, bodies = f"system of simulation {i}", bodies_of(system)
            if bodies not in rows_of:
                same = bodies == bodies_of(self._systems[i])
                rows_of[bodies] = self._row(i) if same else self.rows.of(system, which)
            rows.append(self.rows.with_effects(rows_of[bodies], system, which))
        for (i, system), row in zip(pairs, rows, strict=True):
            self._row(i)[:] = np.where(self._gains, self._row(i), row)
            self._systems[i] = system

    def assign_laws(self, ids: Index, rows: EffectRows) -> None:
        for name, values in rows.laws().items():
            at = self.rows.place(name, values)
            if at is not None:
                self._set_parameter(at, ids, values)

    def faults(self) -> Mask:
        return self._fault.copy()

    def get_state(self) -> dict[str, Array]:
        return {name.strip("_"): getattr(self, name).copy() for name in self.state_names}

    def set_state(self, state: Mapping[str, Array]) -> None:
        for name in self.state_names:
            getattr(self, name)[:] = state[name.strip("_")]


class EngineContact:
    """Contact of the tool in n simulations. Poses in the engine's frame of space.

    Args:
        engine: that integrates it.
        system: with the contact.
    """

    def __init__(self, engine: CompiledBackend, system: System) -> None:
        assert system.contact is not None
        self._engine, self._on = engine, system.contact.on
        self.function: CompiledFunction = system_function("contact", system)

    def bodies(self, com: Array) -> Array:
        """Free payloads (n, `latch.BODY`), with centres of mass (n, 3) in own axes."""
        x, engine = self._engine._states(), self._engine
        order, k = engine._order, engine.floating
        return payload_of(x[:, order - k : order], x[:, 2 * order - k : 2 * order], com)

    def put(self, ids: Index, bodies: Array, com: Array) -> None:
        """Put free payloads there.

        Args:
            ids: (k,) which.
            bodies: (k, `latch.BODY`).
            com: (k, 3) centres of mass in own axes [m].
        """
        engine = self._engine
        first = engine._order - engine.floating
        engine._put_both(ids, first, *payload_coordinates(bodies, com))

    def set_frame(self, ids: Index, place: Array, turn: Array) -> None:
        """Put shapes that are fixed in space where the engine's frame, at `place` (k, 3) [m]
        and `turn` (k, 4), has them."""
        if self._on == "space":
            back = conjugate(turn)
            self._set("frame.place", ids, rotate(back, -place))
            self._set("frame.turn", ids, to_matrix(back).reshape(-1, 9))

    def set_body(self, ids: Index, mass: Array, com: Array, inertia: Array) -> None:
        """Change mass properties (k,), (k, 3), (k, 3, 3) of free payloads, in own axes."""
        self._engine.set_mass("payload", ids, mass, com, inertia)

    def set_touching(self, ids: Index, touching: Mask) -> None:
        """Let the shapes of simulations (k,) touch, or pass through each other."""
        self._set("touching", ids, touching[:, None].astype(float))

    def _set(self, name: str, ids: Index, values: Array) -> None:
        first = self._engine.names.index(f"{name}1")
        for i, column in enumerate(values.T):
            self._engine._set_parameter(first + i, ids, column)

    def measured(self) -> tuple[Array, Array]:
        """Wrench on the tool (n, 6), engine's axes, at the tool, and energy stored (n,) [J]."""
        engine = self._engine
        out = self.function(engine._states()[:, : 2 * engine._order], engine._parameters())
        return out[:, :6], out[:, 6]
