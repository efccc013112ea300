"""The trial's generator: the same case twice; the simulator's logs where nothing is hidden."""

import ast
import json
from collections import Counter
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
import scipy

from benchmarks.trial import cases, detectability, machines, noise, nominal, scoring, write
from benchmarks.trial.imitation import imitation, most_gained, places
from benchmarks.trial.kinds import KINDS
from benchmarks.trial.motions import Quintics
from benchmarks.trial.platforms import read_platform
from benchmarks.trial.targets import can_be_told, each_case, targets
from tests.running_blocks import leg_platform
from ves_gym.diagnosis.machines.system import SystemMachine
from ves_gym.diagnosis.machines.tolerances import StatedErrors
from ves_gym.system.system import System

ROOT = Path(__file__).parents[1] / "benchmarks" / "trial"
SECRET = "tests"


def test_it_takes_nothing_from_the_library():
    for path in ROOT.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not [n for n in names if n.split(".")[0] == "ves_gym"], path.name


def test_a_set_has_its_categories_and_its_variety():
    counts = Counter(category for category, _, _ in cases.plans(SECRET))
    assert counts == {"null": 132, "outside": 72, "pair": 96, "single": 300}
    drawn = [cases.draw(SECRET, i) for i in range(200)]
    varied = {"vehicle": 6, "arm": 2, "platform": 2, "period": 3, "noise": 3}
    for name, least in varied.items():
        assert len({getattr(case, name) for case in drawn}) == least
    assert all(case.mode in KINDS[kind].modes for case in drawn for kind in case.kinds)
    assert drawn[7] == cases.draw(SECRET, 7)


def viscous_case(mode):
    """Index of a quick case: viscous friction of the PUMA."""
    return next(
        i
        for i in range(600)
        if (c := cases.draw(SECRET, i)).mode == mode
        and c.platform == "pose"
        and c.arm == "puma560"
        and c.kinds == ("joint/viscous",)
    )


def test_the_same_case_twice(tmp_path, monkeypatch):
    monkeypatch.setattr(write, "DURATION", 0.3)
    monkeypatch.setattr(write, "SIZED", (0,))
    index = viscous_case("emulated")
    labels = [write.write_case(SECRET, index, tmp_path / name) for name in "ab"]
    assert labels[0] == labels[1]
    assert labels[0]["effects"][0]["gap"] > 0
    for path in sorted((tmp_path / "a").iterdir()):
        assert path.read_bytes() == (tmp_path / "b" / path.name).read_bytes(), path.name
    assert json.loads((tmp_path / "a" / "run-4.json").read_text())["held_back"]


@pytest.mark.slow
def test_nothing_hidden_is_the_simulators_log():
    """RMS of each channel in units of noise; asked through the command line."""
    assert max(nominal.in_units_of_noise("soft", "puma560", "ideal", "pose").values()) < 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("arm", list(machines.SERVOS))
@pytest.mark.parametrize("vehicle", list(machines.VEHICLES))
def test_every_machine_is_the_simulators(vehicle, arm):
    for (mode, platform), most in zip(nominal.MODES, (1e-2, 0.1, 1.0), strict=True):
        if mode == "ideal" or vehicle in machines.EMULATED:
            units = nominal.in_units_of_noise(vehicle, arm, mode, platform)
            assert max(units.values()) < most, (mode, platform, units)


@pytest.mark.parametrize(("vehicle", "mode"), [("stiff", "ideal"), ("heavy-free", "emulated")])
def test_a_description_says_what_no_machine_has(vehicle, mode):
    """Errors that are never drawn are known: the diagnosis finds all of them in its list."""
    case = next(
        c
        for c in (cases.draw(SECRET, i) for i in range(600))
        if (c.vehicle, c.mode, c.arm) == (vehicle, mode, "puma560")
    )
    described = write.setting(SECRET, case).description
    exact = dict.fromkeys(cases.known_exactly(case), 0.0)
    every = SystemMachine(System.from_dict(described)).nuisances
    known = SystemMachine(System.from_dict(described), StatedErrors(known=exact)).nuisances
    gone = {k.name for k in every} - {k.name for k in known}
    assert {"friction of joint 3", "damping of joint 1", "zero of joint 2"} <= gone
    assert ("mass of the base" in gone) == (mode == "emulated")
    assert {"mass of link 1", "gain of joint 2"} <= {k.name for k in known}
    stated = StatedErrors(known=cases.known(case))
    sizes = {
        k.name: k.std for k in SystemMachine(System.from_dict(described), stated).nuisances
    }
    if mode == "emulated":  # drawn within 5 g; usual are 50 g
        factor = case.factor if case.stated else 1.0
        assert sizes["weight estimate"] == pytest.approx(0.005 / 3**0.5 * factor, rel=0.01)


