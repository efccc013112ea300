"""Frozen parameter sets: units on the fields, strict reading, exact round trips.

Every parameter set of `ves_gym` is a frozen dataclass whose array-like values are
nested tuples of float, so that it can be compared, hashed and written to TOML or
JSON without loss. Reading rejects unknown and missing keys by name.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
import math
import numbers
import os
import re
import tempfile
import tomllib
import types
import typing
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from ves_gym._util.suggest import did_you_mean, why_unread

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]
Mask = npt.NDArray[np.bool_]
Rows = Index | slice  # some rows of an array
Vector = tuple[float, ...]
Matrix = tuple[tuple[float, ...], ...]
T = TypeVar("T")


def object_rows(values: Sequence[object]) -> Array:
    """Objects of any kind as an array (k,)."""
    out = np.empty(len(values), object)
    out[:] = values
    return out


class ParameterError(ValueError):
    """A parameter is missing, unknown, of the wrong kind or out of range."""


def unit(symbol: str, **options: Any) -> Any:
    """Dataclass field that carries its unit, e.g. `mass: float = unit("kg")`.

    `default=` gives the default value; every other option is stored as metadata.
    """
    default = options.pop("default", dataclasses.MISSING)
    return dataclasses.field(default=default, metadata={"unit": symbol, **options})


def units(cls: type) -> dict[str, str]:
    """Unit of each field of a parameter set that has one."""
    return {f.name: f.metadata["unit"] for f in dataclasses.fields(cls) if "unit" in f.metadata}


def finite(value: object, shape: tuple[int, ...], name: str) -> Array:
    """Return a value as a float64 array of exactly the given shape, all its numbers finite."""
    try:
        raw = np.asarray(value)
    except ValueError:  # ragged
        raw = np.empty(0, object)
    if raw.dtype.kind not in "fiu":  # text, truth values and None are no numbers
        raise ParameterError(f"{name} must be numbers of shape {shape}, got {value!r}")
    array = np.array(raw, dtype=np.float64)
    if array.shape != shape:
        raise ParameterError(
            f"{name} must have shape {shape}, got shape {array.shape}: {value!r}"
        )
    if not np.isfinite(array).all():
        raise ParameterError(f"{name} must be finite, got {array.tolist()}")
    return array


def integer(value: Any, name: str, least: int = 0, most: int = 2**63 - 1) -> int:
    """Return a number, NumPy's too, as an int; refuse what is not one from least to most."""
    good = isinstance(value, numbers.Integral) and not isinstance(value, bool)
    if not good or not least <= value <= most:
        expected = f">= {least}" if most == 2**63 - 1 else f"from {least} to {most}"
        raise ParameterError(f"{name} must be a whole number {expected}, got {value!r:.80}")
    return int(value)


def freeze_arrays(params: object) -> None:
    """Store lists and arrays in the fields of a frozen dataclass as nested tuples.

    Those have a hash and cannot be changed afterwards; call it first in `__post_init__`.
    """
    for field in dataclasses.fields(params):  # type: ignore[arg-type]
        value = getattr(params, field.name)
        frozen = nested_tuples(value)
        if frozen is not value:
            object.__setattr__(params, field.name, frozen)


