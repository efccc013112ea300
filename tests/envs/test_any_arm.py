"""Every environment takes any arm: seven joints, limits that leave out zero, its own log."""

import dataclasses

import gymnasium as gym
import numpy as np
import pytest

import ves_gym  # noqa: F401 - registers the environments
from tests.envs.test_divergence import derail
from tests.urdf_arms import chain, six_joint_urdf
from ves_gym._util.params import ParameterError
from ves_gym.envs.build import build_task
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.arm_library import PUMA_560, get_arm
from ves_gym.mechanics.link import Follower
from ves_gym.mechanics.servo import own_gains
from ves_gym.system.runlog import RunLog

IDS = ("PumaRestToRest", "PumaReachGoal", "PumaDamp", "BeamLQR")
MORE = ("PumaReach", "PumaTrack", "FreeFlyerReach")
IIWA, UR5E = get_arm("iiwa14"), get_arm("ur5e")


def bent():
    """The iiwa with an elbow that cannot stretch out."""
    links = list(IIWA.links)
    links[3] = dataclasses.replace(links[3], q_min=-2.0, q_max=-0.1)
    return dataclasses.replace(IIWA, links=tuple(links), name="bent-thesis")


@pytest.mark.parametrize("id", [*IDS, *(pytest.param(k, marks=pytest.mark.slow) for k in MORE)])
def test_seven_joints_in_every_environment(id):
    env = gym.make(f"ves/{id}-v0", arm=bent())
    assert env.action_space.shape == (7,)
    for seed in range(3):
        observation, _ = env.reset(seed=seed)
        assert env.observation_space.contains(observation)
        observation, reward, *_ = env.step(env.action_space.sample())
        assert env.observation_space.contains(observation) and np.isfinite(reward)


def balanced():
    """The UR5e with a counterweight that turns against its shoulder's second joint."""
    weight = dataclasses.replace(UR5E.links[1], d=0.0, a=0.0, name="counterweight")
    follower = Follower(link=weight, ratios=(0.0, -1.0, 0.0, 0.0, 0.0, 0.0), on=0)
    return dataclasses.replace(UR5E, followers=(follower,), name="balanced")


def maker(path):
    return Arm.from_file(six_joint_urdf(path), tip="tool0", collision=False)


def published(n):
    def read(path):
        path.write_text(chain(n, seed=n))
        return Arm.from_file(path, collision=False)

    return read


ARMS = {
    **{f"chain{n}": published(n) for n in (4, 5, 7, 8, 9)},
    **{k: lambda _, k=k: get_arm(k) for k in ("puma560-wrist", "ur5e", "iiwa14", "canadarm2")},
    "maker6": maker,
    "bent": lambda _: bent(),
    "balanced": lambda _: balanced(),
}
REASONS = {  # of tasks, by what they say, for which arms
    "needs an arm of 6 joints or more": {"chain4", "chain5"},
    "and the platform's safety stop acts at": {"canadarm2"},
    "takes an arm of driven joints alone": {"balanced"},
}


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:unstable emulation")  # true of random arms
@pytest.mark.parametrize("name", ARMS)
def test_every_environment_runs_100_steps_on_an_arm_of_4_to_9_joints(name, tmp_path):
    """Or says why its task takes no such arm."""
    arm = ARMS[name](tmp_path / "arm.urdf")
    ran = 0
    for id in [k for k in gym.registry if k.startswith("ves/")]:
        try:
            env = gym.make(id, arm=arm)
        except ParameterError as error:
            assert any(k in str(error) and name in arms for k, arms in REASONS.items()), error
            continue
        env.reset(seed=0)
        env.action_space.seed(0)
        for _ in range(100):
            observation, reward, terminated, truncated, _ = env.step(env.action_space.sample())
            assert env.observation_space.contains(observation) and np.isfinite(reward), id
            if terminated or truncated:
                env.reset()
        env.close()
        ran += 1
    assert ran >= 11


