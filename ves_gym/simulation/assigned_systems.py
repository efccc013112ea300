"""Simulations with a system of their own: `Simulator.assign` and `Simulator.assign_effects`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ves_gym._util.params import Index, ParameterError
from ves_gym.engine.backends.compiled import CompiledBackend
from ves_gym.engine.batch_parameters import bodies_of, require_alike, share_base
from ves_gym.hardware.admittance import require_admittances
from ves_gym.mechanics.base_model import BaseModel, semidefinite
from ves_gym.simulation.stable_step import require_stable_step, steps_are_small
from ves_gym.system.deviations import Delays
from ves_gym.system.effect import (
    ArmEffect,
    BaseEffect,
    DelayEffect,
    LaboratoryEffect,
    TorqueEffect,
)
from ves_gym.system.effect_rows import EffectRows, Given
from ves_gym.system.system import System

if TYPE_CHECKING:
    from ves_gym.simulation.simulator import Simulator


class AssignedSystems:
    """Which simulations have a system of their own, and how they are given one.

    Args:
        sim: whose simulations they are.
    """

    def __init__(self, sim: Simulator) -> None:
        self.sim = sim
        self._given: dict[int, Given] = {}  # (rows, row) before the system is asked for

    @property
    def systems(self) -> dict[int, System]:
        """By simulation; one that is not there has the simulator's."""
        return {
            i: source if isinstance(source, System) else source[0].system(source[1])
            for i, source in self._given.items()
        }

    def bodies(self, i: int) -> System:
        """Simulation i's system, or one with the same arm and vehicle where that is at hand."""
        given = self._given.get(i, self.sim.system)
        if isinstance(given, System):
            return given
        rows, row = given
        return rows.system(row) if rows.varied((ArmEffect, BaseEffect)) else self.sim.system

    def restore(self, then: Mapping[int, System]) -> None:
        """Return to what `systems` was."""
        current = self.systems
        ids = [
            i for i in sorted(then.keys() | current.keys()) if then.get(i) is not current.get(i)
        ]
        if ids:
            self.assign([then.get(i, self.sim.system) for i in ids], np.array(ids))

    def assign(self, systems: Sequence[System], index: Index) -> None:
        """Give the simulations of `index` (k,) a system each, see `Simulator.assign`."""
        sim = self.sim
        if isinstance(systems, System) or len(systems) != len(index):
            got = "one System" if isinstance(systems, System) else f"{len(systems)}"
            raise ParameterError(f"systems must be a sequence of {len(index)}, got {got}")
        self._require_possible(systems, index)
        if not len(index):
            return
        loop = sim.emulation_loop
        install = None if loop is None else loop.prepare(index, systems)
        sim.backend.assign(index, [system.actual for system in systems])
        if install is not None:
            install()
        if sim.joint_delays is not None:
            state = sim.state
            delays = [Delays.of(system) for system in systems]
            sim.joint_delays.assign(index, delays, state.q, state.v)
        for i, system in zip(index.tolist(), systems, strict=True):
            self._given[i] = system
            if system is sim.system:
                del self._given[i]
        if sim.payload is not None:
            sim.payload.assigned(index)

    def _require_possible(self, systems: Sequence[System], index: Index) -> None:
        """Refuse systems that differ in more than numbers, or are too fast for the step."""
        own = self.sim.system
        stable = {bodies_of(own.actual)}
        for i, system in zip(index.tolist(), systems, strict=True):
            if not isinstance(system, System):
                raise ParameterError(f"systems must hold Systems, got {system!r}")
            share_base(own, system)
            require_alike(own, system, f"system of simulation {i}")
            judged = system.mode == "ideal" or bool(system.actual.arm.geared)
            if judged and bodies_of(system.actual) not in stable:
                require_stable_step(system.actual)
                stable.add(bodies_of(system.actual))

    def assign_effects(self, rows: EffectRows, index: Index) -> None:
        """Give the simulations of `index` (k,) effects, see `Simulator.assign_effects`."""
        sim, backend = self.sim, self.sim.backend
        if rows.template != sim.system or len(rows) != len(index):
            raise ParameterError(
                f"rows must be {len(index)} of the simulator's own system, got {len(rows)} of"
                f" {rows.template!r}"
            )
        given = {i: (rows, row) for row, i in enumerate(index.tolist())}
        before = [source for source in map(self._given.get, given) if source is not None]
        sources = {id(k): k for k in (k if isinstance(k, System) else k[0] for k in before)}
        at_once = rows.at_once and all(map(rows.replaces, sources.values()))
        bases = rows.bases() if at_once and rows.varied(BaseEffect) else None
        if not at_once or (bases is not None and not isinstance(backend, CompiledBackend)):
            self.assign([rows.system(row) for row in range(len(rows))], index)
            self._given |= given
            return
        loop = sim.emulation_loop
        parameters = None
        if loop is not None and rows.varied(LaboratoryEffect):
            parameters = rows.loop_parameters(rows.before(loop.described(sim.system.arm)))
        if bases is not None and isinstance(backend, CompiledBackend):
            self._require_bases(rows, bases)
            backend.assign_bases(index, bases)
        if rows.varied(TorqueEffect):
            backend.assign_laws(index, rows)
        if loop is not None and (parameters is not None or bases is not None):
            loop.install(index, parameters, bases)
        if sim.joint_delays is not None and rows.varied(DelayEffect):
            state = sim.state
            sim.joint_delays.assign(index, [rows.delays()], state.q, state.v)
        self._given |= given

    def _require_bases(self, rows: EffectRows, bases: BaseModel) -> None:
        """Refuse vehicles (k, ...) that cannot be, or are too fast for the physics step."""
        system = self.sim.system
        for row in np.flatnonzero(~semidefinite(bases)).tolist():
            _ = rows.system(row).actual  # says which matrix, and what it should be
        if system.mode == "emulated":
            require_admittances(bases, system.emulator_settings.admittance_form)
            return
        for row in np.flatnonzero(~steps_are_small(system, bases)).tolist():
            require_stable_step(rows.system(row).actual)