def test_answers_are_judged():
    label = {"category": "single", "effects": [{"kind": "joint/coulomb", "slot": 2}]}

    def given(verdict, *names):
        told = [{"kind": k, "slot": s, "class": [], "probability": 0.9} for k, s in names]
        return {"verdict": verdict, "names": told}

    here, there = ("joint/coulomb", "joint 2"), ("joint/coulomb", "joint 3")
    assert scoring.judge(label, given("named", here)) == "right"
    assert scoring.judge(label, given("named", there)) == "class"
    assert scoring.judge(label, given("named", here, ("payload/mass", ""))) == "wrong"
    assert scoring.judge(label, given("nothing missing")) == "silent"
    assert scoring.judge({**label, "category": "null"}, given("nothing missing")) == "right"
    assert scoring.judge({**label, "category": "outside"}, given("named", here)) == "wrong"
    rivals = ["joint/asymmetry at joint 2", "joint/coulomb at joint 2"]
    other = {"kind": "joint/asymmetry", "slot": "joint 2"}
    for several, mark in ((rivals, "class"), (rivals[:1], "wrong"), (rivals * 2, "wrong")):
        one_of = {"verdict": "one of", "names": [{**other, "class": several}]}
        assert scoring.judge(label, one_of) == mark


def test_a_table_counts_what_is_judged():
    """Two singles, one of them taken for another, and a null that is silent."""
    label = {**asdict(cases.draw(SECRET, 0)), "category": "single", "gap": 3.0, "index": 0}
    label["effects"] = [{"kind": "joint/viscous", "slot": 1, "gap": 3.1, "size": 1.0}]
    name = {"kind": "joint/viscous", "slot": "joint 1", "probability": 0.995, "class": []}
    given = {"verdict": "named", "names": [name], "worse": [], "cpu": 20.0}
    wrong = {**given, "names": [{**name, "kind": "payload/mass", "slot": ""}]}
    null = {**label, "category": "null", "gap": 0.0, "factor": 1.0, "effects": []}
    silent = {**given, "verdict": "nothing missing", "names": []}
    every = [(label, given), (label, wrong), (null, silent)]
    rows = targets(every)
    assert "named alone, kind and place | 1 of 2 (50 %; 1 to 99 %)" in rows
    assert "false alarms | 0 of 1" in rows and "p > 0.99 that are right | 1 of 2" in rows
    assert "calibration error | 0.495 (n = 2)" in rows
    assert " | 1 | 0 | 0 | 1 | 0 | 0 | 0 |" in scoring.table(every)
    assert "joint/viscous 1 (3.1) | joint/viscous joint 1 (0.99) | right |" in each_case(every)


def on_springs(mode, arm):
    """A machine on springs, without anything hidden yet; effects go to its third joint."""
    return replace(
        cases.draw(SECRET, 0),
        mode=mode,
        vehicle="stiff",
        arm=arm,
        platform="pose",
        period=0.01,
        kinds=(),
        slots=(2,),
        signs=(1.0,),
        shapes=(0.3,),
        feedforward=False,
    )


@pytest.mark.parametrize("mode", ["ideal", pytest.param("emulated", marks=pytest.mark.slow)])
def test_every_kind_changes_what_is_measured(mode, monkeypatch):
    monkeypatch.setattr(write, "DURATION", 0.2)
    case = on_springs(mode, "puma560")
    moved = Quintics(np.array([[0.3, 0.3, 0.3], [0.6, 0.5, 0.5]]), np.array([[0.0, 0.5]]))
    at = write.setting(SECRET, case)
    at.motions = [moved] * cases.RUNS
    healthy = write.play(at, at.plant, 0)
    unseen = []
    for kind in KINDS.values():
        if mode in kind.modes:
            plant = at.plant.copy()
            plant.peaks = np.abs(healthy.tau).max(0)
            size = 20 * kind.start if kind.name != "joint/torque_limit" else 1.0
            write.add_effect(plant, replace(case, kinds=(kind.name,)), 0, min(size, kind.most))
            gaps = write.gap(case, write.play(at, plant, 0), healthy)
            if not max(gaps.values()) > 1e-4:
                unseen.append((kind.name, gaps))
    assert not unseen


