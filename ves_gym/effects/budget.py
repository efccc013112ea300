"""The nominal error budget of the laboratory: what is left after careful calibration.

The thesis prints no noise figures (App. F has lost its plots). These are nominal, this
project: with them the Model Method leaves the errors of Table 3-1 (docs/claims.md).
"""

from __future__ import annotations

from ves_gym.effects.sensor_drift import SensorDrift
from ves_gym.effects.sensor_noise import SensorNoise
from ves_gym.system.effect import Effect

LABORATORY_ERRORS: tuple[Effect, ...] = (
    SensorNoise(force=(0.35, 0.2, 0.4), moment=(0.3, 0.3, 0.05)),
    SensorDrift(force=(0.25, 0.12, 0.2), moment=(0.5, 0.72, 0.03), time=60.0),
)
