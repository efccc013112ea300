"""Effects: named physical deviations from the nominal system, one per file."""
