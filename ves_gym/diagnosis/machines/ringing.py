"""A loop or a vehicle that rings just as it is described: no fault of its recording."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ves_gym._util.params import Array
from ves_gym.mechanics.servo import JointServo
from ves_gym.simulation.stability import in_space, linearise, poles_in_space
from ves_gym.system.system import System

_NEAR = 0.03  # by which a mode's frequency may differ from that of a tone, relative
_DAMPED = 0.05  # ratio: a mode with more rings too briefly to be taken for a tone


def loop_rings(
    system: System, servo: JointServo | None, angles: Sequence[Array], frequency: float
) -> bool:
    """Return True if the linearised system has a hardly damped mode at a frequency.

    In mode emulated that of the loop over a control period, in mode ideal that of base,
    servo-held joints and internal modes.

    Args:
        system: as described.
        servo: of the joints; None where the drive has none.
        angles: (joints,) configurations at which to look [rad].
        frequency: Hz.
    """
    if system.mode == "emulated" and (
        servo is None or system.emulator_settings.operation == "position"
    ):
        return False
    for q in angles:
        if system.mode == "emulated":
            z = np.linalg.eigvals(linearise(system, q, servo=servo).A).astype(complex)
            poles = np.log(z[np.abs(z) > 1e-9]) / system.control_dt
        else:
            poles = poles_in_space(*in_space(system, q, servo=servo))
        near = np.abs(np.abs(poles.imag) / (2 * np.pi * frequency) - 1) < _NEAR
        if (near & (poles.real > -_DAMPED * np.abs(poles))).any():
            return True
    return False
