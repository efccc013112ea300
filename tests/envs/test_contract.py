"""What every environment promises, whatever its task."""

import copy
import pickle

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from tests.envs.walks import IDS, SHORT, actions, episode, flat, part, same, walk
from ves_gym._util.params import ParameterError
from ves_gym.envs.batch import ActionError

each_id = pytest.mark.parametrize("name", IDS)
STEPS = 12


def make(name, **settings):
    """An environment of short episodes."""
    return gym.make(name, **{**SHORT, **settings})


def begun(name, seed=0, **settings):
    """One in the middle of an episode."""
    env = make(name, **settings)
    env.reset(seed=seed)
    walk(env, STEPS, seed)
    return env


# ----------------------------------------------------------------------- Gymnasium


@each_id
def test_check_env_has_nothing_to_say(name):
    check_env(gym.make(name).unwrapped, skip_render_check=True)  # a warning is an error


@each_id
def test_spaces(name):
    env = gym.make(name)
    np.testing.assert_array_equal(env.action_space.low, -1)
    np.testing.assert_array_equal(env.action_space.high, 1)
    assert env.action_space.dtype == np.float32
    space = gym.spaces.flatten_space(env.observation_space)
    assert space.dtype == np.float32
    assert np.isfinite(space.low).all() and np.isfinite(space.high).all()
    fields = env.unwrapped.task.fields()
    assert sum(f.size for f in fields) == space.shape[0]
    assert len({f.name for f in fields}) == len(fields)
    assert all(f.name.isidentifier() and f.unit and f.what for f in fields)
    assert all((np.asarray(f.scale) > 0).all() for f in fields)


@each_id
def test_observations_are_inside_and_none_is_constant(name):
    """32 episodes of random actions: every entry varies, no two are the same one."""
    env = gym.make_vec(name, num_envs=32)
    first, _ = env.reset(seed=5)
    seen = [flat(first)]
    for action in actions(env, min(env.unwrapped.task.steps, 200), 5):
        observation, *_ = env.step(action)
        assert env.observation_space.contains(observation)
        seen.append(flat(observation))
    table = np.concatenate(seen)
    assert table.dtype == np.float32
    constant = np.flatnonzero(np.ptp(table, axis=0) == 0)
    assert not len(constant), f"constant entries {constant.tolist()}"
    for i in range(table.shape[1]):
        for k in range(i):
            assert not np.array_equal(table[:, i], table[:, k]), f"entries {k} and {i} agree"


@each_id
def test_observations_stay_the_callers(name):
    """Nothing handed out changes later or leads back into the environment."""
    env = make(name)
    kept = [env.reset(seed=0), *walk(env, 3, 0)]
    copies = copy.deepcopy(kept)
    before = env.unwrapped.snapshot()
    walk(env, 3, 1)
    assert same(kept, copies)
    env.unwrapped.restore(before)
    for observation, *_ in kept:
        for array in observation.values() if isinstance(observation, dict) else [observation]:
            array[:] = 7.0
    assert same(env.unwrapped.snapshot(), before)


# -------------------------------------------------------------- reward, info, ends


@each_id
def test_reward_terms_sum_and_energies_come_at_the_end(name):
    env = make(name)
    for seed in range(3):
        env.reset(seed=seed)
        outcomes = episode(env, seed)
        for _, reward, terminated, truncated, info in outcomes:
            terms = part(info, "reward")
            assert type(reward) is float and np.isfinite(reward)
            assert sum(terms.values()) == reward
            assert bool(part(info, "energy")) == (terminated or truncated)
            assert type(info["success"]) is bool and type(info["clipped"]) is int
        energy = part(outcomes[-1][4], "energy")
        assert set(energy) == {"E_mean", "E_res", "E_peak", "E_strain_peak", "E_int"}
        assert all(type(e) is np.float64 and np.isfinite(e) and e >= 0 for e in energy.values())
        assert energy["E_peak"] >= energy["E_res"]
        assert outcomes[-1][4]["success_once"] == any(o[4]["success"] for o in outcomes)


@each_id
def test_reset_tells_the_episode(name):
    env = make(name)
    for expected in ([8, 0, 0], [8, 0, 1]):
        _, info = env.reset(seed=8 if expected[2] == 0 else None)
        assert env.unwrapped.episode_id.tolist() == expected
        randomized = {k for k in info if k.startswith("randomized/")}
        assert randomized == {f"randomized/{r.label}" for r in env.unwrapped.task.randomize}


@each_id
def test_stepping_needs_a_reset(name):
    env = make(name)
    with pytest.raises(gym.error.ResetNeeded):
        env.step(env.action_space.sample())
    env.reset(seed=0)
    episode(env)
    for _ in range(2):
        with pytest.raises(gym.error.ResetNeeded, match="over"):
            env.step(env.action_space.sample())
    env.reset()
    walk(env, 2, 0)


