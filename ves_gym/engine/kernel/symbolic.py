"""NumPy text as a graph: arrays of CasADi symbols that go through functions written in NumPy.

A function of arrays is called with symbols instead of numbers; what it returns is its formula,
which the kernel compiles. Entries may also be numbers: an exact 0 or 1 leaves no instruction,
so that what a system has not is no part of its code. Whatever needs a number to go on (an
`if`, an index, a conversion) raises, and the function stays in NumPy.
"""

from __future__ import annotations

import functools
import itertools
import math
import operator
from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    import casadi

_TAN_EIGHTH = math.tan(math.pi / 8)
# (t - atan t) / t^3 in powers of t^2, |t| <= 7/16 (coefficients of fdlibm)
_ATAN = (
    3.33333333333329318027e-01, -1.99999999998764832476e-01, 1.42857142725034663711e-01,
    -1.11111104054623557880e-01, 9.09088713343650656196e-02, -7.69187620504482999495e-02,
    6.66107313738753120669e-02, -5.83357013379057348645e-02, 4.97687799461593236017e-02,
    -3.65315727442169155270e-02, 1.62858201153657823623e-02,
)  # fmt: skip
_ROWS = 2  # simulations that a function is followed with: none may look at the other


class Untraceable(TypeError):
    """A function that cannot be traced; it is called in NumPy."""


class Term:
    """An expression in an array, and no number: `float` of a CasADi symbol would be NaN."""

    __slots__ = ("value",)

    def __init__(self, value: Any) -> None:
        self.value = value

    def __bool__(self) -> bool:
        raise Untraceable("a formula asks whether an expression is true")


class Traced(np.ndarray):
    """An array of terms. Shapes are NumPy's, and so is the text; only numbers are missing."""

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **kwargs: Any) -> Any:
        """Build expressions where NumPy would compute (NEP 13)."""
        out = kwargs.pop("out", (None,))[0]
        parts = [_objects(k) for k in inputs]
        for harmless in ("casting", "subok", "dtype"):
            kwargs.pop(harmless, None)
        if method == "__call__" and not kwargs:
            value = (
                _matmul(*parts) if ufunc is np.matmul else _elementwise(ufunc.__name__, parts)
            )
        elif method == "reduce":
            value = _reduced(ufunc.__name__, parts[0], **kwargs)
        elif method == "accumulate":
            value = _accumulated(ufunc.__name__, parts[0], **kwargs)
        else:
            raise Untraceable(f"numpy.{ufunc.__name__}.{method} with {', '.join(kwargs)}")
        if out is None:
            return _traced(value)
        out[...] = value
        return out

    def __array_function__(self, func: Any, types: Any, args: Any, kwargs: Any) -> Any:
        """Replace the functions that would ask an expression for its value (NEP 18)."""
        if func is np.where and len(args) == 3:
            return _traced(_elementwise("where", [_objects(k) for k in args]))
        if func is np.linalg.norm:
            return _norm(*args, **kwargs)
        if func is np.linalg.solve:
            return _solved(*map(_traced, args))
        if func is np.zeros_like:  # a shape may be given; NumPy would fill in whole numbers
            return _traced(np.zeros(kwargs.get("shape", np.shape(args[0]))))
        out = super().__array_function__(func, types, args, kwargs)
        return _traced(out) if isinstance(out, np.ndarray) and out.dtype == object else out

    def astype(self, dtype: Any, *args: Any, **kwargs: Any) -> Any:
        """Round to float32; float64 they are; anything else is refused."""
        if np.dtype(dtype) == np.float64:
            return self.copy()
        if np.dtype(dtype) != np.float32:
            raise Untraceable(f"symbols have no type {np.dtype(dtype)}")
        return _traced(_elementwise("single", [_objects(self)]))


