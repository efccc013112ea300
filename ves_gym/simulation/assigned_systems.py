"""Simulations with a system of their own: `Simulator.assign` and `Simulator.assign_effects`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ves_gym._util.params import Index, ParameterError
from ves_gym.engine.backends.compiled import CompiledBackend
from ves_gym.engine.batch_parameters import bodies_of, require_alike, share_base
from ves_gym.hardware.admittance import require_admittances
from ves_gym.mechanics.base_model import BaseModel, semidefinite
from ves_gym.mechanics.servo import JointServo
from ves_gym.simulation.machines import Machines, Part, Source
from ves_gym.simulation.stable_step import require_stable_step, steps_are_small
from ves_gym.system.effect import BaseEffect, TorqueEffect
from ves_gym.system.effect_rows import EffectRows
from ves_gym.system.system import System


def assign(
    machines: Machines,
    parts: Sequence[Part],
    systems: Sequence[System],
    index: Index,
    servo: JointServo,
) -> None:
    """Give the simulations of `index` (k,) a system each, see `Simulator.assign`.

    Args:
        machines: whose simulations.
        parts: of the simulator.
        systems: k of them.
        index: which.
        servo: the highest gains that have been set.
    """
    if isinstance(systems, System) or len(systems) != len(index):
        got = "one System" if isinstance(systems, System) else f"{len(systems)}"
        raise ParameterError(f"systems must be a sequence of {len(index)}, got {got}")
    _require_possible(machines.system, systems, index, servo)
    if not len(index):
        return
    installs = [part.prepare(machines, index, systems) for part in parts]
    machines.backend.assign(index, [system.actual for system in systems])
    machines.note(index, systems)
    for install in installs:
        install()


def _require_possible(
    template: System, systems: Sequence[System], index: Index, servo: JointServo
) -> None:
    """Refuse systems that differ in more than numbers, or are too fast for the step."""
    stable = {bodies_of(template.actual)}
    for i, system in zip(index.tolist(), systems, strict=True):
        if not isinstance(system, System):
            raise ParameterError(f"systems must hold Systems, got {system!r}")
        share_base(template, system)
        require_alike(template, system, f"system of simulation {i}")
        # on a platform that goes where it is told, only gears may be faster
        judged = system.mode == "ideal" or bool(system.actual.arm.geared)
        if judged and bodies_of(system.actual) not in stable:
            require_stable_step(system.actual, servo)
            stable.add(bodies_of(system.actual))


def assign_effects(
    machines: Machines,
    parts: Sequence[Part],
    rows: EffectRows,
    index: Index,
    servo: JointServo,
) -> None:
    """Give the simulations of `index` (k,) effects, see `Simulator.assign_effects`.

    Args:
        machines, parts, index, servo: see `assign`.
        rows: k rows of the simulator's own system.
    """
    backend = machines.backend
    if rows.template != machines.system or len(rows) != len(index):
        raise ParameterError(
            f"rows must be {len(index)} of the simulator's own system, got {len(rows)} of"
            f" {rows.template!r}"
        )
    sources: list[Source] = [(rows, row) for row in range(len(rows))]
    before = (k if isinstance(k, System) else k[0] for k in machines.sources(index))
    at_once = rows.at_once and all(map(rows.replaces, {id(k): k for k in before}.values()))
    bases = rows.bases() if at_once and rows.varied(BaseEffect) else None
    if not at_once or (bases is not None and not isinstance(backend, CompiledBackend)):
        assign(machines, parts, [rows.system(row) for row in range(len(rows))], index, servo)
        machines.note(index, sources)
        return
    installs = [part.prepare_effects(machines, index, rows, bases) for part in parts]
    if bases is not None and isinstance(backend, CompiledBackend):
        _require_bases(rows, bases, servo)
        backend.assign_bases(index, bases)
    if rows.varied(TorqueEffect):
        backend.assign_laws(index, rows)
    for install in installs:
        install()
    machines.note(index, sources)


def _require_bases(rows: EffectRows, bases: BaseModel, servo: JointServo) -> None:
    """Refuse vehicles (k, ...) that cannot be, or are too fast for the physics step."""
    system = rows.template
    for row in np.flatnonzero(~semidefinite(bases)).tolist():
        _ = rows.system(row).actual  # says which matrix, and what it should be
    if system.mode == "emulated":
        require_admittances(bases, system.emulator_settings.admittance_form)
        return
    for row in np.flatnonzero(~steps_are_small(system, servo, bases)).tolist():
        require_stable_step(rows.system(row).actual, servo)
