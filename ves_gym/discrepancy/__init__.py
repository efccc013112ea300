"""Find where simulation and data disagree, name what is missing, add it, verify it."""
