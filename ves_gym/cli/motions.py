"""Motions, servos and poses on the command line: what `simulate`, `plan` and others share."""

from __future__ import annotations

import argparse
import dataclasses
import math
import sys

import numpy as np

from ves_gym._util.params import Array, ParameterError
from ves_gym.cli.common import numbers
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.limits import THREE_JOINTS, default_goal, require_limits
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.servo import FREE, HIGH_GAINS, OWN_GAINS, PPED_GAINS, JointServo
from ves_gym.system.system import System

GAINS = {"own": OWN_GAINS, "high": HIGH_GAINS, "pped": PPED_GAINS, "free": FREE}


def motion_from(args: argparse.Namespace, arm: Arm) -> Motion:
    """The motion the arguments describe, inside the joint limits."""
    if args.motion is not None:
        for option in ("start", "goal", "via", "duration"):
            if getattr(args, option) is not None:
                raise ParameterError(f"--motion FILE already says it: leave out --{option}")
        motion = Motion.load(args.motion)
        if motion.n != arm.n:
            raise ParameterError(
                f"{args.motion}: {arm.name} has {arm.n} joints, got {motion.n}"
            )
    else:
        motion = _motion_through(args, arm)
    require_limits(arm, motion, ("position",))
    return motion


def _motion_through(args: argparse.Namespace, arm: Arm) -> Motion:
    start = joint_angles(args.start, arm, "--start", args.angle_unit)
    if args.goal is None and args.via:
        raise ParameterError("--via needs --goal: way-points lie between start and goal")
    duration = duration_from(args.duration)
    if args.goal is None and (arm.n != len(THREE_JOINTS) or arm.sliding):
        goal = default_goal(arm, start, duration)
    else:
        goal = joint_angles(args.goal, arm, "--goal", args.angle_unit, THREE_JOINTS)
    vias = [joint_angles(via, arm, "--via", args.angle_unit) for via in args.via or ()]
    if not vias:
        return Motion.straight(start, goal, duration)
    return Motion.through(np.stack([start, *vias, goal]), duration)


def joint_angles(
    text: str | None,
    arm: Arm,
    name: str,
    unit: str | None,
    default: tuple[float, ...] | None = None,
) -> Array:
    """Return joint angles [rad] inside the arm's limits.

    Args:
        text: what was given: numbers with commas between them, [m] of joints that slide; None:
            the default.
        arm: whose joints they are.
        name: of the option.
        unit: `args.angle_unit`: degrees, radians, or None: degrees, and a note on stderr if
            they look like radians.
        default: angles [deg] of an arm with as many joints; zeros otherwise.
    """
    if text is None:
        angles = np.clip(0.0, arm.column("q_min"), arm.column("q_max"))
        if default is not None and len(default) == arm.n and not arm.sliding:
            angles = np.deg2rad(default)
        return arm.require_within_limits(angles, name)
    values = numbers(text, arm.n, name, f"angles in {unit or 'degrees'}", "0,-45,90")
    angles = np.array(values) if unit == "radians" else np.deg2rad(values)
    slides = list(arm.sliding)
    angles[slides] = np.array(values)[slides]  # m
    out = arm.require_within_limits(angles, name)
    if unit is None and (note := radians_note(text, name)):
        print(f"ves-gym: note: {note}", file=sys.stderr)
    return out


def radians_note(text: str, name: str) -> str | None:
    """Return the question that angles given in degrees raise if they look like radians.

    They do if none is beyond a whole turn in radians and one of them has two decimals or more
    and is, to half of its last, a multiple of 15 degrees: 1.57, 0.785, -2.36.

    Args:
        text: numbers with commas between them.
        name: of the option.
    """
    parts = text.split(",")
    values = [float(part) for part in parts]
    if max(map(abs, values)) > 2 * math.pi or not any(map(_is_round, parts)):
        return None
    meant = ",".join(f"{_nearest(part):g}" for part in parts)
    return (
        f"{name} {text} looks like radians; angles are degrees: did you mean {meant}?"
        " (--degrees: no; --radians: take them as they are meant)"
    )


def _is_round(part: str) -> bool:
    value, decimals = abs(float(part)), len(part.strip().partition(".")[2])
    if decimals < 2 or "e" in part.lower() or value < math.radians(15) - 5e-3:
        return False
    off = abs(value - math.radians(15) * round(value / math.radians(15)))
    return off <= 0.5001 * 10.0**-decimals


def _nearest(part: str) -> float:
    """Return an angle given in radians in degrees: round where it is meant to be."""
    angle = math.degrees(float(part))
    return 15.0 * round(angle / 15) if _is_round(part) else round(angle, 1)


def duration_from(value: float | None, default: float = 2.0) -> float:
    """A duration [s] > 0."""
    if value is not None and not (math.isfinite(value) and value > 0):
        raise ParameterError(f"--duration must be > 0 s, got {value}")
    return default if value is None else value


def servo_from(args: argparse.Namespace, system: System) -> JointServo:
    """The joint servo the arguments describe."""
    if system.drive != "motor" and (args.gains is not None or args.no_feedforward):
        raise ParameterError(
            "a prescribed drive has no servo: leave out --gains, --no-feedforward"
        )
    text = args.gains or "own"
    servo = GAINS.get(text) or _numbers(text, system.arm.n)
    if servo is FREE:
        zero = (0.0,) * system.arm.n
        servo = JointServo(kp=zero, kd=zero, feedforward=False, source=FREE.source)
    if not servo.kp:
        servo = servo.for_arm(system.arm)
    if args.no_feedforward:
        servo = dataclasses.replace(servo, feedforward=False)
    if system.drive == "motor" and len(servo.kp) != system.arm.n:
        raise ParameterError(
            f"gains {text!r} are for {len(servo.kp)} joints,"
            f" {system.arm.name} has {system.arm.n}"
        )
    return servo


def _numbers(text: str, n: int) -> JointServo:
    expected = f"{', '.join(GAINS)}, or kp/kd with 1 or {n} numbers each, like 100/10"
    try:
        kp, kd = ([float(k) for k in part.split(",")] for part in text.split("/"))
    except ValueError:
        raise ParameterError(f"--gains must be {expected}, got {text!r}") from None
    if {len(kp), len(kd)} - {1, n}:
        raise ParameterError(f"--gains must be {expected}, got {text!r}")
    return JointServo(kp=tuple(kp * (n // len(kp))), kd=tuple(kd * (n // len(kd))))


def disturbance(text: str | None) -> Array:
    if text is None:
        return np.zeros(6)
    try:
        values = np.array([float(k) for k in text.split(",")])
    except ValueError:
        values = np.full(6, np.nan)
    if values.shape != (6,) or not np.isfinite(values).all():
        raise ParameterError(
            f"--disturb must be six numbers x,y,z [m] and angles [deg], got {text!r}"
        )
    values[3:] = np.deg2rad(values[3:])
    return values
