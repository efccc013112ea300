"""The front door: its names, its verbs beside the commands, and what results show."""

import contextlib
import dataclasses
import doctest
import inspect
import json
import re
import sys
from pathlib import Path

import matplotlib
import numpy as np
import pytest

import ves_gym as vg
from tests.display import require_opengl
from ves_gym import api
from ves_gym.cli.main import main

matplotlib.use("Agg")
import matplotlib.pyplot as plt

DEGREES = "20,10,-5"
GOAL = np.deg2rad([20, 10, -5]).tolist()


@pytest.fixture(scope="module")
def plan():
    return vg.plan([0, 0, 0], GOAL, duration=1.0, planner="direct")


@pytest.fixture(scope="module")
def log(plan):
    return vg.simulate(plan)


@pytest.fixture(scope="module")
def comparison(plan):
    return vg.compare(plan.query, ["straight", "direct"])


@pytest.fixture(autouse=True)
def no_window():
    yield
    plt.close("all")


def command(tmp_path, *words):
    """What a command writes as JSON."""
    file = tmp_path / "result.json"
    status = main([*words, "--json", str(file), "--out", str(tmp_path)])
    assert status == 0
    return json.loads(file.read_text())


# ----------------------------------------------------------- the same as the commands


def test_plan_and_energy_are_those_of_the_command(tmp_path, plan, comparison):
    words = ("plan", f"--goal={DEGREES}", "--duration", "1", "--planner", "direct")
    result = command(tmp_path, *words)
    assert result["predicted"] == plan.predicted.to_dict()
    assert result["simulated"] == comparison["direct"].simulated.to_dict()
    assert result["straight"] == comparison.straight.to_dict()
    case = vg.load_case(tmp_path / "case.toml")
    assert (case.query, case.motion) == (plan.query, plan.motion)


def test_simulate_is_that_of_the_command(tmp_path, plan, log):
    plan.case.save(tmp_path / "case.toml")
    result = command(tmp_path, "simulate", "--case", str(tmp_path / "case.toml"))
    there = vg.RunLog.load(result["log"])
    assert there.digest == result["digest"]
    for name in ("t", "q", "v", "tau", "y", "yd", "w"):
        assert np.array_equal(getattr(there, name), getattr(log, name)), name
    assert result["energies"] == vg.energy(log).to_dict()
    assert result["ledger_residual"] == vg.EnergyBalance.of(log).relative


def test_map_is_that_of_the_command(tmp_path):
    result = command(tmp_path, "map", "--joints", "1,2", "--at", "0,0,-30", "--points", "9")
    section = vg.coupling_map(q3=np.deg2rad(-30.0), points=9)
    assert result["maps"][0]["most"] == section.most.tolist()


def test_emulation_check_is_that_of_the_command(tmp_path):
    result = command(tmp_path, "emulation-check", "--no-search", "--no-figures")
    check = vg.check_emulation(search=False)
    assert result["spectral_radius"] == check.spectral_radius
    assert "stable" in repr(check)


def test_evaluate_is_that_of_the_command(tmp_path):
    id = "ves/BeamLQR-v0"
    words = ("evaluate", id, "--controller", "zero,lqr", "--episodes", "3")
    result = command(tmp_path, *words)
    ours = vg.evaluate(id, ["zero", "lqr"], episodes=3)
    for mine, theirs in zip(ours.to_dict()["controllers"], result["controllers"], strict=True):
        assert mine["rows"] == theirs["rows"]
    assert ours.best.name == "lqr"
    assert ours.ratio("lqr", "zero").value == result["ratios"]["lqr"]["E_mean"]["value"]


# --------------------------------------------------------- hide, name, better, picture


FIRST_HOUR = Path(__file__).parents[1] / "docs" / "site" / "first-hour" / "logs.md"


def first_diagnosis():
    """The lines that hide a friction and name it; no other test runs them."""
    text = FIRST_HOUR.read_text("utf-8")
    snippets = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    (snippet,) = [s for s in snippets if "vg.diagnose(" in s]
    return snippet


