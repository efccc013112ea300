"""Machines as parts that are each run alone on measured input."""
