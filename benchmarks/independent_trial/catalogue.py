"""Which effects exist, with the numbers of their laws, for either half of the trial."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.independent_trial import effects as e
from benchmarks.independent_trial.effects import Effect
from benchmarks.independent_trial.machine import Machine

Rng = np.random.Generator
LAB, SPACE = "lab", "space"


def joint(rng: Rng, m: Machine) -> int:
    return int(rng.integers(min(m.arm.n, 4)))  # not the light wrist of seven joints


def direction(rng: Rng, size: int = 3) -> Any:
    x = rng.standard_normal(size)
    return x / np.linalg.norm(x)


def friction(rng: Rng, m: Machine, second: bool, **law: Any) -> Effect:
    """One bristle in the first half, four (Maxwell slip) in the second."""
    if second:
        law |= {"bristles": [2e-3, 5e-3, 0.012, 0.03], "weights": [0.35, 0.3, 0.2, 0.15]}
    else:
        law |= {"bristles": [rng.uniform(2e-3, 4e-3)], "weights": [1.0]}
    return e.Friction(where=joint(rng, m), law=law, start=1.0, unit="N m")


def coulomb(rng: Rng, m: Machine, second: bool) -> Effect:
    return friction(rng, m, second)


def stribeck(rng: Rng, m: Machine, second: bool) -> Effect:
    return friction(rng, m, second, stick=rng.uniform(0.8, 1.5), fade=rng.uniform(0.03, 0.08))


def uneven(rng: Rng, m: Machine, second: bool) -> Effect:
    return friction(rng, m, second, uneven=rng.choice([-1, 1]) * rng.uniform(0.6, 0.9))


def load(rng: Rng, m: Machine, second: bool) -> Effect:
    f = friction(rng, m, second, load=True, idle=0.3)
    f.start, f.unit = 0.05, "N m/(N m)"
    return f


def dwell(rng: Rng, m: Machine, second: bool) -> Effect:
    return friction(
        rng, m, second, dwell=rng.uniform(0.05, 0.2), forget=rng.uniform(0.01, 0.03)
    )


def viscous(rng: Rng, m: Machine, second: bool) -> Effect:
    law = {"f": e.thinning, "v0": rng.uniform(0.4, 0.8), "power": 0.25 if second else 0.12}
    return e.Torque(where=joint(rng, m), law=law, start=1.0, unit="N m s/rad")


def ripple(rng: Rng, m: Machine, second: bool) -> Effect:
    law = {"f": e.ripple, "teeth": int(rng.integers(7, 20)), "phase": rng.uniform(0, 6)}
    law |= {"second": rng.uniform(0.2, 0.5), "loaded": 0.05 if second else 0.0}
    return e.Torque(where=joint(rng, m), law=law, start=1.0, unit="N m")


def drive(rng: Rng, m: Machine, second: bool) -> Effect:
    j = joint(rng, m)
    law = {"fall": 0.6 if second else 0.0, "top": 0.5 * m.arm.limits["tau_max"][j]}
    return e.Drive(where=j, law=law, start=0.05, unit="1")


def thermal(rng: Rng, m: Machine, second: bool) -> Effect:
    j = joint(rng, m)
    law = {"top": 0.3 * m.arm.limits["tau_max"][j], "warm": rng.uniform(5, 15)}
    law["c"] = 0.6 if second else 0.2
    return e.Thermal(where=j, law=law, start=2.0, unit="1")


def gear(rng: Rng, m: Machine, second: bool) -> Effect:
    j = joint(rng, m)
    law = {"d0": 5e-3, "zeta": rng.uniform(0.03, 0.1), "rotor": m.arm.rotor[j]}
    law |= {"slip": 1e-3, "share": 0.35}
    kind = e.Hysteresis if second else e.Gear
    return kind(where=j, gears=(j,), law=law, start=2e-4, unit="rad/(N m)")


def backlash(rng: Rng, m: Machine, second: bool) -> Effect:
    j = joint(rng, m)
    law = {"k": 1e5, "c": 150.0 if second else 60.0}
    return e.Backlash(where=j, gears=(j,), law=law, start=1e-3, unit="rad")


def change(to: Callable[..., None], start: float, unit: str, **fixed: Any) -> Any:
    def make(rng: Rng, m: Machine, second: bool) -> Effect:
        law = {k: v(rng, m) if callable(v) else v for k, v in fixed.items()} | {"to": to}
        j = joint(rng, m) if to is e.rotor else 0
        return e.Change(where=j, law=law, start=start, unit=unit)

    return make


def shares(rng: Rng, m: Machine, size: int = 6) -> Any:
    return rng.uniform(0.5, 1.5, size)


def command_delay(rng: Rng, m: Machine, second: bool) -> Effect:
    law = {"shares": rng.uniform(0.8, 1.2, m.arm.n) if second else np.ones(m.arm.n)}
    return e.CommandDelay(law=law, start=2e-3, unit="s")


def encoder_delay(rng: Rng, m: Machine, second: bool) -> Effect:
    return e.EncoderDelay(where=joint(rng, m), start=3e-3, unit="s")


def reading(f: Callable[..., Any], start: float, unit: str) -> Any:
    def make(rng: Rng, m: Machine, second: bool) -> Effect:
        way = direction(rng, 6) * np.array([1, 1, 1, 0.3, 0.3, 0.3])
        law = {"f": f, "way": way, "axis": direction(rng), "T": rng.uniform(2, 6)}
        law |= {"log": 0.5 if second else 0.0, "t0": 0.5, "phase": rng.uniform(0, 6)}
        law["G"] = rng.standard_normal((6, 6)) * (np.eye(6) + 0.05)
        return e.Reading(law=law, start=start, unit=unit)

    return make


def sensor_lag(rng: Rng, m: Machine, second: bool) -> Effect:
    return e.SensorLag(law={"shares": shares(rng, m)}, start=3e-3, unit="s")


def loop_delay(rng: Rng, m: Machine, second: bool) -> Effect:
    return e.LoopDelay(start=2e-3, unit="s")


def rate_limit(rng: Rng, m: Machine, second: bool) -> Effect:
    law = {"top": np.array([0.06, 0.06, 0.06, 0.02, 0.02, 0.02])}
    return e.RateLimit(law=law, start=2.0, unit="1")


def speed_damping(rng: Rng, m: Machine, second: bool) -> Effect:
    return e.SpeedDamping(law={"m": np.diag(m.base.M)[:6]}, start=5.0, unit="1/m, 1/rad")


def appendage(rng: Rng, m: Machine, second: bool) -> Effect:
    law = {"way": np.r_[direction(rng), 0, 0, 0], "omega": 2 * np.pi * rng.uniform(0.4, 1.2)}
    law |= {"zeta": 0.02, "x0": 0.05 if second else 1e3, "dry": 0.01 if second else 0.0}
    return e.Appendage(law=law, start=2.0, unit="kg")


def rolling(rng: Rng, m: Machine, second: bool) -> Effect:
    K = np.array(m.base.K)[:6, :6]
    law = {"K": K, "grip": 5.0 if second else 2.0}
    return e.Rolling(where=int(rng.integers(2)), law=law, start=1e-5, unit="m/(N s)")


def floor(rng: Rng, m: Machine, second: bool) -> Effect:
    f = rng.uniform(1, 7, 3)
    lines = [(x, np.r_[direction(rng), 0, 0, 0], rng.uniform(0, 6)) for x in f]
    return e.Floor(law={"lines": lines, "K": m.base.K, "D": m.base.D}, start=1e-4, unit="m")


def hose(rng: Rng, m: Machine, second: bool) -> Effect:
    way = rng.uniform(0.3, 1.0, m.arm.n) * rng.choice([-1, 1], m.arm.n)
    law = {"way": way, "x0": 0.0, "k": 2.0 if second else 0.7, "b": 0.02}
    return e.Hose(law=law, start=1.0, unit="N m")


def packet_loss(rng: Rng, m: Machine, second: bool) -> Effect:
    law = {"channels": ("y", "yd"), "every": 0.3 if second else 0.8}
    return e.PacketLoss(law=law, start=0.1, unit="s")


def hum(rng: Rng, m: Machine, second: bool) -> Effect:
    names = {"tau": direction(rng, m.arm.n) * 0.2, "w": direction(rng, 6) * 0.3}
    return e.Hum(law={"channels": names}, start=3.0, unit="1")


def clock_step(rng: Rng, m: Machine, second: bool) -> Effect:
    return e.ClockStep(start=0.02, unit="s")


def point(rng: Rng, m: Machine) -> Any:
    return direction(rng) * rng.uniform(0.03, 0.12)


# name: (maker, where it can be, number in the protocol's library or None)
LIBRARY: dict[str, tuple[Any, tuple[str, ...], int | None]] = {
    "Coulomb friction": (coulomb, (SPACE,), 1),
    "viscous friction": (viscous, (SPACE, LAB), 2),
    "Stribeck friction": (stribeck, (SPACE,), 3),
    "direction-dependent friction": (uneven, (SPACE,), 4),
    "load-dependent friction": (load, (SPACE,), 5),
    "joint elasticity": (gear, (SPACE,), 6),
    "backlash": (backlash, (SPACE,), 7),
    "gear ripple": (ripple, (SPACE,), 8),
    "rotor inertia": (change(e.rotor, 0.05, "kg m^2"), (SPACE, LAB), 9),
    "drive gain": (drive, (SPACE, LAB), 10),
    "torque limit": (thermal, (SPACE,), 11),
    "command delay": (command_delay, (SPACE, LAB), 12),
    "measurement delay": (encoder_delay, (SPACE,), 12),
    "payload mass": (change(e.payload, 0.3, "kg", p=point, r=0.04), (SPACE, LAB), 13),
    "payload centre": (
        change(e.centre, 0.01, "m", way=lambda r, m: direction(r)), (SPACE, LAB), 14,
    ),
    "sensor bias": (reading(e.bias, 1.0, "N; 0.3 N m"), (LAB,), 15),
    "sensor gain": (reading(e.cross_talk, 0.003, "1"), (LAB,), 16),
    "sensor rotation": (reading(e.mounting, 0.003, "rad"), (LAB,), 17),
    "sensor drift": (reading(e.creep, 1.0, "N; 0.3 N m"), (LAB,), 18),
    "sensor lag": (sensor_lag, (LAB,), 19),
    "platform delay": (loop_delay, (LAB,), 20),
    "platform bandwidth": (change(e.bandwidth, 0.1, "1", shares=shares), (LAB,), 21),
    "platform rate limit": (rate_limit, (LAB,), 22),
    "virtual mass": (change(e.virtual_mass, 0.05, "1", turn=0.6), (SPACE, LAB), 23),
    "gravity leak": (
        change(e.tilt, 0.001, "rad", way=lambda r, m: direction(r, 2)), (LAB,), 24,
    ),
    "base stiffness": (change(e.stiffness, 0.05, "1"), (SPACE, LAB), 25),
    "extra mode": (appendage, (SPACE,), 26),
    "base damping": (change(e.damping, 0.5, "1"), (SPACE, LAB), 27),
    "amplitude-dependent damping": (speed_damping, (SPACE,), 27),
}  # fmt: skip
OUTSIDE: dict[str, tuple[Any, tuple[str, ...], int | None]] = {
    "packet loss": (packet_loss, (SPACE,), None),
    "50 Hz pickup": (hum, (SPACE,), None),
    "floor vibration": (floor, (SPACE,), None),
    "hose drag": (hose, (SPACE, LAB), None),
    "dwell-dependent stiction": (dwell, (SPACE,), None),
    "rolling base": (rolling, (SPACE,), None),
    "clock step": (clock_step, (SPACE,), None),
}
PUMA_ONLY = {"joint elasticity", "backlash", "torque limit"}  # gears need a rotor
STEADY = {
    "sensor bias",
    "sensor drift",
    "sensor rotation",
    "gravity leak",
}  # change no dynamics
THESIS_ONLY = {
    "rolling base",
    "floor vibration",
}  # their laws take a base without modes of its own


def make(name: str, rng: Rng, m: Machine, second: bool) -> Effect:
    maker = (LIBRARY | OUTSIDE)[name][0]
    effect = maker(rng, m, second)
    effect.kind = name
    return effect