@pytest.fixture(scope="module")
def diagnosis(tmp_path_factory):
    names = {}
    with contextlib.chdir(tmp_path_factory.mktemp("first_hour")):
        exec(first_diagnosis(), names)
        plt.close("all")  # the page's figure, which a test would take for one of its own
        assert Path("found.png").is_file()
        assert vg.System.load("better.toml") == names["found"].system
    return names["found"]


@pytest.mark.slow
def test_a_hidden_friction_is_named_and_added(diagnosis):
    assert diagnosis.verdict == "named"
    assert diagnosis.sentence.startswith("Missing: joint/coulomb at joint 3 (torque ")
    (effect,) = diagnosis.system.effects
    assert effect.torque == pytest.approx((0, 0, 3), abs=0.1)
    assert repr(diagnosis) == f"<Diagnosis: {diagnosis.sentence}>"


def test_excitation_keeps_inside_the_limits():
    from ves_gym.mechanics.limits import limit_ratios

    motions = vg.excitation(3)
    assert motions == vg.excitation(3) and motions != vg.excitation(3, seed=1)
    for motion in motions:
        ratios = limit_ratios(vg.PUMA_560, motion, samples=2001)
        assert max(r.max() for r in ratios.values()) <= 0.91
        s = motion.at(np.linspace(0, motion.duration, 2001))
        turns = (np.diff(np.sign(s.v[np.abs(s.v).max(axis=1) > 0.02]), axis=0) != 0).sum(axis=0)
        assert (turns >= 2).all()  # every joint reverses
        assert (np.ptp(s.q, axis=0) > 0.2).all()


# ------------------------------------------------------------------- results look good


RESULTS = {  # what is shown, made of the fixture of that name or of a log
    **dict.fromkeys(("plan", "log", "comparison", "diagnosis")),
    "map": lambda log: vg.coupling_map(q3=-0.1, points=9),
    "balance": vg.EnergyBalance.of,
    "check": lambda log: vg.check_emulation(search=False),
    "evaluation": lambda log: vg.evaluate("ves/BeamLQR-v0", ["zero", "lqr"], episodes=3),
}


@pytest.mark.parametrize(
    "name",
    [pytest.param(k, marks=[pytest.mark.slow] * (k == "diagnosis")) for k in RESULTS],
)
def test_a_result_is_one_line_a_page_and_axes(request, log, name):
    make = RESULTS[name]
    result = request.getfixturevalue(name) if make is None else make(log)
    assert "\n" not in repr(result) and len(repr(result)) < 200
    page = result._repr_html_()
    assert page.startswith("<div>") and "<script" not in page and "data:image/png" in page
    assert not plt.get_fignums()  # the page leaves no figure behind
    axes = plt.subplots()[1]
    assert result.plot(axes) is axes
    assert axes.has_data()
    with pytest.raises(vg.ParameterError, match="ax must be one axes"):
        result.plot(plt.subplots(1, 4)[1])


