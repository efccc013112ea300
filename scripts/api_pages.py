"""Write one page of the documentation site per public name, from the code.

`scripts/site.py` calls it before Sphinx runs: what is public and what has a page are the same
list. The pages hold directives only; their text comes from the docstrings.
"""

from __future__ import annotations

import importlib
import inspect
from pathlib import Path
from typing import Any

import ves_gym as vg
from scripts.api import GROUPS, ROOMS

HEAD = """# {title}

```{{toctree}}
:maxdepth: 1

{names}
```
"""


def sections() -> dict[str, list[str]]:
    """Return titles and the dotted names below each, every public name once."""
    out = {
        title: [f"ves_gym.{name}" for name in names.split()] for title, names in GROUPS.items()
    }
    for room in (*ROOMS, "effects"):
        names = importlib.import_module(f"ves_gym.{room}").__all__
        out[f"ves_gym.{room}"] = [f"ves_gym.{room}.{name}" for name in names]
    return out


def value_of(name: str) -> Any:
    """Import the object of a dotted name."""
    package, _, last = name.rpartition(".")
    return getattr(importlib.import_module(package), last)


def directive(name: str) -> str:
    """Return the directive that documents a name, in reStructuredText."""
    value = value_of(name)
    if inspect.ismodule(value):
        members = bool(getattr(value, "__all__", ()))
        return f".. automodule:: {value.__name__}\n" + ("" if members else "   :members:\n")
    if inspect.isclass(value):
        return f".. autoclass:: {name}\n   :members:\n"
    if inspect.isroutine(value):
        return f".. autofunction:: {name}\n"
    return f".. autodata:: {name}\n   :no-value:\n"


def slug(title: str) -> str:
    """Return the file name of a section, without its ending: none is that of a name."""
    if title.startswith("ves_gym."):
        return title.replace("ves_gym.", "room-", 1)
    return "names-" + title.lower().replace(" ", "-")


def pages() -> dict[str, str]:
    """Return file names and texts: `index.md`, a page per section, a page per name."""
    out: dict[str, str] = {}
    first: dict[int, str] = {}  # object -> the page that documents it
    for title, names in sections().items():
        out[f"{slug(title)}.md"] = HEAD.format(title=title, names="\n".join(names))
        for name in names:
            home = first.setdefault(id(value_of(name)), name)
            text = f"```{{eval-rst}}\n{directive(name)}```"
            if name in sections():
                text += f"\n\n[Its names]({slug(name)}.md)"
            if home != name:
                text = f"The same as [{home}]({home}.md)."
            out[f"{name}.md"] = f"# {name}\n\n{text}\n"
    return {
        "index.md": HEAD.format(title="Reference", names="\n".join(map(slug, sections()))),
        **out,
    }


def write(folder: Path) -> int:
    """Write the pages into a folder, remove those of names that are gone; return how many."""
    folder.mkdir(parents=True, exist_ok=True)
    texts = pages()
    for path in folder.glob("*.md"):
        if path.name not in texts:
            path.unlink()
    for name, text in texts.items():
        (folder / name).write_text(text, "utf-8")
    return len(texts)


def public_names() -> set[str]:
    """Return the dotted names of all that is public."""
    rooms = {room: importlib.import_module(f"ves_gym.{room}") for room in (*ROOMS, "effects")}
    return {f"ves_gym.{name}" for name in vg.__all__} | {
        f"ves_gym.{room}.{name}" for room, module in rooms.items() for name in module.__all__
    }
