"""Blocks of pages that scripts write: from `<!-- NAME -->` to `<!-- end -->`."""

from __future__ import annotations

import re

BLOCK = re.compile(r"^<!-- ([^\n]+) -->\n(.*?)^<!-- end -->$", re.MULTILINE | re.DOTALL)


def filled(text: str, blocks: dict[str, str]) -> str:
    """Return a page with new text in its blocks.

    Args:
        text: of the page.
        blocks: name -> what stands between the marks; others stay.

    Raises:
        ValueError: the page has no block of a name.
    """
    found = {name for name, _ in BLOCK.findall(text)}
    if missing := blocks.keys() - found:
        raise ValueError(f"no block {', '.join(sorted(missing))} among {sorted(found)}")

    def block(match: re.Match[str]) -> str:
        mine = match[1] in blocks
        return f"<!-- {match[1]} -->\n{blocks[match[1]]}\n<!-- end -->" if mine else match[0]

    return BLOCK.sub(block, text)
