"""Model-predictive control by sampling: futures of a model, averaged by what they cost.

Information-theoretic model-predictive control (MPPI; Williams, Wagener, Goldfain, Drews, Rehg,
Boots and Theodorou, IEEE Int. Conf. on Robotics and Automation 2017): around the present
sequence of actions U, sequences U + B e_k with normal e_k are played on a model, and

    U <- U + B sum_k w_k e_k,    w_k ~ exp(-(S_k - min S) / lambda),

S_k the negative return of the rest of the episode and a price of joints that move at its end.
Here B are cubic B-splines in time, so that the sampled actions are smooth, and lambda is a
share of the spread of S, whatever the reward's scale.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ves_gym._util.params import Array, Index
from ves_gym.baselines.controllers import Follow, episode_rng, require_fit, row_of_step
from ves_gym.envs.rest_to_rest import RestToRest
from ves_gym.envs.task import Task
from ves_gym.envs.vector import VesVectorEnv
from ves_gym.mechanics.motion import basis

_PERIOD = 0.25  # s between decisions
_KNOTS = 12  # splines per episode
_TEMPERATURE = 0.2  # lambda over the standard deviation of the returns
_FADES = 0.85  # of the noise, from one iteration to the next of the same decision
AT_REST = 30.0  # s^2/rad^2: price of half the squared joint rates at the end
_LEAST = 1e-9  # spread of the returns below which all sequences are alike


@dataclass(eq=False)
class Mppi:
    """Plays sampled futures on a model in space without errors, every so often, from now on.

    The model is an environment of `lanes` simulations that `VesVectorEnv.fan_out` puts where
    the episode is, as measured. Between two decisions the actions found last go on.
    """

    name = "mppi"
    privileged = True
    seed: int = 0  # of the noise
    lanes: int = 64  # sampled sequences per iteration
    first: int = 6  # iterations of an episode's first decision
    later: int = 1  # and of each one after it
    noise: float = 0.02  # standard deviation of the splines' coefficients at first
    start: str = "direct"  # planner whose motion the first actions follow; straight: no action
    _model: VesVectorEnv | None = field(default=None, init=False)
    _of: Task | None = field(default=None, init=False)
    _splines: Array = field(default_factory=lambda: np.empty((0, 0)), init=False)  # (steps, k)
    _actions: Array = field(default_factory=lambda: np.empty(0), init=False)  # (n, steps, w)
    _rng: list[np.random.Generator] = field(default_factory=list, init=False)

    def reset(self, env: VesVectorEnv, ids: Index) -> None:
        task = env.task
        fits = isinstance(task, RestToRest) and task.control.level == "reference"
        require_fit(self.name, fits, "leads the reference of task rest_to_rest", env)
        if self._of != task or len(self._actions) != env.num_envs:
            self._model, self._of = nominal_model(env, self.lanes), task
            self._splines = basis(_KNOTS, np.linspace(0.0, 1.0, task.steps), 0)
            self._actions = np.zeros((env.num_envs, task.steps, env.batch.width))
            self._rng = [np.random.default_rng()] * env.num_envs
        for i in ids.tolist():
            self._rng[i] = episode_rng(env, i, self.seed)
            self._actions[i] = 0.0
            if self.start != "straight":
                self._actions[i] = followed(self._model, env, i, self.start, self.seed)

    def act(self, env: VesVectorEnv, observation: Any) -> Array:
        every = max(round(_PERIOD / env.batch.dt), 1)
        steps = env.batch.episodes.steps
        for i, k in enumerate(steps.tolist()):
            if k % every == 0 and k < env.task.steps:
                self._improve(env, i, k)
        return np.clip(row_of_step(env, self._actions), -1.0, 1.0)

    def _improve(self, env: VesVectorEnv, i: int, k: int) -> None:
        """Decide anew on the actions of environment i from period k on."""
        model, planned = self._model, self._actions[i, k:]
        assert model is not None
        splines, scale = self._splines[k:], self.noise
        for _ in range(self.later if k else self.first):
            shape = (self.lanes, _KNOTS, planned.shape[1])
            e = scale * self._rng[i].standard_normal(shape)
            e[0] = 0.0  # the present sequence itself
            model.fan_out(env, i)
            play(model, np.clip(planned + splines @ e, -1.0, 1.0))
            cost = episode_costs(model) + residual_motion_cost(model)
            finite = cost[np.isfinite(cost)]  # the others have failed
            spread = float(finite.std()) if len(finite) else 0.0
            if not spread > _LEAST:
                break
            weights = np.exp(-(cost - finite.min()) / (_TEMPERATURE * spread))
            weights /= weights.sum()
            planned += splines @ np.einsum("k,kmj->mj", weights, e)
            scale *= _FADES


def nominal_model(env: VesVectorEnv, lanes: int) -> VesVectorEnv:
    """Return a model of so many simulations of an environment: in space, without errors."""
    task = replace(env.task, system=env.task.system.ideal(), randomize=())
    model = VesVectorEnv(lanes, task, threads=1)
    model.reset(seed=0)
    return model


def play(model: VesVectorEnv, actions: Array) -> None:
    """Play actions (lanes, periods, width) on every lane, each until its episode ends."""
    running = np.ones(model.num_envs, bool)
    for k in range(actions.shape[1]):
        _, last, truncated, _ = model.batch.step(actions[:, k], ~running)
        running &= ~(last | truncated)
        if not running.any():
            break


def episode_costs(model: VesVectorEnv) -> Array:
    """Return J (lanes,) of episodes so far (`episode.judge`); infinite where they failed."""
    e = model.batch.episodes
    return np.where(e.total > -1 + 1e-9, e.cost + e.missing[:, 1], np.inf)


def residual_motion_cost(model: VesVectorEnv) -> Array:
    """Return a price (lanes,) of joints that move at the end, which the reward has not."""
    out: Array = AT_REST / 2 * (model.batch.scene.v**2).sum(axis=1)
    return np.nan_to_num(out, nan=np.inf)


def followed(
    model: VesVectorEnv | None, env: VesVectorEnv, i: int, planner: str, seed: int
) -> Array:
    """Return the actions (steps, width) by which `Follow` leads environment i, just begun."""
    assert model is not None
    follow = Follow(planner, planner, seed)
    model.fan_out(env, i)
    follow.reset(model, np.arange(1))
    follow._plan = np.repeat(follow._plan[:1], model.num_envs, axis=0)
    out = []
    for _ in range(env.task.steps):
        out.append(follow.act(model, None))
        model.batch.step(out[-1])
    return np.stack(out, axis=1)[0]
