"""`ves-gym simulate`: one motion on one system, recorded as a run log."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import ves_gym.api as vg
from ves_gym._util.optional import lacking
from ves_gym._util.params import Array, ParameterError, from_plain, read_table
from ves_gym.cli.files import FORMAT, log_files, log_path
from ves_gym.cli.flags import Answer, Flag, Place, grouped, joints, number, pose, say, whole
from ves_gym.cli.machine import MACHINE, read
from ves_gym.mechanics.limits import require_limits, usual_goal
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.servo import FREE, HIGH_GAINS, OWN_GAINS, PPED_GAINS, JointServo
from ves_gym.planners.case import Case
from ves_gym.simulation import calibration_poses, learn_gravity, weigh_poses
from ves_gym.simulation.run_summary import summarise
from ves_gym.system.energy import TAIL
from ves_gym.system.runlog import RunLog

NAMED = {"own": OWN_GAINS, "high": HIGH_GAINS, "pped": PPED_GAINS, "free": FREE}


def _gains(text: str, place: Place) -> JointServo:
    """Read --gains: a name, or kp/kd."""
    assert place.arm is not None
    n = place.arm.n
    if text == "free":
        zero = (0.0,) * n
        return JointServo(kp=zero, kd=zero, feedforward=False, source=FREE.source)
    if text in NAMED:
        return NAMED[text].for_arm(place.arm)
    try:
        kp, kd = (tuple(float(k) for k in part.split(",")) for part in text.split("/"))
    except ValueError:
        kp = kd = ()
    if {len(kp), len(kd)} - {1, n}:
        raise ParameterError(
            f"--gains must be {', '.join(NAMED)}, or kp/kd with 1 or {n} numbers each, like"
            f" 100/10, got {text!r}"
        )
    return JointServo(kp=kp * (n // len(kp)), kd=kd * (n // len(kd)))


START = Flag("--start", "A,B,C", joints, "joint angles [deg] (default 0,0,0)")
GOAL = Flag("--goal", "A,B,C", joints, "joint angles [deg]")
DURATION = Flag("--duration", "S", number("s", above=0), "of the motion [s] (2)")
GAINS = Flag(
    "--gains",
    "G",
    _gains,
    f"{', '.join(NAMED)}, or kp/kd like 3000,2000,1000/50,40,30 (default own: the arm's)",
)
LOG = Flag(
    "--log",
    "FILE",
    help="the run log, .csv or .parquet, from --out if given (out/simulate/run.csv)",
)
FLAGS = (
    *grouped(
        "motion (default: in 2 s to 60,40,-30 deg; of other than three joints, within half of"
        " the arm's limits)",
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
         "between records (default physics step; mode emulated: control period)"),
    Flag("--grasp", "S", number("s"), "close the latch on the system's payload at this time;"
         " repeatable", many=True),
    Flag("--release", "S", number("s"), "open it", many=True),
    LOG,
    FORMAT,
    *MACHINE,
    *grouped(
        "experiments (mode emulated)",
        Flag("--platform-motion", "FILE",
             read(lambda file: from_plain(Motion, read_table(file), file)),
             "what the platform follows under --operation position: a table with duration [s]"
             " and control, the points of its path, rows of 6 [m, rad]"),
        Flag("--learn", "N", whole(1), "learn the weight in N slow repetitions"),
        Flag("--poses", "N", whole(1), "weigh the arm in N poses, for `calibrate`"),
    ),
)  # fmt: skip


def run(
    case: Case,
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
    format: str = "png",
    platform_motion: Motion | None = None,
    learn: int | None = None,
    poses: int | None = None,
    out: Path | None = None,
    json: str | None = None,
    progress: Any = None,
) -> Answer:
    """Play the motion; write log, case and picture."""
    file = _place(case, log, out, json)
    _check_experiment(case, locals())
    if poses is not None:
        return _weigh(case, poses, file)
    servo = _servo(case, gains, no_feedforward)
    motion, said = _motion(case, start, goal, via, duration), ""
    query = None if case.query is None else replace(case.query, servo=servo)
    case = replace(case, motion=motion, query=query, servo=servo, log=str(file))
    latch = [*((t, "grasp") for t in grasp), *((t, "release") for t in release)]
    how: dict[str, Any] = {"settle": settle, "latch": latch}
    if learn is not None:
        require_limits(case.system.arm, motion, ("position",))
        learnt = learn_gravity(
            case.system, motion, iterations=learn, settle=settle, servo=case.servo,
            seed=case.seed, progress=progress,
        )  # fmt: skip
        if learnt.recording is None:
            raise ParameterError(f"the first repetition was aborted: {learnt.aborted}")
        recorded, said = learnt.recording.log(0), f"{learnt}\n"
    else:
        y = np.zeros(6) if disturb is None else disturb
        recorded = vg.simulate(
            case, record_dt=record_dt, y=y, platform=platform_motion, progress=progress, **how
        )
    space = None
    if case.system.mode != "ideal" and platform_motion is None:
        dt = float(recorded.t[1] - recorded.t[0])
        space = vg.simulate(case, case.system.ideal(), record_dt=dt, y=recorded.y[0], **how)
    summary = summarise(recorded, motion, space, settle=settle)
    for warning in summary.warnings:
        say(warning, "warning")
    beside = file.with_suffix(".case.toml")
    recorded.save(file)
    case.save(beside)
    files = [*log_files(file), beside]
    if sentence := lacking("drawing", "matplotlib"):
        said += f"no picture: {sentence}\n"
    else:
        files.append(_picture(recorded, case, space, file.with_suffix(f".{format}")))
    if summary.stop is not None:
        say(f"{summary.stop}; the log ends there")
    return Answer(
        text=f"{said}{summary}",
        plain={**summary.to_dict(), "log": str(file)},
        files=files,
        next=[["view", beside]],
        negative=summary.stop is not None,
    )


def _motion(
    case: Case,
    start: Array | None,
    goal: Array | None,
    via: tuple[Array, ...],
    duration: float | None,
) -> Motion:
    """The motion that the options describe; the case's, where there is one."""
    given = {"start": start, "goal": goal, "via": via or None, "duration": duration}
    named = [name for name, value in given.items() if value is not None]
    known = case.motion
    if known is None and case.query is not None:
        known = case.query.straight
    if known is not None:
        if named:
            raise ParameterError(f"--case FILE already says it: leave out --{named[0]}")
        return known
    if goal is None and via:
        raise ParameterError("--via needs --goal: way-points lie between start and goal")
    arm, seconds = case.system.arm, duration or 2.0
    rest = np.clip(0.0, arm.column("q_min"), arm.column("q_max"))
    begin = rest if start is None else start
    end = usual_goal(arm, begin, seconds) if goal is None else goal
    return Motion.through(np.stack([begin, *via, end]), seconds)


