"""From what a user writes (names, plain data, objects) to a `Task`; unknown keys are errors."""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import os
import typing
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from ves_gym._util.params import ParameterError, from_plain
from ves_gym._util.suggest import did_you_mean
from ves_gym.envs.base_control import BaseControl
from ves_gym.envs.control import Control, for_system, get_control
from ves_gym.envs.randomize import ranges_of
from ves_gym.envs.registration import IDS
from ves_gym.envs.task import TASKS, Task
from ves_gym.mechanics.arm_library import arm_from
from ves_gym.mechanics.vehicle import get_vehicle, vehicle_from_plain
from ves_gym.simulation.stable_step import with_stable_step
from ves_gym.system.effect import Effect
from ves_gym.system.system import System
from ves_gym.system.system_library import get_system

_KNOWN = tuple(entry.task for entry in IDS.values())
# modules of `ves_gym.envs` that hold a task of another name
_FILES = {"reach_goal": "reach", "seam": "track"}


class UnknownKeywordError(ParameterError, TypeError):
    """A keyword that an environment does not take.

    A `TypeError` as Python's own, with its words: TorchRL tries `frameskip` and goes on
    without it after "unexpected keyword argument 'frameskip'".
    """


def require_keywords(
    function: Callable[..., Any], task: str | type[Task] | Task, settings: Mapping[str, Any]
) -> None:
    """Refuse settings that are neither fields of a task nor keywords of `build_task`.

    Args:
        function: whose own keywords are named with the others.
        task: as in `build_task`.
        settings: what `function` received besides its own keywords.

    Raises:
        UnknownKeywordError: one that is unknown, the known ones, and the closest of them.
    """
    cls = type(task) if isinstance(task, Task) else get_task(task)
    names = dict.fromkeys(f.name for f in dataclasses.fields(cls))
    for signature in (inspect.signature(build_task), inspect.signature(function)):
        for name, parameter in signature.parameters.items():
            if parameter.kind in (parameter.KEYWORD_ONLY, parameter.POSITIONAL_OR_KEYWORD):
                names.setdefault(name)
    for key in settings:
        if key not in names:
            raise UnknownKeywordError(
                f"{function.__name__} of task {cls.kind} got an unexpected keyword argument"
                f" {key!r}; known: {', '.join(names)}{did_you_mean(key, names)}"
            )


def build_task(
    task: str | type[Task] | Task,
    *,
    system: System | Mapping[str, Any] | str | os.PathLike[str] | None = None,
    mode: str | None = None,
    vehicle: Any = None,
    arm: Any = None,
    effects: Iterable[Any] | None = None,
    control: str | Mapping[str, Any] | Control | None = None,
    randomize: Mapping[str, Mapping[str, Any]] | None = None,
    laboratory: str | None = None,
    **settings: Any,
) -> Task:
    """A task with some of its settings changed.

    Args:
        task: name, a class, or a task whose settings are the defaults.
        system: what to simulate: a `System`, its plain data, a name or a .toml or .json file.
        mode: ideal or emulated; changes the system's.
        vehicle: name, file, plain data or `Vehicle`; changes the system's.
        arm: name, file (URDF, MJCF, TOML), plain data or `Arm`; changes the system's.
        effects: effects or their plain data; replace the system's.
        control: name, plain data or `Control`.
        randomize: {effect: {parameter: (low, high)}}, drawn for every episode; other laws than
            the uniform one: {"normal": ...}, {"log_uniform": ...} (`randomize.Range`).
        laboratory: name of the errors that an emulated system has, nominal, lab, hard or
            held-out (docs/laboratory.md): effects and randomize, for what is not given itself.
        settings: other fields of the task.

    Raises:
        UnknownKeywordError: a keyword that is unknown.
        ParameterError: a value that is unknown or does not fit, with what was expected.
    """
    defaults = task if isinstance(task, Task) else None
    cls = type(task) if isinstance(task, Task) else get_task(task)
    fields = {f.name: f for f in dataclasses.fields(cls)}
    require_keywords(build_task, cls, settings)
    start: Any = defaults.system if defaults is not None else fields["system"].default
    ranges = None if randomize is None else ranges_of(randomize)
    if laboratory is not None:
        from ves_gym.envs.laboratories import laboratory as errors_of

        bare = _system(start, system, mode, vehicle, arm, ())
        errors = errors_of(laboratory, bare)
        effects = errors.effects if effects is None else effects
        ranges = errors.ranges if ranges is None else ranges
    values: dict[str, Any] = {"system": _system(start, system, mode, vehicle, arm, effects)}
    if control is not None:
        values["control"] = _control(control)
    else:
        default: Any = defaults.control if defaults is not None else fields["control"].default
        values["control"] = for_system(default, values["system"])
    if arm is not None or vehicle is not None:
        driven: Control = values["control"]
        driven.check(values["system"])
        servo = driven.servo_for(values["system"])
        values["system"] = with_stable_step(values["system"], servo)
    if ranges is not None:
        values["randomize"] = ranges
    typed = _typed(cls, settings)
    if defaults is not None:
        return dataclasses.replace(defaults, **values, **typed)
    return cls(**values, **typed)


