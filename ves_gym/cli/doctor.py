"""`ves-gym doctor`: what is broken on this machine.

Whatever may crash or hang (native libraries, OpenGL) is tried in a child process.
"""

from __future__ import annotations

import argparse
import importlib.metadata
import operator
import os
import platform
import re
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from ves_gym._util.optional import installed
from ves_gym.cli.common import progress, write_json

SCHEMA = "ves-doctor/1"
OK, FAIL, NOTE = "ok", "fail", "note"
_PATIENCE = 90.0  # s for a child process
_ROOT = Path(__file__).parents[2]


class Check(NamedTuple):
    """One finding. `fail` means the core does not work; `note` only limits it."""

    name: str
    status: str
    detail: str


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command: none of its own."""


def run(args: argparse.Namespace) -> int:
    """Print every finding; exit 1 if a core check fails."""
    checks: list[Check] = []
    with progress() as on_progress:
        for done, check in _checks(Path(args.out or "out")):
            checks.append(check)
            on_progress(f"after {check.name}", done)
    ok = all(check.status != FAIL for check in checks)
    write_json(
        args.json, {"schema": SCHEMA, "ok": ok, "checks": [check._asdict() for check in checks]}
    )
    _print_table(checks)
    bad = [check.name for check in checks if check.status == FAIL]
    print("the core works" if ok else f"the core does NOT work: see {', '.join(bad)}")
    return 0 if ok else 1


def _checks(out: Path) -> Iterator[tuple[float, Check]]:
    core, extras, python = requirements()
    parts = (
        lambda: [check_python(python), check_processor()],
        lambda: [check_version(text) for text in core],
        lambda: [check_import("mujoco", "mujoco")],
        lambda: [check_import("ompl", "ompl.geometric")] if installed("ompl") else [],
        lambda: [check_import("pin", "pinocchio", NOTE)] if installed("pinocchio") else [],
        check_stepping,
        lambda: [check_opengl()],
        lambda: [check_extra(name, texts) for name, texts in extras.items()],
        lambda: [check_folder(out)],
    )
    for k, part in enumerate(parts):
        for check in part():
            yield (k + 1) / len(parts), check


# ------------------------------------------------------------------------- packages


def requirements() -> tuple[list[str], dict[str, list[str]], str]:
    """Core requirements, those of each extra, and the Python versions: what is declared.

    From pyproject.toml beside a source tree, else from the installed package.
    """
    project = _ROOT / "pyproject.toml"
    if project.is_file():
        table = tomllib.loads(project.read_text(encoding="utf-8"))["project"]
        extras = {
            name: [text for text in texts if not text.startswith("ves-gym")]
            for name, texts in table["optional-dependencies"].items()
        }
        core, python = list(table["dependencies"]), str(table["requires-python"])
    else:
        metadata = importlib.metadata.metadata("ves-gym")
        core, extras, python = [], {}, str(metadata["Requires-Python"])
        for text in importlib.metadata.requires("ves-gym") or []:
            requirement, _, condition = text.partition(";")
            clauses = [part.strip(" ()") for part in condition.split(" and ")]
            named = [re.fullmatch(r"extra\s*==\s*['\"]([^'\"]+)['\"]", c) for c in clauses]
            extra = next((match[1] for match in named if match), None)
            group = core if extra is None else extras.setdefault(extra, [])
            where = [c for c, match in zip(clauses, named, strict=True) if c and not match]
            if not requirement.startswith("ves-gym"):
                group.append(
                    "; ".join(filter(None, [requirement.strip(), " and ".join(where)]))
                )
    internal = ("all", "build", "dev")  # of other extras, or for those who change the package
    return core, {k: v for k, v in extras.items() if v and k not in internal}, python


def applies(marker: str) -> bool:
    """Return whether an environment marker is true here.

    Args:
        marker: clauses on `sys_platform` and `python_version` joined by `and`; "" is true.

    Raises:
        ValueError: the marker says something else.
    """
    for clause in filter(None, (part.strip(" ()") for part in marker.split(" and "))):
        match = re.fullmatch(r"(\w+)\s*(>=|<=|==|!=|>|<)\s*['\"]([^'\"]+)['\"]", clause)
        if match is None or match[1] not in ("sys_platform", "python_version"):
            raise ValueError(f"markers look like python_version < '3.14', got {clause!r}")
        if match[1] == "python_version":
            true = inside(platform.python_version(), match[2] + match[3])
        else:
            true = _COMPARE[match[2]](sys.platform, match[3])
        if not true:
            return False
    return True


_COMPARE = {
    ">=": operator.ge,
    "<=": operator.le,
    "==": operator.eq,
    "!=": operator.ne,
    ">": operator.gt,
    "<": operator.lt,
}


def inside(version: str, ranges: str) -> bool:
    """Return True if a version lies in ranges like `>=1.0,<2` (release numbers only).

    Args:
        version: installed.
        ranges: admitted.
    """
    for part in filter(None, (p.strip() for p in ranges.split(","))):
        match = re.fullmatch(r"(>=|<=|==|!=|>|<)\s*([\d.]+)", part)
        if match is None:
            raise ValueError(f"version ranges look like >=1.0,<2, got {ranges!r}")
        a, b = _release(version), _release(match[2])
        width = max(len(a), len(b))
        pad = [k + (0,) * (width - len(k)) for k in (a, b)]
        if not _COMPARE[match[1]](*pad):
            return False
    return True


def _release(version: str) -> tuple[int, ...]:
    match = re.match(r"\d+(\.\d+)*", version)
    return tuple(int(k) for k in match[0].split(".")) if match else ()


def check_python(ranges: str) -> Check:
    """The interpreter's version."""
    version = platform.python_version()
    good = inside(version, ranges)
    return Check("python", OK if good else FAIL, f"{version} (needs {ranges})")


