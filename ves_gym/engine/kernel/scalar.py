"""CasADi graphs as C++ text, one simulation a thread: what a GPU runs.

The graphs, integrators and order of the parameters are those of `emit.py`. A value of the graph
becomes one variable. Quantities lie in rows of all simulations, so that neighbouring threads
read neighbouring numbers.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

from ves_gym._util.params import ParameterError

if TYPE_CHECKING:
    import casadi

# names of the C++ types that `real` may be
REALS = {"float64": "double", "float32": "float"}

_OPERATIONS = {
    "OP_ASSIGN": "{a}",
    "OP_ADD": "{a} + {b}",
    "OP_SUB": "{a} - {b}",
    "OP_MUL": "{a} * {b}",
    "OP_DIV": "{a} / {b}",
    "OP_NEG": "-{a}",
    "OP_SQ": "{a} * {a}",
    "OP_TWICE": "{a} + {a}",
    "OP_INV": "one / {a}",
    "OP_SIN": "wp::sin({a})",
    "OP_COS": "wp::cos({a})",
    "OP_SQRT": "wp::sqrt({a})",
    "OP_EXP": "wp::exp({a})",
    "OP_LOG": "wp::log({a})",
    "OP_FLOOR": "wp::floor({a})",
    "OP_TANH": "wp::tanh({a})",
    "OP_FABS": "wp::abs({a})",
    # what is not a number comes through, as in NumPy
    "OP_FMIN": "({a} < {b} || {a} != {a}) ? {a} : {b}",
    "OP_FMAX": "({a} > {b} || {a} != {a}) ? {a} : {b}",
    "OP_LT": "{a} < {b} ? one : zero",
    "OP_LE": "{a} <= {b} ? one : zero",
    "OP_EQ": "{a} == {b} ? one : zero",
    "OP_NE": "{a} != {b} ? one : zero",
    "OP_NOT": "{a} == zero ? one : zero",
    "OP_AND": "{a} * {b}",
    "OP_OR": "{a} != zero || {b} != zero ? one : zero",
    "OP_IF_ELSE_ZERO": "{a} != zero ? {b} : zero",
    "OP_CALL": "real((float){a})",  # the one function that graphs call (`symbolic.single`)
    "OP_SIGN": "{a} > zero ? one : {a} < zero ? -one : {a}",
}


def literal(value: float) -> str:
    """A double as C++ writes it, exactly."""
    if math.isnan(value):
        return "real(NAN)"
    if math.isinf(value):
        return f"real({'-' if value < 0 else ''}INFINITY)"
    return f"real({value!r})"


def statements(
    graph: casadi.Function, read: Callable[[int, int], str], prefix: str
) -> tuple[list[str], dict[tuple[int, int], str]]:
    """Return the lines of a graph, and the names of its outputs by (which, row).

    Args:
        graph: its operations.
        read: (which, row) -> the expression of an input.
        prefix: of the names of its variables.

    Raises:
        ParameterError: an operation that has no code.
    """
    import casadi as ca

    table = {getattr(ca, name): text for name, text in _OPERATIONS.items()}
    lines: list[str] = []
    registers: dict[int, str] = {}
    outputs: dict[tuple[int, int], str] = {}
    divisors = _divisors(graph)
    for k in range(graph.n_instructions()):
        op, into = graph.instruction_id(k), graph.instruction_output(k)
        operands = graph.instruction_input(k)
        if op == ca.OP_CONST:
            registers[into[0]] = literal(graph.instruction_constant(k))
            continue
        if op == ca.OP_OUTPUT:
            outputs[into[0], into[1]] = registers[operands[0]]
            continue
        if op == ca.OP_INPUT:
            text = read(operands[0], operands[1])
        elif op in table:
            a, b = registers[operands[0]], registers[operands[-1]]
            if divisors.get(k, (0, 0))[1] > 1:
                inverse = f"{prefix}{divisors[k][0]}i"
                if k == divisors[k][0]:
                    lines.append(f"const real {inverse} = one / {b};")
                text = f"{a} * {inverse}"
            else:
                text = table[op].format(a=a, b=b)
        else:
            names = ", ".join(name[3:].lower() for name in _OPERATIONS)
            raise ParameterError(f"the kernel cannot compile operation {op}; it knows {names}")
        registers[into[0]] = f"{prefix}{k}"
        lines.append(f"const real {prefix}{k} = {text};")
    return lines, outputs


def _divisors(graph: casadi.Function) -> dict[int, tuple[int, int]]:
    """Per division, the first by the same number, and how many there are.

    The pivots of a factorisation divide again and again; a division costs a GPU ten products.
    """
    import casadi as ca

    written: dict[int, int] = {}  # register -> instruction that wrote it
    by: dict[int, list[int]] = {}
    for k in range(graph.n_instructions()):
        if graph.instruction_id(k) == ca.OP_DIV:
            by.setdefault(written[graph.instruction_input(k)[1]], []).append(k)
        if graph.instruction_id(k) != ca.OP_OUTPUT:
            written[graph.instruction_output(k)[0]] = k
    return {k: (group[0], len(group)) for group in by.values() for k in group}


def graph_text(graph: casadi.Function, real: str, shared: tuple[int, ...] = ()) -> str:
    """Body of `void (int i, array a0, array a1, ...)`, which evaluates a graph.

    The arrays are the graph's inputs, then its results, (k, n) each; every number is read
    before the first is written.

    Args:
        graph: its operations.
        real: float64 or float32.
        shared: inputs that may have one column for all simulations.
    """

    def read(which: int, row: int) -> str:
        index = f"{row} * s{which} + o{which}" if which in shared else f"{row} * n + i"
        return f"a{which}.data[{index}]"

    first = graph.n_in()
    lines, outputs = statements(graph, read, "v")
    head = [
        f"typedef {REALS[real]} real;",
        "const real zero = real(0), one = real(1);",
        f"const long long n = a{first}.shape[1];",
    ]
    for k in shared:
        head.append(
            f"const long long s{k} = a{k}.shape[1] > 1 ? n : 1, o{k} = s{k} > 1 ? i : 0;"
        )
    stores = [
        f"a{first + which}.data[{row} * n + i] = {value};"
        for (which, row), value in outputs.items()
    ]
    return "\n".join([*head, *lines, *stores])


def advance_text(
    motion: casadi.Function,
    observe: casadi.Function | None,
    integrator: str,
    order: int,
    real: str,
) -> str:
    """Body of a function that takes one simulation, number i, through many physics steps.

        void (int i, array x, array u, array p, array out, array active, array fault,
              int steps, real h)

    x (nx, n), changed; p (np, n), or (np, 1) for all alike; u ((nodes nu), n) the commands
    at the ends of the steps, linear between them, one node: held. out ((steps + 1) ny, n)
    is what is observed at the ends of the steps: the first under the new, the last under the
    old commands. active (n,) nonzero: this one moves. fault (n,) becomes 1 where a state is no
    longer meaningful.

    Args:
        motion: (x, u, p) -> x'.
        observe: the same with outputs; None: nothing is observed, and `out` is not touched.
        integrator: rk4, or one that updates rates first (euler, implicitfast).
        order: number of coordinates; x stacks coordinates and rates.
        real: float64 or float32.
    """
    nx, nu = motion.size1_in(0), motion.size1_in(1)

    def read(which: int, row: int) -> str:
        return (f"at[{row}]", f"c[{row}]", f"p.data[{row} * pn + pi]")[which]

    moving, slopes = statements(motion, read, "m")
    watch = ""
    if observe is not None:
        observing, observed = statements(observe, read, "o")
        ny = observe.size1_out(1)
        stores = [
            f"out.data[((long long)s * {ny} + {row}) * n + i] = {value};"
            for (which, row), value in observed.items()
            if which == 1
        ]
        watch = "\n".join(["if (stage == 0) {", *observing, *stores, "}"])
    return _ADVANCE.format(
        real=REALS[real],
        nx=nx,
        nu=nu,
        order=order,
        stages=4 if integrator == "rk4" else 1,
        last="<" if observe is None else "<=",
        watch=watch,
        motion="\n".join(moving),
        slope="\n".join(f"k[{row}] = {value};" for (_, row), value in slopes.items()),
        stage=_RK4 if integrator == "rk4" else _RATES_FIRST,
    )


# The command is interpolated where it is needed: `ahead` steps after the start of step s.
_ADVANCE = """typedef {real} real;
const real zero = real(0), one = real(1);
const long long n = x.shape[1];
const long long pn = p.shape[1] > 1 ? n : 1, pi = pn > 1 ? i : 0;
const int nx = {nx}, nu = {nu}, order = {order}, stages = {stages};
if (!active.data[i]) return;
const bool ramp = u.shape[0] > nu;
real x0[nx], at[nx], k[nx], total[nx], c[nu];
for (int j = 0; j < nx; ++j) x0[j] = x.data[j * n + i];
#pragma unroll 1
for (int s = 0; s {last} steps; ++s) {{
for (int j = 0; j < nx; ++j) at[j] = x0[j];
const int node = s == steps && s > 0 ? s - 1 : s;
#pragma unroll 1
for (int stage = 0; stage < stages; ++stage) {{
const real ahead = stage == 0 ? zero : stage == 3 ? one : real(0.5);
const real share = real(s - node) + ahead;
for (int j = 0; j < nu; ++j) {{
  const real first = u.data[((ramp ? node : 0) * nu + j) * n + i];
  c[j] = ramp ? first + share * (u.data[((node + 1) * nu + j) * n + i] - first) : first;
}}
{watch}
if (s == steps) break;
{motion}
{slope}
{stage}
}}
}}
bool good = true;
for (int j = 0; j < nx; ++j) {{
  x.data[j * n + i] = x0[j];
  good = good && wp::abs(x0[j]) < real(1e10);
}}
if (!good) fault.data[i] = 1;
"""

_RK4 = """const real weight = stage == 1 || stage == 2 ? real(2) : one;
const real reach = stage == 2 ? h : h * real(0.5);
for (int j = 0; j < nx; ++j) {
  total[j] = stage == 0 ? k[j] : total[j] + weight * k[j];
  at[j] = x0[j] + reach * k[j];
}
if (stage == 3) {
  for (int j = 0; j < nx; ++j) x0[j] += h * total[j] / real(6);
}
"""

_RATES_FIRST = """for (int j = 0; j < order; ++j) {
  x0[order + j] += h * k[order + j];
  x0[j] += h * x0[order + j];
}
"""
