"""A task's control period as graphs, from the NumPy text of task, control and bookkeeping.

The state of an episode is a carry of rows beside the engine's: reference and command, what the
task remembers, sums and counters. `move` turns an action into the moved reference, `follow`
into the engine's commands; the physics comes between; `close` gives reward, observation and
the next carry.
"""

from __future__ import annotations

import hashlib
import inspect
import itertools
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ves_gym._util.params import Array, Mask, ParameterError, content_hash
from ves_gym.engine.backends.base import MEANINGLESS
from ves_gym.engine.kernel import symbolic
from ves_gym.engine.kernel.compiled_function import CompiledFunction
from ves_gym.engine.kernel.numbers import is_ours
from ves_gym.engine.kernel.symbolic import Traced, batch_of_symbols, column, per_row
from ves_gym.envs.base_control import wheels_of
from ves_gym.envs.control import Control
from ves_gym.envs.episode import Episodes, bounded, count, endings, judge, scaled_observation
from ves_gym.envs.task import Scene, Task
from ves_gym.mechanics.contact import FLOATING, payload_of
from ves_gym.mechanics.latch import BODY, NUMBERS, TARGET, named, target, tool_in_space
from ves_gym.mechanics.pointing import opposites
from ves_gym.mechanics.spatial import SINGULAR, twist
from ves_gym.mechanics.vehicle import Satellite, act, has_jets
from ves_gym.system.system import System

if TYPE_CHECKING:
    import casadi

WIDEST = 64  # numbers of a goal that formulas may see; longer ones are tables (`Task.lookup`)
FLAGS = ("last", "failed", "solved", "once", "diverged", "event")  # last rows of `close`
LATCHES = ("closes", "opens")  # and where a payload takes part


def layout(*parts: tuple[str, int]) -> dict[str, slice]:
    """Columns of named parts one after another."""
    ends = list(itertools.accumulate((size for _, size in parts), initial=0))
    return {name: slice(a, b) for (name, _), a, b in zip(parts, ends, ends[1:], strict=False)}


def width(columns: dict[str, slice]) -> int:
    """Number of columns of a `layout`."""
    return max((k.stop for k in columns.values()), default=0)


