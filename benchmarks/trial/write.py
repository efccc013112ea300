"""From a drawn case to files: sizes searched by replay, logs, description, label."""

import csv
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from benchmarks.trial import laboratory, machines, noise, space
from benchmarks.trial.arm import Array
from benchmarks.trial.cases import (
    DURATION,
    RUNS,
    Case,
    draw,
    generator,
    known,
    motions,
    noise_std,
    real_machine,
)
from benchmarks.trial.kinds import KINDS, Plant
from benchmarks.trial.servo import Motion, Servo
from benchmarks.trial.space import Run

SIZED = (0, 1)  # runs by which sizes are searched
CLOSE = 0.1  # a gap this near to the wanted one will do
FINER = 2  # inner modes of a flexible base beyond the described


@dataclass
class Setting:
    """A case as it is simulated, before anything is hidden."""

    case: Case
    description: dict[str, Any]
    plant: Plant
    servo: Servo
    motions: list[Motion]
    clock: float


def setting(secret: str, case: Case) -> Setting:
    """Return the machine of a case and its motions."""
    described = machines.description(
        case.vehicle, case.arm, case.mode, case.platform, case.period
    )
    plant, servo, clock = real_machine(case, secret, described)
    return Setting(case, described, plant, servo, motions(case, secret, described), clock)


def play(
    at: Setting,
    plant: Plant,
    run: int,
    reading_noise: Array | None = None,
    led: Run | None = None,
) -> Run:
    """Return a run without noise but that which goes through the emulation's loop.

    Args:
        at: the machine and its motions.
        plant: as it is.
        run: number of the motion.
        reading_noise: of the force sensor in the laboratory.
        led: there, a run whose commands the platform is sent.
    """
    nominal = replace(machines.SERVOS[at.case.arm], feedforward=at.case.feedforward)
    inner = FINER if at.description["vehicle"]["kind"] == "flexible" else 0
    if at.case.mode == "emulated":
        forces = plant.forces

        def force(y: Array, yd: Array) -> Array:
            return np.sum([f(y, yd) for f in forces], axis=0)

        return laboratory.simulate(
            at.description, plant.machine, nominal, at.motions[run], plant.hidden(),
            duration=DURATION, applied=at.servo, reading_noise=reading_noise,
            vehicle_force=force if forces else None, led=led,
        )  # fmt: skip
    return space.simulate(
        at.description, plant.machine, nominal, at.motions[run], plant.hidden(),
        duration=DURATION, record_dt=at.case.period, applied=at.servo, extra_modes=inner,
    )  # fmt: skip


def gap(case: Case, with_it: Run, without: Run) -> dict[str, float]:
    """RMS difference of each channel over its noise, of the worst of its signals."""
    std, out = noise_std(case.arm), {}
    for name in ("q", "v", "tau", "y", "y_cmd", "w", "wg"):
        a, b = getattr(with_it, name), getattr(without, name)
        if a is not None:
            out[name] = float((np.sqrt(np.mean((a - b) ** 2, axis=0)) / std[name]).max())
    return out


def _changed(at: Setting, peaks: Array, which: int, size: float) -> Plant:
    """The plant with one effect of the case at a size."""
    plant = at.plant.copy()
    plant.peaks = peaks
    add_effect(plant, at.case, which, size)
    return plant


def add_effect(plant: Plant, case: Case, which: int, size: float) -> None:
    """Hide one effect of a case in a plant."""
    plant.sign, plant.shape = case.signs[which], case.shapes[which]
    KINDS[case.kinds[which]].add(plant, case.slots[which], size)


def search(
    at: Setting, healthy: dict[int, Run], peaks: Array, which: int
) -> tuple[float, float, str]:
    """Return size, gap reached and channel of one effect, sized alone by replay.

    The gap is the mean over the runs `SIZED`; a secant in logarithms, five trials at most.
    """
    kind = KINDS[at.case.kinds[which]]
    size, tried = kind.start, [(0.0, 0.0, "")]
    best = (kind.start, 0.0, "")
    for _ in range(5):
        size = float(f"{size:.3g}")  # as processors agree on it
        try:
            plant = _changed(at, peaks, which, size)
            rows = [gap(at.case, play(at, plant, run), healthy[run]) for run in SIZED]
        except FloatingPointError:  # too much for the machine
            size *= 0.4
            continue
        mean = {name: float(np.mean([row[name] for row in rows])) for name in rows[0]}
        channel = max(mean, key=lambda name: mean[name])
        reached = mean[channel]
        if abs(np.log(max(reached, 1e-9) / at.case.gap)) < abs(
            np.log(max(best[1], 1e-9) / at.case.gap)
        ):
            best = (size, reached, channel)
        if abs(reached / at.case.gap - 1) < CLOSE or (
            size >= kind.most and reached < at.case.gap
        ):
            break
        slope = 1.0
        if tried[-1][1] > 0 and reached > 0 and tried[-1][0] != size:
            slope = np.log(reached / tried[-1][1]) / np.log(size / tried[-1][0])
        tried.append((size, reached, channel))
        factor = (at.case.gap / max(reached, 1e-3)) ** (1 / float(np.clip(slope, 0.5, 3.0)))
        size = float(min(size * np.clip(factor, 0.02, 30.0), kind.most))
    return best


