"""Pictures of an environment: a frame per call (rgb_array), or a window (human).

What is drawn is in `report`, in a process of its own; it is loaded with the first picture.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ves_gym.envs.batch import Batch
from ves_gym.envs.dump import wrench_on_base
from ves_gym.envs.task import Task

if TYPE_CHECKING:
    from ves_gym.rendering.live import Key

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

    def frame(self, batch: Batch, text: tuple[str, ...] = ()) -> npt.NDArray[np.uint8] | None:
        """The picture (height, width, 3) of the present state; None: it is in the window."""
        if self.mode == "rgb_array":
            return self.live.picture(self._samples(batch, text)[0])
        self.show(batch, text)
        return None

    def frames(self, batch: Batch) -> tuple[npt.NDArray[np.uint8], ...]:
        """Pictures (height, width, 3) of every simulation's present state."""
        samples = self._samples(batch, (), batch.n)
        return tuple(self.live.picture(sample) for sample in samples)

    def show(self, batch: Batch, text: tuple[str, ...] = ()) -> list[Key]:
        """Bring the window up to date, a control period after the last time.

        Returns:
            Keys pressed and let go since then.
        """
        keys = self.live.show(self._samples(batch, text)[0])
        self._due = max(self._due + self.dt, time.monotonic() - self.dt)  # no catching up
        time.sleep(max(0.0, self._due - time.monotonic()))
        return keys

    def _samples(
        self, batch: Batch, text: tuple[str, ...], count: int = 1
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
