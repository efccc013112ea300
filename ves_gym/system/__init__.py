"""What is described: system, effects as a concept, emulator settings, run log, energies."""
