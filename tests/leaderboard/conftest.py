"""Made-up entries and scores."""

import numpy as np
import pytest

from tests.entries import made_entry


@pytest.fixture
def make_entry():
    return made_entry


@pytest.fixture
def noisy_scores():
    """n scores around a level, the same every time."""

    def make(level, n=50, seed=0, failed=0):
        values = level * np.exp(0.3 * np.random.default_rng(seed).normal(size=n))
        return [None if k < failed else float(v) for k, v in enumerate(values)]

    return make
