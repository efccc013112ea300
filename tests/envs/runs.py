"""Whole episodes under a controller, and observations in their units."""

from __future__ import annotations

import numpy as np

from tests.envs.walks import part
from ves_gym.baselines.resolved import Resolved
from ves_gym.envs.vector import VesVectorEnv

EMULATED = {"mode": "emulated", "laboratory": "nominal"}


class Blind(Resolved):
    """The plan of resolved motion, which takes back nothing of what the base does."""

    def __init__(self):
        super().__init__("blind")

    def act(self, env, observation):
        scene = env.batch.scene
        seen = scene.y_seen, scene.yd_seen
        scene.y_seen = scene.yd_seen = np.zeros_like(scene.y)
        action = super().act(env, observation)
        scene.y_seen, scene.yd_seen = seen
        return action


def controlled(controller, n, task, seed=0, **settings):
    """n whole episodes: environment, returns, sums of the reward's terms, the last info."""
    env = VesVectorEnv(n, task, autoreset_mode="Disabled", **settings)
    observation, _ = env.reset(seed=seed)
    controller.reset(env, np.arange(n))
    total, terms = np.zeros(n), {}
    for _ in range(env.task.steps):
        action = controller.act(env, observation)
        observation, reward, terminated, truncated, info = env.step(action)
        total += reward
        for name, term in part(info, "reward").items():
            terms[name] = terms.get(name, 0.0) + term
    assert (terminated | truncated).all()
    return env, total, terms, info


def unscaled(task, observation):
    """Fields of observations (..., size) by name, in their units."""
    out, at = {}, 0
    for field in task.fields():
        out[field.name] = observation[..., at : at + field.size] * field.scale
        at += field.size
    return out
