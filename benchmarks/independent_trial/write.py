"""Cases on disk: logs and description for the one who judges, truth apart, hashes of both."""

from __future__ import annotations

import hashlib
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from benchmarks.independent_trial import cases, measurement, motions
from benchmarks.independent_trial.cases import Case, Made
from benchmarks.independent_trial.catalogue import LIBRARY
from benchmarks.independent_trial.machine import PERIOD

ORDER = ("q_cmd", "v_cmd", "q", "v", "tau", "y", "y_cmd", "yd", "w", "wg")
NAMES = ("run1", "run2", "run3", "held_back")


def write(folder: Path, named: dict[str, Case]) -> None:
    """DIR/cases/NAME/..., DIR/truth/NAME.json, DIR/truth/hashes.txt."""
    for name, case in named.items():
        began = time.process_time()
        made = cases.make(case)
        write_case(folder / "cases" / name, made)
        truth = folder / "truth" / f"{name}.json"
        truth.parent.mkdir(parents=True, exist_ok=True)
        truth.write_text(json.dumps(what_is_true(made), indent=1, default=plain) + "\n")
        print(f"{name}  {time.process_time() - began:.1f} s of processor", flush=True)
    (folder / "truth" / "hashes.txt").write_text(hashes(folder))


def write_case(folder: Path, made: Made) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    system = made.case.system
    text = (cases.SYSTEMS / f"{system}.toml").read_text()
    (folder / "system.toml").write_text(text)
    (folder / "case.toml").write_text(tomli_w.dumps(stated(made)))
    kp, kd = cases.GAINS[system[:4]]
    for name, log in zip(NAMES, made.logs, strict=True):
        rows, run = log["rows"], log["run"]
        write_csv(folder / f"{name}.csv", run.t, rows)
        meta = {
            "format": "ves-run/1",
            "system": cases.description(system),
            "controller": {"kp": kp, "kd": kd, "feedforward": True},
            "initial": {
                "q": list(rows["q_cmd"][0]), "v": [0.0] * len(kp),
                "y": [0.0] * 6, "yd": [0.0] * 6,
            },
            "duration": run.motion.duration,
            "note": "independent trial; case.toml says what is known",
        }  # fmt: skip
        (folder / f"{name}.json").write_text(json.dumps(meta) + "\n")


def write_csv(path: Path, t: np.ndarray, rows: dict[str, np.ndarray]) -> None:
    names, columns = ["t"], [t[:, None]]
    for key in ORDER:
        if key in rows:
            names += [f"{key}_{i + 1}" for i in range(rows[key].shape[1])]
            columns.append(rows[key])
    np.savetxt(
        path, np.hstack(columns), fmt="%.9g", delimiter=",", header=",".join(names), comments=""
    )


def stated(made: Made) -> dict[str, Any]:
    """What the one who judges may know, in words and numbers."""
    run = made.logs[0]["run"]
    n = run.tau.shape[1]
    channels = [k for k in made.logs[0]["rows"] if k not in ("q_cmd", "v_cmd", "y_cmd")]
    width = {k: made.logs[0]["rows"][k].shape[1] for k in channels}
    return {
        "about": "Three runs of one machine, and held_back.csv for the last check. system.toml "
        "describes the machine as stated; it may or may not be all that there is. Tolerances "
        "are one standard deviation; if they are true, nothing is further off than 2.5.",
        "runs": [f"{k}.csv" for k in NAMES[:3]],
        "held_back": "held_back.csv",
        "rest": f"the command stands still for the first {motions.REST} s of each run",
        "period": PERIOD,
        "noise": {
            "about": "one standard deviation of each column (SI units): 0.8 of it white, 0.5 "
            "drifting with a time constant of 2 s, 0.33 a line between 8 and 36 Hz. "
            + ("The noise of w is in the loop. " if run.emulated else ""),
            **{k: measurement.sigma(k, width[k], n).tolist() for k in channels},
        },
        "resolution": {k: v for k, v in measurement.STEP.items() if k in channels},
        "dropouts": "2 in 1000 rows of y and yd repeat the row before",
        "tolerance": {
            k: {"sigma": s, "of": of} for k, (s, of) in measurement.TOLERANCES.items()
        },
        "clocks": "robot (q, v, tau), tracker (y, yd)"
        + (", the loop itself (w, wg, y_cmd)" if run.emulated else " and amplifier (w)")
        + " are not in step: see tolerance",
    }


def what_is_true(made: Made) -> dict[str, Any]:
    case = made.case
    return {
        "kind": case.kind,
        "system": case.system,
        "tolerance_factor": case.tolerance,
        "multiple": case.multiple,
        "seed": case.seed,
        "effects": [
            {
                "name": e.kind,
                "library": library_number(e.kind),
                "place": e.where + 1,
                "size": s,
                "unit": e.unit,
                "law": type(e).__name__,
                "numbers": e.law,
            }
            for e, s in zip(made.effects, made.sizes, strict=True)
        ],
        "reached": not made.gaps
        or case.kind in ("pair", "mode")
        or abs(max(made.gaps[0].values()) / case.multiple - 1) < 0.1,
        "gaps_run1": made.gaps[0] if made.gaps else {},
        "gaps_held_back": made.gaps[1] if made.gaps else {},
    }


def library_number(name: str) -> int | None:
    if name.startswith("base mode"):
        return 25
    return LIBRARY[name][2] if name in LIBRARY else None


def plain(x: Any) -> Any:
    if isinstance(x, np.ndarray | np.generic):
        return x.tolist()
    return getattr(x, "__name__", None) or str(x)


def hashes(folder: Path) -> str:
    """SHA-256 of every file, truth included: published first, the truth later."""
    files = sorted(p for p in folder.rglob("*") if p.is_file() and p.name != "hashes.txt")
    digest = lambda p: hashlib.sha256(p.read_bytes()).hexdigest()  # noqa: E731
    return "".join(f"{digest(p)}  {p.relative_to(folder).as_posix()}\n" for p in files)
