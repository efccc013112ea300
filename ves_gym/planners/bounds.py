"""Bounds on disturbance measures, as shares of the straight line's, and how they are read."""

from __future__ import annotations

import math
from collections.abc import Mapping

from ves_gym._util.params import ParameterError, require_one_of
from ves_gym.system.disturbance import MEASURES

# No more than the straight line moves the arm's mount, and the tool when it arrives.
USUAL = dict.fromkeys(
    ("acceleration_peak", "angular_peak", "acceleration", "angular", "tip_end"), 1.0
)
# Of the straight line's peaks: a motion up to here is judged to shake no more. Bounds are kept
# by a prediction, and 1 % is left for its error.
NO_MORE = 1.01


def checked_bounds(bounds: Mapping[str, float] | None) -> dict[str, float]:
    """Return the usual bounds with others in their place or beside them; inf is none.

    Raises:
        ParameterError: a name not in `MEASURES`, or a bound that is not above zero.
    """
    for name, value in (bounds or {}).items():
        require_one_of("a bound", name, MEASURES)
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        if not (number and value > 0):
            raise ParameterError(f"bound {name} must be a number > 0, got {value!r}")
    merged = USUAL | {name: float(value) for name, value in (bounds or {}).items()}
    return {name: value for name, value in merged.items() if math.isfinite(value)}


def parse_bounds(text: str) -> dict[str, float]:
    """Read bounds like acceleration_peak=0.5+angular_peak=inf."""
    out = {}
    for part in text.split("+"):
        name, _, value = part.partition("=")
        try:
            out[name.strip()] = float(value)
        except ValueError:
            raise ParameterError(
                f"a bound must be NAME=SHARE like acceleration_peak=0.5, got {part!r}"
            ) from None
    checked_bounds(out)
    return out


def bounded_name(planner: str, bounds: Mapping[str, float] | None) -> str:
    """A planner's name with its own bounds, as `get_planner` reads it."""
    unusual = {
        name: share for name, share in (bounds or {}).items() if USUAL.get(name) != share
    }
    listed = "+".join(f"{name}={share:g}" for name, share in unusual.items())
    return f"{planner}:{listed}" if listed else planner
