"""The line between joint controller and drives: late commands, old and lagging measurements,
and a friction of the drives that depends on how they have moved.

Everything here is per simulation (leading axis n) and in physics steps: between two steps
command, angles and rates are linear.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from ves_gym._util.params import Array, Index
from ves_gym.simulation.machines import Machines, Part
from ves_gym.simulation.state import State
from ves_gym.system.deviations import Delays, advanced, fresh, friction
from ves_gym.system.effect import DelayEffect
from ves_gym.system.system import System

_WHOLE = 1e-9  # of a physics step: a delay as near as that to whole steps is whole


class JointDelays(Part):
    """n lines at work, in place of the engine's own steps and evaluation.

    Args:
        machines: whose drives and controllers they join.
    """

    name = "joint_delays"
    arrays = ("fresh", "command_history", "measurement_history", "bristle", "age")
    periodic = False

    def __init__(self, machines: Machines) -> None:
        system, n = machines.system, machines.n
        self.machines, self.backend = machines, machines.backend
        self.dt, self.joints, self.n = system.physics_dt, system.arm.n, n
        self.delays = system.delays(n)
        self.fresh = np.ones(n, bool)  # no command since the reset
        # commands at both ends of past steps
        self.command_history = np.zeros((n, 0, 2, self.joints))
        # angles, rates as seen through the low-pass, and rates, at past nodes
        self.measurement_history = np.zeros((n, 0, 3, self.joints))
        self.bristle, self.age = fresh((n, self.joints))
        self._fit()
        machines.measured_of = self.measured

    def _whole_and_part(self, delay: Array) -> tuple[Index, Array]:
        """Whole physics steps of a delay, and the part of one that is left."""
        steps = delay / self.dt
        near = np.round(steps)
        steps = np.where(np.abs(steps - near) < _WHOLE, near, steps)
        steps_back = np.floor(steps).astype(np.intp)
        return steps_back, steps - steps_back

    @property
    def rubs(self) -> bool:
        """True if a friction remembers how joints have moved."""
        return bool(self.delays.friction.any())

    @property
    def commands_late(self) -> bool:
        """True if a command arrives late in any simulation."""
        return bool(self.delays.command.any())

    @property
    def measurements_late(self) -> bool:
        """True if a measurement is old in any simulation, or a rate behind."""
        return bool(self.delays.measurement.any() or self.delays.lag.any())

    def _fit(self) -> None:
        """As much memory as the longest delays need; what is older was as the oldest known."""
        for name, delay, used in (
            ("command_history", self.delays.command, self.commands_late),
            ("measurement_history", self.delays.measurement, self.measurements_late),
        ):
            history: Array = getattr(self, name)
            need = int(self._whole_and_part(delay)[0].max()) + 2 if used else 0
            missing = need - history.shape[1]
            if missing > 0:
                shape = (self.n, missing, *history.shape[2:])
                older = (
                    np.broadcast_to(history[:, :1], shape) if history.size else np.zeros(shape)
                )
                setattr(self, name, np.concatenate([older, history], axis=1))

    def prepare(
        self, machines: Machines, ids: Index, systems: Sequence[System]
    ) -> Callable[[], None]:
        return lambda: self._assign(ids, [system.delays() for system in systems])

    def _assign(self, ids: Index, delays: Sequence[Delays]) -> None:
        """Give simulations delays of their own, (1, ...) for each of ids."""
        for k, part in enumerate(delays):
            self.delays.put(ids[k : k + 1], part)
        first = not self.command_history.shape[1], not self.measurement_history.shape[1]
        self._fit()
        if first[0]:
            self.fresh[:] = True
        if first[1]:
            q, v = self.machines.state[3:]
            self.measurement_history[:] = np.stack([q, v, v], axis=1)[:, None]

    def reset(self, machines: Machines, ids: Index, start: State) -> None:
        """See `Part`. The past is constant; the first command stands for those before it."""
        q, v = start.q, start.v
        self.fresh[ids] = True
        self.measurement_history[ids] = np.stack([q, v, v], axis=1)[:, None]
        self.bristle[ids], self.age[ids] = fresh(q.shape)

    # ---------------------------------------------------------------- commands

    def arriving(self, nodes: Array) -> Array:
        """Return the commands at the drives over k steps while (n, k + 1, joints) is sent."""
        new = np.stack([nodes[:, :-1], nodes[:, 1:]], axis=2)
        self._begin(nodes[:, 0])
        history = np.concatenate([self.command_history, new], axis=1)
        k, stored = new.shape[1], self.command_history.shape[1]
        out = np.stack([self._at(history, stored + j, j > 0) for j in range(k + 1)], axis=1)
        self.command_history = history[:, k:]
        return np.where(self.delays.command[:, None, None] > 0, out, nodes)

    def arrived(self, command: Array) -> Array:
        """(n, joints) what is at the drives now, where `command` is being sent."""
        if not self.commands_late:
            return command
        history = np.where(
            self.fresh[:, None, None, None], command[:, None, None], self.command_history
        )
        arrived = self._at(history, history.shape[1], True)
        return np.where(self.delays.command[:, None] > 0, arrived, command)

    def _begin(self, first: Array) -> None:
        if self.fresh.any():
            self.command_history[self.fresh] = first[self.fresh][:, None, None]
            self.fresh[:] = False

    def _at(self, segments: Array, node: int, before: bool) -> Array:
        """Command sent one delay before a node; `before` a jump at that instant, or after."""
        steps_back, part = self._whole_and_part(self.delays.command)
        back = steps_back + (before | (part > 0))
        ends = segments[np.arange(self.n), np.clip(node - back, 0, segments.shape[1] - 1)]
        share = np.where(back > steps_back, 1 - part, 0.0)[:, None]
        return np.asarray((1 - share) * ends[:, 0] + share * ends[:, 1], dtype=np.float64)

    # ------------------------------------------------------------ measurements

    def measured(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Return angles and rates as measured.

        Args:
            q, v: (n, joints) true angles [rad] and rates [rad/s].
        """
        if not self.measurements_late:
            return q, v
        return self._measured(
            np.concatenate([self.measurement_history, self._node(q, v)], axis=1)
        )

    def _node(self, q: Array, v: Array) -> Array:
        """(n, 1, 3, joints) a step after the last node remembered."""
        return self._after(self.measurement_history[:, -1], q, v)[:, None]

    def _after(self, before: Array, q: Array, v: Array) -> Array:
        """The node (n, 3, joints) one step after another; exact for rates linear between."""
        lag = self.delays.lag
        if not lag.any():
            return np.stack([q, v, v], axis=1)
        x = self.dt / np.where(lag > 0, lag, 1.0)
        share = -np.expm1(-x) / x  # mean weight of the step's start in what the filter forgets
        follows = before[:, 1] * np.exp(-x) + before[:, 2] * (share - np.exp(-x))
        filtered = np.where(lag > 0, follows + v * (1 - share), v)
        return np.stack([q, filtered, v], axis=1)

    def _measured(self, nodes: Array) -> tuple[Array, Array]:
        """One delay before the last of nodes (n, m, 3, joints)."""
        steps_back, part = self._whole_and_part(self.delays.measurement)
        rows, at = np.arange(self.n), nodes.shape[1] - 1 - steps_back
        share = part[:, None, None]
        out = (1 - share) * nodes[rows, at] + share * nodes[rows, np.maximum(at - 1, 0)]
        return out[:, 0], out[:, 1]

    def _correction(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Return the torque that delayed measurements add at both ends of the next step.

        The engine's servo knows angle and rate themselves: kp (q - q_old) + kd (v - v_old)
        makes it one that does not. The end of the step is foreseen with the present
        acceleration, which costs an error of second order in the step.
        """
        kp, kd = self.machines.kp, self.machines.kd
        rate = 2 * v - self.measurement_history[:, -1, 2]
        further = q + self.dt / 2 * (v + rate)
        present = self._node(q, v)
        ahead = self._after(present[:, 0], further, rate)[:, None]
        nodes = np.concatenate([self.measurement_history, present], axis=1)
        extended = np.concatenate([nodes, ahead], axis=1)
        out = []
        for (q_there, v_there), filtered in (
            ((q, v), self._measured(nodes)),
            ((further, rate), self._measured(extended)),
        ):
            out.append(kp * (q_there - filtered[0]) + kd * (v_there - filtered[1]))
        return out[0], out[1]

    # ---------------------------------------------------------------- stepping

    def step_sequence(self, nodes: Array, ids: Index | None) -> None:
        """Do what `Backend.step_sequence` does, with commands that reach the drives late."""
        if self.commands_late:
            nodes = self.arriving(nodes)
        if not self._stepwise:
            self.backend.step_sequence(nodes, ids)
            return
        for j in range(nodes.shape[1] - 1):
            self.backend.step_sequence(self._sees(nodes[:, j : j + 2]), ids)

    def step_on_platform(self, nodes: Array, base: Array, ids: Index | None) -> Array:
        """Do what `Backend.step_on_platform` does, with commands that reach the drives late."""
        if self.commands_late:
            nodes = self.arriving(nodes)
        if not self._stepwise:
            return self.backend.step_on_platform(nodes, base, ids)
        out = []
        for j in range(nodes.shape[1] - 1):
            ends = self._sees(nodes[:, j : j + 2])
            wrench = self.backend.step_on_platform(ends, base[:, j : j + 2], ids)
            out.append(wrench[:, :1])
        return np.concatenate([*out, wrench[:, 1:]], axis=1)

    def evaluate(self, command: Array) -> tuple[Array, Array]:
        """Do what `Backend.evaluate` does, of what has arrived; without friction's torque."""
        command = self.arrived(command)
        if self.measurements_late:
            command = command + self._correction(*self.machines.state[3:])[0]
        friction = self.friction if self.rubs else 0.0
        torque, acceleration = self.backend.evaluate(command + friction)
        return torque - friction, acceleration

    @property
    def _stepwise(self) -> bool:
        """A servo that sees old joints, or friction that remembers, acts at every step."""
        return self.measurements_late or self.rubs

    def _sees(self, ends: Array) -> Array:
        """Commands (n, 2, joints) at both ends of the next physics step, by a servo that sees
        old joints, and the friction of drives that remember."""
        _, z, zd = self.backend.read()
        q, v = z[:, 6:], zd[:, 6:]
        if self.measurements_late:
            ends = ends + np.stack(self._correction(q, v), axis=1)
            self.measurement_history = np.concatenate(
                [self.measurement_history[:, 1:], self._node(q, v)], axis=1
            )
        if self.rubs:
            self.bristle, self.age = advanced(self.bristle, self.age, v, self.dt)
            ends = ends + self.friction[:, None]
        return ends

    @property
    def friction(self) -> Array:
        """(n, joints) torque of contacts that remember, as they are now [N m]."""
        return friction(self.delays.friction, self.bristle, self.age)

    def set_state(self, state: Mapping[str, Array]) -> None:
        """See `Part`. Memory is as long as the longest delays need."""
        for name in self.arrays:
            setattr(self, name, state[name].copy())


def joint_delays_of(machines: Machines) -> JointDelays | None:
    """Return the delays of a system at work, or None where no effect is on them."""
    delayed = any(isinstance(e, DelayEffect) for e in machines.system.effects)
    return JointDelays(machines) if delayed else None
