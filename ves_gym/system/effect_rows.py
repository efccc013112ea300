"""Effects whose parameters differ between simulations, as arrays: no `System` per simulation.

An effect written for numbers edits k simulations at once where it is given arrays whose last
axis is the simulations', and parameters turned alike: NumPy's broadcasting lines them up.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from functools import cached_property
from typing import Any

import numpy as np

from ves_gym._util.params import Array
from ves_gym.system.deviations import LoopParameters, axis_to_end
from ves_gym.system.effect import (
    ArmEffect,
    BaseEffect,
    DelayEffect,
    Effect,
    LaboratoryEffect,
    TorqueEffect,
)
from ves_gym.system.system import System

BODIES = (ArmEffect, BaseEffect)  # whose arms and vehicles are objects of their own
# with delays a period runs in NumPy, and a reset costs little beside it
ONE_BY_ONE = (*BODIES, DelayEffect)


class EffectRows:
    """Values of some effects' parameters for k simulations of one system.

    Args:
        system: with every effect; what no row says is as it stands there.
        values: (k, *shape) by place of the effect in `system.effects` and name of the
            parameter.
        at_once: `together` holds for such rows.
    """

    def __init__(
        self, system: System, values: Mapping[tuple[int, str], Array], at_once: bool = False
    ) -> None:
        self.template, self.values = system, values
        self.at_once = at_once and not self.varied(ONE_BY_ONE)
        self._size = len(next(iter(values.values())))
        self._systems: dict[int, System] = {}

    def __len__(self) -> int:
        return self._size

    def system(self, row: int) -> System:
        """The system of one simulation, made on first use."""
        if row not in self._systems:
            effects = list(self.template.effects)
            for i in self.places:
                effects[i] = dataclasses.replace(effects[i], **self._row(i, row))  # type: ignore[type-var]
            self._systems[row] = self.template.replace(effects=tuple(effects))
        return self._systems[row]

    @cached_property
    def places(self) -> tuple[int, ...]:
        """Effects that differ, by their place in the system."""
        return tuple(dict.fromkeys(i for i, _ in self.values))

    def varied(self, kind: type[Effect] | tuple[type[Effect], ...]) -> bool:
        """True if an effect of a kind differs between simulations."""
        return any(isinstance(self.template.effects[i], kind) for i in self.places)

    def replaces(self, earlier: System | EffectRows) -> bool:
        """True if these rows say all that differs from `template`, with `earlier` in force."""
        if isinstance(earlier, System):
            return False
        same = earlier.template is self.template and earlier.places == self.places
        return same and earlier.at_once

    def _row(self, i: int, row: int) -> dict[str, Any]:
        return {name: v[row].tolist() for (k, name), v in self.values.items() if k == i}

    def _turned(self, i: int) -> Effect:
        """Effect i with arrays (*shape, k) for parameters."""
        effect, values = self.template.effects[i], {}
        for field in dataclasses.fields(effect):  # type: ignore[arg-type]
            if (i, field.name) in self.values:
                values[field.name] = axis_to_end(self.values[i, field.name])
            else:
                value = np.array(getattr(effect, field.name), float)[..., None]
                values[field.name] = np.broadcast_to(value, (*value.shape[:-1], len(self)))
        turned: Effect = effect.bound(values)
        return turned

    # ------------------------------------------------------------------- batches

    def loop_parameters(self, start: LoopParameters) -> LoopParameters:
        """Parameters (k, ...) of the emulation loop.

        Args:
            start: one row, with the effects before the first that differs.

        Raises:
            ParameterError: relative changes that add up to -1 or less.
        """
        p = start.mapped(lambda row: axis_to_end(np.repeat(row, len(self), axis=0)))
        for i in range(self.places[0], len(self.template.effects)):
            effect = self._turned(i)
            if isinstance(effect, LaboratoryEffect):
                effect.edit(p)

        def first(part: Array, row: Array) -> Array:
            full = np.broadcast_to(part, (*row.shape[1:], len(self)))  # some are alike for all
            return np.ascontiguousarray(full.transpose(-1, *range(full.ndim - 1)))

        return p.mapped(first, start).checked()

    def laws(self) -> dict[str, Array]:
        """Parameters (k,) of the torque laws that differ, by their names in the kernel."""
        out = {}
        # the engine's own system has no effects on arm and vehicle (`System.actual`)
        effects = [
            (i, e) for i, e in enumerate(self.template.effects) if not isinstance(e, BODIES)
        ]
        for place, (i, effect) in enumerate(effects, start=1):
            for (k, name), rows in self.values.items():
                if k != i or not isinstance(effect, TorqueEffect):
                    continue
                label = f"{effect.kind}#{place}.{name}"
                if rows.ndim == 1:
                    out[label] = rows
                else:
                    out |= {f"{label}{j}": x for j, x in enumerate(rows.T, start=1)}
        return out

    def before(self, start: LoopParameters) -> LoopParameters:
        """One row edited by the effects before the first that differs.

        Args:
            start: parameters as described, (1, ...).
        """
        out = start.mapped(np.copy)
        for effect in self.template.effects[: self.places[0]]:
            if isinstance(effect, LaboratoryEffect):
                effect.edit(out)
        return out

    def together(self, start: LoopParameters | None) -> bool:
        """Return True if these rows at once give the very bits that each gives by itself.

        Not so where an effect is written for the leading axis, asks `if` of a number, or makes
        a matrix of a fixed size.

        Args:
            start: (1, ...) the emulation loop as described; None in space.
        """
        systems = [self.system(row) for row in range(len(self))]
        try:
            if self.varied(LaboratoryEffect) and start is not None:
                ours = self.loop_parameters(self.before(start))
                rows = [start.mapped(np.copy).edited(system.effects) for system in systems]
                theirs = rows[0].mapped(stacked, *rows[1:])
                if not all(map(_same, ours.parts(), theirs.parts())):
                    return False
        except (ValueError, IndexError, TypeError):
            return False
        return True


def stacked(*parts: Array) -> Array:
    """Arrays (k, ...) one after the other."""
    return np.concatenate(parts)


def _same(a: Array, b: Array) -> bool:
    return a.shape == b.shape and a.tobytes() == b.tobytes()
