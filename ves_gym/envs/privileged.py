"""What critics and teachers may know beside the observation: the rest of an episode's state."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import Array
from ves_gym.envs.episode import EpisodeBatch
from ves_gym.envs.task import Field


class Privileged:
    """Values that decide an episode and no sensor shows, for every simulation of a batch.

    The return so far and the time left, the true motion of the base with its internal modes,
    the mass and centre of mass of a payload, and what was drawn of the machine. No policy sees
    it: `info["privileged"]` of environments made with `privileged=True` has it, and PPO's
    critic with `critic = "privileged"`.

    Args:
        batch: whose episodes.
    """

    def __init__(self, batch: EpisodeBatch) -> None:
        self.batch = batch

    @cached_property
    def fields(self) -> tuple[Field, ...]:
        """Parts, in order; their values are clipped to +-`Task.CLIP` scales."""
        task, base = self.batch.task, self.batch.system.ideal().base
        M, _, K = (np.diag(k)[6:] for k in base.full())
        soft = np.sqrt(2 / np.where(K > 0, K, 2.0))  # a joule each
        ones, (sway, swaying) = np.ones(1), task.sway
        parts = [
            Field("paid", "1", ones, "return so far, and 1"),
            Field("time_left", "s", np.array([task.duration]), "until the deadline"),
            Field("true_pose", "m, rad", sway, "pose of the base"),
            Field("true_rate", "m/s, rad/s", swaying, "rate of the base"),
            Field("modes", "1", soft, "internal modes of the base"),
            Field("mode_rates", "1/s", np.sqrt(2 / M), "their rates"),
        ]
        if task.interacts:
            parts.append(
                Field("mass", "1", ones, "of the payload, in the one described, less 1")
            )
            parts.append(Field("com", "m", np.full(3, 0.1), "centre of mass of the payload"))
        parts += [
            Field(r.label, "1", np.ones(r.entries), "drawn, -1 to 1 from one end to the other")
            for r in task.randomize
            if r.entries
        ]
        return tuple(k for k in parts if k.size)

    @cached_property
    def _scale(self) -> Array:
        return np.concatenate([k.scale for k in self.fields])

    def __call__(self) -> npt.NDArray[np.float32]:
        """Return the values (n, size) now, in their scales."""
        batch = self.batch
        task, s, e = batch.task, batch.scene, batch.episodes
        paid = e.total / (task.steps if task.goal_fields else 1)
        parts = [1.0 + paid[:, None], (task.duration - s.time)[:, None], s.y, s.yd]
        parts += batch.sim.base_modes or ()
        if task.interacts:
            payload, described = batch.sim.payload, batch.system.payload
            assert payload is not None
            assert described is not None
            parts += [payload.mass[:, None] / described.inertial.mass - 1.0, payload.com]
        pairs = zip(task.randomize, batch.drawn.values(), strict=True)
        parts += [r.context(values) for r, values in pairs if r.entries]
        values = np.hstack(parts) / self._scale
        return np.clip(np.nan_to_num(values), -task.CLIP, task.CLIP).astype(np.float32)
