"""The complete emulation loop as pictures: poles, compliance and step (thesis 5.4)."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ves_gym._util.params import Array
from ves_gym.hardware.leg_servo import LegServo
from ves_gym.mechanics.servo import JointServo
from ves_gym.mechanics.spatial import AXES
from ves_gym.report.figures import _panels, write_figure
from ves_gym.report.planner_styles import COLOURS
from ves_gym.simulation.loop_linearisation import Linearised
from ves_gym.simulation.stability import in_space, linearise, poles_in_space
from ves_gym.system.system import System

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_UNITS = ("m/N", "m/N", "m/N", "rad/(N m)", "rad/(N m)", "rad/(N m)")
_STEP_TIME = 6.0  # [s] shown of the step
_SPACE, _LAB = COLOURS[3], COLOURS[1]


def write_loop_figures(
    folder: str | os.PathLike[str],
    system: System,
    q: Array,
    servo: JointServo | None,
    form: str = "png",
) -> list[Path]:
    """Write loop_poles.png, loop_bode.png and loop_step.png of an emulated system at q.

    Args:
        folder: made if it does not exist.
        system: mode emulated.
        q: (n,) configuration [rad].
        servo: that holds the joints, or None.
        form: one of `figures.FORMATS`.

    Returns:
        The files.

    Raises:
        ParameterError: matplotlib is not installed.
    """
    loop = linearise(system, q, servo=servo)
    space = in_space(system, q, servo=servo)
    figures = {
        "poles": pole_figure(system, loop, space),
        "bode": bode_figure(loop, space),
        "step": step_figure(loop, space),
    }
    paths = [Path(folder) / f"loop_{name}.{form}" for name in figures]
    for figure, path in zip(figures.values(), paths, strict=True):
        write_figure(figure, path)
    return paths


def pole_figure(system: System, loop: Linearised, space: tuple[Array, Array, Array]) -> Figure:
    """Draw poles of one control period in the z-plane, and of slow modes in the s-plane.

    Args:
        system: mode emulated.
        loop: the linearised emulation loop.
        space: M, D and K of the same structure in space.

    Returns:
        The figure.
    """
    figure, (wide, near) = _panels(2, 6.0, 5.0, columns=2)
    z = np.linalg.eigvals(loop.A).astype(complex)
    ideal = poles_in_space(*space)
    turn = np.exp(1j * np.linspace(0, 2 * np.pi, 400))
    wide.plot(turn.real, turn.imag, color="0.6", lw=1)
    inside = np.abs(z) <= 1 + 1e-4
    wide.plot(*_parts(z[inside]), "x", color=_LAB, label="emulated")
    if not inside.all():
        wide.plot(*_parts(z[~inside]), "X", color="#d11", ms=9, label="unstable")
    wide.plot(*_parts(np.exp(ideal * loop.dt)), "o", mfc="none", color=_SPACE, label="in space")
    platform = system.emulator_settings.platform
    if isinstance(platform, LegServo):
        at = np.exp(2j * np.pi * np.linspace(platform.mode_long, platform.mode_short) * loop.dt)
        wide.plot(at.real, at.imag, color=COLOURS[2], lw=5, alpha=0.4, label="leg modes")
    wide.set(aspect="equal", xlabel="real", ylabel="imaginary", title="one control period (z)")
    wide.legend(loc="lower left", fontsize="small")
    s = np.log(z[np.abs(z) > 1e-9]) / loop.dt
    reach = 1.15 * max(1.0, np.abs(ideal[np.abs(ideal) < 40]).max(initial=1.0))
    near.axvline(0, color="0.6", lw=1)
    near.plot(*_parts(s), "x", color=_LAB, label="emulated")
    near.plot(*_parts(ideal), "o", mfc="none", color=_SPACE, label="in space")
    near.set(
        xlim=(-0.6 * reach, 0.25 * reach),
        ylim=(0, reach),
        xlabel="1/s",
        ylabel="rad/s",
        title="slow modes (s); right of the line is unstable",
    )
    near.legend(loc="upper left", fontsize="small")
    for axes in (wide, near):
        axes.grid(alpha=0.3)
    return figure


def bode_figure(loop: Linearised, space: tuple[Array, Array, Array]) -> Figure:
    """Draw pose per wrench along each axis: in space and in the laboratory, gain and phase.

    Args:
        loop: the linearised emulation loop.
        space: M, D and K of the same structure in space.

    Returns:
        The figure: [m/N, rad/(N m)] and [deg] over [Hz].
    """
    M, D, K = space
    f = np.geomspace(0.03, min(20.0, 0.45 / loop.dt), 500)
    w = 2j * np.pi * f[:, None, None]
    ideal = np.linalg.inv(w**2 * M + w * D + K)[:, :6, :6]
    emulated = loop.compliance(f)
    figure, panels = _panels(12, 4.4, 2.4, columns=3)
    for i in range(6):
        row, column = divmod(i, 3)
        gain, phase = panels[6 * row + column], panels[6 * row + 3 + column]
        for response, colour, name in (
            (ideal, _SPACE, "in space"),
            (emulated, _LAB, "emulated"),
        ):
            values = response[:, i, i]
            gain.loglog(f, np.abs(values), color=colour, label=name, lw=1.3)
            angle = np.rad2deg(np.unwrap(np.angle(values)))
            phase.semilogx(f, angle, color=colour, lw=1.3)
        gain.set(title=f"{AXES[i]} per wrench along it", ylabel=_UNITS[i])
        phase.set(ylabel="deg", xlabel="Hz")
        for axes in (gain, phase):
            axes.grid(alpha=0.3)
    panels[0].legend(fontsize="small")
    return figure


def step_figure(loop: Linearised, space: tuple[Array, Array, Array]) -> Figure:
    """Draw the pose after a wrench of 1 N or 1 N m sets in along each axis.

    Args:
        loop: the linearised emulation loop.
        space: M, D and K of the same structure in space.

    Returns:
        The figure: [mm, mrad] over [s].
    """
    M, D, K = space
    n, periods = len(M), round(_STEP_TIME / loop.dt)
    t = np.arange(periods + 1) * loop.dt
    figure, panels = _panels(6, 4.4, 2.6, columns=3)
    generator = np.zeros((2 * n + 1, 2 * n + 1))
    generator[:n, n : 2 * n] = np.eye(n)
    generator[n : 2 * n, : 2 * n] = np.linalg.solve(M, np.hstack([-K, -D]))
    from scipy.linalg import expm

    for i, axes in enumerate(panels):
        generator[n : 2 * n, -1] = np.linalg.solve(M, np.eye(n)[i])
        hold, x = expm(generator * loop.dt), np.r_[np.zeros(2 * n), 1.0]
        ideal = np.empty(periods + 1)
        for k in range(periods + 1):
            ideal[k], x = x[i], hold @ x
        factor, unit = (1e3, "mm") if i < 3 else (1e3, "mrad")
        axes.plot(t, factor * ideal, color=_SPACE, label="in space", lw=1.3)
        emulated = factor * loop.step(np.eye(6)[i], periods)[:, i]
        axes.plot(t, emulated, color=_LAB, label="emulated", lw=1.3)
        size = np.abs(factor * ideal).max()
        if np.abs(emulated).max() > 5 * size:  # it diverges: show where it leaves
            axes.set_ylim(-2 * size, 4 * size)
        axes.set(title=f"{AXES[i]} after 1 {'N' if i < 3 else 'N m'}", ylabel=unit, xlabel="s")
        axes.grid(alpha=0.3)
    panels[0].legend(fontsize="small")
    return figure


def _parts(z: Any) -> tuple[Array, Array]:
    return z.real, z.imag