@pytest.mark.slow
def test_legs_off_their_gains_are_the_librarys():
    """Two independent sets of six legs, with gains other than stated."""
    described = machines.description(
        "stiff", "puma560", "emulated", "legs", machines.PERIODS[0]
    )
    settings = System.from_dict(described).emulator_settings
    dt, h = described["control_dt"], described["physics_dt"]
    mine = leg_platform(settings.platform, settings.stewart, 1, dt, h)
    mine.p = {"gain": np.array([1.2]), "brake": np.array([0.7])}
    theirs = read_platform(described["emulator"], h, round(dt / h), 1.2, 0.7)
    theirs.start(np.zeros(6))
    stated = read_platform(described["emulator"], h, round(dt / h), 1.0, 1.0)
    stated.start(np.zeros(6))
    apart, moved = [], []
    for k in range(60):
        y = 0.02 * np.sin(0.15 * k * np.arange(1.0, 7.0)) * [1, 1, 1, 0.5, 0.5, 0.5]
        theirs.follow(y, np.zeros(6))
        stated.follow(y, np.zeros(6))
        mine.advance(y[None])
        apart.append(mine.measured()[0] - theirs.measured())
        moved.append(stated.measured() - theirs.measured())
    assert np.abs(apart).max() < 0.02 * np.abs(moved).max()  # modes that bend with the leg
    assert np.abs(moved).max() > 1e-3


def test_the_best_reader_weighs_tolerances_as_a_covariance():
    """Reference: s' (1 + J J')^-1 s, the distance under Gaussian tolerances and noise."""
    rng = np.random.default_rng(4)
    J, s = rng.normal(size=(40, 6)) * 3, rng.normal(size=40)
    expected = s @ np.linalg.solve(np.eye(40) + J @ J.T, s)
    assert detectability.beside(s, J) == pytest.approx(expected, rel=1e-12)
    assert detectability.beside(J[:, 2], J) < 1  # an effect that is a tolerance


def test_the_best_reader_takes_large_errors_for_what_they_do():
    """Five standard deviations of a curved tolerance cost 25; straight ones leave more."""
    rng = np.random.default_rng(5)
    J, bend = rng.normal(size=(400, 6)) * 30, rng.normal(size=400)

    def changed(x):
        return J @ x + bend * x[2] ** 2 * 3

    s = changed(5 * np.eye(6)[2])
    assert detectability.beside(s, J) > 1000
    assert 20 < detectability.beside(s, J, changed) < 25.001


IMITATED = (
    "base/virtual_mass", "base/damping", "base/stiffness", "payload/com", "joint/drive_gain",
    "sensor/bias", "sensor/calibration", "sensor/lag", "gravity/mass", "platform/bandwidth",
    "platform/damping",
)  # fmt: skip
QUICK = ("base/stiffness", "joint/drive_gain", "gravity/mass", "platform/bandwidth")


@pytest.mark.parametrize(
    ("mode", "kind"),
    [
        pytest.param(
            "ideal" if k.startswith("base/") else "emulated",
            k,
            marks=[pytest.mark.slow] * (k not in QUICK),
        )
        for k in IMITATED
    ],
)
def test_tolerances_that_imitate_an_effect_do_the_same(mode, kind, monkeypatch):
    """So no reader gains more than |x|^2 by the truth (`benchmarks/trial/imitation.py`)."""
    monkeypatch.setattr(write, "DURATION", 0.15)
    monkeypatch.setattr(detectability, "FITTED", 1)
    drawn = (cases.draw(SECRET, k) for k in range(600))
    case = next(c for c in drawn if c.mode == mode and kind in c.kinds)
    which, size = case.kinds.index(kind), KINDS[kind].start
    x = imitation(case, which, size)
    assert x is not None and x.any()
    at = write.setting(SECRET, case)
    assert len(x) == places(at.plant.joints)["end"]
    at = detectability.off_by(at, np.zeros(len(x)))
    plant = at.plant.copy()
    write.add_effect(plant, case, which, size)
    hidden = write.play(at, plant, 0)
    off = detectability.off_by(at, x)
    imitating = write.play(off, off.plant, 0)
    plain = write.play(at, at.plant, 0)
    change = 0.0
    for name in ("q", "tau", "y", "w"):
        a, b, c = (getattr(run, name) for run in (hidden, imitating, plain))
        assert np.abs(a - b).max() <= 1e-9 * np.abs(c).max()
        change = max(change, float(np.abs(a - c).max()))
    assert change > 1e-7
    assert most_gained(case, which, size) == pytest.approx(x @ x)


