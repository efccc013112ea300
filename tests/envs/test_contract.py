"""What every environment promises, single and vector, whatever its task."""

import copy
import pickle

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import SyncVectorEnv

from tests.envs.walks import (
    SHORT,
    actions,
    each_kind,
    episode,
    every_id,
    flat,
    part,
    same,
    walk,
)
from ves_gym._util.params import ParameterError
from ves_gym.envs.batch import ActionError
from ves_gym.envs.env import VesEnv
from ves_gym.envs.vector import VesVectorEnv

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


@every_id
def test_check_env_has_nothing_to_say(name):
    env = gym.make(name)
    assert type(env) is VesEnv  # no wrapper hides `compute_reward` and `snapshot`
    check_env(env, skip_render_check=True)  # a warning is an error


@every_id
def test_spaces_and_specifications(name):
    """Alike in single and vector environments, and again after JSON."""
    env, native = gym.make(name), gym.make_vec(name, num_envs=2)
    space = gym.spaces.flatten_space(env.observation_space)
    assert space.dtype == env.action_space.dtype == np.float32
    assert np.isfinite(space.low).all() and np.isfinite(space.high).all()
    np.testing.assert_array_equal(
        [env.action_space.low, env.action_space.high],
        [[-1], [1]] * np.ones(env.action_space.shape),
    )
    fields = env.unwrapped.task.fields()
    assert sum(f.size for f in fields) == space.shape[0]
    assert len({f.name for f in fields}) == len(fields)
    assert all(f.name.isidentifier() and f.unit and f.what for f in fields)
    assert all((np.asarray(f.scale) > 0).all() for f in fields)
    sync = SyncVectorEnv([lambda: gym.make(name)])
    assert type(native.unwrapped) is VesVectorEnv
    assert native.single_observation_space == sync.single_observation_space
    assert native.single_action_space == sync.single_action_space
    for made in (env, native, gym.make(name, **SHORT)):
        assert made.spec.max_episode_steps == made.unwrapped.task.steps
        assert "max_episode_steps" not in made.spec.kwargs
    again = gym.make(EnvSpec.from_json(env.spec.to_json()))
    assert again.spec == env.spec and again.unwrapped.task == env.unwrapped.task
    assert same(env.reset(seed=2), again.reset(seed=2))


@every_id
def test_observations_are_inside_and_none_is_constant(name):
    """32 episodes of random actions: every entry varies, no two are the same one.

    But for a payload's two that tell whether it is caught, which random actions never do.
    """
    env = gym.make_vec(name, num_envs=32)
    first, _ = env.reset(seed=5)
    seen = [flat(first)]
    for action in actions(env, min(env.unwrapped.task.steps, 200), 5):
        observation, *_ = env.step(action)
        assert env.observation_space.contains(observation)
        seen.append(flat(observation))
    table = np.concatenate(seen)
    assert table.dtype == np.float32
    columns = env.unwrapped.task.columns
    caught = [np.r_[columns[k]] for k in ("carried", "held") if k in columns]
    table = np.delete(table, np.concatenate([*caught, []]).astype(int), axis=1)
    constant = np.flatnonzero(np.ptp(table, axis=0) == 0)
    assert not len(constant), f"constant entries {constant.tolist()}"
    assert len(np.unique(table, axis=1).T) == table.shape[1]


@each_kind
def test_a_vector_is_a_batch_of_singles(name):
    """Environment i after reset(seed) is the single one after reset(seed, index i)."""
    n = 3
    env = gym.make_vec(name, num_envs=n)
    observation, info = env.reset(seed=6)
    ids = env.episode_id
    moves = actions(env, STEPS, 0)
    outcomes = [env.step(a) for a in moves]
    row = lambda k, i: {name: v[i] for name, v in k.items()} if isinstance(k, dict) else k[i]  # noqa: E731
    for i in range(n):
        alone = gym.make(name)
        first, told = alone.reset(seed=6, options={"index": i})
        assert same(row(observation, i), first) and same(row(info, i), told)
        assert same(ids[i], alone.unwrapped.episode_id)
        for (obs, reward, *flags, info_n), a in zip(outcomes, moves, strict=True):
            o, r, terminated, truncated, info_1 = alone.step(a[i])
            assert same(row(obs, i), o) and same(float(reward[i]), r)
            assert [bool(f[i]) for f in flags] == [terminated, truncated]
            for term, value in part(info_1, "reward").items():
                assert same(info_n[f"reward/{term}"][i], value)
            if terminated or truncated:
                break


@each_kind
def test_autoreset_is_that_of_gymnasiums_loop(name):
    """To the end of an episode and into the next."""
    ours = gym.make_vec(name, num_envs=2, **SHORT)
    theirs = SyncVectorEnv([lambda: gym.make(name, **SHORT)] * 2)
    first, expected = (e.reset(seed=[5, 6])[0] for e in (ours, theirs))
    np.testing.assert_array_equal(flat(first), flat(expected))
    ends = 0
    for a in actions(ours, ours.unwrapped.task.steps + 5, 3):
        outcome, expected = ours.step(a), theirs.step(a)
        np.testing.assert_array_equal(flat(outcome[0]), flat(expected[0]))
        for mine, other in zip(outcome[1:4], expected[1:4], strict=True):
            assert same(mine, other)
        ends += int((outcome[2] | outcome[3]).sum())
    assert ends >= 2