def test_without_matplotlib_the_extra_is_named_and_a_notebook_has_the_table(plan, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(vg.ParameterError, match=r"ves-gym\[report\]"):
        plan.plot()
    page = plan._repr_html_()
    assert "predicted" in page and "<img" not in page


def test_a_notebook_shows_hostile_names_as_text(comparison, log):
    assert len(log.plot()) == 3
    row = dataclasses.replace(comparison.rows[0], planner="<script>alert(1)</script>")
    bad = dataclasses.replace(comparison, rows=(row,))
    assert "<script" not in bad._repr_html_()


def test_paths_keep_their_planners_colours(comparison):
    from ves_gym.report.planner_styles import colour_of

    axes = vg.coupling_map(q3=-0.1, points=9).plot(paths=comparison.plans)
    drawn = {line.get_label(): line.get_color() for line in axes.lines}
    curves = {
        line.get_label().split(" ")[0]: line.get_color() for line in comparison.plot().lines
    }
    for name in ("straight", "direct"):
        assert drawn[name] == curves[name] == colour_of(name)


def test_results_are_saved_and_a_case_read(tmp_path, plan, comparison):
    plan.case.save(tmp_path / "case.toml")
    assert vg.load_case(tmp_path / "case.toml") == plan.case
    comparison.save(tmp_path / "comparison.json")
    assert json.loads((tmp_path / "comparison.json").read_text("utf-8")) == comparison.to_dict()


# --------------------------------------------------------------------------- bad input


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: vg.plan([0, 0], GOAL), r"start.*\(3,\).*\(2,\)"),
        (lambda: vg.plan([0, 0, 0], [9, 0, 0]), "goal"),
        (lambda: vg.plan([0, 0, 0], GOAL, planner="dircet"), 'did you mean "direct"'),
        (lambda: vg.plan([0, 0, 0], GOAL, duration=-1.0), "duration must be > 0"),
        (lambda: vg.plan([0, 0, 0], GOAL, system="bent"), "must be System or None, got 'bent'"),
        (lambda: vg.plan([0, 0, 0]), "plan needs a goal"),
        (lambda: vg.simulate([1, 2]), "motion must be Motion or Plan or Case"),
        (lambda: vg.compare("direct"), "query must be Query or Plan, got 'direct'"),
        (lambda: vg.coupling_map(q4=0.0), "q1, q2, q3, got 'q4'"),
        (lambda: vg.coupling_map(q1=0.0, q2=0.0), "sweeps two joints"),
        (lambda: vg.coupling_map(joints=(1, 1)), "two different numbers from 1 to 3"),
        (lambda: vg.diagnose([]), "at least one run log"),
        (lambda: vg.diagnose([3]), "needs run logs or their files, got 3"),
        (lambda: vg.excitation(0), "n must be a whole number >= 1, got 0"),
        (lambda: vg.excitation(1, duration=1.0), "duration must be from 2 to 600 s"),
        (lambda: vg.evaluate("ves/BeamLQR-v0", ["lqrr"]), 'did you mean "lqr"'),
        (lambda: vg.evaluate("ves/No-v0", ["zero"]), "known: ves/BeamLQR-v0"),
        (lambda: vg.energy("run.csv"), "log must be RunLog"),
        (lambda: vg.train("ves/No-v0"), "known: ves/BeamLQR-v0"),
        (lambda: vg.register_planner(object()), "a planner needs name"),
        (lambda: vg.load_policy("policy.zip"), "a policy is a .json file"),
    ],
)
def test_bad_input_says_what_was_expected(call, message):
    with pytest.raises(vg.ParameterError, match=message):
        call()


VERBS = {  # with the arguments that they need
    "simulate": ("plan",),
    "plan": (),
    "compare": ("plan",),
    "coupling_map": (),
    "diagnose": ("log",),
    "excitation": (),
    "energy": ("log",),
    "calibrate": ("log",),
    "check_emulation": (),
    "render": ("log",),
}


@pytest.mark.parametrize("verb", VERBS)
@pytest.mark.parametrize(
    "wrong", [object(), float("nan"), {"a": 1}], ids=["object", "nan", "dict"]
)
def test_no_argument_of_a_foreign_kind_passes(verb, wrong, plan, log):
    """Nor does it end in an error that does not name what was expected."""
    function = getattr(vg, verb)
    taken = inspect.signature(function).parameters
    needed = dict(
        zip(taken, [{"plan": plan, "log": log}[k] for k in VERBS[verb]], strict=False)
    )
    if verb == "plan":
        needed |= {"start": [0, 0, 0], "goal": GOAL, "duration": 1.0}
    for name, parameter in taken.items():
        a_table = "Mapping" in parameter.annotation and isinstance(wrong, dict)
        if parameter.kind is not parameter.VAR_KEYWORD and not a_table:
            with pytest.raises(vg.ParameterError, match=name):
                function(**{**needed, name: wrong})


