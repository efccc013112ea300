"""What people write on the command line: angles, lists, effects; everything else is SI."""

import dataclasses
import itertools

import numpy as np
import pytest

import ves_gym.effects  # noqa: F401  (fills the registry)
from tests.effects.values import VALUES
from ves_gym._util.params import ParameterError
from ves_gym.cli import flags
from ves_gym.cli.flags import Flag, Place, radians_note, values
from ves_gym.cli.machine import parse_effect
from ves_gym.mechanics.arm_library import PUMA_560
from ves_gym.system.effect import EFFECTS

PLACE = Place("--x", PUMA_560)


@pytest.mark.parametrize(
    ("read", "text", "value"),
    [
        (flags.joints, "90,-45,.5", np.deg2rad([90, -45, 0.5])),
        (flags.per_joint("deg/s"), "180,0,90", [np.pi, 0, np.pi / 2]),
        (flags.word_or("none", flags.integer(), "none"), "none", None),
        (flags.pose, "1,2,3,0,0,180", [1, 2, 3, 0, 0, np.pi]),
        (flags.number("s", above=0), "2.5", 2.5),
        (flags.integer(1), "3", 3),
        (flags.integers, "0,-1", (0, -1)),
        (flags.names, "a, b", ["a", "b"]),
    ],
)
def test_values_become_si(read, text, value):
    got = read(text, PLACE)
    if isinstance(got, np.ndarray):
        np.testing.assert_allclose(got, value)
    else:
        assert got == value


def test_only_what_is_set_is_passed_on():
    table = (
        Flag("LOG", many=True),
        Flag("--q", "A,B,C", flags.joints),
        Flag("--fast"),
        Flag("--via", "A", flags.integer(), to="points", many=True),
    )
    texts = {"log": ["a", "b"], "q": "1,1,1", "fast": False, "points": ["1", "2"]}
    got = values(table, {**texts, "radians": True}, PUMA_560)
    assert got.pop("q").tolist() == [1, 1, 1]
    assert got == {"log": ("a", "b"), "points": (1, 2)}


# ------------------------------------------------------------------- angles, not radians


@pytest.mark.parametrize(
    ("text", "meant"),
    [
        ("1.57,0,0", "90,0,0"),
        ("0.785,-1.571,0.5", "45,-90,28.6"),
        ("-2.36,0,0", "-135,0,0"),
        ("3.14159,0,0", "180,0,0"),
        ("0.26,0,0", "15,0,0"),
    ],
)
def test_round_angles_in_radians_are_asked_about(text, meant, capsys):
    note = radians_note(text, "--x")
    assert note.startswith(f"--x {text} looks like radians; angles are degrees: did you mean")
    assert f"did you mean {meant}?" in note
    angles = flags.joints(text, PLACE)
    assert capsys.readouterr().err == f"ves-gym: note: {note}\n"
    assert angles == pytest.approx(np.deg2rad([float(k) for k in text.split(",")]))
    flags.joints(text, PLACE._replace(angles="degrees"))
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    "text", ["0,0,0", "0.0,0.0,0.0", "1,1,1", "5,5,5", "90,1.57,0", "1e-3,0,0", "6.5,0,0"]
)
def test_small_angles_are_angles(text):
    assert radians_note(text, "--x") is None


@pytest.mark.parametrize("text", ["1.0,0.5,-0.5", "1.5,0,0", "1.2,-0.7,0.4", "0.01,0,0"])
def test_small_angles_with_decimals_are_told_their_unit(text, capsys):
    note = f"--x {text} is taken as degrees (--radians takes radians, --degrees says so)"
    assert radians_note(text, "--x") == note
    angles = flags.joints(text, PLACE)
    assert capsys.readouterr().err == f"ves-gym: note: {note}\n"
    assert angles == pytest.approx(np.deg2rad([float(k) for k in text.split(",")]))
    flags.joints(text, PLACE._replace(angles="degrees"))
    assert capsys.readouterr().err == ""


def test_angles_name_the_unit_they_were_given_in():
    place = PLACE._replace(angles="radians")
    with pytest.raises(ParameterError, match="3 angles in radians, like"):
        flags.joints("a,0,0", place)
    with pytest.raises(ParameterError, match=r"within -160\.0 to 160\.0 deg, got 5156\.6 deg"):
        flags.joints("90,0,0", place)


# -------------------------------------------------------------------------- --effect


@pytest.mark.parametrize(
    ("kind", "brackets"), list(itertools.product(sorted(EFFECTS), [False, True]))
)
def test_every_effect_can_be_written(kind, brackets):
    """Values drawn inside the bounds come back to the last bit; those of a body are one's."""
    rng = np.random.default_rng(7)
    drawn, words = {}, []
    for field in dataclasses.fields(EFFECTS[kind]):
        low, high = field.metadata["bounds"]
        shape = tuple(3 if k is None else k for k in field.metadata["shape"])
        value = rng.uniform(low, high, shape).tolist()
        if kind == "payload/body":
            value = (np.array(VALUES[kind][field.name]) / 3).tolist()
        drawn[field.name] = value
        flat = str(value).replace(" ", "")
        words.append(f"{field.name}={flat if brackets or len(shape) > 1 else flat.strip('[]')}")
    assert parse_effect(f"{kind}:{','.join(words)}") == EFFECTS[kind](**drawn)


@pytest.mark.parametrize(
    ("text", "value"),
    [("3,0,0", (3, 0, 0)), ("3, 0, 0", (3, 0, 0)), ("[3, 0, 0]", (3, 0, 0)),
     (".5,1e-3,+1", (0.5, 1e-3, 1))],
)  # fmt: skip
def test_numbers_as_one_writes_them(text, value):
    assert parse_effect(f"joint/coulomb:torque={text}").torque == value
    assert parse_effect("gravity/scale:error=-.01").error == -0.01


BAD_EFFECTS = {
    "joint/coulom:torque=1": '; did you mean "joint/coulomb"?',
    "coulomb": '; did you mean "joint/coulomb"?',
    "joint/coulomb": "needs torque [N m] in [0, 50], like joint/coulomb:torque=",
    "joint/coulomb:torque=a": "in [0, 50] N m, got 'a'",
    "joint/coulomb:torque=3 0 0": "in [0, 50] N m, got '3 0 0'",
    "joint/coulomb:torque=": "no value in 'torque='",
    "joint/coulomb:torque=3,0,99": "in [0, 50] N m, got [3.0, 0.0, 99.0]",
    "joint/coulomb:torque=3,0,nan": "in [0, 50] N m",
    "gravity/scale:scale=1.01": "unknown parameter 'scale'; known: error in",
    "joint/coulomb:torqe=1,1,1": '; did you mean "torque"?',
    "joint/coulomb:torque=1,1,1,torque=2,2,2": "more than once",
    "gravity/scale:error=0.1,0.1": "[-0.2, 0.2], got [0.1, 0.1]",
    "joint/coulomb:torque=[3,0": "in [0, 50] N m, got '[3,0'",
}


@pytest.mark.parametrize("text", BAD_EFFECTS)
def test_what_is_wrong_is_said_with_unit_and_bounds(text):
    with pytest.raises(ParameterError) as refused:
        parse_effect(text)
    assert BAD_EFFECTS[text] in str(refused.value)
