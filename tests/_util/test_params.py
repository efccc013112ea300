"""Parameter sets: exact round trips, strict reading, files written completely or not at all."""

import contextlib
import dataclasses
import errno
import json
import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import ves_gym
from tests.arms import six_joint_arm
from ves_gym._util import params
from ves_gym._util.params import (
    ParameterError,
    canonical_json,
    content_hash,
    finite,
    from_plain,
    read_table,
    symmetric,
    to_plain,
    units,
    write_text,
)
from ves_gym.envs.build import get_task
from ves_gym.envs.registration import IDS
from ves_gym.mechanics.arm_library import PUMA_560
from ves_gym.mechanics.link import Inertial, Link, diagonal, matrix
from ves_gym.mechanics.vehicle import BENT_THESIS, VEHICLES, Beam, MatrixVehicle
from ves_gym.system import emulator_settings
from ves_gym.system.effect import EFFECTS
from ves_gym.system.system import System

ROOT = Path(__file__).parents[2]

# ------------------------------------------------------------------------ round trips


def matrices(seed):
    """A symmetric vehicle with numbers of every length."""
    roots = np.random.default_rng(seed).normal(size=(3, 6, 6)) * [[[1e-3]], [[1.0]], [[1e5]]]
    M, D, K = (matrix(root @ root.T) for root in roots)
    return MatrixVehicle(M=M, D=D, K=K, source="ω ü 'quoted' \\ \n")


SYSTEMS = {
    **{name: System(vehicle=vehicle) for name, vehicle in VEHICLES.items()},
    "drawn": System(vehicle=matrices(0), physics_dt=1e-3 / 3, control_dt=7e-3),
    "euler": System(integrator="euler", drive="prescribed", arm=six_joint_arm()),
}


@pytest.mark.parametrize("system", SYSTEMS.values(), ids=SYSTEMS)
def test_a_system_survives_plain_data_and_files(system, tmp_path):
    def no_constants(constant):
        raise AssertionError(constant)

    strict = json.loads(canonical_json(system), parse_constant=no_constants)
    copies = [System.from_dict(system.to_dict()), System.from_dict(strict)]
    for suffix in ("toml", "json"):
        system.save(tmp_path / f"system.{suffix}")
        copies.append(System.load(tmp_path / f"system.{suffix}"))
    for copy in copies:
        assert copy == system and copy.hash == system.hash and hash(copy) == hash(system)
    assert [p.name for p in sorted(tmp_path.iterdir())] == ["system.json", "system.toml"]


def test_the_hash_is_the_same_in_another_process():
    code = (
        "from ves_gym.system.system import System;"
        "from ves_gym.mechanics.vehicle import VEHICLES;"
        "print(*(System(vehicle=v).hash for v in VEHICLES.values()))"
    )
    env = {**os.environ, "PYTHONHASHSEED": "123"}
    found = subprocess.run(
        [sys.executable, "-c", code],
        cwd=ROOT,
        env=env,
        capture_output=True,
        text=True,
        check=True,
    )
    assert found.stdout.split() == [System(vehicle=v).hash for v in VEHICLES.values()]


def test_equal_values_written_differently_have_one_hash():
    """12, 12.0 and NumPy's 12 are equal; so must be the text that names a result."""
    whole = Beam(segments=((0, 0, 12),), outer_diameter=0.07, wall=0.006)
    real = Beam(segments=((0.0, -0.0, 12.0),), outer_diameter=0.07, wall=0.006)
    numpy = Beam(segments=((0.0, 0.0, np.float64(12)),), outer_diameter=0.07, wall=0.006)
    assert whole == real == numpy
    assert content_hash(whole) == content_hash(real) == content_hash(numpy)
    assert (
        System(control_dt=1, physics_dt=0.5).hash == System(control_dt=1.0, physics_dt=0.5).hash
    )


def leaves(plain, path=()):
    """Every number and string in plain data, with its path."""
    if isinstance(plain, (dict, list)):
        for key, item in plain.items() if isinstance(plain, dict) else enumerate(plain):
            yield from leaves(item, (*path, key))
    else:
        yield path, plain


