"""Baselines, on signatures made by hand."""

from types import SimpleNamespace

import numpy as np
import pytest

from ves_gym.diagnosis.benchmark.baselines import Baselines
from ves_gym.diagnosis.inference.signatures import Shape


def candidate(name, low=-10.0, high=10.0):
    return SimpleNamespace(name=name, k=1, low=(low,), high=(high,))


@pytest.fixture
def problem():
    """500 numbers of noise, three signatures, and a tolerance like the last of them."""
    rng = np.random.default_rng(0)
    columns = rng.standard_normal((500, 3)).astype(np.float32)
    candidates = [candidate("a"), candidate("b", low=0.0), candidate("c")]
    shapes = [Shape(i, (i,), (0.0,), (0,)) for i in range(3)]
    bank = SimpleNamespace(columns=columns, candidates=candidates, shapes=shapes)

    def evidence(*size):
        z = rng.standard_normal(500) - columns @ np.array(size)
        return SimpleNamespace(size=500, null=z, slopes=10.0 * columns[:, 2:].astype(float))

    return bank, evidence


def found(named):
    return {n.candidate.name: float(n.values[0]) for n in named}


def test_stepwise_names_what_is_there(problem):
    bank, evidence = problem
    two = found(Baselines(evidence(3.0, 2.0, 0.0), bank).stepwise())
    assert two == {"a": pytest.approx(3.0, abs=0.2), "b": pytest.approx(2.0, abs=0.2)}
    assert found(Baselines(evidence(0.0, 0.0, 0.0), bank).stepwise()) == {}


def test_numbers_stay_in_their_ranges(problem):
    bank, evidence = problem
    assert "b" not in found(Baselines(evidence(0.0, -3.0, 0.0), bank).stepwise())


def test_smallest_error_always_names_one(problem):
    bank, evidence = problem
    assert set(found(Baselines(evidence(0.0, 0.0, 1.0), bank).smallest_error())) == {"c"}
    assert len(Baselines(evidence(0.0, 0.0, 0.0), bank).smallest_error()) == 1


def test_a_tolerance_is_named_unless_it_is_allowed_for(problem):
    bank, evidence = problem
    some = evidence(2.0, 0.0, 1.0)
    assert set(found(Baselines(some, bank).stepwise())) == {"a", "c"}
    assert set(found(Baselines(some, bank, tolerances=True).stepwise())) == {"a"}
