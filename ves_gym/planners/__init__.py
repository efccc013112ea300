"""Planners: paths between two arm configurations that disturb the base least."""
