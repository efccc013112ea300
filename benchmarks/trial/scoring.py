"""Answers by `ves-gym diagnose`, and how they compare with the labels."""

import json
import os
import subprocess
import sys
from collections import defaultdict
from pathlib import Path
from typing import Any

Label = dict[str, Any]

SIBLINGS = (
    {"joint/coulomb", "joint/stribeck", "joint/load_friction"},
    {"sensor/bias", "gravity/mass", "gravity/tilt", "gravity/scale"},
    {"payload/mass", "payload/com", "joint/rotor_inertia"},
    {"command/delay", "joint/measurement_delay"},
)
"""Kinds that hardly differ on short runs: a class, for the second score of singles.

So are the rivals of an answer ("one of {sensor/bias, sensor/rotation}"), at most `RIVALS`.
"""
RIVALS = 3


KEPT = ("kind", "slot", "value", "interval", "gain", "probability", "class")
"""What an answer keeps of a name; intervals are of 90 %."""


def answer(folder: Path, out: Path) -> dict[str, Any]:
    """Run `ves-gym diagnose` on a case's folder; return what it says.

    Args:
        folder: of the case, as `write.write_case` leaves it.
        out: gets the diagnosis.

    Returns:
        Verdict; names with what is `KEPT`; `closest`, the best that the
        library can do where there is no name; channels of the run held back that are `worse`;
        `gap`: RMS over noise of each of them before and after; `cpu`: seconds.
    """
    out.mkdir(parents=True, exist_ok=True)
    path, before = out / "answer.json", os.times()
    done = subprocess.run(
        [
            *(sys.executable, "-m", "ves_gym.cli.main", "diagnose"),
            *map(str, sorted(folder.glob("run-*.csv"))),
            *("--system", str(folder / "system.toml")),
            *("--tolerances", str(folder / "tolerances.toml")),
            *("--no-figures", "--no-free-run", "--no-experiment"),
            *("--json", str(path), "--out", str(out)),
        ],
        capture_output=True,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    after = os.times()
    cpu = after.children_user - before.children_user
    if done.returncode == 2 or not path.exists():  # refused, or broke down
        error = done.stderr.strip()[-400:]
        said = {"verdict": "refused", "error": error, "cpu": cpu, "gap": {}}
        return {**said, **{k: [] for k in ("names", "closest", "worse")}}
    found = json.loads(path.read_text("utf-8"))
    last = found["final_after"]
    return {
        "verdict": found["verdict"],
        "names": [{k: name[k] for k in KEPT} for name in found["effects"]],
        "closest": [name["name"] for name in found["closest"]],
        "worse": found["worse"],
        "gap": {k: [gap, last[k]] for k, gap in found["final_before"].items()},
        "cpu": cpu,
    }


def in_place(truth: dict[str, Any], name: dict[str, Any]) -> bool:
    """Return True if a name has the truth's kind and, if it sits at a joint, the joint."""
    if truth["kind"] != name["kind"]:
        return False
    if not truth["kind"].startswith("joint/") or truth["slot"] is None:
        return True
    return str(name["slot"]).endswith(f"joint {truth['slot']}")


def _alike(truth: dict[str, Any], name: dict[str, Any]) -> bool:
    """Return True if a name is of the truth's class, or the answer says that it may be it."""
    pair = {truth["kind"], name["kind"]}
    if len(pair) == 1 or any(pair <= group for group in SIBLINGS):
        return True
    rivals = [r.partition(" at ") for r in name["class"]]
    members = [{"kind": kind, "slot": slot} for kind, _, slot in rivals]
    return len(members) <= RIVALS and any(in_place(truth, m) for m in members)


def judge(label: Label, given: dict[str, Any]) -> str:
    """Return right, class, partly, wrong, unknown, silent or refused.

    Of a null, silence is right. Of a case outside the library "not in the library" is. Of a
    single, its kind alone in its place; `class` is a kind that hardly differs, or one of its
    rivals ("one of"). Of a pair, both; `partly` one of them and no wrong one.
    """
    verdict, names = given["verdict"], given["names"]
    if verdict == "refused":
        return "refused"
    if not names:
        quiet = verdict in ("nothing missing", "excitation too weak")
        if label["category"] == "null":
            return "right" if quiet else "unknown"
        if label["category"] == "outside" and verdict == "not in the library":
            return "right"
        return "silent" if quiet else "unknown"
    truths = label["effects"]
    if label["category"] in ("null", "outside"):
        return "wrong"
    hits = [any(in_place(t, n) for n in names) for t in truths]
    strays = [n for n in names if not any(in_place(t, n) for t in truths)]
    if all(hits) and not strays:
        return "right"
    if label["category"] == "pair" and any(hits) and not strays:
        return "partly"
    if all(any(_alike(t, n) for t in truths) for n in strays) and strays:
        return "class"
    return "wrong"


def table(cases: list[tuple[Label, dict[str, Any]]]) -> str:
    """Return the counts by category, gap and mode as Markdown."""
    marks = ("right", "class", "partly", "wrong", "unknown", "silent", "refused")
    rows: dict[tuple[str, str, str], dict[str, int]] = defaultdict(
        lambda: dict.fromkeys(marks, 0)
    )
    for label, given in cases:
        size = f"{label['gap']:g}" if label["gap"] else "-"
        rows[label["category"], size, label["mode"]][judge(label, given)] += 1
    lines = ["| category | gap | mode | " + " | ".join(marks) + " |", "|---" * 10 + "|"]
    for key in sorted(rows):
        counts = " | ".join(str(rows[key][m]) for m in marks)
        lines.append(f"| {' | '.join(key)} | {counts} |")
    return "\n".join(lines)