@dataclass(frozen=True)
class Shape:
    """Sizes and columns of a task's rows."""

    task: Task
    system: System  # with the randomised effects
    coordinates: int  # of the engine, hidden ones included
    goal: int
    table_values: int
    terms: tuple[str, ...]  # of the reward, `failure` included
    # signals that the emulation loop's halves are given, where they are part of the program
    signals: tuple[tuple[str, ...], tuple[str, ...]] | None = None

    @property
    def joints(self) -> int:
        """Number of joints."""
        return self.system.arm.n

    @cached_property
    def feedforward(self) -> bool:
        """A command has the torque that the reference takes added."""
        control = self.task.control
        follows = self.system.drive == "motor" and control.level != "torque"
        return follows and control.servo.feedforward

    @cached_property
    def reference(self) -> dict[str, slice]:
        """Columns of the outputs of `move`."""
        n = self.joints
        return layout(("ref", 3 * n), ("kp", n), ("kd", n), ("clipped", 1), ("command", n))

    @cached_property
    def carry(self) -> dict[str, slice]:
        """Columns of all that is carried from period to period."""
        n = self.joints
        return layout(
            ("ref", 3 * n), ("kp", n), ("kd", n), ("clipped", 1), ("tau", n),
            ("memory", self.task.memory), ("energies", 2), ("sums", 2), ("peaks", 2),
            ("total", 1), ("cost", 1), ("missing", 2), ("once", 1), ("steps", 1),
        )  # fmt: skip

    @cached_property
    def inputs(self) -> dict[str, slice]:
        """Columns of further inputs of `close`: tables, measurements, marks set by Python."""
        return layout(
            ("table_values", self.table_values), ("y_seen", 6), ("yd_seen", 6), ("stopped", 1),
            ("over", 1), ("tail", 1),
        )  # fmt: skip

    @cached_property
    def outputs(self) -> dict[str, slice]:
        """Columns of the outputs of `close`."""
        size = sum(f.size for f in self.task.fields())
        terms = [(f"reward/{name}", 1) for name in self.terms]
        flags = [(name, 1) for name in self.flags]
        return layout(("observation", size), *terms, ("reward", 1), *flags)

    @property
    def flags(self) -> tuple[str, ...]:
        """Names of the last outputs of `close`."""
        return (*FLAGS, *(LATCHES if self.task.interacts else ()))

    @cached_property
    def scene(self) -> dict[str, slice]:
        """Columns of what is computed of the state for `close`."""
        parts = [("energies", 2), ("tool", 3), ("tool_seen", 3)]
        if self.task.interacts:
            parts.append(("payload", TARGET))
        if self.system.contact is not None:
            parts.append(("contact", 7))
        if self.task.base_control is not None:
            parts.append(("propellant", 1))
        return layout(*parts)

    @cached_property
    def wheels(self) -> slice:
        """Columns of the engine's state that are speeds of reaction wheels."""
        arm = self.system.actual.arm
        first = self.coordinates + 6 + self.joints + len(arm.geared) + arm.bends
        wheels = len(wheels_of(self.system)) if self.system.mode == "ideal" else 0
        return slice(first, first + wheels)

    @cached_property
    def actuators(self) -> dict[str, slice]:
        """Columns of what wheels and jets do and remember."""
        jets = len(getattr(self.system.vehicle, "jets", None) or ())
        wheels = self.wheels.stop - self.wheels.start
        return layout(
            ("torque", wheels), ("wrench", 6), ("owed", jets), ("left", jets), ("propellant", 1)
        )

    @cached_property
    def nodes(self) -> int:
        """Commands per period: one where it is held."""
        return 1 if self.task.control.held else self.system.substeps + 1


def carry_rows(shape: Shape, s: Scene, e: Episodes) -> Array:
    """Rows (k, ...) of what is carried from period to period, from scene and episodes.

    Args:
        shape: of the rows.
        s, e: of k simulations.
    """
    parts = [getattr(s if hasattr(s, name) else e, name) for name in shape.carry]
    return np.hstack([np.reshape(k, (len(s.q), -1)) for k in parts], dtype=np.float64)


def compiles(task: Task) -> bool:
    """Task and control say of themselves that they are formulas, and jets have one."""
    control, drive = type(task.control), type(task.control).drive
    says = all(vars(k).get("compiled", False) for k in (type(task), control))
    jets = getattr(task.system.vehicle, "jets", None) or ()
    searched = task.base_control is not None and jets and opposites(jets) is None
    return says and drive is Control.drive and not (searched or task.tumbles)


def functions(shape: Shape, probe: bytes | None = None) -> dict[str, CompiledFunction]:
    """The compiled pieces of a task, by name.

    Args:
        shape: of its rows.
        probe: numbers that its formulas give: whatever text they come from, other numbers are
            other code. Without them the graphs themselves decide.

    Raises:
        FormulaError: when the first is compiled, with file and line of what cannot be followed.
    """
    task = shape.task
    what: Any = None  # text that may change under the same name
    if probe is not None and is_ours(type(task)) and is_ours(type(task.control)):
        what = (
            content_hash(task), type(task).__qualname__, hashlib.sha256(probe).hexdigest(),
            shape.coordinates, shape.terms, shape.signals,
        )  # fmt: skip
    return {
        name: CompiledFunction(
            what and (name, what),
            partial(_followed, shape.task, make),
            in_place=name in ("actuate", "afloat"),
        )
        for name, make in _graphs(shape).items()
    }


# ------------------------------------------------------------------------------- graphs


class FormulaError(ParameterError):
    """A task or control is declared a formula and cannot be traced with symbols."""


