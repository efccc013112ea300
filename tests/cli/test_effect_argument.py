"""`--effect KIND:NAME=VALUE`: numbers as one writes them, on every command that has effects."""

import dataclasses

import numpy as np
import pytest

import ves_gym.effects  # noqa: F401  (fills the registry)
from tests.effects.values import VALUES
from ves_gym._util.params import ParameterError
from ves_gym.cli.common import parse_effect
from ves_gym.cli.main import main
from ves_gym.diagnosis.inputs import system_inputs
from ves_gym.mechanics.motion import Motion
from ves_gym.simulation.playback import play_motions
from ves_gym.system.effect import EFFECTS
from ves_gym.system.system import System

SHORT = ("--duration", "0.4", "--settle", "0.2")
COULOMB = "joint/coulomb:torque=3,0,0"


@pytest.mark.parametrize("kind", sorted(EFFECTS))
@pytest.mark.parametrize("brackets", [False, True])
def test_every_effect_can_be_written(kind, brackets):
    """Values drawn inside the bounds come back to the last bit; those of a body are one's."""
    rng = np.random.default_rng(7)
    values, words = {}, []
    for field in dataclasses.fields(EFFECTS[kind]):
        low, high = field.metadata["bounds"]
        shape = tuple(3 if k is None else k for k in field.metadata["shape"])
        value = rng.uniform(low, high, shape).tolist()
        if kind == "payload/body":
            value = (np.array(VALUES[kind][field.name]) / 3).tolist()
        values[field.name] = value
        flat = str(value).replace(" ", "")
        words.append(f"{field.name}={flat if brackets or len(shape) > 1 else flat.strip('[]')}")
    assert parse_effect(f"{kind}:{','.join(words)}") == EFFECTS[kind](**values)


@pytest.mark.parametrize(
    ("text", "value"),
    [("3,0,0", (3, 0, 0)), ("3, 0, 0", (3, 0, 0)), ("[3, 0, 0]", (3, 0, 0)),
     (".5,1e-3,+1", (0.5, 1e-3, 1))],
)  # fmt: skip
def test_numbers_as_one_writes_them(text, value):
    assert parse_effect(f"joint/coulomb:torque={text}").torque == value


def test_a_number_alone_is_a_number():
    assert parse_effect("gravity/scale:error=-.01").error == -0.01


