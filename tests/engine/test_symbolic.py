"""NumPy text as compiled graphs: the same numbers, or a refusal."""

import casadi as ca
import numpy as np
import pytest

from ves_gym.engine.kernel.build import LANES
from ves_gym.engine.kernel.compiled_function import CompiledFunction
from ves_gym.engine.kernel.symbolic import (
    Untraceable,
    batch_of_symbols,
    column,
    expressions,
    per_row,
    symbols,
)
from ves_gym.mechanics.spatial import solve, solve_symmetric

A = np.arange(9.0).reshape(3, 3) - 3


def text(x):
    """What tasks are written in."""
    near = (np.abs(x) <= 0.5).all(axis=1) | (x[:, 0] > 2)
    raised = np.stack([x[:, 0], x[:, 1]], axis=1)
    raised[:, 1] += 1.0
    np.maximum(raised, 0.1, out=raised)
    return (
        np.clip(x, -1, 1),
        near & ~(x[:, 1] < 0),
        np.where(near, np.linalg.norm(x, axis=1), np.log10(np.abs(x[:, 0]))),
        raised,
        np.floor(x / 0.3 + 0.5),
        np.matmul(A, x[..., None])[..., 0].sum(axis=-1) ** 2,
        x.astype(np.float32),
        100 * 4.0 ** ((x[:, :1] + 1) / 2),
        np.column_stack([x[:, 0], x.swapaxes(0, 1)[1], x.mean(axis=1)]),
        np.sqrt(np.square(x)) - np.minimum(x, 0) * np.tanh(x),
    )


def compiled(function, x, shapes):
    """(n, all results) of a function in compiled code."""
    rows = batch_of_symbols("x", x.shape[1])
    parts = per_row(function, rows, shapes=shapes)
    out = ca.vertcat(*(k for part in parts for k in part))
    graph = ca.Function("graph", [column(rows[0])], [ca.cse(out)])
    return CompiledFunction(None, lambda: graph)(x)


def test_a_compiled_text_gives_numpys_numbers():
    x = np.random.default_rng(0).uniform(-3, 3, (203, 3))
    shapes = (3, 1, 1, 2, 3, 1, 3, 1, 3, 3)
    expected = np.concatenate(
        [np.asarray(k, float).reshape(len(x), -1) for k in text(x)], axis=1
    )
    np.testing.assert_allclose(compiled(text, x, shapes), expected, rtol=1e-13, atol=1e-13)


def test_the_logarithm_is_exact_to_rounding_everywhere():
    """Reference: NumPy's; ends of the range and what is no number included."""
    x = np.exp(np.random.default_rng(1).uniform(-700, 700, (400, 1)))
    odd = [1.0, 0.0, -1.0, np.inf, np.nan, 5e-310, np.nextafter(1, 2), np.nextafter(1, 0)]
    x = np.concatenate([x, np.array(odd)[:, None]])
    with np.errstate(all="ignore"):
        expected = np.log(x)
    np.testing.assert_allclose(
        compiled(lambda k: (np.log(k),), x, (1,)), expected, rtol=3e-16, atol=0
    )


def test_the_angle_of_a_point_is_exact_to_rounding():
    """Reference: NumPy's, in all quadrants and on the axes, at any distance."""
    rng = np.random.default_rng(3)
    x = rng.normal(size=(4000, 2)) * 10.0 ** rng.uniform(-12, 3, (4000, 2))
    x = np.concatenate([x, [[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, -1.0], [0.0, 1.0]]])
    found = compiled(lambda k: (np.arctan2(k[:, 1], k[:, 0]),), x, (1,))[:, 0]
    np.testing.assert_allclose(found, np.arctan2(x[:, 1], x[:, 0]), rtol=5e-16, atol=0)


def test_rounding_to_single_precision_is_numpys():
    x = (
        np.random.default_rng(2).normal(size=(100, 1))
        * 10.0 ** np.arange(-20, 30, 0.5)[:, None]
    )
    ours = compiled(lambda k: (k.astype(np.float32),), x, (1,))
    np.testing.assert_array_equal(ours, x.astype(np.float32).astype(float))


@pytest.mark.parametrize(
    "function",
    [
        lambda x: (x if x[0, 0] > 0 else -x,),
        lambda x: (x * len(np.flatnonzero(x)),),
        lambda x: (x - x[::-1],),
        lambda x: (x / x.sum(axis=0),),
        lambda x: (x * np.arange(2)[:, None],),
        lambda x: (np.arctan(x),),
        lambda x: (np.sort(x, axis=1),),
        lambda x: (np.asarray(x, dtype=float),),
        lambda x: (x[:, :2],),
    ],
    ids=["if", "index", "neighbour", "sum", "row", "unknown", "sort", "float", "shape"],
)
def test_what_is_no_formula_of_a_row_is_refused(function):
    with pytest.raises((Untraceable, TypeError, RuntimeError, ValueError)):
        per_row(function, batch_of_symbols("x", 3), shapes=(3,))


# ------------------------------------------------- what blocks and equations are written in

NAN = np.nan
RNG = np.random.default_rng(0)
A2, B2 = RNG.normal(size=(2, 4, 3))
WHOLE = np.array([0.0, 1.0, 1.0, 0.0, 2.0, -1.0])
HALVES = np.array([-2.5, -1.5, -0.5, 0.5, 1.5, 2.5, 0.49999999999999994, -7.2, 1e6 + 0.5])
MATRICES = RNG.normal(size=(2, 4, 4)) + 4 * np.eye(4)
MATRICES = MATRICES @ np.swapaxes(MATRICES, -1, -2)
VECTORS = RNG.normal(size=(2, 4))


