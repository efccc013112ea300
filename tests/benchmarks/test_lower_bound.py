"""The lower bound of E_mean: its parts, and that no motion undercuts it."""

import dataclasses

import numpy as np
import pytest
import scipy.linalg

from benchmarks.lower_bound.bound import bound_energy
from benchmarks.lower_bound.conjugate import conjugate, is_convex, local_part, momentum_cost
from benchmarks.lower_bound.potential import (
    Potential,
    ReachableSet,
    Setting,
    Shapes,
    bends_of,
    coupling_of,
    residual_floor,
)
from tests.arms import planar_arm, six_joint_arm
from tests.reach import REACH_RANGE, SPEED_LIMITS
from ves_gym._util.params import ParameterError
from ves_gym.mechanics.arm_library import PUMA_560
from ves_gym.mechanics.dynamics import inertia
from ves_gym.mechanics.vehicle import BENT_THESIS, VEHICLES
from ves_gym.planners.direct import Direct
from ves_gym.planners.motion_problem import MotionProblem
from ves_gym.planners.objective import MeanEnergy
from ves_gym.planners.prediction import LinearBase
from ves_gym.planners.query import Query
from ves_gym.planners.refine import Refined, detours
from ves_gym.planners.suites import reach100
from ves_gym.system.system import System

START, GOAL = np.array([0.3, -0.4, 0.6]), np.array([-0.1, 0.1, 0.1])
SLABS = 5  # coarse: the bound is valid with any number, and found in a second


def query(vehicle="bent-thesis", duration=1.0, start=START, goal=GOAL, **changes):
    system = System(vehicle=VEHICLES[vehicle], **changes).ideal()
    return Query(
        system=system,
        start=tuple(start),
        goal=tuple(goal),
        duration=duration,
        v_max=SPEED_LIMITS,
    )


def base_cost(asked):
    """The cost of a query's base, arm in the middle."""
    linear = LinearBase(asked.system)
    M = linear.mass(linear.inertia(sum(asked.ends) / 2))
    return momentum_cost(M, linear.D, linear.K, asked.duration)


def frozen(asked, nodes=240):
    return MeanEnergy(asked.system, sum(asked.ends) / 2, asked.duration, nodes=nodes)


def setting(asked, cost, slabs):
    arm, (start, goal) = asked.system.arm, asked.ends
    speed = np.minimum(arm.column("v_max"), asked.v_max)
    low, high = arm.column("q_min"), arm.column("q_max")
    reach = ReachableSet(start, goal, low, high, speed, asked.duration)
    values, vectors = np.linalg.eigh(cost.R)
    root = (vectors * np.sqrt(np.maximum(values, 0))) @ vectors.T
    return Setting(reach, Shapes(arm, (start + goal) / 2, np.full(arm.n, 0.8)), root, slabs)


def random_potential(rng, at, slabs):
    """Of the size of a joint momentum's multiplier."""
    n, count = at.shapes.arm.n, at.shapes.count
    f = rng.normal(size=(slabs + 1, count)) * 0.05
    y, multiplier = rng.normal(size=(slabs + 1, 6, n + 1)), rng.normal(size=(slabs + 1, 6))
    return Potential(f=f, y=0.02 * y, l=0.02 * multiplier)


# --------------------------------------------------------------------------- conjugate


@pytest.mark.parametrize(
    ("vehicle", "duration"),
    [("bent-thesis", 4.0), ("straight-horizontal-thesis", 1.0), ("free-floating", 1.0)],
)
def test_the_conjugate_is_that_of_the_mean_energy(vehicle, duration):
    """Fenchel: J_R >= l u - J_R* for any l, with equality in the limit of many nodes.

    J_R is that of `MeanEnergy`, which shares no line with `conjugate`; its trapezoid rule is
    good to 1e-3.
    """
    asked = query(vehicle, duration)
    cost = base_cost(asked)
    cost = cost.less(local_part(cost))
    energy, slabs = frozen(asked), 24
    t = energy.t
    u = LinearBase(asked.system).load(asked.straight, t)
    own = 0.5 * np.trapezoid(np.einsum("ti,ij,tj->t", u, cost.R, u), t)
    left = energy.of(asked.straight) - own
    nodes = np.linspace(0, duration, slabs + 1)
    hats = np.maximum(0, 1 - np.abs(t[:, None] - nodes) / nodes[1])
    work = np.trapezoid(hats[:, :, None] * u[:, None, :], t, axis=0).ravel()
    W = conjugate(cost, slabs)
    best = 0.5 * work @ np.linalg.solve(W, work)
    assert 0.97 * left < best < (1 + 2e-3) * left
    rng = np.random.default_rng(0)
    for _ in range(20):
        multiplier = np.linalg.solve(W, work) * rng.normal(1, 0.3, len(work))
        assert multiplier @ work - 0.5 * multiplier @ W @ multiplier <= best * (1 + 1e-9)


