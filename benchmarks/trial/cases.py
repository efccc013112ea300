"""Cases: what is hidden in which machine, drawn from a secret and an index.

`Case` is drawn without simulating anything; `write.py` sizes its effects and makes its logs.
"""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from benchmarks.trial import laws, machines, noise
from benchmarks.trial.arm import Array
from benchmarks.trial.kinds import KINDS, Kind, Plant
from benchmarks.trial.laboratory import resting_signals
from benchmarks.trial.motions import Quintics, Sines
from benchmarks.trial.servo import Motion, Servo

SIZE = 600  # cases of a set
NULLS, OUTSIDES, PAIRS = 132, 72, 96  # the others are single
GAPS = (1.5, 3.0, 10.0)
RUNS, DURATION = 4, 8.0  # the last run is held back; s
FACTORS = (1.0, 3.0, 10.0)  # of the tolerances described


def generator(secret: str, *names: object) -> np.random.Generator:
    """Return a random generator that belongs to a secret and names."""
    text = "|".join([secret, *map(str, names)])
    return np.random.default_rng(
        int.from_bytes(hashlib.sha256(text.encode()).digest()[:16], "big")
    )


@dataclass(frozen=True)
class Case:
    """One machine with what is hidden in it, before sizes are searched."""

    index: int
    category: str  # null, single, pair, outside
    kinds: tuple[str, ...]
    slots: tuple[int, ...]
    signs: tuple[float, ...]
    shapes: tuple[float, ...]
    gap: float  # wanted, each effect alone, over noise; 0 for null
    mode: str
    vehicle: str
    arm: str
    platform: str
    period: float  # s
    noise: str
    feedforward: bool
    factor: float  # of the tolerances
    stated: bool  # whether the description says so


