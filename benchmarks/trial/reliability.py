"""How often a name is right: the curve through names whose truth is known.

    python -m benchmarks.trial.reliability names DIR >> benchmarks/trial/names.csv
    python -m benchmarks.trial.reliability fit

`names` prints a row for each name that was given, or withheld, in a folder of answered cases.
`fit` prints the constants of the diagnosis (`inference/reliability.py`), and how well such
constants do on cases left out, one after the other, and on whole sets. `names.csv` has those of
sets seven to twelve, each by the code of its day; `library` is the probability that a name has
among members of the library alone.
"""

import argparse
import csv
from pathlib import Path
from typing import Any

import numpy as np
import scipy

from benchmarks.trial.__main__ import answered
from benchmarks.trial.arm import Array
from benchmarks.trial.scoring import in_place
from benchmarks.trial.targets import calibration_error

COUNTED = Path(__file__).with_name("names.csv")
COLUMNS = ("set", "case", "right", "gain", "strain", "library")
NEEDED, USUAL = 35.0, 20.0  # gain and strain where the curve is centred
_RIDGE = 0.1  # of the constants: few names tell little

Names = dict[str, Array]


def names_of(out: Path, number: int) -> list[list[Any]]:
    """Return a row of `COLUMNS` for every name of a folder of answered cases.

    Args:
        out: the folder.
        number: of the set.
    """
    return [
        [number, label["index"], int(any(in_place(t, name) for t in label["effects"])),
         round(name["gain"], 1), round(name["strain"], 1),
         round(name["probability"] / name["reliability"], 4)]
        for label, given in answered(out)
        for name in (*given["names"], *given["withheld"])
    ]  # fmt: skip


def read_names(path: Path = COUNTED) -> Names:
    """Return each column (n,) of a file of names."""
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    return {k: np.array([row[k] for row in rows], float) for k in COLUMNS}


def _terms(names: Names) -> Array:
    """Terms (n, 3) of the log odds."""
    gain, strain = (np.log(np.maximum(names[k], 1.0)) for k in ("gain", "strain"))
    return np.column_stack([np.ones(len(gain)), gain - np.log(NEEDED), strain - np.log(USUAL)])


def constants(names: Names) -> Array:
    """Return (3,) log odds: usual, per e-fold of gain, per e-fold of strain."""
    X, right, library = _terms(names), names["right"], names["library"]

    def unlikely(b: Array) -> float:
        p = np.clip(library / (1 + np.exp(-X @ b)), 1e-6, 1 - 1e-6)
        each = right * np.log(p) + (1 - right) * np.log(1 - p)
        return float(-each.sum() + _RIDGE * (b[1:] @ b[1:]))

    return np.asarray(scipy.optimize.minimize(unlikely, np.zeros(3)).x, float)


def left_out(names: Names, sets: bool = False) -> Array:
    """Return (n,) reliabilities, each by constants from all other cases, or all other sets."""
    X = _terms(names)
    of, out = names["set"] if sets else names["set"] * 1e3 + names["case"], np.zeros(len(X))
    for k in np.unique(of):
        here = of == k
        b = constants({name: column[~here] for name, column in names.items()})
        out[here] = 1 / (1 + np.exp(-X[here] @ b))
    return out


def fit() -> None:
    """Print the constants, and how well they do on cases left out."""
    names = read_names()
    print("EVEN, GAIN, STRAIN =", ", ".join(f"{b:.2f}" for b in constants(names)))
    right, library = names["right"], names["library"]
    for what, p in (
        ("before", library),
        ("now, of cases left out", library * left_out(names)),
        ("now, of sets left out", library * left_out(names, True)),
    ):
        off, sure = calibration_error(p, right), right[p > 0.95]
        print(
            f"{what}: calibration error {off:.3f} of {len(p)} names,"
            f" of those above 0.95 {int(sure.sum())} of {len(sure)} right"
        )


def main() -> None:
    """See the module's docstring."""
    parser = argparse.ArgumentParser(usage=__doc__)
    commands = parser.add_subparsers(required=True, dest="what")
    command = commands.add_parser("names")
    command.add_argument("folder", type=Path)
    command.add_argument("--set", type=int, default=0, dest="number")
    commands.add_parser("fit")
    args = parser.parse_args()
    if args.what == "fit":
        fit()
    else:
        for row in names_of(args.folder, args.number):
            print(",".join(map(str, row)))


if __name__ == "__main__":
    main()
