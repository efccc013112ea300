"""Rules, entries, files of a bundle, and what it takes to make one."""

import json
import os
import stat
import zipfile

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from tests.leaderboard.bundles import POLICY, Bundle, path_bundle, policy_bundle
from ves_gym._util.params import ParameterError, canonical_json
from ves_gym.leaderboard import fingerprint, protocol
from ves_gym.leaderboard.archive import LIMITS, MANIFEST, limit, read_members, write_members
from ves_gym.leaderboard.bundle import KEYS, digest, read_manifest, sealed
from ves_gym.leaderboard.entry import ABOUT, ROW, check_entry
from ves_gym.leaderboard.errors import BundleError, Code
from ves_gym.leaderboard.npy_io import pack, unpack
from ves_gym.leaderboard.policy_files import policy_names
from ves_gym.leaderboard.protocol import Problem, get_problem, problems, read_salt, seeds_of
from ves_gym.leaderboard.tracks.paths import PathTrack
from ves_gym.mechanics.vehicle import BENT_THESIS
from ves_gym.planners.suites import get_suite
from ves_gym.system.system import System

SALT = "a secret of the maintainer"


# -------------------------------------------------------------------------------- rules


def test_problems_of_every_track():
    tracks = {"paths", "policies", "tasks", "damping", "discrepancy"}
    assert set(protocol.PROTOCOL) == tracks
    assert len(problems("paths")) == 2 * 6 and len(problems("policies")) == 2 * 14
    assert len(problems("tasks")) == 2 * 21
    assert "ves/PumaDampEmulated-v0" in problems("damping")
    assert "blind-sealed-quick" in problems("discrepancy")
    for track in protocol.PROTOCOL:
        for name in problems(track):
            problem = get_problem(track, name)
            assert problem.kinds() and problem.count > 0
            assert problem.quick == name.endswith("-quick")
    with pytest.raises(ParameterError, match="track must be one of"):
        problems("speed")
    with pytest.raises(ParameterError, match="problem of track paths"):
        get_problem("paths", "reach100-3s")


def test_public_queries_are_those_of_the_benchmark():
    problem = get_problem("paths", "reach100-2s")
    ours = PathTrack().queries(problem, seeds_of(problem, None))
    suite = get_suite("reach100", system=System(), vehicle="bent-thesis").queries
    assert ours == [q for _, q in suite if q.duration == 2.0]
    among = get_problem("paths", "reach100-2s-obstacles")
    query = PathTrack().queries(among, seeds_of(among, None))[0]
    assert query.surroundings is not None and query.start == ours[0].start


def test_official_seeds_are_secret_and_differ():
    roots = set()
    for track in ("paths", "policies", "damping"):
        for name in problems(track):
            problem = get_problem(track, name)
            public, official = seeds_of(problem, None), seeds_of(problem, SALT)
            assert public.which == "public" and public.mark is None
            assert official.which == "official" and 0 <= official.root < 2**56
            assert official != seeds_of(problem, SALT + "!")
            assert official == seeds_of(problem, SALT)
            assert SALT not in str(official)
            if not problem.quick:
                roots.add(official.root)
    assert len(roots) == 6 + 14 + 3
    paths = get_problem("paths", "reach100-1s-quick")
    there = PathTrack().queries(paths, seeds_of(paths, SALT))
    assert there != PathTrack().queries(paths, seeds_of(paths, None))


def test_blind_sets_and_their_salt():
    sealed_set = Problem("discrepancy", "blind-sealed")
    public = Problem("discrepancy", "blind-development")
    assert seeds_of(sealed_set, SALT).root >= 2**64 and seeds_of(public, None).mark is None
    for problem, salt in ((sealed_set, None), (public, SALT)):
        with pytest.raises(ParameterError, match="salt"):
            seeds_of(problem, salt)


def test_a_salt_from_a_file(tmp_path):
    file = tmp_path / "salt"
    file.write_text(f"  {SALT}\n")
    assert read_salt(file) == SALT
    file.write_text("short")
    with pytest.raises(ParameterError, match="at least 16"):
        read_salt(file)
    with pytest.raises(ParameterError, match="cannot be read"):
        read_salt(tmp_path / "none")


def test_every_code_is_documented():
    """In docs/leaderboard.md, with the words of the code itself."""
    from pathlib import Path

    page = (Path(__file__).parents[2] / "docs/leaderboard.md").read_text("utf-8")
    for code in Code:
        assert f"| `{code.slug}` | {code.value} |" in page
    for track in protocol.PROTOCOL:
        assert f"| *{track}* |" in page


# ------------------------------------------------------------------------------ entries


