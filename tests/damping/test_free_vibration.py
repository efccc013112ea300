"""The base let go: linear model against simulator; its motion found from its measured pose."""

import numpy as np
import pytest

from tests.arms import with_modes
from ves_gym.damping.free_vibration import linear_free_vibration, simulate_free_vibration
from ves_gym.damping.observer import BaseObserver
from ves_gym.damping.plant import THESIS_DISPLACEMENT, GainMatrices, analyse, plant_at
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.servo import HIGH_GAINS, PPED_GAINS
from ves_gym.mechanics.vehicle import BENT_THESIS, STRAIGHT_VERTICAL_THESIS
from ves_gym.simulation.machines import Divergence
from ves_gym.simulation.playback import play_motions
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.energy import energies
from ves_gym.system.system import System

BENT = System(vehicle=BENT_THESIS)

Q = np.deg2rad([45.0, 0.0, 0.0])
FULL = GainMatrices(
    np.array([[300.0, 80, -20], [80, 200, 40], [-20, 40, 90]]),
    np.array([[20.0, 4, 1], [4, 15, -3], [1, -3, 8]]),
)
SETS = [GainMatrices.of(HIGH_GAINS), GainMatrices.of(PPED_GAINS), FULL]
SMALL = 0.01 * np.array(THESIS_DISPLACEMENT)


def test_a_small_release_is_linear():
    """1 mm, 5 s. Tolerance: second order of the motion; the coupling torque of the full
    matrices is held over steps of 1.25 ms."""
    linear, simulated = (
        f(BENT, Q, SETS, SMALL, seconds=5.0)
        for f in (linear_free_vibration, simulate_free_vibration)
    )
    size = np.abs(linear.y).max(axis=(1, 2))
    gap = np.abs(simulated.y - linear.y).max(axis=(1, 2)) / size
    assert (gap[:2] <= 1e-4).all() and gap[2] <= 1e-3
    for name in ("strain", "total"):
        a, b = getattr(linear, name), getattr(simulated, name)
        np.testing.assert_allclose(a, b, atol=1e-3 * a.max())
    for name in ("swing", "effort"):
        np.testing.assert_allclose(getattr(simulated, name), getattr(linear, name), rtol=5e-3)


def test_the_simulated_release_is_that_of_the_suite():
    """`play_motions` with the same servo, and `energies` of what it records."""
    run = simulate_free_vibration(BENT, Q, SETS[1:2], seconds=12.0)
    stay = Motion.straight(Q, Q, 2.0)
    played = play_motions(BENT, [stay], servo=PPED_GAINS, y=THESIS_DISPLACEMENT, settle=10.0)
    np.testing.assert_allclose(run.y[0], played.y[0], atol=1e-12)
    measures = energies(BENT, run.t, played.q, played.y, played.yd, duration=2.0)[0]
    assert run.E_int[0] == pytest.approx(measures.E_int, rel=1e-9)
    assert run.t_5[0] == pytest.approx(measures.t_5, abs=1e-9)
    analysis = analyse(plant_at(BENT, Q), SETS[1])
    assert run.t_5[0] == pytest.approx(analysis.t_5, abs=0.05)


def test_stiff_modes_are_sampled_finely():
    """Straight beam along its axis, 40 Hz: the integral of the records is the closed form."""
    system, y = System(vehicle=STRAIGHT_VERTICAL_THESIS), [0, 0, 1e-3, 0, 0, 0]
    run = linear_free_vibration(system, Q, SETS[:1], y, seconds=30.0)
    analysis = analyse(plant_at(system, Q), SETS[0], y)
    assert run.E_int[0] == pytest.approx(analysis.E_int, rel=5e-3)


def test_a_saturated_motor_shows_in_the_effort():
    """Ten times the displacement asks for more torque than the high gains may give."""
    release = BENT, Q, SETS[:1], 5 * np.array(THESIS_DISPLACEMENT)
    assert simulate_free_vibration(*release, seconds=0.5).effort.max() == pytest.approx(1.0)
    assert linear_free_vibration(*release, seconds=0.5).effort.max() > 1.5


def test_a_run_that_diverges_is_named():
    with pytest.raises(Divergence, match="simulation 0"):
        simulate_free_vibration(BENT, Q, SETS[:1], [1e3, 1e3, 1e3, 0, 0, 0], seconds=1.0)


# --------------------------------------------------------------------------------- the observer

ANGLES = np.array([[0.8, 0.2, -0.3], [0.5, -0.4, 0.6]])
POSES = np.array([[0.03, -0.02, 0.01, 0.0, 0.002, 0.0], [0.0, 0.04, 0.0, 0.001, 0.0, -0.002]])
STILL = np.zeros((2, 6))


@pytest.mark.parametrize("noise", [0.0, 1e-4])
def test_rates_and_internal_modes_are_found_from_the_pose(noise):
    """Arm held stiffly on a released base; the observer begins with no idea of it.

    Tolerance: after 3 s five percent of what the largest of them reaches; 50 % with
    0.1 mm of noise, which differences of poses would turn into 0.01 m/s.
    """
    system, rng = with_modes(7.0).replace(physics_dt=2.5e-3), np.random.default_rng(0)
    sim = Simulator(system.replace(drive="prescribed"), 2)
    sim.reset(q=ANGLES, y=POSES)
    observer = BaseObserver(system, ANGLES, system.control_dt)
    observer.begin(0 * POSES, 0 * POSES, STILL)
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
