"""What a controller sees through a low-pass of the joint rates."""

import numpy as np
import scipy

from ves_gym.effects import JointVelocityLag
from ves_gym.mechanics.vehicle import BENT_THESIS
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.system import System

TIMES = np.array([0.02, 0.0, 0.05])


def test_seen_rates_are_the_true_ones_low_passed():
    system = System(
        vehicle=BENT_THESIS, effects=(JointVelocityLag(time_constant=tuple(TIMES)),)
    )
    sim = Simulator(system, 1, warn_at=None)
    true, seen = [], []
    for k in range(200):
        sim.step(sim.servo_command(0.2 * np.sin(0.1 * k) * np.ones((1, 3)), np.zeros((1, 3))))
        q, v = sim.measured
        assert (q == sim.state.q).all()
        true.append(sim.state.v[0])
        seen.append(v[0])
    true, seen = np.array(true), np.array(seen)
    assert (seen[:, 1] == true[:, 1]).all()
    dt = system.physics_dt * system.substeps
    for i in (0, 2):
        b, a, _ = scipy.signal.cont2discrete(([1.0], [TIMES[i], 1.0]), dt, method="foh")
        want = scipy.signal.lfilter(np.ravel(b), a, true[:, i])
        # between two samples the rate is not quite linear
        assert np.abs(seen[:, i] - want)[50:].max() < 0.02 * np.abs(true[:, i]).max()
        assert np.abs(seen[:, i] - true[:, i])[50:].max() > 0.05 * np.abs(true[:, i]).max()
