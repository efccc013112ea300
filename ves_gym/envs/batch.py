"""n episodes of one task in lockstep: the one code path under every environment."""

from __future__ import annotations

import copy
import dataclasses
import math
import os
import warnings
from collections.abc import Mapping
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import Array, Index, Mask, ParameterError, content_hash
from ves_gym.engine.backends.compiled import CompiledBackend
from ves_gym.engine.backends.kernel import KernelBackend
from ves_gym.engine.kernel.maps import scene_function, torque_function
from ves_gym.engine.kernel.numbers import parameters
from ves_gym.envs.compiled import Shape, carry_rows, plain_command
from ves_gym.envs.compiled_step import CompiledStep, release_still
from ves_gym.envs.control import Gains
from ves_gym.envs.episode import (
    AT_ONCE,
    Beginnings,
    Episodes,
    bounded,
    count,
    ended_energies,
    endings,
    goal_width,
    judge,
    require_answers,
    scaled_observation,
)
from ves_gym.envs.privileged import Privileged
from ves_gym.envs.randomize import Draws
from ves_gym.envs.recording import Recorder
from ves_gym.envs.tail import FreeDecay
from ves_gym.envs.task import Scene, Start, Task
from ves_gym.mechanics.latch import TARGET
from ves_gym.mechanics.linear_range import linear_range
from ves_gym.mechanics.servo import own_gains
from ves_gym.simulation.energy_account import TRUSTED
from ves_gym.simulation.loop_linearisation import EmulationWarning
from ves_gym.simulation.simulator import Simulator

# of what the drives move to and fro: noise as actions makes servos answer within a few steps,
# whose energy is 5 % off while that of the base is right to 1e-5 (PoseReach)
_SHARE = 0.05
_STILL = 1e-12  # J: nothing has moved
_MANY = 8  # simulations from which on beginnings are rehearsed together


class ActionError(ValueError):
    """An action that is no array of finite numbers of the right shape."""


def checked(action: Any, shape: tuple[int, ...]) -> Array:
    """An action, or those of a batch, as float64; an `ActionError` says what is wrong."""
    expected = f"an action must be finite numbers of shape {shape}, got"
    try:
        numbers = np.asarray(action)
    except ValueError:
        raise ActionError(f"{expected} ragged rows") from None
    if numbers.dtype.kind not in "fiu":
        raise ActionError(f"{expected} {action!r}")
    if numbers.shape != shape:
        raise ActionError(f"{expected} {numbers.shape}")
    out = numbers.astype(np.float64)
    if not math.isfinite(np.vdot(out, out)) and not np.isfinite(out).all():
        where = np.argwhere(~np.isfinite(out))[0].tolist()
        raise ActionError(f"{expected} {out[tuple(where)]} at {where}")
    return out


class _Rewired(Exception):
    """The drawn systems need blocks or memory that the emulation loops do not have yet."""


def _code_of(sim: Simulator) -> object:
    """Changes, by identity, when the emulation loop has been wired anew."""
    loop = sim.emulation_loop
    return None if loop is None or loop.code is None else loop.code.version


