"""A tool on a wrist force-torque sensor, read in poses at rest: gravity compensation.

Signals: `orientation` (T, 4) quaternion w, x, y, z or (T, 3) roll, pitch, yaw of the sensor in
the world, z up; `wrench` (T, 6) readings in sensor axes.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from ves_gym._util.params import Array, unit
from ves_gym.diagnosis.data.measured_run import Run
from ves_gym.diagnosis.machines.base import WRENCH, Port
from ves_gym.diagnosis.machines.residual import (
    Parameter,
    ResidualMachine,
    Values,
    register_machine,
)

GRAVITY = 9.80665  # m/s^2
UNITS = ("N",) * 3 + ("N m",) * 3
_PORT = Port(
    "static",
    "reading less the weight of the tool",
    tuple(WRENCH),
    UNITS,
    ("orientation", "wrench"),
    signal="wrench",
)


def bias(force: float, torque: float, ports: tuple[str, ...] = ()) -> dict[str, Parameter]:
    """Return zeros of a force-torque sensor and gains of its axes; tolerances of the zeros."""
    names = tuple(WRENCH)
    return {
        "bias": Parameter(
            unit=UNITS,
            nominal=(0.0,) * 6,
            usual=(2.0,) * 3 + (0.2,) * 3,
            tolerance=(force,) * 3 + (torque,) * 3,
            entries=names,
            ports=ports,
        ),
        "gain": Parameter(
            unit="1",
            nominal=(1.0,) * 6,
            usual=0.02,
            tolerance=0.001,
            low=0.1,
            high=3.0,
            entries=names,
            each=True,
            ports=ports,
        ),
    }


def residual(p: Values, run: Run) -> dict[str, Array]:
    """Return readings less what the sensor reads with these parameters."""
    turn = run["orientation"]
    if turn.shape[1] == 4:
        world = Rotation.from_quat(turn[:, [1, 2, 3, 0]])
    else:
        world = Rotation.from_euler("xyz", turn)
    sensor = world * Rotation.from_rotvec(p["turned"])
    fall = GRAVITY * sensor.inv().apply([0.0, 0.0, -1.0])
    weight = np.concatenate([p["mass"] * fall, np.cross(p["moment"], fall)], axis=1)
    return {"static": run["wrench"] - p["gain"] * weight - p["bias"]}


@register_machine("static tool")
@dataclass(frozen=True)
class StaticTool:
    """The tool as described, sensor axes."""

    mass: float = unit("kg", default=0.0)
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)  # m

    def machine(self, folder: Path | None = None) -> ResidualMachine:
        """Return the machine: a tool, zeros and gains, a sensor that sits turned."""
        moment = tuple((self.mass * np.array(self.centre)).tolist())
        xyz = tuple("xyz")
        parameters = {
            "mass": Parameter(
                unit="kg",
                nominal=self.mass,
                usual=0.5,
                tolerance=0.003,
                low=-50.0,
                high=100.0,
                cause="tool",
            ),
            "moment": Parameter(
                unit="kg m",
                nominal=moment,
                usual=0.05,
                tolerance=0.0005,
                low=-20.0,
                high=20.0,
                entries=xyz,
                cause="tool",
            ),
            **bias(0.02, 0.002),
            "turned": Parameter(
                unit="rad", nominal=(0.0,) * 3, usual=0.01, low=-0.5, high=0.5, entries=xyz
            ),
        }
        return ResidualMachine("static tool", residual, (_PORT,), parameters)
