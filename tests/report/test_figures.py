"""The figures are written for what a result holds, and show something."""

import sys

import numpy as np
import pytest

from ves_gym._util.params import ParameterError
from ves_gym.report.figures import (
    anytime_figure,
    benchmark_figures,
    pareto_figure,
    time_figure,
    write_figures,
)

ALL = ["ratio.png", "energy.png", "coupling.png", "prediction.png"]


def write(result, folder, form="png"):
    figures = benchmark_figures(result)
    return write_figures({folder / name: figures[name] for name in figures}, form)


def written(result, folder):
    return [path.name for path in write(result, folder)]


def test_four_figures_with_something_on_them(tmp_path, make_result):
    from PIL import Image

    paths = write(make_result(durations=(1.0, 2.0), points=21), tmp_path)
    assert [path.name for path in paths] == ALL
    for path in paths:
        pixels = np.asarray(Image.open(path).convert("RGB"))
        assert min(pixels.shape[:2]) > 400
        colours = pixels @ [1, 256, 256**2]  # each as one number
        assert len(np.unique(colours)) > 50  # lines, text, areas


@pytest.mark.parametrize(("form", "start"), [("svg", b"<?xml"), ("pdf", b"%PDF")])
def test_a_paper_gets_lines_instead_of_pixels(tmp_path, make_result, form, start):
    result = make_result(queries=1, points=9)
    paths = write(result, tmp_path, form)
    assert [p.name for p in paths] == [name.replace("png", form) for name in ALL]
    assert all(p.read_bytes().startswith(start) for p in paths)
    (second,) = write_figures({tmp_path / "second": time_figure(result, "E")}, form)
    assert second.read_bytes() == paths[1].read_bytes()


def test_weights_add_a_figure(tmp_path, make_result):
    """Energy against two accelerations: a line through the weights, a point per planner."""
    result = make_result(queries=2, durations=(1.0,), points=9)
    for k, row in enumerate(result["summary"]):
        row |= {"acceleration_ratio_median": 1.0 + k, "acceleration_peak_ratio_median": 2.0 + k}
    some = result["summary"][0]
    for weight in (0.3, 0.03):
        name = f"{some['planner']}:tip={weight}"
        result["planners"].append({"name": name, "summary": ""})
        result["summary"].append({**some, "planner": name, "ratio_median": weight})
    assert written(result, tmp_path) == [*ALL, "pareto.png"]
    for axes in pareto_figure(result).axes:
        (joined,) = [line for line in axes.lines if len(line.get_xdata()) == 3]
        assert list(joined.get_xdata()) == [some["ratio_median"], 0.03, 0.3]
        assert {text.get_text() for text in axes.texts} == {"0.03", "0.3"}
        labels = {line.get_label() for line in axes.lines}
        assert labels >= {p["name"] for p in result["planners"][:4]}


def test_searches_add_a_figure(tmp_path, make_result):
    """A panel per case, a line per search in its planner's colour, and the 5 % line."""
    result = make_result(queries=2, durations=(1.0,), points=9)
    curve = {
        "vehicle": "bent-thesis",
        "n": 2,
        "seconds": [0.1, 0.5, 1.0],
        "ratio": [1.3, 1.02, 1.0],
    }
    result["anytime"] = [
        {**curve, "duration": d, "planner": name}
        for d in (1.0, 2.0)
        for name in ("hotspot-q", "direct")
    ]
    assert written(result, tmp_path) == [*ALL, "anytime.png"]
    panels = anytime_figure(result).axes
    assert [len(axes.lines) for axes in panels] == [3, 3]
    colours = [drawn.get_color() for drawn in panels[0].lines[:2]]
    assert colours == ["#c8541a", "#0a7bb5"]  # those of these planners elsewhere


def test_mode_emulated_adds_base_motion_and_strain_energy(tmp_path, make_emulated):
    """Also where every straight line was stopped: no ratio, and traces that end early."""
    names = written(make_emulated(queries=2, durations=(1.0, 2.0), points=9), tmp_path)
    assert names == [*ALL, "base_motion_emulated.png", "strain_energy_emulated.png"]


def test_a_stopped_run_and_the_run_in_space_are_drawn(make_emulated):
    """Two lines per run, and a cross for the stop."""
    result = make_emulated(planners=4, queries=1, durations=(2.0,), points=9)
    lines = time_figure(result, "distance").axes[0].lines
    assert len(lines) == 4 * 2 + 1
    (cross,) = [curve for curve in lines if curve.get_marker() == "x"]
    first = result["traces"][0]["series"][0]
    assert cross.get_xdata() == [first["t"][-1]]
    assert cross.get_ydata() == [pytest.approx(1e3 * first["distance"][-1])]  # mm


def test_figures_are_reproducible(tmp_path, make_result):
    result = make_result(queries=3, durations=(1.0,), points=9)
    first = [path.read_bytes() for path in write(result, tmp_path / "a")]
    repeated = [path.read_bytes() for path in write(result, tmp_path / "b")]
    assert first == repeated


@pytest.mark.parametrize(
    ("change", "names"),
    [
        ({"maps": []}, ["ratio.png", "energy.png", "prediction.png"]),
        ({"traces": [], "maps": []}, ["ratio.png", "prediction.png"]),
        ({"rows": [], "summary": [], "traces": [], "maps": []}, []),
    ],
)
def test_only_what_there_is_data_for(tmp_path, make_result, change, names):
    result = {**make_result(planners=1, queries=1, durations=(2.0,), points=9), **change}
    assert written(result, tmp_path) == names


def test_a_motion_without_energy_or_prediction_is_left_out(tmp_path, make_result):
    result = make_result(queries=1, durations=(2.0,), points=9)
    for row in result["rows"]:
        row.update(E_mean=0.0, predicted=None, prediction_error=None)
    assert written(result, tmp_path) == ALL


def test_a_map_without_lines_or_ends_is_drawn(tmp_path, make_result):
    result = make_result(queries=1, durations=(2.0,), points=9)
    for section in result["maps"]:
        section.update(lines=[], paths=[])
        del section["start"], section["goal"]
    assert "coupling.png" in written(result, tmp_path)


def test_without_matplotlib_the_extra_is_named(tmp_path, make_result, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(ParameterError, match=r"ves-gym\[report\]"):
        benchmark_figures(make_result(queries=1, points=9))