def _followed(task: Task, make: Callable[[], casadi.Function]) -> casadi.Function:
    """Make a graph; an error names the last line of task or control."""
    try:
        return make()
    except Exception as error:
        frames = traceback.extract_tb(error.__traceback__)
        machinery = str(Path(symbolic.__file__).parent), __file__, str(Path(np.__file__).parent)
        formulas = [k for k in frames if not k.filename.startswith(machinery)]
        where = str(inspect.getsourcefile(type(task)))
        if formulas:
            where = f"{formulas[-1].filename}:{formulas[-1].lineno}, `{formulas[-1].line}`"
        raise FormulaError(
            f"task {task.kind} with control {task.control.kind} says `compiled`, but cannot be:"
            f" {where}: {error}. Write array formulas, a simulation per row, or leave"
            " `compiled` out: its steps then run in NumPy"
        ) from error


def _graphs(shape: Shape) -> dict[str, Callable[[], casadi.Function]]:
    """Return the makers of each piece's graph: `keep`, `move`, `follow`, `close`, and wires."""
    makers = {"keep": _carry_over, "move": _move, "follow": _follow, "close": _close}
    out: dict[str, Callable[[], casadi.Function]]
    out = {name: partial(make, shape) for name, make in makers.items()}
    if shape.task.base_control is not None:
        out["actuate"] = partial(_actuate, shape)
    if shape.task.interacts:
        out["target"] = partial(_target, shape)
        out["afloat"] = _afloat
    if shape.signals:
        names = ("before", "nodes", "after", "seen", "modes")[: 5 if shape.system.base.m else 4]
        out |= {f"lab_{k}": partial(_laboratory, shape, f"lab_{k}") for k in names}
    return out


def _carry_over(shape: Shape) -> casadi.Function:
    import casadi as ca

    carried = ca.SX.sym("carry", width(shape.carry))
    return ca.Function("keep", [carried], [carried])


def _scene(shape: Shape, carried: Traced, z: Traced, zd: Traced, goal: Traced) -> Scene:
    """A scene of symbols, to be completed by what there is."""
    n, rows = shape.joints, len(carried)
    k = {name: carried[:, at].copy() for name, at in shape.carry.items()}
    none = np.zeros((rows, 0))
    return Scene(
        time=k["steps"][:, 0] * shape.system.substeps * shape.system.physics_dt,
        q=z[:, 6:].copy(), v=zd[:, 6:].copy(), y=z[:, :6].copy(), yd=zd[:, :6].copy(),
        y_seen=none, yd_seen=none, tool=none, tool_seen=none, energies=k["energies"],
        ref=k["ref"].reshape(rows, 3, n), goal=goal, memory=k["memory"], table_values=none,
        tau=k["tau"], tail=none, kp=k["kp"], kd=k["kd"], payload=none, contact=none,
        wheels=none, propellant=np.zeros(rows),
    )  # fmt: skip


def _episodes(shape: Shape, carried: Traced) -> Episodes:
    k = {name: carried[:, at].copy() for name, at in shape.carry.items()}
    none: Any = np.zeros(len(carried))
    return Episodes(
        root=none, index=none, number=none, steps=k["steps"][:, 0],
        clipped=k["clipped"][:, 0], once=k["once"][:, 0], total=k["total"][:, 0],
        cost=k["cost"][:, 0], missing=k["missing"], sums=k["sums"], peaks=k["peaks"],
    )  # fmt: skip


def _move(shape: Shape) -> casadi.Function:
    """(z, zd, carry, goal, action) -> `Shape.reference`."""
    task, system, n = shape.task, shape.system, shape.joints
    control, dt = task.control, system.control_dt

    def advanced(*rows: Traced) -> tuple[Any, ...]:
        z, zd, carried, goal, action = rows
        s, e = _scene(shape, carried, z, zd, goal), _episodes(shape, carried)
        remaining: Any = task.duration - e.steps * dt
        follow = lambda: plain_command(task, s)  # noqa: E731
        joints = bounded(e, action)[:, : control.width(system.arm)]
        control.command(s, joints, system.arm, dt, remaining, follow)
        return s.ref.reshape(len(z), 3 * n), s.kp, s.kd, e.clipped, s.tau

    size = 6 + n
    sizes = (size, size, width(shape.carry), shape.goal, task.action_width)
    return _graph("move", advanced, sizes, (3 * n, n, n, 1, n))


