"""Nested state in one file: arrays as safetensors, the rest as JSON in its header.

No pickle: what is read back are numbers, text, arrays, containers, `System`s and the plain
data classes of `ves_gym` itself; nothing in a file can name anything else to be built.
"""

from __future__ import annotations

import dataclasses
import importlib
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ves_gym._util.params import Array, ParameterError, write_bytes
from ves_gym.baselines.policy import _safetensors, load_arrays
from ves_gym.system.system import System

_TAG = "~"  # marks a dictionary that stands for something else
_ENTRY = "state"  # of the header


def save_state(
    path: str | os.PathLike[str], value: Any, references: Mapping[str, Any] | None = None
) -> None:
    """Write nested state completely or not at all.

    Args:
        path: of the file.
        value: numbers, text, arrays, containers, systems and data classes of `ves_gym`.
        references: by name, objects that the reader has: their names are saved.
    """
    packer = _Packer(references or {})
    tree = {"value": packer.pack(value), "systems": packer.systems}
    data = _safetensors().save(packer.arrays, metadata={_ENTRY: json.dumps(tree)})
    write_bytes(path, data)


def load_state(
    path: str | os.PathLike[str], references: Mapping[str, Any] | None = None
) -> Any:
    """Read what `save_state` wrote; refuse any other file."""
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        raise ParameterError(f"{path}: cannot be read: {error.strerror}") from None
    arrays = load_arrays(data, f"{path}: no checkpoint")
    try:
        size = int.from_bytes(data[:8], "little")
        tree = json.loads(json.loads(data[8 : 8 + size])["__metadata__"][_ENTRY])
    except (ValueError, KeyError) as error:
        raise ParameterError(f"{path}: no checkpoint: {error}") from None
    try:
        systems = [System.from_dict(plain, str(path)) for plain in tree["systems"]]
        return _unpack(tree["value"], arrays, systems, references or {})
    except ParameterError:
        raise
    except Exception as error:  # a damaged tree
        what = f"{type(error).__name__}: {error}"
        raise ParameterError(f"{path}: no checkpoint that is whole: {what}") from None


class _Packer:
    def __init__(self, references: Mapping[str, Any]) -> None:
        self.references = {id(value): name for name, value in references.items()}
        self.arrays: dict[str, Array] = {}
        self.systems: list[Any] = []
        self._places: dict[str, int] = {}  # hash of a system -> its place

    def pack(self, value: Any) -> Any:
        """Return plain data that JSON can hold; arrays and systems go to their lists."""
        if value is None or isinstance(value, (bool, str)) or type(value) in (int, float):
            return value
        if id(value) in self.references:
            return {_TAG: "reference", "name": self.references[id(value)]}
        if isinstance(value, np.ndarray) and value.dtype == object:  # events, systems by lane
            return {_TAG: "objects", "of": [self.pack(item) for item in value]}
        if isinstance(value, (np.ndarray, np.generic)):
            return self._array(np.asarray(value))
        if isinstance(value, System):
            at = self._places.setdefault(value.hash, len(self.systems))
            if at == len(self.systems):
                self.systems.append(value.to_dict())
            return {_TAG: "system", "at": at}
        if isinstance(value, list):
            return [self.pack(item) for item in value]
        if isinstance(value, tuple) and type(value) is tuple:
            return {_TAG: "tuple", "of": [self.pack(item) for item in value]}
        if isinstance(value, Mapping):
            items = [[self.pack(k), self.pack(v)] for k, v in value.items()]
            return {_TAG: "dict", "of": items}
        cls = type(value)
        if (names := _fields(cls)) is not None:
            items = [[k, self.pack(getattr(value, k))] for k in names]
            name = f"{cls.__module__}:{cls.__qualname__}"
            return {_TAG: "object", "class": name, "of": items}
        raise ParameterError(f"a checkpoint cannot hold {cls.__module__}.{cls.__qualname__}")

    def _array(self, array: Array) -> dict[str, Any]:
        if array.dtype.kind not in "fiub":
            raise ParameterError(f"a checkpoint cannot hold arrays of {array.dtype}")
        name = str(len(self.arrays))
        # sums may depend on the order in memory: it is kept
        turned = array.ndim > 1 and array.flags.f_contiguous and not array.flags.c_contiguous
        stored = array.T if turned else array
        self.arrays[name] = np.ascontiguousarray(stored).reshape(stored.shape)
        return {_TAG: "array", "at": name, **({"turned": True} if turned else {})}


def _unpack(
    tree: Any, arrays: Mapping[str, Array], systems: list[System], references: Mapping[str, Any]
) -> Any:
    def unpack_all(items: list[Any]) -> list[Any]:
        return [_unpack(item, arrays, systems, references) for item in items]

    if isinstance(tree, list):
        return unpack_all(tree)
    if not isinstance(tree, dict):
        return tree
    kind = tree[_TAG]
    if kind == "array":
        array = arrays[tree["at"]]
        return (array.T if tree.get("turned") else array).copy("K")  # what was read is frozen
    if kind == "objects":
        out = np.empty(len(tree["of"]), object)
        for i, item in enumerate(unpack_all(tree["of"])):
            out[i] = item
        return out
    if kind == "reference":
        return references[tree["name"]]
    if kind == "system":
        return systems[tree["at"]]
    if kind == "tuple":
        return tuple(unpack_all(tree["of"]))
    if kind == "dict":
        return dict(map(unpack_all, tree["of"]))
    return _build(tree["class"], dict(map(unpack_all, tree["of"])))


def _fields(cls: Any) -> tuple[str, ...] | None:
    """Names of the fields of a data class or named tuple of `ves_gym`, None of all else."""
    if not isinstance(cls, type) or cls.__module__.split(".")[0] != "ves_gym":
        return None
    if dataclasses.is_dataclass(cls):
        return tuple(f.name for f in dataclasses.fields(cls))
    return getattr(cls, "_fields", None)


def _build(name: str, values: dict[str, Any]) -> Any:
    module, _, qualname = name.partition(":")
    cls: Any = None
    if module.split(".")[0] == "ves_gym":
        cls = getattr(importlib.import_module(module), qualname, None)
    names = _fields(cls)
    if names is None or set(names) != set(values):
        raise ParameterError(f"a checkpoint of this version has no {name}")
    if not dataclasses.is_dataclass(cls):
        return cls(**values)
    out: Any = object.__new__(cls)  # type: ignore[arg-type]
    for key, value in values.items():
        object.__setattr__(out, key, value)  # frozen, and complete as it was
    return out