def filled(a):
    out = np.zeros_like(a, shape=(2, *a.shape))
    out[1] = a
    return out


CASES = {
    "zeros_like": (filled, A2),
    "where": (lambda a, b: np.where(a <= 0.0, a, b), A2, B2),
    "where of a row": (lambda a, b: np.where(a[:, :1] <= 0.0, a, b), A2, B2),
    "comparisons": (lambda a: np.stack([a <= WHOLE, a > 1.0, a != 1.0, a == 1.0]), WHOLE[::-1]),
    "all": (lambda a: (a != 0.0).all(axis=-1), WHOLE.reshape(2, 3)),
    "any": (lambda a: (a != 0.0).any(axis=-1), WHOLE.reshape(2, 3)),
    "both": (lambda a: (a > 0.0) & (a < 2.0), WHOLE),
    "either": (lambda a: (a < 0.0) | (a > 1.0), WHOLE),
    "negated": (lambda a: ~(a != 0.0), WHOLE),
    "maximum": (lambda a, b: np.maximum(a, np.maximum(b, 0.5)), A2, B2),
    "largest": (lambda a: a.max(axis=-1), A2),
    "rint": (np.rint, HALVES),
    "sum of nothing": (lambda a: a[:, 3:].sum(axis=1) + a[0, 3:].sum(axis=0), A2),
    "cumsum": (lambda a: np.cumsum(a, axis=0), A2),
    "products with vectors": (lambda a, b: a @ b[0] + b[1] @ a.T + b[0] @ b[1], A2, B2),
    "solve": (solve, MATRICES, VECTORS),
    "solve by one matrix": (lambda a, b: solve(a, b[0]), MATRICES[0], VECTORS),
    "solve, symmetric": (
        lambda a, b: solve_symmetric(a, b[..., None])[..., 0], MATRICES, VECTORS,
    ),
}  # fmt: skip


def both_ways(function, *arrays):
    """Value of function(*arrays) by CasADi, and as machine code in every lane."""
    names = [symbols(f"a{k}", a.shape) for k, a in enumerate(arrays)]
    out = function(*names)
    x, y = column(*names), column(out)
    values = np.concatenate([np.ravel(a) for a in arrays]).astype(float)
    by_casadi = np.array(ca.Function("f", [x], [y])(values)).reshape(out.shape)
    function = CompiledFunction(None, lambda: ca.Function("f", [x], [y]))
    lanes = function(np.tile(values, (LANES, 1)))
    assert all(np.array_equal(lanes[0], lane, equal_nan=True) for lane in lanes)
    return by_casadi, lanes[0].reshape(out.shape)


@pytest.mark.parametrize("name", CASES)
def test_each_function_is_the_same_traced_and_compiled(name):
    """Tolerance: 0, but for sums, which the machine may fuse, and equations: 1e-13."""
    function, *arrays = CASES[name]
    expected = np.asarray(function(*arrays), float)
    rounding = 1e-13 if name.startswith(("solve", "products")) else 0
    for found in both_ways(function, *arrays):
        assert found.shape == expected.shape
        np.testing.assert_allclose(found, expected, rtol=rounding, atol=rounding)


NOT_A_NUMBER = {
    "a comparison is false": (lambda a: a <= 1.0, [NAN, 0.0], [0, 1]),
    "whichever side": (lambda a: a >= 1.0, [NAN, 2.0], [0, 1]),
    "its opposite is true": (lambda a: ~(a <= 1.0), [NAN, 0.0], [1, 0]),
    "it differs from all": (lambda a: a != 0.0, [NAN, 0.0], [1, 0]),
    "one of several is unsafe": (lambda a: (a <= 1.0).all(axis=-1), [NAN, 0.0], 0),
    "the branch not taken": (lambda a: np.where(a <= 1.0, a, 7.0), [NAN, 0.0], [7, 0]),
    "whichever branch": (lambda a: np.where(a <= 3.0, 2.0 * a, -1.0), [NAN, 2.0], [-1, 4]),
    "the branch taken": (lambda a: np.where(~(a <= 3.0), a, 1.0), [NAN, 2.0], [NAN, 1]),
}


@pytest.mark.parametrize("what", NOT_A_NUMBER)
def test_not_a_number(what):
    """What safety checks and held platforms rely on."""
    function, values, expected = NOT_A_NUMBER[what]
    array = np.array(values)
    for found in (function(array), *both_ways(function, array)):
        np.testing.assert_array_equal(np.asarray(found, float), expected)


@pytest.mark.parametrize("function", [lambda a: np.maximum(a, 1.0), lambda a: a.max(axis=-1)])
def test_a_maximum_hands_on_what_is_not_a_number(function):
    """In NumPy as compiled, so that a simulation that is lost stays lost in both."""
    array = np.array([[NAN, 2.0, 0.0], [0.0, NAN, 3.0]])
    assert np.isnan(function(array)).any()
    np.testing.assert_array_equal(both_ways(function, array)[1], function(array))


def test_an_exact_zero_or_one_leaves_no_instruction():
    """What a system has not is no part of its code."""
    x = symbols("x", (3,))
    out = x @ np.diag([1.0, 0.0, 1.0]) + np.zeros(3)
    assert expressions(out)[1] == 0.0
    graph = ca.Function("f", [column(x)], [column(out)])
    assert graph.n_instructions() == 3 + 3  # two inputs read, three outputs and a zero


def test_one_singular_matrix_leaves_the_others_their_answers():
    A = np.stack([2.0 * np.eye(2), np.zeros((2, 2)), np.eye(2)])
    np.testing.assert_array_equal(
        solve(A, np.ones((3, 2))), [[0.5, 0.5], [np.nan, np.nan], [1.0, 1.0]]
    )
