"""A tool on a wrist force-torque sensor, read in poses at rest: gravity compensation.

Signals: `orientation` (T, 4) quaternion w, x, y, z or (T, 3) roll, pitch, yaw of the sensor in
the world, z up; `wrench` (T, 6) readings in sensor axes. A mapping file (docs/own_machine.md)
names it after

    ves-gym diagnose poses.csv --import static_tool.py --machine tool.toml
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

import ves_gym as vg
from ves_gym.diagnosis import Parameter, Port, ResidualMachine, Run, register_machine, samples

WRENCH = ("F_x", "F_y", "F_z", "M_x", "M_y", "M_z")
GRAVITY = 9.80665  # m/s^2
UNITS = ("N",) * 3 + ("N m",) * 3
_PORT = Port(
    "static",
    "reading less the weight of the tool",
    WRENCH,
    UNITS,
    ("orientation", "wrench"),
    signal="wrench",
)


def residual(p: Mapping[str, Any], run: Run) -> dict[str, npt.NDArray[np.float64]]:
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

    mass: float = 0.0  # kg
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)  # m

    def machine(self, folder: Path | None = None) -> ResidualMachine:
        """The machine: a tool, zeros and gains, a sensor that sits turned."""
        moment = tuple((self.mass * np.array(self.centre)).tolist())
        xyz, zeros = tuple("xyz"), (0.02,) * 3 + (0.002,) * 3
        tool = partial(Parameter, cause="tool", low=-50.0, high=100.0)
        six = partial(Parameter, entries=WRENCH)
        parameters = {
            "mass": tool(unit="kg", nominal=self.mass, usual=0.5, tolerance=0.003),
            "moment": tool(
                unit="kg m", nominal=moment, usual=0.05, tolerance=0.0005, entries=xyz
            ),
            "bias": six(
                unit=UNITS,
                nominal=(0.0,) * 6,
                usual=(2.0,) * 3 + (0.2,) * 3,
                tolerance=zeros,
            ),
            "gain": six(
                unit="1",
                nominal=(1.0,) * 6,
                usual=0.02,
                tolerance=0.001,
                low=0.1,
                high=3.0,
                each=True,
            ),
            "turned": Parameter(
                unit="rad", nominal=(0.0,) * 3, usual=0.01, low=-0.5, high=0.5, entries=xyz
            ),
        }
        return ResidualMachine("static tool", residual, (_PORT,), parameters)


def read_at_rest(seed: int, **hidden: Any) -> Run:
    """Readings in 40 random poses with noise of 0.1 N and 0.01 N m, and what is hidden."""
    rng = np.random.default_rng(seed)
    turn = Rotation.random(40, rng).as_quat()[:, [3, 0, 1, 2]]
    noise = [0.1] * 3 + [0.01] * 3
    signals = {"orientation": turn, "wrench": np.zeros((40, 6))}
    still = samples("still", signals, {"orientation": 0.0, "wrench": noise})
    true = {**StaticTool().machine().values(()), **hidden}
    signals["wrench"] = noise * rng.standard_normal((40, 6)) - residual(true, still)["static"]
    return samples(f"poses {seed}", signals, {"orientation": 0.0, "wrench": noise})


if __name__ == "__main__":
    hidden = {"mass": 1.4, "moment": [0.0, 0.0, 0.1], "bias": [3.0, -2.0, 5.0, 0.2, 0.1, 0.0]}
    found = vg.diagnose([read_at_rest(k, **hidden) for k in range(3)], StaticTool().machine())
    print(found.sentence)
