"""From residuals to named effects: whitening, candidates, fits, model selection."""
