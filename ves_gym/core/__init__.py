"""Physics: parameters, arm, vehicles, system, simulator, motion, energy, run log."""
