"""n episodes of one task in lockstep: the one code path under every environment."""

from __future__ import annotations

import copy
import os
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import Array, Index, Mask, ParameterError, content_hash
from ves_gym.engine.kernel.scene import SceneMap, TorqueMap
from ves_gym.envs.corners import warn_of_unstable_corners
from ves_gym.envs.dump import Recorder
from ves_gym.envs.randomize import Draws
from ves_gym.envs.tail import tail_energy
from ves_gym.envs.task import Scene, Task
from ves_gym.mechanics.servo import HIGH_GAINS
from ves_gym.simulation.simulator import Simulator

_FAILURE = -2.0  # added to the reward when an episode fails; a straight motion returns about -1


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
    if not np.isfinite(out).all():
        where = np.argwhere(~np.isfinite(out))[0].tolist()
        raise ActionError(f"{expected} {out[tuple(where)]} at {where}")
    return out


@dataclass
class Episodes:
    """Counters and running sums of n episodes. Leading axis n."""

    root: npt.NDArray[np.uint64]  # seed of the sequence of episodes
    index: npt.NDArray[np.int64]  # which of that seed's simulations
    number: npt.NDArray[np.int64]  # which episode, from 0
    steps: npt.NDArray[np.int64]  # control periods so far
    clipped: npt.NDArray[np.int64]  # actions that were out of bounds
    once: Mask  # success at any time
    total: Array  # return so far
    sums: Array  # (n, 2) integrals of E and of the strain energy [J s]
    peaks: Array  # (n, 2) their peaks [J]