def entry():
    row = {
        **dict.fromkeys(ROW),
        "id": "a", "seed": 0, "group": 0, "score": 0.5, "success": True, "failed": False,
        "E_mean": 0.1,
    }  # fmt: skip
    about = {
        **dict.fromkeys(ABOUT, ""),
        "versions": {"numpy": "2.0"}, "model": "0" * 64, "evaluator": "1" * 64,
        "settings": {}, "training": {"steps": 5}, "begun": "2026-01-01T00:00:00+00:00",
        "ended": "2026-01-01T00:00:01+00:00",
    }  # fmt: skip
    return {
        "schema": "ves-entry/1", "track": "paths", "protocol": 1, "problem": "reach100-2s",
        "name": "mine", "author": "", "kind": "planner", "level": "replayed",
        "seeds": "public", "bundle": "2" * 64,
        "score": {"name": "E", "unit": "1", "better": "lower"}, "rows": [row], "about": about,
    }  # fmt: skip


def test_an_entry_is_plain_data_and_comes_back():
    found = check_entry(entry())
    assert found.to_dict() == entry() and check_entry(found.to_dict()) == found
    assert check_entry(json.loads(json.dumps(found.to_dict()))).hash == found.hash
    with_curve = entry()
    with_curve["rows"][0] |= {"anytime": [[0.1, 3.0], [0.2, 2.0]], "E_int": 1.0}
    assert check_entry(with_curve).rows[0]["E_int"] == 1.0


def test_a_board_has_six_digits_of_every_number():
    whole = entry()
    whole["rows"][0] |= {"score": 0.12345678, "anytime": [[0.1, 3.2345678], [0.2, 2.0]]}
    short = check_entry(whole).shortened()
    assert short["rows"][0]["score"] == 0.123457
    assert short["rows"][0]["anytime"] == [[0.1, 3.23457], [0.2, 2.0]]
    assert check_entry(short).shortened() == short
    assert {k: v for k, v in short.items() if k != "rows"} == {
        k: v for k, v in whole.items() if k != "rows"
    }


@pytest.mark.parametrize(
    ("place", "value", "why"),
    [
        (("schema",), "ves-entry/2", "schema"),
        (("track",), "speed", "track"),
        (("protocol",), 0, "protocol"),
        (("protocol",), True, "protocol"),
        (("problem",), "", "problem"),
        (("name",), "a\nb", "name"),
        (("name",), "x" * 201, "name"),
        (("kind",), "human", "kind"),
        (("level",), "believed", "level"),
        (("seeds",), "mine", "seeds"),
        (("bundle",), "abc", "bundle"),
        (("score", "better"), "higher", "better"),
        (("rows",), [], "rows"),
        (("rows", 0, "score"), float("nan"), "score"),
        (("rows", 0, "score"), float("inf"), "score"),
        (("rows", 0, "E_mean"), "0.1", "E_mean"),
        (("rows", 0, "seconds"), -1, "seconds"),
        (("rows", 0, "success"), 1, "success"),
        (("rows", 0, "group"), -1, "group"),
        (("rows", 0, "anytime"), [[0.2, 1.0], [0.1, 0.5]], "anytime"),
        (("rows", 0, "anytime"), [[0.1, 1.0], [0.2, 1.5]], "anytime"),
        (("about", "begun"), "yesterday", "begun"),
        (("about", "begun"), "2027-01-01T00:00:00+00:00", "ended"),
        (("about", "model"), "", "model"),
        (("about", "training"), {"a": {1, 2}}, "training"),
        (("about", "settings"), {"a": float("inf")}, "settings"),
    ],
)
def test_an_entry_that_is_none(place, value, why):
    plain = entry()
    inner = plain
    for key in place[:-1]:
        inner = inner[key]
    inner[place[-1]] = value
    with pytest.raises(ParameterError, match=why):
        check_entry(plain)


def test_keys_and_rows_of_an_entry():
    for key in entry():
        with pytest.raises(ParameterError, match=key):
            check_entry({k: v for k, v in entry().items() if k != key})
    with pytest.raises(ParameterError, match="unknown 'more'"):
        check_entry({**entry(), "more": 1})
    with pytest.raises(ParameterError, match="twice"):
        check_entry({**entry(), "rows": 2 * entry()["rows"]})
    with pytest.raises(ParameterError, match="must be a table"):
        check_entry([])


# ------------------------------------------------------------------------------- arrays


@settings(max_examples=50, deadline=None)
@given(
    values=arrays(
        float,
        array_shapes(min_dims=2, max_dims=2, min_side=0, max_side=9),
        elements=st.floats(allow_nan=False, allow_infinity=False),
    )
)
def test_arrays_keep_every_bit(values):
    found = unpack(pack(values), "actions.npy", (None, values.shape[1]))
    np.testing.assert_array_equal(found, values)
    assert found.tobytes() == np.ascontiguousarray(values).tobytes()


@pytest.mark.parametrize(
    "values",
    [np.zeros((2, 3), np.float32), np.zeros((2, 3), int), np.array([None]), np.zeros(3),
     np.asfortranarray(np.ones((2, 3)))],
)  # fmt: skip
def test_other_arrays_are_refused(values, tmp_path):
    np.save(tmp_path / "a.npy", values, allow_pickle=True)
    with pytest.raises(BundleError) as refused:
        unpack((tmp_path / "a.npy").read_bytes(), "a.npy", (None, 3))
    assert refused.value.code is Code.BAD_ACTION


