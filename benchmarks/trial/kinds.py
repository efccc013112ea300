"""Kinds of hidden effect: where each can sit, and how its size changes a machine.

`add(plant, slot, size)` changes a `Plant`; the size is positive, zero leaves it as it is. Slots
count joints from 0, axes from 0 to 5.
"""

import copy
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from benchmarks.trial import laws
from benchmarks.trial.arm import Array
from benchmarks.trial.hidden import Hidden, Law, Signals


@dataclass
class Plant:
    """A machine as it is: numbers, laws and signals."""

    machine: dict[str, Any]
    laws: list[Law] = field(default_factory=list)
    signals: Signals = field(default_factory=Signals)
    forces: list[Callable[[Array, Array], Array]] = field(default_factory=list)
    peaks: Array = field(default_factory=lambda: np.zeros(0))  # (n,) largest torques [N m]
    sign: float = 1.0
    shape: float = 0.5  # 0 to 1, what a kind leaves open

    def copy(self) -> "Plant":
        """A plant that may be changed."""
        return copy.deepcopy(self)

    def hidden(self) -> Hidden:
        """Laws and signals, as a simulation takes them."""
        return Hidden(tuple(self.laws), self.signals)

    def link(self, j: int) -> dict[str, Any]:
        """The table of link j."""
        return dict(self.machine["arm"]["links"][j])

    @property
    def joints(self) -> int:
        """Number of joints."""
        return len(self.machine["arm"]["links"])


Add = Callable[[Plant, int, float], None]


@dataclass(frozen=True)
class Kind:
    """A kind of effect: `start` is a size to begin the search with, `most` the largest."""

    name: str
    start: float
    most: float
    place: str  # joint, axis, base or none
    modes: tuple[str, ...]
    add: Add
    outside: bool = False
    geared: bool = False  # needs rotors
    held: bool = False  # needs a base on springs


def _law(make: Callable[[Plant, int, float], Law]) -> Add:
    """A kind that is one law."""

    def add(plant: Plant, slot: int, size: float) -> None:
        plant.laws.append(make(plant, slot, size))

    return add


def _one(plant: Plant, slot: int, value: float) -> Array:
    out = np.zeros(plant.joints)
    out[slot] = value
    return out


def _payload(plant: Plant, slot: int, size: float) -> None:
    part = plant.machine["arm"]["links"][-1]["inertial"]
    at = np.array([0.03, 0.02, 0.02 + 0.04 * plant.shape])
    m, c = part["mass"], np.asarray(part["com"], float)
    d = at - c
    inertia = np.asarray(part["inertia"]) + m * size / (m + size) * (
        d @ d * np.eye(3) - np.outer(d, d)
    )
    part["com"] = ((m * c + size * at) / (m + size)).tolist()
    part["mass"], part["inertia"] = m + size, inertia.tolist()


def _centre(plant: Plant, slot: int, size: float) -> None:
    part = plant.machine["arm"]["links"][-1]["inertial"]
    part["com"] = (np.asarray(part["com"]) + plant.sign * size * np.eye(3)[slot % 3]).tolist()


def _scale(name: str) -> Add:
    def add(plant: Plant, slot: int, size: float) -> None:
        scales = plant.machine["vehicle"].setdefault("scales", {"M": 1.0, "D": 1.0, "K": 1.0})
        scales[name] *= (1 + size) if plant.sign > 0 else 1 / (1 + size)

    return add


def _rotor(plant: Plant, slot: int, size: float) -> None:
    plant.machine["arm"]["links"][slot]["rotor_inertia"] += size


def _rider(plant: Plant, slot: int, size: float) -> Law:
    return laws.Rider(size, 1.5 + 4 * plant.shape, np.eye(3)[slot % 3])


def _play(plant: Plant, slot: int, size: float) -> Law:
    return laws.Play(slot, plant.link(slot)["rotor_inertia"], size)


def _spring(plant: Plant, slot: int, size: float) -> Law:
    return laws.Elastic(slot, plant.link(slot)["rotor_inertia"], size)


def _stribeck(plant: Plant, slot: int, size: float) -> Law:
    return laws.Friction(slot, size, stiction=0.6 + 0.6 * plant.shape, fade=0.05, heat=0.1)


def _drag(plant: Plant, slot: int, size: float) -> None:
    law = laws.AmplitudeDrag(slot, size)
    if plant.machine["mode"] == "emulated":
        plant.forces.append(law.force)
    else:
        plant.laws.append(law)


def _signal(name: str, signed: bool = False, ratio: bool = False) -> Add:
    def add(plant: Plant, slot: int, size: float) -> None:
        old = getattr(plant.signals, name)
        change = plant.sign * size if signed else size
        if ratio:
            setattr(plant.signals, name, old * (1 + size if plant.sign > 0 else 1 / (1 + size)))
        else:
            setattr(plant.signals, name, old + change)

    return add


def _lag(plant: Plant, slot: int, size: float) -> None:
    plant.signals.velocity_lag = _one(plant, slot, size)


def _bias(plant: Plant, slot: int, size: float) -> None:
    plant.signals.sensor_bias = plant.signals.sensor_bias + plant.sign * size * np.eye(6)[slot]


def _row(plant: Plant, slot: int, size: float) -> None:
    change = np.zeros((6, 6))
    change[slot, slot] = plant.sign * size
    plant.signals.sensor_gain = plant.signals.sensor_gain + change


def _turned(plant: Plant, slot: int, size: float) -> None:
    a, c, s = slot % 3, np.cos(size), plant.sign * np.sin(size)
    R = np.eye(3)
    i, j = (a + 1) % 3, (a + 2) % 3
    R[i, i] = R[j, j] = c
    R[i, j], R[j, i] = s, -s
    plant.signals.sensor_gain = np.kron(np.eye(2), R) @ plant.signals.sensor_gain