class Batch:
    """n episodes of a task.

    Args:
        task: what the episodes ask.
        n: how many.
        backend, threads: of the `Simulator`.
        dump: folder for run logs of the episodes that diverge; None: nothing is recorded.
    """

    def __init__(
        self,
        task: Task,
        n: int,
        *,
        backend: str = "auto",
        threads: int = 0,
        dump: str | os.PathLike[str] | None = None,
    ) -> None:
        self.task, self.n = task, n
        self._draws = Draws(task.system, task.randomize)
        self.system = self._draws.system
        control, arm = task.control, self.system.arm
        motor = self.system.drive == "motor"
        self.sim = Simulator(
            self.system,
            n,
            servo=control.servo if motor else None,
            backend=backend,
            threads=threads,
            on_divergence="mark",
            warn_at=None,
        )
        if task.randomize and self.system.mode == "emulated":
            warn_of_unstable_corners(
                task.system, task.randomize, control.servo if motor else None
            )
        space = self.system.ideal()
        self._space = space  # effects have no part in it
        self._scenes, self._torques = SceneMap(space, n), TorqueMap(space, n)
        self._emulated = self.system.mode == "emulated"
        self._feedforward = motor and control.servo.feedforward
        self.dt = self.system.control_dt
        self.width = control.width(arm)
        parts = task.parts()
        self._scale = np.concatenate([f.scale for f in parts])
        self.observations = len(self._scale)
        joints = arm.n
        z, zj = np.zeros((n, 6)), np.zeros((n, joints))
        goals = task.start(np.zeros((1, task.draws))).goal.shape[1]
        hold = control.servo if motor and control.level != "torque" else HIGH_GAINS
        self.scene = Scene(
            time=np.zeros(n), q=zj, v=zj, y=z, yd=z, y_seen=z, yd_seen=z,
            tool=np.zeros((n, 3)), tool_seen=np.zeros((n, 3)), energies=np.zeros((n, 2)),
            ref=np.zeros((n, 3, joints)), goal=np.zeros((n, goals)),
            memory=np.zeros((n, task.memory)),
            tau=zj.copy(), tail=np.zeros(n),
            kp=np.tile(np.asarray(hold.kp[:joints], float), (n, 1)),
            kd=np.tile(np.asarray(hold.kd[:joints], float), (n, 1)),
        )  # fmt: skip
        self.episodes = Episodes(
            np.zeros(n, np.uint64), np.arange(n), np.full(n, -1),
            np.zeros(n, np.int64), np.zeros(n, np.int64), np.zeros(n, bool),
            np.zeros(n), np.zeros((n, 2)), np.zeros((n, 2)),
        )  # fmt: skip
        self.drawn: dict[str, Array] = {r.label: np.zeros((n, r.size)) for r in task.randomize}

        self.recorder = None if dump is None else Recorder(self, dump)

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
        for row, i in enumerate(ids.tolist()):
            key = (int(e.root[i]), int(e.index[i]), int(e.number[i]))
            generator = np.random.Generator(np.random.PCG64(np.random.SeedSequence(key)))
            sim.generators[i] = generator
            u[row] = generator.random(u.shape[1])
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
        self._update_scene()
        s.tau[ids] = self._command()[ids]
        e.peaks[ids] = s.energies[ids]
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
        e, s, task = self.episodes, self.scene, self.task
        size = np.abs(actions)
        if size.max() > 1.0:
            e.clipped += (size > 1.0).any(axis=1)
            actions = np.clip(actions, -1.0, 1.0)
        self._drive(actions)
        before = s.energies
        self._update_scene()
        e.steps += 1
        task.remember(s, self.dt)
        e.sums += (before + s.energies) * (self.dt / 2)
        np.maximum(e.peaks, s.energies, out=e.peaks)
        diverged = self.sim.diverged
        astray = diverged.any()
        last = e.steps >= task.steps
        failed = diverged | task.failed(s)
        if self._emulated:  # after a safety stop the platform stands still for good
            assert self.sim.emulation_loop is not None
            stopped = self.sim.emulation_loop.frozen
            failed |= stopped
        if over is not None:
            last, failed = last & ~over, failed & ~over
        ended = last | failed
        info: dict[str, Any] = {}
        if ended.any():
            s.tail[:] = 0.0
            tail_strain = np.zeros(self.n)
            if task.tail:
                good = np.flatnonzero(ended & ~diverged)
                s.tail[good], tail_strain[good] = self._tail(good)
            energies = {
                "E_mean": (e.sums[:, 0] + s.tail) / (e.steps * self.dt + task.tail),
                "E_res": s.energy.copy(),
                "E_peak": e.peaks[:, 0].copy(),
                "E_strain_peak": e.peaks[:, 1].copy(),
                "E_int": e.sums[:, 1] + tail_strain,
            }
            for name, energy in energies.items():
                info[f"energy/{name}"], info[f"_energy/{name}"] = energy, ended
        terms = task.reward(s, self.dt, last & ~failed)
        terms["failure"] = np.where(failed, _FAILURE, 0.0)
        if astray or over is not None:
            for name, term in terms.items():
                mute = diverged & ~np.isfinite(term)
                terms[name] = np.where(mute if over is None else mute | over, 0.0, term)
        first, *others = terms.values()
        reward = sum(others, start=first)  # in the order of the terms
        solved = task.success(s) & ~failed
        if over is not None:
            solved &= ~over
        e.once |= solved
        e.total += reward
        info.update((f"reward/{name}", term) for name, term in terms.items())
        info["success"] = solved
        info["success_once"] = e.once.copy()
        info["clipped"] = e.clipped.copy()
        info["diverged"] = diverged.copy()
        if self._emulated:
            info["stopped"] = stopped
        info.update(self.randomized())
        if self.recorder is not None:
            info.update(self.recorder.step(diverged if over is None else diverged & ~over))
        truncated = last & ~failed if task.ends == "truncated" else np.zeros(self.n, bool)
        terminated = failed | last if task.ends == "terminated" else failed
        return reward, terminated, truncated, info

    def _drive(self, action: Array) -> None:
        remaining = np.subtract(
            self.task.duration, self.episodes.steps * self.dt, dtype=np.float64
        )
        self.task.control.drive(self.sim, self.scene, action, remaining, self._command)

    def _command(self) -> Array:
        """Drive command that follows the reference as it is now."""
        s = self.scene
        if self.system.drive == "prescribed":
            return s.ref[:, 2].copy()
        if self.task.control.level == "torque":
            return np.zeros_like(s.q)
        out = s.kp * s.ref[:, 0] + s.kd * s.ref[:, 1]
        if self._feedforward:
            out = out + self._torques(s.ref)
        return np.asarray(out, dtype=np.float64)

    def _update_scene(self) -> None:
        """Read the state into the scene."""
        s, sim = self.scene, self.sim
        s.time, s.y, s.yd, s.q, s.v = sim.last_state
        s.y_seen, s.yd_seen = s.y, s.yd
        if self._emulated:
            assert sim.emulation_loop is not None
            s.y_seen, s.yd_seen = sim.readings.y, sim.emulation_loop.vehicle_state[:, 6:].copy()
        s.energies, s.tool, s.tool_seen = self._scenes(s.q, s.v, s.y, s.yd, s.y_seen)

    def _tail(self, ids: Index) -> tuple[Array, Array]:
        s = self.scene
        if self.task.control.level == "torque":
            away = np.zeros((len(ids), s.q.shape[1]))
        else:
            away = s.q[ids] - s.ref[ids, 0]
        x = np.concatenate([s.y[ids], away, s.yd[ids], s.v[ids]], axis=1)
        parts = (s.q[ids], x, s.kp[ids], s.kd[ids])
        return tail_energy(self._space, *parts, seconds=self.task.tail)

    def observe(self) -> npt.NDArray[np.float32]:
        """(n, observations) in the fields' scales, clipped; what is not a number becomes 0."""
        parts = self.task.observe(self.scene)
        if self.task.context:
            pairs = zip(self.task.randomize, self.drawn.values(), strict=True)
            parts = (*parts, *(r.context(values) for r, values in pairs))
        values = np.concatenate(parts, axis=1) / self._scale
        if self.sim.diverged.any():
            values = np.nan_to_num(values, nan=0.0)
        clip = self.task.CLIP
        return np.minimum(np.maximum(values, -clip), clip).astype(np.float32)

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
        self.scene, self.episodes, self.drawn = copy.deepcopy(episodes_state)
        if self.recorder is not None:
            self.recorder.set_state(recorded)
