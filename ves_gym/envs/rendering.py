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
    """The first simulation of a batch: arm, whole structure and energy strip.

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
        self._latest: dict[str, Any] | None = None
        self._due = 0.0

    @property
    def open(self) -> bool:
        """True while the window is there."""
        return self.live.open

    def frame(self, batch: Batch, text: tuple[str, ...] = ()) -> npt.NDArray[np.uint8] | None:
        """The picture (height, width, 3) of the present state; None: it is in the window."""
        if self.mode == "rgb_array":
            return self.live.picture(self._sample(batch, text))
        self.show(batch, text)
        return None

    def show(self, batch: Batch, text: tuple[str, ...] = ()) -> list[Key]:
        """Bring the window up to date, a control period after the last time.

        Returns:
            Keys pressed and let go since then.
        """
        keys = self.live.show(self._sample(batch, text))
        self._due = max(self._due + self.dt, time.monotonic() - self.dt)  # no catching up
        time.sleep(max(0.0, self._due - time.monotonic()))
        return keys

    def _sample(self, batch: Batch, text: tuple[str, ...]) -> dict[str, Any]:
        s, e = batch.scene, batch.episodes
        if batch.sim.diverged[0] and self._latest is not None:
            return self._latest  # the last that can be drawn
        marker = batch.task.marker(s)
        if marker is not None:
            marker = marker[0, :: -(-marker.shape[1] // _POINTS)].tolist()
        modes = batch.sim.base_modes
        payload = None
        if batch.sim.payload is not None:
            place, attitude, _, _ = (part[0] for part in batch.sim.payload.state)
            payload = [*place.tolist(), *attitude.tolist()]
        self._latest = {
            "payload": payload,
            "episode": [int(k[0]) for k in (e.root, e.index, e.number)],
            "t": float(s.time[0]),
            "y": s.y[0].tolist(),
            "u": None if modes is None else modes[0][0].tolist(),
            "q": s.q[0].tolist(),
            "E": float(s.energy[0]),
            "strain": float(s.strain[0]),
            "w": wrench_on_base(batch)[0].tolist(),
            "marker": marker,
            "text": list(text),
        }
        return self._latest

    def close(self) -> None:
        """End the drawing process; may be called again."""
        self.live.close()
