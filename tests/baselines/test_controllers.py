"""Built-in controllers do what their names say."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from ves_gym._util.params import ParameterError
from ves_gym.baselines.controllers import gains_action
from ves_gym.baselines.evaluate import evaluate, make_vector, ratio, settings_of
from ves_gym.baselines.registry import CONTROLLERS, get_controller
from ves_gym.envs.control import Gains
from ves_gym.envs.registration import IDS as NAMES
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.servo import HIGH_GAINS, PPED_GAINS

REST = "ves/PumaRestToRest-v0"


def run(controller, id=REST, n=3, steps=None, **settings):
    """Environment after `steps` of a controller (to one before the end), the references met."""
    env = gym.make_vec(id, num_envs=n, threads=1, **settings)
    observation, _ = env.reset(seed=[7, 8, 9][:n])
    controller.reset(env, np.arange(n))
    met = [env.batch.scene.ref.copy()]
    for _ in range(steps or env.task.steps):
        action = controller.act(env, observation)
        assert action.shape == (n, env.batch.width) and np.abs(action).max() <= 1
        observation, _, _, _, info = env.step(action)
        met.append(env.batch.scene.ref.copy())
    return env, np.stack(met, axis=1), info


@pytest.mark.parametrize("control", ["guided", "acceleration", "pd_target"])
def test_straight_leads_the_reference_along_the_quintic(control):
    env, met, info = run(get_controller("straight"), control=control, saving=None)
    times = np.arange(env.task.steps + 1) * env.batch.dt
    for i in range(3):
        motion = Motion.straight(met[i, 0, 0], env.batch.scene.goal[i, :3], env.task.duration)
        np.testing.assert_allclose(met[i, :, 0], motion.at(times).q, atol=2e-4)
    assert info["success"].all()


def test_zero_of_control_guided_is_the_straight_line():
    zero, straight = (
        evaluate(get_controller(name), REST, episodes=3, threads=1)
        for name in ("zero", "straight")
    )
    for a, b in zip(zero.rows, straight.rows, strict=True):
        assert a["E_mean"] == pytest.approx(b["E_mean"], rel=1e-6)


def test_direct_is_followed_and_pays():
    """The plan leaves about a third of the straight line's energy (planning benchmark)."""
    direct = get_controller("direct")
    _, met, info = run(direct, control={"kind": "guided", "jerk": 4000.0})
    plan = direct._plan
    assert np.abs(met[:, :, 0] - plan[:, :, 0]).max() < 1e-3
    assert info["success"].all()
    planned = evaluate(get_controller("direct"), REST, episodes=4, threads=1)
    zero = evaluate(get_controller("zero"), REST, episodes=4, threads=1)
    assert ratio(planned, zero).value < 0.6


def test_torque_follows_within_a_few_hundredths_of_a_radian():
    env, _, _ = run(get_controller("straight"), control="torque")
    q, goal = env.batch.scene.q, env.batch.scene.goal[:, :3]
    assert np.abs(q - goal).max() < 0.03


def test_gains_are_set_through_the_control():
    control = Gains()
    for servo in (HIGH_GAINS, PPED_GAINS):
        action = gains_action(control, np.array(servo.kp), np.array(servo.kd))
        kp, kd = control.gains(action[None])
        np.testing.assert_allclose(kp[0], servo.kp)
        np.testing.assert_allclose(kd[0], servo.kd)
    env, _, _ = run(get_controller("pped"), "ves/PumaDamp-v0", control="pd_gains", steps=3)
    np.testing.assert_allclose(env.batch.scene.kp[0], PPED_GAINS.kp)


@pytest.mark.parametrize("name", ["hold", "high", "pped"])
def test_hold_keeps_the_joints_in_place(name):
    env, met, _ = run(get_controller(name), "ves/PumaDamp-v0", steps=160)
    away = np.abs(env.batch.scene.q - met[:, 0, 0]).max()
    assert away < (0.6 if name == "pped" else 0.05)


