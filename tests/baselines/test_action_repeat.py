"""`ActionRepeat`: Gymnasium's contract of same-step autoreset."""

import gymnasium as gym
import numpy as np

from ves_gym.baselines import ActionRepeat

ID = "ves_gym:ves/PumaDamp-v0"
SHORT = {"duration": 0.5, "tail": 0.5}  # 40 periods
DRAWN = {"randomize": {"payload/mass": {"mass": (0.0, 5.0)}}, "privileged": True}


def made(mode="NextStep", id=ID, **settings):
    return gym.make_vec(id, num_envs=4, autoreset_mode=mode, threads=1, **SHORT, **settings)


def test_every_step_has_the_info_of_the_vector_environment_with_same_step_autoreset():
    """Reference: `VesVectorEnv` with SameStep, which follows Gymnasium's vectors."""
    known, env = made("SameStep", **DRAWN), ActionRepeat(made(**DRAWN))
    action = np.full((4, 3), 0.3)
    for k in (known, env):
        k.reset(seed=3)
    ends = 0
    for _ in range(60):
        (*_, expected), (*_, over, _, info) = known.step(action), env.step(action)
        extra = {"endings", "episode", "_episode"} if over.any() else set()
        assert set(info) == set(expected) | extra
        for name in set(expected) - {"final_info"}:
            np.testing.assert_array_equal(info[name], expected[name], name)
        for name, values in expected.get("final_info", {}).items():
            np.testing.assert_array_equal(info["final_info"][name], values, name)
        ends += over.sum()
    assert ends == 4


def test_final_info_is_of_the_period_in_which_each_episode_ended():
    """Torque throws the arms against their limits at different times within a held action.

    Reference: `VesVectorEnv`, stepped period by period.
    """
    settings = {"control": "torque", "id": "ves_gym:ves/PumaReach-v0"}
    known, env = made("SameStep", **settings), ActionRepeat(made(**settings), hold=40)
    for k in (known, env):
        k.reset(seed=3)
    action = np.sign(np.random.default_rng(0).uniform(-1, 1, (4, 3)))
    *_, over, _, info = env.step(action)
    final, ends = info["final_info"], {}
    for period in range(40):
        *_, ended, _, expected = known.step(action)
        for i in set(np.flatnonzero(ended)) - set(ends):
            ends[i] = period
            for name, values in expected["final_info"].items():
                np.testing.assert_array_equal(final[name][i], values[i], name)
    assert len(set(ends.values())) > 1
    np.testing.assert_array_equal(np.flatnonzero(over), sorted(ends))