def plain_command(task: Task, s: Scene) -> Array:
    """Drive command (n, joints) that follows the reference, without feed-forward torque."""
    if task.system.drive == "prescribed":
        return s.ref[:, 2].copy()
    if task.control.level == "torque":
        return np.zeros_like(s.q)
    return s.kp * s.ref[:, 0] + s.kd * s.ref[:, 1]


def _follow(shape: Shape) -> casadi.Function:
    """(tau before, reference, feed-forward) -> (the engine's commands, tau, gains)."""
    import casadi as ca

    n, at = shape.joints, shape.reference
    before, reference = ca.SX.sym("before", n), ca.SX.sym("reference", width(at))
    extra = ca.SX.sym("extra", n)
    end = reference[at["command"]]
    if shape.feedforward:
        end = end + extra
    nodes = []
    for k in range(shape.nodes):
        share = k / max(shape.nodes - 1, 1)
        command = end if shape.nodes == 1 else before + share * (end - before)
        nodes += [ca.SX.zeros(6), command]
    gains = ca.vertcat(reference[at["kp"]], reference[at["kd"]])
    return ca.Function("follow", [before, reference, extra], [ca.vertcat(*nodes), end, gains])


def _close(shape: Shape) -> casadi.Function:
    """(z, zd, x, carry, reference, tau, goal, inputs, scene) -> (outputs, next carry)."""
    task, system = shape.task, shape.system
    dt = system.control_dt
    scale = np.concatenate([f.scale for f in task.fields()])

    def closed(*rows: Traced) -> tuple[Any, ...]:
        z, zd, x, carried, reference, tau, goal, inputs, scene_rows = rows
        s, e = _scene(shape, carried, z, zd, goal), _episodes(shape, carried)
        before = s.energies
        s.time = np.add(e.steps, 1, dtype=np.float64) * system.substeps * system.physics_dt
        s.ref = reference[:, shape.reference["ref"]].reshape(s.ref.shape)
        s.kp, s.kd = (reference[:, shape.reference[k]] for k in ("kp", "kd"))
        s.tau, e.clipped = tau, reference[:, shape.reference["clipped"]][:, 0]
        for name, at in shape.scene.items():
            setattr(s, name, scene_rows[:, at])
        if "propellant" in shape.scene:
            s.propellant = s.propellant[:, 0]
        s.wheels = x[:, shape.wheels]
        k = {name: inputs[:, at] for name, at in shape.inputs.items()}
        s.table_values, s.tail, over, stopped = (
            k["table_values"], k["tail"][:, 0], k["over"][:, 0], k["stopped"][:, 0],
        )  # fmt: skip
        s.y_seen, s.yd_seen = s.y, s.yd
        if system.mode == "emulated":
            s.y_seen, s.yd_seen = k["y_seen"], k["yd_seen"]
        # as the engine and `Simulator` judge
        sane: Mask = np.all(np.abs(x) < MEANINGLESS, axis=1)
        if system.base.body is not None:
            sane = sane & (np.cos(z[:, 4]) >= SINGULAR)
        closes = task.closes(s) if task.interacts else None
        count(task, s, e, before, dt)
        last, failed = endings(task, s, e, stopped | ~sane, over)
        verdict = judge(task, s, e, dt, last, failed, over, ~sane)
        terms = tuple(verdict.terms[name] for name in shape.terms)
        event, latches = last | failed | ~sane, []
        if closes is not None:
            acts = sane & ~(stopped | over)
            latches = [closes & acts, task.opens(s) & acts]
            event = event | latches[0] | latches[1]
        flags = (last, failed, verdict.solved, e.once, ~sane, event, *latches)
        carry = (
            s.ref.reshape(len(z), -1), s.kp, s.kd, e.clipped, s.tau, s.memory, s.energies,
            e.sums, e.peaks, e.total, e.cost, e.missing, e.once, e.steps,
        )  # fmt: skip
        return (scaled_observation(task, s, scale), *terms, verdict.reward, *flags, *carry)

    size, at = 6 + shape.joints, shape.carry
    sizes = (
        size, size, 2 * shape.coordinates, width(at), width(shape.reference), shape.joints,
        shape.goal, width(shape.inputs), width(shape.scene),
    )  # fmt: skip
    outputs = tuple(k.stop - k.start for k in shape.outputs.values())
    carried = tuple(k.stop - k.start for k in at.values())
    return _graph("close", closed, sizes, (*outputs, *carried), len(outputs))


