"""Reproducible leaderboard: entries, bundles that prove them, and their verification."""
