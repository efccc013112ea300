"""The energy account is kept whatever is recorded; a run that it doubts is no answer."""

import dataclasses

import numpy as np
import pytest

import ves_gym as vg
from ves_gym._util.params import ParameterError
from ves_gym.effects.joint_friction import JointViscous
from ves_gym.envs.env import VesEnv
from ves_gym.envs.vector import VesVectorEnv
from ves_gym.mechanics.arm_library import get_arm
from ves_gym.mechanics.link import Inertial, diagonal
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.servo import OWN_SERVO, JointServo
from ves_gym.mechanics.vehicle import BENT, BENT_THESIS, FREE_FLOATING, SERVICER
from ves_gym.planners.comparison import report_plan
from ves_gym.planners.execution_check import executed_violation
from ves_gym.planners.query import Query
from ves_gym.simulation.energy_account import TRUSTED
from ves_gym.simulation.playback import play_motions
from ves_gym.simulation.run_summary import summarise
from ves_gym.simulation.simulator import Simulator
from ves_gym.simulation.stable_step import with_stable_step
from ves_gym.system.energy_balance import EnergyBalance
from ves_gym.system.system import System

START, GOAL = (0.3, -0.4, 0.5), (0.9, 0.1, -0.3)
MOTIONS = [Motion.straight(START, GOAL, 1.0), Motion.straight(START, (0.1, -0.3, 0.4), 1.0)]
SYSTEMS = {
    "modes": System(vehicle=BENT),
    "free": System(vehicle=FREE_FLOATING),
    "friction": System(vehicle=BENT_THESIS, effects=(JointViscous(damping=(20.0,) * 3),)),
    "euler": System(vehicle=BENT_THESIS, integrator="euler", physics_dt=6.25e-3),
}


def played(system, interval=None, motions=MOTIONS):
    return play_motions(
        system, motions, servo=OWN_SERVO, settle=0.2, record_dt=interval, watch=True
    )


@pytest.mark.parametrize("name", SYSTEMS)
def test_it_is_that_of_a_log_of_every_step(name):
    """Reference: `EnergyBalance`; Simpson's rule begins anew every 256 steps here."""
    system = SYSTEMS[name]
    dense, sparse = played(system, system.physics_dt), played(system, 0.1)
    for i in range(2):
        log = dense.log(i)
        kept = log.meta["energy_residual"]
        print(name, i, kept, EnergyBalance.of(log).relative)
        assert kept == pytest.approx(EnergyBalance.of(log).relative, rel=0.02, abs=2e-5)
        assert sparse.energy_residual(i) == pytest.approx(kept, rel=1e-6)
    assert (kept > TRUSTED) == (name == "euler")


def test_a_run_that_it_doubts_is_no_answer_and_says_so():
    """Euler's rule with long steps, recorded too rarely for the log's own account."""
    for name in ("euler", "modes"):
        system = SYSTEMS[name]
        query = Query(system=system, start=START, goal=GOAL, duration=1.0)
        run, log = played(system, 0.1), vg.simulate(query.straight, system, record_dt=0.1)
        summary, why = summarise(log, query.straight), executed_violation(query, run, 0)
        assert summary.trusted == (why is None) == (name == "modes")
        assert any("energy account" in k for k in summary.warnings) == (why is not None)
        assert why is None or "energy account" in why
        plan = vg.plan(START, GOAL, system=system, duration=1.0, planner="straight")
        report, [row] = report_plan(plan), vg.compare(plan, ["straight"])
        assert plan.feasible and report.failure == row.failure
        assert (report.failure is None) == (name == "modes")


def test_none_is_kept_of_what_it_does_not_know():
    run = played(System(vehicle=SERVICER))
    assert run.energy_residual(0) is None and "energy_residual" not in run.log(0).meta


ENGINES = {
    "modes": SYSTEMS["modes"],
    "friction": SYSTEMS["friction"],
    "prescribed": System(vehicle=BENT, drive="prescribed"),
    "wheels, slosh, arrays, pointing": System(arm="ur5e", vehicle="servicer-flexible"),
}


