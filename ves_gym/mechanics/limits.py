"""The one rule of joint limits: for the reference motion and for the arm that follows it.

Every command asks here. What is checked: position, velocity and, where motors drive the
joints, torque; acceleration where a query limits it. The limits are the arm's own and, where
they are tighter, those of a query.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import Array
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.dynamics import inverse_dynamics
from ves_gym.mechanics.motion import Motion, Samples

TOLERANCE = 1e-6  # of a limit: an optimum lies on it, up to rounding
_SAMPLES = 201  # of a reference motion
THREE_JOINTS = (60.0, 40.0, -30.0)  # deg, where three joints go that have been told no goal
_SAID = ("joint", "time", "value", "limit")  # of an extreme, in a file
_SHARE = 0.5  # of speed, acceleration and torque limits that `default_goal` takes at most
_UNITS = {  # unit in messages and its factor, of a joint that turns and of one that slides
    "position": (("deg", math.degrees(1)), ("mm", 1e3)),
    "velocity": (("deg/s", math.degrees(1)), ("mm/s", 1e3)),
    "acceleration": (("rad/s^2", 1.0), ("m/s^2", 1.0)),
    "torque": (("N m", 1.0), ("N", 1.0)),
}


class LimitError(ValueError):
    """A motion breaks a joint limit; the message names joint, time and value."""


@dataclass(frozen=True)
class Extreme:
    """Place and time at which something comes nearest to its limit, or exceeds it most."""

    kind: str  # position, velocity, acceleration or torque
    joint: int  # from 1
    time: float  # s
    value: float  # rad, rad/s, rad/s^2 or N m; of a position from the middle of its range
    limit: float
    slides: bool = False  # m, m/s, m/s^2 or N instead

    @property
    def ratio(self) -> float:
        """|value| / limit."""
        return abs(self.value) / self.limit

    @property
    def breaks(self) -> bool:
        """True where the limit is exceeded by more than rounding."""
        return self.ratio > 1 + TOLERANCE

    @property
    def short(self) -> str:
        """Like 'velocity of joint 2 reaches 1.03 of its limit'."""
        close = 1 < self.ratio <= 1.005  # three digits would say that it is on the limit
        ratio = f"{self.ratio:.7g}" if close else f"{self.ratio:.3g}"
        return f"{self.kind} of joint {self.joint} reaches {ratio} of its limit"

    def __str__(self) -> str:
        middle = " from the middle of its range" if self.kind == "position" else ""
        return f"{self.short} at t = {self.time:.3f} s ({self.allowed}{middle})"

    @property
    def allowed(self) -> str:
        """Like '128.9 deg/s, allowed +-122.0 deg/s'."""
        symbol, factor = _UNITS[self.kind][self.slides]
        value, limit = self.value * factor, self.limit * factor
        return f"{value:.1f} {symbol}, allowed +-{limit:.1f} {symbol}"


@dataclass(frozen=True)
class LimitCheck:
    """The largest share of its limit that each kind of quantity takes."""

    extremes: tuple[Extreme, ...]  # one per kind

    @property
    def broken(self) -> tuple[Extreme, ...]:
        """Those that break their limit."""
        return tuple(e for e in self.extremes if e.breaks)

    @property
    def inside(self) -> bool:
        """True where no limit is broken."""
        return not self.broken

    def sentences(self, of: str) -> list[str]:
        """Return a sentence per broken limit; `of` is "reference" or "simulated arm"."""
        return [f"{of}: {e}" for e in self.broken]

    def brief(self, of: str) -> str:
        """Return '`of` inside the limits', or that it is not, for a line of output."""
        return f"{of} {'' if self.inside else 'NOT '}inside the limits"

    def verdict(self, of: str) -> str:
        """Return `brief`, and which limits are broken."""
        return self.brief(of) + (f": {self.reasons}" if self.broken else "")

    @property
    def reasons(self) -> str | None:
        """The broken limits in a sentence, None without any."""
        return "; ".join(map(str, self.broken)) or None

    def to_dict(self) -> dict[str, Any]:
        """Plain data: the verdict, and by kind joint, time, value, limit and ratio."""
        return {
            "inside": self.inside,
            "extremes": {
                e.kind: {**{k: getattr(e, k) for k in _SAID}, "ratio": e.ratio}
                for e in self.extremes
            },
        }

    @staticmethod
    def from_dict(plain: Mapping[str, Any], sliding: Sequence[int] = ()) -> LimitCheck:
        """Rebuild from what `to_dict` returned, with the joints (from 0) that slide."""
        return LimitCheck(
            tuple(
                Extreme(kind, **{k: e[k] for k in _SAID}, slides=e["joint"] - 1 in sliding)
                for kind, e in plain["extremes"].items()
            )
        )


def limits_of(
    arm: Arm,
    *,
    v_max: Sequence[float] | None = None,
    a_max: Sequence[float] | None = None,
    motor: bool = True,
) -> dict[str, Array]:
    """Return what is allowed by kind, in the order in which it is checked.

    The arm's limits, and a query's of speed [rad/s] where they are tighter, and of acceleration
    [rad/s^2], which is not limited without; torque where motors drive the joints.
    """
    out = {
        "position": (arm.column("q_max") - arm.column("q_min")) / 2,
        "velocity": np.minimum(arm.column("v_max"), np.inf if v_max is None else v_max),
    }
    if a_max is not None:
        out["acceleration"] = np.asarray(a_max, float)
    if motor:
        out["torque"] = arm.column("tau_max")
    return out


def middle_of_range(arm: Arm) -> Array:
    """Return the angles (n,) from which positions are measured [rad]."""
    return (arm.column("q_min") + arm.column("q_max")) / 2


def check_limits(
    limits: Mapping[str, Array],
    t: npt.ArrayLike,
    values: Mapping[str, Array],
    sliding: Sequence[int] = (),
) -> LimitCheck:
    """Compare what joints do with what they may do.

    Args:
        limits: (n,) by kind, see `limits_of`; only these kinds are checked.
        t: (N,) times [s], or (N, n) where each joint has its own.
        values: (N, n) by kind; positions from the middle of the range.
        sliding: joints (from 0) that slide.
    """
    times = np.asarray(t, float)
    extremes = []
    for kind, limit in limits.items():
        x = values[kind]
        ratio = np.abs(x) / limit
        k, j = (int(i) for i in np.unravel_index(int(ratio.argmax()), ratio.shape))
        time = float(times[k] if times.ndim == 1 else times[k, j])
        value, most = float(x[k, j]), float(limit[j])
        extremes.append(Extreme(kind, j + 1, time, value, most, j in sliding))
    return LimitCheck(tuple(extremes))


def check_reference(
    arm: Arm, motion: Motion, limits: Mapping[str, Array] | None = None
) -> LimitCheck:
    """Check a motion as it is commanded against `limits_of`, default the arm's own, driven by
    motors. Its torque is that of the motion on a base that stands still."""
    s = motion.at(np.linspace(0, motion.duration, _SAMPLES))
    allowed = limits_of(arm) if limits is None else limits
    return check_limits(allowed, s.t, _values(arm, s), arm.sliding)


def _values(arm: Arm, s: Samples) -> dict[str, Array]:
    torque = inverse_dynamics(arm, s.q, s.v, s.a)[0]
    position = s.q - middle_of_range(arm)
    return {"position": position, "velocity": s.v, "acceleration": s.a, "torque": torque}


def limit_ratios(arm: Arm, motion: Motion, samples: int = _SAMPLES) -> dict[str, Array]:
    """Return the largest |value| / limit per joint, by kind of limit: {name: (n,)}.

    Torque is that of the motion on a base that stands still. A position ratio is measured from
    the middle of the joint's range.
    """
    s = motion.at(np.linspace(0, motion.duration, samples))
    limits = limits_of(arm, a_max=tuple(arm.column("a_max")))
    values = _values(arm, s)
    return {k: (np.abs(values[k]) / limits[k]).max(axis=0) for k in limits}


def default_goal(arm: Arm, start: Array, duration: float) -> Array:
    """Return where the quintic law takes an arm from `start` without a goal (n,)
    [rad].

    Each joint goes a third of its room, 60 deg at most, to the side where there is more; all of
    them less where speed, acceleration or torque would take more than half of a limit.
    """
    above, below = arm.column("q_max") - start, start - arm.column("q_min")
    way = np.minimum(np.maximum(above, below) / 3, np.deg2rad(60.0))
    way = np.where(above >= below, way, -way)
    for _ in range(40):
        ratios = limit_ratios(arm, Motion.straight(start, start + way, duration))
        worst = max(float(ratios[k].max()) for k in ("velocity", "acceleration", "torque"))
        if worst <= _SHARE:
            break
        way = way * max(0.5, 0.99 * _SHARE / worst)
    return np.asarray(start + way, np.float64)


def usual_goal(arm: Arm, start: Array, duration: float) -> Array:
    """Return where a motion goes without a goal (n,) [rad].

    The thesis's arm goes to 60, 40, -30 deg, and so does another of three joints that turn and
    reach it; others as `default_goal` says.
    """
    usual = np.deg2rad(THREE_JOINTS)
    if arm.n == len(usual) and not arm.sliding:
        low, high = arm.column("q_min"), arm.column("q_max")
        if (low <= usual).all() and (usual <= high).all():
            return usual
    return default_goal(arm, start, duration)


def require_positions(arm: Arm, motion: Motion) -> None:
    """Raise LimitError when a motion leaves the range of a joint."""
    check = check_reference(arm, motion, {"position": limits_of(arm)["position"]})
    for e in check.broken:
        raise LimitError(
            f"motion breaks the position limit of joint {e.joint} at t = {e.time:.3f} s:"
            f" {e.allowed} about the middle of its range"
        )
