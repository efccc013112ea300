"""Numbers that effects deviate from the description, per simulation.

`LoopParameters` are those of the emulation loop, `Delays` those between joint controller and
drives. Effects add to them; the simulation reads them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from ves_gym._util.params import Array, Index, ParameterError, Rows
from ves_gym.hardware.force_sensor import SensorErrors
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.gravity import GravityModel
from ves_gym.system.emulator_settings import EmulatorSettings

# States of a joint's contact: how far its bristles are bent, and for how long it has rested.
# Bristles follow the way travelled (Dahl, 1968); friction grows with the time of rest
# (Rabinowicz, Proc. Phys. Soc. 71, 1958; Armstrong-Helouvry et al., Automatica 30(7), 1994),
# which a short way forgets. Both are exact for a rate that stays as it is over a step.
BENT = 1e-3  # rad over which bristles bend
FORGOTTEN = 1e-2  # rad of travel after which a rest is forgotten
RESTING = (0.5, 1.5, 5.0)  # s: times over which friction grows at rest


def fresh(shape: tuple[int, ...]) -> tuple[Array, Array]:
    """Return the states of contacts that have rested for long: bristles (...), ages (..., K).

    Args:
        shape: of the contacts.
    """
    return np.zeros(shape), np.ones((*shape, len(RESTING)))


def advanced(bristle: Array, age: Array, v: Array, dt: float) -> tuple[Array, Array]:
    """Return the states a step later.

    Args:
        bristle: (...) between -1 and 1.
        age: (..., K) between 0 and 1.
        v: (...) rate during the step [rad/s].
        dt: of the step [s].
    """
    way, pace = np.sign(v), np.abs(v)
    bristle = way * pace_part(pace * dt / BENT) + bristle * np.exp(-pace * dt / BENT)
    grows = 1 / np.array(RESTING)
    rate = grows + pace[..., None] / FORGOTTEN
    age = grows / rate * pace_part(rate * dt) + age * np.exp(-rate * dt)
    return bristle, age


def pace_part(x: Array) -> Array:
    """Return 1 - exp(-x): the part of the way to where a state goes."""
    return np.asarray(-np.expm1(-x))


def friction(levels: Array, bristle: Array, age: Array) -> Array:
    """Return the torque (...) on the joints [N m]; it never pushes a bristle further.

    Args:
        levels: (..., 1 + K) lasting, and per time of rest [N m].
        bristle: (...).
        age: (..., K).
    """
    level = levels[..., 0] + np.sum(levels[..., 1:] * age, axis=-1)
    return np.asarray(-bristle * np.maximum(level, 0.0))


def contacts(v: Array, dt: float) -> tuple[Array, Array]:
    """Return bristles (..., T, n) and ages (..., T, n, K) along measured rates.

    Args:
        v: (..., T, n) rad/s.
        dt: between samples [s].
    """
    x = fresh((*v.shape[:-2], v.shape[-1]))
    bristles, ages = [], []
    for k in range(v.shape[-2]):
        x = advanced(*x, v[..., k, :], dt)
        bristles.append(x[0])
        ages.append(x[1])
    return np.stack(bristles, axis=-2), np.stack(ages, axis=-3)


@dataclass
class LoopParameters:
    """Parameters of the emulation loop that effects change (leading axis n)."""

    arm: Arm
    gravity_mass: Array  # (n,) of the gravity estimate [kg]
    gravity_P: Array  # (n, p) of the gravity estimate [kg m]
    gravity_tilt: Array  # (n, 3) error of the platform angles it is given [rad]
    gravity_delay: Array  # (n,) age of the estimate [s]
    sensor: SensorErrors
    bandwidth: Array  # (n,) relative change of the platform's bandwidth
    damping: Array  # (n,) relative change of its damping ratio
    payload_scale: Array  # (n,) relative error of the compensated arm inertia
    platform_delay: Array  # (n,) of the command on its way to the platform [s]
    platform_travel: Array  # (n,) share of the legs' stroke that is missing
    platform_speed: Array  # (n,) share of the legs' speed that is missing

    @staticmethod
    def nominal(arm: Arm, emulator: EmulatorSettings, n: int) -> LoopParameters:
        """Return the parameters of the emulator as described.

        Args:
            arm: the arm.
            emulator: the description.
            n: simulations.
        """
        model = emulator.gravity or GravityModel.of(arm)
        gravity = {
            "gravity_mass": np.full(n, model.mass),
            "gravity_P": np.tile(np.asarray(model.P, float), (n, 1)),
            "gravity_tilt": np.zeros((n, 3)),
        }
        arrays = {name: np.zeros(n) for name in ARRAYS} | gravity
        return LoopParameters(arm=arm, sensor=SensorErrors.none(emulator.sensor, n), **arrays)

    @property
    def as_stated(self) -> bool:
        """True if every platform is as described."""
        return not any(getattr(self, name).any() for name in OF_PLATFORM)

    def edited(self, effects: Iterable[Any]) -> LoopParameters:
        """The same, with effects added.

        Raises:
            ParameterError: relative changes that add up to -1 or less.
        """
        for effect in effects:
            effect.edit(self)
        return self.checked()

    def checked(self) -> LoopParameters:
        """The same, or a ParameterError of relative changes that add up to -1 or less."""
        for name in ("bandwidth", "damping", "payload_scale"):
            least = float(getattr(self, name).min())
            if least <= -1:
                raise ParameterError(
                    f"the effects together change {name} by {least:.3g}, must be > -1"
                )
        return self

    def put(self, rows: Rows, other: LoopParameters) -> set[str]:
        """Replace rows.

        Args:
            rows: which simulations.
            other: parameters of as many.

        Returns:
            Names of the fields that are not what they were.
        """
        names = [*ARRAYS, *("sensor" for _ in self.sensor.parts())]
        changed = set()
        for name, mine, theirs in zip(names, self.parts(), other.parts(), strict=True):
            if not np.array_equal(mine[rows], theirs):
                mine[rows] = theirs
                changed.add(name)
        return changed

    def parts(self) -> list[Array]:
        """All arrays, those of the sensor last."""
        return [*(getattr(self, k) for k in ARRAYS), *self.sensor.parts()]

    def mapped(self, make: Callable[..., Array], *others: LoopParameters) -> LoopParameters:
        """Parameters of the same arm, of which each array is made of one of these and others.

        Args:
            make: an array of each -> array.
            others: further parameters.
        """
        parts = [
            make(*group) for group in zip(*(p.parts() for p in (self, *others)), strict=True)
        ]
        arrays: dict[str, Any] = dict(zip(ARRAYS, parts, strict=False))
        return replace(self, sensor=SensorErrors(*parts[len(ARRAYS) :]), **arrays)

    def rows(self, which: Rows) -> LoopParameters:
        """Those of some simulations."""
        return self.mapped(lambda part: part[which])


def axis_to_end(values: Array) -> Array:
    """Return an array (n, ...) with its first axis moved to the end (`np.moveaxis` is slow)."""
    return values.transpose(*range(1, values.ndim), 0)


OF_PLATFORM = ("bandwidth", "damping", "platform_delay", "platform_travel", "platform_speed")
# fields of LoopParameters that are an array each
ARRAYS = [k.name for k in fields(LoopParameters) if k.name not in ("arm", "sensor")]


@dataclass
class Delays:
    """Delays between joint controller and drives [s] (n,), and what drives remember."""

    command: Array  # from the controller's command to the drive
    measurement: Array  # age of the angles and rates that controller and log see
    lag: Array  # (n, joints) time constant of the low-pass through which they see rates
    # (n, joints, 1 + K) levels of a friction that remembers [N m], see `rest_friction`
    friction: Array

    @staticmethod
    def none(n: int, joints: int) -> Delays:
        """Return no delays of n simulations."""
        friction = np.zeros((n, joints, 1 + len(RESTING)))
        return Delays(np.zeros(n), np.zeros(n), np.zeros((n, joints)), friction)

    def edited(self, effects: Iterable[Any]) -> Delays:
        """The same, with effects added."""
        for effect in effects:
            effect.wire(self)
        return self

    def put(self, ids: Index, other: Delays) -> None:
        """Replace rows.

        Args:
            ids: (k,) which.
            other: delays of k simulations.
        """
        for field in fields(self):
            getattr(self, field.name)[ids] = getattr(other, field.name)
