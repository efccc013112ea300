"""n episodes of one task in lockstep: the one code path under every environment."""

from __future__ import annotations

import copy
import dataclasses
import math
import os
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import Array, Index, Mask, ParameterError, content_hash
from ves_gym.engine.kernel.scene import SceneMap, TorqueMap
from ves_gym.envs.compiled import Shape, plain_command
from ves_gym.envs.corners import warn_of_unstable_corners
from ves_gym.envs.dump import Recorder
from ves_gym.envs.episode import (
    Episodes,
    bounded,
    count,
    endings,
    judge,
    outcome,
    scaled_observation,
)
from ves_gym.envs.period import Period, period_of
from ves_gym.envs.randomize import Draws
from ves_gym.envs.tail import free_decay_energy
from ves_gym.envs.task import Scene, Task
from ves_gym.mechanics.servo import own_gains
from ves_gym.simulation.simulator import Simulator


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
        self._period: Period | None = None
        self._draws = Draws(task.system, task.randomize)
        self.system = self._draws.system
        control, arm = task.control, self.system.arm
        motor = self.system.drive == "motor"
        self.sim = Simulator(
            self.system,
            n,
            servo=control.servo_for(arm) if motor else None,
            backend=backend,
            threads=threads,
            on_divergence="mark",
            warn_at=None,
        )
        if task.randomize and self.system.mode == "emulated":
            warn_of_unstable_corners(
                task.system, task.randomize, control.servo_for(arm) if motor else None
            )
        space = self.system.ideal()
        self._space = space  # effects have no part in it
        self._scenes, self._torques = SceneMap(space, n), TorqueMap(space, n)
        self._emulated = self.system.mode == "emulated"
        self._feedforward = motor and control.servo.feedforward
        self.dt = self.system.control_dt
        self.width = task.action_width
        self._joint_width = control.width(arm)
        if task.base_control is not None and self.sim.base_actuators is None:
            raise ParameterError(
                f"base_control needs backend kernel or mujoco, got {self.sim.backend_name}"
            )
        self.scale = np.concatenate([f.scale for f in task.fields()])
        self.observations = sum(f.size for f in task.parts())
        self._observation: npt.NDArray[np.float32] | None = None  # as of the last compiled step
        joints = arm.n
        z, zj = np.zeros((n, 6)), np.zeros((n, joints))
        goals = task.start(np.zeros((1, task.draws))).goal.shape[1]
        table_values = task.lookup(np.zeros((1, goals)), np.zeros(1, np.intp)).shape[1]
        follows = motor and control.level != "torque"
        hold = control.servo_for(arm) if follows else own_gains(arm)
        self.scene = Scene(
            time=np.zeros(n), q=zj, v=zj, y=z, yd=z, y_seen=z, yd_seen=z,
            tool=np.zeros((n, 3)), tool_seen=np.zeros((n, 3)), energies=np.zeros((n, 2)),
            ref=np.zeros((n, 3, joints)), goal=np.zeros((n, goals)),
            memory=np.zeros((n, task.memory)), table_values=np.zeros((n, table_values)),
            tau=zj.copy(), tail=np.zeros(n),
            kp=np.tile(np.asarray(hold.kp, float), (n, 1)),
            kd=np.tile(np.asarray(hold.kd, float), (n, 1)),
        )  # fmt: skip
        self.episodes = Episodes(
            np.zeros(n, np.uint64), np.arange(n), np.full(n, -1),
            np.zeros(n, np.int64), np.zeros(n, np.int64), np.zeros(n, bool),
            np.zeros(n), np.zeros((n, 2)), np.zeros((n, 2)),
        )  # fmt: skip
        self.drawn: dict[str, Array] = {r.label: np.zeros((n, r.size)) for r in task.randomize}

        if compiled and self.sim.base_actuators is None:  # they act period by period
            self._period = period_of(self, self._scenes, self._torques)
        self.recorder = None if dump is None else Recorder(self, dump)

    @property
    def shape(self) -> Shape | None:
        """Rows of the compiled steps; None where they stay in NumPy."""
        return None if self._period is None else self._period.shape

    @property
    def compiled(self) -> bool:
        """Steps run in compiled code."""
        return self._period is not None

    @property
    def scene(self) -> Scene:
        """Every simulation at this instant."""
        if self._period is not None and self._period.ahead:
            self._period.store()
        return self._scene

    @scene.setter
    def scene(self, scene: Scene) -> None:
        self._scene = scene

    @property
    def episodes(self) -> Episodes:
        """Counters and sums of the episodes."""
        if self._period is not None and self._period.ahead:
            self._period.store()
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

    def reset(self, ids: Index, options: Mapping[str, Array] | None = None) -> None:
        """Begin the next episode in some simulations; `options` as in `Task.start`."""
        e, task, sim = self.episodes, self.task, self.sim
        if not len(ids):
            return
        e.number[ids] += 1
        u = np.empty((len(ids), task.draws + self._draws.size))
        keys = np.column_stack([k[ids].astype(np.uint64) for k in (e.root, e.index, e.number)])
        for i, key, row in zip(ids.tolist(), keys.tolist(), u, strict=True):
            seeds = np.random.SeedSequence(key)
            sim.generators[i] = np.random.Generator(np.random.PCG64(seeds))
            sim.generators[i].random(out=row)
        if task.randomize:
            self._randomise(ids, u[:, task.draws :])
        begin = task.start(u[:, : task.draws], **(options or {}))
        s, joints = self.scene, self.system.arm.n
        q = np.broadcast_to(begin.q, (len(ids), joints))
        v = np.broadcast_to(begin.v, (len(ids), joints))
        sim.reset(q=q, v=v, y=begin.y, yd=begin.yd, ids=ids)
        s.ref[ids, 0], s.ref[ids, 1], s.ref[ids, 2] = q, v, 0.0
        s.goal[ids], s.memory[ids], s.tail[ids] = begin.goal, 0.0, 0.0
        for k in (e.steps, e.clipped, e.once, e.total, e.sums):
            k[ids] = 0
        if task.interacts:
            task.on_reset(sim, ids, begin.goal)
        self._update_scene()
        if task.interacts and task.on_period_end(sim, s, ids):
            self._update_scene()
        s.tau[ids] = self._command()[ids]
        e.peaks[ids] = s.energies[ids]
        if self._period is not None:
            self._period.load(ids)
        if self._observation is not None:
            self._observation[ids] = scaled_observation(task, s, self.scale)[ids].astype(
                np.float32
            )
        if self.recorder is not None:
            self.recorder.begin(ids)

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
            over: (n,) simulations that wait for their next episode; nothing is told of them.

        Returns:
            reward (n,), terminated (n,), truncated (n,), and what is known of the step.
        """
        if self._period is not None:
            return self._period.step(actions, over)
        e, s, task = self.episodes, self.scene, self.task
        actions = bounded(e, actions)
        before = s.energies
        remaining = np.subtract(task.duration, e.steps * self.dt, dtype=np.float64)
        if task.base_control is not None:
            task.base_control.drive(self.sim, actions[:, self._joint_width :])
        joints = actions[:, : self._joint_width]
        task.control.drive(self.sim, s, joints, remaining, self._command)
        self._update_scene()
        if task.interacts and task.on_period_end(self.sim, s, np.arange(self.n)):
            self._update_scene()
        count(task, s, e, before, self.dt)
        diverged = self.sim.diverged
        waiting = np.zeros(self.n, bool) if over is None else over
        lost, stopped = diverged, None
        if self._emulated:  # after a safety stop the platform stands still for good
            stopped = self.measured()[2]
            lost = lost | stopped
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
            info.update(self.energies_at_end(strain, ended))
        terms, reward, solved = judge(task, s, e, self.dt, last, failed, waiting, diverged)
        info.update((f"reward/{name}", term) for name, term in terms.items())
        info["success"], info["success_once"] = solved, e.once.copy()
        info["clipped"] = e.clipped.copy()
        info.update(task.step_info(self.sim, s, ended))
        info.update(self.account(stopped, over))
        return reward, *outcome(task, last, failed), info

    def account(self, stopped: Mask | None, over: Mask | None) -> dict[str, Any]:
        """Entries of an info that tell of the simulations rather than of the task.

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
        info.update(self.randomized())
        if self.recorder is not None:
            info.update(self.recorder.step(diverged if over is None else diverged & ~over))
        return info

    def energies_at_end(self, strain: Array, ended: Mask) -> dict[str, Any]:
        """Energies of episodes that have ended, with their mask, as entries of an info.

        Args:
            strain: (n,) integral of the strain energy over the tail [J s].
            ended: (n,).
        """
        e, s = self.episodes, self.scene
        energies = {
            "E_mean": (e.sums[:, 0] + s.tail) / (e.steps * self.dt + self.task.tail),
            "E_res": s.energy.copy(),
            "E_peak": e.peaks[:, 0].copy(),
            "E_strain_peak": e.peaks[:, 1].copy(),
            "E_int": e.sums[:, 1] + strain,
        }
        info: dict[str, Any] = {}
        for name, energy in energies.items():
            info[f"energy/{name}"], info[f"_energy/{name}"] = energy, ended
        return info

    def _command(self) -> Array:
        """Drive command that follows the reference as it is now."""
        out = plain_command(self.task, self.scene)
        if self._feedforward and self.task.control.level != "torque":
            out = out + self._torques(self.scene.ref)
        return out

    def measured(self) -> tuple[Array, Array, Mask]:
        """Mode emulated: base pose (n, 6) and rate as measured, platforms stopped (n,)."""
        loop = self.sim.emulation_loop
        assert loop is not None
        return loop.y_measured, loop.vehicle_state[:, 6:].copy(), loop.frozen

    def _update_scene(self) -> None:
        """Read the state into the scene."""
        s = self.scene
        s.time, s.y, s.yd, s.q, s.v = self.sim.last_state
        s.y_seen, s.yd_seen = s.y, s.yd
        if self._emulated:
            s.y_seen, s.yd_seen, _ = self.measured()
        motion = s.q, s.v, s.y, s.yd, s.y_seen
        s.energies, s.tool, s.tool_seen = self._scenes(*motion, self.sim.base_modes)
        s.table_values = self.task.lookup(s.goal, np.rint(s.time / self.dt).astype(np.intp))

    def tail(self, ids: Index, ref: Array, kp: Array, kd: Array) -> tuple[Array, Array]:
        """Energy left in the base after the end [J s]: of E and of the strain energy.

        Args:
            ids: (k,) simulations.
            ref: (k, joints) where their joints are held [rad].
            kp, kd: (k, joints) by these gains.
        """
        _, y, yd, q, v = (part[ids] for part in self.sim.last_state)
        away = np.zeros_like(q) if self.task.control.level == "torque" else q - ref
        x = np.concatenate([y, away, yd, v], axis=1)
        if (modes := self.sim.base_modes) is not None:
            x = np.concatenate([y, modes[0][ids], away, yd, modes[1][ids], v], axis=1)
        return free_decay_energy(self._space, q, x, kp, kd, seconds=self.task.tail)

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

    def keep_observation(self, rows: Array) -> None:
        """Take observations (observations, n) from a compiled step."""
        self._observation = rows.T.astype(np.float32, order="C")

    def probe(self) -> Scene:
        """Two simulations with any numbers, to ask formulas for theirs."""
        rng, s = np.random.default_rng(0), self._scene
        rows = {f.name: getattr(s, f.name) for f in dataclasses.fields(s)}
        return Scene(**{k: rng.uniform(0.1, 0.5, (2, *v.shape[1:])) for k, v in rows.items()})

    def begin_at(self, scene: Scene, episodes: Episodes) -> None:
        """Go on from where other episodes are: joints, base as measured, reference, sums.

        Internal modes are carried along by the base; sensors and platform start anew.

        Args:
            scene, episodes: of n simulations with the same task and control.
        """
        sim, s = self.sim, scene
        if self._period is not None:
            self._period.ahead = False
        self._observation = None
        if self.system.drive == "motor":
            sim.set_gains(s.kp, s.kd)
        sim.reset(q=s.q, v=s.v, y=s.y_seen, yd=s.yd_seen, time=s.time)
        tables = self._scene.table_values
        self.scene = dataclasses.replace(s, table_values=tables, tail=np.zeros(self.n))
        self.episodes = episodes
        self._update_scene()
        if self._period is not None:
            self._period.load(np.arange(self.n))

    # ---------------------------------------------------------------- snapshot

    def get_state(self) -> Any:
        """Everything needed to continue exactly from here; picklable."""
        episodes_state = (self.scene, self.episodes, self.drawn)
        recorded = None if self.recorder is None else self.recorder.get_state()
        return (
            self.task,
            copy.deepcopy(episodes_state),
            self.sim.snapshot(),
            recorded,
        )

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
        if self._period is not None:
            self._period.ahead = False
        self.scene, self.episodes, self.drawn = copy.deepcopy(episodes_state)
        if self._period is not None:
            self._period.load(np.arange(self.n))
        if self.recorder is not None:
            self.recorder.set_state(recorded)
