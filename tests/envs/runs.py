"""Whole episodes under a controller, and observations in their units."""

from __future__ import annotations

from types import SimpleNamespace

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
    """n whole episodes: environment, returns, J by name, the last info."""
    if hasattr(controller, "settings"):
        spec = SimpleNamespace(kwargs={"task": task, **settings})
        settings = {**controller.settings(spec), **settings}
    env = VesVectorEnv(n, task, autoreset_mode="Disabled", **settings)
    observation, _ = env.reset(seed=seed)
    controller.reset(env, np.arange(n))
    total, costs = np.zeros(n), {}
    for _ in range(env.task.steps):
        before = env.batch.episodes.cost.copy()
        action = controller.act(env, observation)
        observation, reward, terminated, truncated, info = env.step(action)
        terms = part(info, "reward")
        del terms["success"]
        assert not terms.pop("failure").any()
        way = terms.pop("missing", None)
        after, missing = env.batch.episodes.cost, env.batch.episodes.missing[:, 1]
        for name, term in terms.items():  # the inverse of `episode.judge`
            cost = -term * (1 + before + missing) * (1 + after + missing)
            costs[name] = costs.get(name, 0.0) + cost
        total += reward
    assert terminated.all() and not truncated.any()
    if way is not None:
        costs["missing"] = missing
    np.testing.assert_allclose(sum(costs.values()), cost_of(total, info["success"]), rtol=1e-9)
    return env, total, costs, info


def cost_of(returns, solved):
    """What episodes that did not fail cost, J, from what they returned (`episode.judge`)."""
    return 1 / (1 + returns - solved) - 1


def unscaled(task, observation):
    """Fields of observations (..., size) by name, in their units."""
    out, at = {}, 0
    for field in task.fields():
        out[field.name] = observation[..., at : at + field.size] * field.scale
        at += field.size
    return out
