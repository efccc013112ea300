"""Write one page of the documentation site per notebook, with what it shows.

`scripts/site.py` calls it before Sphinx runs: code, text, pictures and tables as stored.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

NOTEBOOKS = Path(__file__).parents[1] / "notebooks"
SEEN = "what the cell above shows"
HEAD = "*The notebook `notebooks/{name}.ipynb`, as it was run last.*"


def page(path: Path) -> str:
    """Return a notebook as Markdown of the site."""
    parts: list[str] = []
    for cell in json.loads(path.read_text("utf-8"))["cells"]:
        source = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            parts.append(source)
            continue
        parts.append(f"```{{code-block}} python\n{source}\n```")
        parts += [_shown(output) for output in cell["outputs"]]
    title, _, rest = parts[0].partition("\n")
    return "\n\n".join([title, HEAD.format(name=path.stem), rest, *parts[1:], ""])


def _shown(output: dict[str, Any]) -> str:
    """An output: what is printed, a table, or a picture within the page."""
    if output["output_type"] == "stream":
        return "```{code-block} text\n" + "".join(output["text"]) + "```"
    data = {kind: "".join(value) for kind, value in output["data"].items()}
    for kind in ("image/png", "image/gif"):
        if kind in data:
            inline = "".join(data[kind].split())
            return f'```{{raw}} html\n<img alt="{SEEN}" src="data:{kind};base64,{inline}">\n```'
    if "text/html" in data:
        return f"```{{raw}} html\n{data['text/html']}\n```"
    return f"```{{code-block}} text\n{data['text/plain']}\n```"


def write(folder: Path) -> int:
    """Write the pages into a folder, remove those that are gone; return how many."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = {path.stem: path for path in sorted(NOTEBOOKS.glob("*.ipynb"))}
    for old in folder.glob("*.md"):
        if old.stem not in paths:
            old.unlink()
    for name, path in paths.items():
        (folder / f"{name}.md").write_text(page(path), "utf-8")
    return len(paths)
