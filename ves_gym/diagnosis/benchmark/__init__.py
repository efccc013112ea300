"""How well the diagnosis works: cases with hidden effects, answers, scores."""
