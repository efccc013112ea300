"""Evidence of a linear model is its marginal likelihood, by quadrature and in closed form."""

import numpy as np
import pytest
import scipy

from ves_gym.diagnosis.constants import TEMPERATURE
from ves_gym.diagnosis.inference.evidence import laplace
from ves_gym.diagnosis.inference.variance_groups import InnerProducts, solve
from ves_gym.system.candidate import Candidate

N = 200


def problem(seed=0):
    """A residual (N,), two columns of errors with a unit prior, one of a name."""
    rng = np.random.default_rng(seed)
    X = rng.standard_normal((N, 3))
    return -X @ [0.7, -0.4, 1.5] + 0.5 * rng.standard_normal(N), X


def named(usual=1.0):
    one = (usual,)
    return Candidate(
        "joint/coulomb", "", ("joint",), ("torque",), ("N m",), (one,), (-50.0,), (50.0,),
        lambda x: x, (0,),
    )  # fmt: skip


def solved(z, X, fixed):
    return solve(
        InnerProducts(
            np.array([float(N)]), np.array([z @ z]), (X.T @ z)[None], (X.T @ X)[None]
        ),
        fixed,
    )


def test_errors_with_a_normal_prior_are_integrated_out():
    """Reference: density of z ~ N(0, T I + X X^T), SciPy; its constant is left out here.

    Tolerance: numbers are taken at the maximum for T = 1, which costs the square of the way.
    """
    z, X = problem()
    found = solved(z, X, 3)
    told = laplace(found.deviance, found.covariance, found.x, (), (), ())
    T = TEMPERATURE
    exact = scipy.stats.multivariate_normal(cov=T * np.eye(N) + X @ X.T).logpdf(z)
    assert told == pytest.approx(-2 * exact - N * np.log(2 * np.pi * T), abs=0.02)


@pytest.mark.parametrize("usual", [0.3, 1.0, 10.0])
def test_the_number_of_a_name_is_integrated_over_a_cauchy_law(usual):
    """Reference: quadrature of the exact density of z over the prior of the number."""
    z, X = problem()
    found = solved(z, X, 2)
    std = np.sqrt(np.diag(found.covariance)[2:])
    told = laplace(
        found.deviance, found.covariance, found.x[:2], [named(usual)], [found.x[2:]], [std]
    )
    T = TEMPERATURE
    beside = scipy.stats.multivariate_normal(cov=T * np.eye(N) + X[:, :2] @ X[:, :2].T)
    at = np.linspace(found.x[2] - 12 * std[0], found.x[2] + 12 * std[0], 2001)
    density = [beside.logpdf(z + x * X[:, 2]) for x in at]
    weighed = np.exp(np.array(density) - max(density)) * scipy.stats.cauchy(0, usual).pdf(at)
    exact = max(density) + np.log(np.trapezoid(weighed, at))
    assert told == pytest.approx(-2 * exact - N * np.log(2 * np.pi * T), abs=0.05)
