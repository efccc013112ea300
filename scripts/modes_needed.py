"""How many internal modes a flexible base needs, by a stated error.

    python scripts/modes_needed.py [--error 0.01] [--queries 20]

The smallest m with which, on each shipped beam, (a) every frequency below 20 Hz with the arm
locked at q = 0 and in 60 random poses and (b) E_mean of the straight lines of 20 reference
queries (reach100, T = 0.5 to 4 s) changes by less than the error when m is doubled, and (a) is
within it of what 40 modes give. `mechanics/vehicle.py` holds the result.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np

from ves_gym._util.params import Array
from ves_gym.mechanics.dynamics import inertia
from ves_gym.mechanics.flexible_base import FlexibleBase
from ves_gym.mechanics.modes import natural_modes
from ves_gym.mechanics.vehicle import (
    BENT_THESIS,
    STRAIGHT_HORIZONTAL_THESIS,
    STRAIGHT_VERTICAL_THESIS,
    Beam,
)
from ves_gym.planners.prediction import predict
from ves_gym.planners.query import Query
from ves_gym.planners.suites import get_suite, part_of, reach_range
from ves_gym.system.system import System

BEAMS = {
    "bent": BENT_THESIS,
    "straight-vertical": STRAIGHT_VERTICAL_THESIS,
    "straight-horizontal": STRAIGHT_HORIZONTAL_THESIS,
}
BAND = 20.0  # Hz
FINE = 40  # modes that stand for all of them
TRIED = range(1, 9)
POSES = 60


def main() -> None:
    """Print the error of each number of modes, and the first that suffices."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--error", type=float, default=0.01)
    parser.add_argument("--queries", type=int, default=20)
    options = parser.parse_args()
    for name, beam in BEAMS.items():
        suite = get_suite("reach100", system=System(vehicle=beam), vehicle=name)
        suite = part_of(suite, first=10)
        every = [query for _, query in suite.queries]
        queries = every[:: len(every) // options.queries][: options.queries]
        numbers = sorted({*TRIED, *(2 * m for m in TRIED)})
        lines = {m: frequencies(beam, m) for m in (*numbers, FINE)}
        means = {m: energies(beam, m, queries) for m in numbers}
        print(f"{name}: largest change of frequencies below 20 Hz, of E_mean")
        needed = None
        for m in TRIED:
            doubled = apart(lines[m], lines[2 * m], BAND)
            whole = apart(lines[m], lines[FINE], BAND)
            energy = float(np.abs(means[m] / means[2 * m] - 1).max())
            print(
                f"  m = {m}  against 2 m: {doubled:.2e} {energy:.2e}"
                f"  frequencies against {FINE} modes: {whole:.2e}",
                flush=True,
            )
            good = max(doubled, whole, energy) < options.error
            needed = needed or (m if good else None)
        print(f"  needed: {needed}")


def flexible(beam: Beam, modes: int) -> FlexibleBase:
    """Return the beam with its slowest modes, however fast the last."""
    return replace(FlexibleBase.of(beam, modes), fastest=1e9)


def frequencies(beam: Beam, modes: int) -> Array:
    """Return natural frequencies with the arm locked (poses, 6 + m) [Hz], slowest first."""
    system = System(vehicle=flexible(beam, modes))
    reach = reach_range(system.arm)
    poses = np.random.default_rng(0).uniform(-reach, reach, (POSES, system.arm.n))
    poses[0] = 0.0
    M, _, K = system.base.full()
    mass = np.tile(M, (POSES, 1, 1))
    mass[:, :6, :6] += inertia(system.arm, poses)[:, :6, :6]
    return natural_modes(K, mass).omega / (2 * np.pi)


def energies(beam: Beam, modes: int, queries: list[Query]) -> Array:
    """Return E_mean of each query's straight line, predicted [J]."""
    system = System(vehicle=flexible(beam, modes))
    return np.array([predict(system, q.straight, q.servo).E_mean for q in queries])


def apart(few: Array, many: Array, band: float) -> float:
    """Return the largest relative distance of the frequencies below a band's end.

    Args:
        few, many: (poses, k) [Hz]; those that `few` does not have count as 1.
        band: [Hz].
    """
    inside = many < band
    k = few.shape[1]
    if inside[:, k:].any():
        return 1.0
    both = min(k, many.shape[1])
    gap = np.abs(few[:, :both] / many[:, :both] - 1)
    return float(gap[inside[:, :both]].max())


if __name__ == "__main__":
    main()
