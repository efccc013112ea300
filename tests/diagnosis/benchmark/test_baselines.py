"""Baselines, on signatures made by hand."""

from types import SimpleNamespace

import numpy as np
import pytest

from ves_gym.diagnosis.benchmark.baselines import Baselines
from ves_gym.diagnosis.inference.signatures import SignatureBlock


def candidate(name, low=-10.0, high=10.0):
    return SimpleNamespace(name=name, k=1, low=(low,), high=(high,))


@pytest.fixture
def problem():
    """500 numbers of noise, three signatures, and a tolerance like the last of them."""
    rng = np.random.default_rng(0)
    columns = rng.standard_normal((500, 3)).astype(np.float32)
    candidates = [candidate("a"), candidate("b", low=0.0), candidate("c")]
    blocks = [SignatureBlock(i, (i,), (0.0,), (0,)) for i in range(3)]
    signatures = SimpleNamespace(columns=columns, candidates=candidates, blocks=blocks)

    def residuals(*size):
        z = rng.standard_normal(500) - columns @ np.array(size)
        slopes = 10.0 * columns[:, 2:].astype(float)
        return SimpleNamespace(size=500, null=z, slopes=slopes, measured=slice(None))

    return signatures, residuals


def found(named):
    return {n.candidate.name: float(n.values[0]) for n in named}


def test_stepwise_names_what_is_there(problem):
    signatures, residuals = problem
    two = found(Baselines(residuals(3.0, 2.0, 0.0), signatures).stepwise())
    assert two == {"a": pytest.approx(3.0, abs=0.2), "b": pytest.approx(2.0, abs=0.2)}
    assert found(Baselines(residuals(0.0, 0.0, 0.0), signatures).stepwise()) == {}


def test_numbers_stay_in_their_ranges(problem):
    signatures, residuals = problem
    assert "b" not in found(Baselines(residuals(0.0, -3.0, 0.0), signatures).stepwise())


def test_smallest_error_always_names_one(problem):
    signatures, residuals = problem
    assert set(found(Baselines(residuals(0.0, 0.0, 1.0), signatures).smallest_error())) == {"c"}
    assert len(Baselines(residuals(0.0, 0.0, 0.0), signatures).smallest_error()) == 1


def test_a_tolerance_is_named_unless_it_is_allowed_for(problem):
    signatures, residuals = problem
    some = residuals(2.0, 0.0, 1.0)
    assert set(found(Baselines(some, signatures).stepwise())) == {"a", "c"}
    assert set(found(Baselines(some, signatures, tolerances=True).stepwise())) == {"a"}
