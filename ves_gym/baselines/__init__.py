"""Baselines: controllers, training, evaluation, and the policies that come with the package."""
