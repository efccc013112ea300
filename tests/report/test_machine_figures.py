"""Pictures of servos, gains and the loop show what they are of, and the same each time."""

import numpy as np
import pytest

from ves_gym.damping.configurations import damping_map
from ves_gym.damping.free_vibration import linear_free_vibration, simulate_free_vibration
from ves_gym.damping.plant import GainMatrices, analyse, plant_at
from ves_gym.hardware.leg_servo import LEG_SERVOS, LOW_GAINS
from ves_gym.mechanics.servo import HIGH_GAINS, PPED_GAINS
from ves_gym.mechanics.vehicle import BENT_THESIS
from ves_gym.simulation.stability import poles_in_space
from ves_gym.system.system import System

pytest.importorskip("matplotlib")

from ves_gym.report.damping import map_figure, pole_figure, response_figure
from ves_gym.report.figures import write_figures
from ves_gym.report.machine_figures import leg_bode_figure, leg_figures

SYSTEM = System(vehicle=BENT_THESIS)
Q = np.deg2rad([45.0, 0.0, 0.0])
SETS = [GainMatrices.of(HIGH_GAINS), GainMatrices.of(PPED_GAINS)]
NAMES = ["high", "PPED"]


@pytest.mark.parametrize("servos", [LEG_SERVOS, {"shaking": LOW_GAINS.scaled(5)}])
def test_figures_of_legs_are_the_same_each_time(tmp_path, servos):
    """Also of an unstable servo alone."""
    figures = [leg_figures(servos) for _ in "ab"]
    assert list(figures[0]) == ["leg_open", "leg_closed", "leg_step", "leg_poles"]
    files = [
        write_figures({tmp_path / folder / k: v for k, v in drawn.items()})
        for folder, drawn in zip("ab", figures, strict=True)
    ]
    for first, second in zip(*files, strict=True):
        assert first.read_bytes() == second.read_bytes()
        assert first.read_bytes().startswith(b"\x89PNG") and first.stat().st_size > 10_000


def test_bode_figure_shades_the_mode_and_names_each_servo():
    figure = leg_bode_figure(LEG_SERVOS, closed=True)
    magnitude, phase = figure.axes
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