@pytest.mark.parametrize(
    ("name", "reference", "id", "episodes", "most"),
    [
        ("closing", "resolved", "ves/PumaReach-v0", 20, 0.9),
        pytest.param(
            "closing-pose", "resolved-pose", "ves/PoseReach-v0", 6, 0.95,
            marks=pytest.mark.slow,
        ),
    ],
)  # fmt: skip
def test_laws_without_a_plan_reach_every_target_and_spare_the_base(
    name, reference, id, episodes, most
):
    """Claim: success of the controllers with plans at less energy, episode by episode.

    Tolerance: 0.7 and 0.84 of the reference's energy, medians of 40 episodes.
    """
    some = {"episodes": episodes, "threads": 1}
    law = evaluate(get_controller(name), id, **some)
    other = evaluate(get_controller(reference), id, **some)
    assert all(row["success"] for row in law.rows)
    assert ratio(law, other).value < most


@pytest.mark.parametrize(
    ("name", "id", "control", "message"),
    [
        ("direct", "PumaReach", None, "plans from rest to rest"),
        ("hold", "PumaRestToRest", None, "cannot act through control guided"),
        ("pped", "PumaRestToRest", "acceleration", "has gains of its own"),
        ("lqr", "PumaRestToRest", None, "acts on task lqr, got task rest_to_rest through"),
        ("lqi", "PumaRestToRest", None, "gives torques in tasks damp and lqr"),
        ("tuned", "PumaRestToRest", None, "sets gains through control pd_gains"),
        ("receding", "PumaRestToRest", None, "leads the reference of task damp"),
        ("adaptive", "PumaTrack", None, "leads the reference of task rest_to_rest"),
        ("mppi", "PumaDamp", None, "leads the reference of task rest_to_rest"),
        (
            "resolved",
            "PumaRestToRest",
            None,
            "tasks reach, track, free_flyer, payload_transfer and",
        ),
        ("resolved-pose", "PumaReach", None, "leads the reference of task pose_reach"),
        ("closing-pose", "PumaReach", None, "acts on task pose_reach through"),
        ("closing", "PumaRestToRest", None, "got task rest_to_rest through"),
        ("closing", "PumaTrack", "acceleration", "track through tool_vel"),
        ("servicer", "PumaReach", None, "acts on task servicer_capture"),
        ("compensating", "FreeFlyerReach", None, "leads the arms of task dual_arm_reach"),
    ],
)
def test_a_controller_refuses_what_it_cannot_do(name, id, control, message):
    settings = {} if control is None else {"control": control}
    env = gym.make_vec(f"ves/{id}-v0", num_envs=1, threads=1, **settings)
    env.reset(seed=0)
    with pytest.raises(ParameterError, match=f"controller {name} .*{message}"):
        get_controller(name).reset(env, np.arange(1))


def test_unknown_names_are_refused():
    with pytest.raises(ParameterError, match=r"one of zero, random.*got 'best'"):
        get_controller("best")
    assert all(get_controller(name).name == name for name in CONTROLLERS)


PLANNING = ("hotspot", "refined", "robust", "mppi")  # seconds each


@pytest.mark.parametrize(
    "name",
    [pytest.param(k, marks=[pytest.mark.slow] if k in PLANNING else []) for k in CONTROLLERS],
)
def test_controllers_play_the_tasks_that_they_are_listed_with(name):
    """And refuse the others."""
    played = []
    for task in NAMES:
        id, controller = f"ves/{task}-v0", get_controller(name)
        settings = settings_of(controller, id)
        try:  # a task may have no such control
            env = make_vector(id, 1, AutoresetMode.DISABLED, threads=1, **settings)
            observation, _ = env.reset(seed=[0])
            controller.reset(env, np.arange(1))
            action = controller.act(env, observation)
        except ParameterError:
            continue
        assert action.shape == (1, env.batch.width)
        played.append(task)
    assert tuple(played) == tuple(k for k in NAMES if k in CONTROLLERS[name].tasks)
    assert set(CONTROLLERS[name].tasks) <= set(NAMES)
