"""Write a task: the tool draws a letter in space, and the base is to stay at rest."""

from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt

import ves_gym as vg
from ves_gym.envs import Control, Field, Scene, Start, VesVectorEnv, get_control
from ves_gym.mechanics import tool_frame

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
CORNERS = np.array([[0, 0, 0], [0, 0, 1.0], [0, 0.6, 0], [0, 0.6, 1.0]])  # an N, one high


@vg.register_task("letter")
class Letter(vg.Task):
    """Draw an N with the tool. Solved: root mean square of its distance at most `near`."""

    draws = 3  # uniform numbers that an episode's start takes
    memory = 1  # distance^2 so far, over time [m^2 s]
    compiled = True  # below are formulas of the scene

    control: Control = get_control("acceleration")
    duration: float = 4.0  # [s]
    height: float = 0.1  # [m]
    near: float = 0.01  # distance that costs one [m]

    def start(self, u: Array, **options: Array) -> Start:
        q = np.array([0.0, -0.3, 1.5]) + 0.3 * (2 * u - 1)
        return Start(q=q, goal=tool_frame(self.system.arm, q)[0])  # the letter's first corner

    def target(self, goal: Array, time: Array) -> Array:
        """(n, 3) where the tool is to be [m]: from rest to rest on every stroke."""
        r = np.clip(3 * time[:, None] / self.duration - np.arange(3.0), 0, 1)  # of each stroke
        way: Array = self.height * r**3 * (10 - 15 * r + 6 * r**2) @ np.diff(CORNERS, axis=0)
        return goal + way

    def fields(self) -> tuple[Field, ...]:
        joints, (pose, rate) = np.ones(self.system.arm.n), self.sway
        return (
            Field("joint_angle", "rad", np.pi * joints, "joint angles"),
            Field("joint_rate", "rad/s", joints, "joint rates"),
            Field("base_pose", "m, rad", pose, "pose of the base as measured"),
            Field("base_rate", "m/s, rad/s", rate, "its rate"),
            Field("path", "m", np.full(6, 0.1), "path now and in 0.1 s, less tool measured"),
            Field("time", "s", np.array([self.duration]), "since the start"),
        )

    def observe(self, s: Scene) -> tuple[Array, ...]:
        ahead = [self.target(s.goal, s.time + t) - s.tool_seen for t in (0.0, 0.1)]
        return s.q, s.v, s.y_seen, s.yd_seen, np.concatenate(ahead, axis=1), s.time[:, None]

    def distance2(self, s: Scene) -> Array:
        out: Array = np.sum((s.tool - self.target(s.goal, s.time)) ** 2, axis=1)
        return out

    def remember(self, s: Scene, dt: float) -> None:
        s.memory[:, 0] += self.distance2(s) * dt

    def costs(self, s: Scene, dt: float, last: Mask) -> dict[str, Array]:
        share = dt / self.duration
        error = self.distance2(s) / self.near**2
        return {"error": share * error, "energy": share * s.energy}

    def success(self, s: Scene) -> Mask:
        at_end = s.time > self.duration - 1e-6
        return at_end & (s.memory[:, 0] < self.duration * self.near**2)


gym.register(
    "mine/Letter-v0",
    entry_point="ves_gym.envs:VesEnv",
    vector_entry_point="ves_gym.envs:VesVectorEnv",
    kwargs={"task": "letter"},
)


class Tracer:
    """Moves the tool along the letter, and back to it."""

    name, privileged = "tracer", True

    def settings(self, spec: Any) -> dict[str, Any]:
        return {"control": {"kind": "tool_velocity", "speed": 0.5}}

    def reset(self, env: VesVectorEnv, ids: Any) -> None:
        pass

    def act(self, env: VesVectorEnv, observation: Any) -> Array:
        s, task = env.batch.scene, env.task
        assert isinstance(task, Letter)
        now, soon = (task.target(s.goal, s.time + t) for t in (0.02, 0.04))
        return np.clip(((soon - now) / 0.02 + 4 * (now - s.tool)) / 0.5, -1, 1)


if __name__ == "__main__":
    print(vg.evaluate("mine/Letter-v0", ["zero", "random", Tracer()], episodes=20).table)
