"""CasADi graphs as LLVM code over a block of simulations side by side.

A value of the graph becomes one vector, a simulation per lane. Every lane runs the same
instructions, so a result depends neither on the lane nor on the neighbours, and what is not
a number stays in its own lane.
"""

from __future__ import annotations

import math
import struct
import sys
from collections.abc import Callable
from functools import cache, partialmethod
from typing import TYPE_CHECKING

from ves_gym._util.params import ParameterError
from ves_gym.engine.kernel.build import LANES

if TYPE_CHECKING:
    import casadi

_V = f"<{LANES} x double>"
_BOOL = f"<{LANES} x i1>"
_INT = f"<{LANES} x i64>"
# Taylor-like minimax polynomials on |r| <= pi/4 (coefficients of fdlibm's kernels)
_SIN = (
    -1.66666666666666324348e-01,
    8.33333333332248946124e-03,
    -1.98412698298579493134e-04,
    2.75573137070700676789e-06,
    -2.50507602534068634195e-08,
    1.58969099521155010221e-10,
)
_COS = (
    4.16666666666666019037e-02,
    -1.38888888888741095749e-03,
    2.48015872894767294178e-05,
    -2.75573143513906633035e-07,
    2.08757232129817482790e-09,
    -1.13596475577881948265e-11,
)
# pi/2 in three parts of 33 bits: exact products with a whole number up to 2^20
_HALF_PI = (1.57079632673412561417e00, 6.07710050630396597660e-11, 2.02226624879595063154e-21)
_LN2 = (6.93147180369123816490e-01, 1.90821492927058770002e-10)
_LOG = (
    6.666666666666735130e-01,
    3.999999999940941908e-01,
    2.857142874366239149e-01,
    2.222219843214978396e-01,
    1.818357216161805012e-01,
    1.531383769920937332e-01,
    1.479819860511658591e-01,
)
_ONE, _ROOT_HALF = 0x3FF0000000000000, 0x3FE6A09E667F3BCD  # bits of 1 and of the root of 1/2


def number(value: float) -> str:
    """A double as LLVM writes it, exactly."""
    return f"0x{struct.unpack('<Q', struct.pack('<d', value))[0]:016X}"


def splat(value: float) -> str:
    """A vector of one value in every lane."""
    text = f"double {number(value)}"
    return f"<{', '.join([text] * LANES)}>"


def _integers(value: int) -> str:
    """A vector of one whole number in every lane."""
    return f"<{', '.join([f'i64 {value}'] * LANES)}>"