def with_leaf(plain, path, value):
    copy = json.loads(json.dumps(plain))
    place = copy
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    return copy


@pytest.mark.parametrize("name", sorted(VEHICLES))
def test_every_changed_number_changes_the_hash(name):
    """Content hash of the plain data: one leaf at a time, by a billionth of itself."""
    plain = System(vehicle=VEHICLES[name]).to_dict()
    seen = {content_hash(plain)}
    count = 1
    for path, value in leaves(plain):
        if isinstance(value, bool):
            changed = not value
        elif isinstance(value, str):
            changed = value + "."
        else:
            changed = value * (1 + 1e-9) or 1e-12
        seen.add(content_hash(with_leaf(plain, path, changed)))
        count += 1
    assert len(seen) == count > 60


# ------------------------------------------------------------------ strict reading

PLAIN = System().to_dict()


def changed(path, value):
    return with_leaf(PLAIN, path, value)


def without(path):
    copy = json.loads(json.dumps(PLAIN))
    place = copy
    for key in path[:-1]:
        place = place[key]
    del place[path[-1]]
    return copy


LINK = ("arm", "links", 1)

BAD = {
    "unknown key at the top": (changed(("colour",), 1), "'colour'", "known: arm, vehicle"),
    "unknown key in a link": (changed((*LINK, "length"), 1), "'length'", "links[1]", "alpha"),
    "a kind where there is none": (changed((*LINK, "kind"), "prismatic"), "links[1]", "'kind'"),
    "missing key": (without((*LINK, "a_max")), "links[1]", "missing key 'a_max'"),
    "missing key in the body": (without((*LINK, "inertial", "mass")), "inertial", "'mass'"),
    "text for a number": (changed((*LINK, "d"), "long"), "links[1].d", "float", "'long'"),
    "truth value for a number": (changed((*LINK, "d"), True), "links[1].d", "float", "True"),
    "list for a number": (changed((*LINK, "d"), [1.0]), "links[1].d", "float", "[1.0]"),
    "number for text": (changed(("mode",), 1), "System.mode", "str", "1"),
    "number for a list": (changed(("arm", "links"), 3), "arm.links", "list", "3"),
    "number for a table": (changed(("arm", "base"), 3), "arm.base", "table of Inertial", "3"),
    "nothing at all": (None, "System", "table", "None"),
    "list for a table": ([1], "System", "table", "[1]"),
    "no links": (changed(("arm", "links"), []), "links", "at least one"),
    "wrong length": (changed((*LINK, "inertial", "com"), [0.0, 0.0]), "com", "(3,)", "(2,)"),
    "ragged matrix": (
        changed((*LINK, "inertial", "inertia"), [[1.0], [0.0, 1.0], []]),
        "inertia",
        "(3, 3)",
    ),
    "nan": (changed((*LINK, "d"), math.nan), "Link", "finite", "nan"),
    "inf": (changed((*LINK, "v_max"), math.inf), "v_max", "> 0", "rad/s", "inf"),
    "nan in a matrix": (
        changed((*LINK, "inertial", "com", 2), math.nan),
        "com",
        "finite",
        "nan",
    ),
    "beyond the range of floats": (changed((*LINK, "d"), 10**400), "links[1].d", "float"),
    "unknown kind": (changed(("vehicle", "kind"), "boat"), "vehicle.kind", "beam", "'boat'"),
    "missing kind": (without(("vehicle", "kind")), "vehicle.kind", "satellite", "None"),
    "unknown vehicle name": (changed(("vehicle",), "boat"), "vehicle", "bent-thesis", "'boat'"),
    "number for a vehicle": (changed(("vehicle",), 5), "vehicle.kind", "beam"),
    "unknown mode": (changed(("mode",), "dream"), "System.mode", "ideal", "'dream'"),
    "unknown drive": (changed(("drive",), "steam"), "System.drive", "motor", "'steam'"),
    "unknown integrator": (changed(("integrator",), "ab2"), "integrator", "rk4", "'ab2'"),
    "zero step": (changed(("physics_dt",), 0.0), "physics_dt", "> 0 s", "0.0"),
    "negative step": (changed(("control_dt",), -1.0), "control_dt", "> 0 s", "-1.0"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_data_is_refused_by_name(case):
    plain, *parts = BAD[case]
    with pytest.raises(ParameterError) as caught:
        System.from_dict(plain)
    for part in parts:
        assert part in str(caught.value), str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("path", [path for path, _ in leaves(PLAIN)], ids=str)
def test_nothing_but_its_own_type_is_taken_for_any_entry(path):
    plain = PLAIN
    for part in path:
        plain = plain[part]
    for wrong in ({}, [], None, "x" if isinstance(plain, bool) else True, math.inf):
        with pytest.raises(ParameterError):
            System.from_dict(changed(path, wrong))


def test_integers_are_taken_for_real_numbers():
    assert System.from_dict(changed((*LINK, "d"), 2)).arm.links[1].d == 2.0
    assert isinstance(System.from_dict(changed((*LINK, "d"), 2)).arm.links[1].d, float)


def test_the_kind_must_be_that_of_the_class():
    plain = to_plain(BENT_THESIS)
    assert from_plain(Beam, plain) == BENT_THESIS
    with pytest.raises(ParameterError, match="kind must be beam, got 'satellite'"):
        from_plain(Beam, {**plain, "kind": "satellite"})


def test_a_vehicle_may_be_named():
    assert System.from_dict({**PLAIN, "vehicle": "free-flying"}).vehicle.thrusters
    assert System.from_dict({}) == System()


def test_units_are_on_the_fields():
    assert units(Link)["tau_max"] == "N m"
    assert "source" not in units(Beam)


# ------------------------------------------------------------------ arrays and checks


@pytest.mark.parametrize(
    "value",
    [
        *("abc", "123", ("1", "2", "3"), (True, False, True), None, {}),
        *((1, 2), ((1, 2, 3),), 5.0, (1, (2,), 3)),
        *((1, None, 3), (1, 2, math.nan), (1, 2, -math.inf), (1, 2, 3j)),
    ],
    ids=repr,
)
def test_finite_takes_numbers_of_one_shape_only(value):
    with pytest.raises(ParameterError, match="com"):
        finite(value, (3,), "com")


def test_symmetric_names_entries_and_eigenvalues():
    crooked = np.eye(6)
    crooked[1, 4] = 1e-3
    with pytest.raises(
        ParameterError, match=r"K must be symmetric.*\[2,5\] = 0.001.*\[5,2\] = 0"
    ):
        symmetric(crooked, "K")
    with pytest.raises(ParameterError, match=r"K must be positive semidefinite.*-0.25"):
        symmetric(np.diag([1, 1, 1, 1, 1, -0.25]), "K")
    assert (symmetric(np.zeros((6, 6)), "D") == 0).all()


@pytest.mark.parametrize("value", [True, "1", None, math.nan, math.inf, -1.0, 0.0, 1j])
def test_lengths_of_time_are_positive_numbers(value):
    with pytest.raises(ParameterError, match=r"System.physics_dt must be > 0 s, got"):
        System(physics_dt=value)


# ------------------------------------------------------------------------------ files


def test_files_that_cannot_be_read_are_named(tmp_path):
    cases = {
        "absent.toml": (None, "cannot be read"),
        "broken.toml": (b"a = \n", "not valid TOML"),
        "twice.toml": (b"a = 1\na = 2\n", "not valid TOML"),
        "broken.json": (b"{", "not valid JSON"),
        "twice.json": (b'{"a": 1, "a": 2}', "key 'a' is given more than once"),
        "deep.json": (b"[" * 100_000, "not valid JSON"),
        "list.json": (b"[1]", "expected a table at the top, got list"),
        "latin.toml": ("a = 'é'".encode("latin-1"), "cannot be read"),
        "system.yaml": (b"a: 1", "expected a .toml or .json file, got '.yaml'"),
        "system": (b"", "expected a .toml or .json file"),
    }
    for name, (data, message) in cases.items():
        path = tmp_path / name
        if data is not None:
            path.write_bytes(data)
        with pytest.raises(ParameterError) as caught:
            read_table(path)
        assert str(path) in str(caught.value)
        assert message in str(caught.value)
    with pytest.raises(ParameterError, match="cannot be read"):
        read_table(tmp_path)


def test_a_bad_system_file_is_named_with_the_key(tmp_path):
    path = tmp_path / "s.json"
    path.write_text(json.dumps(changed((*LINK, "d"), "long")))
    with pytest.raises(ParameterError, match=r"s\.json\.arm\.links\[1\]\.d must be float"):
        System.load(path)
    path.write_text(json.dumps(changed((*LINK, "d"), math.nan)))  # JSON's NaN
    with pytest.raises(ParameterError, match="finite"):
        System.load(path)


def test_a_system_is_written_as_toml_or_json_only(tmp_path):
    with pytest.raises(ParameterError, match=r"expected a .toml or .json name, got '.yaml'"):
        System().save(tmp_path / "s.yaml")
    assert not list(tmp_path.iterdir())


def test_writing_makes_folders_and_replaces(tmp_path):
    path = tmp_path / "a" / "b" / "c.txt"
    for text in ("first", "second ω"):
        write_text(path, text)
    assert path.read_text(encoding="utf-8") == "second ω"
    assert [p.name for p in path.parent.iterdir()] == ["c.txt"]


@pytest.mark.parametrize("call", ["fsync", "replace", "chmod"])
def test_a_failed_write_leaves_the_old_file_and_nothing_else(call, tmp_path, monkeypatch):
    path = tmp_path / "kept.txt"
    write_text(path, "old")

    def fail(*args, **kwargs):
        raise OSError(errno.ENOSPC, "disk full", "a temporary name")

    monkeypatch.setattr(params.os, call, fail)
    with pytest.raises(OSError, match="disk full") as caught:
        write_text(path, "new")
    assert caught.value.filename == str(path)
    assert path.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["kept.txt"]


def test_written_files_follow_the_umask(tmp_path):
    before = os.umask(0o027)
    try:
        write_text(tmp_path / "f", "x")
    finally:
        os.umask(before)
    assert (tmp_path / "f").stat().st_mode & 0o777 == 0o640


def test_lists_and_arrays_become_tuples_that_can_be_hashed():
    inertia = np.diag([1.0, 1.0, 1.0])
    body = Inertial(mass=1.0, com=[0.0, 0.0, 0.1], inertia=inertia)
    assert body == Inertial(mass=1.0, com=(0.0, 0.0, 0.1), inertia=diagonal(1.0, 1.0, 1.0))
    assert hash(body) == hash(dataclasses.replace(body))
    inertia[0, 0] = 9.0  # the caller's array is no longer the body's
    assert body.inertia[0][0] == 1.0
    arm = dataclasses.replace(PUMA_560, links=list(PUMA_560.links))
    assert arm == PUMA_560
    assert hash(arm) == hash(PUMA_560)


def parameter_sets():
    """Every public parameter set that is good with its defaults alone."""
    rooms = (ves_gym, ves_gym.envs, ves_gym.planners, ves_gym.experiments)
    rooms += (ves_gym.mechanics, ves_gym.hardware, ves_gym.baselines, emulator_settings)
    found = [getattr(room, name) for room in rooms for name in dir(room)]
    found = {k for k in found if isinstance(k, type) and dataclasses.is_dataclass(k)}
    found |= {*EFFECTS.values(), *(get_task(k.task) for k in IDS.values())}
    for cls in sorted(found, key=lambda k: k.__name__):
        with contextlib.suppress(TypeError, ParameterError):
            cls()
            yield cls


@pytest.mark.parametrize("cls", list(parameter_sets()))
def test_an_object_of_another_kind_is_refused_in_any_field(cls):
    for field in (f for f in dataclasses.fields(cls) if f.init):
        with pytest.raises(ParameterError, match=field.name):
            cls(**{field.name: object()})
