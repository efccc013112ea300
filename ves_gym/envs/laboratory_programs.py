"""An emulated control period as one program: the loop's compiled halves around the engine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from ves_gym._util.params import Array, Index, Mask
from ves_gym.engine.backends.kernel import KernelBackend
from ves_gym.engine.kernel.compiled_function import (
    CompiledFunction,
    Piece,
    Program,
    aligned,
    fill,
    unlane,
)
from ves_gym.engine.kernel.emit import LANES
from ves_gym.envs.compiled import Shape

if TYPE_CHECKING:
    from ves_gym.simulation.blocks.compiled_loop import CompiledLoop
    from ves_gym.simulation.simulator import Simulator

# what is known here of the signals that come from outside the loop
_BEFORE = ("q", "kp", "kd", "y_engine", "yd_engine", "weight")
_AFTER = ("wrench", "draws", "q")


def signals_of(sim: Simulator) -> tuple[tuple[str, ...], tuple[str, ...]] | None:
    """Signals that the loop's halves read; None where they cannot be part of a program."""
    loop = sim.emulation_loop
    if loop is None or loop.code is None or sim.joint_delays is not None:
        return None
    external = set(loop.wiring.external)
    if not external <= {*_BEFORE, *_AFTER} or "admittance.X" not in loop.memory:
        return None
    first, second = (tuple(k for k in names if k in external) for names in (_BEFORE, _AFTER))
    return first, second


class LaboratoryPrograms:
    """Programs of an emulated period, built anew when the loop's code or memory are others.

    Args:
        sim: whose loop.
        shape: of the task's rows.
        functions: of the task's pieces.
        first, last: pieces before and after the physics.
        rows: commands from `follow`, what `close` is given, internal modes of the base.
    """

    def __init__(
        self,
        sim: Simulator,
        shape: Shape,
        functions: Mapping[str, CompiledFunction],
        first: Sequence[Piece],
        last: Sequence[Piece],
        rows: tuple[Array, Array, Array],
    ) -> None:
        assert isinstance(sim.backend, KernelBackend)
        self.sim, self.backend, self.shape = sim, sim.backend, shape
        self._functions, self._first, self._last = functions, tuple(first), tuple(last)
        self._commands, inputs, self._modes = rows
        self._measured = inputs[:, shape.inputs["y_seen"].start : shape.inputs["stopped"].stop]
        blocks, count = self.backend.blocks, shape.system.substeps + 1
        self._nodes = aligned(blocks, count * (6 + shape.joints), LANES)
        self._outputs = aligned(blocks, count * self.backend.outputs, LANES)
        self._draws = aligned(blocks, 18, LANES)
        self.lost = aligned(blocks, 1, LANES)  # 1: has diverged
        self._reading = aligned(blocks, 6, LANES)
        self._made_of: tuple[object, object] = (None, None)
        self._programs: list[Program] = []

    def run(self, stopped: Index) -> bool:
        """Run a period; False, and nothing has happened, where the loop's wiring is another.

        Args:
            stopped: simulations that stay where they are.
        """
        loop, substeps = self.sim.emulation_loop, self.shape.system.substeps
        assert loop is not None
        if signals_of(self.sim) != self.shape.signals:
            return False
        assert loop.code is not None
        if loop.code is not self._made_of[0] or loop.code.version is not self._made_of[1]:
            self._made_of = loop.code, loop.code.version
            self._programs = self._build(loop.code)
        fill(self._draws, loop.draws())
        self.backend.run_program(self._programs, substeps, stopped)
        return True

    def stops(self, some: bool) -> Mask:
        """Account for the period; platforms (n,) that stand still for good.

        Args:
            some: there may be new ones.
        """
        loop = self.sim.emulation_loop
        assert loop is not None
        loop.ran_elsewhere(unlane(self._reading, self.sim.n) if some else None)
        return loop.frozen

    def _modes_piece(self, code: CompiledLoop) -> list[Piece]:
        """Return what sets the base's internal modes on the platform, if it has any."""
        loop, m = self.sim.emulation_loop, self.shape.system.base.m
        if not m:
            return []
        assert loop is not None
        block: Any = loop.wiring.block("admittance")
        at = [slice(k.start, k.start + m) for k in block.oscillators]
        coupled = code.rows("admittance.coupled")
        pair = [coupled[:, k] for k in at]
        _, z, zd = self.backend.rows_of_state()
        model = [code.rows(k) for k in ("admittance.X", "command_sent", "frozen")]
        return [self._functions["lab_modes"].piece(*pair, z, zd, *model, self._modes)]

    def _build(self, code: CompiledLoop) -> list[Program]:
        functions, backend = self._functions, self.backend
        assert self.shape.signals is not None
        _, z, zd = backend.rows_of_state()
        first, second = ([code.rows(k) for k in names] for names in self.shape.signals)
        before = [
            *self._first,
            functions["lab_before"].piece(z, zd, backend.rows_of_gains(), *first),
            *code.pieces("before"),
            functions["lab_nodes"].piece(
                code.rows("acceleration"), self._commands, self._nodes
            ),
        ]
        rows_in = [self._outputs, z, self._draws, code.rows("reading")]
        at = [code.rows(k) for k in ("y_measured", "admittance.X", "frozen")]
        after = [
            functions["lab_after"].piece(*rows_in, *second, self._reading),
            *code.pieces("after"),
            functions["lab_seen"].piece(*at, self.lost, self._measured),
            *self._modes_piece(code),
            *self._last,
        ]
        steps = self.shape.system.substeps
        physics = backend.pieces(self._nodes, steps + 1, steps, self._outputs)
        return [Program([*before, piece, *after]) for piece in physics]
