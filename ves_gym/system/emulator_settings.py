"""`EmulatorSettings`: the machine that moves the arm as the vehicle would (thesis 2)."""

from __future__ import annotations

from dataclasses import dataclass

from ves_gym._util.params import (
    ParameterError,
    integer,
    require_choice,
    require_positive,
    require_types,
    unit,
)
from ves_gym.hardware.admittance import FORMS
from ves_gym.hardware.force_sensor import ForceSensor
from ves_gym.hardware.leg_servo import LegServo
from ves_gym.hardware.platform import PoseServo
from ves_gym.hardware.stewart import VES, Stewart
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.gravity import GRAVITY, GravityModel

OPERATIONS = ("microgravity", "admittance", "position")


@dataclass(frozen=True, kw_only=True)
class EmulatorSettings:
    """Settings of the Vehicle Emulation System. The sample rate is the System's control_dt.

    `operation` (thesis 2.2): `position`, the platform follows a given motion;
    `admittance`, it moves as the vehicle under all the sensor feels, weight included;
    `microgravity`, the estimated weight of the arm is subtracted first (eq. 2.1).

    `payload_compensation` (this project, docs/physics.md) integrates vehicle and arm
    together and adds what the arm's inertia must have done to the reading; it makes
    vehicles lighter than the arm emulable.

    `joint_balance` carries the joints' share of the arm's weight (thesis 3.1: "joint
    balancing"), outside the motors.
    """

    operation: str = "microgravity"
    platform: PoseServo | LegServo = PoseServo()
    stewart: Stewart = VES
    sensor: ForceSensor = ForceSensor()
    gravity: GravityModel | None = None  # None: exact
    zero_at_start: bool = False  # set the sensor's zero from the estimate at every reset
    admittance_form: str = "coupled"
    delay: int = 1  # control periods from a reading to the command it causes
    payload_compensation: bool = True
    joint_balance: bool = True
    force_max: float = unit("N", default=3000.0)  # safety: reading that freezes the platform
    moment_max: float = unit("N m", default=2000.0)

    def __post_init__(self) -> None:
        require_choice(self, "operation", OPERATIONS)
        require_choice(self, "admittance_form", FORMS)
        require_positive(self, "force_max", "moment_max")
        require_types(self, "platform", "stewart", "sensor", "gravity", "zero_at_start")
        require_types(self, "payload_compensation", "joint_balance")
        delay = integer(self.delay, "EmulatorSettings.delay")  # control periods
        object.__setattr__(self, "delay", delay)

    def lag(self, control_dt: float) -> float:
        """Delay from wrench to motion for slow motion [s]: sensor, computer, platform."""
        # The command for the end of a period is sent `delay` periods after its reading, and
        # rests on a wrench held over that period.
        command = (self.delay - 1) * control_dt + control_dt / 2
        moving = isinstance(self.platform, PoseServo) and self.platform.rate_feedforward
        hold = 0.0 if moving else control_dt / 2
        return self.sensor.lag + command + hold + self.platform.lag


def require_carried(settings: EmulatorSettings, arm: Arm) -> None:
    """Refuse an arm whose weight alone freezes the platform in the first period of every run.

    Args:
        settings: of the machine; one whose sensor is zeroed with the arm on it does not read
            the weight.
        arm: that stands on the platform.

    Raises:
        ParameterError: says the weight and the limit.
    """
    weight = arm.mass * GRAVITY
    if weight > settings.force_max and not settings.zero_at_start:
        raise ParameterError(
            f"mode emulated: {arm.name} weighs {weight:.0f} N, and the platform's safety stop"
            f" acts at EmulatorSettings.force_max = {settings.force_max:g} N: every run would"
            " stop at once. Take a lighter arm, mode ideal, or the settings of a platform that"
            " carries it (force_max, moment_max, stewart)"
        )


NOMINAL = EmulatorSettings()
