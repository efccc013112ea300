"""An episode whose numbers run away ends as a failure, alone."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from tests.envs.walks import actions, each_kind, flat, part, same, walk
from ves_gym.envs.batch import Batch

WILD = 3e9  # rad/s; a millionth of a second later no number is left


def derail(batch: Batch, i: int) -> None:
    """Give simulation i a state that the engine cannot continue."""
    s = batch.sim.state
    batch.sim.reset(q=s.q[i], v=WILD, y=s.y[i], ids=[i])


@each_kind
def test_divergence_ends_the_episode_as_a_failure(name):
    env = gym.make(name).unwrapped
    env.reset(seed=0)
    walk(env, 5, 0)
    derail(env.batch, 0)
    observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
    assert (terminated, truncated) == (True, False)
    assert info["diverged"] is True and info["success"] is False
    assert np.isfinite(reward)
    assert info["reward/failure"] < 0
    assert sum(part(info, "reward").values()) == reward
    assert np.isfinite(flat(observation)).all()
    assert env.observation_space.contains(observation)
    with pytest.raises(gym.error.ResetNeeded):
        env.step(env.action_space.sample())


@each_kind
def test_the_next_reset_is_clean(name):
    """The episode after a divergence is the one that would have come anyway."""
    env, calm = gym.make(name).unwrapped, gym.make(name).unwrapped
    for e in (env, calm):
        e.reset(seed=4)
        walk(e, 5, 0)
    derail(env.batch, 0)
    env.step(env.action_space.sample())
    assert same(env.reset(), calm.reset())
    assert same(walk(env, 20, 1), walk(calm, 20, 1))


@each_kind
@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_neighbours_notice_nothing(name, mode):
    """In a vector, in every autoreset mode; the diverged one joins in again."""
    n, bad = 3, 1
    env, calm = (gym.make_vec(name, num_envs=n, autoreset_mode=mode) for _ in range(2))
    for e in (env, calm):
        e.reset(seed=2)
        walk(e, 5, 0)
    derail(env.batch, bad)
    others = np.arange(n) != bad
    for k, action in enumerate(actions(env, 10, 1)):
        ours, theirs = env.step(action), calm.step(action)
        for a, b in zip(ours[:4], theirs[:4], strict=True):
            assert same(flat(a)[others], flat(b)[others])
        assert np.isfinite(flat(ours[0])).all() and np.isfinite(ours[1]).all()
        assert env.observation_space.contains(ours[0])
        if k:
            continue
        assert ours[2].tolist() == [False, True, False]
        assert ours[4]["diverged"].tolist() == [False, True, False]
        assert ours[4]["_energy/E_mean"].tolist() == [False, True, False]
        if mode is AutoresetMode.SAME_STEP:
            assert np.isfinite(flat(ours[4]["final_obs"])).all()
        if mode is AutoresetMode.DISABLED:
            env.reset(options={"reset_mask": ~others})
    if mode is not AutoresetMode.NEXT_STEP:
        return
    assert not ours[4]["diverged"].any()
    assert np.isfinite(env.batch.sim.state.y).all()


def test_a_safety_stop_ends_the_episode_as_a_failure():
    """In the laboratory: a platform out of its range freezes; its neighbours ride on."""
    env, calm = (gym.make_vec("ves/PumaRestToRestEmulated-v0", num_envs=2) for _ in range(2))
    env.reset(seed=0), calm.reset(seed=0)
    sim = env.batch.sim
    sim.reset(q=sim.state.q[1], y=[0.0, 0.0, 2.0, 0, 0, 0], ids=[1])
    ours, theirs = env.step(np.zeros((2, 3))), calm.step(np.zeros((2, 3)))
    assert ours[2].tolist() == [False, True]
    assert ours[4]["stopped"].tolist() == [False, True]
    assert not ours[4]["diverged"].any() and not ours[4]["success"].any()
    assert ours[4]["reward/failure"][1] < 0
    assert same(ours[0][0], theirs[0][0]) and not theirs[4]["stopped"].any()
    env.step(np.zeros((2, 3)))
    assert not env.step(np.zeros((2, 3)))[4]["stopped"].any()  # the next episode


def test_absurd_settings_diverge_too():
    """A motor a million times too strong, through the front door."""
    strong = {"kind": "torque", "fraction": 1e9}
    env = gym.make_vec("ves/PumaRestToRest-v0", num_envs=2, control=strong)
    env.reset(seed=0)
    action = np.zeros((2, 3))
    action[0] = 1.0
    for _ in range(200):
        observation, reward, terminated, *_ = env.step(action)
        assert np.isfinite(observation).all() and np.isfinite(reward).all()
        assert not terminated[1]
        if terminated[0]:
            break
    assert terminated[0]
