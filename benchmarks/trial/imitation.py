"""Tolerances of a machine that do exactly what a hidden effect does.

Some effects are nothing but a number further off than its tolerance: a damping, the gain of a
sensor's channel, the zero that a weight estimate has. How unlikely such a machine is bounds
what any reader can gain by the truth, whatever the runs and however long: the deviance of an
effect that x standard deviations of tolerances (x a vector) imitate is |x|^2 at most.
"""

import numpy as np

from benchmarks.trial.arm import Array
from benchmarks.trial.cases import TOLERANCES, Case
from benchmarks.trial.laboratory import resting_signals
from benchmarks.trial.machines import SERVOS, description

UNIFORM = 3**0.5  # half-widths in a standard deviation
_OF_THE_BASE = {"base/virtual_mass": "M", "base/damping": "D", "base/stiffness": "K"}
_RATIOS = {  # effect -> tolerance of the same number, multiplied
    "sensor/lag": "sensor_cutoff",
    "platform/bandwidth": "bandwidth",
    "platform/damping": "damping",
}


def places(joints: int) -> dict[str, int]:
    """Return where the tolerances of each kind begin, as `cases.machine_off` draws them.

    Args:
        joints: of the arm. The clock comes last, and is left out: it moves no sample.

    Returns:
        Name -> place; "end" -> their count. Those of bodies (mass, centre, inertia) are first,
        five each.
    """
    counts = {
        "bodies": 5 * (joints + 1), "rotor": joints, "M": 1, "D": 1, "K": 1, "drive": joints,
        "sensor_gain": 6, "sensor_offset": 6, "sensor_cutoff": 1, "bandwidth": 1, "damping": 1,
        "estimate": 1, "servo": 2 * joints,
    }  # fmt: skip
    out, at = {}, 0
    for name, count in counts.items():
        out[name], at = at, at + count
    return {**out, "end": at}


def imitation(case: Case, which: int, size: float) -> Array | None:
    """Return tolerances (p,) in standard deviations that do what an effect does, if they can.

    Args:
        case: drawn.
        which: of its effects.
        size: of that.
    """
    kind, slot, sign = case.kinds[which], case.slots[which], case.signs[which]
    place = places(len(SERVOS[case.arm].kp))
    x = np.zeros(place["end"])

    def put(name: str, off: float, at: int = 0) -> None:
        x[place[name] + at] += off / (case.factor * TOLERANCES[name] / UNIFORM)

    ratio = size if sign > 0 else -size / (1 + size)
    if kind in _OF_THE_BASE and case.mode == "ideal":  # else a number in a computer, and exact
        put(_OF_THE_BASE[kind], ratio)
    elif kind in _RATIOS:
        put(_RATIOS[kind], ratio)
    elif kind == "joint/drive_gain":
        put("drive", sign * size, slot)
    elif kind == "gravity/mass":
        put("estimate", sign * size)
    elif kind == "sensor/bias":
        put("sensor_offset", sign * size, slot)
    elif kind == "sensor/calibration":  # zeroed under the arm's weight: so is a tolerance of it
        off = sign * size
        put("sensor_gain", off, slot)
        put("sensor_offset", off * float(_resting(case)[slot]), slot)
    elif kind == "payload/com":  # of the last body
        x[5 * len(SERVOS[case.arm].kp) + 1 + slot % 3] = (
            sign * size / (case.factor * TOLERANCES["centre"] / UNIFORM)
        )
    else:
        return None
    return x


def most_gained(case: Case, which: int, size: float) -> float:
    """Return a deviance that no reader of an effect can pass; infinite where none is known.

    Args:
        case: drawn.
        which: of its effects.
        size: of that.
    """
    x = imitation(case, which, size)
    return float("inf") if x is None else float(x @ x)


def _resting(case: Case) -> Array:
    table = description(case.vehicle, case.arm, case.mode, case.platform, case.period)
    return resting_signals(table)
