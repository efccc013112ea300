"""Exudyn 1.13.6: plans of this package played by an arm on beams that are not its own."""

from dataclasses import replace

import numpy as np
import pytest

import ves_gym as vg
from tests.foreign.servo_loop import link_rows, queries, row, without_rotors
from ves_gym.mechanics.arm_library import PUMA_560
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.energy import log_base_energy

pytestmark = pytest.mark.slow
TAIL = 2.0  # s after the motion

ARM = without_rotors(PUMA_560)


def sheared(vehicle):
    """The beam as Exudyn has it: undamped, its tubes shear, and more modes ring."""
    members = [
        replace(k, section=replace(k.section, shear=True)) for k in vehicle.structure.members
    ]
    structure = replace(vehicle.structure, members=tuple(members))
    return replace(vehicle, structure=structure, damping_ratio=0.0, modes=14)


def commands(system, motion, times):
    """(times, n) torques beside those of the servos, see exudyn_beam.py."""
    sim = Simulator(system)
    wanted = motion.at(times)
    forward = sim.servo.torque_feedforward(system.arm, wanted)
    return sim.servo, sim.servo_command(wanted.q[None], wanted.v[None], forward[None])[0]


@pytest.mark.parametrize("duration", [1.0, 2.0, 4.0])
@pytest.mark.parametrize("name", ["bent", "straight-vertical"])
def test_energy_of_plans(foreign, name, duration):
    """E of `refined` over the straight line's: theirs over ours within 2 %."""
    vehicle = sheared(vg.get_vehicle(name))
    system = vg.System(arm=ARM, vehicle=vehicle)
    step = 2.5e-3 * min(duration, 2.0)  # s, theirs: the quickest plans take sharp torques
    times = np.arange(round((duration + TAIL) / step) + 1) * step
    played, starts, ours = [], [], []
    for start, goal in queries(ARM, duration):
        for planner in ("straight", "refined"):
            plan = vg.plan(start, goal, duration=duration, planner=planner, system=system)
            log = vg.simulate(plan, settle=TAIL)
            servo, command = commands(system, plan.motion, times)
            played.append(command)
            starts.append(plan.motion.start)
            total = log_base_energy(log).total[:: round(step / system.physics_dt)]
            ours.append(total[: len(times)])
    members = [
        [*k.vector, k.section.outer_diameter, k.section.wall] for k in vehicle.structure.members
    ]
    material = vehicle.structure.members[0].material
    theirs = foreign(
        "exudyn", "exudyn_beam", members=members, hub=row(ARM.base), links=link_rows(ARM),
        material=[material.youngs_modulus, material.shear_modulus, material.density],
        kp=servo.kp, kd=servo.kd, command=played, start_q=starts, step=step,
    )["E"]  # fmt: skip
    a, b = (np.mean(k, axis=1).reshape(-1, 2) for k in (theirs, ours))
    found = (a[:, 1] / a[:, 0]) / (b[:, 1] / b[:, 0])
    print(f"{name} {duration:g} s: straight {a[0, 0]:.5g} / {b[0, 0]:.5g} J, refined"
          f" {a[0, 1]:.5g} / {b[0, 1]:.5g} J; refined over straight, theirs over ours:"
          f" {found.min():.4f} to {found.max():.4f}; medians {np.median(a[:, 1] / a[:, 0]):.4f}"
          f" / {np.median(b[:, 1] / b[:, 0]):.4f}")  # fmt: skip
    assert ((found > 0.98) & (found < 1.02)).all()
