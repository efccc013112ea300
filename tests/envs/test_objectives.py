"""Rewards by objective and costs: what MO-Gymnasium and Safety-Gymnasium expect."""

import gymnasium as gym
import numpy as np
import pytest

from tests.envs.walks import SHORT, actions, each_kind, part, same
from ves_gym._util.params import ParameterError
from ves_gym.baselines.registry import get_controller
from ves_gym.envs.signals import OBJECTIVES, CostBounds


def pair(name, **settings):
    """An environment with a vector and its twin with a scalar."""
    return [gym.make(name, **{**SHORT, **settings}, reward=k) for k in ("vector", "scalar")]


@pytest.mark.parametrize(  # the reward of goal variants is that of their goals
    "name", [k for k in each_kind.args[1] if "Goal" not in str(k)]
)
def test_the_weighted_sum_is_the_scalar_reward(name):
    """In every period of an episode, the last with its tail included, to 1e-12."""
    vector, scalar = pair(name)
    weights = vector.unwrapped.reward_weights
    for env in (vector, scalar):
        env.reset(seed=0)
    over = False
    for action in actions(vector, 100, 0):
        row, number = vector.step(action), scalar.step(action)
        assert row[1] in vector.unwrapped.reward_space and row[1].shape == (len(OBJECTIVES),)
        assert abs(row[1] @ weights - number[1]) <= 1e-12 * max(1.0, abs(number[1]))
        assert same(row[0], number[0]) and same(row[2:], number[2:])
        over = row[2] or row[3]
        if over:
            break
    assert over
    assert not hasattr(scalar.unwrapped, "reward_space")


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_vectors_of_environments_tell_the_same(mode):
    """Row by row as the single environments; rows that begin anew have zeros."""
    settings = {"duration": 0.1, "reward": "vector", "cost": True, "control": "torque"}
    many = gym.make_vec("ves/PumaReach-v0", num_envs=3, autoreset_mode=mode, **settings)
    one = gym.make("ves/PumaReach-v0", **settings)
    many.reset(seed=4)
    rows = []
    for action in np.stack([actions(one, 12, i) for i in range(3)], axis=1):
        _, reward, ended, _, info = many.step(action)
        costs = np.stack([info[k] for k in sorted(info) if k.startswith("cost")], axis=1)
        rows.append((reward, costs))
        assert reward.shape == (3, 3) and costs.shape == (3, 4)
        if ended.all():
            break
    assert len(rows) == 8
    for i in range(3):
        one.reset(seed=4, options={"index": i})
        for action, (reward, costs) in zip(actions(one, 12, i), rows, strict=False):
            _, expected, _, _, info = one.step(action)
            np.testing.assert_array_equal(reward[i], expected)
            told = [info[k] for k in sorted(info) if k.startswith("cost")]
            np.testing.assert_array_equal(costs[i], told)
    if mode == "NextStep":
        _, reward, *_, info = many.step(np.ones(many.action_space.shape, np.float32))
        assert not reward.any() and not info["cost"].any()


def test_time_is_what_has_passed_unsolved():
    """-1 where nothing is solved; with the reference what it took; a failure takes the rest."""
    totals = {}
    for name in ("zero", "resolved"):
        env = gym.make_vec(
            "ves/PumaReach-v0", num_envs=4, reward="vector", autoreset_mode="Disabled"
        )
        observation, _ = env.reset(seed=0)
        controller = get_controller(name)
        controller.reset(env, np.arange(4))
        total, unsolved = np.zeros(4), np.zeros(4)
        for _ in range(env.task.steps):
            action = np.clip(controller.act(env, observation), -1, 1)
            observation, reward, *_, info = env.step(action)
            total += reward[:, OBJECTIVES.index("time")]
            unsolved += ~info["success"]
        np.testing.assert_allclose(total, -unsolved / env.task.steps, rtol=1e-12)
        totals[name] = total
    np.testing.assert_allclose(totals["zero"], -1, rtol=1e-12)
    assert (totals["resolved"] > -0.9).all()
    env = gym.make("ves/FreeFlyerReach-v0", reward="vector", tumble=1e-3)
    env.reset(seed=0)
    total, over = np.zeros(3), False
    while not over:
        _, reward, over, _, info = env.step(np.ones(3))
        total += reward
    assert info["reward/failure"] < -0.9 and env.unwrapped.batch.episodes.steps[0] < 100
    assert total[OBJECTIVES.index("time")] == pytest.approx(-1, rel=1e-12)


@pytest.mark.parametrize("compiled", ["kernel", "mujoco"])
def test_costs_are_of_the_state_that_was_simulated(compiled):
    """Each against the bound, computed here from states before and after; any of them costs."""
    bounds = {"displacement": 5e-3, "acceleration": 0.3}
    env = gym.make(
        "ves/PumaTrack-v0", cost=bounds, backend=compiled, control="torque", duration=1.5
    ).unwrapped
    env.reset(seed=0)
    arm, seen = env.task.system.arm, []
    before = env.batch.scene.yd.copy()
    for action in actions(env, 60, 1):
        *_, terminated, _, info = env.step(action)
        s = env.batch.scene
        beyond = (s.q < arm.column("q_min")) | (s.q > arm.column("q_max"))
        fast = np.abs(s.v) > arm.column("v_max")
        push = np.linalg.norm((s.yd - before)[0, :3]) * 80  # Hz, of the control
        shift = np.linalg.norm(s.y[0, :3])
        expected = {
            "limits": float((beyond | fast).any()),
            "displacement": float(shift > bounds["displacement"]),
            "acceleration": float(push > bounds["acceleration"]),
        }
        assert {k: info[f"cost_{k}"] for k in expected} == expected
        assert info["cost"] == max(expected.values())
        seen.append([expected[k] for k in expected])
        before = s.yd.copy()
        if terminated:
            break
    assert (np.ptp(seen, axis=0) == 1).all()  # every one of them costs, and not always


def test_nothing_is_told_unless_asked_and_nonsense_is_refused():
    env = gym.make("ves/PumaReach-v0")
    env.reset(seed=0)
    assert not any(k.startswith("cost") for k in env.step(np.zeros(3))[4])
    for settings, why in (
        ({"reward": "list"}, "reward must be scalar or vector, got 'list'"),
        ({"cost": "limits"}, "cost must be True, None or bounds by name"),
        ({"cost": {"speed": 1.0}}, "speed"),
        ({"cost": {"displacement": 0.0}}, "displacement must be"),
        (
            {"reward": "vector", "task": "reach_goal", "goal": True},
            "reward is that of its goals",
        ),
    ):
        with pytest.raises(ParameterError, match=why):
            gym.make("ves/PumaReach-v0", **settings)
    assert gym.make(
        "ves/PumaReach-v0", cost={"displacement": 0.1}
    ).unwrapped._signals.bounds == (CostBounds(displacement=0.1))


def test_mo_gymnasium_makes_the_scalar_reward_again():
    """By its wrapper LinearReward."""
    wrappers = pytest.importorskip("mo_gymnasium").wrappers
    vector, scalar = pair("ves/PumaReach-v0")
    linear = wrappers.LinearReward(vector, weight=vector.unwrapped.reward_weights)
    for env in (linear, scalar):
        env.reset(seed=3)
    for action in actions(scalar, 10, 3):
        _, mine, over, _, info = linear.step(action)
        _, theirs, *_, terms = scalar.step(action)
        assert mine == pytest.approx(theirs, rel=1e-12, abs=1e-12)
        assert info["vector_reward"].shape == (3,) and part(terms, "reward")
        if over:
            break
