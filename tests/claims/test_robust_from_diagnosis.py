"""From logs of a machine that is not as described to a plan that holds on it."""

import dataclasses
import json

import numpy as np
import pytest

from ves_gym.cli.main import main
from ves_gym.effects import BaseStiffness, PayloadMass
from ves_gym.mechanics.motion import Motion
from ves_gym.planners.case import load_case, speed_limits
from ves_gym.planners.query import Query, solve
from ves_gym.planners.refine import Refined
from ves_gym.planners.robust import read_uncertainty
from ves_gym.simulation.playback import play_motions
from ves_gym.system.energy import TAIL
from ves_gym.system.system import System

DESCRIBED = System()
TRUE = DESCRIBED.replace(effects=(BaseStiffness(error=-0.2), PayloadMass(mass=4.0)))
ENDS = (
    ([0.0, -0.2, 0.1], [0.8, 0.5, -0.6]),
    ([0.5, 0.3, -0.5], [-0.6, -0.4, 0.4]),
    ([-0.4, 0.2, 0.6], [0.5, -0.3, -0.2]),
)
GOAL = (60.0, 40.0, -30.0)  # deg


@pytest.fixture(scope="module")
def diagnosed(tmp_path_factory):
    """The folder of a diagnosis of three runs, of a softer base and an arm that holds 4 kg."""
    folder, rng = tmp_path_factory.mktemp("diagnosed"), np.random.default_rng(0)
    recording = play_motions(
        TRUE, [Motion.straight(np.array(a), b, duration=1.5) for a, b in ENDS], settle=2.0
    )
    (folder / "logs").mkdir()
    for i in range(len(ENDS)):
        log = recording.log(i)
        noisy = {
            k: getattr(log, k) + s * rng.standard_normal(getattr(log, k).shape)
            for k, s in (("q", 2e-5), ("tau", 0.1), ("y", 1e-5))
        }
        meta = {**log.meta, "system": DESCRIBED.to_dict()}
        path = folder / "logs" / f"run-{i + 1}.parquet"
        dataclasses.replace(log, **noisy, meta=meta).save(path)
    options = ("--no-figures", "--no-free-run", "--out", str(folder))
    assert main(["diagnose", str(folder / "logs"), *options]) == 0
    return folder


@pytest.mark.slow
def test_a_plan_from_a_diagnosis_holds_on_the_machine_that_is_there(diagnosed, capsys):
    """Claim: simulate, diagnose, plan from the file, and judge on the hidden truth.

    Reference: a plan by someone who knows the truth, and one by who knows the description.
    The servo goes by the diagnosed arm, as the plan does.
    """
    words = ("plan", "--robust-from", diagnosed / "diagnosis.json", "--duration", "4")
    words = (*words, "--goal", ",".join(map(str, GOAL)), "--out", diagnosed / "plan")
    result = diagnosed / "plan.json"
    assert main([*map(str, words), "--json", str(result)]) == 0
    assert "base/stiffness.error: -0.2" in capsys.readouterr().out
    plain = json.loads(result.read_text())
    assert plain["planner"] == "robust" and plain["info"]["scenarios"] == 4
    goal = tuple(np.deg2rad(GOAL).tolist())
    limits = speed_limits(DESCRIBED.arm)
    zero = (0.0,) * 3
    blind, told = (
        solve(Refined(), Query(system=s, start=zero, goal=goal, duration=4.0, v_max=limits))
        for s in (DESCRIBED, TRUE.actual)
    )
    robust = load_case(diagnosed / "plan" / "case.toml").motion
    servo = blind.query.servo
    E = [
        e.E_mean
        for e in play_motions(
            TRUE.actual, [blind.motion, robust, told.motion], servo=servo, settle=TAIL
        ).energies()
    ]
    print(f"on the truth [J]: as described {E[0]:.4f}, robust {E[1]:.4f}, told {E[2]:.4f}")
    assert E[1] < 0.8 * E[0]
    assert E[1] < 1.1 * E[2]


@pytest.mark.slow
def test_what_a_diagnosis_says_is_the_machine(diagnosed, capsys):
    uncertain = read_uncertainty(diagnosed / "diagnosis.json")
    low, high = uncertain.ranges["payload/mass"]["mass"]
    assert low < 4.0 < high
    assert uncertain.around.effects == ()
    assert uncertain.estimate.arm.mass - DESCRIBED.arm.mass == pytest.approx(4.0, rel=0.05)
    words = ["plan", "--robust-from", str(diagnosed / "diagnosis.json"), "--goal", "1,2,3"]
    assert main([*words, "--vehicle", "bent"]) == 2
    assert "leave out --vehicle" in capsys.readouterr().err


def test_ranges_are_read_from_a_table(tmp_path, capsys):
    file = tmp_path / "ranges.toml"
    file.write_text('["base/stiffness"]\nerror = [-0.1, 0.1]\n')
    words = ["plan", "--robust-from", str(file), "--goal", "20,10,10", "--duration", "1"]
    assert main([*words, "--planner", "robust-worst", "--out", str(tmp_path)]) == 0
    assert "uncertain: base/stiffness.error: -0.1 to 0.1" in capsys.readouterr().out
    assert main([*words, "--planner", "direct"]) == 2
    assert "is for planners robust and robust-worst, got direct" in capsys.readouterr().err
    file.write_text("")
    assert main(words) == 2
    assert "expected ranges of effects, got none" in capsys.readouterr().err
    wrong = tmp_path / "other.json"
    wrong.write_text('{"schema": "ves-plan/1"}')
    assert main(["plan", "--robust-from", str(wrong), "--goal", "1,2,3"]) == 2
    assert "schema must be 'ves-diagnose/1'" in capsys.readouterr().err
