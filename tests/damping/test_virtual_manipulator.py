"""The virtual manipulator: links as printed, kinematics, equations 4.1 and 4.2."""

import dataclasses

import numpy as np
import pytest

from tests.arms import planar_arm, six_joint_arm
from ves_gym._util.params import Array, ParameterError
from ves_gym.damping.plant import GainMatrices, analyse, plant_at
from ves_gym.damping.tuning import (
    Bounds,
    joint_gains,
    tune,
    tune_virtual,
    two_masses,
    virtual_jacobian,
)
from ves_gym.mechanics.arm import Arm, Inertial, diagonal
from ves_gym.mechanics.arm_library import PUMA_560
from ves_gym.mechanics.dynamics import frames
from ves_gym.mechanics.vehicle import BENT_THESIS, DECOUPLED, FREE_FLOATING
from ves_gym.system.system import System

ARMS = {"puma": PUMA_560, "planar": planar_arm(), "six joints": six_joint_arm()}
BENT_ELBOW = np.deg2rad([45.0, -30.0, 80.0])
LOOSE = Bounds(K=(1e-6, 1e4), B=(1e-6, 1e3))


def point(mass: float, com=(0.0, 0.0, 0.0)) -> Inertial:
    return Inertial(mass=mass, com=com, inertia=diagonal(0, 0, 0))


def point_mass_arm(mass: float = 30.0) -> Arm:
    """The PUMA's geometry without mass, but for a point at the tool."""
    links = [
        dataclasses.replace(k, rotor_inertia=0.0, inertial=point(0.0)) for k in PUMA_560.links
    ]
    links[-1] = dataclasses.replace(links[-1], inertial=point(mass))
    return Arm(name="point", base=point(0.0), links=tuple(links), source="test")


# --------------------------------------------------------------------------- the links


def virtual_links(arm: Arm) -> Array:
    """(n + 1, 3) virtual links [m] from the centre of mass to the base.

    Row j turns with link j (row 0 with the base): in its DH frame, as thesis B.5 and B.6
    print them. Row 0 ends in the platform-top origin, theirs in the base link's centre.
    """
    bodies = [arm.base, *(link.inertial for link in arm.links)]
    masses = np.array([b.mass for b in bodies])
    beyond = np.cumsum(masses[::-1])[::-1]  # mass of body j and of all after it
    out = np.array([-b.mass * np.array(b.com) for b in bodies])
    turn, place = arm.start
    lengths = np.zeros((arm.n, *out.shape))  # of each link, by the bodies they turn with
    for j, link in enumerate(arm.links):
        # d lies along the axis before the link, a along the link's own x before beta
        lengths[j, j] = link.d * (turn[:, 2] if j == 0 else np.eye(3)[2])
        lengths[j, j + 1] = link.a * link.far_end[0][0]
    lengths[0, 0] += place
    out -= np.tensordot(beyond[1:], lengths, axes=1)
    return out / arm.mass


PRINTED_MASS = 93.4  # kg, B.5; the masses it lists sum to 93.7


def test_links_to_the_base_are_those_printed_in_b6():
    """d2, d3, a2, a3 to the digits printed. d1 is printed to the base link's centre, -0.263
    by R1 = 0.629 m: its own lengths give R1 = 0.617 m, so -0.258."""
    links = virtual_links(PUMA_560) * PUMA_560.mass / PRINTED_MASS
    assert links[1, 2] == pytest.approx(0.0765, abs=6e-5)
    assert links[2, 2] == pytest.approx(-0.0125, abs=1e-4)  # of rounded r3 and l3
    assert links[2, 0] == pytest.approx(-0.054, abs=5e-4)
    assert links[3, 0] == pytest.approx(-0.0281, abs=6e-5)
    to_centre = virtual_links(PUMA_560)[0, 2] + PUMA_560.base.com[2]
    assert to_centre == pytest.approx(-0.263 * 0.617 / 0.629, abs=5e-4)


@pytest.mark.parametrize("name", ARMS)
def test_the_jacobian_is_the_slope_of_the_links(name):
    arm, step = ARMS[name], 1e-6
    links = virtual_links(arm)

    def base(q):
        turns = [np.eye(3), *frames(arm, q).rotation]
        return sum(R @ v for R, v in zip(turns, links, strict=True))

    q = np.random.default_rng(1).uniform(-2, 2, arm.n)
    slope = [(base(q + d) - base(q - d)) / (2 * step) for d in step * np.eye(arm.n)]
    np.testing.assert_allclose(virtual_jacobian(arm, q), np.transpose(slope), atol=1e-9)


# -------------------------------------------------------------------------- the gains


def test_equations_4_1_and_4_2():
    """Joint springs hold the energy of the Cartesian ones, dampers lose their power."""
    rng = np.random.default_rng(0)
    K, B = (k @ k.T for k in rng.normal(size=(2, 3, 3)))
    joint = joint_gains(PUMA_560, BENT_ELBOW, GainMatrices(K, B))
    dq = rng.normal(size=3)
    moved = virtual_jacobian(PUMA_560, BENT_ELBOW) @ dq
    assert dq @ joint.K @ dq == pytest.approx(moved @ K @ moved)
    assert dq @ joint.B @ dq == pytest.approx(moved @ B @ moved)


@pytest.mark.parametrize("full", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_two_masses_are_an_arm_with_one(full):
    """Their measure is what the full dynamic analysis finds for the joint gains."""
    system = System(vehicle=BENT_THESIS, arm=point_mass_arm())
    gains, search = tune_virtual(system, BENT_ELBOW, full=full, bounds=LOOSE)
    judged = analyse(plant_at(system, BENT_ELBOW), gains)
    assert judged.E_int == pytest.approx(search.value, rel=1e-6)
    if full:  # then nothing is lost against full joint gains, whose bounds are narrower
        best = tune(plant_at(system, BENT_ELBOW), full=True).value
        assert 0.95 * best < judged.E_int < 1.001 * best


def test_poles_of_the_two_masses_are_those_of_the_arm():
    system = System(vehicle=BENT_THESIS, arm=point_mass_arm())
    cartesian = GainMatrices(np.diag([500.0, 300, 900]), np.diag([40.0, 90, 60]))
    joints = joint_gains(system.arm, BENT_ELBOW, cartesian)
    simple = analyse(two_masses(system, BENT_ELBOW), cartesian)
    full = analyse(plant_at(system, BENT_ELBOW), joints)
    np.testing.assert_allclose(np.sort(simple.poles), np.sort(full.poles), rtol=1e-6)
    assert simple.t_5 == pytest.approx(full.t_5, abs=0.02)
    assert simple.worst == pytest.approx(full.worst, rel=1e-6)


@pytest.mark.slow
def test_no_joint_is_left_free():
    """Six joints, J_vm of rank 3: the least gains hold the rest."""
    system = System(arm=six_joint_arm(), vehicle=DECOUPLED)
    bounds = Bounds(K=(2.0, 1e4), B=(0.5, 1e3))
    gains, _ = tune_virtual(system, np.full(6, 0.3), bounds=bounds)
    for gain, (low, _) in zip(gains, (bounds.K, bounds.B), strict=True):
        assert np.linalg.eigvalsh(gain)[0] == pytest.approx(low, rel=1e-6)
    assert np.isfinite(analyse(plant_at(system, np.full(6, 0.3)), gains).E_int)


def test_a_base_without_stiffness_is_refused():
    with pytest.raises(ParameterError, match="stiffness in all six directions"):
        tune_virtual(System(vehicle=FREE_FLOATING), BENT_ELBOW)
