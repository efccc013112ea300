"""Randomisation: plain data, drawn anew for every episode, told in `info`, off by default."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from tests.envs.walks import KINDS, SHORT, actions, flat, same, walk
from ves_gym._util.params import ParameterError, from_plain, to_plain
from ves_gym.effects import JointViscous
from ves_gym.envs.batch import Batch
from ves_gym.envs.build import build_task
from ves_gym.envs.randomize import Draws, ranges_of
from ves_gym.envs.task import Task
from ves_gym.mechanics.vehicle import BENT_THESIS
from ves_gym.system.system import System

IDEAL = "ves/PumaRestToRest-v0"
EMULATED = "ves/PumaRestToRestEmulated-v0"
VISCOUS = {"joint/viscous": {"damping": ([0.0, 10.0, 0.0], [20.0, 30.0, 5.0])}}
MANY = {
    "gravity/scale": {"error": (-0.01, 0.01)},
    "joint/stribeck": {
        "coulomb": ([0.0] * 3, [5.0] * 3),
        "stiction": ([1.0] * 3, [8.0] * 3),
        "fade_speed": (0.1, 0.4),
    },
    "sensor/rotation": {"angles": ([-0.01] * 3, [0.01] * 3)},
    "platform/bandwidth": {"error": (-0.05, 0.05)},
}

WIDE = {"gravity/delay": {"delay": {"normal": [0.0095, 0.02]}}}
STIFFNESS = {"base/stiffness": {"error": (-0.2, 0.2)}}


def drawn(info):
    return {k: v for k, v in info.items() if k.startswith("randomized/")}


def test_off_by_default_in_space_and_on_in_the_laboratory():
    for name in KINDS:
        ranges = gym.make(name).unwrapped.task.randomize
        assert len(ranges) == 7 * ("Emulated" in name)  # those of `lab`
        assert gym.make(name, randomize={}).unwrapped.task.randomize == ()


def test_values_are_uniform_and_in_force():
    """300 episodes: inside the ranges, spread over them, and what the simulations run with."""
    n = 300
    env = gym.make_vec(IDEAL, num_envs=n, randomize=VISCOUS)
    _, info = env.reset(seed=0)
    (label, values), *others = drawn(info).items()
    assert label == "randomized/joint/viscous.damping" and not others
    low, high = np.array(VISCOUS["joint/viscous"]["damping"])
    share = (values - low) / (high - low)
    assert ((share >= 0) & (share < 1)).all()
    np.testing.assert_allclose(share.mean(axis=0), 0.5, atol=4 * np.sqrt(1 / 12 / n))
    np.testing.assert_allclose(share.var(axis=0), 1 / 12, rtol=0.2)
    for system, row in zip(env.batch.sim.systems, values, strict=True):
        assert system.effects == (JointViscous(damping=tuple(row.tolist())),)


@pytest.mark.parametrize(("name", "ranges"), [(IDEAL, VISCOUS), (EMULATED, MANY)])
def test_an_episode_is_that_of_the_system_drawn(name, ranges):
    """Bit for bit that of an environment whose system has the drawn effects."""
    n = 4
    env = gym.make_vec(name, num_envs=n, randomize=ranges, effects=[])
    env.reset(seed=3)
    start, goals = env.batch.scene.q.copy(), env.batch.scene.goal[:, :3].copy()
    moves = actions(env, 15, 0)
    outcomes = [env.step(a) for a in moves]
    for i, system in enumerate(env.batch.sim.systems):
        assert len(system.effects) == len(ranges)
        none = {"mode": None, "laboratory": None, "effects": None, "randomize": {}}
        alone = gym.make(name, system=system, **none)
        alone.reset(seed=0, options={"q": start[i], "goal": goals[i]})
        for (observation, reward, *_), a in zip(outcomes, moves, strict=True):
            ours = alone.step(a[i])
            assert same(ours[0], observation[i])
            assert same(ours[1], float(reward[i]))


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_every_episode_draws_anew_and_says_so(mode):
    """Also within `step`; and the draw depends on seed, index and number only."""
    env = gym.make_vec(
        EMULATED, num_envs=2, randomize=MANY, autoreset_mode=mode, effects=[], **SHORT
    )
    _, info = env.reset(seed=5)
    seen = [drawn(info)]
    for a in actions(env, 45, 0):
        *_, info = env.step(a)
        numbers = env.episode_id[:, 2].tolist()
        if numbers != [len(seen) - 1] * 2:
            assert numbers == [len(seen)] * 2
            seen.append(drawn(info))
        assert same(drawn(info), seen[-1])  # told in every step
    assert len(seen) == 3
    for i in range(2):
        alone = gym.make(EMULATED, randomize=MANY, effects=[], **SHORT)
        for k, told in enumerate(seen):
            again = alone.reset(**({"seed": 5, "options": {"index": i}} if k == 0 else {}))[1]
            for label, value in drawn(again).items():
                assert same(np.asarray(value), np.asarray(told[label][i])), label
    flatly = [np.concatenate([v[i].ravel() for v in s.values()]) for s in seen for i in (0, 1)]
    assert len({f.tobytes() for f in flatly}) == 6


def test_a_partial_reset_draws_for_those_only():
    env, calm = (gym.make_vec(EMULATED, num_envs=3, randomize=MANY, effects=[]) for _ in "ab")
    env.reset(seed=1), calm.reset(seed=1)
    before = env.batch.sim.systems
    mask = np.array([False, True, False])
    env.reset(options={"reset_mask": mask})
    after = env.batch.sim.systems
    assert [a == b for a, b in zip(before, after, strict=True)] == [True, False, True]
    for ours, theirs in zip(walk(env, 10, 0), walk(calm, 10, 0), strict=True):
        assert same(flat(ours[0])[~mask], flat(theirs[0])[~mask])


@pytest.mark.parametrize(
    ("id", "ranges", "rewired"),
    [
        (EMULATED, MANY, False),
        (EMULATED, WIDE, True),  # a delay longer than the loops have memory for
        (IDEAL, STIFFNESS, False),
    ],
)
def test_beginnings_tried_together_are_those_of_each_alone(id, ranges, rewired):
    """Claim: with forty simulations, whose beginnings are tried in others and copied, episodes
    are to the last bit those of a vector of two, which begin in their own place.

    Also over ends, and for starts that are chosen.
    """
    many, few = (
        gym.make_vec(id, num_envs=n, randomize=ranges, effects=[], **SHORT) for n in (40, 2)
    )
    for env in (many, few):
        env.reset(seed=5)
    moves = np.random.default_rng(0).uniform(-1, 1, (45, *many.action_space.shape))
    for a in moves:
        ours, theirs = many.step(a), few.step(a[:2])
        for x, y in zip(ours[:4], theirs[:4], strict=True):
            assert same(x[:2], y)
    assert many.batch._direct != rewired and not few.batch._direct
    goal = np.full((40, 3), 0.1)
    chosen = many.reset(options={"goal": goal})[0], few.reset(options={"goal": goal[:2]})[0]
    assert same(chosen[0][:2], chosen[1])
    ours, theirs = many.batch.sim.systems[:2], few.batch.sim.systems
    assert ours == theirs


@pytest.mark.parametrize(
    ("ranges", "said"),
    [
        ({"gravity/skale": {"error": (0, 1)}}, "effect must be one of .*gravity/scale"),
        ({"joint/viscous": {"dumping": (0, 1)}}, "has parameters damping, got 'dumping'"),
        ({"joint/viscous": {"damping": ([2.0] * 3, [1.0] * 3)}}, "low <= high"),
        ({"joint/viscous": {"damping": ([0.0] * 3, [1.0] * 2)}}, "one shape"),
        ({"joint/viscous": {"damping": ([0.0] * 2, [1.0] * 2)}}, "3 numbers, one per joint"),
        ({"joint/viscous": {"damping": 3.0}}, r"must be \(low, high\), got 3.0"),
        ({"joint/viscous": 3.0}, r"must map parameters to \(low, high\)"),
        ({"joint/viscous": {"damping": ("a", "b")}}, "numbers"),
        ({"joint/viscous": {"damping": ([0.0] * 3, [float("nan")] * 3)}}, "low <= high"),
        ({"joint/viscous": {"damping": ([-1.0] * 3, [1.0] * 3)}}, r"in \[0, 100\]"),
        ({"joint/viscous": {"damping": ([0.0] * 3, [1e3] * 3)}}, r"in \[0, 100\]"),
        (
            {"sensor/bias": {"force": ([0.0] * 3, [1.0] * 3)}},
            "acts in mode emulated, got mode ideal; .*Emulated-v0",
        ),
    ],
)
def test_bad_ranges_are_refused_before_anything_runs(ranges, said):
    with pytest.raises(ParameterError, match=said):
        Batch(build_task("rest_to_rest", randomize=ranges), 1)


def test_an_effect_is_set_or_drawn_and_sources_have_one_size():
    own = [JointViscous(damping=(1.0,) * 3)]
    with pytest.raises(ParameterError, match="joint/viscous is already in the system"):
        Batch(build_task("rest_to_rest", effects=own, randomize=VISCOUS), 1)
    laws = {
        "gravity/mass": {"error": {"normal": (0, [[0.1]]), "shared": "a"}},
        "gravity/scale": {"error": {"normal": (0, [[0.01, 0.01]]), "shared": "a"}},
    }
    with pytest.raises(
        ParameterError, match=r"a matrix with 1 columns, as the others .*, got 2"
    ):
        Draws(System(vehicle=BENT_THESIS, mode="emulated"), ranges_of(laws))


LAWS = {
    "gravity/scale": {"error": {"normal": (0.001, 0.1)}},
    "gravity/tilt": {
        "angles": {"normal": ([0.0] * 3, [[4e-6, 2e-6, 0], [2e-6, 4e-6, 0], [0, 0, 0]])}
    },
    "sensor/lag": {"error": {"log_uniform": (0.01, 1.0)}},
    "gravity/mass": {"error": {"normal": (0.5, [[0.1, -0.2]]), "shared": "calibration"}},
    "sensor/bias": {
        "force": {"normal": ([0.0] * 3, [[1, 0], [0, 1], [1, 1]]), "shared": "calibration"}
    },
}  # fmt: skip


def test_laws_have_their_moments():
    """2000 draws: mean and covariance, cut-off, one source behind two parameters."""
    draws = Draws(System(vehicle=BENT_THESIS, mode="emulated"), ranges_of(LAWS))
    assert draws.size == 1 + 3 + 1 + 2
    rows = draws.rows(np.random.default_rng(0).random((2000, draws.size)))
    kinds = [e.kind for e in draws.system.effects]
    scale, tilt, lag, mass, force = (
        rows.values[kinds.index(k), name]
        for k, name in (
            ("gravity/scale", "error"),
            ("gravity/tilt", "angles"),
            ("sensor/lag", "error"),
            ("gravity/mass", "error"),
            ("sensor/bias", "force"),
        )
    )
    assert np.abs(scale).max() <= 0.2 < 0.199 + scale.std()  # cut off at the effect's bounds
    np.testing.assert_allclose(scale.std(), 0.0880, atol=0.004)  # of a normal cut at 2 sigma
    np.testing.assert_allclose(np.cov(tilt[:, :2].T), [[4e-6, 2e-6], [2e-6, 4e-6]], atol=4e-7)
    assert not tilt[:, 2].any()
    assert ((lag >= 0.01) & (lag <= 1)).all()
    np.testing.assert_allclose(np.log10(lag).mean(), -1.0, atol=0.05)
    np.testing.assert_allclose(mass, 0.5 + 0.1 * force[:, 0] - 0.2 * force[:, 1], atol=1e-12)
    np.testing.assert_allclose(force[:, 2], force[:, 0] + force[:, 1], atol=1e-12)


def test_laws_are_drawn_alike_alone_and_together():
    """Bit for bit, and the task's plain data gives the task again."""
    some = {"randomize": LAWS, "vehicle": "bent-thesis"}
    together = gym.make_vec(EMULATED, num_envs=9, **some)
    told = drawn(together.reset(seed=2)[1])
    alone = gym.make(EMULATED, **some)
    for i in (0, 8):
        ours = drawn(alone.reset(seed=2, options={"index": i})[1])
        assert same({k: v[i] for k, v in told.items()}, ours)
    task = alone.unwrapped.task
    assert from_plain(Task, task.to_dict(), "task").to_dict() == task.to_dict()
    again = gym.make(gym.envs.registration.EnvSpec.from_json(alone.spec.to_json()))
    assert again.unwrapped.task.to_dict() == task.to_dict()


