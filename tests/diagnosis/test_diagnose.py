"""From logs with something hidden to its name and a report, on machines of another generator.

Whole diagnoses of such machines are in tests/golden/test_diagnoses.py; here what is shown of
one is held against full fits and against what is known.
"""

import dataclasses
from dataclasses import replace

import numpy as np
import pytest

from tests.diagnosis.conftest import MOVES, SINES
from tests.diagnosis.logs import told
from ves_gym._util.params import ParameterError
from ves_gym.diagnosis import diagnose as d
from ves_gym.diagnosis.data.measured_run import run_of
from ves_gym.diagnosis.data.sanity_checks import require_plausible
from ves_gym.diagnosis.inference.candidates import library, without
from ves_gym.diagnosis.inference.explanations import classes, ranked
from ves_gym.diagnosis.inference.fit import fit
from ves_gym.diagnosis.inference.held_back import group_squares, likeliness
from ves_gym.diagnosis.inference.whitened_residuals import WhitenedResiduals
from ves_gym.diagnosis.machines.system import SystemMachine
from ves_gym.effects import JointElasticity
from ves_gym.report.diagnosis_figures import overlays
from ves_gym.system.system import System

KINDS = ("joint/coulomb", "joint/viscous", "joint/drive_gain", "joint/torque_offset")


@pytest.fixture(scope="module")
def plain(hidden):
    """Logs of a machine that is as described."""
    return hidden(seed=1, runs=(SINES, MOVES))


def test_a_gear_that_is_not_there_damps_no_noise(plain):
    machine = SystemMachine(System.from_dict(plain[0].meta["system"]))
    runs = [run_of(log, f"run-{i}") for i, log in enumerate(plain)]
    residuals = WhitenedResiduals(machine, runs)
    soft = JointElasticity(compliance=(0.0, 2e-5, 0.0), damping=(0.0, 30.0, 0.0))
    highest = ("joint", 1, runs[0].band)  # of the ranges of frequency
    groups = [(g.port, g.channel, g.high) for g in residuals.groups]
    group = residuals.groups[groups.index(highest)]
    moved = residuals.under([machine.model([soft])], ["joint", "wrench"])[0]
    plain = np.mean(residuals.null[group.part] ** 2)
    assert np.mean(moved[group.part] ** 2) > 0.95 * plain
    _, squares, noise = group_squares(residuals, moved)
    at = groups.index(highest)
    assert squares[at] / noise[at] > 0.95 * plain
    assert likeliness(residuals, moved) > likeliness(residuals, residuals.null)


def test_a_log_without_torques_says_what_it_cannot_tell(plain):
    bare = []
    for log in plain:
        meta = {k: v for k, v in log.meta.items() if k != "controller"}
        bare.append(dataclasses.replace(log, tau=None, meta=meta))
    found = told(None, bare, lambda c: c.kind in KINDS)
    assert found.untestable == {"joint": ("tau",), "servo": ("tau", "controller")}


def test_numbers_in_another_unit_are_asked_about(plain):
    log = plain[0]
    system = System.from_dict(log.meta["system"])
    with pytest.raises(ParameterError, match=r"run: q reaches .*is it in degrees\?"):
        require_plausible(dataclasses.replace(log, q=np.rad2deg(log.q)), system, "run")
    with pytest.raises(ParameterError, match=r"y reaches .*millimetres"):
        require_plausible(dataclasses.replace(log, y=1e5 * log.y), system, "run")
    cut = np.r_[0:500, 600 : len(log)]
    parts = {k: getattr(log, k)[cut] for k in ("t", "q", "q_cmd", "v_cmd", "y")}
    gappy = dataclasses.replace(
        log, **parts, v=None, tau=None, w=None, wg=None, y_cmd=None, yd=None
    )
    with pytest.raises(ParameterError, match=r"row 501: .* cut the log at the gap"):
        require_plausible(gappy, system, "run")


def test_a_library_that_lacks_the_kind_to_leave_out_says_so():
    with pytest.raises(ParameterError, match="no candidate 'joint/magic'"):
        without(library(3, ["joint"], "ideal"), ["joint/magic"])


REPORTED = (
    "joint/coulomb",
    "joint/viscous",
    "joint/stribeck",
    "joint/drive_gain",
    "sensor/lag",
)


