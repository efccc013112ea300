"""How large an effect must be for a wanted gap over the noise."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ves_gym._util.params import Array
from ves_gym.diagnosis.benchmark.blind.noise import STD
from ves_gym.diagnosis.benchmark.blind.simulate import CHANNELS

TOLERANCE = 0.05  # relative, of the gap reached
ROUNDS = 24
# standard deviations the gap is measured in; what has no noise of its own counts in that of
# the quantity it stands for
SCALE = {**STD, "y_cmd": STD["y"], "wg": STD["w"]}


def gaps(changed: Sequence[Array], plain: Sequence[Array]) -> dict[str, Array]:
    """Return the RMS difference over noise, mean over the runs.

    Args:
        changed, plain: records (N, 33) of the same runs.

    Returns:
        (k,) per group of channels.
    """
    out = {}
    for name, std in SCALE.items():
        columns = CHANNELS[name]
        per_run = [
            np.sqrt(((a[:, columns] - b[:, columns]) ** 2).mean(axis=0)) / std
            for a, b in zip(changed, plain, strict=True)
        ]
        out[name] = np.asarray(np.mean(per_run, axis=0))
    return out


def gap(changed: Sequence[Array], plain: Sequence[Array]) -> float:
    """Return the gap of the most affected channel; infinite where the machine ran away.

    Args:
        changed, plain: records (N, 33) of the same runs.
    """
    most = max(float(values.max()) for values in gaps(changed, plain).values())
    return most if np.isfinite(most) else np.inf


def search(
    measure: Callable[[float], float], target: float, start: float, most: float
) -> tuple[float, float]:
    """Return the magnitude whose gap is `target`, and the gap it has.

    Secant steps in logarithms inside a bracket that bisection keeps valid.

    Args:
        measure: magnitude -> gap over noise.
        target: gap.
        start: magnitude to begin with.
        most: largest magnitude, returned where it is too little.
    """
    low, high = 1e-6 * most, most
    x, best = min(start, most), (start, 0.0)
    points: list[tuple[float, float]] = []
    for _ in range(ROUNDS):
        reached = measure(x)
        if abs(np.log(max(reached, 1e-12) / target)) < abs(
            np.log(max(best[1], 1e-12) / target)
        ):
            best = (x, reached)
        if abs(reached / target - 1) <= TOLERANCE:
            break
        if reached < target:
            low = max(low, x)
        else:
            high = min(high, x)
        usable = np.isfinite(reached) and reached > 0
        guess = np.nan
        if usable:
            points.append((np.log(x), np.log(reached / target)))
            (a, fa), (b, fb) = points[-2:] if len(points) > 1 else [(0.0, 0.0), points[-1]]
            slope = np.clip((fb - fa) / (b - a), 0.3, 30.0) if len(points) > 1 else 1.0
            guess = b - fb / slope
        x = float(np.exp(guess))
        if not low < x < high:
            x = float(np.sqrt(low * high))
            if usable and guess >= np.log(high) and high == most:
                x = most
        if high / low < 1 + 1e-6:
            break
    return best
