"""A planner of one's own, and where it stands: the straight line with a slower time law."""

from typing import Any

import numpy as np

import ves_gym as vg


@vg.register_planner
class Gentle:
    """The straight line by a cubic time law, whose greatest speed is a fifth lower."""

    name = "gentle"  # on the leaderboard: a-z, 0-9 and hyphens
    summary = "straight joint line, cubic time law"

    def find(self, query: vg.Query, seed: int) -> tuple[vg.Motion, dict[str, Any]]:
        u = np.linspace(0, 1, 400)[:, None]
        law = u**2 * (3 - 2 * u)
        start, goal = query.ends
        return vg.Motion.fit(start + law * (goal - start), query.duration), {}


if __name__ == "__main__":
    query = vg.Query(
        system=vg.System(),
        start=tuple(np.deg2rad([0, -45, 90])),
        goal=tuple(np.deg2rad([80, 40, -40])),
        duration=4.0,
    )
    print(vg.compare(query, ["straight", "gentle", "direct"]).table)