@pytest.fixture(scope="module")
def found(hidden):
    """A drive whose gain is 10 % off; everything in the library counts as a rival."""
    logs = hidden(("joint/drive_gain", 1, 0.1), seed=2)
    system = System.from_dict(logs[0].meta["system"])
    machine = SystemMachine(system)
    runs = [run_of(log, f"run-{i}") for i, log in enumerate(logs)]
    ports = [p.name for p in machine.ports]
    every = library(system.arm.n, ports, system.mode, system=system)
    some = [c for c in every if c.kind in REPORTED]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(d, "ALIKE", np.inf)
        yield d.diagnose(machine, runs[:-1], runs[-1:], candidates=some)


def test_a_gain_is_named_and_the_gap_shrinks(found):
    names = [(f.candidate.kind, f.candidate.slot) for f in found.explanations]
    assert names == [("joint/drive_gain", "joint 2")]
    assert found.explanations[0].values[0] == pytest.approx(0.1, rel=0.1)
    before, after = (
        np.array([getattr(g, side) for g in found.final]) for side in ("before", "after")
    )
    worst = before.argmax()
    assert found.final[worst].port == "joint" and found.final[worst].channel == "tau_2"
    assert after[worst] ** 2 - 1 < 0.1 * (before[worst] ** 2 - 1)
    assert (after <= 1.02 * np.maximum(before, 1)).all()  # no other channel is worse
    better = found.residuals.machine.model(found.effects).system
    assert System.from_dict(better.to_dict()) == better


def test_the_best_candidate_is_ranked_as_a_full_fit_has_it(found):
    """Reference: the non-linear fit; its residual is linear in a gain to 3 % of the gain."""
    best = ranked(found.signatures, found.selection.null, found.selection.law)[0]
    assert best.candidate.name == "joint/drive_gain at joint 2"
    full = fit(found.residuals, [best.candidate], [best.values])
    assert best.values == pytest.approx(full.values[0], rel=0.05)
    best_gain = found.selection.null.deviance - full.deviance
    assert [best.screen, best.gain] == pytest.approx([best_gain] * 2, rel=0.05)
    assert best.gain <= best_gain + 0.1  # what a fit ends its rounds at
    assert 0 < best.error < best.gain
    assert best.chance < 1e-6


def test_what_is_chosen_but_scores_too_low_alone_is_fitted_alone(found, monkeypatch):
    """Effects that only show beside others have no score of their own."""
    scores, name = found.signatures.scores, "joint/drive_gain at joint 2"

    def low(*args):
        return [
            replace(s, deviance=np.inf)
            if found.signatures.candidates[s.candidate].name == name
            else s
            for s in scores(*args)
        ]

    monkeypatch.setattr(found.signatures, "scores", low)
    last = ranked(found.signatures, found.selection.null, found.selection.law, [name])[-1]
    assert (last.candidate.name, last.screen) == (name, None)
    assert last.values[0] == pytest.approx(0.1, rel=0.1) and last.gain > 100


def test_rivals_come_with_an_experiment_and_the_map_with_every_group(found):
    told = found.to_dict()
    assert {g["port"] for g in told["where"]} == {p.name for p in found.residuals.ports}
    worst = max(told["where"], key=lambda g: g["before"])
    assert (worst["port"], worst["channel"]) == ("joint", "tau_2")
    assert worst["after"] < 2 < worst["before"]
    chosen = [r["name"] for r in told["ranking"] if r["chosen"]]
    assert chosen == ["joint/drive_gain at joint 2"]
    assert told["experiments"]
    for e in told["experiments"]:
        assert e["between"][0] == chosen[0]
        best = max(e["runs"], key=lambda a: a["sigma"])
        assert best["where"] in e["sentence"] and "port joint" in e["sentence"]
        assert all(0 <= a["likeness"] <= 1 for a in (*e["runs"], *e["ports"]))
        silent = next(a for a in e["ports"] if a["where"] == "platform")
        assert silent["sigma"] == 0  # no candidate of this library acts there


def test_an_overlay_shows_the_channel_that_is_explained_and_its_noise(found):
    first, second = overlays(found.selection, found.residuals)
    assert (first["port"], first["channel"], first["unit"]) == ("joint", "tau_2", "N m")
    assert (second["port"], second["channel"]) != ("joint", "tau_2")
    before, after = (np.array(first[f"noise_{k}"]) for k in ("before", "after"))
    assert np.mean(after**2) == pytest.approx(1, abs=0.5) and before.max() > 5
    assert len(first["f"]) == len(before)
    assert np.ptp(first["before"]) > np.ptp(first["after"])


def test_one_that_is_imitated_but_does_not_imitate_is_no_class():
    alike = np.array([[1.0, 0.99, 0.1], [0.99, 1.0, 0.99], [0.1, 0.2, 1.0]])
    assert classes(["a", "b", "c"], alike) == [["a", "b"]]
    assert classes([], np.zeros((0, 0))) == []
