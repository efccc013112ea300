"""The list of cases, and one case: sized, simulated, measured."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.independent_trial import catalogue, measurement, motions
from benchmarks.independent_trial import effects as laws
from benchmarks.independent_trial.effects import Change, Effect
from benchmarks.independent_trial.machine import PERIOD, Machine, Plant

SYSTEMS = Path(__file__).with_name("systems")
GAINS = {  # thesis; iiwa14: 2 Hz and 0.7 at the largest inertia
    "puma": ([3000.0, 2000.0, 1000.0], [50.0, 40.0, 30.0]),
    "iiwa": (
        [45.02, 998.2, 36.12, 199.5, 4.474, 3.557, 0.2398],
        [5.016, 111.2, 4.024, 22.22, 0.4984, 0.3963, 0.02672],
    ),
}
SPACE = ("puma_bent_thesis_ideal", "puma_bent_ideal", "iiwa14_straight_ideal")
LAB = ("puma_bent_thesis_emulated", "puma_bent_emulated")
MULTIPLES = {"first": (3.0, 10.0), "second": (4.0, 8.0)}
TAIL = 1.5  # s of free motion after the command


@dataclass
class Case:
    """What is hidden in one case, before its size is known."""

    kind: str  # single, null, outside, pair, mode
    names: list[str]
    system: str
    multiple: float
    tolerance: float  # factor on what is stated
    seed: tuple[int, ...]
    half: str


@dataclass
class Made:
    """One case made: runs as recorded, what is true, how far from the machine without it."""

    case: Case
    logs: list[dict[str, Any]]  # three, and the one held back
    effects: list[Effect]
    sizes: list[float]
    gaps: list[dict[str, float]] = field(default_factory=list)


def description(system: str) -> dict[str, Any]:
    return tomllib.loads((SYSTEMS / f"{system}.toml").read_text())


def stated(system: str) -> Machine:
    return Machine.read(description(system), *GAINS[system[:4]])


def plan(half: str, seed: int) -> list[Case]:
    """About a hundred cases of one half, in random order."""
    rng = np.random.default_rng([seed, half == "second"])
    out: list[Case] = []

    def add(
        kind: str, names: list[str], place: str, multiple: float, tolerance: float = 1.0
    ) -> None:
        n = len(out)
        system = choose(rng, names, place, tolerance)
        out.append(
            Case(kind, names, system, multiple, tolerance, (seed, half == "second", n), half)
        )

    for name, (_, places, _) in catalogue.LIBRARY.items():
        for multiple in MULTIPLES[half]:
            add("single", [name], str(rng.choice(places)), multiple)
    for k in range(20):
        add("null", [], ("space", "lab")[k % 4 == 3], 0.0, 1.0 if k < 10 else 3.0)
    for name, (_, places, _) in catalogue.OUTSIDE.items():
        for multiple in MULTIPLES[half]:
            add("outside", [name], str(rng.choice(places)), multiple)
    names = list(catalogue.LIBRARY)
    while sum(c.kind == "pair" for c in out) < 10:
        pair = [str(x) for x in rng.choice(names, 2, replace=False)]
        places = set(catalogue.LIBRARY[pair[0]][1]) & set(catalogue.LIBRARY[pair[1]][1])
        if places and not set(pair) <= {"joint elasticity", "backlash"}:
            add("pair", pair, str(rng.choice(sorted(places))), MULTIPLES[half][-1])
    for k in range(3):
        add("mode", [f"base mode {k + 1}"], "space", 0.0)
    return [out[i] for i in rng.permutation(len(out))]


def choose(rng: np.random.Generator, names: list[str], place: str, tolerance: float) -> str:
    if place == "lab":
        # the finite-element beam's loop has little to spare (documentation, section 11)
        steady = set(names) <= catalogue.STEADY and tolerance == 1.0
        return str(rng.choice(LAB)) if steady else LAB[0]
    if set(names) & catalogue.THESIS_ONLY or any(n.startswith("base mode") for n in names):
        return SPACE[0]
    if set(names) & catalogue.PUMA_ONLY:
        return str(rng.choice(SPACE[:2]))
    return str(rng.choice(SPACE, p=(0.5, 0.42, 0.08)))


def hidden(case: Case, rng: np.random.Generator, m: Machine) -> list[Effect]:
    if case.kind == "mode":
        number = int(case.names[0].split()[-1]) - 1
        law = {"to": laws.one_mode, "q": np.zeros(m.arm.n)}
        return [Change(kind=case.names[0], where=number, law=law, start=0.03, unit="1")]
    return [catalogue.make(name, rng, m, case.half == "second") for name in case.names]


def gap(with_: dict[str, Any], without: dict[str, Any]) -> dict[str, float]:
    """Per channel group: r.m.s. difference over the run in noise levels, its worst column."""
    n = without["tau"].shape[1]
    out = {}
    for name, x in without.items():
        if name == "wg":
            continue  # the same noise as w
        std = measurement.sigma(name, x.shape[1], n)
        out[name] = float(np.max(np.sqrt(np.mean((with_[name] - x) ** 2, axis=0)) / std))
    return out


def rows_without_noise(
    plant: Plant, path: motions.Motion, rows: int, sizes: list[float], tag: int
) -> dict[str, Any]:
    """Noise-free rows, with what the effects do to the recorder."""
    run = plant.run(path, rows, sizes, None, np.random.default_rng(tag))
    out, rng = run.sampled(), np.random.default_rng(tag)
    for e, s in zip(plant.effects, sizes, strict=True):
        e.record(out, run.t, s, rng)
    return out


def worst(g: dict[str, float]) -> float:
    value = max(g.values())
    return value if np.isfinite(value) else 1e9


def fit_size(measure: Any, start: float, target: float, tries: int = 12) -> float:
    """The size whose gap is `target` within 2 %: secant in logarithms, kept in a bracket."""
    low, high, s, slope = 0.0, np.inf, start, 1.0
    last: tuple[float, float] | None = None
    for _ in range(tries):
        g = max(measure(s), 1e-9)
        if abs(g / target - 1) < 0.02:
            break
        low, high = (s, high) if g < target else (low, s)
        if last is not None and g != last[1] and s != last[0]:
            slope = np.log(g / last[1]) / np.log(s / last[0])
        last = (s, g)
        slope = float(np.clip(slope, 0.3, 4.0))
        s = s * float(np.clip((target / g) ** (1 / slope), 0.1, 10.0))
        if not low < s < high:
            s = np.sqrt(low * high) if low > 0 else high / 2
        if high < 1.002 * low:
            break  # a law in whole rows has a gap in whole steps
    return float(s)


def sized(
    plant: Plant, path: motions.Motion, without: dict[str, Any], target: float, tag: int
) -> float:
    """The size of a plant's only effect that moves the rows `target` noise levels away."""
    rows, effect = len(without["tau"]), plant.effects[0]
    measure = lambda s: worst(gap(rows_without_noise(plant, path, rows, [s], tag), without))  # noqa: E731
    return fit_size(measure, effect.start, target)


