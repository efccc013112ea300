"""`System`: the frozen, serialisable description of what is simulated.

Everything that reproduces a result is in it; `content_hash` names it.
"""

from __future__ import annotations

import dataclasses
import os
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from ves_gym.core.arm import Arm
from ves_gym.core.params import (
    ParameterError,
    content_hash,
    from_plain,
    read_table,
    require_choice,
    require_positive,
    to_plain,
    unit,
    write_table,
)
from ves_gym.core.puma import PUMA_560
from ves_gym.core.vehicle import BENT, BaseModel, Vehicle, get_vehicle

MODES = ("ideal",)
DRIVES = ("motor", "prescribed")
INTEGRATORS = ("rk4", "euler", "implicitfast")


@dataclass(frozen=True, kw_only=True)
class System:
    """Arm + vehicle + mode, and how time advances.

    `mode` ideal is the space system itself: zero gravity, arm and vehicle coupled.
    `drive` motor gives the joints torque-limited motors with servo gains; prescribed
    makes them follow their command exactly, whatever the base does (a perfect servo).
    The control period must be a whole number of physics steps.
    """

    arm: Arm = PUMA_560
    vehicle: Vehicle = BENT
    mode: str = "ideal"
    drive: str = "motor"
    integrator: str = "rk4"
    physics_dt: float = unit("s", default=1.25e-3)
    control_dt: float = unit("s", default=12.5e-3)  # 80 Hz, thesis 2.4.2

    def __post_init__(self) -> None:
        require_choice(self, "mode", MODES)
        require_choice(self, "drive", DRIVES)
        require_choice(self, "integrator", INTEGRATORS)
        require_positive(self, "physics_dt", "control_dt")
        ratio = self.control_dt / self.physics_dt
        if round(ratio) < 1 or abs(ratio - round(ratio)) > 1e-9 * ratio:
            raise ParameterError(
                f"System.control_dt must be a whole number of physics steps of"
                f" {self.physics_dt:g} s, got {self.control_dt:g} s = {ratio:g} steps"
            )

    @property
    def substeps(self) -> int:
        """Physics steps per control period."""
        return round(self.control_dt / self.physics_dt)

    @cached_property
    def base(self) -> BaseModel:
        """M, D, K (and satellite body) of the vehicle; arrays read-only."""
        model = self.vehicle.base_model()
        for array in (model.M, model.D, model.K):
            array.flags.writeable = False
        return model

    @cached_property
    def hash(self) -> str:
        """SHA-256 of the canonical description, 64 hexadecimal digits."""
        return content_hash(self)

    def replace(self, **changes: Any) -> System:
        """A copy with some fields changed."""
        return dataclasses.replace(self, **changes)

    def to_dict(self) -> dict[str, Any]:
        """Plain data, as written to TOML and JSON."""
        plain: dict[str, Any] = to_plain(self)
        return plain

    @staticmethod
    def from_dict(plain: Any, where: str = "System") -> System:
        """Rebuild from plain data. A vehicle may be given by name."""
        if isinstance(plain, dict) and isinstance(plain.get("vehicle"), str):
            plain = {**plain, "vehicle": to_plain(get_vehicle(plain["vehicle"]))}
        system: System = from_plain(System, plain, where)
        return system

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write as .toml or .json, completely or not at all."""
        write_table(path, self)

    @staticmethod
    def load(path: str | os.PathLike[str]) -> System:
        """Read a .toml or .json file; unknown keys are an error."""
        return System.from_dict(read_table(path), str(path))
