"""Parts common to the HTML pages: one file each, with nothing to load beside it."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from importlib.resources import files
from typing import Any

from ves_gym._util.params import ParameterError, to_plain


def part(name: str, package: str = "ves_gym.report") -> str:
    """Read a template, style sheet or script; `page.css` and `dom.js` are for all.

    Args:
        name: of the file.
        package: that it lies in.

    Returns:
        Its text.
    """
    return files(package).joinpath(name).read_text(encoding="utf-8")


def assemble(template: str, parts: Mapping[str, str]) -> str:
    """Put parts in the places of a template that say {{name}}.

    In one pass: what looks like a place inside a part stays as it is.

    Args:
        template: text with places.
        parts: text by name.

    Returns:
        The complete text.

    Raises:
        KeyError: a place without a part.
    """
    return re.sub(r"\{\{(\w+)\}\}", lambda match: parts[match[1]], template)


def embedded(data: Any) -> str:
    """JSON that cannot end or disturb the script element it stands in.

    Raises:
        ParameterError: the data holds a number that JSON has not.
    """
    try:
        text = json.dumps(to_plain(data), separators=(",", ":"), allow_nan=False)
    except ValueError as error:
        raise ParameterError(f"the result must be finite to become a page: {error}") from None
    return text.replace("<", "\\u003c")  # thereby no `</` and no `<!--`
