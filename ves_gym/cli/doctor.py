"""`ves-gym doctor`: what is broken on this machine.

Whatever may crash or hang (native libraries, OpenGL) is tried in a child process.
"""

from __future__ import annotations

import importlib.metadata
import os
import platform
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet

from ves_gym._util.optional import installed, require
from ves_gym._util.params import ParameterError
from ves_gym._util.tables import table
from ves_gym.cli.flags import Answer, Context, Flag, one_of, require_writable
from ves_gym.rendering.opengl import (
    RenderError,
    attempt,
    candidates,
    install_hint,
    probe,
    state,
)

OK, FAIL, NOTE = "ok", "fail", "note"
_PATIENCE = 90.0  # s for a child process
_VECTORS = ("sse4_2", "avx", "avx2", "fma", "avx512f", "asimd", "sve")


class Check(NamedTuple):
    """One finding. `fail` means the core does not work; `note` only limits it."""

    name: str
    status: str
    detail: str


def doctor(at: Context) -> Answer:
    """Return every finding; negative if a core check fails."""
    checks: list[Check] = []
    for done, check in _checks(at.out or Path("out")):
        checks.append(check)
        at.progress(done, f"after {check.name}")
    bad = [check.name for check in checks if check.status == FAIL]
    verdict = f"the core does NOT work: see {', '.join(bad)}" if bad else "the core works"
    rows = table(("check", "", "detail"), checks, title="ves-gym doctor", left=(0, 1, 2))
    plain = {
        "schema": "ves-doctor/1",
        "ok": not bad,
        "checks": [check._asdict() for check in checks],
    }
    return Answer(text=f"{rows}\n{verdict}", plain=plain, negative=bool(bad))


def _checks(out: Path) -> Iterator[tuple[float, Check]]:
    core, extras, python = requirements()
    version = platform.python_version()
    good = SpecifierSet(python).contains(version, prereleases=True)
    parts = (
        lambda: [Check("python", OK if good else FAIL, f"{version} (needs {python})")],
        lambda: [check_processor()],
        lambda: [check_version(needed) for needed in core],
        lambda: [check_import("mujoco")],
        lambda: [check_import("ompl.geometric")] if installed("ompl") else [],
        lambda: [check_import("pinocchio", NOTE)] if installed("pinocchio") else [],
        check_stepping,
        lambda: [check_opengl()],
        lambda: [check_extra(name, needed) for name, needed in extras.items()],
        lambda: [check_folder(out)],
    )
    for k, part in enumerate(parts):
        for check in part():
            yield (k + 1) / len(parts), check


# ------------------------------------------------------------------------- packages


def requirements() -> tuple[list[Requirement], dict[str, list[Requirement]], str]:
    """Core requirements, those of each extra, and the Python versions: what is declared."""
    about = importlib.metadata.metadata("ves-gym")
    texts = importlib.metadata.requires("ves-gym") or ()
    every = [Requirement(text) for text in texts if not text.startswith("ves-gym")]
    core = [r for r in every if "extra" not in str(r.marker)]
    extras = {
        k: [r for r in every if r not in core and f'extra == "{k}"' in str(r.marker)]
        for k in about.get_all("Provides-Extra") or ()
    }
    internal = ("all", "build", "dev")  # of other extras, or for those who change the package
    declared = {k: v for k, v in extras.items() if v and k not in internal}
    return core, declared, str(about["Requires-Python"])


def check_version(needed: Requirement, extra: str = "") -> Check:
    """A distribution's version against its range; `extra` is what asks for it."""
    name, ranges = needed.name, needed.specifier
    how = f"pip install '{name}{ranges}'"
    try:
        version = importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        if needed.marker is not None and not needed.marker.evaluate({"extra": extra}):
            return Check(name, NOTE, f"not installed: has wheels where {needed.marker}")
        return Check(name, FAIL, f"not installed (needs {ranges}): {how}")
    if not ranges.contains(version, prereleases=True):
        return Check(name, FAIL, f"{version}, needs {ranges}: {how}")
    return Check(name, OK, f"{version} (needs {ranges})")


