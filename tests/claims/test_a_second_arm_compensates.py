"""Claim: a second arm that is free to move takes the energy out of the base.

Two UR5e stand 1 m apart; one goes from random angles to random ones in 2 s, planned by `direct`
with the other held or free. Both motions are simulated on the full nonlinear system. On `bent`
the second arm leaves at most 0.2 of what is left while it is held; on a free satellite
of 800 kg at most 0.2 of what the straight line leaves.

Medians of twenty queries over the straight line's. `bent`: 0.0004 with the second arm free,
0.027 with it held. Satellite, with `attitude_end` weighing 10 beside the energy: energy 0.19,
angle in the end 0.041.

Missed: two UR5e on a satellite, energy and angle with the second arm free over those with it
held, both planned with `attitude_end` weighing 10: promised 0.2, measured 0.21 and 0.30; the
first arm alone leaves 0.18 of the straight line's angle, at 1.3 times its energy.
"""

import numpy as np
import pytest

import ves_gym as vg
from ves_gym.mechanics.arm_library import get_arm
from ves_gym.mechanics.vehicle import BENT, Satellite, get_vehicle
from ves_gym.system.system import System

UR5E = get_arm("ur5e")
ARMS = [UR5E.at((0.0, 0.5, 0.0)), UR5E.at((0.0, -0.5, 0.0))]
LOW, HIGH = np.array([-1, -2.2, -1.5, -1, -1, -1]), np.array([1, -0.6, 1.5, 1, 1, 1])


def left(system: System, start: np.ndarray, goal: np.ndarray, planner: str) -> float:
    """E_mean of a planned motion, simulated [J]."""
    plan = vg.plan(start, goal, system=system, planner=planner)
    assert plan.feasible, plan.failure
    return vg.energy(vg.simulate(plan, system)).E_mean


@pytest.mark.parametrize("count", [3, pytest.param(20, marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    ("vehicle", "held_by"),
    [(BENT, "direct"), (Satellite(body=get_vehicle("servicer").body), "straight")],
    ids=["bent", "satellite"],
)
def test_the_second_arm_takes_the_energy(vehicle, held_by, count):
    system, rng = System(arms=ARMS, vehicle=vehicle), np.random.default_rng(1)
    ratios = []
    for _ in range(count):
        start = np.r_[rng.uniform(LOW, HIGH), rng.uniform(LOW, HIGH)]
        goal = rng.uniform(LOW, HIGH)
        held = left(system, start, np.r_[start[:6], goal], held_by)
        ratios.append(left(system, start, goal, "direct") / held)
    print(f"{count} queries: E {np.median(ratios):.3g} of held, at most {max(ratios):.3g}")
    assert np.median(ratios) <= 0.2
