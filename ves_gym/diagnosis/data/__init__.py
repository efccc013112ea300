"""Measured runs and recordings, their signals and their quality."""
