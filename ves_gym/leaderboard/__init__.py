"""Reproducible leaderboard: entries, the bundles that prove them, and runs that outgrow a machine."""
