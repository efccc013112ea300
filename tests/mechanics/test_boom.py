"""Arms whose links bend, and booms that carry them: chains, frequencies, reductions."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy

from ves_gym._util.params import ParameterError
from ves_gym.damping.plant import plant_at
from ves_gym.mechanics.arm_library import get_arm
from ves_gym.mechanics.boom import (
    NO_ARM,
    QUASI_ISOTROPIC,
    REACHING_OUT,
    SHUTTLE_LIKE,
    Boom,
    BoomMember,
)
from ves_gym.mechanics.dynamics import inertia
from ves_gym.mechanics.finite_elements import Tube
from ves_gym.mechanics.flexible_base import FlexibleBase, Polyline, Strut, beam_line
from ves_gym.mechanics.flexure import expand
from ves_gym.mechanics.kinematics import joint_positions
from ves_gym.mechanics.link import Inertial, diagonal
from ves_gym.mechanics.modes import natural_modes
from ves_gym.mechanics.spatial import rotation
from ves_gym.planners.query import Query, solve
from ves_gym.planners.registry import get_planner
from ves_gym.system.system import System
from ves_gym.system.system_library import get_system

sys.path.insert(0, str(Path(__file__).parents[2] / "scripts"))
from hinges_needed import TIPS, by_hinges, closed_form

MICRO = ("puma560", "puma560-wrist", "iiwa14")


@pytest.mark.parametrize("name", MICRO)
def test_at_rest_a_chain_is_the_ordinary_arm(name):
    """Rigid limit: kinematics and inertia of n joints, driven boom and braked boom alike."""
    micro = get_arm(name)
    arm = SHUTTLE_LIKE.carry(micro)
    chain, p = expand(arm), arm.bends
    assert (arm.n, p) == (3 + micro.n, 10)
    q = np.random.default_rng(0).uniform(-1, 1, (4, arm.n))
    q[:, :3] = REACHING_OUT
    still = np.zeros((4, p))
    H = inertia(arm, q)
    kept = np.r_[:6, 6 + p : 6 + p + arm.n]
    assert chain.inertia(q, still)[:, kept[:, None], kept] == pytest.approx(H, abs=1e-9)
    assert chain.tool(q, still) == pytest.approx(joint_positions(arm, q)[:, -1], abs=1e-12)

    braked = SHUTTLE_LIKE.braked(REACHING_OUT, micro)
    assert (braked.n, braked.bends) == (micro.n, 13)
    joints = np.r_[:6, 9 : 6 + arm.n]
    assert inertia(braked, q[:, 3:]) == pytest.approx(H[:, joints[:, None], joints], abs=1e-9)
    tool = expand(braked).tool(q[:, 3:], np.zeros((4, 13)))
    assert tool == pytest.approx(joint_positions(arm, q)[:, -1], abs=1e-12)


def test_the_masses_of_a_bent_boom_lie_where_its_members_do():
    """Elbow at a right angle: the second member hangs along -z."""
    base = SHUTTLE_LIKE.braked((0.0, 0.0, np.pi / 2), NO_ARM).base
    tube = SHUTTLE_LIKE.members[0].section.of(QUASI_ISOTROPIC).area * QUASI_ISOTROPIC.density
    masses = [110.0, 6.4 * tube, 60.0, 7.0 * tube, 130.0]
    places = [(0, 0, 0), (3.2, 0, 0), (6.4, 0, 0), (6.4, 0, -3.5), (6.4, 0, -6.7)]
    assert base.mass == pytest.approx(sum(masses))
    assert base.com == pytest.approx(np.average(places, axis=0, weights=masses), abs=1e-9)


@pytest.mark.parametrize("pinned", [False, True])
@pytest.mark.parametrize("tip", TIPS)
def test_members_have_the_frequencies_of_beams(tip, pinned):
    """Closed forms of Euler-Bernoulli beams. Two hinges: the first clamped mode within 1.1 %,
    0.13 % with twice the member's mass at its tip; four: the first two within 1 %; five, the
    first two pinned within 0.2 %."""
    exact = closed_form(tip, pinned=pinned)
    errors = {k: np.abs(by_hinges(k, tip, pinned=pinned) / exact - 1) for k in (2, 4, 5)}
    if pinned:
        assert errors[5][:2].max() <= 2e-3
        return
    assert errors[2][0] <= (0.011 if tip < 2 else 1.3e-3)
    assert errors[4][:2].max() <= 0.01


def test_a_tip_gives_in_statics_as_a_beam_does():
    """Force and moment at the tip, exactly: Gauss's rule integrates what they bend."""
    length, load = 6.0, Tube(outer_diameter=0.2, wall=0.004)
    member = BoomMember(vector=(length, 0, 0), section=load, material=QUASI_ISOTROPIC)
    arm = Boom(name="rod", members=(member,), source="test").braked([], NO_ARM)
    flexures = arm.base_flexures
    ways = np.array([np.cross(f.axis, np.array([length, 0, 0]) - f.origin) for f in flexures])
    turns = np.array([f.axis for f in flexures])
    J = np.hstack([ways, turns])
    compliance = (J.T / [f.stiffness for f in flexures]) @ J
    section = load.of(QUASI_ISOTROPIC)
    EI = QUASI_ISOTROPIC.youngs_modulus * section.second_y
    GJ = QUASI_ISOTROPIC.shear_modulus * section.torsion
    third, half, one = length**3 / 3 / EI, length**2 / 2 / EI, length / EI
    expected = np.diag([0, third, third, length / GJ, one, one])
    expected[1, 5] = expected[5, 1] = half
    expected[2, 4] = expected[4, 2] = -half
    assert compliance == pytest.approx(expected, rel=1e-12, abs=1e-18)