def noisy(at: Setting, run: Run, rng: np.random.Generator, loop: bool) -> Run:
    """Return the run as recorded: noise on q, v, tau, y, in space on w too, quantised."""
    case, std, n = at.case, noise_std(at.case.arm), len(run.t)
    dt = float(run.t[1] - run.t[0])
    out = replace(run, t=run.t * at.clock, yd=None)
    for name in ("q", "v", "tau", "y") if loop else ("q", "v", "tau", "y", "w"):
        values = getattr(run, name) + noise.draw(case.noise, std[name], n, dt, rng)
        setattr(out, name, noise.quantised(case.noise, values, std[name]))
    return out


def write_log(path: Path, run: Run, meta: dict[str, Any]) -> None:
    """Write a log as CSV, its metadata beside it."""
    columns, names = [run.t[:, None]], ["t"]
    for name in ("q_cmd", "v_cmd", "q", "v", "tau", "y", "y_cmd", "w", "wg"):
        values = getattr(run, name)
        if values is not None:
            columns.append(values)
            names += [f"{name}_{i + 1}" for i in range(values.shape[1])]
    with path.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(names)
        writer.writerows([[f"{x:.9g}" for x in row] for row in np.hstack(columns)])
    path.with_suffix(".json").write_text(json.dumps(meta), "utf-8")


def write_runs(
    secret: str, at: Setting, plant: Plant, folder: Path, runs: Sequence[int] = range(RUNS)
) -> None:
    """Write logs of a machine to `folder`: `run-1.csv`, its metadata beside it, and so on.

    Args:
        secret: of the set.
        at: the machine as described, and its motions.
        plant: as it is.
        folder: exists.
        runs: which of the motions; the last of the case's is marked as held back.
    """
    case, std = at.case, noise_std(at.case.arm)
    emulated = case.mode == "emulated"
    for run in runs:
        rng = generator(secret, "noise", case.index, run)
        reading = None
        if emulated:
            dt = at.description["control_dt"]
            samples = round(DURATION / dt) + 1
            reading = noise.draw(case.noise, std["w"], samples, dt, rng)
        result = noisy(at, play(at, plant, run, reading), rng, emulated)
        channels = ("q", "v", "tau", "y", "w", *(("wg",) if emulated else ()))
        meta = {
            "format": "ves-run/1",
            "system": at.description,
            "controller": {
                "kp": machines.SERVOS[case.arm].kp.tolist(),
                "kd": machines.SERVOS[case.arm].kd.tolist(),
                "feedforward": case.feedforward,
            },
            "initial": {
                "q": result.q_cmd[0].tolist(),
                "v": [0.0] * plant.joints,
                "y": [0.0] * 6,
                "yd": [0.0] * 6,
            },
            "noise_std": {name: std[name].tolist() for name in channels},
            "held_back": run == RUNS - 1,
            "note": "",
        }
        write_log(folder / f"run-{run + 1}.csv", result, meta)


def write_case(secret: str, index: int, folder: Path) -> dict[str, Any]:
    """Write a case's logs and description to `folder`, and return its label.

    Args:
        secret: of the set.
        index: of the case.
        folder: gets `system.toml`, `tolerances.toml`, `run-1.csv` and so on.
    """
    case = draw(secret, index)
    at = setting(secret, case)
    healthy = {run: play(at, at.plant, run) for run in SIZED}
    peaks = np.max([np.abs(run.tau).max(0) for run in healthy.values()], axis=0)
    found = [search(at, healthy, peaks, which) for which in range(len(case.kinds))]
    plant = at.plant.copy()
    plant.peaks = peaks
    for which, (size, _, _) in enumerate(found):
        add_effect(plant, case, which, size)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "system.toml").write_text(tomli_w.dumps(at.description), "utf-8")
    tolerances = {
        "schema": "ves-tolerances/1",
        "scale": case.factor if case.stated else 1.0,
        "known": known(case),
    }
    (folder / "tolerances.toml").write_text(tomli_w.dumps(tolerances), "utf-8")
    write_runs(secret, at, plant, folder)
    effects = [
        {"kind": name, "slot": slot + 1 if KINDS[name].place in ("joint", "axis") else None,
         "sign": sign, "size": size, "gap": float(f"{reached:.3g}"), "channel": channel}
        for name, slot, sign, (size, reached, channel) in zip(
            case.kinds, case.slots, case.signs, found, strict=True
        )
    ]  # fmt: skip
    return {**asdict(case), "effects": effects}
