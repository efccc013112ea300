"""What is missing between the weight that the thesis measured and the arm that it describes?

    python examples/thesis_weight/diagnose.py [FOLDER]

C.3 prints the PUMA 560's total mass and minimal parameters twice: identified from 47 poses
with the force sensor, and from parts that were weighed. The logs have the weight that the
first predict, read slowly pose by pose; the description has the second. Held back: joint 1
turns by 180 deg while the platform tilts from +5 to -5 deg, as for table 3-1. Logs and
description stay in FOLDER, so that

    ves-gym diagnose FOLDER/logs --system FOLDER/measured.toml --band 0.25

finds the same. Why the verdict is what it is: docs/results.md, `by_hand.py`.
"""

import argparse
import dataclasses
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

import ves_gym as vg
from ves_gym.effects import LABORATORY_ERRORS, SensorNoise
from ves_gym.hardware import ForceSensor
from ves_gym.mechanics import GravityModel, minimal_model

Array = npt.NDArray[np.float64]

IDENTIFIED = GravityModel(
    mass=95.065,
    P=(0.1028, 0.8352, 45.7104, 0.1593, -5.8440, 4.6137, 0.1298, 2.2527, -0.0738),
    source="thesis C.3, experimentally determined",
)
MEASURED = GravityModel(
    mass=93.678,
    P=(0.0, 0.0, 54.54, 0.0, -5.308, 5.065, 0.1044, 2.617, 0.0),
    source="thesis C.3, physically measured; sign of P5 restored (docs/errata.md)",
)
POSES, RUNS, TILT = 47, 3, np.deg2rad(5.0)
PER_POSE, CHECK = 40.0, 320.0  # s; the motion's own wrench is below 0.05 N, N m rms
STEP, BAND = 0.4, 0.25  # s, Hz
NOISE = next(e for e in LABORATORY_ERRORS if isinstance(e, SensorNoise))


def reweighed(arm: vg.Arm, mass: float, P: Sequence[float] | Array) -> vg.Arm:
    """The arm with this much more mass [kg] and minimal parameters P (9,) [kg m] larger.

    The foot takes the mass; centres of mass move as little as will do.
    """
    bodies = [arm.base, *(link.inertial for link in arm.links)]
    bodies[0] = dataclasses.replace(arm.base, mass=arm.base.mass + mass)
    heavier = dataclasses.replace(arm, base=bodies[0])
    minimal = minimal_model(heavier)
    lever = minimal.combination[:, : 3 * len(bodies)]  # of the bodies' first moments
    wanted = minimal_model(arm).parameters() + np.asarray(P) - minimal.parameters()
    change = np.linalg.lstsq(lever, wanted)[0].reshape(-1, 3)
    foot, *rest = (
        dataclasses.replace(body, com=tuple((np.array(body.com) + k / body.mass).tolist()))
        for body, k in zip(bodies, change, strict=True)
    )
    links = zip(arm.links, rest, strict=True)
    moved = tuple(dataclasses.replace(link, inertial=body) for link, body in links)
    return dataclasses.replace(arm, base=foot, links=moved)


def system_of(model: GravityModel) -> vg.System:
    """The laboratory with an arm of that weight."""
    known = GravityModel.of(vg.PUMA_560)
    arm = reweighed(vg.PUMA_560, model.mass - known.mass, np.subtract(model.P, known.P))
    return vg.System(arm=dataclasses.replace(arm, source=model.source), mode="emulated")


def paths() -> list[vg.Motion]:
    """Joints and the platform's tilts about x and y, (m, 5): the poses, then the check."""
    q, y = vg.simulation.calibration_poses(vg.PUMA_560, POSES, tilt=TILT)
    parts = np.array_split(np.hstack([q, y[:, 3:5]]), RUNS)
    check = np.array([-np.pi / 2, 0, 0, TILT, TILT])
    return [
        *(vg.Motion.through(points, PER_POSE * len(points)) for points in parts),
        vg.Motion.straight(check, -check, CHECK),
    ]


def log_of(path: vg.Motion, weight: GravityModel, seed: int) -> vg.RunLog:
    """What the force sensor reads of such a weight: late by its filter, noise on top."""
    t = np.arange(0.0, path.duration, STEP)
    now, felt = path.at(t), path.at(t - ForceSensor().lag)
    (q, y), then = (_split(s.q) for s in (now, felt))
    std = np.array([*NOISE.force, *NOISE.moment])
    noise = std * np.random.default_rng(seed).standard_normal((len(t), 6))
    return vg.RunLog(
        t=t,
        q_cmd=q,
        v_cmd=now.v[:, :3],
        q=q,
        y=y,
        w=weight.wrench(vg.PUMA_560, *then) + noise,
        meta={
            "format": "ves-run/1",
            "noise_std": {"w": std.tolist()},
            "note": f"weight predicted by {weight.source}",
        },
    )


def _split(path: Array) -> tuple[Array, Array]:
    """Joint angles (N, 3) and platform poses (N, 6) of points (N, 5)."""
    y = np.zeros((len(path), 6))
    y[:, 3:5] = path[:, 3:]
    return path[:, :3], y


def write_logs(folder: Path, weight: GravityModel, seed: int = 0) -> list[Path]:
    """A log of every path; the last is the one held back."""
    out = []
    for i, path in enumerate(paths()):
        out.append(folder / f"run-{i + 1}.parquet")
        log_of(path, weight, seed + i).save(out[-1])
    return out


def verdict(
    described: GravityModel,
    files: Sequence[Path],
    more: Sequence[vg.Candidate] = (),
    band: float = BAND,
) -> vg.Diagnosis:
    """Diagnose a machine with this arm from logs, the last of them held back.

    Args:
        described: weight of the arm as described.
        files: of the logs.
        more: candidates beside those of the library.
        band: what is compared [Hz].
    """
    system = system_of(described)
    return vg.diagnose(files, system, final=1, band=band, candidates=more, as_logged=True)


def stretched(found: vg.Diagnosis) -> list[tuple[str, float]]:
    """Tolerances that the answer takes beyond 3 times their size, largest first."""
    sizes: Array = found.selection.fit.nuisances
    pairs = zip((k.name for k in found.residuals.nuisances), sizes.tolist(), strict=True)
    return sorted((p for p in pairs if abs(p[1]) > 3), key=lambda p: -abs(p[1]))


def show(found: vg.Diagnosis) -> None:
    """Print the verdict, what was tried, and what is left."""
    print(found.sentence)
    for step in found.selection.steps:
        print(" ", step)
    for f in found.explanations:
        if f.candidate.kind != "sensor/drift":  # 8 numbers a run
            pairs = zip(f.candidate.names, f.values, f.candidate.units, strict=True)
            print(f"  {f.candidate.name}:", ", ".join(f"{n} {v:.4f} {u}" for n, v, u in pairs))
    far = ", ".join(f"{name} {size:.0f} times" for name, size in stretched(found))
    print("tolerances stretched:", far or "none")
    print("gap on the run held back, before and after:")
    for gap in found.final:
        print(f"  {gap.channel} {gap.before:.1f} {gap.after:.1f}")


def main() -> None:
    """Write the logs, diagnose, print."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("folder", nargs="?", help="where logs and description stay")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(args.folder or scratch)
        files = write_logs(folder / "logs", IDENTIFIED)
        system_of(MEASURED).save(folder / "measured.toml")
        found = verdict(MEASURED, files)
    show(found)


if __name__ == "__main__":
    main()
