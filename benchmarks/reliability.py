"""How often a name is right: names given where the truth is known, and the curve through them.

    python -m benchmarks.trial2 write DIR --cases 0:30
    python -m benchmarks.reliability count DIR names.jsonl
    python -m benchmarks.reliability fit names.jsonl

`count` diagnoses every case of a set twice, a minute each: as it is, and with the true kinds
left out of the library, where every name is wrong. It adds a line per name to the file; cases
that have one are left alone. `fit` prints the constants of the diagnosis
(`inference/reliability.py`), and how well such constants do on cases left out, one after the
other. The names that those are from are in docs/diagnosis-reliability.jsonl.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
import scipy

from benchmarks.trial2.scoring import SIBLINGS, in_place
from ves_gym._util.params import Array
from ves_gym.diagnosis.diagnose import NAMING_VERDICTS, WEAK, diagnose
from ves_gym.diagnosis.inference.reliability import NEEDED, USUAL
from ves_gym.diagnosis.inputs import system_inputs
from ves_gym.diagnosis.machines.tolerances import StatedErrors
from ves_gym.system.system import System

HIDDEN = 0.25  # weight of a name that was given where the true kinds were left out
_RIDGE = 0.1  # of the constants: few names tell little


def names_of(folder: Path, label: dict[str, Any], hidden: bool) -> list[dict[str, Any]]:
    """Diagnose a case; what each of its names gains, and whether it is right.

    Args:
        folder: logs and description.
        label: the truth.
        hidden: leave the true kinds, and those that hardly differ, out of the library.
    """
    logs = [str(path) for path in sorted(folder.glob("run-*.csv"))]
    stated = (folder / "tolerances.toml").exists()
    inputs = system_inputs(
        logs,
        System.load(folder / "system.toml"),
        stated=StatedErrors(scale=label["factor"]) if stated else None,
    )
    kinds = {effect["kind"] for effect in label["effects"]}
    gone = kinds.union(*(group for group in SIBLINGS if group & kinds)) if hidden else set()
    found = diagnose(
        inputs.machine,
        inputs.runs,
        inputs.final,
        candidates=[c for c in inputs.candidates if c.kind not in gone],
    )
    if found.verdict not in (*NAMING_VERDICTS, WEAK) and not found.withheld:
        return []
    return [
        {
            "case": label["index"],
            "hidden": hidden,
            "name": f.candidate.name,
            "right": any(
                in_place(t, {"kind": f.candidate.kind, "slot": f.candidate.slot})
                for t in label["effects"]
            ),
            "gain": round(f.gain, 1),
            "error": round(f.error, 2),
            "library": round(f.probability / f.reliability, 4),
        }
        for f in (*found.explanations, *found.withheld)
    ]


def count(folder: Path, out: Path) -> None:
    """Add a line per name to a file; a case without any has a line of its own."""
    lines = out.read_text("utf-8").splitlines() if out.exists() else []
    done = {(k["case"], k["hidden"]) for k in map(json.loads, lines)}
    for path in sorted((folder / "labels").glob("*.json")):
        label = json.loads(path.read_text("utf-8"))
        for hidden in (False, True):
            if (label["index"], hidden) in done or hidden > (
                label["category"] in ("single", "pair")
            ):
                continue
            found = names_of(folder / "cases" / path.stem, label, hidden)
            found = found or [{"case": label["index"], "hidden": hidden}]
            with out.open("a", encoding="utf-8") as file:
                file.writelines(json.dumps(name) + "\n" for name in found)
            told = ", ".join(f"{n['name']} {n['gain']:g}" for n in found if "name" in n)
            print(f"case {path.stem}{' hidden' * hidden}: {told or 'no name'}", flush=True)


def constants(names: list[dict[str, Any]]) -> Array:
    """Return (3,) log odds: even, per e-fold of gain, per deviation of the largest error.

    Args:
        names: of `count`.
    """
    X, right, library, weight = _columns(names)

    def unlikely(b: Array) -> float:
        p = np.clip(library / (1 + np.exp(-X @ b)), 1e-6, 1 - 1e-6)
        each = right * np.log(p) + (1 - right) * np.log(1 - p)
        return float(-weight @ each + _RIDGE * (b[1:] @ b[1:]))

    return np.asarray(scipy.optimize.minimize(unlikely, np.zeros(3)).x, float)


def _columns(names: list[dict[str, Any]]) -> tuple[Array, Array, Array, Array]:
    """Terms (n, 3), right (n,), share of the library (n,), weight (n,) of names."""
    gain, error = (np.array([n[k] for n in names], float) for k in ("gain", "error"))
    terms = [np.ones(len(names)), np.log(np.maximum(gain, 1.0) / NEEDED), error - USUAL]
    weight = np.where([n["hidden"] for n in names], HIDDEN, 1.0)
    right = np.array([n["right"] for n in names], float)
    return np.column_stack(terms), right, np.array([n["library"] for n in names]), weight


def left_out(names: list[dict[str, Any]]) -> Array:
    """Return (n,) probabilities of names, each by constants from all other cases."""
    out = np.zeros(len(names))
    X, _, library, _ = _columns(names)
    case = np.array([n["case"] for n in names])
    for k in np.unique(case):
        b = constants([n for n in names if n["case"] != k])
        here = case == k
        out[here] = library[here] / (1 + np.exp(-X[here] @ b))
    return out


def calibration_error(p: Array, right: Array) -> float:
    """Return the mean distance of probability and share of the right, over ten ranges.

    Args:
        p: (n,) probabilities.
        right: (n,) 1 where the name is right, else 0.
    """
    at = np.minimum((10 * p).astype(int), 9)
    return float(sum(abs((p - right)[at == k].sum()) for k in range(10)) / len(p))


def read_names(path: Path) -> list[dict[str, Any]]:
    """Names of a file of `count`."""
    lines = map(json.loads, path.read_text("utf-8").splitlines())
    return [line for line in lines if "name" in line]


def fit(path: Path) -> None:
    """Print the constants, and how well they do on cases left out."""
    names = read_names(path)
    print("EVEN, GAIN, STRETCH =", ", ".join(f"{b:.2f}" for b in constants(names)))
    usual = np.array([not n["hidden"] for n in names])
    right = np.array([n["right"] for n in names], float)
    library = np.array([n["library"] for n in names], float)
    for what, p in (("before", library), ("now, of cases left out", left_out(names))):
        off, sure = calibration_error(p[usual], right[usual]), right[usual & (p > 0.95)]
        print(
            f"{what}: calibration error {off:.3f} of {usual.sum()} names,"
            f" of those above 0.95 {int(sure.sum())} of {len(sure)} right"
        )


def main() -> None:
    """See the module's docstring."""
    parser = argparse.ArgumentParser(usage=__doc__)
    commands = parser.add_subparsers(required=True, dest="what")
    command = commands.add_parser("count")
    command.add_argument("folder", type=Path)
    command.add_argument("out", type=Path)
    commands.add_parser("fit").add_argument("out", type=Path)
    args = parser.parse_args()
    if args.what == "count":
        count(args.folder, args.out)
    else:
        fit(args.out)


if __name__ == "__main__":
    main()
