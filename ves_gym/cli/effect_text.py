"""How an effect is written on the command line: KIND:NAME=VALUE,NAME=VALUE."""

from __future__ import annotations

import dataclasses
import re
import tomllib
from typing import Any

import numpy as np

from ves_gym._util.params import ParameterError
from ves_gym._util.suggest import did_you_mean
from ves_gym.system.effect import EFFECTS, Effect

_NEXT = re.compile(r",\s*(?=[A-Za-z_]\w*\s*=)")  # the comma before another NAME=


def parse_effect(text: str) -> Effect:
    """Return the effect that `kind:name=value,name=value` describes.

    A value is a number or several with commas between them, 3,0,0; square brackets are for
    matrices and may be written around the latter as well, [[1, 0], [0, 1]].

    Raises:
        ParameterError: unknown kind or parameter, or a value that it cannot have.
    """
    kind, _, assignments = text.partition(":")
    if kind not in EFFECTS:
        raise ParameterError(
            f"--effect must be one of {', '.join(sorted(EFFECTS))}, got {kind!r}"
            f"{did_you_mean(kind, EFFECTS)}"
        )
    fields = {f.name: f for f in dataclasses.fields(EFFECTS[kind])}  # type: ignore[arg-type]
    values: dict[str, Any] = {}
    for part in _NEXT.split(assignments) if assignments.strip() else ():
        name, equals, value = (k.strip() for k in part.partition("="))
        if not equals or not value:
            raise ParameterError(
                f"--effect must be like {_example(kind)}, got {text!r}: no value in {part!r}"
            )
        if name not in fields:
            raise ParameterError(
                f"--effect {kind}: unknown parameter {name!r}; known:"
                f" {', '.join(map(_described, fields.values()))}{did_you_mean(name, fields)}"
            )
        if name in values:
            raise ParameterError(f"--effect {kind}: {name} is given more than once")
        values[name] = _numbers(value, fields[name])
    missing = [f for k, f in fields.items() if k not in values and f.default is _MISSING]
    if missing:
        raise ParameterError(
            f"--effect {kind} needs {', '.join(map(_described, missing))}, like"
            f" {_example(kind)}; got {text!r}"
        )
    effect: Effect = EFFECTS[kind](**values)
    return effect


_MISSING = dataclasses.MISSING


def _numbers(text: str, field: dataclasses.Field[Any]) -> Any:
    """Return a parameter's value: a number, a list, or the text itself, to be refused."""
    try:
        if "[" in text:
            return tomllib.loads(f"_ = {text}")["_"]
        values = [float(k) for k in text.split(",")]
    except ValueError:  # of TOML, too
        return text
    return values[0] if len(values) == 1 and not field.metadata["shape"] else values


def _described(field: dataclasses.Field[Any]) -> str:
    """Return name, unit and bounds of an effect's parameter."""
    (low, high), symbol = field.metadata["bounds"], field.metadata["unit"]
    return f"{field.name}{'' if symbol == '1' else f' [{symbol}]'} in [{low:g}, {high:g}]"


def _example(kind: str) -> str:
    """Return how an effect of a kind is written: its first parameter, large enough to see."""
    field = dataclasses.fields(EFFECTS[kind])[0]  # type: ignore[arg-type]
    low, high = field.metadata["bounds"]
    shape = tuple(3 if k is None else k for k in field.metadata["shape"])
    value = f"{high / 10 if high > 0 else low / 10:.1g}"
    if len(shape) < 2:
        return f"{kind}:{field.name}={','.join([value, *['0'] * (sum(shape) - 1)])}"
    return f"{kind}:{field.name}={np.full(shape, float(value)).tolist()}".replace(" ", "")