def test_what_tolerances_imitate_is_told_apart_from_what_they_do_not():
    index = next(k for k in range(600) if cases.draw(SECRET, k).kinds == ("gravity/mass",))
    case = cases.draw(SECRET, index)
    std = case.factor * 0.005 / 3**0.5
    for share, told in ((5.0, False), (7.0, True)):  # 25 and 49 of deviance
        effect = {"kind": "gravity/mass", "size": share * std}
        assert can_be_told({**asdict(case), "effects": [effect]}) == told
    index = next(k for k in range(600) if cases.draw(SECRET, k).kinds == ("joint/viscous",))
    effect = {"kind": "joint/viscous", "size": 1e-6}
    assert can_be_told({**asdict(cases.draw(SECRET, index)), "effects": [effect]})


def test_slow_noise_is_white_for_the_best_reader():
    """Drawn by the generator's recursion, whitened by its covariance: 3 standard errors."""
    drawn = noise.draw("slow", np.ones(300), 800, 5e-3, np.random.default_rng(6))
    white = detectability.whitened("slow", drawn, 5e-3)
    spectrum = np.square(np.abs(np.fft.rfft(white, axis=0, norm="ortho")))
    for part in (spectrum[:4], spectrum[4:20], spectrum[20:]):
        assert abs(part.mean() - 1) < 3 / np.sqrt(part.size)
    assert np.square(np.abs(np.fft.rfft(drawn, axis=0, norm="ortho")))[1:4].mean() > 5


def test_heavy_noise_tells_as_much_as_its_fisher_information():
    """Reference: the score of Student's t, integrated by SciPy."""
    n, std = 5, np.sqrt(5 / 3)

    def score(x):
        return float(((n + 1) * x / (n + x**2)) ** 2 * scipy.stats.t.pdf(x, n))

    information = std**2 * scipy.integrate.quad(score, -np.inf, np.inf)[0]
    assert information == pytest.approx(detectability.HEAVY, rel=1e-9)


def test_a_platform_that_is_sent_its_own_commands_goes_where_it_went(monkeypatch):
    monkeypatch.setattr(write, "DURATION", 0.3)
    at = write.setting(SECRET, cases.draw(SECRET, viscous_case("emulated")))
    plain = write.play(at, at.plant, 0)
    assert plain.y_cmd is not None and np.abs(plain.y_cmd).max() > 1e-6
    again = write.play(at, at.plant, 0, led=plain)
    for name in ("q", "tau", "y", "y_cmd", "w", "wg"):
        assert np.array_equal(getattr(again, name), getattr(plain, name)), name
    off = at.plant.copy()
    off.signals.sensor_bias = off.signals.sensor_bias + np.array([5.0, 0, 0, 0, 0, 0])
    led = write.play(at, off, 0, led=plain)
    assert np.array_equal(led.y, plain.y) and np.array_equal(led.tau, plain.tau)
    assert not np.array_equal(write.play(at, off, 0).y, plain.y)


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["ideal", "emulated"])
def test_the_best_reader_sees_less_beside_tolerances(mode, monkeypatch):
    monkeypatch.setattr(write, "DURATION", 0.3)
    monkeypatch.setattr(detectability, "FITTED", 1)
    index = viscous_case(mode)
    effect = {"kind": "joint/viscous", "size": 20.0}
    (row,) = detectability.detectability(SECRET, {"index": index, "effects": [effect]})
    assert 0 < row.tolerances < row.noise
    # four bodies of mass, centre (3), inertia; rotors; of the base in space M, D, K; gains of
    # drives, servo and sensor, zeros; filter, bandwidth and damping; weight that is taken off
    assert row.unknown == 4 * 5 + 3 + 3 + 3 + 12 + 3 + 1 + 6