@each_id
def test_close_may_be_called_again(name):
    env = begun(name)
    env.close()
    env.close()


# ------------------------------------------------------------------------- actions


def bad_actions(shape):
    """(what, value) no environment can take."""
    good = np.zeros(shape, np.float32)
    for bad in (np.nan, np.inf, -np.inf):
        wrong = good.copy()
        wrong[-1] = bad
        yield str(bad), wrong
    yield "too long", np.zeros(shape[0] + 1)
    yield "too short", np.zeros(shape[0] - 1)
    yield "a row too many", np.zeros((1, *shape))
    yield "a number", 0.5
    yield "None", None
    yield "text", "left"
    yield "texts", ["0"] * shape[0]
    yield "truth values", np.zeros(shape, bool)
    yield "complex", np.zeros(shape, complex)
    yield "objects", [None] * shape[0]
    yield "a mapping", {"torque": 0.0}
    yield "ragged", [[0.0], [0.0, 0.0], *[0.0] * (shape[0] - 2)]
    yield "beyond float64", [10**400] * shape[0]


@each_id
def test_a_bad_action_is_refused_and_changes_nothing(name):
    env = begun(name)
    before = env.unwrapped.snapshot()
    for what, action in bad_actions(env.action_space.shape):
        with pytest.raises(ActionError, match="finite numbers of shape"):
            pytest.fail(f"{what} was accepted: {env.step(action)}")
        assert same(env.unwrapped.snapshot(), before), what
    again = begun(name)
    assert same(walk(env, 5, 1), walk(again, 5, 1))


@each_id
def test_a_bad_action_says_where(name):
    env = begun(name)
    action = np.zeros(env.action_space.shape)
    action[1] = np.nan
    with pytest.raises(ActionError, match=r"of shape \(\d+,\), got nan at \[1\]"):
        env.step(action)


@each_id
def test_out_of_bounds_is_clipped_and_counted(name):
    env, twin = begun(name, 1), begun(name, 1)
    assert env.step(np.zeros(env.action_space.shape))[4]["clipped"] == 0
    twin.step(np.zeros(env.action_space.shape))
    far = np.where(np.arange(env.action_space.shape[0]) % 2, -3.0, 1e30)
    ours, theirs = env.step(far), twin.step(np.sign(far))
    assert same(ours[:4], theirs[:4])
    assert (ours[4]["clipped"], theirs[4]["clipped"]) == (1, 0)
    assert env.step(np.sign(far))[4]["clipped"] == 1  # the bound itself is inside
    assert env.reset()[0] is not None
    assert env.step(np.sign(far))[4]["clipped"] == 0  # counted per episode


@each_id
def test_any_real_dtype_will_do(name):
    env = begun(name)
    given = np.where(np.arange(env.action_space.shape[0]) % 2, -1, 1)
    mark, results = env.unwrapped.snapshot(), []
    for kind in (np.float64, np.float32, np.float16, np.int8, np.int64, list):
        env.unwrapped.restore(mark)
        results.append(env.step(given.tolist() if kind is list else given.astype(kind)))
    assert all(same(r, results[0]) for r in results)


# ------------------------------------------------------------------ reset and seeds


@each_id
def test_unknown_options_are_refused_with_the_known_ones(name):
    env = begun(name)
    before = env.unwrapped.snapshot()
    with pytest.raises(ParameterError, match="unknown option 'colour'; known: index"):
        env.reset(seed=1, options={"colour": "red"})
    for option in env.unwrapped.task.options:
        with pytest.raises(ParameterError, match=option):
            env.reset(options={option: [[1.0, "x"]]})
    assert same(env.unwrapped.snapshot(), before)


@each_id
def test_bad_seeds_and_indices_are_refused(name):
    env = begun(name)
    before = env.unwrapped.snapshot()
    for seed in (-1, 1.5, "x", True, 2**64, [1]):
        with pytest.raises(gym.error.Error, match="seed must be a whole number"):
            env.reset(seed=seed)
    for index in (-1, 1.5, "x", None, True, [0, 1]):
        with pytest.raises(ParameterError, match="index must be a whole number"):
            env.reset(seed=1, options={"index": index})
    with pytest.raises(ParameterError, match="index needs a seed"):
        env.reset(options={"index": 1})
    assert same(env.unwrapped.snapshot(), before)


@each_id
def test_a_refused_first_reset_does_no_harm(name):
    env = make(name)
    with pytest.raises(gym.error.Error):
        env.reset(seed=-1)
    env.reset(seed=2)
    walk(env, 2, 0)


@each_id
def test_seeds_of_any_size_and_kind(name):
    env = make(name)
    assert same(env.reset(seed=np.int32(5)), env.reset(seed=5))
    seeds = (0, 1, 2**32, 2**63, 2**64 - 1)
    starts = [flat(env.reset(seed=seed)[0]) for seed in seeds]
    assert len({s.tobytes() for s in starts}) == len(seeds)


