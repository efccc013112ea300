"""The energy account is kept whatever is recorded; a run that it doubts is no answer."""

import dataclasses

import pytest

import ves_gym as vg
from ves_gym._util.params import ParameterError
from ves_gym.effects.joint_friction import JointViscous
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
