"""Episodes as run logs, of what diverged (`dump=`) or was driven by hand, and as pictures.

What is drawn is in `rendering`, in a process of its own; it is loaded with the first picture.
"""

from __future__ import annotations

import os
import time
import uuid
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import Array, Index, Mask
from ves_gym.envs.episode import EpisodeBatch
from ves_gym.envs.task import Task
from ves_gym.simulation.playback import base_wrench
from ves_gym.system.runlog import RunLog

if TYPE_CHECKING:
    from ves_gym.rendering.live import Key

Rows = tuple[list[Array], npt.NDArray[np.intp]]


def wrench_on_base(batch: EpisodeBatch, acceleration: Array | None = None) -> Array:
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
        self, batch: EpisodeBatch, folder: str | os.PathLike[str] | None = None
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
        """Store the state after a step; return the entries of `info` on those that diverged."""
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
            servo = control.servo_for(batch.system)
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


# ----------------------------------------------------------------------- pictures

_POINTS = 100  # most of a marker


def render_modes() -> list[str]:
    """Return the modes that this machine can show: a window needs a display."""
    from ves_gym.rendering.opengl import has_display

    return ["human", "rgb_array"] if has_display() else ["rgb_array"]


def require_display() -> None:
    """Raise a RenderError where no window can open."""
    from ves_gym.rendering import opengl

    opengl.require_display()


class Renderer:
    """The simulations of a batch, the first alone: arm, whole structure and energy strip.

    Args:
        task: what the batch is at.
        render_mode: rgb_array, or human for a window that runs in real time.
        rolling: s of the energy strip that follow the clock; None: it spans the episode.
        lines: of text that each frame may come with.
        title: of the window.

    Raises:
        RenderError: no display or no OpenGL; the message says what is missing.
    """

    def __init__(
        self,
        task: Task,
        render_mode: str,
        *,
        rolling: float | None = None,
        lines: int = 0,
        title: str = "",
    ) -> None:
        from ves_gym.rendering.live import Live, LiveSettings

        self.mode, self.dt = render_mode, task.system.control_dt
        window = render_mode == "human"
        settings = LiveSettings(
            system=task.system,
            window=window,
            width=960 if window else 640,
            height=720 if window else 480,
            span=task.duration if rolling is None else rolling,
            rolling=rolling is not None,
            lines=lines,
            title=title or f"ves_gym {task.kind}",
        )
        self.live = Live(settings)
        self._latest: dict[int, dict[str, Any]] = {}  # of each simulation
        self._due = 0.0

    @property
    def open(self) -> bool:
        """True while the window is there."""
        return self.live.open

    def frame(
        self, batch: EpisodeBatch, text: tuple[str, ...] = ()
    ) -> npt.NDArray[np.uint8] | None:
        """The picture (height, width, 3) of the present state; None: it is in the window."""
        if self.mode == "rgb_array":
            return self.live.picture(self._samples(batch, text)[0])
        self.show(batch, text)
        return None

    def frames(self, batch: EpisodeBatch) -> tuple[npt.NDArray[np.uint8], ...]:
        """Pictures (height, width, 3) of every simulation's present state."""
        samples = self._samples(batch, (), batch.n)
        return tuple(self.live.picture(sample) for sample in samples)

    def show(self, batch: EpisodeBatch, text: tuple[str, ...] = ()) -> list[Key]:
        """Bring the window up to date, a control period after the last time.

        Returns:
            Keys pressed and let go since then.
        """
        keys = self.live.show(self._samples(batch, text)[0])
        self._due = max(self._due + self.dt, time.monotonic() - self.dt)  # no catching up
        time.sleep(max(0.0, self._due - time.monotonic()))
        return keys

    def _samples(
        self, batch: EpisodeBatch, text: tuple[str, ...], count: int = 1
    ) -> list[dict[str, Any]]:
        """Samples of the first simulations, `count` of them."""
        s, e = batch.scene, batch.episodes
        marker = batch.task.marker(s)
        if marker is not None:
            marker = marker[:, :: -(-marker.shape[1] // _POINTS)]
        modes, wrench = batch.sim.base_modes, wrench_on_base(batch)
        payload = None
        if batch.sim.payload is not None:
            payload = np.concatenate(batch.sim.payload.state[:2], axis=1)
        for i in range(count):
            if batch.sim.diverged[i] and i in self._latest:
                continue  # the last that can be drawn
            self._latest[i] = {
                "row": i,
                "payload": None if payload is None else payload[i].tolist(),
                "episode": [int(k[i]) for k in (e.root, e.index, e.number)],
                "t": float(s.time[i]),
                "y": s.y[i].tolist(),
                "u": None if modes is None else modes[0][i].tolist(),
                "q": s.q[i].tolist(),
                "E": float(s.energy[i]),
                "strain": float(s.strain[i]),
                "w": wrench[i].tolist(),
                "marker": None if marker is None else marker[i].tolist(),
                "text": list(text),
            }
        return [self._latest[i] for i in range(count)]

    def close(self) -> None:
        """End the drawing process; may be called again."""
        self.live.close()