def get_task(task: str | type[Task]) -> type[Task]:
    """A task's class, or the one registered by a name."""
    if isinstance(task, type) and issubclass(task, Task):
        return task
    if not isinstance(task, str):
        raise ParameterError(f"task must be a name or a Task, got {task!r}")
    if task in _KNOWN:
        importlib.import_module(f"ves_gym.envs.{_FILES.get(task, task)}")
    if task not in TASKS:
        names = tuple(dict.fromkeys((*_KNOWN, *TASKS)))
        raise ParameterError(
            f"task must be one of {', '.join(names)}, or a class, got {task!r}"
            f"{did_you_mean(task, names)}"
        )
    return TASKS[task]


def _typed(cls: type[Task], settings: Mapping[str, Any]) -> dict[str, Any]:
    """Settings checked against the types of the task's fields."""
    hints = typing.get_type_hints(cls)
    return {
        k: v if isinstance(v, BaseControl) else from_plain(hints[k], v, f"{cls.kind}.{k}")
        for k, v in settings.items()
    }


def _system(
    start: System, system: Any, mode: Any, vehicle: Any, arm: Any, effects: Any
) -> System:
    if isinstance(system, System):
        start = system
    elif isinstance(system, Mapping):
        start = System.from_dict(system)
    elif system is not None:
        start = get_system(system)
    changes: dict[str, Any] = {}
    if vehicle is not None:
        if isinstance(vehicle, (str, os.PathLike)):
            vehicle = get_vehicle(vehicle)
        elif isinstance(vehicle, Mapping):
            vehicle = vehicle_from_plain(vehicle)
        changes["vehicle"] = vehicle
    if arm is not None:
        changes["arm"] = arm_from(arm)
    if mode is not None and mode != start.mode:
        changes["mode"] = mode
        if mode == "ideal":
            start = start.ideal()
    if effects is not None:
        changes["effects"] = _effects(effects)
    out = start.replace(**changes)
    return with_stable_step(out) if {"arm", "vehicle"} & set(changes) else out


def _effects(effects: Any) -> tuple[Effect, ...]:
    how = '[ves_gym.effects.PayloadMass(mass=2.0)] or [{"kind": "payload/mass", "mass": 2.0}]'
    if isinstance(effects, (str, Mapping)) or not isinstance(effects, Iterable):
        raise ParameterError(f"effects must be a list, such as {how}, got {effects!r}")
    out = []
    for i, effect in enumerate(effects):
        if isinstance(effect, Mapping):
            effect = from_plain(Effect, effect, f"effects[{i}]")
        if not isinstance(effect, Effect):
            raise ParameterError(f"effects[{i}] must be an effect, as in {how}, got {effect!r}")
        out.append(effect)
    return tuple(out)


def _control(control_spec: str | Mapping[str, Any] | Control) -> Control:
    if isinstance(control_spec, Control):
        return control_spec
    if isinstance(control_spec, str):
        return get_control(control_spec)
    return from_plain(Control, control_spec, "control")
