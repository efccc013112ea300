"""Rows of an entry as columns: how the board's files hold them, at a third of the length.

A column is a list with a value per row, or a single value that all rows have. What a row
lacks is null.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ves_gym._util.params import ParameterError

_MOST = 200_000  # rows
_KEYS = {"count", "columns"}

Plain = dict[str, Any]


def to_columns(rows: Sequence[Mapping[str, Any]]) -> Plain:
    """Rows as plain data: their count, and columns by name."""
    names = sorted({name for row in rows for name in row})
    return {
        "count": len(rows),
        "columns": {name: _short([row.get(name) for row in rows]) for name in names},
    }


def from_columns(plain: Any) -> list[Plain]:
    """The rows again.

    Raises:
        ParameterError: it is no such table.
    """
    if not isinstance(plain, Mapping) or plain.keys() != _KEYS:
        raise ParameterError("entry.rows must be a table of count and columns")
    count, columns = plain["count"], plain["columns"]
    if type(count) is not int or not 0 <= count <= _MOST or not isinstance(columns, Mapping):
        raise ParameterError(f"entry.rows must have 0 to {_MOST} rows in columns")
    full = {}
    for name, values in columns.items():
        if isinstance(values, list) and len(values) != count:
            raise ParameterError(
                f"entry.rows: column {name!r:.80} has {len(values)} values for {count} rows"
            )
        full[name] = values if isinstance(values, list) else [values] * count
    return [{name: values[k] for name, values in full.items()} for k in range(count)]


def _short(values: list[Any]) -> Any:
    """The value that all have, or all values; a list is never taken for one value."""
    alike = not isinstance(values[0], (list, tuple)) and len(set(map(repr, values))) == 1
    return values[0] if alike else values
