"""`ves-gym diagnose` on machines of other people, against what was published of them.

    python -m benchmarks.real_machines FOLDER [emps tiago staubli] [--json FILE]

FOLDER holds `emps/`, `tiago_arm/`, `staubli_tx40/`; nothing of it is part of the project. Each
is described as a newcomer would from its documents: the columns of the examples, tolerances
as `--describe` writes them, no noise, no friction, no radius of a pinion; where there is one
file the last third is held back. Sizes are printed beside the published ones and beside least
squares on the same residual, joint by joint, which are told the laws. UR10e and Panda: no logs
of them are here.
"""

from __future__ import annotations

import argparse
import time
import tomllib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import ves_gym as vg
from benchmarks import store
from ves_gym._util.params import Array
from ves_gym._util.recordings import read_columns
from ves_gym.diagnosis.data.describe import SETTINGS as DESCRIBED
from ves_gym.diagnosis.data.measured_run import Run, run_of_signals
from ves_gym.diagnosis.machines.mjcf_mapping import machine_of

EXAMPLES = Path(__file__).parents[1] / "examples"
SETTINGS = ("tolerance", "noise", "known", "band")  # that were chosen with the data in sight
STAUBLI = {  # T40X_config.yaml of the data; what is of the shaft is in joints 5 and 6 once more
    "coulomb": (7.14, 8.26, 6.34, 2.48, 3.03, 0.282),
    "viscous": (8.05, 5.53, 1.97, 1.11, 1.86, 0.65),
}
PUBLISHED: dict[str, dict[str, Sequence[float]]] = {
    "emps": {"coulomb": (20.39,), "viscous": (203.5,)},
    "tiago": {"lag": (0.195,) * 8},
    "staubli": STAUBLI,
}
FIELDS = {  # law -> effect and its number
    "coulomb": ("joint/coulomb", "torque"),
    "viscous": ("joint/viscous", "damping"),
    "lag": ("joint/velocity_lag", "time_constant"),
}


def described(name: str, model: Path | None = None) -> tuple[Any, Callable[[Path], Run]]:
    """Machine and loader of an example's mapping file without its settings."""
    (path,) = (EXAMPLES / name).glob("*.toml")
    table = {k: x for k, x in tomllib.loads(path.read_text()).items() if k not in SETTINGS}
    table |= tomllib.loads("\n".join(DESCRIBED))
    if model is not None:
        table["model"] = str(model.resolve())
    for joint in table["joint"]:
        joint.pop("radius", None)
    file, machine = machine_of(table, path)
    return machine, lambda data: file.run(read_columns(data), data.name)


def parted(run: Run) -> list[Run]:
    """The first two thirds of a run, and the last."""
    cut, dt = 2 * run.length // 3, run.dt
    out = []
    for name, part in (("first", slice(0, cut)), ("last", slice(cut, run.length))):
        signals = {k: x[part] for k, x in run.signals.items()}
        t = dt * np.arange(run.length)[part]
        out.append(run_of_signals(t, signals, f"{name} of {run.name}", run.band, run.meta))
    return out


def emps(folder: Path) -> tuple[Any, list[Run]]:
    """The axis, the second file held back."""
    machine, load = described("emps")
    return machine, [load(folder / "emps" / f"DATA_EMPS{k}.mat") for k in ("", "_PULSES")]


def tiago(folder: Path) -> tuple[Any, list[Run]]:
    """The drives of lift and arm."""
    machine, load = described("tiago")
    return machine, parted(load(folder / "tiago_arm"))


def staubli(folder: Path) -> tuple[Any, list[Run]]:
    """Six joints, the wrist's motors coupled."""
    data = folder / "staubli_tx40"
    machine, load = described("staubli", data / "tx40_mdh_modified.urdf")
    return machine, parted(load(data))


MACHINES = {"emps": emps, "tiago": tiago, "staubli": staubli}