def _servo(case: Case, gains: JointServo | None, no_feedforward: bool) -> JointServo:
    if case.system.drive != "motor" and (gains is not None or no_feedforward):
        raise ParameterError(
            "a prescribed drive has no servo: leave out --gains, --no-feedforward"
        )
    servo = case.servo if gains is None else gains
    return replace(servo, feedforward=False) if no_feedforward else servo


def _check_experiment(case: Case, given: dict[str, Any]) -> None:
    for option in ("platform_motion", "learn", "poses"):
        if given[option] is not None and case.system.mode != "emulated":
            raise ParameterError(f"--{option.replace('_', '-')} needs --mode emulated")
    if given["learn"] is not None and given["poses"] is not None:
        raise ParameterError("--learn and --poses are two experiments: give one of them")
    for option in ("disturb", "record_dt", "grasp", "release"):
        if given["learn"] is not None and given[option] not in (None, ()):
            raise ParameterError(
                f"--learn starts every repetition at home and records every control period:"
                f" leave out --{option.replace('_', '-')}"
            )
    if given["platform_motion"] is None:
        return
    if given["disturb"] is not None:
        raise ParameterError(
            "--platform-motion says where the platform starts: leave out --disturb"
        )
    operation = case.system.emulator_settings.operation
    if operation != "position":
        raise ParameterError(f"--platform-motion needs --operation position, got {operation}")


def _weigh(case: Case, poses: int, file: Path) -> Answer:
    """Record static poses for the Model Method."""
    q, y = calibration_poses(case.system.arm, poses, seed=case.seed)
    log = weigh_poses(case.system, q, y, seed=case.seed)
    log.save(file)
    return Answer(
        text=f"weighed {poses} poses",
        plain={
            "schema": "ves-poses/1",
            "log": str(file),
            "digest": log.digest,
            "poses": poses,
        },
        files=log_files(file),
        next=[["calibrate", file]],
    )


def _place(case: Case, log: str | None, out: Path | None, json: str | None) -> Path:
    """Return where the run log goes: --log from --out, else as the case says."""
    if log is None and out is None and case.log is not None:
        return log_path(Path(case.log), json)
    return log_path(
        Path(out or ("out/simulate" if log is None else ""), log or "run.csv"), json
    )


def _picture(log: RunLog, case: Case, space: RunLog | None, path: Path) -> Path:
    from ves_gym.report.figures import write_figure
    from ves_gym.report.run import run_figure

    assert case.motion is not None
    write_figure(run_figure(log, case.system, case.motion.duration, space), path)
    return path
