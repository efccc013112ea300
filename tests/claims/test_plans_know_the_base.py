"""Claims: a plan's energy is what MuJoCo then measures, on bases and arms that give way.

Solar arrays and sloshing propellant on a satellite, with and without its pointing law; a boom
that bends under the arm; gears of 2e3 N m/rad with 40 kg in the hand.

Missed: mean strain energy of the arrays of `servicer-flexible` after `refined` over that after
the straight line, 2 s, twenty queries: promised 0.05, measured 0.060.
"""

from dataclasses import replace

import numpy as np
import pytest

from tests.claims.test_macro_micro import BRAKED
from ves_gym.effects.payload import PayloadMass
from ves_gym.mechanics.arm_library import get_arm
from ves_gym.mechanics.link import Gear
from ves_gym.mechanics.vehicle import BENT, SERVICER_FLEXIBLE
from ves_gym.planners.coupling import band_limited, coupling_matrix
from ves_gym.planners.motion_problem import MotionProblem
from ves_gym.planners.query import Query, solve
from ves_gym.planners.registry import get_planner
from ves_gym.planners.suites import reach100
from ves_gym.simulation.playback import play_motions
from ves_gym.system.energy import TAIL
from ves_gym.system.system import System

PUMA = get_arm("puma560")


def geared():
    """PUMA with 40 kg in its hand, every gear giving way."""
    arm = PUMA
    for _ in range(2):  # of 20 kg each, the most that one may weigh
        arm = PayloadMass(mass=20.0).arm(arm)
    gear = Gear(compliance=1 / 2e3, damping=2.0)
    return replace(arm, links=tuple(replace(link, gear=gear) for link in arm.links))


SYSTEMS = {
    "arrays": System(vehicle=replace(SERVICER_FLEXIBLE, pointing=None)),
    "pointing": System(vehicle=SERVICER_FLEXIBLE),
    "boom": BRAKED,
    "gears": System(arm=geared(), vehicle=BENT),
}
ENDS = {"start": (0.4, -1.1, 0.9), "goal": (-0.5, 0.2, -0.4)}


def query(name, **changes):
    return Query(system=SYSTEMS[name], **{"duration": 2.0, **ENDS, **changes})


def played(asked, motions):
    """Energies of motions on MuJoCo; where pulses of jets act on the kernel, its equal."""
    backend = "auto" if getattr(asked.system.vehicle, "pointing", None) else "mujoco"
    run = play_motions(asked.system, motions, servo=asked.servo, settle=TAIL, backend=backend)
    return run.energies()


@pytest.mark.parametrize(("name", "seconds"), [*((k, 2.0) for k in SYSTEMS), ("boom", 4.0)])
def test_predicted_is_simulated_and_refined_pays(name, seconds):
    """Measured: 0.97 to 1.01; `refined` leaves 0.03 to 0.33 of the straight line's E_mean."""
    asked = query(name, duration=seconds)
    plans = [solve(get_planner(planner), asked) for planner in ("straight", "refined")]
    assert all(plan.feasible for plan in plans)
    straight, refined = played(asked, [plan.motion for plan in plans])
    for plan, found in zip(plans, (straight, refined), strict=True):
        ratio = plan.predicted.E_mean / found.E_mean
        print(name, plan.planner, f"{ratio:.4f}")
        assert 0.95 <= ratio <= 1.05
    print(name, f"{refined.E_mean / straight.E_mean:.4f}")
    assert refined.E_mean <= (0.7 if name == "pointing" else 0.3) * straight.E_mean


@pytest.mark.slow
@pytest.mark.parametrize("seconds", [2.0, 4.0])
def test_with_its_pointing_law_on_no_plan_is_worse(seconds):
    """Ten queries of reach100."""
    suite = reach100(System(), "servicer-flexible", 10, durations=(seconds,))
    predicted, left = [], []
    for _, asked in suite.queries:
        plans = [solve(get_planner(planner), asked) for planner in ("straight", "refined")]
        assert all(plan.feasible for plan in plans)
        straight, refined = found = played(asked, [plan.motion for plan in plans])
        predicted += [p.predicted.E_mean / e.E_mean for p, e in zip(plans, found, strict=True)]
        left.append(refined.E_mean / straight.E_mean)
    print(f"{seconds:g} s: {min(predicted):.3f} to {max(predicted):.3f};", end=" ")
    print(f"median {np.median(left):.2f}, worst {max(left):.2f}")
    assert min(predicted) >= 0.95 and max(predicted) <= 1.05
    assert max(left) <= 1.0


@pytest.mark.parametrize("name", ["boom", "gears"])
def test_the_load_of_springs_has_its_derivative(name):
    """Central differences of `MotionProblem.momentum` along three directions."""
    problem = MotionProblem(query(name), 4, nodes=24)
    rng, h = np.random.default_rng(0), 1e-5
    x = problem.straight + 0.1 * rng.normal(size=problem.straight.size)
    u, slope = problem.momentum(x)
    form = problem.energy
    expected = form.linear.load(problem.motion(x), form.t).ravel()
    assert u == pytest.approx(expected, rel=1e-9, abs=1e-9)
    for way in rng.normal(size=(3, x.size)):
        ahead, back = (problem.momentum(x + s * h * way)[0] for s in (1, -1))
        assert slope @ way == pytest.approx(
            (ahead - back) / (2 * h), abs=1e-6 * np.abs(u).max()
        )


def test_maps_know_arrays_and_booms():
    """Q_T tends to Q for short motions; what hangs on springs is strained by a step."""
    q = np.array([0.3, -0.7, 0.5])
    for name in ("arrays", "boom"):
        Q, fast = coupling_matrix(SYSTEMS[name], q), band_limited(SYSTEMS[name], q, 1e-4)
        assert np.linalg.eigvalsh(Q)[-1] > 0
        np.testing.assert_allclose(fast, Q, atol=1e-4 * np.abs(Q).max())


def test_a_plan_says_what_it_does_not_know():
    late = (  # the simulated arm is 0.0270 rad from it
        "the servo gives way to the base: joint 3 will be 0.0272 rad from the goal when the"
        " motion ends, at most 0.005 is an answer",
    )
    known = {"arrays": ("jets: taken as off",), "pointing": (), "boom": (), "gears": late}
    for name, expected in known.items():
        assert solve(get_planner("straight"), query(name)).notes == expected
    loose = Gear(compliance=1e-4, gap=2e-3)
    arm = replace(PUMA, links=tuple(replace(k, gear=loose, damping=1.0) for k in PUMA.links))
    found = solve(get_planner("straight"), Query(system=System(arm=arm), duration=2.0, **ENDS))
    assert found.notes == (
        "play of gears at joints 1, 2, 3, up to 0.002 rad: taken as none",
        "friction of the joints: taken as none",
    )
    fast = solve(get_planner("straight"), query("pointing", duration=0.3))
    assert any("the pointing law would" in note for note in fast.notes), fast.notes