def test_low_and_high_are_the_uniform_law_and_keep_their_plain_data():
    """The hash of tasks that exist must stay."""
    (short,), (long,) = (
        ranges_of({"gravity/scale": {"error": law}})
        for law in ((-0.1, 0.1), {"uniform": (-0.1, 0.1)})
    )
    assert short == long
    assert to_plain(short) == {
        "effect": "gravity/scale", "parameter": "error", "low": -0.1, "high": 0.1,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("law", "said"),
    [
        ({"nromal": (0, 1)}, "must name one law of uniform.*did you mean \"normal\""),
        ({"normal": (0, 1), "uniform": (0, 1)}, "must name one law"),
        ({"normal": 3.0}, "two entries for normal, got 3.0"),
        ({"normal": (0.0, -1.0)}, "standard deviations >= 0, got -1.0"),
        ({"normal": (1.0, 0.1)}, r"a mean in \[-0.2, 0.2\], got 1.0"),
        ({"normal": (0.0, [1.0, 2.0])}, "or a covariance"),
        ({"normal": (0.0, "wide")}, "needs"),
        ({"normal": (0.0, [[1.0, 2.0]]), "shared": "a"}, "5 standard deviations within"),
        ({"normal": (0.0, 1.0), "shared": "a"}, "a matrix that has a row for each number"),
        ({"normal": (0.0, 1.0), "shared": 3}, "shared must be a name, got 3"),
        ({"log_uniform": (0.0, 0.1)}, "0 < low <= high"),
        ({"log_uniform": (0.1, 0.01)}, "0 < low <= high"),
    ],
)  # fmt: skip
def test_bad_laws_are_refused(law, said):
    with pytest.raises(ParameterError, match=said):
        build_task("rest_to_rest", mode="emulated", randomize={"gravity/scale": {"error": law}})


def test_a_normal_of_many_numbers_is_cut_off_at_the_bounds():
    """Five standard deviations away at least; further out than 53 bits of a number reach."""
    law = {"gravity/scale": {"error": {"normal": (0.0, [[0.03]]), "shared": "a"}}}
    (error,) = ranges_of(law)
    np.testing.assert_array_equal(error.values(np.array([[1e-17], [0.5]])), [-0.2, 0.0])


@pytest.mark.parametrize("name", ["hard", "held-out"])
def test_every_laboratory_can_be_had_with_six_joints(name):
    env = gym.make_vec("ves/PoseReachEmulated-v0", num_envs=2, threads=1, laboratory=name)
    observation, _ = env.reset(seed=0)
    assert np.isfinite(observation).all()
    env.close()
