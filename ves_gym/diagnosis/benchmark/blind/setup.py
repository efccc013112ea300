"""A machine with its nuisances: what may legitimately be off, and by how much."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ves_gym._util.params import Array
from ves_gym.diagnosis.benchmark.blind.beam import BaseMatrices
from ves_gym.diagnosis.benchmark.blind.description import plant_of, sampled
from ves_gym.diagnosis.benchmark.blind.mechanics import (
    GRAVITY,
    BodyParameters,
    fill_trig,
    newton_euler,
)
from ves_gym.diagnosis.benchmark.blind.plant import BlindPlant, scratch
from ves_gym.diagnosis.benchmark.blind.simulate import Drive

# Each number is drawn uniformly within +-size; `large` draws are twice as wide.
NUISANCE: dict[str, tuple[float, str]] = {
    "link mass": (0.001, "relative, each body"),
    "link centre of mass": (2e-4, "m, each axis of each link"),
    "link inertia": (0.01, "relative, each link"),
    "rotor inertia": (0.01, "relative, each joint"),
    "drive gain": (0.001, "relative, each joint"),
    "servo gains": (0.001, "relative, kp and kd of each joint"),
    "encoder zero": (2e-5, "rad, each joint"),
    "sensor gain": (0.001, "relative, each signal; zeroed under the arm's weight at q = 0"),
    "sensor offset": (0.03, "N, N m, each signal"),
    "sensor cutoff": (0.01, "relative"),
    "platform bandwidth": (0.01, "relative"),
    "platform damping": (0.01, "relative"),
    "gravity estimate": (0.005, "kg, of its mass"),
    "base stiffness": (0.002, "relative"),
    "base mass": (0.002, "relative"),
    "base damping": (0.01, "relative"),
    "clock": (3e-5, "relative rate of the time stamps"),
}
LARGE = 2.0


class MachineSetup(NamedTuple):
    """A machine, before its admittance is sampled."""

    plant: BlindPlant
    drive: Drive
    base: BaseMatrices
    dt: float  # s, control period
    clock: float  # relative error of the time stamps

    def finished(self) -> BlindPlant:
        """Return the plant with the admittance of its base."""
        phi, gamma = sampled(self.base, self.dt)
        plant = self.plant._replace(phi=phi, gamma=gamma)
        solid: dict[str, Any] = {  # one memory layout, so that the loop is compiled once
            k: np.ascontiguousarray(v)
            for k, v in plant._asdict().items()
            if isinstance(v, np.ndarray)
        }
        return plant._replace(**solid)

    def edit(self, **changes: Any) -> MachineSetup:
        """Return the setup with other numbers in the plant."""
        return self._replace(plant=self.plant._replace(**changes))


def nominal_setup(description: dict[str, Any], controller: dict[str, Any]) -> MachineSetup:
    """Return the machine exactly as described."""
    plant, base = plant_of(description, controller)
    return MachineSetup(
        plant, Drive(plant.bodies, plant.rotor), base, description["control_dt"], 0.0
    )


def resting(bodies: BodyParameters) -> Array:
    """Return (6,) weight of the arm on the level platform at q = 0."""
    room, zero = scratch(), np.zeros(3)
    fill_trig(bodies, zero, room.trig)
    pull = np.array([0.0, 0.0, GRAVITY])
    newton_euler(
        bodies, room.trig, zero, zero, zero, zero, pull, room.work, room.tau, room.wrench
    )
    return room.wrench


def with_nuisance(
    setup: MachineSetup, rng: np.random.Generator, factor: float = 1.0
) -> MachineSetup:
    """Return the machine with every nuisance drawn.

    Args:
        setup: as described.
        rng: of the draws.
        factor: times as wide as listed.
    """

    def draw(name: str, *shape: int) -> Array:
        size = factor * NUISANCE[name][0]
        return np.asarray(rng.uniform(-size, size, shape))

    p, base = setup.plant, setup.base
    true = BodyParameters(
        dh=p.bodies.dh,
        mass=p.bodies.mass * (1 + draw("link mass", 4)),
        com=p.bodies.com + draw("link centre of mass", 4, 3) * [[0.0], [1.0], [1.0], [1.0]],
        inertia=p.bodies.inertia * (1 + draw("link inertia", 4))[:, None, None],
    )
    signals = (1 + draw("sensor gain", 6))[:, None] * p.to_signal
    plant = p._replace(
        bodies=true,
        estimate=true,  # the weight was measured on this machine
        surplus=float(draw("gravity estimate")),
        rotor=p.rotor * (1 + draw("rotor inertia", 3)),
        gain=p.gain * (1 + draw("drive gain", 3)),
        kp=p.kp * (1 + draw("servo gains", 3)),
        kd=p.kd * (1 + draw("servo gains", 3)),
        zero=draw("encoder zero", 3),
        to_signal=signals,
        offset=p.offset + draw("sensor offset", 6) - (signals - p.to_signal) @ resting(true),
        filter=p.filter * (1 + float(draw("sensor cutoff"))),
        servo=p.servo
        * [
            1 + float(draw("platform bandwidth")),
            1 + float(draw("platform damping")),
            1.0,
        ],
    )
    mass, loss, spring = (
        1 + float(draw(f"base {k}")) for k in ("mass", "damping", "stiffness")
    )
    clock = float(draw("clock"))
    return setup._replace(
        plant=plant,
        base=BaseMatrices(base.M * mass, base.D * loss, base.K * spring),
        clock=clock,
    )
