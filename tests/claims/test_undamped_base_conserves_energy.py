"""Claim: the base neither gains nor loses energy on its own.

Free vibration of the undamped bent beam for 10 s, joints prescribed at rest, rk4 at the
default step. References: E(t) itself; the frequencies of `modes`; with damping, the
closed-form decay of a mode, exp(-2 zeta omega t).

Tolerances: energy 1e-9; rk4 loses 1e-10 in 10 s, (omega dt)^6 / 144 per step. Frequency 1e-6
for amplitudes of about 1e-4 m: rk4's phase error is (omega dt)^4 / 120 = 5e-10, and geometric
nonlinearity is of the order of the amplitude squared.
"""

import dataclasses

import numpy as np
import pytest

from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.vehicle import BENT_THESIS
from ves_gym.planners.coupling import blocks, modes
from ves_gym.simulation.playback import play_motions
from ves_gym.simulation.recording import Recording
from ves_gym.system.energy import base_energy
from ves_gym.system.system import System

POSE = np.deg2rad([45.0, -20.0, 60.0])
HOLD = Motion.straight(POSE, POSE, 1.0)
RELEASE = np.array([0.1, 0.1, 0.1, 0.0, 0.0, 0.0])  # thesis 4.3.2


def vibrate(y: np.ndarray, **changes) -> Recording:
    """10 s of free vibration from rest at the pose y."""
    beam = dataclasses.replace(BENT_THESIS, damping_ratio=changes.pop("damping_ratio", 0.0))
    system = System(vehicle=beam, drive="prescribed", **changes)
    return play_motions(system, [HOLD], settle=9.0, y=y)


def energy(run: Recording) -> np.ndarray:
    return base_energy(run.system, run.q, run.y, run.yd).total[0]


def test_energy_is_kept():
    E = energy(vibrate(RELEASE))
    assert E[0] == pytest.approx(0.5 * RELEASE @ BENT_THESIS.stiffness() @ RELEASE, rel=1e-12)
    assert np.abs(E / E[0] - 1).max() <= 1e-9


def test_energy_changes_hands():
    """Not a frozen base: strain falls below a third of the total within a period."""
    run = vibrate(RELEASE)
    parts = base_energy(run.system, run.q, run.y, run.yd)
    assert parts.strain[0].min() < parts.total[0, 0] / 3
    assert np.abs(run.q[0] - POSE).max() <= 1e-15  # the joints stay where they are


def modal_angle(run: Recording, mode: int) -> np.ndarray:
    """Unwrapped phase of a modal coordinate [rad]."""
    found = modes(run.system, POSE)
    project = found.shapes[:, mode] @ blocks(run.system, POSE).Mt
    place, rate = run.y[0] @ project, run.yd[0] @ project
    return np.unwrap(np.angle(found.omega[mode] * place - 1j * rate))


@pytest.mark.parametrize("mode", range(6))
def test_frequency_is_that_of_modes(mode):
    shape = modes(System(vehicle=BENT_THESIS), POSE).shapes[:, mode]
    run = vibrate(1e-4 * shape / np.abs(shape).max())
    rate = np.polyfit(run.t, modal_angle(run, mode), 1)[0]
    assert rate == pytest.approx(modes(run.system, POSE).omega[mode], rel=1e-6)


def test_another_pose_has_another_frequency():
    """The comparison sees a joint moved by 5 degrees."""
    shape = modes(System(vehicle=BENT_THESIS), POSE).shapes[:, 4]
    run = vibrate(1e-4 * shape / np.abs(shape).max())
    rate = np.polyfit(run.t, modal_angle(run, 4), 1)[0]
    other = modes(run.system, POSE + np.deg2rad([0.0, 5.0, 0.0])).omega[4]
    assert rate != pytest.approx(other, rel=1e-4)


def test_damping_is_seen():
    """5 % modal damping is of the bare beam; the loaded mode's own ratio follows from D.

    Compared with the eigenvalues of the linear base: end energy to 1 %.
    """
    system = System(vehicle=BENT_THESIS)
    base, Mt = system.base, blocks(system, POSE).Mt
    inverse = np.linalg.inv(Mt)
    A = np.block([[np.zeros((6, 6)), np.eye(6)], [-inverse @ base.K, -inverse @ base.D]])
    values, vectors = np.linalg.eig(A)
    start = 1e-3 * np.r_[RELEASE, np.zeros(6)]
    end = (vectors * np.exp(10.0 * values)) @ np.linalg.solve(vectors, start)
    y, yd = end.real[:6], end.real[6:]
    expected = 0.5 * (y @ base.K @ y + yd @ Mt @ yd)
    E = energy(vibrate(1e-3 * RELEASE, damping_ratio=0.05))
    assert E[-1] == pytest.approx(expected, rel=0.01)
    assert E[-1] < 0.2 * E[0]


def test_a_step_too_long_is_refused():
    """The stability limit omega dt < 2.8 of rk4: beyond it, an error instead of a blow-up."""
    with pytest.raises(ValueError, match="physics_dt must be <="):
        vibrate(RELEASE, physics_dt=0.5, control_dt=0.5)
