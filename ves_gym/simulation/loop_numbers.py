"""Numbers that the blocks of the emulation loop compute with, a row per simulation.

They follow from a system's laboratory (`LoopParameters`) and from its arm and vehicle
(`Bodies`); every simulation may have a system of its own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from ves_gym._util.params import Array, Index, ParameterError, Rows, object_rows
from ves_gym.engine.batch_parameters import Bodies, ParameterRows, bodies_of
from ves_gym.mechanics.arm import Arm
from ves_gym.simulation.blocks.block import Block, Noted
from ves_gym.simulation.blocks.sensing import ArmInertia
from ves_gym.system.deviations import LoopParameters
from ves_gym.system.effect import BaseEffect
from ves_gym.system.effect_rows import stacked
from ves_gym.system.system import System

BODIES = {field.name for field in fields(Bodies)}


@dataclass(frozen=True)
class Assignment:
    """Systems of their own for some simulations, checked."""

    systems: list[tuple[int, System]]  # of each simulation
    bodies: list[tuple[int, System, Bodies]]  # where arm or vehicle is another than before
    parameters: LoopParameters  # a row per simulation


class LoopNumbers:
    """Parameters of n emulators and of their blocks.

    Args:
        system: of all simulations at first.
        n: simulations.
        given: a function takes the place of the vehicle.
        compensating: the loop takes the arm's inertia out of the reading.

    Raises:
        ParameterError: effects on a vehicle whose place a function takes.
    """

    def __init__(self, system: System, n: int, *, given: bool, compensating: bool) -> None:
        on_base = [e.kind for e in system.effects if isinstance(e, BaseEffect)]
        if given and on_base:
            raise ParameterError(
                f"effect {on_base[0]} would do nothing: an `admittance` takes the vehicle's"
                " place"
            )
        self.system, self.spec, self.given = system, system.emulator_settings, given
        self.parameters = LoopParameters.nominal(system.arm, self.spec, n).edited(
            system.effects
        )
        self.noisy = self.parameters.sensor.random()
        base = system.actual.base  # the arm's model, in what follows, is the description
        self._linear = base.body is None and not given
        self._sampled = self._linear and not compensating  # a coupled one is not
        described = system.replace(effects=())  # what the compensation goes by
        self._names = ParameterRows(described) if compensating else None
        self.inertia = ArmInertia(described) if compensating else None
        self.bodies = self._row(system, "own system").repeated(n)
        self.systems = [system] * n
        self._start: LoopParameters | None = None  # before effects, of the last arm asked for
        self.p: dict[str, dict[str, Array]] = {}  # block -> its parameters
        self.sources: dict[str, set[str]] = {}  # block -> what its parameters follow from

    def load(self, blocks: Sequence[Block]) -> None:
        """Derive the parameters of blocks, and note what each block's follow from."""
        self.p, self.sources = {}, {}
        for block in blocks:
            sources = self.sources[block.name] = set()
            noted: Any = [Noted(k, sources) for k in (self.parameters, self.bodies)]
            values = block.parameters(*noted)
            # of its own, in plain order: products of stacks round by the layout of memory
            self.p[block.name] = {k: np.array(v, order="C") for k, v in values.items()}

    def derive(
        self, blocks: Sequence[Block], rows: Rows, changed: set[str]
    ) -> dict[str, list[str]]:
        """Bring the blocks' parameters of some simulations up to date.

        Args:
            blocks: of the loop.
            rows: which simulations.
            changed: fields of `parameters` and bodies.

        Returns:
            Block -> names of its parameters that are others than before.
        """
        p, bodies = self.parameters.rows(rows), self.bodies.rows(rows)
        others: dict[str, list[str]] = {}
        for block in blocks:
            if not changed & self.sources[block.name]:
                continue
            mine = self.p[block.name]
            for name, values in block.parameters(p, bodies).items():
                if not np.array_equal(mine[name][rows], values):
                    mine[name][rows] = values
                    others.setdefault(block.name, []).append(name)
        return others

    def described(self, arm: Arm) -> LoopParameters:
        """Return a row of parameters before any effect."""
        if self._start is None or self._start.arm is not arm:
            self._start = LoopParameters.nominal(arm, self.spec, 1)
        return self._start

    def put(self, rows: Rows, p: LoopParameters) -> set[str]:
        """Replace parameters of some simulations; names of those that have changed.

        Args:
            rows: which simulations.
            p: as many rows.
        """
        changed = self.parameters.put(rows, p)
        self.noisy = self.parameters.sensor.random()
        return changed

    def assignment(self, ids: Index, systems: Sequence[System]) -> Assignment:
        """Check systems for some simulations; nothing is changed.

        Args:
            ids: (k,) which.
            systems: k of them.

        Raises:
            ParameterError: systems that the simulations of one loop cannot have.
        """
        pairs = list(zip(ids.tolist(), systems, strict=True))
        numbers = [self.described(k.arm).mapped(np.copy).edited(k.effects) for k in systems]
        others = [(i, k) for i, k in pairs if _all_bodies(k) != _all_bodies(self.systems[i])]
        if self.given and any(k.vehicle is not self.system.vehicle for _, k in pairs):
            raise ParameterError(
                "an `admittance` takes the place of every simulation's vehicle: assign systems"
                " with the vehicle of the simulator's own"
            )
        row_of: dict[tuple[int, ...], Bodies] = {}  # of each arm and vehicle
        for i, k in others:
            if _all_bodies(k) not in row_of:
                row_of[_all_bodies(k)] = self._row(k, f"system of simulation {i}")
        bodies = [(i, k, row_of[_all_bodies(k)]) for i, k in others]
        return Assignment(pairs, bodies, numbers[0].mapped(stacked, *numbers[1:]))

    def assign(self, assignment: Assignment) -> None:
        """Put arms and vehicles of an assignment in place; its parameters go through `put`."""
        for i, _, row in assignment.bodies:
            self.bodies.put(i, row)
        for i, system in assignment.systems:
            self.systems[i] = system

    def _arrays(self) -> list[Any]:
        """All numbers, (n, ...) each."""
        blocks = [values for p in self.p.values() for values in p.values()]
        return [*self.parameters.parts(), *self.bodies.parts(), self.noisy, *blocks]

    def rows_of(self, ids: Index) -> dict[str, Array]:
        """Numbers and systems of simulations (k,)."""
        rows = {str(k): values[ids] for k, values in enumerate(self._arrays())}
        return rows | {"system": object_rows([self.systems[i] for i in ids.tolist()])}

    def put_rows(self, ids: Index, rows: Mapping[str, Array]) -> None:
        """Give simulations (k,) the numbers and systems of `rows_of`."""
        for k, values in enumerate(self._arrays()):
            values[ids] = rows[str(k)]
        for i, system in zip(ids.tolist(), rows["system"].tolist(), strict=True):
            self.systems[i] = system

    def silence(self) -> None:
        """Take noise and drift out of every sensor."""
        errors = self.parameters.sensor
        errors.noise[:], errors.drift[:] = 0.0, 0.0
        self.noisy = errors.random()

    def _row(self, system: System, which: str) -> Bodies:
        """Arm and vehicle of a system as one row."""
        numbers = np.empty(0)
        if self._names is not None and system.arm is self.system.arm:
            numbers = self._names.values  # those of the arm: a vehicle is the loop's alone
        elif self._names is not None:
            numbers = self._names.of(system.replace(effects=()), which)
        return Bodies.of(system, self._linear, self._sampled, numbers)


def _all_bodies(system: System) -> tuple[int, ...]:
    """Arm and vehicle as described and as they are."""
    return bodies_of(system) + bodies_of(system.actual)
