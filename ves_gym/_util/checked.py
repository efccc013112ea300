"""Arguments of public functions are checked at the door, by their annotations."""

from __future__ import annotations

import functools
import inspect
import math
import numbers
import os
import re
from collections.abc import Callable, Iterable, Mapping
from typing import Any, ParamSpec, TypeVar

from ves_gym._util.params import ParameterError

P = ParamSpec("P")
R = TypeVar("R")

_INNER = re.compile(r"\[[^\[\]]*\]")
# annotation, without what is in brackets -> its class, and how a message says it
_PLAIN: Mapping[str, tuple[type, str]] = {
    "float": (numbers.Real, "a finite number"),
    "int": (numbers.Integral, "a whole number"),
    "bool": (bool, "True or False"),
    "str": (str, "text"),
    "None": (type(None), "None"),
    "Path": (os.PathLike, "a path"),
    "os.PathLike": (os.PathLike, "a path"),
    "Sequence": (Iterable, "a list"),
    "tuple": (Iterable, "a tuple"),
    "Mapping": (Mapping, "a dict"),
    "Callable": (Callable, "a function"),  # type: ignore[dict-item]
}


def checked(*structural: str) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Decorate a function so that arguments of another kind are refused by their names.

    Annotations are compared with the names of an argument's classes, so that none has to be
    imported; what is in brackets, and arrays, are left to the function.

    Args:
        structural: annotations that no class of an argument has to be called by: protocols
            and aliases.

    Returns:
        The decorator. What it makes raises `ParameterError`.
    """

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        signature = inspect.signature(function)
        kinds = {
            name: _INNER.sub("", _INNER.sub("", p.annotation)).split(" | ")
            for name, p in signature.parameters.items()
            if p.kind is not p.VAR_KEYWORD
        }
        closed = {
            name: options
            for name, options in kinds.items()
            if all(k in _PLAIN or k.isidentifier() for k in options)
            and not {"Any", *structural} & set(options)
        }

        @functools.wraps(function)
        def door(*args: P.args, **kwargs: P.kwargs) -> R:
            try:
                arguments = signature.bind(*args, **kwargs).arguments
            except TypeError:  # Python says it better
                return function(*args, **kwargs)
            for name in (k for k in arguments if k in closed):
                value, options = arguments[name], closed[name]
                if not any(_is(value, kind) for kind in options):
                    expected = " or ".join(_PLAIN[k][1] if k in _PLAIN else k for k in options)
                    raise ParameterError(f"{name} must be {expected}, got {value!r}")
            return function(*args, **kwargs)

        return door

    return decorate


def _is(value: Any, kind: str) -> bool:
    if kind not in _PLAIN:
        return kind in (k.__name__ for k in type(value).__mro__)
    if kind in ("float", "int"):
        number = isinstance(value, _PLAIN[kind][0]) and not isinstance(value, bool)
        return number and math.isfinite(value)
    if kind == "Sequence" and isinstance(value, (str, Mapping)):
        return False
    return isinstance(value, _PLAIN[kind][0])
