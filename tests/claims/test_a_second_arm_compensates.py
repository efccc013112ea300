"""Claim: a second arm that is free to move takes the energy out of the base.

Two UR5e stand 1 m apart; one goes from random angles to random ones in 2 s with the other held
or free. Both motions are simulated on the full nonlinear system. On `bent`, both planned by
`direct`, the second arm leaves at most 0.2 of what is left while it is held; on a free
satellite of 800 kg at most 0.2 of what the straight line leaves, and with a bound on the
attitude at the end (`calm:attitude_end=0.15`) at most 0.2 of its energy and of its angle.

Medians (the slow tests print them). `bent`, twenty queries: 0.019 of what is left while the
second arm is held. Satellite, of the straight line: `direct`, twenty queries, 0.071 of its
energy and 0.30 of its angle at the end; with the bound, nine queries, 0.15 and 0.148.

Missed: two UR5e on a satellite, energy and angle at the end with the second arm free over those
with it held, both planned by `direct`: promised 0.2, measured 0.22 and 0.48.
"""

import numpy as np
import pytest

import ves_gym as vg
from ves_gym.mechanics.arm_library import get_arm
from ves_gym.mechanics.vehicle import BENT, Satellite, Vehicle, get_vehicle
from ves_gym.planners.bounds import USUAL
from ves_gym.system.system import System

UR5E = get_arm("ur5e")
ARMS = [UR5E.at((0.0, 0.5, 0.0)), UR5E.at((0.0, -0.5, 0.0))]
LOW, HIGH = np.array([-1, -2.2, -1.5, -1, -1, -1]), np.array([1, -0.6, 1.5, 1, 1, 1])


def left(system: System, start: np.ndarray, goal: np.ndarray, planner: str) -> np.ndarray:
    """E_mean of a planned motion, simulated [J], and the base's angle as it ends [rad]."""
    plan = vg.plan(start, goal, system=system, planner=planner)
    assert plan.feasible, plan.failure
    log = vg.simulate(plan, system)
    end = np.searchsorted(log.t, plan.motion.duration)
    return np.array([vg.energy(log).E_mean, np.linalg.norm(log.y[end, 3:])])


SATELLITE = Satellite(body=get_vehicle("servicer").body)
LIFTED = "+".join(f"{name}=inf" for name in USUAL)  # of the bounds on how it shakes
POINTED = f"calm:attitude_end=0.15+{LIFTED}"


def shares(vehicle: Vehicle, count: int, planner: str, held_by: str) -> np.ndarray:
    """Medians of energy and angle with the second arm free, of those with it held."""
    system, rng, found = System(arms=ARMS, vehicle=vehicle), np.random.default_rng(1), []
    for _ in range(count):
        start = np.r_[rng.uniform(LOW, HIGH), rng.uniform(LOW, HIGH)]
        goal = rng.uniform(LOW, HIGH)
        held = left(system, start, np.r_[start[:6], goal], held_by)
        found.append(left(system, start, goal, planner) / held)
    print(f"E, angle by {planner} over {held_by}, held: {np.median(found, axis=0).round(3)}")
    return np.median(found, axis=0)


@pytest.mark.parametrize("count", [3, pytest.param(20, marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    ("vehicle", "held_by"),
    [(BENT, "direct"), (SATELLITE, "straight")],
    ids=["bent", "satellite"],
)
def test_the_second_arm_takes_the_energy(vehicle, held_by, count):
    assert shares(vehicle, count, "direct", held_by)[0] <= 0.2


@pytest.mark.slow
def test_with_a_bound_on_the_attitude_it_takes_energy_and_turn():
    assert (shares(SATELLITE, 9, POINTED, "straight") <= 0.2).all()
