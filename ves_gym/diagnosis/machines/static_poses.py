"""A tool on a wrist force-torque sensor, read in poses at rest, as a machine.

There is no time in such a log: every pose is a sample, and its noise independent of the others.
So the coefficients that are compared are the samples themselves, two in one complex number.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from ves_gym._util.params import Array, ParameterError, require_positive, unit
from ves_gym._util.signals import SensorNoiseModel, SpectralWindow
from ves_gym.diagnosis.data.measured_run import Run
from ves_gym.diagnosis.inference.candidates import Candidate
from ves_gym.diagnosis.machines.base import WRENCH, Nuisance, Port
from ves_gym.diagnosis.machines.plant import (
    Effects,
    PlantEffect,
    PlantMachine,
    Size,
    candidate_of,
    of_kind,
    plant_effect,
)

GRAVITY = 9.80665  # m/s^2
_FEWEST = 8  # poses
_STEP = 0.1  # s: stands for the clock that there is not


@dataclass(frozen=True)
class PoseWindow(SpectralWindow):
    """Poses in place of frequencies: every pose counts, spread over the band by its number."""

    @property
    def frequencies(self) -> Array:
        """(K,) from 0 to the top, two poses each."""
        return np.linspace(0.0, self.top, (self.length + 1) // 2)

    def spectrum(self, x: Array) -> Array:
        """Return (..., K, c): two samples in one number, |.|^2 = s^2 for noise of variance s^2.

        Args:
            x: (..., T, c).
        """
        if x.shape[-2] % 2:
            x = np.concatenate([x, np.zeros_like(x[..., :1, :])], axis=-2)
        return np.asarray((x[..., ::2, :] + 1j * x[..., 1::2, :]) / np.sqrt(2))


@dataclass(frozen=True, eq=False)
class StaticRun(Run):
    """Poses at rest."""

    @property
    def window(self) -> PoseWindow:
        """The samples that are compared."""
        return PoseWindow(self.length, self.dt, self.band, 0)


def static_run(
    name: str, orientation: Rotation, wrench: Array, noise: Array, spread: float = 0.0
) -> StaticRun:
    """Return poses of a sensor as a run.

    Args:
        name: of the run.
        orientation: (T,) sensor axes -> world axes, z up.
        wrench: (T, 6) readings, force and moment in sensor axes [N, N m].
        noise: (6,) standard deviation of the readings.
        spread: of the orientation known [rad].

    Raises:
        ParameterError: too few poses.
    """
    if len(wrench) < _FEWEST or len(orientation) != len(wrench):
        raise ParameterError(
            f"{name}: needs at least {_FEWEST} poses with a reading each, got"
            f" {len(orientation)} orientations, {len(wrench)} readings"
        )
    down = orientation.inv().apply([0.0, 0.0, -1.0])
    white = {
        "down": SensorNoiseModel(np.full(3, spread), np.zeros(3)),
        "wrench": SensorNoiseModel(np.array(noise, float), np.zeros(6)),
    }
    return StaticRun(name, _STEP, {"down": down, "wrench": wrench}, white, {}, 1.0)


@plant_effect("tool/body")
@dataclass(frozen=True)
class ToolBody(PlantEffect):
    """A body beside the tool described: mass, and mass times centre in sensor axes."""

    mass: float  # kg
    moment: tuple[float, float, float] = (0.0, 0.0, 0.0)  # kg m

    def wrench(self, down: Array) -> Array:
        """Return (..., T, 6) weight about the sensor's origin [N, N m].

        Args:
            down: (..., T, 3) where gravity points, sensor axes.
        """
        force = self.mass * GRAVITY * down
        return np.concatenate([force, np.cross(self.moment, GRAVITY * down)], axis=-1)


@plant_effect("wrench/bias")
@dataclass(frozen=True)
class WrenchBias(PlantEffect):
    """A constant on all six readings."""

    bias: tuple[float, ...]  # (6,) N, N m


@plant_effect("wrench/gain")
@dataclass(frozen=True)
class WrenchGain(PlantEffect):
    """Readings along one axis that are too large."""

    axis: int
    error: float  # relative


@plant_effect("wrench/turned")
@dataclass(frozen=True)
class WrenchTurned(PlantEffect):
    """The sensor sits turned under the flange, by a small rotation vector."""

    angle: tuple[float, float, float]  # rad


BIAS = (
    *(Size(name, "N", 2.0, -1e4, 1e4) for name in WRENCH[:3]),
    *(Size(name, "N m", 0.2, -1e4, 1e4) for name in WRENCH[3:]),
)
BODY = (
    Size("mass", "kg", 0.5, -50.0, 100.0),
    *(Size(f"moment_{axis}", "kg m", 0.05, -20.0, 20.0) for axis in "xyz"),
)


@dataclass(frozen=True)
class StaticTolerance:
    """Usual errors of a described tool, standard deviations."""

    mass: float = unit("kg", default=0.003)
    moment: float = unit("kg m", default=0.0005)
    force: float = unit("N", default=0.02)  # of the sensor's zero
    torque: float = unit("N m", default=0.002)
    gain: float = unit("1", default=0.001)
    unexplained: float = unit("1", default=0.0)

    def __post_init__(self) -> None:
        require_positive(self, "mass", "moment", "force", "torque", "gain")


class StaticTool(PlantMachine):
    """Port `static`: readings less the weight of the tool.

    Args:
        name: of the machine.
        mass: of the tool as described [kg].
        centre: (3,) in sensor axes [m].
        tolerance: of the description.
        effects: that the description has.
        known: sizes of single tolerances.
    """

    effects = (ToolBody, WrenchBias, WrenchGain, WrenchTurned)

    def __init__(
        self,
        name: str,
        mass: float,
        centre: Sequence[float],
        tolerance: StaticTolerance | None = None,
        effects: Sequence[PlantEffect] = (),
        known: Mapping[str, float] | None = None,
    ) -> None:
        self.tolerance = tolerance or StaticTolerance()
        super().__init__(name, effects, known, self.tolerance.unexplained)
        x, y, z = (mass * float(c) for c in centre)
        self.tool = ToolBody(mass, (x, y, z))
        self.ports = (
            Port(
                "static",
                "reading less the weight of the tool",
                tuple(WRENCH),
                ("N",) * 3 + ("N m",) * 3,
                ("down", "wrench"),
                signal="wrench",
            ),
        )

    def tolerances(self) -> list[Nuisance]:
        """Return errors of the tool and of the sensor's zeros and gains."""
        allowed, port, out = self.tolerance, ("static",), []
        bodies = [("mass of the tool", ToolBody(0.1), allowed.mass)]
        for k, axis in enumerate("xyz"):
            x, y, z = (0.1 * np.eye(3)[k]).tolist()
            bodies.append(
                (f"moment {axis} of the tool", ToolBody(0.0, (x, y, z)), allowed.moment)
            )
        for name, body, std in bodies:
            out.append(Nuisance(name, port, self.model([body]), 0.1, std))
        for k, axis in enumerate(WRENCH):
            zero = WrenchBias(tuple((0.1 * np.eye(6)[k]).tolist()))
            std = allowed.force if k < 3 else allowed.torque
            out.append(Nuisance(f"zero of {axis}", port, self.model([zero]), 0.1, std))
            gain = self.model([WrenchGain(k, 0.01)])
            out.append(Nuisance(f"gain of {axis}", port, gain, 0.01, allowed.gain))
        return out

    def candidates(self) -> tuple[Candidate, ...]:
        """Return tool, bias of the sensor, gains, turned sensor."""
        port = ("static",)
        angles = [Size(f"angle_{axis}", "rad", 0.01, -0.5, 0.5) for axis in "xyz"]
        out = [
            candidate_of(ToolBody, port, BODY, _body, sparse=True),
            candidate_of(
                WrenchBias,
                port,
                BIAS,
                lambda x: WrenchBias(tuple(float(k) for k in x)),
                sparse=True,
            ),
            candidate_of(WrenchTurned, port, angles, _turned, sparse=True),
        ]
        for k, axis in enumerate(WRENCH):
            number = Size("error", "1", 0.02, -0.9, 2.0)
            out.append(candidate_of(WrenchGain, port, [number], partial(wrench_gain, k), axis))
        return tuple(out)

    def residual(self, run: Run, port: str, effects: Effects) -> Array:
        """Return readings less what the sensor with these effects reads, (..., T, 6)."""
        down = run["down"]
        for e in of_kind(effects, WrenchTurned):
            down = (
                Rotation.from_rotvec(e.angle)
                .inv()
                .apply(down.reshape(-1, 3))
                .reshape(down.shape)
            )
        reading = self.tool.wrench(down)
        for e in of_kind(effects, ToolBody):
            reading = reading + e.wrench(down)
        for e in of_kind(effects, WrenchGain):
            reading = reading * (1 + e.error * np.eye(6)[e.axis])
        for e in of_kind(effects, WrenchBias):
            reading = reading + np.array(e.bias)
        return np.asarray(run["wrench"] - reading)


def wrench_gain(axis: int, x: Array) -> WrenchGain:
    """Return the gain of an axis by numbers (1,)."""
    return WrenchGain(axis, float(x[0]))


def _body(x: Array) -> ToolBody:
    mass, a, b, c = (float(k) for k in x)
    return ToolBody(mass, (a, b, c))


def _turned(x: Array) -> WrenchTurned:
    a, b, c = (float(k) for k in x)
    return WrenchTurned((a, b, c))
