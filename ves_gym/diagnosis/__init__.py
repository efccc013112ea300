"""Discrepancy workflow: where simulation and data disagree, what is missing, how to add it."""
