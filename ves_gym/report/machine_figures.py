"""Machines as pictures: a run, modes of a structure, the emulation loop, the legs' servos."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from ves_gym._util.params import Array
from ves_gym.hardware.leg_response import (
    bandwidth,
    gain_margin,
    leg_poles,
    open_loop,
    step_response,
)
from ves_gym.hardware.leg_servo import LEG_SERVOS, LegServo, closed_loop
from ves_gym.mechanics.flexible_base import FlexibleBase
from ves_gym.mechanics.modes import natural_modes
from ves_gym.mechanics.servo import JointServo
from ves_gym.mechanics.spatial import AXES
from ves_gym.report.figures import panels_of
from ves_gym.report.planner_styles import COLOURS
from ves_gym.simulation.loop_linearisation import Linearised
from ves_gym.simulation.stability import in_space, linearise, poles_in_space
from ves_gym.system.energy import log_base_energy
from ves_gym.system.runlog import RunLog
from ves_gym.system.system import System

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MODES = 6  # of a structure
_SWING = 0.15  # of the structure's length: the largest way of a mode
_UNITS = ("m/N", "m/N", "m/N", "rad/(N m)", "rad/(N m)", "rad/(N m)")
_LOOP_TIME = 6.0  # [s] of the loop's step
_LEG_TIME = 0.5  # [s] of a leg's unit step
_EXTENSIONS = np.linspace(0, 1, 21)  # of the leg, shortest to longest, in the pole plot
_SPACE, _LAB = COLOURS[3], COLOURS[1]

Matrices = tuple[Array, Array, Array]  # M, D, K of the structure in space


def run_figure(
    log: RunLog, system: System, duration: float, space: RunLog | None = None
) -> Figure:
    """Draw a run log with rates of the base, five panels over the time [s], a dotted line where
    the motion ends [s]: dashed what was commanded, or the same run in space."""
    E = log_base_energy(log, system)
    figure, panels = panels_of(5, 8.0, 1.7, columns=1)
    place, turn, joint, error, energy = panels
    for k, name in enumerate("xyz"):
        (curve,) = place.plot(log.t, 1e3 * log.y[:, k], label=name, lw=1)
        turn.plot(log.t, np.rad2deg(log.y[:, 3 + k]), label=f"$\\phi_{name}$", lw=1)
        if space is not None:
            dashed: dict[str, Any] = {"color": curve.get_color(), "lw": 0.8, "ls": "--"}
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
    angle = "deg, cm" if system.arm.sliding else "deg"
    joints = f"joints [{angle}]", f"joint error [{angle}]"
    labels = ("base [mm]", "base [deg]", *joints, "base energy [J]")
    for axes, label in zip(panels, labels, strict=True):
        axes.sharex(energy)
        axes.set_ylabel(label)
        axes.legend(loc="upper right", ncols=3, fontsize="small")
        axes.axvline(duration, color="0.5", lw=0.8, ls=":")
        axes.label_outer()
    meaning = "commanded" if space is None else "commanded, or in space"
    energy.set_xlabel(f"time [s]; dotted: end of the motion, dashed: {meaning}")
    return figure


def mode_figure(base: FlexibleBase) -> Figure:
    """Draw the slowest modes of a base with a centreline, nothing on its flange: at most six,
    from the front and from the side, at rest in grey."""
    centreline, reduced = base.centreline(), base.reduction()
    assert centreline is not None
    mass, stiffness = reduced.matrices()
    modes = natural_modes(stiffness, mass)
    count = min(_MODES, len(modes.omega))
    figure, panels = panels_of(2 * count, 2.2, 2.3, columns=count, grid=False)
    size = float(np.ptp(centreline.at_rest, axis=0).max()) or 1.0
    for k in range(count):
        z = modes.shapes[:, k]
        way = centreline.static @ z[:6] + centreline.shapes @ z[6:]
        largest = float(np.linalg.norm(way, axis=1).max())
        moved = centreline.at_rest + (_SWING * size / largest if largest > 0 else 0.0) * way
        for across, axes in enumerate(panels[k::count]):
            axes.plot(centreline.at_rest[:, across], centreline.at_rest[:, 2], color="0.7")
            axes.plot(moved[:, across], moved[:, 2], marker=".")
            axes.set_aspect("equal", adjustable="datalim")
            axes.set_xlabel(f"{'xy'[across]} [m]")
        panels[k].set_title(f"{modes.omega[k] / (2 * np.pi):.3g} Hz")
    for axes in panels[::count]:
        axes.set_ylabel("z [m]")
    return figure


# ------------------------------------------------------------- the emulation loop, thesis 5.4


def emulation_figures(system: System, q: Array, servo: JointServo | None) -> dict[str, Figure]:
    """Return the figures of an emulated system at q (n,) [rad], by name.

    loop_poles, loop_bode and loop_step; of a platform with leg servos those of `leg_figures`.
    """
    loop = linearise(system, q, servo=servo)
    space = in_space(system, q, servo=servo)
    figures = {
        "loop_poles": loop_pole_figure(system, loop, space),
        "loop_bode": loop_bode_figure(loop, space),
        "loop_step": loop_step_figure(loop, space),
    }
    platform = system.emulator_settings.platform
    if isinstance(platform, LegServo):
        servos = dict(LEG_SERVOS)
        if platform not in servos.values():
            servos["this one"] = platform
        figures |= leg_figures(servos)
    return figures


def loop_pole_figure(system: System, loop: Linearised, space: Matrices) -> Figure:
    """Draw poles of one control period in the z-plane, and of slow modes in the s-plane."""
    figure, (wide, near) = panels_of(2, 6.0, 5.0, columns=2)
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
        wide.plot(*_parts(at), color=COLOURS[2], lw=5, alpha=0.4, label="leg modes")
    wide.set(aspect="equal", xlabel="real", ylabel="imaginary", title="one control period (z)")
    wide.legend(loc="lower left", fontsize="small")
    s = np.log(z[np.abs(z) > 1e-9]) / loop.dt
    reach = 1.15 * max(1.0, np.abs(ideal[np.abs(ideal) < 40]).max(initial=1.0))
    near.axvline(0, color="0.6", lw=1)
    near.plot(*_parts(s), "x", color=_LAB, label="emulated")
    near.plot(*_parts(ideal), "o", mfc="none", color=_SPACE, label="in space")
    near.set(xlim=(-0.6 * reach, 0.25 * reach), ylim=(0, reach), xlabel="1/s", ylabel="rad/s")
    near.set_title("slow modes (s); right of the line is unstable")
    near.legend(loc="upper left", fontsize="small")
    return figure


def loop_bode_figure(loop: Linearised, space: Matrices) -> Figure:
    """Draw pose per wrench along each axis in space and in the laboratory: gain [m/N, rad/(N
    m)] and phase [deg] over [Hz]."""
    M, D, K = space
    f = np.geomspace(0.03, min(20.0, 0.45 / loop.dt), 500)
    w = 2j * np.pi * f[:, None, None]
    ideal = np.linalg.inv(w**2 * M + w * D + K)[:, :6, :6]
    curves = ((ideal, _SPACE, "in space"), (loop.compliance(f), _LAB, "emulated"))
    figure, panels = panels_of(12, 4.4, 2.4, columns=3)
    for i in range(6):
        row, column = divmod(i, 3)
        gain, phase = panels[6 * row + column], panels[6 * row + 3 + column]
        for response, colour, name in curves:
            values = response[:, i, i]
            gain.loglog(f, np.abs(values), color=colour, label=name, lw=1.3)
            angle = np.rad2deg(np.unwrap(np.angle(values)))
            phase.semilogx(f, angle, color=colour, lw=1.3)
        gain.set(title=f"{AXES[i]} per wrench along it", ylabel=_UNITS[i])
        phase.set(ylabel="deg", xlabel="Hz")
    panels[0].legend(fontsize="small")
    return figure


def loop_step_figure(loop: Linearised, space: Matrices) -> Figure:
    """Draw the pose [mm, mrad] over [s] after a wrench of 1 N or 1 N m sets in along each
    axis."""
    from scipy.linalg import expm

    M, D, K = space
    n, periods = len(M), round(_LOOP_TIME / loop.dt)
    t = np.arange(periods + 1) * loop.dt
    figure, panels = panels_of(6, 4.4, 2.6, columns=3)
    generator = np.zeros((2 * n + 1, 2 * n + 1))
    generator[:n, n : 2 * n] = np.eye(n)
    generator[n : 2 * n, : 2 * n] = np.linalg.solve(M, np.hstack([-K, -D]))
    for i, axes in enumerate(panels):
        generator[n : 2 * n, -1] = np.linalg.solve(M, np.eye(n)[i])
        hold, x = expm(generator * loop.dt), np.r_[np.zeros(2 * n), 1.0]
        ideal = np.empty(periods + 1)
        for k in range(periods + 1):
            ideal[k], x = 1e3 * x[i], hold @ x
        emulated = 1e3 * loop.step(np.eye(6)[i], periods)[:, i]
        axes.plot(t, ideal, color=_SPACE, label="in space", lw=1.3)
        axes.plot(t, emulated, color=_LAB, label="emulated", lw=1.3)
        size = np.abs(ideal).max()
        if np.abs(emulated).max() > 5 * size:  # it diverges: show where it leaves
            axes.set_ylim(-2 * size, 4 * size)
        wrench, unit = ("N", "mm") if i < 3 else ("N m", "mrad")
        axes.set(title=f"{AXES[i]} after 1 {wrench}", ylabel=unit, xlabel="s")
    panels[0].legend(fontsize="small")
    return figure


# -------------------------------------------------------------------- leg servos, thesis 5


def leg_figures(servos: Mapping[str, LegServo]) -> dict[str, Figure]:
    """Return leg_open, leg_closed, leg_step and leg_poles of servos by name."""
    return {
        "leg_open": leg_bode_figure(servos, closed=False),
        "leg_closed": leg_bode_figure(servos, closed=True),
        "leg_step": leg_step_figure(servos),
        "leg_poles": leg_pole_figure(servos),
    }


def leg_bode_figure(servos: Mapping[str, LegServo], *, closed: bool) -> Figure:
    """Draw loop gain or closed loop of one leg [dB], [deg] over [Hz], the band of its
    transverse mode shaded."""
    figure, (magnitude, phase) = panels_of(2, 7.0, 3.0, columns=1)
    for k, (name, servo) in enumerate(servos.items()):
        f = np.geomspace(0.1, 0.49 * servo.rate, 4000)
        response = closed_loop(servo, f) if closed else open_loop(servo, f)
        measure = (
            f"{bandwidth(servo):.2g} Hz" if closed else f"{_decibel(gain_margin(servo)):.3g} dB"
        )
        gain = _decibel(np.abs(response))
        magnitude.plot(f, gain, label=f"{name}: {measure}", **_leg_style(k))
        phase.plot(f, _phase(response), **_leg_style(k))
    ends = [f for servo in servos.values() for f in (servo.mode_long, servo.mode_short)]
    for axes in (magnitude, phase):
        axes.axvspan(min(ends), max(ends), color="0.88", zorder=0)
        axes.set(xscale="log", xlim=(0.1, 100))
        axes.xaxis.set_major_formatter("{x:g}")
        axes.grid(which="minor", alpha=0.25)
    magnitude.axhline(-3.0 if closed else 0.0, color="0.4", linewidth=0.8)
    magnitude.set(ylabel="magnitude [dB]", ylim=(-40, 10) if closed else (-50, 40))
    magnitude.set_title("closed loop of one leg" if closed else "loop gain of one leg")
    title, small = "bandwidth (−3 dB)" if closed else "gain margin", {"fontsize": "small"}
    magnitude.legend(
        title=title, title_fontproperties={"size": "small"}, loc="lower left", **small
    )
    phase.axhline(-180, color="0.4", linewidth=0.8)
    phase.set(xlabel="frequency [Hz]", ylabel="phase [deg]", ylim=(-300, 30))
    phase.set_yticks(range(-270, 1, 90))
    return figure


def leg_step_figure(servos: Mapping[str, LegServo]) -> Figure:
    """Length of a leg after a unit step of its command, as thesis figure 5-13."""
    figure, (axes,) = panels_of(1, 7.0, 3.8)
    axes.axhline(1.0, color="0.4", linewidth=0.8)
    for k, (name, servo) in enumerate(servos.items()):
        t = np.arange(int(_LEG_TIME * servo.rate)) / servo.rate
        length = step_response(servo, t)
        over = max(100 * (length.max() - 1), 0)
        axes.plot(t, length, label=f"{name}: {over:.2g} % overshoot", **_leg_style(k))
    axes.set(xlabel="time [s]", ylabel="length / step of the command", xlim=(0, _LEG_TIME))
    axes.set_ylim(bottom=0)
    axes.legend(loc="lower right", fontsize="small")
    return figure


def leg_pole_figure(servos: Mapping[str, LegServo]) -> Figure:
    """Closed-loop poles in the z-plane, at home and as the leg goes from end to end."""
    columns = len(servos)
    figure, panels = panels_of(2 * columns, 3.4, 3.4, columns=columns)
    circle = np.exp(1j * np.linspace(0, 2 * np.pi, 2001))
    for k, (name, servo) in enumerate(servos.items()):
        disc, near = panels[k], panels[columns + k]
        turn = 2 * np.pi * servo.mode_short / servo.rate  # argument of the mode's pole
        way = [leg_poles(servo, float(extension)) for extension in _EXTENSIONS]
        for axes in (disc, near):
            axes.plot(*_parts(circle), color="0.4", linewidth=0.8)
            axes.plot(*_parts(np.concatenate(way)), ".", color="0.6", markersize=3)
            axes.plot(
                *_parts(leg_poles(servo)), "x", color=_leg_style(k)["color"], markersize=8
            )
        disc.set_title(f"{name}\nlargest modulus {max(np.abs(p).max() for p in way):.4f}")
        disc.set_aspect("equal")
        disc.set(xlim=(-1.08, 1.08), ylim=(-1.08, 1.08))
        near.set(xlim=(1 - 0.7 * turn, 1 + 0.1 * turn), ylim=(-1.3 * turn, 1.3 * turn))
        near.set(xlabel="Re z")
        near.set_title("near z = 1; grey: shortest to longest leg", fontsize="small")
    for axes in panels[::columns]:
        axes.set(ylabel="Im z")
    return figure


def _leg_style(k: int) -> dict[str, Any]:
    return {"color": COLOURS[k % len(COLOURS)], "linestyle": ("-", "-", "--", "-.")[k % 4]}


def _phase(response: Any) -> Array:
    """Continuous phase [deg]; a zero on the unit circle counts as +180."""
    angle = np.angle(response)
    step = np.diff(angle)
    step -= 2 * np.pi * np.floor((step + 0.9 * np.pi) / (2 * np.pi))
    return np.rad2deg(angle[0] + np.concatenate([[0.0], np.cumsum(step)]))


def _decibel(gain: Array | float) -> Any:
    with np.errstate(divide="ignore"):
        return 20 * np.log10(gain)


def _parts(z: Any) -> tuple[Array, Array]:
    return z.real, z.imag