@each_id
def test_a_seeded_reset_restores_everything(name):
    """Two whole episodes after equal seeds agree bit for bit after any history."""
    fresh, used = make(name), begun(name, 3)
    walk(used, 30, 4)
    expected = []
    for env in (fresh, used):
        run = [env.reset(seed=11), *episode(env, 1), env.reset(), *walk(env, STEPS, 2)]
        expected.append(run)
    assert same(*expected)
    assert same(fresh.unwrapped.snapshot(), used.unwrapped.snapshot())


@each_id
def test_episodes_and_seeds_differ(name):
    env = make(name)
    starts = [flat(env.reset(seed=s)[0]).tobytes() for s in (1, 2)]
    starts += [flat(env.reset()[0]).tobytes() for _ in range(2)]
    starts += [flat(env.reset(seed=1, options={"index": 1})[0]).tobytes()]
    assert len(set(starts)) == len(starts)
    ours, theirs = make(name), make(name)  # without a seed: from the system's entropy
    assert not same(flat(ours.reset()[0]), flat(theirs.reset()[0]))


# --------------------------------------------------------------- copies, snapshots


def continued(env):
    """The rest of this episode and the beginning of the next."""
    return [*episode(env, 7), env.reset(), *walk(env, STEPS, 8), env.np_random.random()]


@each_id
@pytest.mark.parametrize("how", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_copies_continue_identically(name, how):
    env, undisturbed = begun(name), begun(name)
    before = env.unwrapped.snapshot()
    twin = how(env)
    assert same(env.unwrapped.snapshot(), before)
    assert same(twin.unwrapped.snapshot(), before)
    walk(twin, 3, 1)
    assert same(env.unwrapped.snapshot(), before)  # the copy has a life of its own
    twin = how(env)
    results = [continued(e) for e in (env, twin, undisturbed)]
    assert same(results[0], results[1])
    assert same(results[0], results[2])


@each_id
def test_copies_before_the_first_reset_and_after_the_end(name):
    env = make(name)
    twin = copy.deepcopy(env)
    assert same(env.reset(seed=1), twin.reset(seed=1))
    episode(env)
    twin = pickle.loads(pickle.dumps(env))
    with pytest.raises(gym.error.ResetNeeded):
        twin.step(env.action_space.sample())
    assert same(env.reset(), twin.reset())


@each_id
def test_snapshots_lead_back(name):
    """To the same point of the same episode, once and again, here or in another process."""
    env = begun(name)
    mark = env.unwrapped.snapshot()
    first = [*episode(env, 7), env.reset()]
    env.unwrapped.restore(mark)
    assert same(env.unwrapped.snapshot(), mark)
    assert same([*episode(env, 7), env.reset()], first)
    other = make(name)
    other.reset(seed=99)
    other.unwrapped.restore(pickle.loads(pickle.dumps(mark)))
    assert same([*episode(other, 7), other.reset()], first)


@each_id
def test_a_snapshot_of_something_else_is_refused(name):
    env, longer = begun(name), begun(name, duration=0.5)
    before = env.unwrapped.snapshot()
    with pytest.raises(ParameterError, match="snapshot is of task"):
        env.unwrapped.restore(longer.unwrapped.snapshot())
    mujoco = begun(name, backend="mujoco")
    with pytest.raises(
        ParameterError, match=r"on backend mujoco, this is .* on backend kernel"
    ):
        env.unwrapped.restore(mujoco.unwrapped.snapshot())
    assert same(env.unwrapped.snapshot(), before)


# --------------------------------------------------------------------- goal variants


@each_id
def test_goal_variants_compute_their_reward(name):
    """HER: rewards of goals, any leading axes, and the same as those that `step` returns."""
    task = make(name).unwrapped.task
    if task.goal_fields is None:
        with pytest.raises(ParameterError, match="no goal-conditioned variant"):
            make(name, goal=True)
        return
    env = make(name, goal=True)
    check_env(env.unwrapped, skip_render_check=True)
    env.reset(seed=0)
    rows = episode(env)
    achieved = np.stack([o[0]["achieved_goal"] for o in rows])
    desired = np.stack([o[0]["desired_goal"] for o in rows])
    infos = [o[4] for o in rows]
    whole = env.unwrapped.compute_reward(achieved, desired, np.array(infos))
    assert whole.shape == (len(rows),)
    single = [
        env.unwrapped.compute_reward(*args)
        for args in zip(achieved, desired, infos, strict=True)
    ]
    np.testing.assert_array_equal(whole, single)
    np.testing.assert_allclose(whole, [o[1] for o in rows], rtol=1e-6, atol=1e-6)