def nested_tuples(value: Any) -> Any:
    """Lists and arrays within a value as tuples; the value itself where there are none."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if type(value) not in (list, tuple):
        return value
    out = tuple(map(nested_tuples, value))
    same = type(value) is tuple and all(a is b for a, b in zip(out, value, strict=True))
    return value if same else out


def require_positive(params: object, *names: str, zero: bool = False) -> None:
    """Check that each named field is a finite number > 0; with `zero` it may be 0."""
    for name in names:
        value = getattr(params, name)
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        good = number and math.isfinite(value)
        if not good or value < 0 or (value == 0 and not zero):
            symbol = units(type(params)).get(name, "")
            raise ParameterError(
                f"{type(params).__name__}.{name} must be {'>=' if zero else '>'} 0"
                f"{symbol and ' '}{symbol}, got {value!r}"
            )


def require_types(params: object, *names: str) -> None:
    """Check that each named field is an instance, or a tuple of some, of its annotation."""
    kind: Any = type(params)
    hints = _hints(kind)
    for name in names:
        value, hint = getattr(params, name), hints[name]
        several = typing.get_origin(hint) is tuple  # tuple[Kind, ...]
        kinds = typing.get_args(hint) or (hint,)
        kinds = tuple(k for k in kinds if k is not Ellipsis)
        items = value if several and isinstance(value, tuple) else (value,)
        if several > isinstance(value, tuple) or not all(isinstance(v, kinds) for v in items):
            expected = " or ".join("None" if k is type(None) else k.__name__ for k in kinds)
            raise ParameterError(
                f"{type(params).__name__}.{name} must be {'a tuple of ' * several}{expected},"
                f" got {value!r}"
            )


@functools.cache
def _hints(cls: Any) -> dict[str, Any]:
    return typing.get_type_hints(cls)


def require_least(params: object, least: float, *names: str) -> None:
    """Check that each named field is a number of at least so much."""
    for name in names:
        value = getattr(params, name)
        if not value >= least:
            raise ParameterError(
                f"{type(params).__name__}.{name} must be >= {least}, got {value!r}"
            )


def require_choice(params: object, name: str, choices: tuple[str, ...]) -> None:
    """Check that the named field is one of the choices."""
    require_one_of(f"{type(params).__name__}.{name}", getattr(params, name), choices)


def require_one_of(name: str, value: object, choices: Collection[str]) -> None:
    """Raise ParameterError where a value is none of the choices; it lists them."""
    if value not in choices:
        raise ParameterError(
            f"{name} must be one of {', '.join(choices)}, got {value!r:.80}"
            f"{did_you_mean(value, choices)}"
        )


def symmetric(value: object, name: str, size: int = 6) -> Array:
    """Return a value as a symmetric positive semidefinite matrix (size, size).

    Symmetry is tested to 1e-9 of the largest entry (rounding of a printed or inverted matrix);
    an eigenvalue may be negative by 1e-12 of the largest.
    """
    matrix = finite(value, (size, size), name)
    largest = max(float(np.abs(matrix).max()), np.finfo(float).tiny)
    gap = np.abs(matrix - matrix.T)
    if gap.max() > 1e-9 * largest:
        i, j = (int(k) for k in np.unravel_index(int(gap.argmax()), gap.shape))
        raise ParameterError(
            f"{name} must be symmetric, got [{i + 1},{j + 1}] = {matrix[i, j]:.6g}"
            f" and [{j + 1},{i + 1}] = {matrix[j, i]:.6g}"
        )
    lowest = float(np.linalg.eigvalsh(matrix)[0])
    if lowest < -1e-12 * largest:
        raise ParameterError(
            f"{name} must be positive semidefinite, got an eigenvalue {lowest:.6g}"
        )
    return (matrix + matrix.T) / 2


# ------------------------------------------------------------------ plain data and back


def to_plain(value: Any, compared: bool = False) -> Any:
    """Parameter set -> dicts, lists, strings and numbers (what TOML and JSON hold).

    `compared`: only fields in which two that are equal must agree.
    """
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        plain = {}
        if "kind" in type(value).__dict__:
            plain["kind"] = type(value).__dict__["kind"]
        for field in dataclasses.fields(value):
            item = getattr(value, field.name)
            if item is None or (compared and not field.compare):
                continue
            # 12, 12.0 and NumPy's 12 are one value, and so are 0.0 and -0.0: one text, one hash
            real = "unit" in field.metadata
            plain[field.name] = (
                (np.asarray(item, float) + 0.0).tolist() if real else to_plain(item, compared)
            )
        return plain
    if isinstance(value, (tuple, list)):
        return [to_plain(item, compared) for item in value]
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    return value


def from_plain(cls: Any, plain: Any, where: str = "") -> Any:
    """Rebuild a parameter set of type `cls` from plain data, as `to_plain` gives them.

    A field annotated with a union of parameter sets is resolved by the entry `kind`; `where` is
    the path of the entry, for the message.
    """
    where = where or getattr(cls, "__name__", "value")
    origin = typing.get_origin(cls)
    if origin in (typing.Union, types.UnionType):
        return _from_union(typing.get_args(cls), plain, where)
    registry = getattr(cls, "REGISTRY", None)  # an open family, told apart by the entry `kind`
    if registry is not None and cls not in registry.values():
        kind = plain.get("kind") if isinstance(plain, Mapping) else None
        if not isinstance(kind, str) or kind not in registry:
            names = sorted(registry)
            raise ParameterError(
                f"{where}.kind must be one of {', '.join(names)}, got {kind!r}"
                f"{did_you_mean(kind, names)}"
            )
        return from_plain(registry[kind], plain, where)
    if isinstance(cls, type) and dataclasses.is_dataclass(cls):
        return _from_mapping(cls, plain, where)
    if origin is tuple:
        if not isinstance(plain, (list, tuple)):
            raise ParameterError(f"{where} must be a list, got {plain!r}")
        inner = typing.get_args(cls)
        if len(inner) == 2 and inner[1] is Ellipsis:
            inner = (inner[0],) * len(plain)
        if len(inner) != len(plain):
            raise ParameterError(f"{where} must have {len(inner)} entries, got {len(plain)}")
        return tuple(
            from_plain(k, item, f"{where}[{i}]")
            for i, (k, item) in enumerate(zip(inner, plain, strict=True))
        )
    if origin is dict:
        if not isinstance(plain, Mapping):
            raise ParameterError(f"{where} must be a table, got {plain!r}")
        inner = typing.get_args(cls)[1]
        return {k: from_plain(inner, item, f"{where}.{k}") for k, item in plain.items()}
    if cls is float and isinstance(plain, (int, float)) and not isinstance(plain, bool):
        try:
            return float(plain)
        except OverflowError:
            raise ParameterError(
                f"{where} must be float, got an integer beyond its range"
            ) from None
    if cls is Any or (isinstance(plain, cls) and isinstance(plain, bool) == (cls is bool)):
        return plain
    raise ParameterError(f"{where} must be {cls.__name__}, got {plain!r}")


def _from_union(options: tuple[Any, ...], plain: Any, where: str) -> Any:
    if plain is None and type(None) in options:
        return None
    options = tuple(k for k in options if k is not type(None))
    if len(options) == 1:
        return from_plain(options[0], plain, where)
    kinds = {k.kind: k for k in options}
    kind = plain.get("kind") if isinstance(plain, Mapping) else None
    if not isinstance(kind, str) or kind not in kinds:
        raise ParameterError(
            f"{where}.kind must be one of {', '.join(kinds)}, got {kind!r}"
            f"{did_you_mean(kind, kinds)}"
        )
    return from_plain(kinds[kind], plain, where)


def _from_mapping(cls: type[T], plain: Any, where: str) -> T:
    if not isinstance(plain, Mapping):
        raise ParameterError(
            f"{where} must be a table of {cls.__name__} entries, got {plain!r}"
        )
    fields = {f.name: f for f in dataclasses.fields(cls) if f.init}  # type: ignore[arg-type]
    entries = dict(plain)
    kind = cls.__dict__.get("kind")
    if kind is not None and "kind" not in fields and entries.pop("kind", kind) != kind:
        raise ParameterError(f"{where}.kind must be {kind}, got {plain['kind']!r}")
    unknown = [key for key in entries if key not in fields]
    if unknown:
        raise ParameterError(
            f"{where}: unknown key {unknown[0]!r}; known: {', '.join(fields)}"
            f"{did_you_mean(unknown[0], fields)}"
        )
    taken: Any = cls
    hints = _hints(taken)
    values = {key: from_plain(hints[key], v, f"{where}.{key}") for key, v in entries.items()}
    missing = [
        name
        for name, f in fields.items()
        if name not in values
        and f.default is dataclasses.MISSING
        and f.default_factory is dataclasses.MISSING
    ]
    if missing:
        raise ParameterError(f"{where}: missing key {missing[0]!r}")
    return cls(**values)


# --------------------------------------------------------------------------- files


def canonical_json(value: Any) -> str:
    """One text per value: sorted keys, shortest exact floats, no NaN."""
    return json.dumps(to_plain(value), sort_keys=True, separators=(",", ":"), allow_nan=False)


def content_hash(value: Any) -> str:
    """SHA-256 of the canonical JSON, 64 hexadecimal digits."""
    plain = canonical_json(to_plain(value, compared=True))
    return hashlib.sha256(plain.encode()).hexdigest()


def read_table(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read a TOML or JSON file (by suffix) into plain data."""
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ParameterError(f"{path}: cannot be read: {why_unread(path, error)}") from None
    if path.suffix not in (".toml", ".json"):
        raise ParameterError(f"{path}: expected a .toml or .json file, got {path.suffix!r}")
    try:
        if path.suffix == ".toml":
            table = tomllib.loads(text)
        else:
            table = json.loads(text, object_pairs_hook=_once)
    except (ValueError, RecursionError) as error:
        raise ParameterError(f"{path}: not valid {path.suffix[1:].upper()}: {error}") from None
    if not isinstance(table, dict):
        raise ParameterError(f"{path}: expected a table at the top, got {type(table).__name__}")
    return table


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """A JSON object; a key given twice is an error, as it is in TOML."""
    table: dict[str, Any] = {}
    for key, value in pairs:
        if key in table:
            raise ValueError(f"key {key!r} is given more than once")
        table[key] = value
    return table