@each_kind
def test_what_is_handed_out_stays_the_callers(name):
    """Nothing handed out changes later or leads back into the environment."""
    for env in (make(name), gym.make_vec(name, num_envs=2, **SHORT)):
        kept = [env.reset(seed=0), *walk(env, 3, 0)]
        copies = copy.deepcopy(kept)
        before = env.unwrapped.snapshot()
        walk(env, 3, 1)
        assert same(kept, copies)
        env.unwrapped.restore(before)
        for observation, *_, info in kept:
            parts = observation.values() if isinstance(observation, dict) else [observation]
            for array in (*parts, *info.values()):
                if isinstance(array, np.ndarray):
                    array[...] = 1
        assert same(env.unwrapped.snapshot(), before)


# -------------------------------------------------------------- reward, info, ends


@each_kind
def test_reward_terms_sum_and_energies_come_at_the_end(name):
    env = make(name)
    for seed in range(3):
        env.reset(seed=seed)
        outcomes = episode(env, seed)
        for _, reward, terminated, truncated, info in outcomes:
            assert type(reward) is float and np.isfinite(reward)
            assert sum(part(info, "reward").values()) == reward
            assert bool(part(info, "energy")) == (terminated or truncated)
            assert type(info["success"]) is bool and type(info["clipped"]) is int
        energy = part(outcomes[-1][4], "energy")
        assert set(energy) == {"E_mean", "E_res", "E_peak", "E_strain_peak", "E_int"}
        assert all(type(e) is np.float64 and np.isfinite(e) and e >= 0 for e in energy.values())
        assert energy["E_peak"] >= energy["E_res"]
        assert outcomes[-1][4]["success_once"] == any(o[4]["success"] for o in outcomes)


@each_kind
def test_stepping_needs_a_reset(name):
    env = make(name)
    with pytest.raises(gym.error.ResetNeeded):
        env.step(env.action_space.sample())
    with pytest.raises(gym.error.Error):
        env.reset(seed=-1)  # does no harm
    env.reset(seed=0)
    episode(env)
    twin = pickle.loads(pickle.dumps(env))
    for over in (env, env, twin):
        with pytest.raises(gym.error.ResetNeeded, match="over"):
            over.step(env.action_space.sample())
    assert same(env.reset(), twin.reset())
    walk(env, 2, 0)
    env.close(), env.close()


# ------------------------------------------------------------------ actions, refusals


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
    yield "texts", ["0"] * shape[0]
    yield "truth values", np.zeros(shape, bool)
    yield "complex", np.zeros(shape, complex)
    yield "objects", [None] * shape[0]
    yield "a mapping", {"torque": 0.0}
    yield "ragged", [[0.0], [0.0, 0.0], *[0.0] * (shape[0] - 2)]
    yield "beyond float64", [10**400] * shape[0]


@each_kind
def test_what_is_refused_changes_nothing(name):
    """Actions, with the place of what is none; options, seeds and indices."""
    env, again = begun(name), begun(name)
    before, task = env.unwrapped.snapshot(), env.unwrapped.task
    for what, action in bad_actions(env.action_space.shape):
        with pytest.raises(ActionError, match=r"finite numbers of shape \(\d+,\), got"):
            pytest.fail(f"{what} was accepted: {env.step(action)}")
        assert same(env.unwrapped.snapshot(), before), what
    wrong = np.zeros(env.action_space.shape)
    wrong[1] = np.nan
    with pytest.raises(ActionError, match=r"got nan at \[1\]"):
        env.step(wrong)
    with pytest.raises(ParameterError, match="unknown option 'colour'; known: index"):
        env.reset(seed=1, options={"colour": "red"})
    for option in task.options:
        with pytest.raises(ParameterError, match=option):
            env.reset(options={option: [[1.0, "x"]]})
    for seed in (-1, 1.5, "x", True, 2**64, [1]):
        with pytest.raises(gym.error.Error, match="seed must be a whole number"):
            env.reset(seed=seed)
    for index in (-1, 1.5, "x", None, True, [0, 1]):
        with pytest.raises(ParameterError, match="index must be a whole number"):
            env.reset(seed=1, options={"index": index})
    with pytest.raises(ParameterError, match="index needs a seed"):
        env.reset(options={"index": 1})
    longer = begun(name, duration=0.5)
    with pytest.raises(ParameterError, match="snapshot is of task"):
        env.unwrapped.restore(longer.unwrapped.snapshot())
    if task.system.contact is None:  # the kernel's alone
        mujoco = begun(name, backend="mujoco")
        with pytest.raises(ParameterError, match=r"backend mujoco, this is .* on backend ker"):
            env.unwrapped.restore(mujoco.unwrapped.snapshot())
    assert same(env.unwrapped.snapshot(), before)
    assert same(walk(env, 5, 1), walk(again, 5, 1))


