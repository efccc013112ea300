"""Graphs one after another over blocks of simulations, without a return to Python between.

A piece is a compiled graph with the addresses of its rows; a program runs pieces in order for
the blocks lo to hi. Every piece has the one signature

    void piece(i64 *table, i64 lo, i64 hi)

whose table holds, for each argument and then for each result, the address of its rows in
block 0 and the number of rows from one block to the next.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import Array
from ves_gym.engine.kernel.emit import LANES, declarations, emit_function, over_blocks, rows_of

if TYPE_CHECKING:
    import casadi

    from ves_gym.engine.kernel.build import Library

Table = npt.NDArray[np.int64]


class Piece:
    """One function of a library on fixed rows.

    Args:
        library: whose function.
        name: of the function.
        rows: of its arguments, then of its results: (blocks, k, LANES), or a slice along the
            second axis of such an array; (1, k, LANES) serves all blocks.
    """

    def __init__(self, library: Library, name: str, rows: Sequence[Array]) -> None:
        self.address = library.address(name)
        stride = LANES * rows[0].itemsize
        apart = [k.strides[0] // stride if len(k) > 1 else 0 for k in rows]
        ends = [(k.ctypes.data, rows_apart) for k, rows_apart in zip(rows, apart, strict=True)]
        self.table: Table = np.array(ends, np.int64).ravel()
        self._owners: Any = library, rows  # addresses do not keep memory alive


class Step(Piece):
    """`advance` of a physics kernel as a piece of a program.

    Args:
        library: the physics kernel.
        chain: the library with the program, which knows how to call it.
        arguments: addresses of x, u, p, out and scratch, then steps, ublock, unode and record
            as in `emit.emit_module`.
        h: physics step [s].
        owners: arrays that the addresses belong to.
    """

    def __init__(
        self,
        library: Library,
        chain: Library,
        arguments: Sequence[int],
        h: float,
        owners: Sequence[Array | None],
    ) -> None:
        self.address = chain.address("advance_piece")
        bits = int(np.float64(h).view(np.int64))
        *head, record = arguments
        words = [library.address("advance"), *head, bits, record]
        self.table = np.array(words, np.int64)
        self._owners = library, owners


class LoopPiece(Piece):
    """A function of `emit.emit_driver` as a piece of a program.

    Args:
        library: whose function.
        name: of the function.
        memory, parameters: (blocks, k, LANES), what it works on.
    """

    def __init__(self, library: Library, name: str, memory: Array, parameters: Array) -> None:
        self.address = library.address(f"{name}_piece")
        self.table = np.array([memory.ctypes.data, parameters.ctypes.data], np.int64)
        self._owners = library, (memory, parameters)


class Program:
    """Pieces in order; calling it runs them all for blocks lo to hi.

    Args:
        library: one made of `emit_pieces`.
        pieces: what to run.
    """

    def __init__(self, library: Library, pieces: Sequence[Piece]) -> None:
        words = [len(pieces)]
        for piece in pieces:
            words += [piece.address, piece.table.ctypes.data]
        self._words: Table = np.array(words, np.int64)
        self._pieces = tuple(pieces)
        self._run: Callable[[int, int, int], None] = library.program
        self._where = self._words.ctypes.data

    def __call__(self, lo: int, hi: int) -> None:
        self._run(self._where, lo, hi)


def emit_pieces(graphs: Mapping[str, casadi.Function]) -> str:
    """A module with a piece for each graph, `program` and `advance_piece`.

    Args:
        graphs: by the names of their pieces.
    """
    parts = [declarations()]
    for name, graph in graphs.items():
        parts += [emit_function(f"{name}_point", graph), _piece(name, graph)]
    return "\n".join([*parts, _PROGRAM, _STEP])


def _piece(name: str, graph: casadi.Function) -> str:
    ends = graph.n_in() + graph.n_out()
    load: list[str] = []
    move: list[str] = []
    for i in range(ends):
        load += [
            f"  %wa{i} = getelementptr i64, ptr %table, i64 {2 * i}",
            f"  %a{i} = load i64, ptr %wa{i}",
            f"  %k{i} = inttoptr i64 %a{i} to ptr",
            f"  %ws{i} = getelementptr i64, ptr %table, i64 {2 * i + 1}",
            f"  %stride{i} = load i64, ptr %ws{i}",
        ]
        move += rows_of(f"k{i}", f"%stride{i}")
    arguments = ", ".join(f"ptr %k{i}b" for i in range(ends))
    body = [*move, f"  call void @{name}_point({arguments})"]
    return over_blocks(name, "ptr %table", "\n".join(body), "\n".join(load))


_PROGRAM = """
define void @program(ptr %words, i64 %lo, i64 %hi) {
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


def _call(name: str, pointers: int, words: tuple[str, ...]) -> str:
    """A piece that calls the code in its table with pointers, lo, hi and what else is there.

    Args:
        name: of the piece.
        pointers: how many follow the code's address.
        words: types of what comes after them.
    """
    kinds = ["i64"] * (1 + pointers) + list(words)
    lines = [f"define void @{name}(ptr %table, i64 %lo, i64 %hi) {{"]
    for i, kind in enumerate(kinds):
        lines += [
            f"  %w{i} = getelementptr i64, ptr %table, i64 {i}",
            f"  %k{i} = load {kind}, ptr %w{i}",
        ]
    lines += [f"  %p{i} = inttoptr i64 %k{i} to ptr" for i in range(1 + pointers)]
    arguments = [f"ptr %p{i}" for i in range(1, 1 + pointers)] + ["i64 %lo", "i64 %hi"]
    arguments += [f"{kind} %k{i}" for i, kind in enumerate(kinds) if i > pointers]
    return "\n".join([*lines, f"  call void %p0({', '.join(arguments)})", "  ret void", "}"])


# table: code, x, u, p, out, scratch, steps, ublock, unode, h, record
_STEP = _call("advance_piece", 5, ("i64", "i64", "i64", "double", "i64"))


def numbers(rows: Array, n: int) -> Array:
    """Return lanes as a row per quantity, a copy.

    Args:
        rows: (blocks, k, LANES).
        n: number of simulations.

    Returns:
        (k, n).
    """
    if len(rows) == 1:
        return rows[0, :, :n].copy()
    return rows.swapaxes(0, 1).reshape(rows.shape[1], -1)[:, :n]