class FunctionBody:
    """Lines of one function body; every method appends one instruction and names its result."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self._count = 0
        self._angles: dict[str, tuple[str, str]] = {}

    def put(self, text: str) -> str:
        self._count += 1
        name = f"%v{self._count}"
        self.lines.append(f"  {name} = {text}")
        return name

    def op(self, kind: str, a: str, b: str) -> str:
        return self.put(f"{kind} contract {_V} {a}, {b}")

    add = partialmethod(op, "fadd")
    sub = partialmethod(op, "fsub")
    mul = partialmethod(op, "fmul")
    div = partialmethod(op, "fdiv")

    def fma(self, a: str, b: str, c: str) -> str:
        return self.put(f"call {_V} @llvm.fma.v{LANES}f64({_V} {a}, {_V} {b}, {_V} {c})")

    def call(self, name: str, *args: str) -> str:
        parameters = ", ".join(f"{_V} {a}" for a in args)
        return self.put(f"call {_V} @llvm.{name}.v{LANES}f64({parameters})")

    def compare(self, kind: str, a: str, b: str) -> str:
        return self.put(f"fcmp {kind} {_V} {a}, {b}")

    def select(self, test: str, a: str, b: str) -> str:
        return self.put(f"select {_BOOL} {test}, {_V} {a}, {_V} {b}")

    def negate(self, a: str) -> str:
        return self.put(f"fneg {_V} {a}")

    def row(self, pointer: str, i: int) -> str:
        return self.put(f"getelementptr {_V}, ptr {pointer}, i64 {i}")

    def load(self, pointer: str, i: int) -> str:
        return self.put(f"load {_V}, ptr {self.row(pointer, i)}, align 64")

    def store(self, value: str, pointer: str, i: int) -> None:
        where = self.row(pointer, i)
        self.lines.append(f"  store {_V} {value}, ptr {where}, align 64")

    def _polynomial(self, coefficients: tuple[float, ...], x: str) -> str:
        value = splat(coefficients[-1])
        for c in reversed(coefficients[:-1]):
            value = self.fma(value, x, splat(c))
        return value

    def sine_cosine(self, x: str) -> tuple[str, str]:
        """Both, without a branch: reduced to a quarter turn, then polynomials."""
        if x in self._angles:
            return self._angles[x]
        turns = self.call("rint", self.mul(x, splat(2 / math.pi)))
        r = x
        for part in _HALF_PI:
            r = self.fma(turns, splat(-part), r)
        square = self.mul(r, r)
        sine = self.fma(self.mul(square, r), self._polynomial(_SIN, square), r)
        half = self.fma(square, splat(-0.5), splat(1.0))
        cosine = self.fma(self.mul(square, square), self._polynomial(_COS, square), half)
        # which quarter, 0 to 3
        turns_whole = self.call("floor", self.mul(turns, splat(0.25)))
        quarter = self.fma(turns_whole, splat(-4.0), turns)
        first = self.compare("oeq", quarter, splat(1.0))
        two = self.compare("oeq", quarter, splat(2.0))
        three = self.compare("oeq", quarter, splat(3.0))
        odd = self.put(f"or {_BOOL} {first}, {three}")
        s, c = self.select(odd, cosine, sine), self.select(odd, sine, cosine)
        down = self.put(f"or {_BOOL} {two}, {three}")
        flip = self.put(f"or {_BOOL} {first}, {two}")
        out = self.select(down, self.negate(s), s), self.select(flip, self.negate(c), c)
        self._angles[x] = out
        return out

    def exp(self, x: str) -> str:
        """e^x: 2^k times a polynomial; 0 below -708, infinite above 709."""
        inside = self.call("maximum", self.call("minimum", x, splat(709.0)), splat(-708.0))
        k = self.call("rint", self.mul(inside, splat(1 / math.log(2))))
        r = self.fma(k, splat(-_LN2[0]), inside)
        r = self.fma(k, splat(-_LN2[1]), r)
        terms = tuple(1 / math.factorial(i) for i in range(14))
        value = self._polynomial(terms, r)
        shifted = self.add(k, splat(6755399441055744.0))  # 1.5 * 2^52: k in the low bits
        bits = self.put(f"bitcast {_V} {shifted} to {_INT}")
        power = self.put(f"shl {_INT} {bits}, {_integers(52)}")
        scaled = self.put(f"add {_INT} {self.put(f'bitcast {_V} {value} to {_INT}')}, {power}")
        out = self.put(f"bitcast {_INT} {scaled} to {_V}")
        out = self.select(self.compare("ogt", x, splat(709.0)), splat(math.inf), out)
        out = self.select(self.compare("olt", x, splat(-708.0)), splat(0.0), out)
        return self.select(self.compare("uno", x, x), x, out)  # NaN: its bits were added to

    def log(self, x: str) -> str:
        """ln x: x = 2^k m with m about 1, then fdlibm's series in (m - 1) / (m + 1)."""
        small = self.compare("olt", x, splat(sys.float_info.min))
        bits = self.put(
            f"bitcast {_V} {self.select(small, self.mul(x, splat(2.0**54)), x)} to {_INT}"
        )
        shifted = self.put(f"add {_INT} {bits}, {_integers(_ONE - _ROOT_HALF)}")
        power = self.put(f"ashr {_INT} {shifted}, {_integers(52)}")
        power = self.put(f"sub {_INT} {power}, {_integers(1023)}")
        k = self.put(f"sitofp {_INT} {power} to {_V}")
        k = self.sub(k, self.select(small, splat(54.0), splat(0.0)))
        mantissa = self.put(f"and {_INT} {shifted}, {_integers(2**52 - 1)}")
        mantissa = self.put(f"add {_INT} {mantissa}, {_integers(_ROOT_HALF)}")
        f = self.sub(self.put(f"bitcast {_INT} {mantissa} to {_V}"), splat(1.0))
        s = self.div(f, self.add(splat(2.0), f))
        square = self.mul(s, s)
        series = self.mul(square, self._polynomial(_LOG, square))
        half = self.mul(self.mul(splat(0.5), f), f)
        low = self.fma(k, splat(_LN2[1]), self.mul(s, self.add(half, series)))
        out = self.fma(k, splat(_LN2[0]), self.add(self.sub(low, half), f))
        out = self.select(self.compare("oeq", x, splat(0.0)), splat(-math.inf), out)
        out = self.select(self.compare("olt", x, splat(0.0)), splat(math.nan), out)
        return self.select(self.compare("olt", x, splat(math.inf)), out, x)

    def single(self, x: str) -> str:
        """The nearest number of single precision."""
        near = self.put(f"fptrunc {_V} {x} to <{LANES} x float>")
        return self.put(f"fpext <{LANES} x float> {near} to {_V}")

    def tanh(self, x: str) -> str:
        """(1 - e) / (1 + e) with e = exp(-2 |x|); a series near zero, where that cancels."""
        size = self.call("fabs", x)
        e = self.exp(self.mul(size, splat(-2.0)))
        far = self.div(self.sub(splat(1.0), e), self.add(splat(1.0), e))
        square = self.mul(x, x)
        series = self._polynomial(
            (-1 / 3, 2 / 15, -17 / 315, 62 / 2835, -1382 / 155925), square
        )
        near = self.fma(self.mul(size, square), series, size)
        value = self.select(self.compare("olt", size, splat(0.05)), near, far)
        return self.call("copysign", value, x)


