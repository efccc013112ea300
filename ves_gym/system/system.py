"""`System`: the frozen, serialisable description of what is simulated.

Everything that reproduces a result is in it; `content_hash` names it.
"""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Sequence
from dataclasses import InitVar, dataclass
from functools import cached_property
from typing import Any

from ves_gym._util.params import (
    ParameterError,
    content_hash,
    freeze_arrays,
    from_plain,
    read_table,
    require_choice,
    require_positive,
    require_types,
    to_plain,
    unit,
    write_table,
)
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.arm_library import PUMA_560, arm_from, get_arm
from ves_gym.mechanics.contact import Contact
from ves_gym.mechanics.payload import Payload
from ves_gym.mechanics.side_by_side import side_by_side
from ves_gym.mechanics.vehicle import (
    BENT,
    BaseModel,
    Satellite,
    Vehicle,
    altered,
    get_vehicle,
    orbit_of,
    vehicle_name,
)
from ves_gym.system.deviations import Delays, LoopParameters
from ves_gym.system.effect import EFFECTS, ArmEffect, BaseEffect, Effect
from ves_gym.system.emulator_settings import NOMINAL, EmulatorSettings

MODES = ("ideal", "emulated")
DRIVES = ("motor", "prescribed")
INTEGRATORS = ("rk4", "euler", "implicitfast")


