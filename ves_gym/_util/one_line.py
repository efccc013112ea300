"""Text of elsewhere for a terminal: names from files can hold what moves a cursor."""

from __future__ import annotations

LONGEST = 2000  # characters


def on_one_line(text: str) -> str:
    r"""Return a text without line ends, at most 2000 characters of it, all of them printable.

    Spaces in a row become one. What cannot be seen, or changes the direction of what follows,
    is written as Python writes it: '\x1b', '\u202e'.
    """
    words = " ".join(text.split())
    if len(words) > LONGEST:
        words = f"{words[:LONGEST]} ... ({len(words)} characters)"
    return "".join(k if k.isprintable() else ascii(k)[1:-1] for k in words)