def _tilt(plant: Plant, slot: int, size: float) -> None:
    plant.signals.tilt = plant.signals.tilt + plant.sign * size * np.eye(3)[slot % 2]


BOTH, SPACE, EARTH = ("ideal", "emulated"), ("ideal",), ("emulated",)


def _ceiling(plant: Plant, slot: int, size: float) -> Law:
    return laws.Ceiling(slot, plant.peaks[slot] * np.exp(-size))


def _gain(plant: Plant, slot: int, size: float) -> Law:
    return laws.Gain(_one(plant, slot, plant.sign * size))


def _ripple(plant: Plant, slot: int, size: float) -> Law:
    return laws.Ripple(slot, size, 6 + 20 * plant.shape, 6 * plant.shape)


def _patches(plant: Plant, slot: int, size: float) -> Law:
    return laws.Patches(slot, size, 5 + 8 * plant.shape, 6 * plant.shape)


def _uneven(plant: Plant, slot: int, size: float) -> Law:
    return laws.Uneven(slot, plant.sign * size)


def _offset(plant: Plant, slot: int, size: float) -> Law:
    return laws.Offset(slot, plant.sign * size)


def _plain(law: Callable[[int, float], Law]) -> Add:
    """A kind that is one law of a place and a size."""
    return _law(lambda plant, slot, size: law(slot, size))


KINDS = {
    kind.name: kind
    for kind in (
        Kind("joint/coulomb", 2.0, 30, "joint", BOTH, _plain(laws.Friction)),
        Kind("joint/viscous", 3.0, 80, "joint", BOTH, _plain(laws.Drag)),
        Kind("joint/stribeck", 2.0, 30, "joint", BOTH, _law(_stribeck)),
        Kind("joint/asymmetry", 1.0, 15, "joint", BOTH, _law(_uneven)),
        Kind("joint/load_friction", 0.1, 0.5, "joint", BOTH, _plain(laws.Loaded)),
        Kind("joint/ripple", 1.0, 15, "joint", BOTH, _law(_ripple)),
        Kind("joint/drive_gain", 0.05, 0.4, "joint", BOTH, _law(_gain)),
        Kind("joint/torque_limit", 0.2, 2.5, "joint", BOTH, _law(_ceiling)),
        Kind("joint/torque_offset", 1.0, 40, "joint", BOTH, _law(_offset)),
        Kind("joint/rotor_inertia", 0.3, 15, "joint", BOTH, _rotor),
        Kind("joint/elasticity", 4e-5, 4e-4, "joint", BOTH, _law(_spring), geared=True),
        Kind("joint/backlash", 1e-3, 0.08, "joint", BOTH, _law(_play), geared=True),
        Kind("joint/velocity_lag", 5e-3, 0.03, "joint", BOTH, _lag),
        Kind("joint/measurement_delay", 3e-3, 0.02, "none", BOTH, _signal("reading_delay")),
        Kind("command/delay", 5e-3, 0.09, "none", BOTH, _signal("command_delay")),
        Kind("payload/mass", 0.2, 12, "none", BOTH, _payload),
        Kind("payload/com", 0.01, 0.25, "axis", BOTH, _centre),
        Kind("base/stiffness", 0.03, 1.5, "none", BOTH, _scale("K"), held=True),
        Kind("base/damping", 0.2, 6, "none", BOTH, _scale("D"), held=True),
        Kind("base/virtual_mass", 0.03, 1.5, "none", BOTH, _scale("M")),
        Kind("base/amplitude_damping", 2000, 8e5, "axis", BOTH, _drag, held=True),
        Kind("base/extra_mode", 10, 300, "axis", SPACE, _law(_rider)),
        Kind("sensor/bias", 1.0, 60, "axis", EARTH, _bias),
        Kind("sensor/calibration", 0.02, 0.4, "axis", EARTH, _row),
        Kind("sensor/rotation", 0.005, 0.09, "axis", EARTH, _turned),
        Kind("sensor/lag", 0.2, 4, "none", EARTH, _signal("sensor_cutoff", ratio=True)),
        Kind("gravity/mass", 0.1, 10, "none", EARTH, _signal("weight_mass", signed=True)),
        Kind("gravity/scale", 0.002, 0.15, "none", EARTH, _signal("weight_scale", signed=True)),
        Kind("gravity/tilt", 0.002, 0.09, "axis", EARTH, _tilt),
        Kind("gravity/delay", 0.05, 0.4, "none", EARTH, _signal("weight_delay")),
        Kind("platform/bandwidth", 0.1, 3, "none", EARTH, _signal("bandwidth", ratio=True)),
        Kind("platform/damping", 0.2, 3, "none", EARTH, _signal("damping", ratio=True)),
        Kind("platform/delay", 0.01, 0.1, "none", EARTH, _signal("platform_delay")),
        Kind("outside/cable", 8.0, 800, "joint", BOTH, _plain(laws.Cable), True),
        Kind("outside/detent", 2.0, 60, "joint", BOTH, _plain(laws.Detent), True),
        Kind("outside/patches", 3.0, 60, "joint", BOTH, _law(_patches), True),
        Kind("outside/thermal", 0.003, 0.2, "joint", BOTH, _plain(laws.Thermal), True),
        Kind(
            "outside/base_slip", 5.0, 3000, "axis", SPACE, _plain(laws.Hysteresis), True,
            held=True,
        ),
    )
}  # fmt: skip