class Batch:
    """n episodes of a task.

    Args:
        task: what the episodes ask.
        n: how many.
        backend, threads: of the `Simulator`.
        dump: folder for run logs of the episodes that diverge; None: nothing is recorded.
        compiled: step in compiled code where task, control and engine allow it; False: in
            NumPy, the readable reference, which gives the same numbers to rounding.
    """

    def __init__(
        self,
        task: Task,
        n: int,
        *,
        backend: str = "auto",
        threads: int = 0,
        dump: str | os.PathLike[str] | None = None,
        compiled: bool = True,
    ) -> None:
        self.task, self.n = task, n
        self._compiled: CompiledStep | None = None
        self._draws = Draws(task.system, task.randomize)
        self.system = self._draws.system
        control, arm = task.control, self.system.arm
        motor = self.system.drive == "motor"
        self.sim = Simulator(
            self.system,
            n,
            servo=control.servo_for(task.system) if motor else None,
            backend=backend,
            threads=threads,
            on_divergence="mark",
            warn_at=None,
        )
        if isinstance(control, Gains):
            self.sim.require_stable(control.kp[1], control.kd[1])
        if task.randomize and self.system.mode == "emulated":
            from ves_gym.envs.laboratories import warn_of_unstable_corners

            warn_of_unstable_corners(
                task.system, task.randomize, control.servo_for(task.system) if motor else None
            )
        space = self.system.ideal()
        self._space = space  # effects have no part in it
        self._scene_of, self._torque_of = scene_function(space), torque_function(space)
        self._numbers = parameters(space)[1]
        self._emulated = self.system.mode == "emulated"
        self._feedforward = motor and control.servo.feedforward
        self._per_range = 1 / linear_range(self.system.vehicle)
        self.dt = self.system.control_dt
        self.width = task.action_width
        self._joint_width = control.width(arm)
        if task.base_control is not None and self.sim.base_actuators is None:
            raise ParameterError(
                f"base_control needs backend kernel or mujoco, got {self.sim.backend_name}"
            )
        goals = goal_width(task)
        self.scale = np.concatenate([f.scale for f in task.fields()])
        self.observations = sum(f.size for f in task.parts())
        self._observation: npt.NDArray[np.float32] | None = None  # as of the last compiled step
        joints = arm.n
        table_values = task.lookup(np.zeros((1, goals)), np.zeros(1, np.intp)).shape[1]
        follows = motor and control.level != "torque"
        vehicle = task.system.vehicle
        hold = control.servo_for(task.system) if follows else own_gains(arm, vehicle)
        self._hold_gains = np.asarray(hold.kp, float), np.asarray(hold.kd, float)
        self._sizes = {
            "q": joints, "v": joints, "y": 6, "yd": 6, "y_seen": 6, "yd_seen": 6, "tool": 3,
            "tool_seen": 3, "energies": 2, "goal": goals, "memory": task.memory,
            "table_values": table_values, "tau": joints,
            "payload": TARGET if task.interacts else 0,
            "contact": 7 if self.sim.contact is not None else 0,
            "wheels": self.sim.machines.wheels,
        }  # fmt: skip
        require_answers(task, self._blank(2)[0], self.dt)
        self.scene, self.episodes = self._blank(n)
        self.privileged = Privileged(self)
        self.drawn: dict[str, Array] = {r.label: np.zeros((n, r.size)) for r in task.randomize}

        if compiled and CompiledStep.possible(self.sim, task):
            self._compiled = CompiledStep(self.sim, task, self._scene)
        # whether all that a beginning needs can be written where it belongs
        alike = not (self._emulated or task.randomize or task.interacts or task.base_control)
        alike = alike and self.sim.contact is None
        self._direct = self._compiled is not None and (alike or n >= _MANY)
        rows = self._first_rows if alike else self._rehearsed_rows
        complete = rows if self._direct else self._first_states
        self._beginnings = Beginnings(task, n, self._draws.size, complete)
        self.recorder = None if dump is None else Recorder(self, dump)

    def _blank(self, n: int) -> tuple[Scene, Episodes]:
        """Scene and episodes of n simulations, zeros but for the gains that hold joints."""
        scene = Scene(
            time=np.zeros(n), tail=np.zeros(n), propellant=np.zeros(n),
            ref=np.zeros((n, 3, self.system.arm.n)),
            kp=np.tile(self._hold_gains[0], (n, 1)), kd=np.tile(self._hold_gains[1], (n, 1)),
            **{name: np.zeros((n, size)) for name, size in self._sizes.items()},
        )  # fmt: skip
        episodes = Episodes(
            np.zeros(n, np.uint64), np.arange(n), np.full(n, -1),
            np.zeros(n, np.int64), np.zeros(n, np.int64), np.zeros(n, bool),
            np.zeros(n), np.zeros(n), *(np.zeros((n, 2)) for _ in range(3)),
        )  # fmt: skip
        return scene, episodes

    @property
    def shape(self) -> Shape | None:
        """Rows of the compiled steps; None where they stay in NumPy."""
        return None if self._compiled is None else self._compiled.shape

    @property
    def compiled(self) -> bool:
        """Steps run in compiled code."""
        return self._compiled is not None

    @property
    def scene(self) -> Scene:
        """Every simulation at this instant."""
        if self._compiled is not None and self._compiled.ahead:
            self._compiled.store(self._scene, self._episodes)
        return self._scene

    @scene.setter
    def scene(self, scene: Scene) -> None:
        self._scene = scene

    @property
    def episodes(self) -> Episodes:
        """Counters and sums of the episodes."""
        if self._compiled is not None and self._compiled.ahead:
            self._compiled.store(self._scene, self._episodes)
        return self._episodes

    @episodes.setter
    def episodes(self, episodes: Episodes) -> None:
        self._episodes = episodes

    @property
    def goals(self) -> Array:
        """(n, g) goals of the episodes, which no step changes."""
        return self._scene.goal

    # ------------------------------------------------------------------ reset

    def seed(self, ids: Index, roots: npt.ArrayLike, index: npt.ArrayLike) -> None:
        """Restart the sequences of episodes of some simulations."""
        e = self.episodes
        e.root[ids], e.index[ids], e.number[ids] = roots, index, -1
        self._beginnings.forget(ids)

    def reset(self, ids: Index, options: Mapping[str, Array] | None = None) -> None:
        """Begin the next episode in some simulations; `options` as in `Task.start`."""
        if not len(ids):
            return
        e, sim = self._episodes, self.sim
        try:
            rows = self._beginnings.take(ids, e, options)
        except _Rewired:  # from here on each begins in its own place
            self._direct, _ = False, self.scene
            sizes = self.n, self._draws.size
            self._beginnings = Beginnings(self.task, *sizes, self._first_states)
            rows = self._beginnings.take(ids, e, options)
        e.number[ids] += 1
        for i in ids.tolist():
            sim.generators[i] = self._beginnings.generators[i]
        self._scene.goal[ids] = rows["goal"]
        if self._direct:
            assert self._compiled is not None
            self._compiled.begin(ids, rows)
            if self._observation is None:
                shape = self.n, rows["observation"].shape[1]
                self._observation = np.zeros(shape, np.float32)
            self._observation[ids] = rows["observation"]
            for label, values in self.drawn.items():
                values[ids] = rows[f"drawn.{label}"]
        else:
            self._begin(ids, rows, self._beginnings.uniform[ids])
        if self.recorder is not None:
            self.recorder.begin(ids)

    def _begin(self, ids: Index, rows: dict[str, Array], uniform: Array) -> None:
        """Put simulations (k,) where episodes begin, and observe them there.

        Args:
            ids: which.
            rows: `_first_states` of theirs.
            uniform: (k, ...) what their beginnings are drawn from.
        """
        e, s, task, sim = self.episodes, self.scene, self.task, self.sim
        if task.randomize:
            self._randomise(ids, uniform[:, task.draws :])
        sim.reset(q=rows["q"], v=rows["v"], y=rows["y"], yd=rows["yd"], ids=ids)
        s.ref[ids] = np.stack([rows["q"], rows["v"], np.zeros_like(rows["q"])], axis=1)
        s.memory[ids], s.tail[ids] = 0.0, 0.0
        s.kp[ids], s.kd[ids] = self._hold_gains
        for k in (e.steps, e.clipped, e.once, e.total, e.cost, e.missing, e.sums):
            k[ids] = 0
        if task.interacts:
            assert sim.payload is not None
            sim.payload.change(ids, **task.payload(rows["goal"]))
        self._update_scene(ids)
        self._grasp(np.isin(np.arange(self.n), ids))
        chosen = s.rows(ids)
        s.tau[ids] = chosen.tau = self._command(chosen)
        e.peaks[ids] = chosen.energies
        if self._compiled is not None:
            self._compiled.load(ids, chosen, e.rows(ids))
        if self._observation is not None:
            self._observation[ids] = scaled_observation(task, chosen, self.scale)

    def _grasp(self, among: Mask) -> None:
        """Close latches of some simulations (n,), where the task has it."""
        if not self.task.interacts:
            return
        ids = np.flatnonzero(among & self.task.closes(self.scene))
        if len(ids):
            self.sim.grasp(ids)
            self._update_scene()

    def _first_states(self, begin: Start, ids: Index) -> dict[str, Array]:
        """States (k, ...) of joints and base, and the goal."""
        k, joints = len(begin.goal), self.system.arm.n
        sizes = {"q": joints, "v": joints, "y": 6, "yd": 6}
        rows = {n: np.broadcast_to(getattr(begin, n), (k, w)) for n, w in sizes.items()}
        return rows | {"goal": begin.goal}

    @cached_property
    def _rehearsal(self) -> tuple[Batch, object]:
        """Simulations in which beginnings are tried, and the code of their loop."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", EmulationWarning)  # issued for these already
            spare = Batch(self.task, min(self.n, AT_ONCE), threads=1, compiled=False)
        return spare, _code_of(spare.sim)

    def _rehearsed_rows(self, begin: Start, ids: Index) -> dict[str, Array]:
        """All that compiled steps go on from, of simulations with more than their engine.

        They begin in spare ones, many together: where lanes end one after another, a
        beginning would cost as much as twenty.
        """
        assert self._compiled is not None
        spare, code = self._rehearsal
        states, uniform, out = self._first_states(begin, ids), self._beginnings.uniform[ids], []
        for first in range(0, len(ids), spare.n):
            part = slice(first, first + spare.n)
            those = np.arange(len(ids[part]))
            for k, i in zip(those.tolist(), ids[part].tolist(), strict=True):
                spare.sim.generators[k] = self._beginnings.generators[i]
            mine = {name: values[part] for name, values in states.items()}
            spare._scene.goal[those] = mine["goal"]
            spare._begin(those, mine, uniform[part])
            if _code_of(spare.sim) is not code:
                raise _Rewired
            drawn = {f"drawn.{label}": values[those] for label, values in spare.drawn.items()}
            s, e = spare._scene.rows(those), spare._episodes.rows(those)
            out.append(self._rows_at(s, e) | drawn | spare.sim.rows_of(those))
        return {name: np.concatenate([rows[name] for rows in out]) for name in out[0]}

    def _first_rows(self, begin: Start, ids: Index) -> dict[str, Array]:
        """All that compiled steps go on from, where no simulation differs from the others."""
        rows, backend = self._first_states(begin, ids), self.sim.backend
        assert self._compiled is not None
        assert isinstance(backend, KernelBackend)
        q, v, y, yd, goal = rows.values()
        k = len(goal)
        pose, rate = np.hstack([y, q]), np.hstack([yd, v])
        x = backend.states_of(np.zeros(k, np.intp), pose, rate)
        modes = self._compiled.modes
        hidden = None if modes is None else (x[:, modes[0]], x[:, modes[1]])
        energies, tool, _ = self._measures(pose, rate, y, hidden)
        s, e = self._blank(k)
        s.q, s.v, s.y, s.yd, s.y_seen, s.yd_seen, s.goal = q, v, y, yd, y, yd, goal
        s.tool, s.tool_seen, s.energies, e.peaks = tool, tool, energies, energies
        s.ref = np.stack([q, v, np.zeros_like(q)], axis=1)
        s.table_values = self.task.lookup(goal, np.zeros(k, np.intp))
        s.tau = self._command(s)
        return self._rows_at(s, e) | {"engine.x": x}

    def _rows_at(self, s: Scene, e: Episodes) -> dict[str, Array]:
        """Rows (k, ...) of compiled steps at scene and episodes of k simulations."""
        assert self._compiled is not None
        names = self._compiled.shape.scene
        return {
            "carry": carry_rows(self._compiled.shape, s, e),
            "scene": np.hstack([np.reshape(getattr(s, k), (len(s.q), -1)) for k in names]),
            "seen": np.hstack([s.y_seen, s.yd_seen]),
            "goal": s.goal,
            "table_values": s.table_values,
            "observation": scaled_observation(self.task, s, self.scale).astype(np.float32),
        }

    def episode_ids(self) -> npt.NDArray[np.uint64]:
        """Return (n, 3) seed, index and number that the episodes' random numbers come from."""
        e = self.episodes
        return np.column_stack([e.root, e.index.astype(np.uint64), e.number.astype(np.uint64)])

    def randomized(self) -> dict[str, Any]:
        """Return the parameters (n, size) drawn for the episodes, as entries of an info."""
        return {f"randomized/{label}": value.copy() for label, value in self.drawn.items()}

    def _randomise(self, ids: Index, u: Array) -> None:
        rows = self._draws.rows(u)
        self.sim.assign_effects(rows, ids)
        for label, values in zip(self.drawn, rows.values.values(), strict=True):
            self.drawn[label][ids] = values.reshape(len(ids), -1)

    # ------------------------------------------------------------------- step

    def check(self, actions: Any) -> Array:
        """Actions as float64 (n, width); an `ActionError` says what is wrong with them."""
        return checked(actions, (self.n, self.width))

    def step(
        self, actions: Array, over: Mask | None = None
    ) -> tuple[Array, Mask, Mask, dict[str, Any]]:
        """One control period with checked actions.

        Args:
            over: (n,) simulations that wait for their next episode; they are not reported.

        Returns:
            reward (n,), terminated (n,), truncated (n,), and what is known of the step.
        """
        if self._compiled is not None and not self._compiled.fits:
            _ = self.scene  # brought up to date: from here on in NumPy
            self._compiled = self._observation = None
        if self._compiled is not None:
            out = self._compiled.step(actions, over, self.goals, lambda: self.free_decay)
            self._observation = self._compiled.observation
            out[3].update(self.task.step_info(self.sim, out[1] | out[2]))
            out[3].update(self.account(self._compiled.stopped, over))
            out[3].update(self._energy_account(out[3]))
            return out
        e, s, task = self.episodes, self.scene, self.task
        actions = bounded(e, actions)
        before = s.energies
        remaining = np.subtract(task.duration, e.steps * self.dt, dtype=np.float64)
        if task.base_control is not None:
            task.base_control.drive(self.sim, actions[:, self._joint_width :])
        joints = actions[:, : self._joint_width]
        task.control.drive(self.sim, s, joints, remaining, self._command)
        self._update_scene()
        diverged = self.sim.diverged
        waiting = np.zeros(self.n, bool) if over is None else over
        lost, stopped = diverged, None
        if self._emulated:  # after a safety stop the platform stands still for good
            stopped = self.measured()[2]
            lost = lost | stopped
        free = ~(lost | waiting)
        self._grasp(free)
        count(task, s, e, before, self.dt)
        if task.interacts and (opens := task.opens(s) & free).any():
            release_still(self.sim, np.flatnonzero(opens))
        last, failed = endings(task, s, e, lost, waiting)
        ended = last | failed
        info: dict[str, Any] = {}
        if ended.any():
            s.tail = np.zeros(self.n)
            strain = np.zeros(self.n)
            if task.tail:
                ids = np.flatnonzero(ended & ~diverged)
                ref = s.ref[ids, 0]
                s.tail[ids], strain[ids] = self.tail(ids, ref, s.kp[ids], s.kd[ids])
            length = e.steps * self.dt + task.tail
            peak, strain_peak = e.peaks.T.copy()
            mean, sway = (e.sums[:, 0] + s.tail) / length, e.sums[:, 1] + strain
            info |= ended_energies(mean, s.energy.copy(), peak, strain_peak, sway, ended)
        terms, reward, solved = judge(task, s, e, self.dt, last, failed, waiting, diverged)
        info.update((f"reward/{name}", term) for name, term in terms.items())
        info["success"], info["success_once"] = solved, e.once.copy()
        info["clipped"] = e.clipped.copy()
        info.update(task.step_info(self.sim, ended))
        info.update(self.account(stopped, over))
        info.update(self._energy_account(info))
        return reward, ended, np.zeros(self.n, bool), info

    def account(self, stopped: Mask | None, over: Mask | None) -> dict[str, Any]:
        """Return entries of an info that describe the simulations rather than the task.

        Args:
            stopped: (n,) in the laboratory.
            over: as in `step`.
        """
        diverged = self.sim.diverged.copy()
        info: dict[str, Any] = {"diverged": diverged}
        if stopped is not None:
            info["stopped"] = stopped
        acts = self.sim.base_actuators
        if acts is not None:
            info["base/propellant"] = acts.propellant.copy()
            if acts.wheels:
                info["base/wheel_momentum"] = self.sim.wheel_speed * acts.rotors
        if self._per_range.any():  # a satellite has no range
            pose = self.sim.backend.read()[1][:, :6]
            used = (np.abs(pose) * self._per_range).max(axis=1)
            if (beyond := used > 1.0).any():
                info["base/range"], info["_base/range"] = used, beyond
        info.update(self.randomized())
        if self.recorder is not None:
            info.update(self.recorder.step(diverged if over is None else diverged & ~over))
        return info

    def _energy_account(self, info: Mapping[str, Any]) -> dict[str, Any]:
        """Entries of an info: how far the account of energy of ended episodes is open.

        Of the base's largest energy or, where it is more, of `_SHARE` of all that the drives
        have moved to and fro; trusted below 1 %.
        """
        ended, engine = info.get("_energy/E_peak"), self.sim.backend
        if ended is None or not (isinstance(engine, CompiledBackend) and engine.accounted):
            return {}
        ids = np.flatnonzero(ended)
        gap, moved = engine.energy_gap(ids)
        scale = np.maximum(info["energy/E_peak"][ids], _SHARE * moved)
        residual = np.zeros(self.n)
        residual[ids] = np.where(scale > _STILL, np.abs(gap) / np.maximum(scale, _STILL), 0.0)
        return {
            "energy_residual": residual, "_energy_residual": ended,
            "energy_trusted": residual < TRUSTED, "_energy_trusted": ended,
        }  # fmt: skip

    def _command(self, s: Scene | None = None) -> Array:
        """Drive command that follows the reference as it is now, of all or of `s`."""
        s = self.scene if s is None else s
        out = plain_command(self.task, s)
        if self._feedforward and self.task.control.level != "torque":
            motion = s.ref.reshape(len(s.ref), -1)
            out = out + self._torque_of(motion, self._numbers)
        return out

    def measured(self) -> tuple[Array, Array, Mask]:
        """Mode emulated: base pose (n, 6) and rate as measured, platforms stopped (n,)."""
        loop = self.sim.emulation_loop
        assert loop is not None
        return loop.y_measured, loop.vehicle_state[:, 6:].copy(), loop.frozen

    def _update_scene(self, ids: Index | None = None) -> None:
        """Read the state into the scene, of all or of some simulations."""
        s, rows = self.scene, slice(None) if ids is None else ids
        time, y, yd, q, v = (part[rows] for part in self.sim.last_state)
        y_seen, yd_seen = y, yd
        if self._emulated:
            y_seen, yd_seen = (part[rows] for part in self.measured()[:2])
        modes = self.sim.base_modes
        if modes is not None:
            modes = modes[0][rows], modes[1][rows]
        pose, rate = np.hstack([y, q]), np.hstack([yd, v])
        energies, tool, tool_seen = self._measures(pose, rate, y_seen, modes)
        table_values = self.task.lookup(s.goal[rows], np.rint(time / self.dt).astype(np.intp))
        parts = {
            "time": time, "y": y, "yd": yd, "q": q, "v": v, "y_seen": y_seen,
            "yd_seen": yd_seen, "energies": energies, "tool": tool, "tool_seen": tool_seen,
            "table_values": table_values,
        }  # fmt: skip
        if self.sim.machines.wheels:
            parts["wheels"] = self.sim.wheel_speed[rows]
        if self.task.interacts:
            assert self.sim.payload is not None
            which = np.arange(self.n) if ids is None else ids
            parts["payload"] = self.sim.payload.target(which).rows()
        if self.sim.contact is not None:
            parts["contact"] = np.column_stack(self.sim.contact.measured())[rows]
        if self.sim.base_actuators is not None:
            parts["propellant"] = self.sim.base_actuators.propellant[rows].copy()
        for name, values in parts.items():
            if ids is None:
                setattr(s, name, values)
            else:
                getattr(s, name)[ids] = values

    def _measures(
        self, z: Array, zd: Array, measured: Array, modes: tuple[Array, Array] | None
    ) -> list[Array]:
        """Energies of bases (k, 2) and places of tools (k, 3), at z and as measured.

        Args:
            z, zd: (k, 6 + joints) poses and angles, and their rates.
            measured: (k, 6) poses of the bases.
            modes: u and u' (k, m) of flexures and of the base's internal modes.
        """
        state = z, zd, measured, *(modes or ())
        return np.split(self._scene_of(*state, self._numbers), [2, 5], axis=1)

    @cached_property
    def free_decay(self) -> FreeDecay:
        """Energies that the base keeps after the end."""
        gains = None if self.task.control.level == "gains" else self._hold_gains
        return FreeDecay(self._space, self.n, self.task.tail, gains)

    def tail(self, ids: Index, ref: Array, kp: Array, kd: Array) -> tuple[Array, Array]:
        """Energy left in the base after the end [J s]: of E and of the strain energy.

        Args:
            ids: (k,) simulations.
            ref: (k, joints) where their joints are held [rad].
            kp, kd: (k, joints) by these gains.
        """
        _, y, yd, q, v = (part[ids] for part in self.sim.last_state)
        away = np.zeros_like(q) if self.task.control.level == "torque" else q - ref
        modes = self.sim.base_modes
        u, ud = (y[:, :0], yd[:, :0]) if modes is None else (part[ids] for part in modes)
        x = np.concatenate([y, u, away, yd, ud, v], axis=1)
        return self.free_decay(q, x, kp, kd)

    def observe(self) -> npt.NDArray[np.float32]:
        """(n, observations) in the fields' scales, clipped; what is not a number becomes 0."""
        if self._observation is not None:
            observation = self._observation.copy()
        else:
            observation = scaled_observation(self.task, self.scene, self.scale).astype(
                np.float32
            )
        if not self.task.context:
            return observation
        clip, pairs = self.task.CLIP, zip(self.task.randomize, self.drawn.values(), strict=True)
        context = [np.clip(r.context(values), -clip, clip) for r, values in pairs]
        return np.concatenate([observation, *(k.astype(np.float32) for k in context)], axis=1)

    def begin_at(self, scene: Scene, episodes: Episodes) -> None:
        """Go on from where other episodes are: joints, base as measured, reference, sums.

        Internal modes are carried along by the base; sensors and platform start anew.

        Args:
            scene, episodes: of n simulations with the same task and control.
        """
        sim, s = self.sim, scene
        if self._compiled is not None:
            self._compiled.ahead = False
        self._observation = None
        if self.system.drive == "motor":
            sim.set_gains(s.kp, s.kd)
        sim.reset(q=s.q, v=s.v, y=s.y_seen, yd=s.yd_seen, time=s.time)
        tables = self._scene.table_values
        self.scene = dataclasses.replace(s, table_values=tables, tail=np.zeros(self.n))
        self.episodes = episodes
        self._beginnings.forget(np.arange(self.n))
        self._update_scene()
        if self._compiled is not None:
            self._compiled.load(np.arange(self.n), self._scene, self._episodes)

    # ---------------------------------------------------------------- snapshot

    def get_state(self) -> Any:
        """Everything needed to continue exactly from here; picklable."""
        episodes_state = copy.deepcopy((self.scene, self.episodes, self.drawn))
        recorded = None if self.recorder is None else self.recorder.get_state()
        return self.task, episodes_state, self.sim.snapshot(), recorded

    def set_state(self, state: Any) -> None:
        """Return to a state handed out by `get_state` of a batch of the same task and n."""
        task, episodes_state, snapshot, recorded = state
        if task != self.task:
            raise ParameterError(
                f"snapshot is of task {task.kind} {content_hash(task)[:12]}, this is"
                f" {self.task.kind} {content_hash(self.task)[:12]}"
            )
        self.sim.restore(snapshot)  # refuses what does not fit, before anything changes
        self._observation = None
        self._beginnings.forget(np.arange(self.n))
        if self._compiled is not None:
            self._compiled.ahead = False
        self.scene, self.episodes, self.drawn = copy.deepcopy(episodes_state)
        if self._compiled is not None:
            self._compiled.load(np.arange(self.n), self._scene, self._episodes)
        if self.recorder is not None:
            self.recorder.set_state(recorded)
