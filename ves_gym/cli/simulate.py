"""`ves-gym simulate`: one motion on one system, recorded as a run log."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import ves_gym.api as vg
from ves_gym._util.params import Array, ParameterError, from_plain, read_table
from ves_gym.cli.flags import (
    DURATION,
    FORMAT,
    GOAL,
    START,
    Answer,
    Context,
    Flag,
    Place,
    floats,
    grouped,
    integer,
    joints,
    number,
    pose,
    read,
    say,
)
from ves_gym.cli.machine import MACHINE
from ves_gym.mechanics.limits import require_positions, usual_goal
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.servo import FREE, HIGH_GAINS, OWN_SERVO, PPED_GAINS, JointServo
from ves_gym.planners.case import Case
from ves_gym.report.machine_figures import run_figure
from ves_gym.simulation import calibration_poses, learn_gravity, weigh_poses
from ves_gym.simulation.run_summary import summarise
from ves_gym.system.energy import TAIL

NAMED = {"own": OWN_SERVO, "high": HIGH_GAINS, "pped": PPED_GAINS, "free": FREE}


def _gains(text: str, place: Place) -> JointServo:
    """Read --gains: a name, or kp/kd."""
    assert place.arm is not None
    n = place.arm.n
    if text == "free":
        zero = (0.0,) * n
        return JointServo(kp=zero, kd=zero, feedforward=False, source=FREE.source)
    if text in NAMED:
        return NAMED[text]
    try:
        kp, kd = (tuple(floats(part)) for part in text.split("/"))
    except ValueError:
        kp = kd = ()
    if {len(kp), len(kd)} - {1, n}:
        raise ParameterError(
            f"--gains must be {', '.join(NAMED)}, or kp/kd with 1 or {n} numbers each, like"
            f" 100/10, got {text!r}"
        )
    return JointServo(kp=kp * (n // len(kp)), kd=kd * (n // len(kd)))


GAINS = Flag("--gains", "G", _gains,
             f"{', '.join(NAMED)}, or kp/kd like 3000,2000,1000/50,40,30 (default own: the"
             " arm's, fed forward on the base as it will move; others as if it stood still)"
             )  # fmt: skip


def simulate(
    at: Context,
    *,
    start: Array | None = None,
    goal: Array | None = None,
    via: tuple[Array, ...] = (),
    duration: float | None = None,
    settle: float = TAIL,
    disturb: Array | None = None,
    gains: JointServo | None = None,
    no_feedforward: bool = False,
    record_dt: float | None = None,
    grasp: tuple[float, ...] = (),
    release: tuple[float, ...] = (),
    log: str | None = None,
    platform_motion: Motion | None = None,
    learn: int | None = None,
    poses: int | None = None,
) -> Answer:
    """Play the motion; write log, case and picture."""
    case = at.case
    path = Path(at.out or ("out/simulate" if log is None else ""), log or "run.csv")
    if log is None and at.out is None and case.log is not None:
        path = Path(case.log)
    files = at.log(path)
    _check_experiment(case, locals())
    if poses is not None:
        return _weigh(case, poses, files)
    servo = _servo(case, gains, no_feedforward)
    motion, lines = _motion(case, start, goal, via, duration), []
    query = None if case.query is None else replace(case.query, servo=servo)
    case = replace(case, motion=motion, query=query, servo=servo, log=str(path))
    latch = [*((t, "grasp") for t in grasp), *((t, "release") for t in release)]
    how: dict[str, Any] = {"settle": settle, "latch": latch}
    if learn is not None:
        require_positions(case.system.arm, motion)
        learnt = learn_gravity(
            case.system, motion, iterations=learn, settle=settle, servo=case.servo,
            seed=case.seed, progress=at.progress,
        )  # fmt: skip
        if learnt.recording is None:
            raise ParameterError(f"the first repetition was aborted: {learnt.aborted}")
        recorded, lines = learnt.recording.log(0), [str(learnt)]
    else:
        how |= {"record_dt": record_dt, "y": np.zeros(6) if disturb is None else disturb}
        recorded = vg.simulate(case, platform=platform_motion, progress=at.progress, **how)
    space = None
    if case.system.mode != "ideal" and platform_motion is None:
        how |= {"record_dt": float(recorded.t[1] - recorded.t[0]), "y": recorded.y[0]}
        space = vg.simulate(case, case.system.ideal(), **how)
    summary = summarise(recorded, motion, space, settle=settle)
    for warning in summary.warnings:
        say(warning, "warning")
    beside = path.with_suffix(".case.toml")
    recorded.save(path)
    case.save(beside)
    if summary.stop is not None:
        say(f"{summary.stop}; the log ends there")

    return Answer(
        text="\n".join([*lines, str(summary)]),
        plain={**summary.to_dict(), "log": str(path)},
        files=[*files, beside],
        figures=lambda: {path.stem: run_figure(recorded, case.system, motion.duration, space)},
        folder=path.parent,
        then=[["view", beside]],
        negative=summary.stop is not None or not summary.trusted,
    )


def _motion(
    case: Case,
    start: Array | None,
    goal: Array | None,
    via: tuple[Array, ...],
    duration: float | None,
) -> Motion:
    """The motion that the options describe; the case's, where there is one."""
    stated = case.motion
    if stated is None and case.query is not None:
        stated = case.query.straight
    if stated is not None:
        options = {"start": start, "goal": goal, "via": via or None, "duration": duration}
        for name, value in options.items():
            if value is not None:
                raise ParameterError(f"--case FILE already says it: leave out --{name}")
        return stated
    if goal is None and via:
        raise ParameterError("--via needs --goal: way-points lie between start and goal")
    arm, seconds = case.system.arm, duration or 2.0
    begin = arm.home if start is None else start
    end = usual_goal(arm, begin, seconds) if goal is None else goal
    return Motion.through(np.stack([begin, *via, end]), seconds)


