"""What an arm from a file brings along acts: any number of joints, friction, shapes."""

import dataclasses

import numpy as np
import pytest

from tests.mechanics.test_urdf import chain
from ves_gym.effects.joint_friction import JointCoulomb, JointViscous
from ves_gym.mechanics.arm import Arm, Capsule
from ves_gym.mechanics.arm_library import arm_names, get_arm
from ves_gym.mechanics.kinematics import frames
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.vehicle import BENT_THESIS, FREE_FLOATING
from ves_gym.planners.obstacles import Sphere, Surroundings, collisions
from ves_gym.simulation.playback import play_motions
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.system import System


def runs(system, seconds=0.25):
    """State after some time under a torque that swings, on both engines."""
    n = system.arm.n
    rng = np.random.default_rng(n)
    low, high = system.arm.column("q_min"), system.arm.column("q_max")
    q = np.clip(rng.uniform(-0.5, 0.5, n), low, high)
    torque = 0.05 * system.arm.column("tau_max") * rng.uniform(-1, 1, n)
    out = []
    for backend in ("kernel", "mujoco"):
        sim = Simulator(system, backend=backend)
        sim.reset(q=q, y=1e-3 * np.ones(6))
        hold = sim.servo_command(q[None], np.zeros((1, n)))
        for _ in range(round(seconds / system.control_dt)):
            sim.step(hold + torque)
        out.append(
            np.concatenate([sim.state.q, sim.state.y, sim.state.v, sim.state.yd], axis=1)
        )
    return out


@pytest.mark.parametrize("n", (3, 6, 9))
def test_kernel_is_mujoco_for_three_to_nine_joints(tmp_path, n):
    """The figure asked for is 1e-9, of angles [rad], rates [rad/s] and the base's pose."""
    path = tmp_path / "arm.urdf"
    path.write_text(chain(n, seed=n))
    vehicle = FREE_FLOATING if n % 2 else BENT_THESIS
    kernel, engine = runs(System(arm=Arm.from_file(path), vehicle=vehicle))
    assert np.isfinite(kernel).all()
    np.testing.assert_allclose(kernel, engine, atol=1e-9)


@pytest.mark.parametrize("name", arm_names())
def test_shipped_arms_run_alike_on_both_engines_and_follow_their_motion(name):
    arm = get_arm(name)
    system = System(vehicle=BENT_THESIS, arm=arm)
    kernel, engine = runs(system, 0.1)
    np.testing.assert_allclose(kernel, engine, atol=1e-9)
    start = np.clip(0.2, arm.column("q_min"), arm.column("q_max")) * np.ones(arm.n)
    duration = max(1.5, 4 * 0.3 / arm.column("v_max").min())
    run = play_motions(system, [Motion.straight(start, start + 0.3, duration)], settle=0.5)
    slow = 0.1 if name == "canadarm2" else 5e-3  # rad: 0.2 Hz, on a beam lighter than the arm
    np.testing.assert_allclose(run.q[0, -1], start + 0.3, atol=slow)
    log = run.log(0)
    assert log.n_joints == arm.n and len(log.meta["controller"]["kp"]) == arm.n


def test_damping_and_friction_of_links_are_those_of_the_effects():
    arm = get_arm("ur5e")
    damping, friction = (250.0, 2.0, 1.0, 0.1, 0.1, 0.0), (2.0, 1.0, 0.0, 0.0, 0.0, 0.0)
    links = zip(arm.links, damping, friction, strict=True)
    rubbing = dataclasses.replace(
        arm, links=tuple(dataclasses.replace(k, damping=d, friction=f) for k, d, f in links)
    )
    thirds = JointViscous(damping=tuple(k / 3 for k in damping))
    system = System(vehicle=BENT_THESIS, arm=rubbing)
    assert system.actual.arm == arm
    assert system.actual.effects == (*[thirds] * 3, JointCoulomb(torque=friction))
    assert system.actual.actual is system.actual
    by_hand = System(
        vehicle=BENT_THESIS, arm=arm, effects=(*[thirds] * 3, JointCoulomb(torque=friction))
    )
    for one, other in zip(runs(system, 0.05), runs(by_hand, 0.05), strict=True):
        np.testing.assert_array_equal(one, other)


# ------------------------------------------------------------------------- shapes


def test_an_obstacle_meets_the_shape_that_the_file_gives():
    """A wide capsule on the UR5e's forearm: a sphere is met at its radius, from the axis."""
    arm = get_arm("ur5e")
    wide = Capsule(start=(0.05, 0.0, 0.0), end=(0.3, 0.0, 0.0), radius=0.2)
    links = list(arm.links)
    links[2] = dataclasses.replace(links[2], shape=(wide,))
    shaped = dataclasses.replace(arm, links=tuple(links))
    q = np.array([0.3, -1.0, 0.8, 0.0, 0.0, 0.0])
    turn, at = (part[2] for part in (frames(arm, q).rotation, frames(arm, q).position))
    middle, aside = at + turn @ [0.2, 0.0, 0.0], turn @ [0.0, 0.0, -1.0]
    for gap, clear in ((0.01, True), (-0.01, False)):
        ball = Sphere(centre=tuple(middle + (0.2 + 0.05 + gap) * aside), radius=0.05)
        around = Surroundings(obstacles=(ball,), clearance=0.0)
        found = collisions(System(vehicle=BENT_THESIS, arm=shaped), around)
        assert found.is_clear(q) is clear
    assert collisions(System(vehicle=BENT_THESIS, arm=arm), around).is_clear(
        q
    )  # thin capsules along the links


def test_shapes_that_always_overlap_are_no_collision():
    arm = get_arm("iiwa14")
    fat = tuple(
        dataclasses.replace(
            k, shape=(Capsule(start=(0.0,) * 3, end=(0.0, 0.0, 0.01), radius=0.22),)
        )
        for k in arm.links
    )
    shaped = dataclasses.replace(arm, links=fat)
    found = collisions(System(vehicle=BENT_THESIS, arm=shaped), Surroundings(clearance=0.0))
    assert found.is_clear(np.zeros(7))