def _actuate(shape: Shape) -> casadi.Function:
    """(action, x, `Shape.actuators`) -> the same after it, propellant, the engine's inputs."""
    task, at = shape.task, shape.actuators
    control, vehicle = task.base_control, shape.system.vehicle
    assert control is not None and isinstance(vehicle, Satellite)
    engine = at["torque"].stop + 6 * has_jets(vehicle)
    alone = (1,) * (1 + engine)

    def acted(action: Traced, x: Traced, memory: Traced) -> tuple[Any, ...]:
        beside = np.clip(action[:, task.control.width(shape.system.arm) :], -1.0, 1.0)
        state = (memory[:, at[k]] for k in ("owed", "left", "propellant"))
        command = control.asked(shape.system, beside)
        out = act(vehicle, shape.system.control_dt, *command, x[:, shape.wheels], *state)
        return np.concatenate(out, axis=1), out[-1], *np.concatenate(out[:2], axis=1).T[:engine]

    sizes = task.action_width, 2 * shape.coordinates, width(at)
    return _graph("actuate", acted, sizes, (width(at), *alone), *range(1, 1 + len(alone)))


def _target(shape: Shape) -> casadi.Function:
    """(x, free body, its other numbers) -> `latch.LatchTarget` in rows."""
    arm, n, order = shape.system.actual.arm, shape.joints, shape.coordinates

    def seen(x: Traced, body: Traced, others: Traced) -> tuple[Any, ...]:
        y, q, yd, v = x[:, :6], x[:, 6 : 6 + n], x[:, order : order + 6], x[:, order + 6 :]
        q, v = q.copy(), v[:, :n].copy()
        for k, i in enumerate(arm.geared):  # the links turn further than the rotors
            q[:, i] += x[:, 6 + n + k]
            v[:, i] += x[:, order + 6 + n + k]
        tool = tool_in_space(arm, y, twist(y, yd), q, v)
        parts = named(body, BODY) | named(others, NUMBERS)
        return (target(tool, arm.tool_rotation, parts).rows(),)

    sizes = 2 * order, sum(BODY.values()), sum(NUMBERS.values())
    return _graph("target", seen, sizes, (TARGET,))


def _afloat() -> casadi.Function:
    """(a touched payload's coordinates and rates, centre of mass, carried, free body) -> it."""

    def moved(
        b: Traced, bd: Traced, com: Traced, held: Traced, body: Traced
    ) -> tuple[Any, ...]:
        return (np.where(held > 0, body, payload_of(b, bd, com)),)

    size = sum(BODY.values())
    return _graph("afloat", moved, (FLOATING, FLOATING, 3, 1, size), (size,))