def symbols(name: str, shape: tuple[int, ...]) -> Traced:
    """Return fresh symbols, name_0 and so on.

    Args:
        name: what they are called.
        shape: of the array.
    """
    import casadi as ca

    size = math.prod(shape)
    return traced(ca.vertsplit(ca.SX.sym(name, size)) if size else (), shape)


def traced(entries: Iterable[Any], shape: tuple[int, ...]) -> Traced:
    """Return expressions and numbers as an array.

    Args:
        entries: row by row; CasADi's, or numbers.
        shape: of the array.
    """
    out = np.empty(math.prod(shape), object)
    for k, entry in enumerate(entries):  # at once, NumPy would look into them
        out[k] = float(entry) if isinstance(entry, int | float) else Term(entry)
    return out.reshape(shape).view(Traced)


def batch_of_symbols(name: str, columns: int) -> Traced:
    """(2, columns) symbols: the rows of `per_row`."""
    return symbols(name, (_ROWS, columns))


def per_row(
    function: Callable[..., tuple[Any, ...]], *rows: Traced, shapes: tuple[int, ...]
) -> list[list[Any]]:
    """Expressions that a function of rows gives for any one of them.

    Args:
        function: of arrays, a simulation per row.
        rows: its arguments, from `batch_of_symbols`.
        shapes: number of columns of each of its results.

    Returns:
        Per result its columns, in the first row's symbols.

    Raises:
        Untraceable: a result of another shape, or a row that depends on others.
    """
    import casadi as ca

    results = function(*rows)
    first, second = (column(*(part[i] for part in rows)) for i in range(_ROWS))
    out = []
    for result, width in zip(results, shapes, strict=True):
        array = _objects(result)
        if array.ndim == 1:
            array = array[:, None]
        if array.shape != (_ROWS, width):
            raise Untraceable(f"expected {(_ROWS, width)}, got {array.shape}")
        expression, other = map(column, array)
        mixed = width and (ca.depends_on(expression, second) or ca.depends_on(other, first))
        if mixed or _text(first, expression) != _text(second, other):
            raise Untraceable("a simulation's numbers depend on those of others")
        out.append(list(ca.vertsplit(expression)) if width else [])
    return out


def column(*arrays: npt.ArrayLike) -> casadi.SX:
    """All entries of arrays of terms or numbers, row by row, one under the other."""
    import casadi as ca

    flat = [k for array in arrays for k in expressions(array)]
    return ca.vertcat(*flat) if flat else ca.SX(0, 1)


def expressions(array: npt.ArrayLike) -> list[Any]:
    """Entries of an array row by row: CasADi's expressions, or numbers."""
    return [_expression(k) for k in _objects(array).ravel()]


def _text(x: Any, y: Any) -> str:
    """Instructions of a graph, the same for the same graph of other symbols."""
    import casadi as ca

    f = ca.Function("row", [x], [y], {"allow_free": True})
    lines = []
    for k in range(f.n_instructions()):
        constant = f.instruction_constant(k) if f.instruction_id(k) == ca.OP_CONST else None
        where = f.instruction_input(k), f.instruction_output(k)
        lines.append(f"{f.instruction_id(k)} {where} {constant}")
    return "\n".join(lines)


@functools.cache
def single() -> casadi.Function:
    """Rounding to float32: the one function that graphs call and the kernel knows by itself."""
    import casadi as ca

    x = ca.SX.sym("x")
    return ca.Function("single", [x], [x], {"never_inline": True})


# ------------------------------------------------------------------------- operations


def _objects(value: Any) -> npt.NDArray[np.object_]:
    """Plain array of objects: expressions and floats."""
    if isinstance(value, Term):
        out = np.empty((), object)
        out[()] = value
        return out
    array = np.asarray(value).view(np.ndarray)
    if array.dtype == object:
        return array
    if array.dtype.kind not in "fiub":
        raise Untraceable(f"symbols with {array.dtype}")
    return array.astype(float).astype(object)


def _traced(value: Any) -> Traced:
    return _objects(value).view(Traced)


