"""The tracks by name."""

from __future__ import annotations

from pathlib import Path

from ves_gym.leaderboard.tracks.base import LeaderboardTrack, Progress, no_progress


def get_track(
    name: str,
    folder: Path | None = None,
    workers: int = 1,
    progress: Progress = no_progress,
) -> LeaderboardTrack:
    """Return a track.

    Args:
        name: paths, policies, tasks, damping or discrepancy.
        folder: of the discrepancy track's cases, None for `DiagnosisTrack`'s own.
        workers: processes, 1 for none.
        progress: called with the stage and the fraction done where a method runs again.
    """
    if name == "paths":
        from ves_gym.leaderboard.tracks.paths import PathTrack

        return PathTrack(workers, progress)
    if name == "discrepancy":
        from ves_gym.leaderboard.tracks.diagnosis import DiagnosisTrack

        return DiagnosisTrack(folder, workers, progress)
    if name == "tasks":
        from ves_gym.leaderboard.tracks.tasks import TaskTrack

        return TaskTrack()
    from ves_gym.leaderboard.tracks.damping import DampingTrack
    from ves_gym.leaderboard.tracks.policies import PolicyTrack

    return PolicyTrack() if name == "policies" else DampingTrack()