def write_table(path: str | os.PathLike[str], value: Any) -> None:
    """Write a parameter set or plain data as .toml or .json, atomically."""
    path = Path(path)
    plain = to_plain(value)
    if path.suffix == ".toml":
        write_text(path, toml(plain))
    elif path.suffix == ".json":
        write_text(path, json.dumps(plain, indent=1, allow_nan=False) + "\n")
    else:
        raise ParameterError(f"{path}: expected a .toml or .json name, got {path.suffix!r}")


_ROW = re.compile(r"\[\n\s+([^\[\]{}\"\n]+,(?:\n\s+[^\[\]{}\"\n]+,)*)\n\s*\]")


def toml(plain: Mapping[str, Any]) -> str:
    """Return plain data as the text of a TOML file."""
    import tomli_w

    return _ROW.sub(_on_a_line, tomli_w.dumps(plain))


def _on_a_line(row: re.Match[str]) -> str:
    """Numbers of an innermost list on one line, so that a person can read a matrix."""
    return f"[{' '.join(row[1].split()).rstrip(',')}]"


def write_result(path: str | os.PathLike[str], plain: Mapping[str, Any]) -> None:
    """Write plain data with an entry `schema`, all numbers finite, as .json, atomically."""
    if Path(path).suffix != ".json":
        raise ParameterError(f"{path}: expected a .json name, got {Path(path).suffix!r}")
    write_text(path, json.dumps(plain, indent=1, allow_nan=False) + "\n")


def read_result(path: str | os.PathLike[str], schema: str) -> dict[str, Any]:
    """Read what `write_result` wrote; it must have this schema."""
    plain = read_table(path)
    if plain.get("schema") != schema:
        raise ParameterError(f"{path}: schema must be {schema!r}, got {plain.get('schema')!r}")
    return plain


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write a file in UTF-8, as `write_bytes`; its folder must exist."""
    write_bytes(path, text.encode("utf-8"))


def write_bytes(path: str | os.PathLike[str], data: bytes, *, private: bool = False) -> None:
    """Write a file completely or not at all: temporary name, fsync, rename.

    Its folder is made if it is not there. `private`: nobody else may read or write it. An
    OSError names the file, and what was there stays.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            if not private:  # as it is made
                os.chmod(temporary, 0o666 & ~_umask())
            os.replace(temporary, path)
        except BaseException:
            os.unlink(temporary)
            raise
    except OSError as error:  # under the name that the caller knows
        raise OSError(error.errno, error.strerror, str(path)) from None


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
