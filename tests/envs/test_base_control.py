"""Wheels and jets of a satellite as part of an action."""

from dataclasses import replace

import numpy as np
import pytest

from ves_gym._util.params import ParameterError
from ves_gym.envs.build import build_task
from ves_gym.envs.env import VesEnv
from ves_gym.envs.vector import VesVectorEnv
from ves_gym.mechanics.pointing import strongest
from ves_gym.mechanics.vehicle import FREE_FLYING, SERVICER, SERVICER_FLEXIBLE
from ves_gym.simulation.simulator import Simulator

TASK = "free_flyer"
OPEN = replace(SERVICER_FLEXIBLE, pointing=None)
TORQUE = {"kind": "torque", "fraction": 0.02}
BOTH = {"vehicle": OPEN, "base_control": {}}


@pytest.mark.parametrize("backend", ["kernel", "mujoco"])
def test_actions_are_the_torques_and_wrenches_of_a_simulator(backend):
    """Against `Simulator.step` with wheel_torque and base_wrench, moments moved by hand."""
    env = VesVectorEnv(2, TASK, backend=backend, control=TORQUE, **BOTH)
    env.reset(seed=0)
    task, start = env.task, env.batch.sim.last_state
    assert env.single_action_space.shape == (3 + 4 + 6,)
    sim = Simulator(task.system, 2, servo=task.control.servo_for(task.system), backend=backend)
    sim.reset(q=start.q, y=start.y)
    rng, full = np.random.default_rng(1), task.system.arm.column("tau_max")
    for _ in range(40):
        action = rng.uniform(-1, 1, (2, 13))
        env.step(action)
        force, moment = 20.0 * action[:, 7:10], 15.0 * action[:, 10:]
        moment += np.cross([0.0, 0.0, -0.75], force)  # of the body's centre
        wrench = np.column_stack([force, moment])
        sim.step(
            0.02 * full * action[:, :3], wheel_torque=0.2 * action[:, 3:7], base_wrench=wrench
        )
    for ours, direct in zip(env.batch.sim.last_state, sim.last_state, strict=True):
        assert np.abs(ours - direct).max() <= 1e-7  # 20 N to 8 digits: `strongest` is a fit
    speed = env.batch.sim.wheel_speed
    assert np.abs(speed - sim.wheel_speed).max() <= 1e-5 and np.ptp(speed) > 1


def test_single_and_vector_agree_and_info_tells_fuel_and_momentum():
    env, many = VesEnv(TASK, **BOTH), VesVectorEnv(3, TASK, **BOTH)
    first, _ = env.reset(seed=4, options={"index": 2})
    assert np.array_equal(first, many.reset(seed=4)[0][2])
    rng = np.random.default_rng(0)
    for _ in range(30):
        action = rng.uniform(-1, 1, (3, 13))
        seen, reward, *_, info = env.step(action[2])
        all_seen, all_rewards, *_, all_info = many.step(action)
        assert np.array_equal(seen, all_seen[2]) and reward == all_rewards[2]
    assert info["base/propellant"] == all_info["base/propellant"][2] > 0
    assert np.array_equal(info["base/wheel_momentum"], all_info["base/wheel_momentum"][2])
    assert np.allclose(info["base/wheel_momentum"], 0.02 * many.batch.sim.wheel_speed[2])


def test_jets_give_whole_pulses():
    """Just over 0.01 N s a period from two jets each: five periods make the least pulse."""
    env = VesEnv(TASK, vehicle=OPEN, base_control={"wheels": False})
    env.reset(seed=0)
    action, used = np.zeros(9), []
    action[3 + 5] = 0.0101 / 0.0125 / 10  # of the moment about z of two jets of 10 N
    for _ in range(12):
        used.append(env.step(action)[4]["base/propellant"])
    pulse = 2 * 0.05 / (290 * 9.80665)
    assert used[:4] == [0.0] * 4
    assert used[4] == pytest.approx(pulse, rel=0.02)
    assert used[-1] == pytest.approx(2 * pulse, rel=0.02)


def test_the_most_that_jets_give():
    """Pairs of 10 N: 20 N along each axis, a couple of 15 N m about each."""
    most = strongest(SERVICER.jets, SERVICER.body.com)
    assert most == pytest.approx([20.0] * 3 + [15.0] * 3, rel=1e-6)
    one = strongest(SERVICER.jets[:1], SERVICER.body.com)
    assert not one.any()  # pushes one way only


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"base_control": {}}, "jets needs a vehicle|wheels needs a vehicle"),
        ({"base_control": {}, "vehicle": "servicer"}, "without pointing"),
        ({"base_control": {}, "vehicle": "bent"}, "needs a satellite in mode ideal, got"),
        ({"base_control": {"wheels": False}, "vehicle": FREE_FLYING}, "wrench must be six"),
        ({"base_control": {"wheels": False, "jets": False}}, "got neither"),
        ({"base_control": {"wrench": [1.0]}, "vehicle": OPEN}, r"shape \(6,\)"),
        ({"base_control": {"wrench": [0.0] * 6}, "vehicle": OPEN}, "wrench must be > 0"),
        ({"base_control": {"wheel": True}, "vehicle": OPEN}, "unknown key 'wheel'"),
    ],
)
def test_refused(settings, message):
    with pytest.raises(ParameterError, match=message):
        build_task(TASK, **settings)