def test_starts_are_inside_the_limits_and_spread():
    arm = bent()
    for task in ("rest_to_rest", "reach", "track", "damp", "free_flyer"):
        built = build_task(task, arm=arm)
        q = built.start(np.random.default_rng(0).random((200, built.draws))).q
        assert (q >= arm.column("q_min")).all() and (q <= arm.column("q_max")).all()
        assert (np.ptp(q, axis=0) > 0.1).all()


def narrow():
    """Three joints, as the PUMA, that cannot go where its episodes go."""
    limits = ((-1.0, 1.0), (0.2, 1.2), (-0.5, 0.5))
    links = [
        dataclasses.replace(link, q_min=low, q_max=high)
        for link, (low, high) in zip(PUMA_560.links, limits, strict=True)
    ]
    return dataclasses.replace(PUMA_560, links=tuple(links), name="narrow")


@pytest.mark.parametrize(
    "task", ["rest_to_rest", "reach", "track", "damp", "free_flyer", "payload_transfer", "lqr"]
)
def test_usual_starts_are_cut_to_the_arm_s_limits(task):
    """Numbers that are given for an arm hold, or are refused."""
    arm = narrow()
    built = build_task(task, arm=arm)
    q = built.start(np.random.default_rng(0).random((200, built.draws))).q
    assert (q >= arm.column("q_min")).all() and (q <= arm.column("q_max")).all()
    assert (np.ptp(q, axis=0) > 0.01).all()
    if task not in ("rest_to_rest", "lqr"):
        with pytest.raises(ParameterError, match="must start within the joint limits"):
            build_task(task, arm=arm, span=[1.0, 0.9, 1.0])


def test_an_arm_that_needs_a_shorter_step_gets_it():
    """Its own, under the servos that the task's control has."""
    light = [
        dataclasses.replace(link, rotor_inertia=0.0, inertial=dataclasses.replace(
            link.inertial, mass=link.inertial.mass / 10,
            inertia=tuple(tuple(x / 10 for x in row) for row in link.inertial.inertia)))
        for link in PUMA_560.links
    ]  # fmt: skip
    arm = dataclasses.replace(PUMA_560, links=tuple(light), name="light")
    for id in ("BeamLQR", "PumaDamp"):
        env = gym.make(f"ves/{id}-v0", arm=arm)
        env.reset(seed=0)
        assert env.unwrapped.batch.system.physics_dt < 2.5e-3


def test_default_controls_are_the_arm_s_own():
    damp = build_task("damp", arm="iiwa14")
    assert damp.control.damping == own_gains(IIWA, damp.system.vehicle).kd
    assert build_task("free_flyer", arm="iiwa14").control.a_max is None
    assert build_task("free_flyer").control.a_max == (6.0, 6.0, 12.0)
    given = {"kind": "acceleration", "a_max": [6.0, 6.0, 12.0]}
    with pytest.raises(ParameterError, match=r"a_max must have shape \(7,\)"):
        build_task("free_flyer", arm="iiwa14", control=given)


def test_an_arm_is_given_by_name_file_data_or_itself(tmp_path):
    path = tmp_path / "arm.urdf"
    IIWA.to_urdf(path)
    assert (
        build_task("reach", arm="iiwa14").system.arm is build_task("reach", arm=IIWA).system.arm
    )
    assert build_task("reach", arm=str(path)).system.arm.n == 7
    assert build_task("reach").system.arm is PUMA_560
    with pytest.raises(ParameterError, match="arm must be one of puma560, canadarm2"):
        build_task("reach", arm="iiwa")


def test_the_log_of_an_episode_has_seven_joints(tmp_path):
    env = gym.make("ves/PumaDamp-v0", arm="iiwa14", dump=str(tmp_path)).unwrapped
    env.reset(seed=0)
    for _ in range(3):
        env.step(np.zeros(7))
    derail(env.batch, 0)
    log = RunLog.load(env.step(np.zeros(7))[-1]["dump"])
    own = own_gains(IIWA, env.batch.system.vehicle)
    assert log.n_joints == 7 and log.meta["controller"]["kd"] == list(own.kd)
