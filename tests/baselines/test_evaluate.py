"""Evaluation: the same episodes whatever runs beside them, every one of them counted."""

import json

import gymnasium as gym
import numpy as np
import pytest

from ves_gym._util.params import ParameterError
from ves_gym.baselines.comparison import ControllerComparison
from ves_gym.baselines.evaluate import Evaluation, beats, evaluate, pool, ratio
from ves_gym.baselines.registry import get_controller

REST = "ves/PumaRestToRest-v0"


@pytest.mark.parametrize("id", [REST, "ves/FreeFlyerReach-v0"])
def test_rows_do_not_depend_on_how_many_run_at_once(id):
    """Random actions on a satellite end episodes early: environments go on at other times."""
    some = {"episodes": 7, "seed": 3, "threads": 1, "duration": 1.0}
    whole = evaluate(get_controller("random"), id, **some)
    for n in (1, 3):
        assert evaluate(get_controller("random"), id, n_envs=n, **some).rows == whole.rows
    assert [row["seed"] for row in whole.rows] == list(range(3, 10))


def test_episode_k_is_what_a_single_environment_begins_with_its_seed():
    some = {"episodes": 2, "seed": 5, "threads": 1}
    rows = evaluate(get_controller("zero"), REST, **some, saving=None).rows
    env = gym.make(REST, saving=None)
    for row in rows:
        env.reset(seed=row["seed"])
        total, over = 0.0, False
        while not over:
            _, reward, over, _, info = env.step(np.zeros(3))
            total += reward
        assert row["return"] == pytest.approx(total, rel=1e-12)
        assert row["E_mean"] == info["energy/E_mean"]
        assert row["success"] is info["success"] is True
        assert row["length"] == env.unwrapped.task.steps


def test_failures_count():
    """Full torque throws the arm against its limits."""

    class Push:
        name, privileged = "push", False

        def reset(self, env, ids):
            pass

        def act(self, env, observation):
            return np.ones((env.num_envs, 3))

    found = evaluate(Push(), REST, episodes=5, n_envs=2, threads=1, control="torque")
    assert len(found.rows) == 5 and all(row["failed"] for row in found.rows)
    assert all(row["length"] < 160 for row in found.rows)
    summary = found.summary()
    assert summary["failed"] == 5 and summary["success"].value == 0


def made(values, name="made", group=0, **more):
    rows = [
        {
            "seed": k,
            "group": group,
            "return": v,
            "length": 1,
            "success": v > 0,
            "success_once": True,
            "failed": False,
            **dict.fromkeys(("E_mean", "E_peak", "E_res", "E_int"), abs(v)),
            **more,
        }
        for k, v in enumerate(values)
    ]
    return Evaluation(name, "x", {}, rows)


def test_better_is_what_lies_apart():
    rng = np.random.default_rng(0)
    good, same, bad = (made(rng.normal(m, 1, 50), str(m)) for m in (3.0, 3.1, 1.0))
    assert beats(good, bad) and not beats(bad, good)
    assert not beats(good, same) and not beats(same, good)


def test_ratio_goes_episode_by_episode():
    a, b = made([1.0, 4.0, 9.0], "a"), made([2.0, 4.0, 3.0], "b")
    assert ratio(a, b).value == 1.0  # the median of 0.5, 1, 3
    with pytest.raises(ParameterError, match="share no episode"):
        ratio(a, made([0.0, 0.0, 1e-26]))


def test_policies_of_several_seeds_are_groups():
    both = pool([made([1.0, 2.0]), made([3.0, 4.0])], "two")
    (values,) = both.values("return")  # (episodes, groups): drawn together
    assert values.tolist() == [[1, 3], [2, 4]]
    assert both.summary()["return"]["mean"].value == 2.5
    assert ratio(both, made([1.0, 1.0])).value == 2.5


def test_a_comparison_is_strict_json_even_after_a_divergence(tmp_path):
    lost = made([1.0, 2.0, 3.0], "lost", E_mean=float("inf"), failed=True)
    pair = ControllerComparison((made([1.0, 2.0, 3.0], "good"), lost))
    pair.save(tmp_path / "pair.json")
    result = json.loads((tmp_path / "pair.json").read_text("utf-8"))
    assert result["schema"] == "ves-evaluate/1"
    assert json.loads(json.dumps(pair.to_dict(), allow_nan=False)) == result
    lost = result["controllers"][1]
    assert lost["summary"]["E_mean"]["median"]["value"] is None
    assert lost["rows"][0]["E_mean"] is None and lost["summary"]["failed"] == 3


def test_bad_arguments_are_refused():
    zero = get_controller("zero")
    with pytest.raises(
        ParameterError, match="episodes must be a whole number from 1 to 1000000, got 0"
    ):
        evaluate(zero, REST, episodes=0)
    with pytest.raises(ParameterError, match=r"known: ves/.*PumaRestToRest"):
        evaluate(zero, "ves/Nothing-v0", episodes=1)
    with pytest.raises(ParameterError, match="no vector environment of ves_gym"):
        evaluate(zero, "CartPole-v1", episodes=1)
    with pytest.raises(ParameterError, match="unexpected keyword argument 'speed'"):
        evaluate(zero, REST, episodes=1, speed=3)