def _servo(case: Case, gains: JointServo | None, no_feedforward: bool) -> JointServo:
    if case.system.drive != "motor" and (gains is not None or no_feedforward):
        raise ParameterError(
            "a prescribed drive has no servo: leave out --gains, --no-feedforward"
        )
    servo = case.servo if gains is None else gains
    return replace(servo, feedforward=False) if no_feedforward else servo


def _check_experiment(case: Case, options: dict[str, Any]) -> None:
    unset = [k for k, v in options.items() if v is None or (isinstance(v, tuple) and not v)]
    chosen = {k.replace("_", "-") for k in options if k not in unset}
    for option in ("platform-motion", "learn", "poses"):
        if option in chosen and case.system.mode != "emulated":
            raise ParameterError(f"--{option} needs --mode emulated")
    if {"learn", "poses"} <= chosen:
        raise ParameterError("--learn and --poses are two experiments: give one of them")
    for option in ("disturb", "record-dt", "grasp", "release"):
        if {"learn", option} <= chosen:
            raise ParameterError(
                "--learn starts every repetition at home and records every control period:"
                f" leave out --{option}"
            )
    if "platform-motion" not in chosen:
        return
    if "disturb" in chosen:
        raise ParameterError(
            "--platform-motion says where the platform starts: leave out --disturb"
        )
    operation = case.system.emulator_settings.operation
    if operation != "position":
        raise ParameterError(f"--platform-motion needs --operation position, got {operation}")


def _weigh(case: Case, poses: int, files: list[Path]) -> Answer:
    """Record static poses for the Model Method."""
    q, y = calibration_poses(case.system.arm, poses, seed=case.seed)
    log = weigh_poses(case.system, q, y, seed=case.seed)
    log.save(files[0])
    plain = {
        "schema": "ves-poses/1",
        "log": str(files[0]),
        "digest": log.digest,
        "poses": poses,
    }
    text = f"weighed {poses} poses"
    return Answer(text=text, plain=plain, files=files, then=[["calibrate", files[0]]])


TABLE = {
    "simulate": (simulate, (
        *grouped(
            "motion (default: in 2 s to 60,40,-30 deg; for arms of other than three joints,"
            " within half of the limits)",
            START,
            GOAL,
            Flag("--via", "A,B,C", joints, "way-point; repeatable", many=True),
            DURATION,
        ),
        Flag("--settle", "S", number("s", least=0), "joints held after it (10)"),
        Flag("--disturb", "X,Y,Z,A,B,C", pose, "base pose at the start [m, deg]"),
        GAINS,
        Flag("--no-feedforward", help="no feed-forward joint torque"),
        Flag("--record-dt", "S", number("s", above=0),
             "time between records (default physics step; mode emulated: control period)"),
        Flag("--grasp", "S", number("s"), "close the latch on the system's payload at this"
             " time; repeatable", many=True),
        Flag("--release", "S", number("s"), "open it at this time; repeatable", many=True),
        Flag("--log", "FILE",
             help="the run log, .csv or .parquet, from --out if given (out/simulate/run.csv)"),
        FORMAT,
        *MACHINE,
        *grouped(
            "experiments (mode emulated)",
            Flag("--platform-motion", "FILE",
                 read(lambda file: from_plain(Motion, read_table(file), file)),
                 "what the platform follows under --operation position: a table with duration"
                 " [s] and control, the points of its path, rows of 6 [m, rad]"),
            Flag("--learn", "N", integer(1), "learn the weight in N slow repetitions"),
            Flag("--poses", "N", integer(1), "weigh the arm in N poses, for `calibrate`"),
        ),
    )),
}  # fmt: skip
