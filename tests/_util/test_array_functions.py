"""Functions of arrays: NumPy, the traced graph and the compiled graph give the same."""

import casadi as ca
import numpy as np
import pytest

from ves_gym._util.array_functions import NUMPY
from ves_gym.engine.kernel import build, emit
from ves_gym.engine.kernel.blocks import aligned
from ves_gym.engine.kernel.emit import LANES
from ves_gym.engine.kernel.graph_arrays import GRAPH, column, symbols

NAN = np.nan


def traced(function, *arrays):
    """Value of function(xp, *arrays), traced: by CasADi, and as machine code in every lane."""
    names = [symbols(f"a{k}", a.shape) for k, a in enumerate(arrays)]
    out = np.asarray(function(GRAPH, *names), object)
    x, y = column(names), column([out])
    values = np.concatenate([np.ravel(a) for a in arrays]).astype(float)
    by_casadi = np.array(ca.Function("f", [x], [y])(values)).reshape(out.shape)

    text = emit.emit_map(ca.Function("f", [x, ca.SX.sym("p")], [y]))
    library = build.Library(build.compile_text(text))
    rows, results = aligned(1, values.size, LANES), aligned(1, out.size, LANES)
    rows[0] = values[:, None]
    none = aligned(1, 1, LANES)
    library.map(*(a.ctypes.data for a in (rows, none, results)), 0, 1)
    assert all(np.array_equal(results[0, :, 0], lane, equal_nan=True) for lane in results[0].T)
    return by_casadi, results[0, :, 0].reshape(out.shape)


RNG = np.random.default_rng(0)
A, B = RNG.normal(size=(2, 4, 3))
WHOLE = np.array([0.0, 1.0, 1.0, 0.0, 2.0, -1.0])
TRUTH, OTHER = np.array([[1.0, 1, 0], [0, 0, 0], [1, 1, 1]]), np.array([[1.0, 0, 0]] * 3)
HALVES = np.array([-2.5, -1.5, -0.5, 0.5, 1.5, 2.5, 0.49999999999999994, -7.2, 1e6 + 0.5])
MATRICES = RNG.normal(size=(2, 4, 4)) + 4 * np.eye(4)
MATRICES = MATRICES @ np.swapaxes(MATRICES, -1, -2)
VECTORS = RNG.normal(size=(2, 4))


def filled(xp, a):
    out = xp.zeros((2, *a.shape))
    out[1] = a
    return out


CASES = {
    "zeros": (filled, A),
    "where": (lambda xp, a, b: xp.where(xp.less_equal(a, 0.0), a, b), A, B),
    "where of a row": (
        lambda xp, a, b: xp.where(xp.less_equal(a[:, 0], 0.0)[:, None], a, b), A, B,
    ),
    "less_equal": (lambda xp, a: xp.less_equal(a, WHOLE), WHOLE[::-1].copy()),
    "less_equal of a number": (lambda xp, a: xp.less_equal(1.0, a), WHOLE),
    "not_equal": (lambda xp, a: xp.not_equal(a, 1.0), WHOLE),
    "all": (lambda xp, a: xp.all(xp.not_equal(a, 0.0)), TRUTH),
    "any": (lambda xp, a: xp.any(xp.not_equal(a, 0.0)), TRUTH),
    "both": (
        lambda xp, a, b: xp.both(xp.not_equal(a, 0.0), xp.not_equal(b, 0.0)), TRUTH, OTHER,
    ),
    "either": (
        lambda xp, a, b: xp.either(xp.not_equal(a, 0.0), xp.not_equal(b, 0.0)), TRUTH, OTHER,
    ),
    "negate": (lambda xp, a: xp.negate(xp.not_equal(a, 0.0)), TRUTH),
    "maximum": (lambda xp, a, b: xp.maximum(a, b), A, B),
    "maximum with a number": (lambda xp, a: xp.maximum(a, 0.5), A),
    "largest": (lambda xp, a: xp.largest(a), A),
    "rint": (lambda xp, a: xp.rint(a), HALVES),
    "solve": (lambda xp, a, b: xp.solve(a, b), MATRICES, VECTORS),
    "solve by one matrix": (lambda xp, a, b: xp.solve(a, b), MATRICES[0], VECTORS),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_each_function_is_the_same_traced_and_compiled(name):
    """Tolerance: 0, but for the solution of equations, which NumPy pivots: 1e-13."""
    function, *arrays = CASES[name]
    expected = np.asarray(function(NUMPY, *arrays), float)
    for found in traced(function, *arrays):
        assert found.shape == expected.shape
        if name.startswith("solve"):
            np.testing.assert_allclose(found, expected, rtol=1e-13, atol=1e-13)
        else:
            np.testing.assert_array_equal(found, expected)


def test_every_function_has_a_case():
    names = {k for k in vars(type(NUMPY)) if not k.startswith("_")}
    assert names == {k for k in vars(type(GRAPH)) if not k.startswith("_")}
    assert names == {case.partition(" ")[0] for case in CASES}


NOT_A_NUMBER = {
    "a comparison is false": (lambda xp, a: xp.less_equal(a, 1.0), [NAN, 0.0], [0, 1]),
    "whichever side": (lambda xp, a: xp.less_equal(1.0, a), [NAN, 2.0], [0, 1]),
    "its opposite is true": (
        lambda xp, a: xp.negate(xp.less_equal(a, 1.0)), [NAN, 0.0], [1, 0],
    ),
    "it differs from all": (lambda xp, a: xp.not_equal(a, 0.0), [NAN, 0.0], [1, 0]),
    "one of several is unsafe": (lambda xp, a: xp.all(xp.less_equal(a, 1.0)), [NAN, 0.0], 0),
    "the branch not taken is dropped": (
        lambda xp, a: xp.where(xp.less_equal(a, 1.0), a, 7.0), [NAN, 0.0], [7, 0],
    ),
    "whichever branch": (
        lambda xp, a: xp.where(xp.less_equal(a, 3.0), 2.0 * a, -1.0), [NAN, 2.0], [-1, 4],
    ),
    "the branch taken is kept": (
        lambda xp, a: xp.where(xp.negate(xp.less_equal(a, 3.0)), a, 1.0), [NAN, 2.0], [NAN, 1],
    ),
}  # fmt: skip


@pytest.mark.parametrize("what", NOT_A_NUMBER)
def test_not_a_number(what):
    """What safety checks and held platforms rely on."""
    function, values, expected = NOT_A_NUMBER[what]
    array = np.array(values)
    for found in (function(NUMPY, array), *traced(function, array)):
        np.testing.assert_array_equal(np.asarray(found, float), expected)


@pytest.mark.parametrize(
    "function", [lambda xp, a: xp.maximum(a, 1.0), lambda xp, a: xp.largest(a)]
)
def test_a_maximum_hands_on_what_is_not_a_number(function):
    """In NumPy as compiled, so that a simulation that is lost stays lost in both."""
    array = np.array([[NAN, 2.0, 0.0], [0.0, NAN, 3.0]])
    expected = function(NUMPY, array)
    assert np.isnan(expected).any()
    np.testing.assert_array_equal(traced(function, array)[1], expected)


def test_one_singular_matrix_leaves_the_others_their_answers():
    A = np.stack([2.0 * np.eye(2), np.zeros((2, 2)), np.eye(2)])
    x = NUMPY.solve(A, np.ones((3, 2)))
    np.testing.assert_array_equal(x, [[0.5, 0.5], [np.nan, np.nan], [1.0, 1.0]])
