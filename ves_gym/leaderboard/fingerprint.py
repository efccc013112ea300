"""Hashes and words of what a result depends on: environment, system, packages, machine."""

from __future__ import annotations

import hashlib
import platform
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import gymnasium as gym

from ves_gym._util.params import content_hash
from ves_gym._util.version import __version__
from ves_gym.envs.build import build_task
from ves_gym.system.system import System

_PACKAGES = ("numpy", "scipy", "mujoco", "llvmlite", "gymnasium", "ompl", "casadi")


@cache
def model_xml(system: System) -> str:
    """SHA-256 of the system's MuJoCo model as MJCF.

    The text depends on MuJoCo's version as well as on the system.
    """
    from ves_gym.engine.backends.mujoco import model_spec

    spec = model_spec(system)
    spec.compile()
    return hashlib.sha256(spec.to_xml().encode()).hexdigest()


def environment(id: str) -> dict[str, Any]:
    """Id, version and content hash of a registered environment with its task and settings."""
    spec = gym.spec(id)
    settings = {k: v for k, v in spec.kwargs.items() if k != "goal"}
    task = build_task(**settings)
    described = {"task": task.to_dict(), "goal": bool(spec.kwargs.get("goal", False))}
    return {"id": id, "version": spec.version, "spec": content_hash(described)}


def package_versions() -> dict[str, str]:
    """Return the installed versions on which a result depends."""
    out = {"ves_gym": __version__, "python": platform.python_version()}
    for name in _PACKAGES:
        try:
            out[name] = version(name)
        except PackageNotFoundError:
            continue
    return out


@cache
def cpu_model() -> str:
    """The processor in words."""
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()[:200]
    except (OSError, UnicodeDecodeError):
        pass
    return (platform.processor() or platform.machine())[:200]


@cache
def simd() -> str:
    """The processor's instruction sets, as the engine is compiled for them."""
    from ves_gym.engine.kernel.build import machine

    name, _, features = machine().partition(" ")[2].partition(" ")
    have = sorted(k[1:] for k in features.split(",") if k.startswith("+"))
    without = sorted(k[1:] for k in features.split(",") if k.startswith("-"))
    vector = [k for k in have if k.startswith(("avx", "fma", "sse", "neon", "sve", "vsx"))]
    vector = [k for k in vector if k not in without]
    return f"{name} {' '.join(vector)}".strip()