def check_version(requirement: str) -> Check:
    """A distribution's version against its range."""
    requirement, _, marker = (part.strip() for part in requirement.partition(";"))
    match = re.match(r"([\w.-]+)\s*(.*)", requirement)
    assert match is not None, requirement
    name, ranges = match[1], match[2]
    try:
        version = importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        if not applies(marker):
            return Check(name, NOTE, f"not installed: has wheels where {marker}")
        return Check(name, FAIL, f"not installed (needs {ranges}): pip install '{requirement}'")
    if not inside(version, ranges):
        return Check(name, FAIL, f"{version}, needs {ranges}: pip install '{requirement}'")
    return Check(name, OK, f"{version} (needs {ranges})")


def check_extra(name: str, texts: list[str]) -> Check:
    """Check that an optional set of packages is complete; never a failure.

    Args:
        name: of the extra.
        texts: its requirements.
    """
    checks = [check_version(text) for text in texts]
    lacking = [
        f"{c.name} {c.detail.split(' (')[0].split(':')[0]}" for c in checks if c.status != OK
    ]
    if not lacking:
        return Check(f"extra {name}", OK, ", ".join(c.name for c in checks))
    return Check(f"extra {name}", NOTE, f"{'; '.join(lacking)}: pip install 'ves-gym[{name}]'")


# -------------------------------------------------------------------- child processes


def _child(code: str, timeout: float = _PATIENCE) -> tuple[bool, str]:
    """Run Python code in a child process: whether it ended well, and its last line."""
    paths = [str(_ROOT), *filter(None, [os.environ.get("PYTHONPATH")])]
    try:
        done = subprocess.run(
            [sys.executable, "-c", code],
            env={**os.environ, "PYTHONPATH": os.pathsep.join(paths)},
            capture_output=True,
            text=True,
            timeout=timeout,
        )
    except subprocess.TimeoutExpired:
        return False, f"hangs (gave up after {timeout:g} s)"
    if done.returncode < 0:
        return False, f"crashes with signal {-done.returncode}"
    text = done.stdout if done.returncode == 0 else done.stderr
    lines = [text_line.strip() for text_line in text.splitlines() if text_line.strip()]
    return done.returncode == 0, lines[-1] if lines else f"exit status {done.returncode}"