def check_extra(name: str, needed: list[Requirement]) -> Check:
    """Check that an optional set of packages is complete; never a failure."""
    checks = [check_version(requirement, name) for requirement in needed]
    lacking = [
        f"{c.name} {c.detail.split(' (')[0].split(':')[0]}" for c in checks if c.status != OK
    ]
    if not lacking:
        return Check(f"extra {name}", OK, ", ".join(c.name for c in checks))
    return Check(f"extra {name}", NOTE, f"{'; '.join(lacking)}: pip install 'ves-gym[{name}]'")


# -------------------------------------------------------------------- child processes


def check_import(module: str, otherwise: str = FAIL) -> Check:
    """Load a native library; `otherwise` is the status if it does not load."""
    good, words = attempt(f"import {module}; print('loads')", _PATIENCE)
    if good:
        return Check(f"import {module}", OK, words)
    hint = ""
    if module == "mujoco" and "MUJOCO_GL" in os.environ:
        hint = f" ({state()}; MuJoCo reads it when it loads)"
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
    good, words = attempt(_STEP.format(backend="mujoco"), _PATIENCE)
    fast, answer = attempt(_STEP.format(backend="kernel"), _PATIENCE)
    kernel = Check("kernel", OK if fast else NOTE, answer if fast else f"MuJoCo runs: {answer}")
    return [Check("batch stepping", OK if good else FAIL, words), kernel]


def check_opengl() -> Check:
    """Which OpenGL backends draw; pictures need one, nothing else does."""
    try:
        automatic = candidates()
    except RenderError as error:
        return Check("OpenGL", NOTE, str(error))
    linux = platform.system() == "Linux"
    every = dict.fromkeys([*automatic, *(("egl", "osmesa", "glfw") if linux else ())])
    probes = [probe(backend) for backend in every]
    detail = "; ".join(f"{p.backend}: {p.reason}" for p in probes)
    if any(p.works for p in probes if p.backend in automatic):
        return Check("OpenGL", OK, f"{state()}; {detail}")
    return Check("OpenGL", NOTE, f"no pictures from `view`: {detail}; {install_hint()}")


# -------------------------------------------------------------------------- the machine


def check_processor() -> Check:
    """Cores that this process may use, and vector instructions."""
    affine = hasattr(os, "sched_getaffinity")
    cores = len(os.sched_getaffinity(0)) if affine else os.cpu_count() or 1
    kind = platform.machine()
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return Check("processor", OK, f"{kind}, {cores} cores; vector instructions unknown")
    match = re.search(r"^(?:flags|Features)\s*:\s*(.*)$", text, re.MULTILINE)
    flags = set(match[1].split()) if match else set()
    features = " ".join(k for k in _VECTORS if k in flags) or "no known vector instructions"
    detail = f"{kind}, {cores} cores; {features}"
    if kind == "x86_64" and flags and "avx" not in flags:
        return Check("processor", NOTE, f"{detail}; MuJoCo's wheels need AVX")
    return Check("processor", OK, detail)


def check_folder(out: Path) -> Check:
    """Check that results can be written."""
    try:
        require_writable(out, "--out")
    except ParameterError as error:
        return Check("out folder", FAIL, str(error))
    return Check("out folder", OK, f"{out.absolute()} can be written")


def completion(at: Context, *, shell: str) -> Answer:
    """Lines for a shell's start file; shtab writes them."""
    require("completion", "shtab")
    import shtab

    from ves_gym.cli.main import COMMANDS, build_parser

    return Answer(text=shtab.complete(build_parser(*COMMANDS), shell))


SHELLS = "bash", "zsh", "fish"
TABLE = {
    "doctor": (doctor, ()),
    "completion": (completion, (
        Flag("SHELL", "", one_of(*SHELLS),
             f"{', '.join(SHELLS)}; in bash: eval \"$(ves-gym completion bash)\""),
    )),
}  # fmt: skip