def emit_function(name: str, graph: casadi.Function, in_place: bool = False) -> str:
    """Return one graph as `void name(ptr inputs ..., ptr outputs ...)` on rows of lanes.

    All is read before anything is written.

    Args:
        name: of the function.
        graph: its operations.
        in_place: outputs may lie where inputs do.
    """
    import casadi as ca

    code = FunctionBody()
    registers: dict[int, str] = {}
    outputs: dict[tuple[int, int], str] = {}
    for k in range(graph.n_instructions()):
        op, into = graph.instruction_id(k), graph.instruction_output(k)
        operands = graph.instruction_input(k)
        if op == ca.OP_CONST:
            registers[into[0]] = splat(graph.instruction_constant(k))
        elif op == ca.OP_INPUT:
            registers[into[0]] = code.load(f"%in{operands[0]}", operands[1])
        elif op == ca.OP_OUTPUT:
            outputs[into[0], into[1]] = registers[operands[0]]
        else:
            a, b = (registers[operands[i]] for i in (0, -1))
            registers[into[0]] = _operation(op)(code, a, b)
    for (which, row), value in outputs.items():
        code.store(value, f"%out{which}", row)
    kind = "ptr" if in_place else "ptr noalias"
    arguments = [f"{kind} %in{i}" for i in range(graph.n_in())]
    arguments += [f"{kind} %out{i}" for i in range(graph.n_out())]
    head = f"define internal void @{name}({', '.join(arguments)}) noinline {{"
    return "\n".join([head, *code.lines, "  ret void", "}"])


_UNITY, _NOTHING = splat(1.0), splat(0.0)


def _truth(code: FunctionBody, kind: str, a: str, b: str) -> str:
    return code.select(code.compare(kind, a, b), _UNITY, _NOTHING)