def check_import(name: str, module: str, otherwise: str = FAIL) -> Check:
    """Load a native library.

    Args:
        name: its distribution.
        module: what is imported.
        otherwise: status if it does not load.
    """
    good, words = _child(f"import {module}; print('loads')")
    if good:
        return Check(f"import {module}", OK, words)
    hint = ""
    if module == "mujoco" and "MUJOCO_GL" in os.environ:
        hint = f" (MUJOCO_GL is {os.environ['MUJOCO_GL']!r}; MuJoCo reads it when it loads)"
    return Check(f"import {module}", otherwise, words + hint)


_STEP = """
import time
import numpy as np
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.system import System
sim = Simulator(System(), 64, backend={backend!r})
sim.reset(v=0.1)
sim.step()
begin, steps = time.perf_counter(), 0
while time.perf_counter() - begin < 0.5:
    state = sim.step()
    steps += 64 * sim.system.substeps
assert np.isfinite(state.q).all() and np.abs(state.y).max() > 0, "the state is not finite"
took = (time.perf_counter() - begin) / steps * 1e6
print(f"{{took:.2f}} us per physics step, batch of 64")
"""


def check_stepping() -> list[Check]:
    """Step a batch of simulations on each engine, and time it."""
    good, words = _child(_STEP.format(backend="mujoco"))
    fast, answer = _child(_STEP.format(backend="kernel"))
    kernel = Check("kernel", OK if fast else NOTE, answer if fast else f"MuJoCo runs: {answer}")
    return [Check("batch stepping", OK if good else FAIL, words), kernel]


def check_opengl() -> Check:
    """Which OpenGL backends draw; pictures need one, nothing else does."""
    from ves_gym.rendering.opengl import RenderError, candidates, install_hint, probe

    try:
        automatic = candidates()
    except RenderError as error:
        return Check("OpenGL", NOTE, str(error))
    linux = platform.system() == "Linux"
    every = dict.fromkeys([*automatic, *(("egl", "osmesa", "glfw") if linux else ())])
    probes = [probe(backend) for backend in every]
    detail = "; ".join(f"{p.backend}: {p.reason}" for p in probes)
    setting = os.environ.get("MUJOCO_GL")
    state = "MUJOCO_GL is not set" if setting is None else f"MUJOCO_GL is {setting!r}"
    if any(p.works for p in probes if p.backend in automatic):
        return Check("OpenGL", OK, f"{state}; {detail}")
    return Check("OpenGL", NOTE, f"no pictures from `view`: {detail}; {install_hint()}")


# -------------------------------------------------------------------------- the machine


def check_processor() -> Check:
    """Cores that this process may use, and vector instructions."""
    try:
        cores = len(os.sched_getaffinity(0))
    except AttributeError:
        cores = os.cpu_count() or 1
    kind = platform.machine()
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return Check("processor", OK, f"{kind}, {cores} cores; vector instructions unknown")
    match = re.search(r"^(?:flags|Features)\s*:\s*(.*)$", text, re.MULTILINE)
    flags = set(match[1].split()) if match else set()
    features = [
        k for k in ("sse4_2", "avx", "avx2", "fma", "avx512f", "asimd", "sve") if k in flags
    ]
    detail = f"{kind}, {cores} cores; {' '.join(features) or 'no known vector instructions'}"
    if kind == "x86_64" and flags and "avx" not in flags:
        return Check("processor", NOTE, f"{detail}; MuJoCo's wheels need AVX")
    return Check("processor", OK, detail)


def check_folder(out: Path) -> Check:
    """Check that results can be written."""
    folder = out.absolute()
    while not folder.exists():
        folder = folder.parent
    try:
        with tempfile.NamedTemporaryFile(dir=folder, prefix=".ves-gym-") as file:
            file.write(b"x")
    except OSError as error:
        return Check("out folder", FAIL, f"{folder} cannot be written: {error.strerror}")
    return Check("out folder", OK, f"{folder} can be written")


def _print_table(checks: list[Check]) -> None:
    from rich.console import Console
    from rich.table import Table

    styles = {OK: "green", FAIL: "bold red", NOTE: "yellow"}
    table = Table(title="ves-gym doctor", title_justify="left")
    table.add_column("check", no_wrap=True)
    table.add_column("")
    table.add_column("detail", overflow="fold")
    for check in checks:
        table.add_row(check.name, check.status, check.detail, style=styles[check.status])
    Console(width=None if sys.stdout.isatty() else 120, markup=False).print(table)
