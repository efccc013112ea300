"""Claim: a second arm that is free to move takes the energy out of the base.

Two UR5e stand 1 m apart; one goes from random angles to random ones in 2 s, planned by `direct`
with the other held or free. Both motions are simulated on the full nonlinear system. On `bent`
the second arm leaves at most 0.2 of what is left while it is held; on a free satellite
of 800 kg at most 0.2 of what the straight line leaves.

Medians of twenty queries (the slow tests print them). `bent`: 0.019 of what is left while the
second arm is held. Satellite: 0.071 of the straight line's energy, 0.30 of its angle at the
end.

Missed: two UR5e on a satellite, energy and angle at the end with the second arm free over those
with it held, both planned by `direct`: promised 0.2, measured 0.22 and 0.48.
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


def left(system: System, start: np.ndarray, goal: np.ndarray, planner: str) -> np.ndarray:
    """E_mean of a planned motion, simulated [J], and the base's angle as it ends [rad]."""
    plan = vg.plan(start, goal, system=system, planner=planner)
    assert plan.feasible, plan.failure
    log = vg.simulate(plan, system)
    end = np.searchsorted(log.t, plan.motion.duration)
    return np.array([vg.energy(log).E_mean, np.linalg.norm(log.y[end, 3:])])


@pytest.mark.parametrize("count", [3, pytest.param(20, marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    ("vehicle", "held_by"),
    [(BENT, "direct"), (Satellite(body=get_vehicle("servicer").body), "straight")],
    ids=["bent", "satellite"],
)
def test_the_second_arm_takes_the_energy(vehicle, held_by, count):
    system, rng = System(arms=ARMS, vehicle=vehicle), np.random.default_rng(1)
    ratios: dict[str, list[np.ndarray]] = {"straight": [], "direct": []}
    for _ in range(count):
        start = np.r_[rng.uniform(LOW, HIGH), rng.uniform(LOW, HIGH)]
        goal = rng.uniform(LOW, HIGH)
        free = left(system, start, goal, "direct")
        for planner, found in ratios.items():
            found.append(free / left(system, start, np.r_[start[:6], goal], planner))
    for planner, found in ratios.items():
        print(f"E, angle over {planner}, held: {np.median(found, axis=0).round(3)} of {count}")
    assert np.median(ratios[held_by], axis=0)[0] <= 0.2
