"""Scores of candidates against exact fits, where a port is known to the last digit."""

import types

import numpy as np
import pytest

from ves_gym.diagnosis.inference.candidates import Candidate
from ves_gym.diagnosis.inference.signatures import Signatures
from ves_gym.diagnosis.inference.variance_groups import products, solve

COUNT = 4000  # numbers of each of two ports


def candidate(name):
    """A candidate of one number, which is its own model."""
    bounds = {"low": (-1e9,), "high": (1e9,), "starts": ((1.0,),), "factors": (0,)}
    return Candidate(name, "", ("both",), ("x",), ("1",), make=lambda x: (name, *x), **bounds)


def machine_of(loudness):
    """Residuals of two ports: at the first a tolerance is `loudness` times the noise.

    Candidates act at the second alone; at the first alone as that tolerance does, and a little
    otherwise; and nowhere. Hidden is the first of them, at ten times the noise.
    """
    rng = np.random.default_rng(0)
    parts = slice(0, COUNT), slice(COUNT, 2 * COUNT)
    groups = [
        types.SimpleNamespace(part=p, n=COUNT, copies=(), priced=True, floor=0.0) for p in parts
    ]
    slopes, columns = np.zeros((2 * COUNT, 2)), {k: np.zeros(2 * COUNT) for k in "abc"}
    loud = loudness * rng.standard_normal(COUNT)
    slopes[parts[0], 0], slopes[parts[1], 1] = loud, rng.standard_normal(COUNT)
    columns["a"][parts[1]] = rng.standard_normal(COUNT) / np.sqrt(COUNT)
    columns["b"][parts[0]] = 30.0 * loud + rng.standard_normal(COUNT)
    null = rng.standard_normal(2 * COUNT) + slopes @ [0.2, 0.3] - 10.0 * columns["a"]

    def silent(group, a, b=None):
        return np.zeros((a.shape[1], (a if b is None else b).shape[1]))

    def under(models, ports):
        return np.stack([null + x * columns[name] for ((name, x),) in models])

    return types.SimpleNamespace(
        slopes=slopes, null=null, under=under, groups=groups, length=2 * COUNT,
        size=2 * COUNT, measured=np.arange(2 * COUNT), nuisances=("loud", "other"),
        gram=np.stack([slopes[p].T @ slopes[p] for p in parts]),
        noise_gram=np.zeros((2, 2, 2)),
        noise_product=silent,
        machine=types.SimpleNamespace(model=lambda effects: tuple(effects)),
    ), columns  # fmt: skip


@pytest.mark.parametrize("loudness", [1.0, 1e5])
def test_a_score_is_the_gain_of_a_fit(loudness):
    """Claim: scores are exact to 0.5 in deviance however loud a tolerance is.

    With tolerances in single precision every score was off by hundreds where a port was off by
    1e5 times its noise, so that nothing but the tolerance's own likeness was tried.
    """
    residuals, columns = machine_of(loudness)
    none = np.zeros((residuals.length, 0))
    null = solve(products(residuals, residuals.null, none), 2)
    signatures = Signatures(residuals, [candidate(k) for k in "abc"])
    for name, score in zip(
        "abc", signatures.scores(residuals.null, none, null.size), strict=True
    ):
        exact = solve(products(residuals, residuals.null, columns[name][:, None]), 2)
        assert score.deviance == pytest.approx(exact.deviance, abs=0.5), name
    gain = null.deviance - signatures.scores(residuals.null, none, null.size)[0].deviance
    assert 40 < gain < 200
