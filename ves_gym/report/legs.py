"""The leg servos as static pictures: Bode plots, unit step, poles (thesis 5)."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ves_gym._util.params import ParameterError
from ves_gym.hardware.leg_response import (
    bandwidth,
    gain_margin,
    leg_poles,
    open_loop,
    step_response,
)
from ves_gym.hardware.leg_servo import LegServo, closed_loop
from ves_gym.report.figures import _panels, write_figure
from ves_gym.report.planner_styles import COLOURS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from ves_gym._util.params import Array
    from ves_gym.hardware.leg_servo import Complex

_STEP_TIME = 0.5  # [s] shown of the unit step
_EXTENSIONS = np.linspace(0, 1, 21)  # of the leg, shortest to longest, in the pole plot


def write_leg_figures(
    folder: str | os.PathLike[str],
    servos: Mapping[str, LegServo],
    form: str = "png",
) -> list[Path]:
    """Write leg_open.png, leg_closed.png, leg_step.png and leg_poles.png.

    Args:
        folder: made if it does not exist.
        servos: by the name in the legend, e.g. `hardware.leg_servo.LEG_SERVOS`.
        form: one of `figures.FORMATS`.

    Raises:
        ParameterError: no servos, or matplotlib is not installed.
    """
    if not servos:
        raise ParameterError("write_leg_figures needs at least one leg servo, got none")
    figures = {
        "open": bode_figure(servos, closed=False),
        "closed": bode_figure(servos, closed=True),
        "step": step_figure(servos),
        "poles": pole_figure(servos),
    }
    paths = [Path(folder) / f"leg_{name}.{form}" for name in figures]
    for figure, path in zip(figures.values(), paths, strict=True):
        write_figure(figure, path)
    return paths


def bode_figure(servos: Mapping[str, LegServo], *, closed: bool) -> Figure:
    """Draw magnitude and phase of one leg, the band of its transverse mode shaded.

    Args:
        servos: by the name in the legend.
        closed: the closed loop instead of the loop gain.

    Returns:
        The figure: [dB] and [deg] over [Hz].
    """
    figure, (magnitude, phase) = _panels(2, 7.0, 3.0, columns=1)
    for (name, servo), style in zip(servos.items(), _styles(len(servos)), strict=True):
        f = np.geomspace(0.1, 0.49 * servo.rate, 4000)
        response = closed_loop(servo, f) if closed else open_loop(servo, f)
        measure = (
            f"{bandwidth(servo):.2g} Hz" if closed else f"{_decibel(gain_margin(servo)):.3g} dB"
        )
        magnitude.plot(f, _decibel(np.abs(response)), label=f"{name}: {measure}", **style)
        phase.plot(f, _phase(response), **style)
    for axes in (magnitude, phase):
        _mode_band(axes, servos)
        axes.set(xscale="log", xlim=(0.1, 100))
        axes.xaxis.set_major_formatter("{x:g}")
        axes.grid(which="both", alpha=0.25)
    level = -3.0 if closed else 0.0
    magnitude.axhline(level, color="0.4", linewidth=0.8)
    magnitude.set(ylabel="magnitude [dB]", ylim=(-40, 10) if closed else (-50, 40))
    magnitude.set_title(
        "closed loop of one leg" if closed else "loop gain of one leg", fontsize="medium"
    )
    magnitude.legend(
        title="bandwidth (−3 dB)" if closed else "gain margin",
        loc="lower left",
        fontsize="small",
        title_fontsize="small",
    )
    phase.axhline(-180, color="0.4", linewidth=0.8)
    phase.set(xlabel="frequency [Hz]", ylabel="phase [deg]", ylim=(-300, 30))
    phase.set_yticks(range(-270, 1, 90))
    return figure


def step_figure(servos: Mapping[str, LegServo]) -> Figure:
    """Length of a leg after a unit step of its command, as thesis figure 5-13."""
    figure, (axes,) = _panels(1, 7.0, 3.8)
    axes.axhline(1.0, color="0.4", linewidth=0.8)
    for (name, servo), style in zip(servos.items(), _styles(len(servos)), strict=True):
        t = np.arange(int(_STEP_TIME * servo.rate)) / servo.rate
        length = step_response(servo, t)
        over = max(100 * (length.max() - 1), 0)
        axes.plot(t, length, label=f"{name}: {over:.2g} % overshoot", **style)
    axes.set(xlabel="time [s]", ylabel="length / step of the command", xlim=(0, _STEP_TIME))
    axes.set_ylim(bottom=0)
    axes.grid(alpha=0.3)
    axes.legend(loc="lower right", fontsize="small")
    return figure


def pole_figure(servos: Mapping[str, LegServo]) -> Figure:
    """Closed-loop poles in the z-plane, at home and as the leg goes from end to end."""
    columns = len(servos)
    figure, panels = _panels(2 * columns, 3.4, 3.4, columns=columns)
    styles = _styles(columns)
    for k, (name, servo) in enumerate(servos.items()):
        disc, near = panels[k], panels[columns + k]
        turn = 2 * np.pi * servo.mode_short / servo.rate  # argument of the mode's pole
        for axes in (disc, near):
            _disc(axes)
            for extension in _EXTENSIONS:
                poles = leg_poles(servo, float(extension))
                axes.plot(poles.real, poles.imag, ".", color="0.6", markersize=3)
            poles = leg_poles(servo)
            axes.plot(poles.real, poles.imag, "x", color=styles[k]["color"], markersize=8)
            axes.grid(alpha=0.25)
        largest = max(float(np.abs(leg_poles(servo, float(e))).max()) for e in _EXTENSIONS)
        disc.set_title(f"{name}\nlargest modulus {largest:.4f}", fontsize="medium")
        disc.set_aspect("equal")
        disc.set(xlim=(-1.08, 1.08), ylim=(-1.08, 1.08))
        near.set(xlim=(1 - 0.7 * turn, 1 + 0.1 * turn), ylim=(-1.3 * turn, 1.3 * turn))
        near.set(xlabel="Re z")
        near.set_title("near z = 1; grey: shortest to longest leg", fontsize="small")
    for axes in panels[::columns]:
        axes.set(ylabel="Im z")
    return figure


# ---------------------------------------------------------------------------- pieces


def _styles(count: int) -> list[dict[str, Any]]:
    dashes = ("-", "-", "--", "-.")
    return [
        {"color": COLOURS[k % len(COLOURS)], "linestyle": dashes[k % len(dashes)]}
        for k in range(count)
    ]


def _phase(response: Complex) -> Array:
    """Continuous phase [deg]; a zero on the unit circle counts as +180."""
    angle = np.angle(response)
    step = np.diff(angle)
    step -= 2 * np.pi * np.floor((step + 0.9 * np.pi) / (2 * np.pi))
    return np.rad2deg(angle[0] + np.concatenate([[0.0], np.cumsum(step)]))


def _decibel(gain: Array | float) -> Array:
    with np.errstate(divide="ignore"):
        return 20 * np.log10(gain)


def _mode_band(axes: Axes, servos: Mapping[str, LegServo]) -> None:
    ends = [f for servo in servos.values() for f in (servo.mode_long, servo.mode_short)]
    axes.axvspan(min(ends), max(ends), color="0.88", zorder=0)


def _disc(axes: Axes) -> None:
    circle = np.exp(1j * np.linspace(0, 2 * np.pi, 2001))
    axes.plot(circle.real, circle.imag, color="0.4", linewidth=0.8)
