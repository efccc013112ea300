"""Answers by `ves-gym diagnose`, and how they compare with the labels."""

import json
import os
import subprocess
import sys
import time
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


def answer(folder: Path, out: Path) -> dict[str, Any]:
    """Run `ves-gym diagnose` on a case's folder and return verdict, names and seconds."""
    program = str(Path(sys.executable).with_name("ves-gym"))
    logs = [str(path) for path in sorted(folder.glob("run-*.csv"))]
    options = ["--system", str(folder / "system.toml"), "--json", str(out / "answer.json")]
    if (folder / "tolerances.toml").exists():
        options += ["--tolerances", str(folder / "tolerances.toml")]
    options += ["--no-figures", "--no-free-run", "--out", str(out)]
    out.mkdir(parents=True, exist_ok=True)
    began = time.monotonic()
    cpu = os.times()
    done = subprocess.run(
        [program, "diagnose", *logs, *options],
        capture_output=True,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    after = os.times()
    seconds = {
        "wall": time.monotonic() - began,
        "cpu": after.children_user - cpu.children_user,
    }
    if done.returncode == 2 or not (out / "answer.json").exists():  # refused, or broke down
        return {"verdict": "refused", "error": done.stderr.strip()[-400:], "seconds": seconds}
    result = json.loads((out / "answer.json").read_text("utf-8"))
    names = [
        {
            "kind": effect["kind"],
            "slot": effect.get("slot"),
            "probability": effect["probability"],
            "class": effect["class"],
        }
        for effect in result["effects"]
    ]
    closest = [effect["name"] for effect in result.get("closest") or []]
    return {
        "verdict": result["verdict"],
        "names": names,
        "closest": closest,
        "worse": result["worse"],
        "held_back": [result["final_before"], result["final_after"]],
        "seconds": seconds,
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
    rivals = [r.partition(" at ") for r in name.get("class", ())]
    members = [{"kind": kind, "slot": slot} for kind, _, slot in rivals]
    return len(members) <= RIVALS and any(in_place(truth, m) for m in members)


def judge(label: Label, given: dict[str, Any]) -> str:
    """Return right, class, partly, wrong, unknown, silent or refused.

    Of a null, silence is right. Of a case outside the library "not in the library" is. Of a
    single, its kind alone in its place; `class` is a kind that hardly differs, or one of its
    rivals ("one of"). Of a pair, both; `partly` one of them and no wrong one.
    """
    verdict, names = given["verdict"], given.get("names") or []
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


def table(labels: list[Label], answers: dict[int, dict[str, Any]]) -> str:
    """Return the counts by category, gap and mode as Markdown."""
    marks = ("right", "class", "partly", "wrong", "unknown", "silent", "refused")
    rows: dict[tuple[str, str, str], dict[str, int]] = defaultdict(
        lambda: dict.fromkeys(marks, 0)
    )
    for label in labels:
        given = answers.get(label["index"])
        if given is not None:
            size = f"{label['gap']:g}" if label["gap"] else "-"
            rows[label["category"], size, label["mode"]][judge(label, given)] += 1
    lines = ["| category | gap | mode | " + " | ".join(marks) + " |", "|---" * 10 + "|"]
    for key in sorted(rows):
        lines.append(
            f"| {' | '.join(key)} | " + " | ".join(str(rows[key][m]) for m in marks) + " |"
        )
    times = sorted(a["seconds"]["cpu"] for a in answers.values())
    if times:
        lines.append(f"\nmedian {times[len(times) // 2]:.0f} s of processor time per case")
    return "\n".join(lines)
