"""Build the documentation site: `make site`, or `python scripts/site.py [FOLDER]`.

Sphinx reads the pages of `docs/` where they lie, with `docs/site/conf.py`. Warnings are errors,
nothing is fetched, and afterwards every address within the pages is followed: exit status 1
where one leads nowhere.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import time
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from scripts import api_pages, notebook_pages  # noqa: E402 - run as a file, the root is not on the path

START = """<!doctype html><html lang="en"><meta charset="utf-8"><title>ves_gym</title>
<meta http-equiv="refresh" content="0; url=site/index.html">
<a href="site/index.html">ves_gym</a>
"""
CAPTION = 'class="caption" role="heading"'


class Addresses(HTMLParser):
    """Anchors and addresses of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.anchors: set[str] = set()
        self.addresses: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        for name, value in attributes:
            if value and name == "id":
                self.anchors.add(value)
            elif value and name in ("href", "src"):
                self.addresses.append(value)


def dead_links(folder: Path) -> list[str]:
    """Return `page: address` of every address inside a folder that leads nowhere."""
    pages = {path: Addresses(path.read_text("utf-8")) for path in folder.rglob("*.html")}
    dead = []
    for page, found in pages.items():
        for address in found.addresses:
            parts = urlsplit(address)
            if parts.scheme or parts.netloc:
                continue
            target = (page.parent / unquote(parts.path)).resolve() if parts.path else page
            missing = not target.is_file()
            anchor = unquote(parts.fragment)
            if not missing and anchor and target in pages:
                missing = anchor not in pages[target].anchors
            if missing:
                dead.append(f"{page.relative_to(folder)}: {address}")
    return dead


def build(folder: Path) -> int:
    """Build the site in a folder; return the exit status."""
    start = time.perf_counter()
    folder = folder.resolve()
    if folder.exists():  # pages of an earlier build would hide links that lead nowhere now
        if any(folder.iterdir()) and not (folder / ".buildinfo").is_file():
            print(f"{folder} holds something else than a site: name another", file=sys.stderr)
            return 2
        shutil.rmtree(folder)
    api_pages.write(ROOT / "docs" / "site" / "api")
    notebook_pages.write(ROOT / "docs" / "site" / "notebooks")
    # all pages every time (-E -a): one that is not read again does not warn again
    options = ["-b", "html", "-E", "-a", "-q", "-W", "--keep-going"]
    places = ["-c", str(ROOT / "docs" / "site"), "-d", f"{folder}-cache"]
    done = subprocess.run(
        [sys.executable, "-m", "sphinx", *options, *places, str(ROOT / "docs"), str(folder)],
        cwd=ROOT,
    )
    if done.returncode:
        return 1
    for page in folder.rglob("*.html"):  # Sphinx's captions are headings without a level
        text = page.read_text("utf-8")
        page.write_text(text.replace(CAPTION, f'{CAPTION} aria-level="2"'), "utf-8")
    (folder / "index.html").write_text(START, "utf-8")
    dead = dead_links(folder)
    for each in dead:
        print(f"dead link: {each}", file=sys.stderr)
    count = sum(1 for _ in folder.rglob("*.html"))
    print(f"{count} pages in {time.perf_counter() - start:.0f} s: {folder / 'index.html'}")
    return 1 if dead else 0


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Build the documentation site.")
    parser.add_argument("folder", type=Path, nargs="?", default=ROOT / "out" / "site")
    sys.exit(build(parser.parse_args().folder))