def _elementwise(name: str, parts: list[npt.NDArray[np.object_]]) -> Any:
    operations = _operations()
    if name not in operations:
        raise Untraceable(f"numpy.{name} has no formula; known: {', '.join(operations)}")
    return _apply(operations[name], *parts)


def _apply(operation: Callable[..., Any], *parts: Any) -> Any:
    def apply(*args: Any) -> Any:
        value = operation(*map(_expression, args))
        return value if isinstance(value, float) else Term(value)

    with np.errstate(all="ignore"):  # NumPy 2.0 takes flags that CasADi leaves for its own
        return np.frompyfunc(apply, len(parts), 1)(*parts)


def _expression(item: Any) -> Any:
    return item.value if isinstance(item, Term) else item


def _matmul(a: npt.NDArray[np.object_], b: npt.NDArray[np.object_]) -> Any:
    rows, columns = a.ndim > 1, b.ndim > 1
    a, b = a if rows else a[None], b if columns else b[:, None]
    terms = _elementwise("multiply", [a[..., :, :, None], b[..., None, :, :]])
    out = _reduced("add", terms, axis=-2)
    out = out if rows else out[..., 0, :]
    return out if columns else out[..., 0]


def _solved(A: Any, b: Any) -> Any:
    """A^-1 b (..., m, c) by elimination without exchange, from the last row up.

    The joints are eliminated before their base, so that heavy ones cost the base no digits.
    """
    rows = []
    for k in reversed(range(A.shape[-1])):
        inverse = 1.0 / A[..., k, k, None]
        rows.append((A[..., k, :k], b[..., k, :], inverse))
        factor = (A[..., :k, k] * inverse)[..., None]
        A, b = (x[..., :k, :] - factor * x[..., k, None, :] for x in (A[..., :k], b))
    out: list[Any] = []
    for row, rhs, inverse in reversed(rows):
        for j, solved in enumerate(out):
            rhs = rhs - row[..., j, None] * solved
        out.append(rhs * inverse)
    return np.stack(out, axis=-2)


def _reduced(
    name: str,
    array: npt.NDArray[np.object_],
    axis: Any = 0,
    keepdims: bool = False,
    **others: Any,
) -> Any:
    if any(k not in ("initial", "where") for k in others) or axis is None:
        raise Untraceable(f"numpy.{name} over everything")
    if isinstance(axis, tuple):
        for k in sorted((k % array.ndim for k in axis), reverse=True):
            array = np.asarray(_reduced(name, array, k, keepdims), object)
        return array
    combine = _operations()[name]
    if not array.shape[axis] and name == "add":
        return np.zeros(array.shape).sum(axis=axis, keepdims=keepdims)
    out = functools.reduce(
        lambda a, b: _apply(combine, a, b), list(np.moveaxis(array, axis, 0))
    )
    return np.expand_dims(out, axis) if keepdims else out


def _accumulated(name: str, array: npt.NDArray[np.object_], axis: int = 0) -> Any:
    combine = _operations()[name]
    parts = list(np.moveaxis(array, axis, 0))
    out = itertools.accumulate(parts, lambda a, b: np.asarray(_apply(combine, a, b), object))
    return np.stack(list(out), axis=axis)


def _norm(x: Any, ord: Any = None, axis: Any = None, keepdims: bool = False) -> Any:
    if ord is not None or not isinstance(axis, int):
        raise Untraceable("numpy.linalg.norm other than along one axis")
    return np.sqrt(np.sum(x * x, axis=axis, keepdims=keepdims))


def _sum(a: Any, b: Any) -> Any:
    """a + b, where an exact 0 is none."""
    if isinstance(a, float) and a == 0.0:
        return b
    return a if isinstance(b, float) and b == 0.0 else a + b


def _difference(a: Any, b: Any) -> Any:
    """a - b, where an exact 0 is none."""
    if isinstance(b, float) and b == 0.0:
        return a
    return -b if isinstance(a, float) and a == 0.0 else a - b


