"""Answers of `ves-gym diagnose` to the trial's cases, and how they compare with the truth."""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import tomli_w

from benchmarks.independent_trial.arm import GRAVITY

Truth = dict[str, Any]
Answer = dict[str, Any]

MARKS = ("right", "class", "partly", "wrong", "unknown", "silent", "alarm", "refused")
# what the package calls effects of `catalogue.LIBRARY`: the first is strict, all are its class
KINDS: dict[str, tuple[str, ...]] = {
    "Coulomb friction": ("joint/coulomb", "joint/friction", "joint/stribeck"),
    "viscous friction": ("joint/viscous", "joint/friction"),
    "Stribeck friction": ("joint/stribeck", "joint/coulomb", "joint/friction"),
    "direction-dependent friction": ("joint/asymmetry", "joint/coulomb", "joint/friction"),
    "load-dependent friction": ("joint/load_friction", "joint/coulomb", "joint/friction"),
    "joint elasticity": ("joint/elasticity", "joint/backlash"),
    "backlash": ("joint/backlash", "joint/elasticity"),
    "gear ripple": ("joint/ripple",),
    "rotor inertia": ("joint/rotor_inertia", "payload/body"),
    "drive gain": ("joint/drive_gain",),
    "torque limit": ("joint/torque_limit",),
    "command delay": ("command/delay", "joint/measurement_delay"),
    "measurement delay": ("joint/measurement_delay", "command/delay"),
    "payload mass": ("payload/mass", "payload/body", "payload/com"),
    "payload centre": ("payload/com", "payload/body", "payload/mass"),
    "sensor bias": ("sensor/bias", "gravity/tilt", "gravity/mass"),
    "sensor gain": ("sensor/calibration",),
    "sensor rotation": ("sensor/rotation", "sensor/calibration"),
    "sensor drift": ("sensor/drift", "sensor/bias"),
    "sensor lag": ("sensor/lag",),
    "platform delay": ("platform/delay", "platform/bandwidth"),
    "platform bandwidth": ("platform/bandwidth", "platform/delay"),
    "platform rate limit": ("platform/stroke",),
    "virtual mass": ("base/virtual_mass",),
    "gravity leak": ("gravity/tilt", "sensor/bias", "gravity/mass"),
    "base stiffness": ("base/stiffness",),
    "extra mode": ("base/extra_mode",),
    "base damping": ("base/damping", "base/amplitude_damping"),
    "amplitude-dependent damping": ("base/amplitude_damping", "base/damping"),
}
# stated in case.toml -> tolerances of the package, by pattern
TOLERANCES = {
    "link masses and inertias": (
        "mass of link *",
        "mass of the arm's foot",
        "inertia of link *",
    ),
    "base stiffness": ("stiffness of the base at *",),
    "base damping": ("damping of the base at *",),
    "drive gain": ("gain of joint *",),
    "platform bandwidth": ("platform bandwidth",),
    "sensor gain": ("gain of [FM]_?",),
}
LABORATORY = ("platform bandwidth", "sensor gain")  # there alone
UNLISTED = 0.1  # of usual errors: README.md lists all that deviates


def tolerances(case: dict[str, Any], emulated: bool, weight: float) -> dict[str, Any]:
    """What `--tolerances` says of a case: errors of the description as they are stated.

    All of it is in `case.toml` and README.md. Noise differs by channel and is stated in the
    logs' metadata.

    Args:
        case: `case.toml`.
        emulated: whether it is the laboratory's, whose sensor reads the weight with an error of
            its gain and cross-talk, for it is not zeroed under the arm.
        weight: of the arm [N].
    """
    stated = {k: v["sigma"] for k, v in case["tolerance"].items()}
    known = {
        pattern: stated[name]
        for name, patterns in TOLERANCES.items()
        if emulated or name not in LABORATORY
        for pattern in patterns
    }
    if emulated:
        known["zero of [FM]_?"] = weight * stated["sensor gain"]
    clocks = {
        "offset": stated["time between recorders"],
        "rate": stated["clock rate"],
        "jitter": stated["jitter of sampling"],
    }
    return {"schema": "ves-tolerances/1", "scale": UNLISTED, "known": known, "clocks": clocks}


