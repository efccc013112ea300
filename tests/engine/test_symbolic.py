"""NumPy text as compiled graphs: the same numbers, or a refusal."""

import casadi as ca
import numpy as np
import pytest

from ves_gym.engine.kernel.blocks import aligned, lanes
from ves_gym.engine.kernel.build import Library, compile_text
from ves_gym.engine.kernel.pieces import Piece, Program, emit_pieces, numbers
from ves_gym.engine.kernel.symbolic import Untraceable, column, per_row, symbols

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
    rows = symbols("x", x.shape[1])
    parts = per_row(function, rows, shapes=shapes)
    out = ca.vertcat(*(k for part in parts for k in part))
    graph = ca.Function("graph", [column(rows[0])], [ca.cse(out)])
    library = Library(compile_text(emit_pieces({"graph": graph})))
    points = lanes(x)
    results = aligned(len(points), graph.size1_out(0), 8)
    Program(library, [Piece(library, "graph", [points, results])])(0, len(points))
    return numbers(results, len(x)).T


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
        per_row(function, symbols("x", 3), shapes=(3,))