@dataclass(frozen=True, kw_only=True)
class System:
    """Arm + vehicle + mode + effects, and how time advances.

    `mode` ideal is the space system itself: zero gravity, arm and vehicle coupled.
    Emulated is the laboratory: full gravity, and a platform that moves as the vehicle
    would by what its force sensor feels (`emulator`; the nominal machine by default).
    `effects` are deviations from what is described here. `payload` is a body that the tool
    can grasp, carry and release (`Simulator.grasp`); in the laboratory a stand holds it.
    `contact` gives the tool, and what it meets, surfaces that push on each other.
    `drive` motor gives the joints torque-limited motors with servo gains; prescribed
    makes them follow their command exactly, whatever the base does (a perfect servo).
    Arm and vehicle may be given by name or file, as `get_arm` and `get_vehicle` take them.
    `arms` are several arms on one base, each where it stands (`Arm.at`): `arm` is then all of
    them, their joints in this order, and the last one's tool is the tool.
    The control period must be a whole number of physics steps.
    """

    arm: Arm = PUMA_560
    vehicle: Vehicle = BENT
    mode: str = "ideal"
    emulator: EmulatorSettings | None = None
    effects: tuple[Effect, ...] = ()
    drive: str = "motor"
    integrator: str = "rk4"
    physics_dt: float = unit("s", default=1.25e-3)
    control_dt: float = unit("s", default=12.5e-3)  # 80 Hz, thesis 2.4.2
    payload: Payload | None = None
    contact: Contact | None = None
    arms: InitVar[Sequence[Arm] | None] = None  # instead of `arm`: several on one base

    def __post_init__(self, arms: Sequence[Arm] | None) -> None:
        if arms is not None:
            if self.arm is not PUMA_560:
                raise ParameterError("System takes arm or arms, got both")
            object.__setattr__(self, "arm", side_by_side(arms))
        for name, read, types in (
            ("arm", get_arm, Arm),
            ("vehicle", get_vehicle, Vehicle.__args__),
        ):
            value = getattr(self, name)
            if isinstance(value, (str, os.PathLike)):  # as on the command line
                object.__setattr__(self, name, read(value))
            elif not isinstance(value, types):
                raise ParameterError(
                    f"System.{name} must be {'an Arm' if name == 'arm' else 'a vehicle'}, its"
                    f" name or its file, got {value!r}"
                )
        require_choice(self, "mode", MODES)
        require_choice(self, "drive", DRIVES)
        require_choice(self, "integrator", INTEGRATORS)
        require_positive(self, "physics_dt", "control_dt")
        require_types(self, "payload", "contact", "emulator")
        ratio = self.control_dt / self.physics_dt
        if not 1 <= ratio < 1e9 or abs(ratio - round(ratio)) > 1e-9 * ratio:
            raise ParameterError(
                f"System.control_dt must be a whole number of physics steps of"
                f" {self.physics_dt:g} s, got {self.control_dt:g} s = {ratio:g} steps"
            )
        if self.mode == "emulated" and self.emulator is None:
            object.__setattr__(self, "emulator", NOMINAL)  # the dataclass is frozen
        if self.mode == "ideal" and self.emulator is not None:
            raise ParameterError(
                "System.emulator belongs to mode emulated, got one with mode ideal"
                " (System.ideal() drops it)"
            )
        if self.mode == "emulated" and self.arm.bends:
            raise ParameterError(
                f"mode emulated needs an arm of rigid links, got {self.arm.name} with"
                f" {self.arm.bends} flexures: emulate its boom as the vehicle (Boom.at)"
            )
        if self.mode == "emulated":
            self.arm.require_turning("mode emulated")
            self.arm.require_uncoupled("mode emulated")
        if self.mode == "emulated" and isinstance(self.vehicle, Satellite):
            self._require_a_body_alone(self.vehicle)
        if self.contact is not None:
            self._require_contact(self.contact)
        if self.payload is not None and orbit_of(self.vehicle) is not None:
            raise ParameterError(
                "System.payload: a free payload feels no gravity gradient, leave out the"
                " satellite's orbit or the payload"
            )
        freeze_arrays(self)  # a list of effects has no hash
        require_types(self, "effects")
        for effect in self.effects:
            effect.require_mode(self.mode)
            effect.check(self)

    def _require_a_body_alone(self, vehicle: Satellite) -> None:
        for name in ("wheels", "jets", "appendages", "extra", "orbit"):
            if getattr(vehicle, name):
                raise ParameterError(
                    f"mode emulated knows a satellite's body, not its {name}: the arm's wrench"
                    " is all that moves its platform; use mode ideal, or a vehicle of the body"
                    " alone, Satellite(body=vehicle.body)"
                )

    def _require_contact(self, contact: Contact) -> None:
        self.arm.require_rigid("contact at the tool")
        self.arm.require_driven_tool("contact at the tool")
        if self.mode == "emulated":
            raise ParameterError("System.contact needs mode ideal, got mode emulated")
        if contact.on == "payload" and self.payload is None:
            raise ParameterError(
                "System.contact is on the payload, of which there is none: give"
                " System(payload=...), or Contact(on='base') or 'space'"
            )

    def __repr__(self) -> str:
        name, kind = vehicle_name(self.vehicle), self.vehicle.kind
        vehicle = kind if name == kind else f"{name} ({kind})"
        orbit = orbit_of(self.vehicle)
        vehicle += "" if orbit is None else f", {orbit}"
        effects = "".join(f", {effect}" for effect in self.effects)
        payload = "" if self.payload is None else f", payload {self.payload.inertial.mass:g} kg"
        return f"<System: {self.arm.name} on {vehicle}, {self.mode}{payload}{effects}>"

    @cached_property
    def substeps(self) -> int:
        """Physics steps per control period."""
        return round(self.control_dt / self.physics_dt)

    @cached_property
    def base(self) -> BaseModel:
        """M, D, K (and satellite body) of the vehicle; arrays read-only."""
        model = self.vehicle.base_model()
        for array in (model.M, model.D, model.K, model.drag):
            if array is not None:
                array.flags.writeable = False
        return model

    @property
    def actual(self) -> System:
        """The system as it really is: arm and vehicle as the effects on them say.

        The engine runs this one; what is computed about it goes by the description. Holds
        the remaining effects. A system without such effects is its own.
        """
        differs = any(isinstance(e, (ArmEffect, BaseEffect)) for e in self.effects)
        differs = differs or self.arm.rubs
        return self._actual if differs else self

    @cached_property
    def _actual(self) -> System:
        arm, base = self.arm, self.base
        for effect in self.effects:
            arm, base = effect.arm(arm), effect.base(base)
        others = tuple(e for e in self.effects if not isinstance(e, (ArmEffect, BaseEffect)))
        others += _friction(arm)
        arm = arm.without_friction()
        if base is self.base:
            return self.replace(arm=arm, effects=others)
        return self.replace(arm=arm, vehicle=altered(self.vehicle, base), effects=others)

    @property
    def loop_parameters(self) -> LoopParameters:
        """(1, ...) of the emulation loop, the effects in them."""
        nominal = LoopParameters.nominal(self.arm, self.emulator_settings, 1)
        return nominal.edited(self.effects)

    @property
    def prescribed_coordinates(self) -> tuple[int, ...]:
        """Coordinates of (Y, q) whose motion no force changes: platform, prescribed joints."""
        first = 0 if self.mode == "emulated" else 6
        return tuple(range(first, 6 + self.arm.n * (self.drive == "prescribed")))

    def delays(self, n: int = 1) -> Delays:
        """Return the delays (n, ...) between joint controller and drives, by the effects."""
        return Delays.none(n, self.arm.n).edited(self.effects)

    @cached_property
    def hash(self) -> str:
        """SHA-256 of the canonical description, 64 hexadecimal digits."""
        return content_hash(self)

    def replace(self, **changes: Any) -> System:
        """A copy with some fields changed."""
        out = dataclasses.replace(self, **changes)
        if out.vehicle is self.vehicle and "base" in self.__dict__:
            out.__dict__["base"] = self.base  # cached: it depends on the vehicle alone
        return out

    def ideal(self) -> System:
        """The space system that this one emulates (itself, if it is ideal)."""
        if self.mode == "ideal":
            return self
        effects = tuple(e for e in self.effects if "ideal" in e.modes)
        return self.replace(mode="ideal", emulator=None, effects=effects)

    @property
    def emulator_settings(self) -> EmulatorSettings:
        """The emulator of an emulated system."""
        if self.emulator is None:
            raise ParameterError("mode ideal has no emulator: use mode emulated")
        return self.emulator

    def to_dict(self) -> dict[str, Any]:
        """Plain data, as written to TOML and JSON."""
        plain: dict[str, Any] = to_plain(self)
        return plain

    @staticmethod
    def from_dict(plain: Any, where: str = "System") -> System:
        """Rebuild a system from plain data. Arm and vehicle may be given by name or file.

        Args:
            plain: a table as `to_dict` gives it.
            where: path of the entry, for the message.
        """
        if isinstance(plain, dict) and isinstance(plain.get("vehicle"), str):
            plain = {**plain, "vehicle": to_plain(get_vehicle(plain["vehicle"]))}
        if isinstance(plain, dict) and isinstance(plain.get("arms"), list):
            several = side_by_side([arm_from(k) for k in plain["arms"]])
            plain = {k: v for k, v in plain.items() if k != "arms"} | {"arm": to_plain(several)}
        if isinstance(plain, dict) and isinstance(plain.get("arm"), str):
            plain = {**plain, "arm": to_plain(get_arm(plain["arm"]))}
        system: System = from_plain(System, plain, where)
        return system

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write as .toml or .json, completely or not at all."""
        write_table(path, self)

    @staticmethod
    def load(path: str | os.PathLike[str]) -> System:
        """Read a .toml or .json file; unknown keys are an error."""
        return System.from_dict(read_table(path), str(path))


def _friction(arm: Arm) -> tuple[Effect, ...]:
    """The laws of the friction that an arm's links have."""
    out: list[Effect] = []
    for kind, name, values in (
        ("joint/viscous", "damping", [link.damping for link in arm.links]),
        ("joint/coulomb", "torque", [link.friction for link in arm.links]),
    ):
        if any(values):
            make: Any = EFFECTS[kind]
            _, most = make.__dataclass_fields__[name].metadata["bounds"]
            laws = math.ceil(max(k or 0.0 for k in values) / most)  # each within its bounds
            out += [make(**{name: tuple((k or 0.0) / laws for k in values)})] * laws
    return tuple(out)