@pytest.mark.parametrize("name", ENGINES)
def test_that_of_the_engine_closes_with_the_fourth_power_of_the_step(name):
    """Reference: order of RK4; a force that the account forgets would not shrink at all."""
    gaps = []
    for share in (1.0, 0.5):
        system = ENGINES[name]
        sim = Simulator(system.replace(physics_dt=system.physics_dt * share), 2)
        rng, pushes = np.random.default_rng(0), 2.0 if system.drive == "prescribed" else 30.0
        sim.reset(q=system.arm.home, v=0.1, yd=0.01 * rng.standard_normal((2, 6)))
        for _ in range(40):
            sim.step(pushes * rng.standard_normal((2, system.arm.n)))
        gap, moved = sim.backend.energy_gap(np.arange(2))
        gaps.append(np.abs(gap).max())
        assert gaps[-1] < 1e-5 * moved.min()
    print(name, gaps)
    assert gaps[1] < gaps[0] / 11


def ended(env, seed=0):
    """Infos of random actions' first episodes (n,): residual, trusted, E_mean."""
    n, rng = env.num_envs, np.random.default_rng(seed)
    env.reset(seed=seed)
    out = np.full((3, n), np.nan)
    while np.isnan(out).any():
        info = env.step(rng.uniform(-1, 1, env.action_space.shape))[4]
        new = info.get("_energy_residual", np.zeros(n, bool)) & np.isnan(out[0])
        if new.any():
            names = ("energy_residual", "energy_trusted", "energy/E_mean")
            out[:, new] = [info[k][new] for k in names]
    return out


@pytest.mark.parametrize(
    "task", ["pose_reach", "track", "payload_transfer", "servicer_capture"]
)
def test_episodes_of_the_steps_that_tasks_have_are_trusted(task):
    residual, trusted, _ = ended(VesVectorEnv(4, task))
    print(task, residual)
    assert residual.max() < TRUSTED and trusted.all()


def test_episodes_of_steps_that_are_too_long_are_marked():
    """Reference: the same actions at a tenth of the step; E_mean is off by a tenth or more."""
    system = VesVectorEnv(1, "track").task.system
    coarse, fine = (
        ended(VesVectorEnv(4, "track", system=system.replace(physics_dt=dt)))
        for dt in (system.control_dt, system.control_dt / 10)
    )
    error = np.abs(coarse[2] / fine[2] - 1)
    print(coarse[0], fine[0], error)
    assert not coarse[1].any() and fine[1].all()
    assert np.median(error) > 0.1


def test_a_single_environment_tells_the_residual_of_the_vector():
    residual, *_ = ended(VesVectorEnv(1, "track"))
    env, rng = VesEnv("track"), np.random.default_rng(0)
    env.reset(seed=0)
    info = {}
    while "energy_residual" not in info:
        *_, info = env.step(rng.uniform(-1, 1, (1, 3))[0])
    assert info["energy_residual"] == residual[0] and info["energy_trusted"] is True


def feather(mass):
    """A UR5e whose last link weighs next to nothing."""
    arm = get_arm("ur5e")
    thin = Inertial(mass=mass, com=(0.0, 0.0, 0.0), inertia=diagonal(*[1e-3 * mass] * 3))
    last = dataclasses.replace(arm.links[-1], inertial=thin, rotor_inertia=0.0)
    return System(arm=dataclasses.replace(arm, links=(*arm.links[:-1], last)))


def test_a_loop_that_no_step_can_hold_is_refused_with_the_number():
    """Reference: kd / J of the last joint, whose inertia is 1e-3 of its mass."""
    stiff = JointServo(kp=(3000.0,) * 6, kd=(50.0,) * 6)
    system = feather(1e-6)
    with pytest.raises(ParameterError, match=r"5e\+10/s, needs physics steps of 2e-11 s"):
        with_stable_step(system, stiff)
    with pytest.raises(ParameterError, match=r"physics_dt must be <= [1-5].*e-11 s"):
        Simulator(system, 1, servo=stiff)
    assert with_stable_step(system).physics_dt == system.physics_dt  # its own gains can be held


def test_the_pose_of_the_fastest_motion_decides():
    """A UR5e on a satellite: 591/s where it is fastest, 396/s at its first nine poses."""
    system = System(arm="ur5e", vehicle="servicer", physics_dt=5e-3, control_dt=5e-3)
    servo = OWN_SERVO.for_arm(system.arm, system.vehicle)
    with pytest.raises(ParameterError, match=r"physics_dt must be <= 0.00471 s .*, 590.9/s"):
        Simulator(system, 1, servo=servo)
    Simulator(system.replace(physics_dt=2.5e-3), 1, servo=servo)
