"""The figures are written for what a result holds, and show what they are of, each time."""

import sys

import numpy as np
import pytest

from ves_gym._util.params import ParameterError
from ves_gym.damping.configurations import damping_map
from ves_gym.damping.free_vibration import linear_free_vibration, simulate_free_vibration
from ves_gym.damping.plant import GainMatrices, analyse, plant_at
from ves_gym.hardware.leg_servo import LEG_SERVOS, LOW_GAINS
from ves_gym.mechanics.servo import HIGH_GAINS, PPED_GAINS
from ves_gym.mechanics.vehicle import BENT_THESIS
from ves_gym.report.damping import map_figure, pole_figure, response_figure
from ves_gym.report.figures import (
    benchmark_figures,
    pareto_figure,
    time_figure,
    write_figures,
)
from ves_gym.report.machine_figures import leg_bode_figure, leg_figures
from ves_gym.simulation.stability import poles_in_space
from ves_gym.system.system import System

pytest.importorskip("matplotlib")

ALL = ["ratio", "energy", "coupling", "prediction", "pareto"]


def write(figures, folder, form="png"):
    return write_figures({folder / name: figure for name, figure in figures.items()}, form)


def test_figures_have_something_on_them_and_are_the_same_each_time(tmp_path, result):
    from PIL import Image

    paths, again = (write(benchmark_figures(result), tmp_path / folder) for folder in "ab")
    assert [path.name for path in paths] == [f"{name}.png" for name in ALL]
    for path, second in zip(paths, again, strict=True):
        assert path.read_bytes() == second.read_bytes()
        pixels = np.asarray(Image.open(path).convert("RGB"))
        assert min(pixels.shape[:2]) > 400
        colours = pixels @ [1, 256, 256**2]  # each as one number
        assert len(np.unique(colours)) > 50  # lines, text, areas


@pytest.mark.parametrize(("form", "start"), [("svg", b"<?xml"), ("pdf", b"%PDF")])
def test_a_paper_gets_lines_instead_of_pixels(tmp_path, result, form, start):
    first, second = (
        write({k: time_figure(result, "E")}, tmp_path, form)[0].read_bytes() for k in "ab"
    )
    assert first.startswith(start) and first == second


def test_bounds_are_joined_in_their_order(result):
    """Energy against two accelerations: a line through the bounds, a point per planner."""
    some = result["summary"][0]
    names = {row["planner"] for row in result["summary"]}
    result["summary"] = [r for r in result["summary"] if r["duration"] == some["duration"]]
    for bound in (3.0, 0.03):
        name = f"{some['planner']}:tip={bound:g}"
        result["planners"].append({"name": name, "summary": ""})
        result["summary"].append({**some, "planner": name, "ratio_median": bound})
    for axes in pareto_figure(result).axes:
        (joined,) = [line for line in axes.lines if len(line.get_xdata()) == 3]
        assert list(joined.get_xdata()) == [0.03, some["ratio_median"], 3.0]
        assert {text.get_text() for text in axes.texts} == {"0.03", "1", "3"}
        assert {line.get_label() for line in axes.lines} >= names


def test_a_stopped_run_and_the_run_in_space_are_drawn(emulated):
    """Two lines per run, and a cross where it stopped."""
    assert set(benchmark_figures(emulated)) >= {
        "base_motion_emulated",
        "strain_energy_emulated",
    }
    lines = time_figure(emulated, "distance").axes[0].lines
    (trace,) = emulated["traces"]
    assert all(row["stopped"] for row in emulated["rows"])
    assert len(lines) == 3 * len(trace["series"])
    cross = next(curve for curve in lines if curve.get_marker() == "x")
    first = trace["series"][0]
    assert cross.get_xdata() == [first["t"][-1]]
    assert cross.get_ydata() == [pytest.approx(1e3 * first["distance"][-1])]  # mm


@pytest.mark.parametrize(
    ("change", "names"),
    [
        ({"maps": []}, ["ratio", "energy", "prediction", "pareto"]),
        ({"traces": [], "maps": [], "summary": []}, ["ratio", "prediction"]),
        ({"rows": [], "summary": [], "traces": [], "maps": []}, []),
    ],
)
def test_only_what_there_is_data_for(result, change, names):
    assert list(benchmark_figures({**result, **change})) == names