def test_a_plan_without_a_motion_is_not_simulated(plan):
    class Stuck:
        name, summary = "stuck", "finds nothing"

        def find(self, query, seed):
            raise vg.NoPlan("no motion: stuck")

    blocked = vg.plan([0, 0, 0], GOAL, duration=1.0, planner=Stuck())
    assert blocked.found is None and blocked.query == plan.query
    assert "no motion" in repr(blocked) and "<img" not in blocked._repr_html_()
    with pytest.raises(vg.NoPlan, match="stuck found no motion"):
        vg.simulate(blocked)


def test_a_planner_of_one_s_own_has_a_name_everywhere(plan):
    from ves_gym.planners.registry import PLANNERS

    class Own:
        name, summary = "own", "the straight line"

        def find(self, query, seed):
            return query.straight, {}

    try:
        assert vg.register_planner(Own) is Own
        answer = vg.plan([0, 0, 0], GOAL, duration=1.0, planner="own")
        assert answer.motion == plan.query.straight
        with pytest.raises(vg.ParameterError, match="'own' is already registered by Own"):
            vg.register_planner(Own())
    finally:
        PLANNERS.pop("own", None)


def test_a_released_policy_is_loaded_by_name():
    pytest.importorskip("safetensors")
    assert vg.load_policy("BeamLQR/ppo").network.sizes[-1] == 3


EXAMPLES = ("simulate", "plan", "compare", "coupling_map", "excitation", "evaluate", "train",
            "energy", "calibrate", "check_emulation", "render", "export")  # fmt: skip


@pytest.mark.parametrize(
    "name",
    [pytest.param(k, marks=[pytest.mark.slow] * (k == "train")) for k in EXAMPLES],
)
def test_the_example_of_a_verb_runs(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    if name == "export":
        pytest.importorskip("rosbags")
    if name == "render":
        require_opengl()
    (example,) = doctest.DocTestFinder(recurse=False).find(
        inspect.unwrap(getattr(vg, name)), name, globs={"vg": vg}
    )
    assert example.examples
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS)
    assert runner.run(example).failed == 0


def test_every_verb_has_an_example():
    """But `diagnose`, which takes minutes: tests here run that of its page."""
    verbs = {k for k in vg.__all__ if inspect.isfunction(getattr(api, k, None))}
    assert verbs - {"diagnose"} == set(EXAMPLES)


# ------------------------------------------------------------------------------ pages


def test_the_page_of_names_is_up_to_date():
    """Else: `python scripts/api.py`."""
    from scripts import api

    assert api.PAGE.read_text("utf-8") == api.page()
    listed = " ".join(api.GROUPS.values()).split()
    assert sorted(listed) == sorted(vg.__all__)


def test_the_readme_names_a_friction_in_twelve_lines_and_one_import():
    snippet = first_diagnosis()
    lines = [line for line in snippet.splitlines() if line.strip()]
    assert len(lines) <= 12
    assert [line for line in lines if "import" in line] == ["import ves_gym as vg"]
    for word in ("JointCoulomb", "found.sentence", "found.system", "found.plot()"):
        assert word in snippet


@pytest.mark.slow
def test_a_training_gives_policies_curves_and_a_picture(tmp_path):
    """Two updates of PPO: the policy is on disk, acts, and the curve can be drawn."""
    result = vg.train("ves/BeamLQR-v0", steps=4096, seeds=[0], folder=tmp_path / "run")
    assert repr(result).startswith("<TrainingResult: ")
    best = sorted((tmp_path / "run").rglob("best.json"))
    assert len(best) == 1
    scored = vg.evaluate("ves/BeamLQR-v0", [vg.load_policy(best[0])], episodes=2)
    assert np.isfinite(scored.to_dict()["controllers"][0]["summary"]["return"]["iqm"]["value"])
    assert np.ravel(result.plot())[0].get_figure() is not None


def test_a_run_is_drawn(tmp_path):
    require_opengl()
    plan = vg.plan([0, 0, 0], [0.3, 0.2, -0.2], duration=1.0, planner="straight")
    log = vg.simulate(plan.motion, settle=0.2, record_dt=0.02)
    path = vg.render(log, tmp_path / "run.gif", width=160, height=120, fps=10)
    assert path == tmp_path / "run.gif" and path.read_bytes()[:6] == b"GIF89a"
