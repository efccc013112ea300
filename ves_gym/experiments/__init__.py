"""Many runs: units, specifications, sweeps, executors, searches."""
