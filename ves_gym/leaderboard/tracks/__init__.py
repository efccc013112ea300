"""Tracks of the leaderboard: how their problems are answered and replayed."""
