"""Answers to the independent trial are judged by what was hidden, and where."""

import pytest

from benchmarks.independent_trial import answers, measurement


def truth(kind, *effects):
    hidden = [{"name": name, "place": place} for name, place in effects]
    sizes = {"multiple": 3.0, "tolerance_factor": 1.0}
    return {"kind": kind, "effects": hidden, "system": "bent_ideal", **sizes}


def given(verdict, *names):
    said = [{"kind": kind, "slot": slot, "probability": 0.99} for kind, slot in names]
    return {"verdict": verdict, "names": said, "cpu": 1.0}


RUBS = truth("single", ("Coulomb friction", 2))
BOTH = truth("pair", ("Coulomb friction", 2), ("base stiffness", 1))
HERE, THERE = ("joint/coulomb", "joint 2"), ("joint/coulomb", "joint 1")
SOFT = ("base/stiffness", "")


@pytest.mark.parametrize(
    ("case", "answer", "judged"),
    [
        (RUBS, given("named", HERE), "right"),
        (RUBS, given("named, more remains", HERE), "right"),
        (RUBS, given("named", THERE), "wrong"),
        (RUBS, given("named", HERE, SOFT), "wrong"),
        (RUBS, given("named", ("joint/stribeck", "joint 2")), "class"),
        (RUBS, given("nothing missing"), "silent"),
        (RUBS, given("not in the library"), "unknown"),
        (BOTH, given("named", HERE, SOFT), "right"),
        (BOTH, given("named", HERE), "partly"),
        (BOTH, given("named", SOFT, THERE), "wrong"),
        (truth("single", ("command delay", 1)), given("named", ("command/delay", "")), "right"),
        (truth("null"), given("excitation too weak"), "silent"),
        (truth("null"), given("not in the library"), "alarm"),
        (truth("null"), given("named", HERE), "alarm"),
        (truth("outside", ("hose drag", 1)), given("not in the library"), "right"),
        (truth("outside", ("hose drag", 1)), given("named", HERE), "wrong"),
        (truth("mode", ("base mode 1", 1)), given("named", SOFT), "right"),
        (RUBS, given("refused"), "refused"),
    ],
)
def test_an_answer_is_judged_by_kind_and_place(case, answer, judged):
    assert answers.judge(case, answer) == judged
    assert f"| space: {case['kind']} 3 |" in answers.table([(case, answer)])


def test_sure_names_are_counted_by_machine():
    lab = RUBS | {"system": "bent_emulated"}
    judged = [(RUBS, given("named", HERE, SOFT)), (lab, given("named", THERE))]
    assert [k for k in answers.table(judged).splitlines() if "p > 0.95" in k] == [
        "laboratory: 0 of 1 names with p > 0.95 are true; processor time, median: 1 s",
        "space: 1 of 2 names with p > 0.95 are true; processor time, median: 1 s",
    ]


def test_every_effect_of_the_catalogue_has_a_kind():
    from benchmarks.independent_trial.catalogue import LIBRARY

    assert answers.KINDS.keys() == LIBRARY.keys()


@pytest.mark.parametrize("emulated", [False, True])
def test_what_is_stated_of_a_case_is_known_to_the_package(emulated):
    from ves_gym._util.params import from_plain
    from ves_gym.diagnosis.machines.system import SystemMachine
    from ves_gym.diagnosis.machines.tolerances import StatedErrors
    from ves_gym.system.system import System

    stated = {k: {"sigma": s} for k, (s, _) in measurement.TOLERANCES.items()}
    plain = answers.tolerances({"tolerance": stated}, emulated, 900.0)
    errors = from_plain(StatedErrors, plain, "here")
    system = System.load("benchmarks/independent_trial/systems/puma_bent_thesis_emulated.toml")
    if not emulated:
        system = system.ideal()
    sizes = {k.name: k.std for k in SystemMachine(system, errors).nuisances}
    assert sizes["gain of joint 1"] == 0.002 and sizes["mass of link 2"] == 0.003
    assert ("platform bandwidth" in sizes) == emulated
    assert sizes.get("zero of M_x", 0.0) == (900 * 0.0005 if emulated else 0.0)
    modes = "stiffness of the base at "
    assert {std for name, std in sizes.items() if name.startswith(modes)} == {0.003}
    silent = SystemMachine(system, StatedErrors()).nuisances  # the laboratory computes its own
    assert any(k.name.startswith(modes) for k in silent) != emulated