def test_what_is_taken_off_leaves_a_convex_form_and_not_much_more_would():
    asked = query()
    cost = base_cost(asked)
    R = local_part(cost)
    assert np.linalg.eigvalsh(R)[0] > 0
    energy = frozen(asked, 64)
    weight = np.full(65, energy.t[1])
    weight[[0, -1]] /= 2
    taken = np.kron(np.diag(weight), R)
    least = scipy.linalg.eigh(energy.hessian, taken, eigvals_only=True, subset_by_index=[0, 0])
    assert 1.0 < least[0] < 1.15
    assert is_convex(cost.less(R))
    assert not is_convex(cost.less(1.15 * R))
    assert not is_convex(cost.less(cost.C))


def test_a_base_may_have_more_than_six_coordinates():
    """An oscillator that nothing pushes on and a rigid one change nothing."""
    cost = base_cost(asked := query())
    system = asked.system
    M = system.base.mass_matrix + inertia(system.arm, sum(asked.ends) / 2)[:6, :6]
    wide = momentum_cost(
        scipy.linalg.block_diag(M, 2.0),
        scipy.linalg.block_diag(system.base.D, 0.3),
        scipy.linalg.block_diag(system.base.K, 50.0),
        asked.duration,
    )
    np.testing.assert_allclose(conjugate(wide, 6), conjugate(cost, 6), rtol=1e-8, atol=1e-9)
    with pytest.raises(ParameterError, match="one size >= 6"):
        momentum_cost(np.eye(5), np.eye(5), np.eye(5), 1.0)


# --------------------------------------------------------------------------- potential


def test_the_coupling_and_its_derivatives_are_the_arms():
    coupling, bends = coupling_of(PUMA_560), bends_of(PUMA_560)
    q = np.random.default_rng(1).uniform(-3, 3, (40, 3))
    waves = coupling.waves(q)
    across, moment = coupling.split(waves @ coupling.table)
    full = inertia(PUMA_560, q)
    np.testing.assert_allclose(across, np.swapaxes(full[:, :6, 6:], 1, 2), atol=1e-11)
    np.testing.assert_allclose(moment[:, 0], full[:, 1, 5], atol=1e-11)
    eps = 1e-4
    for k in range(3):
        move = eps * np.eye(3)[k]
        ahead, back = (coupling.waves(q + s * move) @ coupling.table for s in (1, -1))
        here = waves @ coupling.table
        np.testing.assert_allclose(waves @ bends.first[k], (ahead - back) / 2 / eps, atol=1e-5)
        np.testing.assert_allclose(
            waves @ bends.second[k], (ahead - 2 * here + back) / eps**2, atol=1e-5
        )
        for m in range(3):
            third = coupling.split(waves @ coupling.derived(k, k, m))[0]
            size = np.linalg.norm(third[:, :, 3:], axis=2).max(axis=0)
            assert (size <= bends.most_third[k][m][0][:, 1]).all()


def test_motions_stay_in_the_boxes():
    asked = query(duration=1.5)
    problem = MotionProblem(asked, 10)
    reach = setting(asked, base_cost(asked), 6).reach
    found = [problem.straight + 0.5 * (x - problem.straight) for x in detours(problem, 12, 3)]
    allowed = [x for x in found if problem.limits(x)[0].max() <= 0]
    assert len(allowed) > 3
    for x in allowed:
        motion = problem.motion(x)
        for k in range(6):
            low, high = reach.box(0.25 * k, 0.25 * (k + 1))
            q = motion.at(np.linspace(0.25 * k, 0.25 * (k + 1), 30)).q
            assert (q >= low - 1e-9).all()
            assert (q <= high + 1e-9).all()


def test_the_floor_is_below_the_residual_everywhere_and_near_it_somewhere():
    asked = query()
    cost = base_cost(asked)
    at = setting(asked, cost.less(local_part(cost)), 4)
    rng = np.random.default_rng(5)
    for _ in range(2):
        p = random_potential(rng, at, 4)
        for k in (0, 1):
            low, high = at.box(k)
            seen = at.residual(p, k, rng.uniform(low, high, (20_000, 3)))[0].min()
            scale = abs(seen)
            floor, least = residual_floor(at, p, k, 0.05 * scale)
            assert floor <= seen
            assert floor <= least
            assert floor > seen - 0.1 * scale


