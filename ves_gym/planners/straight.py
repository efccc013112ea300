"""The straight line in joint space with a quintic law: what others are compared with."""

from __future__ import annotations

from typing import Any

from ves_gym.mechanics.motion import Motion
from ves_gym.planners.query import Query


class Straight:
    """Straight joint line, quintic rest to rest."""

    name = "straight"
    summary = "straight joint line, quintic time law"

    def find(self, query: Query, seed: int) -> tuple[Motion, dict[str, Any]]:
        """Return the straight quintic; deterministic.

        Args:
            query: the ends and the duration.
            seed: not used.

        Returns:
            The motion.
        """
        return query.straight, {}
