"""One run as a picture: base pose, joints, joint errors and energy against time."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ves_gym._util.optional import require
from ves_gym.system.energy import log_base_energy
from ves_gym.system.runlog import RunLog
from ves_gym.system.system import System

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def run_figure(
    log: RunLog, system: System, duration: float, space: RunLog | None = None
) -> Figure:
    """Draw a run log: what was commanded dashed, or the same run in space.

    Args:
        log: with rates of the base.
        system: that it is a run of.
        duration: of the motion [s], a dotted line.
        space: the same motion played in space, dashed, or None.

    Returns:
        The figure: five panels over the time [s].

    Raises:
        ParameterError: matplotlib is not installed.
    """
    require("drawing", "matplotlib")
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    assert log.yd is not None  # a recording has it
    E = log_base_energy(log, system)
    figure = Figure(figsize=(8, 9), layout="constrained")
    FigureCanvasAgg(figure)
    place, turn, joint, error, energy = figure.subplots(5, 1, sharex=True)
    for k, name in enumerate("xyz"):
        (curve,) = place.plot(log.t, 1e3 * log.y[:, k], label=name, lw=1)
        turn.plot(log.t, np.rad2deg(log.y[:, 3 + k]), label=f"$\\phi_{name}$", lw=1)
        if space is not None:
            dashed = {"color": curve.get_color(), "lw": 0.8, "ls": "--"}
            place.plot(space.t, 1e3 * space.y[:, k], **dashed)
            turn.plot(space.t, np.rad2deg(space.y[:, 3 + k]), **dashed)
    for k, link in enumerate(system.arm.links):
        name, factor = f"$q_{k + 1}$", 100.0 if link.slides else math.degrees(1)
        (curve,) = joint.plot(log.t, factor * log.q[:, k], label=name, lw=1)
        joint.plot(log.t, factor * log.q_cmd[:, k], "--", color=curve.get_color(), lw=1)
        error.plot(log.t, factor * (log.q_cmd - log.q)[:, k], label=name, lw=1)
    energy.plot(log.t, E.total, label="total", lw=1.2)
    energy.plot(log.t, E.strain, label="strain", lw=0.8)
    if space is not None:
        total = log_base_energy(space).total
        energy.plot(space.t, total, "--", color="0.4", label="total in space", lw=1)
    shown = "deg, cm" if system.arm.sliding else "deg"
    joints = f"joints [{shown}]", f"joint error [{shown}]"
    labels = ("base [mm]", "base [deg]", *joints, "base energy [J]")
    for axes, label in zip((place, turn, joint, error, energy), labels, strict=True):
        axes.set_ylabel(label)
        axes.legend(loc="upper right", ncols=3, fontsize="small")
        axes.grid(alpha=0.3)
        axes.axvline(duration, color="0.5", lw=0.8, ls=":")
    meaning = "commanded" if space is None else "commanded, or in space"
    energy.set_xlabel(f"time [s]; dotted: end of the motion, dashed: {meaning}")
    return figure