def test_what_is_missing_in_a_result_is_left_out(result, monkeypatch):
    for row in result["rows"]:
        row.update(E_mean=0.0, predicted=None, prediction_error=None)
    for section in result["maps"]:
        section.update(lines=[], paths=[], start=None, goal=None)
    assert list(benchmark_figures(result)) == ALL
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(ParameterError, match=r"ves-gym\[report\]"):
        benchmark_figures(result)


# ------------------------------------------------------------------- servos, gains, legs

SYSTEM = System(vehicle=BENT_THESIS)
Q = np.deg2rad([45.0, 0.0, 0.0])
SETS = [GainMatrices.of(HIGH_GAINS), GainMatrices.of(PPED_GAINS)]
NAMES = ["high", "PPED"]


@pytest.mark.parametrize("servos", [LEG_SERVOS, {"shaking": LOW_GAINS.scaled(5)}])
def test_legs_have_four_figures(tmp_path, servos):
    """Also an unstable servo alone."""
    drawn = leg_figures(servos)
    assert list(drawn) == ["leg_open", "leg_closed", "leg_step", "leg_poles"]
    for file in write(drawn, tmp_path):
        assert file.stat().st_size > 10_000


def test_bode_figure_shades_the_mode_and_names_each_servo():
    magnitude, phase = leg_bode_figure(LEG_SERVOS, closed=True).axes
    labels = [text.get_text() for text in magnitude.get_legend().get_texts()]
    assert [label.split(":")[0] for label in labels] == list(LEG_SERVOS)
    for axes in (magnitude, phase):
        (band,) = axes.patches
        assert (band.get_x(), band.get_x() + band.get_width()) == (10, 13)


def test_every_pole_of_the_upper_half_is_drawn():
    plant = plant_at(SYSTEM, Q)
    sets = [(n, analyse(plant, g).poles) for n, g in zip(NAMES, SETS, strict=True)]
    figure = pole_figure(sets, poles_in_space(plant.mass, SYSTEM.base.D, SYSTEM.base.K))
    assert [axes.get_title() for axes in figure.axes] == NAMES
    for axes, (_, poles) in zip(figure.axes, sets, strict=True):
        _, rings, crosses = axes.lines
        assert len(rings.get_xdata()) == 6
        upper = poles[poles.imag >= 0]
        np.testing.assert_array_equal(crosses.get_xdata(), upper.real)
        (slowest, fastest), (_, top) = axes.get_xlim(), axes.get_ylim()
        assert slowest < upper.real.min() and upper.real.max() < fastest
        assert upper.imag.max() < top


@pytest.mark.parametrize("both", [True, False])
def test_responses_of_both_models_are_drawn(both):
    linear = linear_free_vibration(SYSTEM, Q, SETS, seconds=4.0)
    simulated = simulate_free_vibration(SYSTEM, Q, SETS, seconds=4.0) if both else None
    figure = response_figure(NAMES, linear, simulated)
    translation, strain, integral = figure.axes
    assert len(strain.lines) == (4 if both else 2)
    start = translation.lines[0].get_ydata()[0]
    assert start == pytest.approx(100 * np.sqrt(3))  # mm
    np.testing.assert_array_equal(strain.lines[-1].get_ydata(), linear.strain[1])
    assert integral.lines[-1].get_ydata()[-1] == pytest.approx(linear.E_int[1])
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels == NAMES + ["by the linear model"] * both


def test_a_map_has_a_column_per_section():
    figure = map_figure([damping_map(SYSTEM, k, Q, points=2) for k in ((0, 1), (1, 2))])
    panels = [axes for axes in figure.axes if axes.get_title()]
    assert len(panels) == 6
    assert [axes.get_title() for axes in panels[:2]] == ["joint 3 at 0°", "joint 1 at 45°"]
    assert panels[1].get_xlabel() == "joint 2 [deg]"
    star = panels[0].lines[0]
    assert (star.get_xdata()[0], star.get_ydata()[0]) == pytest.approx((45, 0))