def answer(folder: Path, out: Path) -> Answer:
    """Run `ves-gym diagnose` on a case; return verdict, names and processor time.

    Args:
        folder: of the case, as `write.write_case` leaves it.
        out: gets copies of the logs with what is stated, and the diagnosis.
    """
    case = tomllib.loads((folder / "case.toml").read_text("utf-8"))
    logs = out / "logs"
    logs.mkdir(parents=True, exist_ok=True)
    noise = {k: v for k, v in case["noise"].items() if k not in ("about", "wg")}
    for name in (*case["runs"], case["held_back"]):
        (logs / name).write_bytes((folder / name).read_bytes())
        meta = json.loads((folder / name).with_suffix(".json").read_text("utf-8"))
        meta |= {"noise_std": noise, "held_back": name == case["held_back"]}
        (logs / name).with_suffix(".json").write_text(json.dumps(meta), "utf-8")
    arm = tomllib.loads((folder / "system.toml").read_text("utf-8"))["arm"]
    masses = (arm["base"]["mass"], *(link["inertial"]["mass"] for link in arm["links"]))
    stated = tolerances(case, "wg" in case["noise"], GRAVITY * sum(masses))
    (out / "tolerances.toml").write_text(tomli_w.dumps(stated), "utf-8")
    before = os.times().children_user
    done = subprocess.run(
        [
            *(sys.executable, "-m", "ves_gym.cli.main", "diagnose"),
            *(str(logs / name) for name in (*case["runs"], case["held_back"])),
            *("--system", str(folder / "system.toml")),
            *("--tolerances", str(out / "tolerances.toml")),
            *("--no-figures", "--no-free-run", "--no-experiment"),
            *("--json", str(out / "answer.json"), "--out", str(out)),
        ],
        capture_output=True,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    cpu = os.times().children_user - before
    if not (out / "answer.json").exists():
        return {"verdict": "refused", "names": [], "cpu": cpu, "error": done.stderr[-400:]}
    found = json.loads((out / "answer.json").read_text("utf-8"))
    names = [{k: name[k] for k in ("kind", "slot", "probability")} for name in found["effects"]]
    return {"verdict": found["verdict"], "names": names, "cpu": cpu}


def judge(truth: Truth, given: Answer) -> str:
    """Return right, class, partly, wrong, unknown, silent, alarm or refused.

    A null is silent, or it is an alarm. Of what has no name, unknown is right. Of a single, its
    kind alone and, at a joint, in its place; `class` is a kind that hardly differs. Of a pair,
    both; `partly` one of them and no other. Of a mode, any name of the base.
    """
    names, verdict = given["names"], given["verdict"]
    if verdict == "refused":
        return "refused"
    quiet = verdict in ("nothing missing", "excitation too weak") and not names
    if truth["kind"] == "null":
        return "silent" if quiet else "alarm"
    if quiet or not names:
        told = "silent" if quiet else "unknown"
        return "right" if truth["kind"] == "outside" and told == "unknown" else told
    if truth["kind"] == "outside":
        return "wrong"
    if truth["kind"] == "mode":
        base = all(name["kind"].startswith("base/") for name in names)
        return "right" if base else "wrong"
    strict = [[_is(effect, name, 1) for name in names] for effect in truth["effects"]]
    alike = [[_is(effect, name, None) for name in names] for effect in truth["effects"]]
    strays = any(not any(row[i] for row in alike) for i in range(len(names)))
    hits = [any(row) for row in strict]
    if all(hits) and len(names) == len(hits):
        return "right"
    if all(any(row) for row in alike) and not strays:
        return "class"
    return "partly" if any(hits) and not strays else "wrong"


def _is(effect: dict[str, Any], name: dict[str, Any], most: int | None) -> bool:
    """Return True if a name is an effect's kind, one of the first `most`, in its place."""
    if name["kind"] not in KINDS[effect["name"]][:most]:
        return False
    at_joint = name["kind"].startswith("joint/") and name["slot"].startswith("joint ")
    one_place = effect["name"] not in ("command delay", "measurement delay")
    return not (at_joint and one_place) or name["slot"] == f"joint {effect['place']}"


def counts(judged: list[tuple[Truth, Answer]]) -> list[list[str]]:
    """Return judgements by machine, kind of case and size: a case, and how many of `MARKS`."""
    rows: dict[tuple[str, str, float], list[str]] = {}
    for truth, given in judged:
        size = truth["multiple"] or truth["tolerance_factor"]
        rows.setdefault((_where(truth), truth["kind"], size), []).append(judge(truth, given))
    return [
        [f"{where}: {kind} {size:g}", *(str(told.count(mark)) for mark in MARKS)]
        for (where, kind, size), told in sorted(rows.items())
    ]


def _where(truth: Truth) -> str:
    return "laboratory" if truth["system"].endswith("emulated") else "space"


def table(judged: list[tuple[Truth, Answer]]) -> str:
    """Return `counts` as Markdown.

    Below: of space and laboratory, how many names that are more than 95 % sure are true, and
    the processor time.
    """
    lines = [f"| case | {' | '.join(MARKS)} |", "|---" * (len(MARKS) + 1) + "|"]
    lines += [f"| {' | '.join(row)} |" for row in counts(judged)]
    parts: dict[str, list[tuple[Truth, Answer]]] = {}
    for truth, given in judged:
        parts.setdefault(_where(truth), []).append((truth, given))
    for where, part in sorted(parts.items()):
        sure = [
            _is_true(truth, name)
            for truth, given in part
            for name in given["names"]
            if name["probability"] > 0.95
        ]
        cpu = statistics.median(given["cpu"] for _, given in part)
        lines += [
            "",
            f"{where}: {sum(sure)} of {len(sure)} names with p > 0.95 are true; processor time,"
            f" median: {cpu:.0f} s",
        ]
    return "\n".join(lines)


def _is_true(truth: Truth, name: dict[str, Any]) -> bool:
    """Return True if a name is one of the effects, in its place; of a mode, if of the base."""
    if truth["kind"] == "mode":
        return str(name["kind"]).startswith("base/")
    return any(_is(effect, name, 1) for effect in truth["effects"] if effect["name"] in KINDS)
