"""The emulation loop of a system as graphs: what its FMU does in a control period.

The blocks' own text, run once with arrays of symbols; parameters are numbers of the system.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from ves_gym._util.params import Array, ParameterError
from ves_gym.engine.kernel.symbolic import Traced, column, symbols
from ves_gym.mechanics.servo import JointServo
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.system import System

if TYPE_CHECKING:
    import casadi


class LoopGraphs:
    """State and halves of a control period; a state is the engine's, then the loop's memory,
    then the platform's last acceleration (6).

    Args:
        system: mode emulated, its sensors without noise and drift.
        servo: gains of the joints.

    Raises:
        ParameterError: it draws random numbers, or follows a motion of its own.
    """

    def __init__(self, system: System, servo: JointServo) -> None:
        self.sim = Simulator(system, servo=servo, warn_at=system.arm.home, compiled=False)
        loop = self.sim.emulation_loop
        assert loop is not None
        lacking = {
            "noise and drift of the force sensor": bool(loop.numbers.noisy.any()),
            f"operation {loop.spec.operation}": loop.spec.operation == "position",
        }
        if missing := [what for what, there in lacking.items() if there]:
            raise ParameterError(f"an FMU has no words for {', '.join(missing)}")
        self.loop, self.n, self.nodes = loop, system.arm.n, loop.shape.nodes
        self.shapes = dict(loop.memory.shapes)

    @cached_property
    def engine(self) -> int:
        """Numbers in the engine's state."""
        return self.first.size - self.memory - 6

    @property
    def memory(self) -> int:
        """Numbers in the loop's memory."""
        return sum(int(np.prod(shape)) for shape in self.shapes.values())

    @cached_property
    def first(self) -> Array:
        """State at the arm's home, the platform at rest."""
        state = self.sim.reset(q=self.sim.system.arm.home)
        z, zd = np.hstack([state.y, state.q]), np.hstack([state.yd, state.v])
        engine: Any = self.sim.backend
        remembered = [self.loop.memory[name].ravel() for name in self.shapes]
        return np.concatenate(
            [engine.states_of(np.arange(1), z, zd)[0], *remembered, np.zeros(6)]
        )

    def parted(self, x: Traced) -> dict[str, Array]:
        """Memory (1, ...) by name of a state."""
        out, at = {}, self.engine
        for name, shape in self.shapes.items():
            size = int(np.prod(shape))
            out[name] = x[at : at + size].reshape(1, *shape)
            at += size
        return out

    def before(self, g: Traced) -> casadi.Function:
        """(state, -, gains) -> the state, and the platform's acceleration (nodes 6)."""
        import casadi as ca

        x, n, order = symbols("x", (self.first.size,)), self.n, self.engine // 2
        kp, kd = (g[None, :n], g[None, n:]) if len(g) else np.zeros((2, 1, n))
        external: dict[str, Any] = {
            "q": x[None, 6 : 6 + n], "kp": kp, "kd": kd,
            "y_engine": x[None, :6], "yd_engine": x[None, order : order + 6],
        }  # fmt: skip
        memory, out = self._run(self.loop.wiring.before, x, external)
        path = out["acceleration"][0]
        state = column(x[: self.engine], *memory, path[-1])
        arguments = [column(x), ca.SX(0, 1), column(g)]
        return ca.Function("before", arguments, ca.cse([state, column(path)]))

    def after(self, g: Traced) -> casadi.Function:
        """(state, wrench (nodes 6), gains) -> the state."""
        import casadi as ca

        x, w = symbols("x", (self.first.size,)), symbols("w", (self.nodes * 6,))
        external = {"q": x[None, 6 : 6 + self.n], "wrench": w.reshape(1, -1, 6)}
        external["draws"] = np.zeros((1, 18))
        memory, _ = self._run(self.loop.wiring.after, x, external)
        state = column(x[: self.engine], *memory, x[-6:])
        return ca.Function("after", [column(x), column(w), column(g)], [ca.cse(state)])

    def _run(
        self, blocks: Any, x: Traced, external: Mapping[str, Any]
    ) -> tuple[list[Array], dict[str, Array]]:
        """Memory after some blocks, and what they put out."""
        if self.loop.estimate is None:
            external = {**external, "weight": np.zeros((1, 6))}
        memory = self.parted(x)
        changed, out = self.loop.wiring.run(blocks, self.loop.p, memory, external)
        return [changed.get(name, memory[name]) for name in memory], out

    def seen(self, x: Traced) -> dict[str, Array]:
        """Return a controller's inputs of a state: readings (6,), and `frozen` (1,)."""
        memory = self.parted(x)
        weight = memory["weight"][0] if self.loop.estimate is not None else np.zeros(6)
        reading = memory["reading"][0]
        sent = memory["command_sent"][0, :6]
        return {"w": reading, "wg": reading - weight, "y_cmd": sent, "frozen": memory["frozen"]}

    def modes(self, x: Traced) -> tuple[Array, Array]:
        """u and u' of the described base as `Simulator.base_modes` has them."""
        base, gears = self.sim.system.base, len(self.sim.system.actual.arm.geared)
        memory, order = self.parted(x), self.engine // 2
        bends = slice(gears + 6 + self.n, gears + 6 + self.n + self.sim.system.arm.bends)
        u, ud = x[:order][bends], x[order : self.engine][bends]
        if not base.m:
            return u, ud
        block: Any = self.loop.wiring.block("admittance")
        at, moving = block.oscillators
        coupled, frozen = memory["admittance.coupled"][0], memory["frozen"]
        still = np.concatenate([memory["command_sent"][0, :6], np.zeros(6)])
        vehicle = np.where(frozen != 0, still, memory["admittance.X"][0])
        at_platform = zip((x[:6], x[order : order + 6]), np.split(vehicle, 2), strict=True)
        lag = [(part - mode) @ base.coupling for part, mode in at_platform]
        parts = zip((u, ud), (coupled[at], coupled[moving]), lag, strict=True)
        shift, rate = (np.concatenate([a, b[: base.m] + c]) for a, b, c in parts)
        return shift, rate