@each_kind
def test_what_a_vector_refuses_changes_nothing(name):
    env = gym.make_vec(name, num_envs=3)
    with pytest.raises(gym.error.ResetNeeded):
        env.step(env.action_space.sample())
    with pytest.raises(gym.error.ResetNeeded, match="every environment"):
        env.reset(options={"reset_mask": np.array([True, False, True])})
    env.reset(seed=0)
    walk(env, 3, 0)
    before = env.snapshot()
    good = np.zeros(env.action_space.shape)
    wrong = good.copy()
    wrong[2, 1] = np.nan
    for action in (good[:2], good[:, :-1], good[0], 0.0, None, "x", good > 1):
        with pytest.raises(ActionError, match="finite numbers of shape"):
            env.step(action)
    with pytest.raises(ActionError, match=r"nan at \[2, 1\]"):
        env.step(wrong)
    for seed in (-1, 1.5, "x", True, 2**64, [0, 1], [0, 1, -1], [0, "x", 1]):
        with pytest.raises(gym.error.Error, match="seed must be"):
            env.reset(seed=seed)
    for mask in (np.array([True]), np.ones(3), [1, 0, 1], None, np.ones((3, 1), bool), "all"):
        with pytest.raises(gym.error.Error, match="reset_mask must be 3 truth values"):
            env.reset(seed=1, options={"reset_mask": mask})
    with pytest.raises(ParameterError, match="'colour'; known: reset_mask"):
        env.reset(options={"colour": 1})
    with pytest.raises(ParameterError, match=r"options\['q'\] must have shape \(3, "):
        env.reset(options={"q": np.zeros(3)})
    assert same(env.snapshot(), before)
    env.close(), env.close()


@each_kind
def test_out_of_bounds_is_clipped_and_counted(name):
    env, twin = begun(name, 1), begun(name, 1)
    assert env.step(np.zeros(env.action_space.shape))[4]["clipped"] == 0
    twin.step(np.zeros(env.action_space.shape))
    far = np.where(np.arange(env.action_space.shape[0]) % 2, -3.0, 1e30)
    ours, theirs = env.step(far), twin.step(np.sign(far).astype(np.int8).tolist())
    assert same(ours[:4], theirs[:4])
    assert (ours[4]["clipped"], theirs[4]["clipped"]) == (1, 0)
    assert env.step(np.sign(far))[4]["clipped"] == 1  # the bound itself is inside
    env.reset()
    assert env.step(np.sign(far))[4]["clipped"] == 0  # counted per episode
    many = gym.make_vec(name, num_envs=3)
    many.reset(seed=0)
    action = np.zeros(many.action_space.shape)
    action[1] = 2.0
    assert [many.step(action)[4]["clipped"].tolist() for _ in "ab"] == [[0, 1, 0], [0, 2, 0]]


# ------------------------------------------------------------------ reset and seeds


@each_kind
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


@each_kind
def test_episodes_and_seeds_differ_and_are_told(name):
    env, labels = make(name), {r.label for r in make(name).unwrapped.task.randomize}
    starts = []
    for seed, index, number in ((1, 0, 0), (2, 0, 0), (None, 0, 1), (None, 0, 2), (1, 1, 0)):
        options = {"index": index} if index else None
        observation, info = env.reset(seed=seed, options=options)
        starts.append(flat(observation).tobytes())
        assert env.unwrapped.episode_id.tolist() == [seed or 2, index, number]
        assert {k for k in info if k.startswith("randomized/")} == {
            f"randomized/{k}" for k in labels
        }
    seeds = (0, 2**32, 2**63, 2**64 - 1)
    starts += [flat(env.reset(seed=seed)[0]).tobytes() for seed in seeds]
    assert len(set(starts)) == len(starts)
    assert same(env.reset(seed=np.int32(5)), env.reset(seed=5))
    ours, theirs = make(name), make(name)  # without a seed: from the system's entropy
    assert not same(flat(ours.reset()[0]), flat(theirs.reset()[0]))


# --------------------------------------------------------------- copies, snapshots


def continued(env):
    """The rest of this episode and the beginning of the next."""
    return [*episode(env, 7), env.reset(), *walk(env, STEPS, 8), env.np_random.random()]


@each_kind
def test_copies_continue_identically(name):
    env, undisturbed = begun(name), begun(name)
    before = env.unwrapped.snapshot()
    for how in (copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))):
        twin = how(env)
        assert same(twin.unwrapped.snapshot(), before)
        walk(twin, 3, 1)
        assert same(env.unwrapped.snapshot(), before)  # the copy has a life of its own
    twins = copy.deepcopy(env), pickle.loads(pickle.dumps(env))
    expected = continued(undisturbed)
    assert all(same(continued(e), expected) for e in (env, *twins))


@each_kind
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
