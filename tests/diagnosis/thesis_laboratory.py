"""The PUMA 560 in the thesis's laboratory, and noise of readings as it might be there."""

import numpy as np
import scipy

from ves_gym.hardware.force_sensor import ForceSensor
from ves_gym.hardware.platform import PoseServo
from ves_gym.mechanics.vehicle import BENT_THESIS
from ves_gym.system.emulator_settings import EmulatorSettings
from ves_gym.system.system import System

SYSTEM = System(
    vehicle=BENT_THESIS,
    mode="emulated",
    control_dt=5e-3,
    emulator=EmulatorSettings(
        platform=PoseServo(bandwidth=10.0, damping_ratio=0.7, rate_feedforward=True),
        sensor=ForceSensor(cutoff=40.0),
        delay=1,
        payload_compensation=False,
        joint_balance=False,
    ),
)
"""Without payload compensation the platform must be slow for the loop to be stable."""

STD = {  # rad, rad/s, N m, m and rad, N and N m
    "q": np.array([1.3e-4, 2e-4, 2.5e-4]),  # times kp: that of the torque
    "v": np.full(3, 2e-3),
    "tau": np.array([0.4, 0.4, 0.25]),
    "y": np.array([5e-5, 5e-5, 5e-5, 2e-5, 2e-5, 2e-5]),
    "w": np.array([0.35, 0.3, 0.4, 0.3, 0.3, 0.15]),
}
COLOUR = {"q": 0.3, "v": 0.6, "tau": 0.5, "y": 0.7, "w": 0.4}  # from sample to sample


def coloured(std, colour, samples, rng):
    """Return AR(1) noise (samples, len(std)): each of a deviation, neighbours correlated."""
    fresh = rng.standard_normal((samples + 50, len(std)))
    gain = np.sqrt(1 - colour**2)
    path = scipy.signal.lfilter([gain], [1.0, -colour], fresh, axis=0)[50:]
    return path * std