# ------------------------------------------------------------------------------ bundles


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("bundles")


@pytest.fixture(scope="module")
def policy(folder):
    return policy_bundle(folder, training={"hours": 2})


def test_what_a_manifest_says(policy):
    bundle = Bundle(policy)
    said = bundle.manifest
    assert set(said) == set(KEYS)
    assert (said["track"], said["problem"]) == POLICY
    assert said["spec"]["environment"]["id"] == "ves/PumaRestToRest-v0"
    assert said["spec"]["environment"]["version"] == 0
    assert said["seeds"]["list"] == list(range(19_940_000, 19_940_010))
    assert said["members"].keys() == bundle.members.keys() - {MANIFEST}
    for name, told in said["members"].items():
        assert told == {
            "bytes": len(bundle.members[name]),
            "sha256": digest(bundle.members[name]),
        }
    assert said["method"]["weights"] == [digest(bundle.members["policy.safetensors"])]
    about = said["about"]
    assert about["training"] == {"hours": 2} and about["begun"] <= about["ended"]
    assert about["versions"]["numpy"] == np.__version__ and about["simd"] and about["cpu"]
    text = bundle.members[MANIFEST].decode()
    assert text == canonical_json(said) + "\n"
    assert read_manifest(bundle.members[MANIFEST]) == said
    assert sealed(said) == bundle.members[MANIFEST]


def test_no_path_of_this_machine_is_told(policy, folder):
    for data in Bundle(policy).members.values():
        assert str(folder).encode() not in data and os.getcwd().encode() not in data


def test_the_same_members_make_the_same_zip(policy, tmp_path):
    members = read_members(policy)
    assert write_members(tmp_path / "b.zip", members).read_bytes() == policy.read_bytes()
    assert read_members(write_members(tmp_path / "b", members)) == members


def test_a_folder_in_use_is_left_alone(policy, tmp_path):
    (tmp_path / "x").write_text("mine")
    with pytest.raises(ParameterError, match="empty folder"):
        write_members(tmp_path, read_members(policy))
    assert [p.name for p in tmp_path.iterdir()] == ["x"]


def test_runs_are_the_same_but_for_their_times(policy, folder):
    again = Bundle(policy_bundle(folder, name="again.zip", training={"hours": 2}))
    first = Bundle(policy)
    for bundle in (again, first):
        for key in ("begun", "ended"):
            del bundle.manifest["about"][key]
        del bundle.manifest["seal"]
    assert again.manifest == first.manifest
    assert again.members["actions.npy"] == first.members["actions.npy"]


def test_names_that_a_bundle_may_hold():
    names = [n for g in range(protocol.MOST_GROUPS) for n in policy_names(g)]
    assert len(set(names)) == 2 * protocol.MOST_GROUPS
    assert all(limit(n) for n in (*names, *LIMITS))
    for name in ("policy-0.json", "policy-16.json", "policy.pkl", "../policy.json", "", "a/b"):
        assert limit(name) is None


def test_sizes_are_bounded(tmp_path, monkeypatch):
    from ves_gym.leaderboard import archive

    monkeypatch.setitem(archive.LIMITS, "actions.npy", 10)
    with zipfile.ZipFile(tmp_path / "b.zip", "w") as file:
        file.writestr("actions.npy", b"x" * 11)
    (tmp_path / "b").mkdir()
    (tmp_path / "b/actions.npy").write_bytes(b"x" * 11)
    monkeypatch.setattr(archive, "TOTAL", 500)
    (tmp_path / "c.zip").write_bytes(b"x" * 501)
    for name in ("b.zip", "b", "c.zip"):
        with pytest.raises(BundleError) as refused:
            read_members(tmp_path / name)
        assert refused.value.code is Code.UNSAFE_ARCHIVE


# ------------------------------------------------------------------------- fingerprints


def test_environments_and_models_are_told_apart():
    ids = problems("policies")[::2]
    found = [fingerprint.environment(id) for id in ids]
    assert len({f["spec"] for f in found}) == len(ids)
    beam, other = System(vehicle=BENT_THESIS), System(vehicle=BENT_THESIS, physics_dt=2.5e-3)
    assert fingerprint.model_xml(beam) != fingerprint.model_xml(other)
    assert fingerprint.model_xml(beam) == fingerprint.model_xml(System(vehicle=BENT_THESIS))


def test_paths_without_any_answer(folder):
    """A planner that never finds anything still makes a bundle of failures."""
    from ves_gym.leaderboard.verify import verify
    from ves_gym.planners.query import NoPlan

    class Mute:
        name, summary = "mute", "nothing"

        def find(self, query, seed):
            raise NoPlan("nothing")

    entry = verify(path_bundle(folder, name="mute", method=Mute()))
    assert [r["score"] for r in entry.rows] == [None] * 10
    assert stat.S_ISDIR((folder / "mute").stat().st_mode)
