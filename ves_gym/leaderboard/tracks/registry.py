"""The tracks by name."""

from __future__ import annotations

from pathlib import Path

from ves_gym.leaderboard.tracks.base import Track


def get_track(name: str, folder: Path | None = None, workers: int = 1) -> Track:
    """Return a track.

    Args:
        name: paths, policies, damping or discrepancy.
        folder: of the discrepancy track's cases, None for `Naming`'s own.
        workers: processes, 1 for none.
    """
    if name == "paths":
        from ves_gym.leaderboard.tracks.paths import Paths

        return Paths(workers)
    if name == "discrepancy":
        from ves_gym.leaderboard.tracks.diagnosis import Naming

        return Naming(folder, workers)
    from ves_gym.leaderboard.tracks.damping import Damping
    from ves_gym.leaderboard.tracks.policies import Episodes

    return Episodes() if name == "policies" else Damping()