def test_any_potential_bounds_the_functional_along_any_motion():
    """The theorem itself, by quadrature along motions that keep the speed limits."""
    asked = query(duration=1.4)
    cost = base_cost(asked)
    cost = cost.less(local_part(cost))
    slabs = 4
    at, problem = setting(asked, cost, slabs), MotionProblem(asked, 10)
    rng = np.random.default_rng(2)
    t = np.linspace(0, 1.4, 801)
    ends = at.shapes.at(np.stack(asked.ends))[0]
    found = [problem.straight + 0.4 * (x - problem.straight) for x in detours(problem, 8, 1)]
    motions = [problem.motion(x) for x in found if problem.limits(x)[0].max() < 0]
    assert len(motions) > 3
    for _ in range(3):
        p = random_potential(rng, at, slabs)
        floors = sum(residual_floor(at, p, k, 0.05)[0] for k in range(slabs)) * at.step
        least = ends[0] @ p.f[0] - ends[1] @ p.f[-1] + floors
        nodes = np.linspace(0, 1.4, slabs + 1)
        multiplier = np.stack([np.interp(t, nodes, p.l[:, j]) for j in range(6)], axis=1)
        for motion in motions:
            u = LinearBase(asked.system).load(motion, t)
            own = 0.5 * np.einsum("ti,ij,tj->t", u, cost.R, u)
            assert np.trapezoid((multiplier * u).sum(axis=1) + own, t) >= least


# ------------------------------------------------------------------------------- bound


@pytest.mark.parametrize(
    ("vehicle", "duration"),
    [
        ("bent-thesis", 1.0),
        pytest.param("straight-vertical-thesis", 0.8, marks=pytest.mark.slow),
        pytest.param("free-floating", 1.2, marks=pytest.mark.slow),
    ],
)
def test_no_motion_undercuts_the_bound(vehicle, duration):
    rng = np.random.default_rng(round(100 * duration))
    start = 0.6 * rng.uniform(-1, 1, 3) * REACH_RANGE
    goal = start + rng.uniform(-0.35, 0.35, 3) * duration
    asked = query(vehicle, duration, start, goal)
    bound = bound_energy(asked, slabs=SLABS)
    assert bound.energy > 0
    assert bound.check() == pytest.approx(bound.energy, rel=0.05)
    energy, problem = frozen(asked, 96), MotionProblem(asked, 10)
    found = [asked.straight, Direct(16).find(asked, 0)[0], Refined(20, 2).find(asked, 0)[0]]
    found += [problem.motion(x) for x in detours(problem, 20, 4)]
    energies = [energy.of(m) for m in found]
    assert bound.energy < min(energies)
    assert bound.gap(energies[0]) == energies[0] / bound.energy > 1


@pytest.mark.slow
def test_the_bound_is_near_the_best_known_energy():
    """On the base of the published queries; 12 slabs give 0.88."""
    asked = reach100(
        System(vehicle=BENT_THESIS).ideal(), "bent-thesis", 4, durations=(1.0,)
    ).queries[3][1]
    bound = bound_energy(asked, slabs=6)
    best = frozen(asked, 96).of(Refined(24, 1).find(asked, 0)[0])
    assert 0.75 * best < bound.energy < best


def test_tampering_with_a_certificate_gives_no_more_than_there_is():
    asked = query()
    bound = bound_energy(asked, slabs=SLABS)
    best = frozen(asked, 96).of(Direct(16).find(asked, 0)[0])
    p = bound.potential
    for changed in (
        dataclasses.replace(p, l=1.3 * p.l),
        dataclasses.replace(p, f=1.3 * p.f),
        Potential(f=2 * p.f, y=2 * p.y, l=2 * p.l),
        dataclasses.replace(p, y=0 * p.y),
    ):
        value = dataclasses.replace(bound, potential=changed).check()
        assert value < best
        assert value < bound.energy * 1.05


@pytest.mark.parametrize("arm", [planar_arm(), six_joint_arm()], ids=["two", "six"])
def test_arms_of_other_numbers_of_joints(arm):
    """Of six joints only by the first moment."""
    system = dataclasses.replace(
        System(vehicle=VEHICLES["bent-thesis"]).ideal(), arm=arm, drive="prescribed"
    )
    start, goal = np.full(arm.n, 0.2), np.full(arm.n, 0.5)
    asked = Query(system=system, start=tuple(start), goal=tuple(goal), duration=1.0)
    bound = bound_energy(asked, slabs=4)
    assert (bound.potential is None) == (arm.n > 4)
    assert 0 < bound.energy < frozen(asked, 96).of(asked.straight)
    assert bound.check() == pytest.approx(bound.energy, rel=0.05)


def test_no_way_to_go_needs_no_energy():
    assert bound_energy(query(goal=START)).energy == 0.0
    with pytest.raises(ParameterError, match="slabs must be >= 2, got 1"):
        bound_energy(query(), slabs=1)
    with pytest.raises(ParameterError, match="at rest at the start, got a moving one"):
        bound_energy(dataclasses.replace(query(), start_rate=(0.1, 0.0, 0.0)))
