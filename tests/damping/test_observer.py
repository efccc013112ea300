"""The base's motion found from its measured pose."""

import numpy as np
import pytest

from ves_gym._util.params import ParameterError
from ves_gym.damping.observer import BaseObserver
from ves_gym.mechanics.arm import matrix
from ves_gym.mechanics.vehicle import BENT_THESIS, MatrixVehicle
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.system import System

Q = np.array([[0.8, 0.2, -0.3], [0.5, -0.4, 0.6]])
Y = np.array([[0.03, -0.02, 0.01, 0.0, 0.002, 0.0], [0.0, 0.04, 0.0, 0.001, 0.0, -0.002]])
STILL = np.zeros((2, 6))


def with_modes():
    bent = System(vehicle=BENT_THESIS).base
    coupling = 7.0 * np.eye(6)[:, [0, 4]]
    vehicle = MatrixVehicle(
        **{name: matrix(getattr(bent, name)) for name in "MDK"},
        coupling=matrix(coupling),
        omega=(2.0, 5.0),
    )
    return System(vehicle=vehicle, physics_dt=2.5e-3)


@pytest.mark.parametrize("noise", [0.0, 1e-4])
def test_rates_and_internal_modes_are_found_from_the_pose(noise):
    """Arm held stiffly on a released base; the observer begins with no idea of it.

    Tolerance: after 3 s five percent of what the largest of them reaches; 50 % with
    0.1 mm of noise, which differences of poses would turn into 0.01 m/s.
    """
    system, rng = with_modes(), np.random.default_rng(0)
    sim = Simulator(system.replace(drive="prescribed"), 2)
    sim.reset(q=Q, y=Y)
    observer = BaseObserver(system, Q, system.control_dt)
    observer.begin(0 * Y, 0 * Y, STILL)
    gaps, sizes = [], []
    for _ in range(400):
        sim.step(np.zeros((2, 3)))
        state, (u, _) = sim.state, sim.base_modes
        observer.step(STILL, STILL, state.y + noise * rng.normal(size=(2, 6)))
        for i in range(2):
            found = observer.base_state(i, observer.s[i], np.zeros(6))
            gaps.append(np.r_[found.yd[:3] - state.yd[i, :3], found.u - u[i]])
            sizes.append(np.r_[state.yd[i, :3], u[i]])
    late = slice(480, None)
    error, size = (np.sqrt(np.mean(np.square(k[late]), axis=0)) for k in (gaps, sizes))
    assert (error < (0.05 if not noise else 0.5) * size.max()).all(), (error, size)


def test_what_is_no_period():
    with pytest.raises(ParameterError, match="dt must be > 0 s"):
        BaseObserver(System(vehicle=BENT_THESIS), Q, 0.0)
