"""Simulations with a system of their own: `Simulator.assign` and `Simulator.assign_effects`."""

from __future__ import annotations

from collections.abc import Sequence

from ves_gym._util.params import Index, ParameterError
from ves_gym.engine.batch_parameters import bodies_of, require_alike, share_base
from ves_gym.mechanics.servo import JointServo
from ves_gym.simulation.machines import Machines, Part, Source
from ves_gym.simulation.stable_step import require_stable_step
from ves_gym.system.effect import TorqueEffect
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
    machines: Machines, parts: Sequence[Part], rows: EffectRows, index: Index, servo: JointServo
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
    if not (rows.at_once and all(map(rows.replaces, {id(k): k for k in before}.values()))):
        assign(machines, parts, [rows.system(row) for row in range(len(rows))], index, servo)
        machines.note(index, sources)
        return
    installs = [part.prepare_effects(machines, index, rows) for part in parts]
    if rows.varied(TorqueEffect):
        backend.assign_laws(index, rows)
    for install in installs:
        install()
    machines.note(index, sources)