_OPERATIONS: dict[str, Callable[[FunctionBody, str, str], str]] = {
    "OP_ASSIGN": lambda code, a, b: a,
    "OP_ADD": lambda code, a, b: code.add(a, b),
    "OP_SUB": lambda code, a, b: code.sub(a, b),
    "OP_MUL": lambda code, a, b: code.mul(a, b),
    "OP_DIV": lambda code, a, b: code.div(a, b),
    "OP_NEG": lambda code, a, b: code.negate(a),
    "OP_SQ": lambda code, a, b: code.mul(a, a),
    "OP_TWICE": lambda code, a, b: code.add(a, a),
    "OP_INV": lambda code, a, b: code.div(_UNITY, a),
    "OP_SIN": lambda code, a, b: code.sine_cosine(a)[0],
    "OP_COS": lambda code, a, b: code.sine_cosine(a)[1],
    "OP_SQRT": lambda code, a, b: code.call("sqrt", a),
    "OP_EXP": lambda code, a, b: code.exp(a),
    "OP_LOG": lambda code, a, b: code.log(a),
    "OP_TANH": lambda code, a, b: code.tanh(a),
    "OP_FLOOR": lambda code, a, b: code.call("floor", a),
    "OP_CALL": lambda code, a, b: code.single(a),  # the one function that graphs call
    "OP_FABS": lambda code, a, b: code.call("fabs", a),
    "OP_FMIN": lambda code, a, b: code.call("minimum", a, b),
    "OP_FMAX": lambda code, a, b: code.call("maximum", a, b),
    "OP_LT": lambda code, a, b: _truth(code, "olt", a, b),
    "OP_LE": lambda code, a, b: _truth(code, "ole", a, b),
    "OP_EQ": lambda code, a, b: _truth(code, "oeq", a, b),
    "OP_NE": lambda code, a, b: _truth(code, "une", a, b),
    "OP_NOT": lambda code, a, b: _truth(code, "oeq", a, _NOTHING),
    "OP_AND": lambda code, a, b: code.mul(a, b),
    "OP_OR": lambda code, a, b: code.call("maximum", a, b),
    "OP_IF_ELSE_ZERO": lambda code, a, b: code.select(
        code.compare("une", a, _NOTHING), b, _NOTHING
    ),
    "OP_REMAINDER": lambda code, a, b: code.sub(
        a, code.mul(b, code.call("rint", code.div(a, b)))
    ),
    "OP_SIGN": lambda code, a, b: code.select(
        code.compare("ueq", a, _NOTHING), a, code.call("copysign", _UNITY, a)
    ),
}


@cache  # asked for every instruction of every graph
def _operation(op: int) -> Callable[[FunctionBody, str, str], str]:
    import casadi as ca

    for name, build in _OPERATIONS.items():
        if getattr(ca, name) == op:
            return build
    operations = ", ".join(name[3:].lower() for name in _OPERATIONS)
    raise ParameterError(f"the kernel cannot compile operation {op}; it knows {operations}")


# ------------------------------------------------------------------------------ modules
#
# A module defines one function, `void run(i64 *table, i64 lo, i64 hi)`, which works on the
# blocks lo to hi of what the table points to.


def emit_graph(graph: casadi.Function, in_place: bool) -> str:
    """A module that evaluates a graph.

    Its table holds, for each argument and then for each result, the address of its rows in
    block 0 and the number of rows from one block to the next.

    Args:
        graph: its operations.
        in_place: results may lie where arguments do.
    """
    ends = range(graph.n_in() + graph.n_out())
    setup = [
        line for i in ends for line in (*_word(2 * i, f"k{i}"), *_word(2 * i + 1, f"s{i}"))
    ]
    setup += [f"  %p{i} = inttoptr i64 %k{i} to ptr" for i in ends]
    body = [text for i in ends for text in _rows_of(f"p{i}", f"%s{i}")]
    body.append(f"  call void @point({', '.join(f'ptr %p{i}b' for i in ends)})")
    run = _OVER_BLOCKS.format(setup="\n".join(setup), body="\n".join(body))
    return "\n".join([_declarations(), emit_function("point", graph, in_place), run])