BAD = {
    "kind": ("joint/coulom:torque=1", '; did you mean "joint/coulomb"?'),
    "kind alone": ("coulomb", '; did you mean "joint/coulomb"?'),
    "no value": ("joint/coulomb", "needs torque [N m] in [0, 50], like joint/coulomb:torque="),
    "no number": ("joint/coulomb:torque=a", "in [0, 50] N m, got 'a'"),
    "no comma": ("joint/coulomb:torque=3 0 0", "in [0, 50] N m, got '3 0 0'"),
    "empty": ("joint/coulomb:torque=", "no value in 'torque='"),
    "bounds": ("joint/coulomb:torque=3,0,99", "in [0, 50] N m, got [3.0, 0.0, 99.0]"),
    "not finite": ("joint/coulomb:torque=3,0,nan", "in [0, 50] N m"),
    "parameter": ("gravity/scale:scale=1.01", "unknown parameter 'scale'; known: error in"),
    "slip": ("joint/coulomb:torqe=1,1,1", '; did you mean "torque"?'),
    "twice": ("joint/coulomb:torque=1,1,1,torque=2,2,2", "more than once"),
    "list for a number": ("gravity/scale:error=0.1,0.1", "[-0.2, 0.2], got [0.1, 0.1]"),
    "half a list": ("joint/coulomb:torque=[3,0", "in [0, 50] N m, got '[3,0'"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_what_is_wrong_is_said_with_unit_and_bounds(case):
    text, expected = BAD[case]
    with pytest.raises(ParameterError) as refused:
        parse_effect(text)
    assert expected in str(refused.value)


def test_one_number_for_three_joints(refused):
    line = refused("simulate", "--effect", "joint/coulomb:torque=3", *SHORT)
    assert "joint/coulomb.torque must be 3 numbers, one per joint, got 1" in line


def test_simulate_takes_several(call, tmp_path):
    words = ("--effect", COULOMB, "--effect", "joint/viscous:damping=1,2,3")
    status, _, _, result = call("simulate", "--goal", "5,5,5", *words, *SHORT)
    assert status == 0
    system = System.load(tmp_path / "out" / "system.toml")
    assert [str(e) for e in system.effects] == [
        "joint/coulomb(torque=[3.0, 0.0, 0.0])",
        "joint/viscous(damping=[1.0, 2.0, 3.0])",
    ]
    assert system.hash == result["system"]


def test_plan_benchmark_map_and_check_take_it(call):
    with_it = ("--effect", COULOMB)
    status, _, _, planned = call("plan", "--goal", "5,5,5", "--planner", "straight", *with_it)
    assert status == 0
    assert planned["system"] == System(effects=(parse_effect(COULOMB),)).hash
    bench = (
        "--suite",
        "thesis",
        "--vehicle",
        "straight-horizontal-thesis",
        "--planners",
        "straight",
    )
    bench += ("--workers", "1", "--no-figures")
    status, _, _, table = call("benchmark", *bench, *with_it)
    assert status == 0 and table["rows"][0]["success"]
    assert call("map", "--joints", "1,2", "--points", "4", *with_it)[0] == 0
    words = ("--vehicle", "bent-thesis", "--no-search", "--no-figures", *with_it)
    status, _, _, check = call("emulation-check", *words)
    assert status == 0 and check["system"]["effects"][0]["kind"] == "joint/coulomb"


def test_evaluate_adds_it_to_the_effects_of_the_environment(call):
    words = ("--controller", "hold", "--episodes", "2", "--nominal")
    _, _, _, plain = call("evaluate", "ves/PumaDamp-v0", *words)
    status, _, _, result = call("evaluate", "ves/PumaDamp-v0", *words, "--effect", COULOMB)
    assert status == 0
    (column,) = result["controllers"]
    assert column["settings"]["effects"] == [
        {"kind": "joint/coulomb", "torque": [3.0, 0.0, 0.0]}
    ]
    assert column["rows"] != plain["controllers"][0]["rows"]
    _, _, _, result = call("evaluate", "ves/PumaDampEmulated-v0", *words, "--effect", COULOMB)
    kinds = [e["kind"] for e in result["controllers"][0]["settings"]["effects"]]
    assert kinds[-1] == "joint/coulomb" and "sensor/noise" in kinds


def test_diagnose_takes_it_as_described(call, run_log, tmp_path):
    words = ("diagnose", run_log, "--effect", COULOMB, "--effect", "joint/nothing:torque=1")
    status, _, err, _ = call(*words)
    assert status == 2 and "--effect must be one of" in err
    goals = np.deg2rad([[20.0, -10, 15], [-20, 10, 5]])
    played = play_motions(
        System(), [Motion.straight(np.zeros(3), g, 1.0) for g in goals], settle=0.5
    )
    logs = [tmp_path / f"{k}.csv" for k in range(2)]
    for k, path in enumerate(logs):
        played.log(k).save(path)
    plain, with_it = (system_inputs(logs, effects=e) for e in ((), [parse_effect(COULOMB)]))
    assert plain.described == System().hash
    assert with_it.described == System(effects=(parse_effect(COULOMB),)).hash


def test_help_has_an_example(capsys):
    for command in ("simulate", "plan", "benchmark", "evaluate", "diagnose", "train", "teleop"):
        with pytest.raises(SystemExit):
            main([command, "--help"])
        assert "joint/coulomb:torque=3,0,0" in " ".join(capsys.readouterr().out.split())