def _laboratory(shape: Shape, name: str) -> casadi.Function:
    """One of the wires between engine and emulation loop: rows in their places.

    `lab_before`: (z, zd, gains) -> each signal given to the first half. `lab_nodes`:
    (platform's accelerations, joint commands) -> the engine's. `lab_after`: (the engine's
    outputs, z, draws, reading) -> each given to the second half, the reading of before.
    `lab_seen`: (measured pose, vehicle's state, frozen, diverged) -> what is measured.
    `lab_modes`: (internal modes of the model, z, zd, vehicle's state, command sent, frozen) ->
    the modes on the platform (`Simulator.base_modes`).
    """
    import casadi as ca

    n, count = shape.joints, shape.system.substeps + 1
    size, width = 6 + n, 12 + 2 * n  # accelerations, torques, wrench
    z, zd, gains = ca.SX.sym("z", size), ca.SX.sym("zd", size), ca.SX.sym("gains", 2 * n)
    draws, outputs = ca.SX.sym("draws", 18), ca.SX.sym("outputs", count * width)
    forces = [outputs[(i + 1) * width - 6 : (i + 1) * width] for i in range(count)]
    signals = {
        "q": z[6:], "kp": gains[:n], "kd": gains[n:], "y_engine": z[:6], "yd_engine": zd[:6],
        "weight": ca.SX.zeros(6), "wrench": ca.vertcat(*forces), "draws": draws,
    }  # fmt: skip
    assert shape.signals is not None
    first, second = ([signals[k] for k in names] for names in shape.signals)
    push, constant = ca.SX.sym("push", 6 * count), shape.nodes == 1
    commands = ca.SX.sym("commands", shape.nodes * size)
    nodes = []
    for i in range(count):
        at = 0 if constant else i * size
        nodes += [push[6 * i : 6 * i + 6], commands[at + 6 : at + size]]
    y, X, reading = ca.SX.sym("y", 6), ca.SX.sym("X", 12), ca.SX.sym("reading", 6)
    frozen, lost = ca.SX.sym("frozen"), ca.SX.sym("lost")
    scene_rows = ca.vertcat(y, ca.if_else(frozen, 0.0, X[6:]), ca.fmax(frozen, lost))
    modes = {}
    if shape.system.base.m:
        u, ud = (ca.SX.sym(name, shape.system.base.m) for name in ("u", "ud"))
        sent, coupled = ca.SX.sym("sent", 12), ca.SX(shape.system.base.coupling.T)
        pose = ca.if_else(frozen, sent[:6], X[:6])
        away, faster = z[:6] - pose, zd[:6] - scene_rows[6:12]
        deflected = u + ca.mtimes(coupled, away), ud + ca.mtimes(coupled, faster)
        inputs = [u, ud, z, zd, X, sent, frozen]
        modes["lab_modes"] = ca.Function("lab_modes", inputs, [ca.vertcat(*deflected)])
    wires = {
        **modes,
        "lab_before": ca.Function("lab_before", [z, zd, gains], first),
        "lab_nodes": ca.Function("lab_nodes", [push, commands], [ca.vertcat(*nodes)]),
        "lab_after": ca.Function(
            "lab_after", [outputs, z, draws, reading], [*second, ca.SX(reading)]
        ),
        "lab_seen": ca.Function("lab_seen", [y, X, frozen, lost], [scene_rows]),
    }
    return wires[name]


def _graph(
    name: str,
    function: Callable[..., tuple[Any, ...]],
    sizes: tuple[int, ...],
    shapes: tuple[int, ...],
    *splits: int,
) -> casadi.Function:
    """NumPy text as a graph; its results are stacked, from each of `splits` on anew."""
    import casadi as ca

    rows = [batch_of_symbols(f"{name}{i}_", size) for i, size in enumerate(sizes)]
    parts = per_row(function, *rows, shapes=shapes)
    ends = 0, *splits, len(parts)
    stacks = [parts[a:b] for a, b in itertools.pairwise(ends)]
    outputs = [ca.vertcat(*(k for part in stack for k in part)) for stack in stacks]
    inputs = [column(row[0]) for row in rows]
    return ca.Function(name, inputs, [ca.densify(k) for k in ca.cse(outputs)])
