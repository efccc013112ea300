"""The figures of the leg servos: written, whole, and the same each time."""

import pytest

from ves_gym._util.params import ParameterError
from ves_gym.hardware.leg_servo import LEG_SERVOS, LOW_GAINS

pytest.importorskip("matplotlib")

from ves_gym.report.legs import bode_figure, write_leg_figures

PNG = b"\x89PNG"


def test_figures_are_written(tmp_path):
    paths = write_leg_figures(tmp_path / "new", LEG_SERVOS)
    assert [p.name for p in paths] == [
        "leg_open.png",
        "leg_closed.png",
        "leg_step.png",
        "leg_poles.png",
    ]
    drawn = [p.read_bytes() for p in paths]
    assert all(data.startswith(PNG) and len(data) > 10_000 for data in drawn)


def test_figures_of_one_unstable_servo_are_written_and_the_same_each_time(tmp_path):
    servos = {"shaking": LOW_GAINS.scaled(5)}
    first, second = (write_leg_figures(tmp_path / name, servos) for name in "ab")
    assert len(first) == 4
    assert [p.read_bytes() for p in first] == [p.read_bytes() for p in second]


def test_bode_figure_shades_the_mode_and_names_each_servo():
    figure = bode_figure(LEG_SERVOS, closed=True)
    magnitude, phase = figure.axes
    labels = [text.get_text() for text in magnitude.get_legend().get_texts()]
    assert [label.split(":")[0] for label in labels] == list(LEG_SERVOS)
    for axes in (magnitude, phase):
        (band,) = axes.patches
        assert (band.get_x(), band.get_x() + band.get_width()) == (10, 13)


def test_no_servos_are_refused(tmp_path):
    with pytest.raises(ParameterError, match="at least one"):
        write_leg_figures(tmp_path, {})
