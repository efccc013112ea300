"""Names of entries and authors: one spelling each, and none that looks like another's.

Two names look alike if they have the same skeleton, by the method of Unicode Technical
Standard 39: decomposed, letters replaced by the Latin ones they are drawn like, upper and lower
case alike. The letters listed are those of Cyrillic, Greek and Armenian that are drawn like
Latin ones in common fonts (confusables.txt of that standard), and those that Latin ones
and digits themselves are mistaken for.
"""

from __future__ import annotations

import unicodedata
from collections.abc import Iterable

from ves_gym._util.params import ParameterError

_DRAWN_LIKE = str.maketrans(
    {
        **dict(zip("асԁеһіјӏорԛѕԝхугһкмтвнзьѵ", "acdehijlopqswxyrhkmtbh3bv", strict=True)),
        **dict(zip("αβγεηικνορτυχωϲϳ", "abyenikvoptuxwcj", strict=True)),
        **dict(zip("աօսհոցզյ", "wouhngqj", strict=True)),
        **dict(zip("ıɩɡɑʏʋ", "iigayv", strict=True)),
        **dict(zip("1|!0", "lllo", strict=True)),
        "–": "-",
        "—": "-",
        "‐": "-",
        "‑": "-",
        "−": "-",
        "_": "-",
        "’": "'",
        "‘": "'",
    }
)


def require_name(value: str, where: str) -> str:
    """Return a name that has one spelling only.

    Raises:
        ParameterError: it is not in Unicode's form NFC, or has spaces at its ends or in a row.
    """
    if unicodedata.normalize("NFC", value) != value:
        raise ParameterError(f"{where} must be in Unicode's form NFC, got {value!a}")
    if value != " ".join(value.split(" ")).strip() or "  " in value:
        raise ParameterError(f"{where} must have single spaces between words, got {value!a}")
    if value and unicodedata.combining(value[0]):
        raise ParameterError(f"{where} must begin with a letter or sign, got {value!a}")
    return value


def skeleton(name: str) -> str:
    """Return what names that look alike have in common."""
    drawn = unicodedata.normalize("NFKD", name).casefold()
    drawn = "".join(k for k in drawn if not unicodedata.combining(k)).translate(_DRAWN_LIKE)
    return drawn.replace("i", "l").replace("rn", "m").replace("vv", "w").replace(" ", "")


def require_unlike(name: str, others: Iterable[str], what: str) -> None:
    """Raise a ParameterError where a name is not one of others but looks like one.

    Args:
        name: a new one.
        others: those there are.
        what: it is a name of, for the message.
    """
    known = set(others)
    if name in known or not name:
        return
    drawn = skeleton(name)
    for other in sorted(known):
        if other and skeleton(other) == drawn:
            raise ParameterError(
                f"{what} {name!a} looks like {other!a}, which is on the board: take another"
                " name, or that one to the letter"
            )