def sizes(effects: Sequence[Any], law: str, n: int) -> Array:
    """A law's number at each joint (n,), all effects together."""
    out, (kind, field) = np.zeros(n), FIELDS[law]
    for effect in effects:
        if getattr(effect, "kind", "") == kind:
            out = out + np.broadcast_to(getattr(effect, field), n)
        if law == "viscous" and hasattr(effect, "ratio"):  # of a shaft
            out = out + effect.viscous * np.square(effect.ratio)
    return out


def least_squares(machine: Any, run: Run) -> dict[str, Array]:
    """Friction of each joint by least squares on what the described motion leaves."""
    left = machine.residuals(run, [machine.nominal], ["joint"])["joint"][0]
    inner = slice(run.window.skip, run.length - run.window.skip)
    found = []
    for r, v in zip(left[inner].T, run.joints.v[inner].T, strict=True):
        laws = np.stack([np.sign(v), v, np.ones_like(v)], axis=1)
        found.append(np.linalg.lstsq(laws, r, rcond=None)[0])
    coulomb, viscous, _ = np.array(found).T
    return {"coulomb": coulomb, "viscous": viscous}


def judged(name: str, folder: Path) -> dict[str, Any]:
    """Diagnose a machine; names, sizes, gaps and seconds."""
    machine, runs = MACHINES[name](folder)
    begin = time.process_time()
    found = vg.diagnose(runs, machine, final=1, as_logged=True)
    seconds = time.process_time() - begin
    own = least_squares(machine, runs[0]) if "tau" in runs[0] else {}
    n, before, after = (
        len(machine.joints),
        *(
            float(np.sqrt(np.mean([getattr(g, k) ** 2 for g in found.final])))
            for k in ("before", "after")
        ),
    )
    laws = {
        law: {
            "found": sizes(found.effects, law, n).tolist(),
            "published": list(published),
            "least squares": own[law].tolist() if law in own else None,
        }
        for law, published in PUBLISHED[name].items()
    }
    names = [e.candidate.name for e in found.explanations]
    return {
        "verdict": found.verdict,
        "sentence": found.sentence,
        "names": names,
        "probability": [e.probability for e in found.explanations],
        "laws": laws,
        "gap before, held back": before,
        "gap after, held back": after,
        "CPU s": seconds,
    }


def told(name: str, result: dict[str, Any]) -> str:
    """A machine's lines, for people."""
    before, after = (result[f"gap {k}, held back"] for k in ("before", "after"))
    lines = [
        f"{name}: {result['verdict']}, {result['CPU s']:.0f} s CPU; gap held back"
        f" {before:.3g} -> {after:.3g} noise levels",
        f"  {result['sentence']}",
    ]
    for law, by in result["laws"].items():
        for i, (found, published) in enumerate(zip(by["found"], by["published"], strict=True)):
            own = "" if by["least squares"] is None else f", ours {by['least squares'][i]:.4g}"
            lines.append(
                f"  {law} {i + 1}: found {found:.4g}, published {published:g}{own}"
                f" ({found / published - 1:+.0%})"
            )
    return "\n".join(lines)


def _rows(name: str, result: dict[str, Any]) -> list[list[Any]]:
    """A row for each joint and law that was published."""
    rows = []
    for law, by in result["laws"].items():
        own = by["least squares"] or [None] * len(by["found"])
        each = zip(by["found"], by["published"], own, strict=True)
        for joint, numbers in enumerate(each, 1):
            where = f"{law}, joint {joint}" if len(by["found"]) > 1 else law
            rows.append([f"{name}: {result['verdict']}", where, *numbers])
    return rows


def main() -> None:
    """Diagnose, print, and write JSON when asked."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="of the data")
    parser.add_argument("names", nargs="*", metavar="MACHINE", help=f"of {', '.join(MACHINES)}")
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    args = parser.parse_args()
    results = {}
    for name in args.names or MACHINES:
        results[name] = judged(name, args.folder)
        print(told(name, results[name]), flush=True)
    if args.json:
        columns = ["machine, verdict", "law", "found", "published", "least squares"]
        store(
            args.json, columns, [row for k, found in results.items() for row in _rows(k, found)]
        )


if __name__ == "__main__":
    main()
