"""Packages that not every installation has: loaded on use, or refused in one line.

`require("training", "torch")` stands before the first thing a function does with them, so that
nothing is half done; `lacking` gives the same sentence to those that can do without.
"""

from __future__ import annotations

import importlib.util
import sys
from typing import NamedTuple

from ves_gym._util.params import ParameterError


class Source(NamedTuple):
    """Origin of a module: the package to install, and by which command."""

    package: str
    extra: str = ""  # of ves-gym that installs it; none: named by itself
    wheels: str = ""  # the platforms that it has wheels for, where these are not all


PACKAGES = {  # module -> what installs it
    "PIL": Source("pillow", "report"),
    "ansys.mapdl.reader": Source("ansys-mapdl-reader", "ansys"),
    "h5py": Source("h5py", "data"),
    "imageio_ffmpeg": Source("imageio-ffmpeg", "movie"),
    "matplotlib": Source("matplotlib", "report"),
    "minari": Source("minari", "data"),
    "ompl": Source("ompl", wheels="Linux and macOS 15, Python 3.11 to 3.13"),
    "onnx": Source("onnx", "onnx"),
    "onnxruntime": Source("onnxruntime", "onnx"),
    "optuna": Source("optuna", "scale"),
    "pandas": Source("pandas", "frames"),
    "pinocchio": Source("pin", "pinocchio", wheels="Linux and macOS"),
    "pyarrow": Source("pyarrow", "parquet"),
    "pyyeti": Source("pyyeti", "nastran"),
    "rerun": Source("rerun-sdk", "rerun"),
    "robot_descriptions": Source("robot_descriptions", "robots"),
    "rosbags": Source("rosbags", "mcap"),
    "safetensors": Source("safetensors"),
    "shtab": Source("shtab", "completion"),
    "stable_baselines3": Source("stable-baselines3", "rl"),
    "tensorboard": Source("tensorboard", "tensorboard"),
    "torch": Source("torch", "rl"),
    "warp": Source("warp-lang", "gpu"),
    "xarray": Source("xarray", "frames"),
}


class MissingPackageError(ParameterError):
    """An optional package is not installed, or does not load."""


def require(purpose: str, *modules: str) -> None:
    """Do nothing if the modules of `PACKAGES` are installed, of which none is loaded; else name
    each package that is missing and its command. `purpose`, like "planner ompl-qt", is the
    subject."""
    sentence = lacking(purpose, *modules)
    if sentence:
        raise MissingPackageError(sentence)


def lacking(purpose: str, *modules: str) -> str:
    """Return the sentence of `require`, empty if nothing is missing."""
    missing = [PACKAGES[name] for name in modules if not installed(name)]
    if not missing:
        return ""
    names = " and ".join(dict.fromkeys(source.package for source in missing))
    kind = "package" if len(missing) == 1 else "packages"
    return f"{purpose} needs the {kind} {names}: {_how(missing)}"


def installed(module: str) -> bool:
    """Return whether a module can be found; only the packages it lies in are loaded."""
    try:
        return importlib.util.find_spec(module) is not None
    except (ImportError, ValueError):  # its parent is missing; loaded by hand, without a spec
        return sys.modules.get(module) is not None


def explain(error: ImportError) -> str | None:
    """Return the sentence for an optional package that failed to load, None for any other."""
    name = error.name or ""
    distribution = next((m for m in PACKAGES if f"{name}.".startswith(f"{m}.")), None)
    if distribution is None:
        return None
    source = PACKAGES[distribution]
    if not installed(distribution):
        return lacking("this command", distribution)
    return f"the package {source.package} does not load here ({error}): {_how([source])}"


def _how(sources: list[Source]) -> str:
    """Return the commands that install the packages, and where there is nothing to install."""
    targets = dict.fromkeys(
        f"'ves-gym[{source.extra}]'" if source.extra else source.package for source in sources
    )
    notes = [f"{s.package} has wheels for {s.wheels}" for s in sources if s.wheels]
    return "; ".join([f"pip install {' '.join(targets)}", *notes])