@cache
def plans(secret: str) -> list[tuple[str, tuple[str, ...], float]]:
    """Return category, kinds and gap of every case of a set, in the order of the indices."""
    rng = generator(secret, "plans")
    known = [k for k in KINDS.values() if not k.outside]
    strange = [k for k in KINDS.values() if k.outside]
    out: list[tuple[str, tuple[str, ...], float]] = [("null", (), 0.0)] * NULLS
    out += [
        ("outside", (strange[i % len(strange)].name,), GAPS[1 + i // len(strange) % 2])
        for i in range(OUTSIDES)
    ]
    for i in range(PAIRS):
        while True:
            a, b = (known[j] for j in rng.choice(len(known), 2, replace=False))
            if set(a.modes) & set(b.modes):
                break
        out.append(("pair", (a.name, b.name), GAPS[1 + i % 2]))
    out += [
        ("single", (known[i % len(known)].name,), GAPS[i // len(known) % 3])
        for i in range(SIZE - len(out))
    ]
    return [out[i] for i in rng.permutation(SIZE)]


def draw(secret: str, index: int) -> Case:
    """Return a case of a set."""
    category, names, gap = plans(secret)[index]
    rng = generator(secret, "case", index)
    kinds = [KINDS[name] for name in names]
    modes = [m for m in ("ideal", "emulated") if all(m in k.modes for k in kinds)]
    mode = modes[int(rng.integers(len(modes)))]
    arm = "puma560" if any(k.geared for k in kinds) or rng.random() < 0.6 else "iiwa14"
    vehicles = list(machines.EMULATED if mode == "emulated" else machines.VEHICLES)
    if any(k.held for k in kinds):
        vehicles = [v for v in vehicles if machines.VEHICLES[v]["kind"] != "satellite"]
    joints = len(machines.SERVOS[arm].kp)
    slots = tuple(int(rng.integers(_places(kind, joints))) for kind in kinds)
    factor = float(rng.choice(FACTORS, p=[0.6, 0.2, 0.2]))
    return Case(
        index=index,
        category=category,
        kinds=names,
        slots=slots,
        signs=tuple(float(s) for s in rng.choice([-1.0, 1.0], len(names))),
        shapes=tuple(float(s) for s in rng.random(len(names))),
        gap=gap,
        mode=mode,
        vehicle=vehicles[int(rng.integers(len(vehicles)))],
        arm=arm,
        # a damping ratio is a number of the pose servo
        platform="legs" if rng.random() < 0.3 and "platform/damping" not in names else "pose",
        period=float(rng.choice(machines.PERIODS)),
        noise=str(rng.choice(noise.FAMILIES)),
        feedforward=bool(rng.random() < 0.5),
        factor=factor,
        stated=factor == 1.0 or bool(rng.random() < 0.5),
    )


def _places(kind: Kind, joints: int) -> int:
    """Number of slots that a kind has."""
    return {"joint": joints, "axis": 6}.get(kind.place, 1)


def motions(case: Case, secret: str, description: dict[str, Any]) -> list[Motion]:
    """Return the motions of a case's runs: sines, dwells, reversals, and sines held back."""
    rng = generator(secret, "motions", case.index)
    links = description["arm"]["links"]
    v_max = np.array([link["v_max"] for link in links])
    a_max = np.array([link["a_max"] for link in links])
    n = len(links)
    centre = rng.uniform(-0.4, 0.4, n)
    out: list[Motion] = []
    for run in range(RUNS):
        if run == 1:
            times, points, t = [], [centre], 0.4
            while t < DURATION - 1.2:
                T = rng.uniform(0.9, 1.6)
                step = rng.uniform(-1, 1, n) * np.minimum(0.4 * v_max * T, 0.08 * a_max * T**2)
                points.append(centre + np.clip(step, -0.6, 0.6))
                times.append((t, t + T))
                t += T + rng.uniform(0.2, 0.7)
            out.append(Quintics(np.array(points), np.array(times)))
            continue
        low, high = ((0.15, 0.9), (0.0, 0.0), (0.08, 0.25), (0.12, 0.7))[run]
        frequency = rng.uniform(low, high, (n, 3))
        w = 2 * np.pi * frequency
        share = rng.uniform(0.4, 1.0, (n, 3))
        share /= share.sum(1)[:, None]
        reach = np.minimum(0.45 * v_max[:, None] / w, 0.2 * a_max[:, None] / w**2)
        amplitude = share * np.minimum(reach, 0.6)
        phase = rng.uniform(-np.pi, np.pi, (n, 3))
        out.append(Sines(centre, amplitude, frequency, phase))
    return out


TOLERANCES = {  # half-widths of uniform draws, at factor 1
    "mass": 0.001,
    "centre": 0.0002,  # m
    "inertia": 0.01,
    "rotor": 0.01,
    "drive": 0.001,
    "servo": 0.001,
    "sensor_gain": 0.001,
    "sensor_offset": 0.03,  # N, N m
    "sensor_cutoff": 0.01,
    "bandwidth": 0.01,
    "damping": 0.01,
    "estimate": 0.005,  # kg
    "K": 0.002,
    "M": 0.002,
    "D": 0.01,
    "clock": 3e-5,
}


def known_exactly(case: Case) -> tuple[str, ...]:
    """Return what a case's description says is exact: errors that no machine here has.

    They are patterns of the diagnosis's tolerances (docs/diagnosis.md, "Tolerances, noise,
    known facts"). Joints of this generator do not rub unless that is hidden in them; a computer
    holds the very numbers of an emulated vehicle, and of the moments in the weight estimate;
    only frames in space have more inner modes than described.

    Args:
        case: for its mode and vehicle.
    """
    kind, emulated = machines.VEHICLES[case.vehicle]["kind"], case.mode == "emulated"
    out = ["friction of joint *", "damping of joint *", "zero of joint *"]
    if emulated:
        out += ["mass of the base", "moment * of the estimate"]
    if kind != "satellite":
        out += ["stiffness of the base", "damping of the base"] if emulated else []
        out += ["inner mode *"] if emulated or kind != "flexible" else []
    return tuple(out)


def known(case: Case) -> dict[str, float]:
    """Return what a case states beside the usual errors: tolerance -> standard deviation.

    Args:
        case: for its mode, vehicle and factor.
    """
    out = dict.fromkeys(known_exactly(case), 0.0)
    if case.mode == "emulated":  # usual is ten times what this generator draws
        factor = case.factor if case.stated else 1.0
        out["weight estimate"] = float(f"{factor * TOLERANCES['estimate'] / 3**0.5:.3g}")
    return out


def real_machine(
    case: Case, secret: str, description: dict[str, Any]
) -> tuple[Plant, Servo, float]:
    """Return the machine within its tolerances, its servo, and the rate of its clock.

    Args:
        case: for its factor of the tolerances.
        secret: of the set.
        description: of the machine; not changed.
    """
    rng = generator(secret, "tolerances", case.index)
    return machine_off(case, description, lambda half, size: half * rng.uniform(-1, 1, size))


def machine_off(
    case: Case, description: dict[str, Any], draw: Callable[[float, int | None], Any]
) -> tuple[Plant, Servo, float]:
    """Return a machine off its description by what is drawn: plant, servo, rate of its clock.

    Args:
        case: for its factor of the tolerances.
        description: of the machine; not changed.
        draw: called with a half-width and how many (None: one), always in the same order.
    """

    def off(name: str, size: int | None = None) -> Any:
        return draw(case.factor * TOLERANCES[name], size)

    plant = Plant({**description}).copy()
    arm = plant.machine["arm"]
    for part in (arm["base"], *(link["inertial"] for link in arm["links"])):
        part["mass"] *= 1 + off("mass")
        part["com"] = (np.asarray(part["com"]) + off("centre", 3)).tolist()
        part["inertia"] = (np.asarray(part["inertia"]) * (1 + off("inertia"))).tolist()
    for link in arm["links"]:
        link["rotor_inertia"] *= 1 + off("rotor")
    scales = {name: 1 + off(name) for name in "MDK"}
    if case.mode == "ideal":  # in the laboratory they are numbers in a computer
        plant.machine["vehicle"]["scales"] = scales
    plant.laws.append(laws.Gain(off("drive", plant.joints)))
    signals = plant.signals
    signals.sensor_gain = np.diag(1 + off("sensor_gain", 6))
    signals.sensor_bias = off("sensor_offset", 6)
    if case.mode == "emulated":  # zeroed under the arm's weight at q = 0
        missing = np.eye(6) - signals.sensor_gain
        signals.sensor_bias = signals.sensor_bias + missing @ resting_signals(description)
    signals.sensor_cutoff = 1 + off("sensor_cutoff")
    signals.bandwidth, signals.damping = 1 + off("bandwidth"), 1 + off("damping")
    signals.weight_mass = off("estimate")
    nominal = machines.SERVOS[case.arm]
    servo = Servo(
        nominal.kp * (1 + off("servo", plant.joints)),
        nominal.kd * (1 + off("servo", plant.joints)),
        case.feedforward,
    )
    return plant, servo, 1 + off("clock")


def noise_std(arm: str) -> dict[str, Array]:
    """Standard deviation of each channel's noise."""
    std = {name: np.array(row) for name, row in machines.NOISE[arm].items()}
    return {**std, "wg": std["w"], "y_cmd": std["y"]}