def emit_stepper(
    motion: casadi.Function, observe: casadi.Function, integrator: str, order: int
) -> str:
    """A module that steps blocks of simulations.

    Its table holds the addresses of x, u, p, out and scratch, then steps, ublock, unode, the
    bits of the step h, and record. Rows are vectors of LANES. Block b has x at row b nx, p at
    b np, u at b ublock, its nodes unode rows apart (0: held). With `record` outputs go to
    `out`, steps + 1 nodes a block; the first node of a step sees the commands of that step,
    the last those at its end.

    Args:
        motion: (x, u, p) -> x'. observe: the same with outputs.
        integrator: rk4, or one that updates rates first (euler, implicitfast).
        order: number of coordinates; x stacks coordinates and rates.
    """
    nx, nu, np_ = (motion.size1_in(i) for i in range(3))
    ny = observe.size1_out(1)
    parts = [
        _declarations(),
        emit_function("motion", motion),
        emit_function("observe", observe),
    ]
    step = _rk4(nx, nu, ny) if integrator == "rk4" else _rates_first(nx, ny, order)
    words = [text for i, name in enumerate(_STEPPER) for text in _word(i, f"w_{name}")]
    words += [f"  %{name} = inttoptr i64 %w_{name} to ptr" for name in _STEPPER[:5]]
    body = _ADVANCE.format(V=_V, nx=nx, np=np_, ny=ny, nu=nu, step=step, words="\n".join(words))
    return "\n".join([*parts, body])


_STEPPER = ("x", "u", "p", "out", "scratch", "steps", "ublock", "unode", "h", "record")


def _word(i: int, name: str) -> list[str]:
    """Lines that load a word of the table."""
    return [
        f"  %at_{name} = getelementptr i64, ptr %table, i64 {i}",
        f"  %{name} = load i64, ptr %at_{name}",
    ]


def _rows_of(pointer: str, rows: str) -> list[str]:
    """Lines that find a block's rows of lanes, `%xb` of a pointer `%x`."""
    return [
        f"  %{pointer}row = mul i64 %b, {rows}",
        f"  %{pointer}b = getelementptr {_V}, ptr %{pointer}, i64 %{pointer}row",
    ]


def _declarations() -> str:
    """The processor's own operations that functions use."""
    unary = ("rint", "floor", "fabs", "sqrt")
    two = ("minimum", "maximum", "copysign")
    lines = [f"declare {_V} @llvm.{k}.v{LANES}f64({_V})" for k in unary]
    lines += [f"declare {_V} @llvm.{k}.v{LANES}f64({_V}, {_V})" for k in two]
    lines.append(f"declare {_V} @llvm.fma.v{LANES}f64({_V}, {_V}, {_V})")
    return "\n".join(lines)


def _spread(code: FunctionBody, scalar: str) -> str:
    first = code.put(f"insertelement {_V} undef, double {scalar}, i32 0")
    mask = f"<{LANES} x i32> zeroinitializer"
    return code.put(f"shufflevector {_V} {first}, {_V} undef, {mask}")


def _rk4(nx: int, nu: int, ny: int) -> str:
    """Classical Runge-Kutta on scratch rows: k (nx), sum (nx), stage (nx), middle u (nu)."""
    code = FunctionBody()
    k, total, stage = (code.row("%scratch", i * nx) for i in range(3))
    middle = code.row("%scratch", 3 * nx)
    h = _spread(code, "%h")
    half = code.mul(h, splat(0.5))
    for i in range(nu):
        both = code.add(code.load("%u0", i), code.load("%u1", i))
        code.store(code.mul(both, splat(0.5)), middle, i)
    code.lines.append(f"  call void @observe(ptr %xb, ptr %u0, ptr %pb, ptr {k}, ptr %ob)")
    for weight, ahead, command in ((1.0, half, middle), (2.0, half, middle), (2.0, h, "%u1")):
        for i in range(nx):
            slope = code.load(k, i)
            if weight == 1.0:
                code.store(slope, total, i)
            else:
                code.store(code.fma(slope, splat(weight), code.load(total, i)), total, i)
            code.store(code.fma(slope, ahead, code.load("%xb", i)), stage, i)
        code.lines.append(f"  call void @motion(ptr {stage}, ptr {command}, ptr %pb, ptr {k})")
    sixth = code.mul(h, splat(1 / 6))
    for i in range(nx):
        slope = code.add(code.load(total, i), code.load(k, i))
        code.store(code.fma(slope, sixth, code.load("%xb", i)), "%xb", i)
    return "\n".join(code.lines)


def _rates_first(nx: int, ny: int, order: int) -> str:
    """Semi-implicit Euler: rates from here, coordinates with the new rates."""
    code = FunctionBody()
    k, h = code.row("%scratch", 0), _spread(code, "%h")
    code.lines.append(f"  call void @observe(ptr %xb, ptr %u0, ptr %pb, ptr {k}, ptr %ob)")
    for i in range(order):
        rate = code.fma(code.load(k, order + i), h, code.load("%xb", order + i))
        code.store(rate, "%xb", order + i)
        code.store(code.fma(rate, h, code.load("%xb", i)), "%xb", i)
    return "\n".join(code.lines)


