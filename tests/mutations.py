"""Are the tests worth their time? Sixty seeded faults of one line each, and who notices.

    python -m tests.mutations [--seed 0] [--count 60] [--out out/mutations.json]

Each fault is put into a copy of the working tree: a sign, a constant, an index, an order of
arguments or operands, or a guard at the door that is gone. The tests of the module's own room
run against it, those of a like name first, then golden numbers and claims; the first that
fails has caught it. Rooms have a share of the faults by their lines.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from queue import SimpleQueue

ROOT = Path(__file__).parents[1]
LIMIT = 900  # s for the tests of one fault
WORKERS = 2  # faults that are judged side by side, each in a tree of its own
Edit = tuple[str, int, int, int, int, str]  # kind, first line, column, last line, column, text


def _numbers(node: ast.AST) -> Iterator[Edit]:
    value = node.value if isinstance(node, ast.Constant) else None
    if isinstance(value, float) and value not in (0.0, 1.0):
        yield _edit("constant", node, repr(value * 1.25))
    elif isinstance(value, int) and not isinstance(value, bool) and value > 1:
        yield _edit("constant", node, repr(value + 1))


def _operators(node: ast.AST) -> Iterator[Edit]:
    if not isinstance(node, ast.BinOp):
        return
    left, right = ast.unparse(node.left), ast.unparse(node.right)
    if isinstance(node.op, ast.Add):
        yield _edit("sign", node, f"(({left}) - ({right}))")
    elif isinstance(node.op, ast.Sub):
        yield _edit("sign", node, f"(({left}) + ({right}))")
    elif isinstance(node.op, (ast.Div, ast.MatMult)):
        mark = "/" if isinstance(node.op, ast.Div) else "@"
        yield _edit("order", node, f"(({right}) {mark} ({left}))")


def _indices(node: ast.AST) -> Iterator[Edit]:
    if not (isinstance(node, ast.Subscript) and isinstance(node.slice, ast.Constant)):
        return
    if isinstance(node.slice.value, int) and isinstance(node.ctx, ast.Load):
        yield _edit("index", node, f"{ast.unparse(node.value)}[{1 - node.slice.value}]")


def _guards(node: ast.AST) -> Iterator[Edit]:
    if isinstance(node, ast.If) and not node.orelse:
        if len(node.body) == 1 and isinstance(node.body[0], ast.Raise):
            yield _edit("guard", node.test, "False")
    elif isinstance(node, ast.Compare) and len(node.ops) == 1:
        flip = {ast.Lt: "<=", ast.LtE: "<", ast.Gt: ">=", ast.GtE: ">"}.get(type(node.ops[0]))
        if flip:
            left, right = ast.unparse(node.left), ast.unparse(node.comparators[0])
            yield _edit("order", node, f"({right} {flip} {left})")


KINDS: tuple[Callable[[ast.AST], Iterator[Edit]], ...] = (
    _numbers,
    _operators,
    _indices,
    _guards,
)


def _edit(kind: str, node: ast.AST, text: str) -> Edit:
    span: tuple[int, int, int, int] = (
        node.lineno, node.col_offset, node.end_lineno, node.end_col_offset,
    )  # type: ignore[attr-defined]  # fmt: skip
    return (kind, *span, text)


def edits(source: str) -> list[Edit]:
    """All faults of one line that a source offers, annotations and defaults of types aside."""
    tree = ast.parse(source)
    typed = {
        id(part)
        for node in ast.walk(tree)
        for name in ("annotation", "returns")
        if (top := getattr(node, name, None)) is not None
        for part in ast.walk(top)
    }
    nodes = [node for node in ast.walk(tree) if id(node) not in typed]
    found = [edit for node in nodes for kind in KINDS for edit in kind(node)]
    return [edit for edit in found if edit[1] == edit[3]]


def apply(source: str, edit: Edit) -> str:
    """The source with one fault."""
    _, line, first, _, last, text = edit
    lines = source.split("\n")
    raw = lines[line - 1].encode()
    lines[line - 1] = (raw[:first] + text.encode() + raw[last:]).decode()
    return "\n".join(lines)


def draw(seed: int, count: int) -> list[tuple[str, Edit]]:
    """Faults by file: rooms in turn by their lines, kinds alike."""
    rng = random.Random(seed)
    files = sorted((ROOT / "ves_gym").rglob("*.py"))
    sources = {path: path.read_text("utf-8") for path in files}
    weights = [sources[path].count("\n") for path in files]
    out: list[tuple[str, Edit]] = []
    while len(out) < count:
        path = rng.choices(files, weights)[0]
        kind = ("sign", "constant", "index", "order", "guard")[len(out) % 5]
        offered = [edit for edit in edits(sources[path]) if edit[0] == kind]
        if offered:
            out.append((path.relative_to(ROOT).as_posix(), rng.choice(offered)))
    return out


_IN_EPISODES = {
    "_util", "baselines", "effects", "engine", "envs", "hardware", "mechanics", "simulation",
    "system",
}  # fmt: skip


def targets(file: str) -> list[list[str]]:
    """Tests that may see a fault in a file, the nearest first."""
    room, stem = Path(file).parts[1], Path(file).stem
    near = list((ROOT / "tests").rglob(f"test_{stem}*.py"))
    own = [p for p in (ROOT / "tests" / room, ROOT / "tests" / f"test_{room}") if p.is_dir()]
    rest = [ROOT / "tests" / name for name in ("golden", "claims")]
    last = [ROOT / "tests" / "envs"] if room in _IN_EPISODES and room != "envs" else []
    steps = [near, own, rest, last]
    return [[str(p.relative_to(ROOT)) for p in step if p.exists()] for step in steps if step]


def caught(tree: Path, file: str, edit: Edit) -> str:
    """The step of `targets` whose tests notice a fault; "" if none does."""
    path = tree / file
    source = path.read_text("utf-8")
    path.write_text(apply(source, edit), "utf-8")
    environment = {**os.environ, "PYTHONPATH": str(tree), "OMP_NUM_THREADS": "1"}
    try:
        for step in targets(file):
            command = [sys.executable, "-m", "pytest", "-x", "-q", *step]
            try:
                code = subprocess.run(
                    command, cwd=tree, env=environment, capture_output=True, timeout=LIMIT
                ).returncode
            except subprocess.TimeoutExpired:
                return f"{step[0]} (hangs)"
            if code not in (0, 5):
                return step[0]
        return ""
    finally:
        path.write_text(source, "utf-8")


def main() -> None:
    """Draw, put in, run, and write who noticed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--count", type=int, default=60)
    parser.add_argument("--out", type=Path, default=Path("out/mutations.json"))
    args = parser.parse_args()
    args.out.parent.mkdir(parents=True, exist_ok=True)
    rows = json.loads(args.out.read_text("utf-8")) if args.out.exists() else []
    done = {(row["file"], *row["edit"]) for row in rows}
    faults = [k for k in draw(args.seed, args.count) if (k[0], *k[1]) not in done]
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(WORKERS) as pool:
        trees: SimpleQueue[Path] = SimpleQueue()
        ignored = shutil.ignore_patterns(".git", ".venv", "out", "__pycache__")
        for k in range(WORKERS):
            tree = Path(folder) / str(k)
            shutil.copytree(ROOT, tree, symlinks=True, ignore=ignored)
            trees.put(tree)

        def judged(fault: tuple[str, Edit]) -> tuple[str, Edit, str]:
            tree = trees.get()
            try:
                return *fault, caught(tree, *fault)
            finally:
                trees.put(tree)

        for file, edit, by in pool.map(judged, faults):
            rows.append({"file": file, "edit": edit, "caught by": by})
            args.out.write_text(json.dumps(rows, indent=1), "utf-8")
            print(f"{len(rows):3d} {file}:{edit[1]} {edit[0]}: {by or 'NOBODY'}", flush=True)
    print(f"{sum(bool(row['caught by']) for row in rows)} of {len(rows)} caught")


if __name__ == "__main__":
    main()
