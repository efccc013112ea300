"""Damping a swaying base with the arm: joint gains (PPED), good configurations, an observer."""