def length_of(rng: np.random.Generator) -> int:
    return round(rng.uniform(10.0, 13.0) / PERIOD)


def make(case: Case) -> Made:
    """Simulate a case. Deterministic: all draws hang on `case.seed`."""
    rng = np.random.default_rng(list(case.seed))
    known = stated(case.system)
    true = measurement.deviate(known, rng, case.tolerance)
    effects = hidden(case, rng, known)
    shapes = motions.SECOND if case.half == "second" else motions.FIRST
    rows = [length_of(rng) for _ in shapes]
    paths = [
        shape(rng, known.arm.limits, r * PERIOD - TAIL)
        for shape, r in zip(shapes, rows, strict=True)
    ]
    bare, tag = Plant(known, true, []), int(rng.integers(2**31))
    without = bare.run(paths[0], rows[0]).sampled() if effects else {}
    sizes = [
        e.start
        if case.kind == "mode"
        else sized(Plant(known, true, [e]), paths[0], without, case.multiple, tag)
        for e in effects
    ]
    plant = Plant(known, true, effects) if effects else bare
    made = Made(case, [], effects, sizes)
    for k in range(len(paths)):
        loud = None
        if true.lab is not None:
            std = measurement.sigma("w", 6, known.arm.n)
            loud = measurement.noise(rng, rows[k], std)
            loud = np.round(loud / measurement.STEP["w"]) * measurement.STEP["w"]
        run = plant.run(paths[k], rows[k], sizes, loud, np.random.default_rng(tag))
        made.logs.append(
            {"run": run, "rows": measurement.record(run, effects, sizes, rng, case.tolerance)}
        )
        if effects and k in (0, len(paths) - 1):
            other = without if k == 0 else bare.run(paths[k], rows[k]).sampled()
            made.gaps.append(
                gap(rows_without_noise(plant, paths[k], rows[k], sizes, tag), other)
            )
    return made
