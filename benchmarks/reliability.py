"""How often a name is right: names given where the truth is known, and the curve through them.

    python -m benchmarks.trial2 write DIR --cases 0:30
    python -m benchmarks.reliability count DIR names.jsonl
    python -m benchmarks.reliability fit names.jsonl

`count` diagnoses every case of a set, a minute each, and adds a line per name to the file;
cases that have one are left alone. `fit` prints the constants of the diagnosis
(`inference/reliability.py`), and how well such constants do on cases left out, one after the
other, and on whole sets. The names that those are from are in docs/diagnosis-reliability.jsonl:
of the seventh to twelfth set of trial 2, by the code sealed with each.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
import scipy

from benchmarks.trial2.scoring import in_place
from ves_gym._util.params import Array, from_plain, read_table
from ves_gym.diagnosis.diagnose import NAMING_VERDICTS, WEAK, diagnose
from ves_gym.diagnosis.inference.reliability import NEEDED, USUAL
from ves_gym.diagnosis.inputs import system_inputs
from ves_gym.diagnosis.machines.tolerances import StatedErrors
from ves_gym.system.system import System

_RIDGE = 0.1  # of the constants: few names tell little


def names_of(folder: Path, label: dict[str, Any]) -> list[dict[str, Any]]:
    """Diagnose a case; what each of its names gains, and whether it is right.

    Args:
        folder: logs and description.
        label: the truth.
    """
    logs = [str(path) for path in sorted(folder.glob("run-*.csv"))]
    errors = folder / "tolerances.toml"
    inputs = system_inputs(
        logs,
        System.load(folder / "system.toml"),
        stated=from_plain(StatedErrors, read_table(errors), str(errors)),
    )
    found = diagnose(inputs.machine, inputs.runs, inputs.final, candidates=inputs.candidates)
    if found.verdict not in (*NAMING_VERDICTS, WEAK) and not found.withheld:
        return []
    return [
        {
            "case": f"{folder.parent.parent.name}/{folder.name}",
            "name": f.candidate.name,
            "right": any(
                in_place(t, {"kind": f.candidate.kind, "slot": f.candidate.slot})
                for t in label["effects"]
            ),
            "gain": round(f.gain, 1),
            "strain": round(f.strain, 1),
            "library": round(f.probability / f.reliability, 4),
        }
        for f in (*found.explanations, *found.withheld)
    ]


def count(folder: Path, out: Path) -> None:
    """Add a line per name to a file; a case without any has a line of its own."""
    lines = out.read_text("utf-8").splitlines() if out.exists() else []
    done = {json.loads(line)["case"] for line in lines}
    for path in sorted((folder / "labels").glob("*.json")):
        case = f"{folder.name}/{path.stem}"
        if case in done:
            continue
        label = json.loads(path.read_text("utf-8"))
        found = names_of(folder / "cases" / path.stem, label) or [{"case": case}]
        with out.open("a", encoding="utf-8") as file:
            file.writelines(json.dumps(name) + "\n" for name in found)
        told = ", ".join(f"{n['name']} {n['gain']:g}" for n in found if "name" in n)
        print(f"case {path.stem}: {told or 'no name'}", flush=True)


def constants(names: list[dict[str, Any]]) -> Array:
    """Return (3,) log odds: usual, per e-fold of gain, per e-fold of strain.

    Args:
        names: of `count`.
    """
    X, right, library = _columns(names)

    def unlikely(b: Array) -> float:
        p = np.clip(library / (1 + np.exp(-X @ b)), 1e-6, 1 - 1e-6)
        each = right * np.log(p) + (1 - right) * np.log(1 - p)
        return float(-each.sum() + _RIDGE * (b[1:] @ b[1:]))

    return np.asarray(scipy.optimize.minimize(unlikely, np.zeros(3)).x, float)


def _columns(names: list[dict[str, Any]]) -> tuple[Array, Array, Array]:
    """Terms (n, 3), right (n,), share of the library (n,) of names."""
    gain, strain, right, library = (
        np.array([n[k] for n in names], float) for k in ("gain", "strain", "right", "library")
    )
    terms = [
        np.ones(len(names)),
        np.log(np.maximum(gain, 1.0) / NEEDED),
        np.log(np.maximum(strain, 1.0) / USUAL),
    ]
    return np.column_stack(terms), right, library


def left_out(names: list[dict[str, Any]], sets: bool = False) -> Array:
    """Return (n,) reliabilities of names, each by constants from all other cases.

    Args:
        names: of `count`.
        sets: by constants from all other sets.
    """
    out = np.zeros(len(names))
    X = _columns(names)[0]
    of = np.array([n["case"].split("/")[0] if sets else n["case"] for n in names])
    for k in np.unique(of):
        here = of == k
        b = constants([n for n, mine in zip(names, here, strict=True) if not mine])
        out[here] = 1 / (1 + np.exp(-X[here] @ b))
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
    print("EVEN, GAIN, STRAIN =", ", ".join(f"{b:.2f}" for b in constants(names)))
    right, library = (np.array([n[k] for n in names], float) for k in ("right", "library"))
    for what, p in (
        ("before", library),
        ("now, of cases left out", library * left_out(names)),
        ("now, of sets left out", library * left_out(names, True)),
    ):
        off, sure = calibration_error(p, right), right[p > 0.95]
        print(
            f"{what}: calibration error {off:.3f} of {len(names)} names,"
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
