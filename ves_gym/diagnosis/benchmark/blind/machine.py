"""The nominal machine of the benchmark: the only file that asks the library for a system."""

from __future__ import annotations

from typing import Any

from ves_gym.hardware.force_sensor import ForceSensor
from ves_gym.hardware.platform import PoseServo
from ves_gym.mechanics.servo import HIGH_GAINS
from ves_gym.mechanics.vehicle import BENT_THESIS
from ves_gym.system.emulator_settings import EmulatorSettings
from ves_gym.system.system import System


def nominal() -> System:
    """PUMA 560 on the emulated bent beam of the thesis, loop at 200 Hz, all settings explicit.

    Without payload compensation the platform must be slow enough for the loop to be stable
    and the arm's motors carry its weight, as nothing else does.
    """
    return System(
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


def controller() -> dict[str, Any]:
    """The joint servo, as written into the logs."""
    return {"kp": list(HIGH_GAINS.kp), "kd": list(HIGH_GAINS.kd), "feedforward": True}
