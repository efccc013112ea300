"""Reproducible leaderboard: entries, bundles that prove them, runs that outgrow a machine."""