def elbow(hinges: int) -> Boom:
    """Two members at a right angle, no joints, a body at the tip."""
    tube = Tube(outer_diameter=0.33, wall=0.005)
    ways = ((6.4, 0.0, 0.0), (0.0, 4.0, -5.0))
    members = tuple(
        BoomMember(vector=k, section=tube, material=QUASI_ISOTROPIC, hinges=hinges)
        for k in ways
    )
    body = Inertial(mass=200.0, com=(0.0, 0.1, 0.2), inertia=diagonal(9.0, 9.0, 9.0))
    return Boom(name="elbow", members=members, tip=body, source="test")


@pytest.mark.parametrize(("hinges", "modes", "error"), [(2, 3, 0.005), (4, 4, 0.005)])
def test_a_bent_boom_has_the_frequencies_of_finite_elements(hinges, modes, error):
    boom = elbow(hinges)
    tube = Tube(outer_diameter=0.33, wall=0.005)
    struts = tuple(
        Strut(vector=m.vector, section=tube, material=QUASI_ISOTROPIC) for m in boom.members
    )
    frame = FlexibleBase(structure=Polyline(members=struts), modes=12, damping_ratio=0.0)
    fine = replace(frame, fastest=1e9).base_model()
    M, _, K = fine.full()
    M[:6, :6] += boom.tip.spatial()
    expected = natural_modes(K, M)[0][:modes]
    found_base = boom.at([], modes=20, fastest=1e9).base_model()
    mass, _, stiffness = found_base.full()
    found = natural_modes(stiffness, mass)[0][:modes]
    assert np.abs(found / expected - 1).max() <= error


def test_a_reduction_is_the_linear_motion_of_the_chain():
    """All modes kept: frequencies of the braked boom with the locked arm, to rounding."""
    micro = get_arm("puma560-wrist")
    arm = SHUTTLE_LIKE.braked(REACHING_OUT, micro)
    chain, q = expand(arm), np.full(6, 0.3)
    M = chain.inertia(q, np.zeros(13))[6:19, 6:19]
    squares = scipy.linalg.eigh(np.diag(chain.stiffness), M, eigvals_only=True)
    base = SHUTTLE_LIKE.at(REACHING_OUT, modes=7, fastest=1e9).base_model()
    mass, _, stiffness = base.full()
    mass[:6, :6] += inertia(micro, q)[:6, :6]
    assert natural_modes(stiffness, mass)[0] == pytest.approx(np.sqrt(squares), rel=1e-8)
    # proportional damping stays so: D = loss K
    _, damping, _ = base.full()
    assert damping == pytest.approx(0.003 * stiffness, rel=1e-6, abs=1e-6 * damping.max())