def _product(a: Any, b: Any) -> Any:
    """a b, where an exact 0 leaves nothing and an exact 1 the other."""
    for x, y in ((a, b), (b, a)):
        if isinstance(x, float) and x in (0.0, 1.0):
            return y if x else 0.0
    return a * b


def _power(a: Any, b: Any) -> Any:
    import casadi as ca

    if isinstance(b, float):
        if b == int(b) and 1 <= b <= 8:
            return functools.reduce(operator.mul, [a] * int(b))
        raise Untraceable(f"power {b}")
    if isinstance(a, float) and a > 0:
        return ca.exp(float(np.log(a)) * b)
    raise Untraceable("power of two expressions")


def _arctan2(y: Any, x: Any) -> Any:
    """Angle of (x, y), of operations that the kernel has; 0 at the origin."""
    import casadi as ca

    a, b = ca.fabs(x), ca.fabs(y)
    t = ca.fmin(a, b) / ca.fmax(ca.fmax(a, b), 1e-300)  # of the nearer axis, 0 to 1
    far = t > _TAN_EIGHTH
    t = ca.if_else(far, (t - 1) / (t + 1), t)
    series = functools.reduce(lambda sum, c: sum * t * t + c, reversed(_ATAN))
    angle = ca.if_else(far, np.pi / 4, 0.0) + (t - t * t * t * series)
    angle = ca.if_else(b > a, np.pi / 2 - angle, angle)
    angle = ca.if_else(x < 0, np.pi - angle, angle)
    return ca.if_else(y < 0, -angle, angle)


@functools.cache
def _operations() -> Mapping[str, Callable[..., Any]]:
    """Each elementwise operation of NumPy as a graph's; truth is 1, falsehood 0."""
    import casadi as ca

    def where(condition: Any, yes: Any, no: Any) -> Any:
        if isinstance(condition, float):
            return yes if condition else no
        return ca.if_else(condition, yes, no)

    def either(f: Any, g: Any) -> Callable[..., Any]:
        """`f` of expressions, `g` where there are only numbers."""

        def apply(*args: Any) -> Any:
            if any(isinstance(k, ca.SX) for k in args):
                return f(*args)
            return float(g(*args))

        return apply

    table: dict[str, Callable[..., Any]] = {
        "add": _sum,
        "subtract": _difference,
        "multiply": _product,
        "divide": operator.truediv,
        "negative": operator.neg,
        "positive": operator.pos,
        "square": lambda a: a * a,
        "power": either(_power, np.power),
        "where": where,
        "single": either(single(), np.float32),
        "clip": either(lambda a, low, high: ca.fmin(ca.fmax(a, low), high), np.clip),
        "absolute": either(ca.fabs, np.abs),
        # what the kernel makes of remainder(x, 1): x less the nearest whole number
        "rint": either(lambda a: a - ca.remainder(a, 1.0), np.rint),
    }
    same = ("sqrt", "sin", "cos", "exp", "tanh", "log", "log10", "floor", "sign")
    table |= {name: either(getattr(ca, name), getattr(np, name)) for name in same}
    table["fabs"] = table["absolute"]
    others = {
        "arctan2": _arctan2,
        "maximum": ca.fmax,
        "minimum": ca.fmin,
        "less": operator.lt,
        "less_equal": operator.le,
        "greater": operator.gt,
        "greater_equal": operator.ge,
        "equal": operator.eq,
        "not_equal": operator.ne,
        "logical_and": ca.logic_and,
        "logical_or": ca.logic_or,
        "logical_not": ca.logic_not,
    }
    table |= {name: either(f, getattr(np, name)) for name, f in others.items()}
    table |= {
        "bitwise_and": table["logical_and"],
        "bitwise_or": table["logical_or"],
        "invert": table["logical_not"],
    }
    return table
