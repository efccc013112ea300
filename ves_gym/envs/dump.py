"""Episodes as run logs: of what diverged (`dump=`), and of what was driven by hand."""

from __future__ import annotations

import os
import uuid
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import Array, Index, Mask
from ves_gym.envs.episode import Episodes
from ves_gym.envs.task import Scene, Task
from ves_gym.simulation.playback import base_wrench
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.runlog import RunLog
from ves_gym.system.system import System

Rows = tuple[list[Array], npt.NDArray[np.intp]]


class RecordableBatch(Protocol):
    """n episodes of a task: `Batch`."""

    task: Task
    system: System
    sim: Simulator
    n: int

    @property
    def scene(self) -> Scene:
        """Every simulation at this instant."""

    @property
    def episodes(self) -> Episodes:
        """Counters and sums of the episodes."""


def wrench_on_base(batch: RecordableBatch, acceleration: Array | None = None) -> Array:
    """(n, 6) wrench of the arm on the base in platform axes, without weight [N, N m].

    In the laboratory what is measured less the gravity estimate; in space the truth, from
    the base's acceleration (n, 6) where that is known already.
    """
    sim = batch.sim
    if sim.emulation_loop is not None:
        return np.asarray(sim.readings.wrench - sim.readings.gravity, dtype=np.float64)
    if acceleration is None:
        acceleration = sim.evaluate(batch.scene.tau)[1]
    state, hidden = sim.last_state, sim.internal_state if batch.system.actual.base.m else None
    return base_wrench(batch.system, state.y, state.yd, acceleration, hidden)


class Recorder:
    """Keeps the episodes that a batch is in, step by step.

    Args:
        batch: whose episodes.
        folder: where those that diverge are written; made if it is not there. None: nowhere.
    """

    def __init__(
        self, batch: RecordableBatch, folder: str | os.PathLike[str] | None = None
    ) -> None:
        self.batch, self.folder = batch, None if folder is None else Path(folder)
        if self.folder is not None:
            self.folder.mkdir(parents=True, exist_ok=True)
        n = batch.system.arm.n
        sizes = {"t": 1} | dict.fromkeys(("q_cmd", "v_cmd", "q", "v", "tau"), n)
        sizes |= dict.fromkeys(("y", "yd", "w"), 6)
        if batch.system.mode == "emulated":
            sizes |= {"wg": 6, "y_cmd": 6}
        self._columns, end = {}, 0
        for name, size in sizes.items():
            self._columns[name] = slice(end, end := end + size)
        self._rows: list[Array] = []  # (n, width) per step
        self._first = np.zeros(batch.n, np.intp)  # row of each simulation's beginning

    def begin(self, ids: Index) -> None:
        """Forget the episodes of these simulations: they are at the beginning of others."""
        record = self._record()
        if self._rows:  # their last row was the end of the episode before
            merged = self._rows[-1].copy()
            merged[ids] = record[ids]
            self._rows[-1] = merged
        else:
            self._rows.append(record)
        self._first[ids] = len(self._rows) - 1
        gone = int(self._first.min())
        del self._rows[:gone]
        self._first -= gone

    def step(self, diverged: Mask) -> dict[str, Any]:
        """Keep the state after a step; what `info` tells of those that diverged in it."""
        self._rows.append(self._record())
        if self.folder is None or not diverged.any():
            return {}
        return {"dump": self.dump(self.folder, diverged), "_dump": diverged.copy()}

    def _record(self) -> Array:
        batch, s, sim = self.batch, self.batch.scene, self.batch.sim
        tau, acceleration = sim.evaluate(s.tau)
        row = [s.time[:, None], s.ref[:, 0], s.ref[:, 1], s.q, s.v, tau, s.y, s.yd]
        with np.errstate(all="ignore"):  # a diverged state has no wrench, and is cut off
            base_wrench = wrench_on_base(batch, acceleration)
        if sim.emulation_loop is None:
            return np.concatenate([*row, base_wrench], axis=1)
        return np.concatenate(
            [*row, sim.readings.wrench, base_wrench, sim.readings.y_cmd], axis=1
        )

    # ------------------------------------------------------------------- logs

    def dump(self, folder: Path, which: Mask) -> npt.NDArray[np.object_]:
        """Write the episodes of some simulations; their files' names (n,), None for others.

        None, too, for one without two finite samples: no log is that short.
        """
        names = np.full(len(which), None, object)
        e = self.batch.episodes
        for i in np.flatnonzero(which).tolist():
            rows = self._finite(i)
            if len(rows) < 2:
                continue
            key = f"{e.root[i]}-{e.index[i]}-{e.number[i]}"
            path = folder / f"{self.batch.task.kind}-{key}-{uuid.uuid4().hex[:8]}.csv"
            self.log(i, f"diverged within a period of t = {rows[-1, 0]:.4f} s").save(path)
            names[i] = str(path)
        return names

    def _finite(self, i: int) -> Array:
        """Rows of the episode of simulation i up to the last finite one."""
        rows = np.stack([row[i] for row in self._rows[self._first[i] :]])
        bad = ~np.isfinite(rows).all(axis=1)
        return rows[: int(bad.argmax())] if bad.any() else rows

    def log(self, i: int, note: str = "") -> RunLog:
        """The episode of simulation i so far, up to its last finite sample."""
        rows = self._finite(i)
        part = {k: rows[:, where] for k, where in self._columns.items()}
        return RunLog(t=part.pop("t")[:, 0], **part, meta=self._meta(i, part, note))

    def _meta(self, i: int, part: dict[str, Array], note: str) -> dict[str, Any]:
        batch, e = self.batch, self.batch.episodes
        control = batch.task.control
        kp, kd = batch.scene.kp[i], batch.scene.kd[i]
        if control.level == "torque":
            servo = control.servo_for(batch.system.arm)
            kp, kd = np.array(servo.kp), np.array(servo.kd)
        meta = {
            "format": "ves-run/1",
            "system": batch.sim.systems[i].to_dict(),
            "controller": {
                "kp": kp.tolist(),
                "kd": kd.tolist(),
                "feedforward": control.servo.feedforward,
                "control": control.kind,
            },
            "initial": {k: part[k][0].tolist() for k in ("q", "v", "y", "yd")},
            "noise_std": {},
            "backend": batch.sim.backend_name,
            "task": batch.task.kind,
            "episode": [int(e.root[i]), int(e.index[i]), int(e.number[i])],
            "note": note,
        }
        if batch.system.mode == "emulated":
            stops = [k for k in batch.sim.events if k.simulation == i]
            meta["events"] = [{"time": k.time, "reason": k.reason} for k in stops]
        return meta

    # --------------------------------------------------------------- snapshot

    def get_state(self) -> Rows:
        """Return the rows recorded so far; they are never written to."""
        return list(self._rows), self._first.copy()

    def set_state(self, state: Rows | None) -> None:
        """Return to what `get_state` gave; None: begin here, with what came before unknown."""
        if state is None:
            self._rows = []
            self.begin(np.arange(self.batch.n))
            return
        rows, first = state
        self._rows, self._first = list(rows), first.copy()