def test_a_reduced_boom_is_drawn_as_it_lies():
    base = SHUTTLE_LIKE.at(REACHING_OUT)
    line = beam_line(base, np.zeros((1, 6)))[0]
    assert line[-1] == pytest.approx(np.zeros(3), abs=1e-12)  # the flange
    lengths = np.linalg.norm(np.diff(line, axis=0), axis=1)
    assert lengths.sum() == pytest.approx(13.4)
    y = np.array([[0.01, 0.02, -0.01, 0.001, 0.002, 0.003]])
    assert beam_line(base, y)[0, -1] == pytest.approx(y[0, :3], abs=1e-9)
    assert beam_line(base, y)[0, 0] == pytest.approx(line[0], abs=1e-12)  # the root holds


def test_what_takes_links_for_rigid_says_so():
    arm = SHUTTLE_LIKE.braked(REACHING_OUT, get_arm("puma560"))
    system, still = System(arm=arm), (0.0, 0.0, 0.0)
    query = Query(system=system, start=still, goal=(0.1, 0.1, 0.1), duration=1.0)
    with pytest.raises(ParameterError, match=r"takes links for rigid.*13 flexures.*Boom\.at"):
        solve(get_planner("reaction-null"), query)
    with pytest.raises(ParameterError, match="PPED takes links for rigid"):
        plant_at(system, still)
    with pytest.raises(ParameterError, match="no words for the 13 flexures"):
        arm.to_urdf("nowhere.urdf")
    with pytest.raises(ParameterError, match="mode emulated needs an arm of rigid links"):
        System(arm=arm, mode="emulated")


def test_bad_booms_are_refused():
    with pytest.raises(ParameterError, match=r"rigidly along \(.*bend the boom"):
        SHUTTLE_LIKE.at((0.0, 0.0, 0.0))
    with pytest.raises(ParameterError, match="q must have shape"):
        SHUTTLE_LIKE.braked((0.0, 0.0), get_arm("puma560"))
    arm = SHUTTLE_LIKE.carry(get_arm("puma560"))
    light = replace(arm.links[1], inertial=get_arm("puma560").links[1].inertial)
    with pytest.raises(ParameterError, match="link 2: the parts beyond its flexures"):
        expand(replace(arm, links=(arm.links[0], light, *arm.links[2:])))
    with pytest.raises(ParameterError, match=r"the last of Arm\.links must not bend"):
        replace(arm, links=arm.links[:2])


@pytest.mark.parametrize("name", ["macro-micro", "macro-micro-braked"])
def test_pictures_bend_as_the_boom_does(name):
    """Place of the tool in a picture, base moved and links bent."""
    from ves_gym.rendering.drawing import Drawing  # needs MuJoCo with its OpenGL

    system = get_system(name)
    drawing, p = Drawing(system, 64, 48), system.arm.bends
    rng = np.random.default_rng(0)
    y, q, d = (
        rng.uniform(-0.2, 0.2, 6),
        rng.uniform(-1, 1, system.arm.n),
        rng.uniform(-0.1, 0.1, p),
    )
    drawing.pose(y, q, d)
    expected = y[:3] + rotation(y) @ expand(system.arm).tool(q, d)
    assert drawing.data.site("tool").xpos == pytest.approx(expected, abs=1e-9)
    drawing.pose(y, q)
    straight = y[:3] + rotation(y) @ joint_positions(system.arm, q)[-1]
    assert drawing.data.site("tool").xpos == pytest.approx(straight, abs=1e-9)
