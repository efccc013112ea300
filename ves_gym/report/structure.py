"""Picture of the modes of a flexible base, drawn along its line."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from ves_gym.mechanics.flexible_base import FlexibleBase
from ves_gym.mechanics.modes import natural_modes

_SHOWN = 6
_SWING = 0.15  # of the structure's length: the largest way in the picture


def mode_figure(base: FlexibleBase) -> Figure:
    """Draw the slowest modes with nothing on the flange: from the front and from the side.

    Args:
        base: that has a centreline.

    Returns:
        The figure: at most six modes side by side, at rest in grey.
    """
    line, reduced = base.centreline(), base.reduction()
    assert line is not None
    mass, stiffness = reduced.matrices()
    modes = natural_modes(stiffness, mass)
    count = min(_SHOWN, len(modes.omega))
    figure = Figure(figsize=(2.2 * count, 5.0), layout="constrained")
    axes = figure.subplots(2, count, squeeze=False)
    size = float(np.ptp(line.at_rest, axis=0).max()) or 1.0
    for k in range(count):
        z = modes.shapes[:, k]
        way = line.static @ z[:6] + line.shapes @ z[6:]
        largest = float(np.linalg.norm(way, axis=1).max())
        moved = line.at_rest + (_SWING * size / largest if largest > 0 else 0.0) * way
        for row, across in enumerate((0, 1)):
            axis = axes[row, k]
            axis.plot(line.at_rest[:, across], line.at_rest[:, 2], color="0.7")
            axis.plot(moved[:, across], moved[:, 2], marker=".")
            axis.set_aspect("equal", adjustable="datalim")
            axis.set_xlabel(f"{'xy'[across]} [m]")
        axes[0, k].set_title(f"{modes.omega[k] / (2 * np.pi):.3g} Hz")
    for row in axes:
        row[0].set_ylabel("z [m]")
    return figure
