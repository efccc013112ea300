"""Labels of the blind benchmark in the words of the candidates."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from ves_gym.diagnosis.machines.base import WRENCH

Name = tuple[str, str]  # kind and slot
Plain = Mapping[str, Any]

_SIGNALS = ("f_x", "f_y", "f_z", "m_x", "m_y", "m_z")
# slots that are called otherwise; all the rest have the same names on both sides
SLOTS = dict(zip(_SIGNALS, WRENCH, strict=True))
# one candidate with a number per axis stands for all slots: the clearest says which
BY_AXIS = ("payload/com", "sensor/rotation", "gravity/tilt", "sensor/bias")
INTERVAL = 1.645  # standard deviations to either side, 90 %


def label_name(effect: Plain) -> Name:
    """Return kind and slot of a label's effect, as a candidate has them."""
    slot = str(effect["slot"])
    return str(effect["kind"]), SLOTS.get(slot, slot)


def answer_name(effect: Plain) -> Name:
    """Return kind and slot of an answer's effect; its axis is that of the clearest number."""
    kind, value, std = str(effect["kind"]), effect["value"], effect.get("std") or {}
    if kind in BY_AXIS and not effect["slot"]:  # answers of before had a bias per axis
        return kind, max(value, key=lambda axis: abs(value[axis]) / (std.get(axis) or 1.0))
    return kind, str(effect["slot"])


def numbers(label: Plain, answer: Plain) -> list[tuple[float, float, float | None]]:
    """Pair every number that label and answer both state.

    Drift has none: its label is a process, its candidate a path.

    Args:
        label: effect of a label.
        answer: effect of an answer, of the same kind.

    Returns:
        (true, estimated, standard deviation or None).
    """
    value: Mapping[str, float] = answer["value"]
    std: Mapping[str, float | None] = answer.get("std") or {}
    kind, slot = label_name(label)
    out: list[tuple[float, float, float | None]] = []
    for name, true in label["parameters"].items():
        if kind in BY_AXIS:
            at = slot if slot in value else "bias"  # as before all axes were one cause
            out.append((true, value[at], std.get(at)))
        elif kind == "sensor/calibration":
            if name == "error":
                column = WRENCH[_source(label)]
                out.append((true, value[column], std.get(column)))
        elif (kind, name) == ("joint/stribeck", "stiction"):
            out.append((true, value["coulomb"] * (1 + value["breakaway"]), None))
        elif (kind, name) == ("joint/ripple", "amplitude"):
            out.append((true, *_amplitude(value, std)))
        elif name in value:
            out.append((true, value[name], std.get(name)))
    return out


def _source(label: Plain) -> int:
    """Return the signal that a wrong calibration takes from."""
    i = _SIGNALS.index(label["slot"])
    return i - i % 3 + (i % 3 + int(label["parameters"]["from"])) % 3


def _amplitude(
    value: Mapping[str, float], std: Mapping[str, float | None]
) -> tuple[float, float | None]:
    s, c = value["sine"], value["cosine"]
    size = math.hypot(s, c)
    a, b = std.get("sine"), std.get("cosine")
    if a is None or b is None or size == 0:
        return size, None
    return size, math.hypot(s * a, c * b) / size
