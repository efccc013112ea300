"""Sampling on a fanned-out model finds motions that leave the base calmer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from ves_gym._util.params import ParameterError
from ves_gym.baselines.evaluate import evaluate, make_vector
from ves_gym.baselines.mppi import Mppi, nominal_model, returns
from ves_gym.baselines.registry import get_controller
from ves_gym.envs.vector import VesVectorEnv

REST = "ves/PumaRestToRest-v0"


def test_returns_of_the_model_are_those_of_the_environment() -> None:
    """Claim: what the model of a machine as described earns is what the environment earns.

    Reference: the environment, played with the same actions from the same moment on.
    """
    env = make_vector(REST, 2, AutoresetMode.DISABLED, threads=1)
    env.reset(seed=4)
    rng = np.random.default_rng(0)
    actions = rng.uniform(-0.2, 0.2, (2, env.task.steps, 3))
    for k in range(40):
        env.step(actions[:, k])
    model = nominal_model(env, 3)
    model.fan_out(env, 1)
    found = returns(model, np.repeat(actions[1:, 40:], 3, axis=0))
    total = 0.0
    for k in range(40, env.task.steps):
        total += env.step(actions[:, k])[1][1]
    np.testing.assert_allclose(found, total, rtol=1e-9)


def test_a_few_samples_pay() -> None:
    """Claim: 10 iterations of 32 samples leave less than 0.7 of the straight line's energy, and
    the same seed finds the same actions.

    Reference: the straight line, with which the search begins.
    """
    straight = evaluate(get_controller("straight"), REST, episodes=1, threads=1)
    twice = [
        evaluate(
            Mppi(3, lanes=32, first=10, later=0, noise=0.15, start="straight"),
            REST,
            episodes=1,
            threads=1,
        )
        for _ in range(2)
    ]
    assert twice[0].rows[0]["E_mean"] == twice[1].rows[0]["E_mean"]
    assert twice[0].rows[0]["E_mean"] < 0.7 * straight.rows[0]["E_mean"]


def test_a_plan_to_start_from_is_kept() -> None:
    """Claim: begun from a plan, the actions are the plan's where nothing is improved on it."""

    class Counting(Mppi):
        decisions = 0

        def _improve(self, env: VesVectorEnv, i: int, k: int) -> None:
            self.decisions += 1
            super()._improve(env, i, k)

    start = Counting(lanes=2, first=2, later=0, noise=1e-9, start="direct")
    found, plan = (
        evaluate(k, REST, episodes=1, threads=1) for k in (start, get_controller("direct"))
    )
    assert found.rows[0]["E_mean"] == pytest.approx(plan.rows[0]["E_mean"], rel=1e-3)
    assert start.decisions == 8


def test_what_it_cannot_do_is_refused() -> None:
    env = make_vector("ves/PumaDamp-v0", 1, AutoresetMode.DISABLED, threads=1)
    env.reset(seed=0)
    with pytest.raises(ParameterError, match="leads the reference of task rest_to_rest"):
        Mppi().reset(env, np.arange(1))
    with pytest.raises(ParameterError, match="lanes >= 2"):
        Mppi(lanes=1)
    model = nominal_model(make_vector(REST, 1, AutoresetMode.DISABLED, threads=1), 2)
    assert replace(model.task, randomize=()) == model.task