_ADVANCE = """
define void @run(ptr %table, i64 %lo, i64 %hi) {{
entry:
{words}
  %h = bitcast i64 %w_h to double
  %keep = icmp ne i64 %w_record, 0
  %nodes = add i64 %w_steps, 1
  %oblock0 = mul i64 %nodes, {ny}
  %oblock = select i1 %keep, i64 %oblock0, i64 0
  %onode = select i1 %keep, i64 {ny}, i64 0
  %any = icmp slt i64 %lo, %hi
  br i1 %any, label %block, label %done
block:
  %b = phi i64 [ %lo, %entry ], [ %bnext, %blockend ]
  %xrow = mul i64 %b, {nx}
  %xb = getelementptr {V}, ptr %x, i64 %xrow
  %prow = mul i64 %b, {np}
  %pb = getelementptr {V}, ptr %p, i64 %prow
  %urow = mul i64 %b, %w_ublock
  %ub = getelementptr {V}, ptr %u, i64 %urow
  %orow = mul i64 %b, %oblock
  %obb = getelementptr {V}, ptr %out, i64 %orow
  %some = icmp sgt i64 %w_steps, 0
  br i1 %some, label %step, label %last
step:
  %s = phi i64 [ 0, %block ], [ %snext, %step ]
  %u0row = mul i64 %s, %w_unode
  %u0 = getelementptr {V}, ptr %ub, i64 %u0row
  %u1 = getelementptr {V}, ptr %u0, i64 %w_unode
  %osrow = mul i64 %s, %onode
  %ob = getelementptr {V}, ptr %obb, i64 %osrow
{step}
  %snext = add i64 %s, 1
  %more = icmp slt i64 %snext, %w_steps
  br i1 %more, label %step, label %last
last:
  br i1 %keep, label %final, label %blockend
final:
  %lurow = mul i64 %w_steps, %w_unode
  %ul = getelementptr {V}, ptr %ub, i64 %lurow
  %lorow = mul i64 %w_steps, %onode
  %ol = getelementptr {V}, ptr %obb, i64 %lorow
  call void @observe(ptr %xb, ptr %ul, ptr %pb, ptr %scratch, ptr %ol)
  br label %blockend
blockend:
  %bnext = add i64 %b, 1
  %again = icmp slt i64 %bnext, %hi
  br i1 %again, label %block, label %done
done:
  ret void
}}
"""

_OVER_BLOCKS = """
define void @run(ptr %table, i64 %lo, i64 %hi) {{
entry:
{setup}
  %any = icmp slt i64 %lo, %hi
  br i1 %any, label %block, label %done
block:
  %b = phi i64 [ %lo, %entry ], [ %bnext, %block ]
{body}
  %bnext = add i64 %b, 1
  %again = icmp slt i64 %bnext, %hi
  br i1 %again, label %block, label %done
done:
  ret void
}}
"""

# several functions one after another; its table: how many, then code and table of each
PROGRAM = """
define void @run(ptr %words, i64 %lo, i64 %hi) {
entry:
  %count = load i64, ptr %words
  %some = icmp sgt i64 %count, 0
  br i1 %some, label %piece, label %done
piece:
  %i = phi i64 [ 0, %entry ], [ %inext, %piece ]
  %k0 = shl i64 %i, 1
  %k = add i64 %k0, 1
  %wf = getelementptr i64, ptr %words, i64 %k
  %f = load i64, ptr %wf
  %code = inttoptr i64 %f to ptr
  %wt = getelementptr i64, ptr %wf, i64 1
  %t = load i64, ptr %wt
  %table = inttoptr i64 %t to ptr
  call void %code(ptr %table, i64 %lo, i64 %hi)
  %inext = add i64 %i, 1
  %more = icmp slt i64 %inext, %count
  br i1 %more, label %piece, label %done
done:
  ret void
}
"""
