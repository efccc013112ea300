"""Every change to a bundle is found, and called by its name.

Two ways to tamper: the careless forger changes a file and leaves the digests, the careful one
brings all of them up to date. The first never gets past a digest. The second is caught by what
is computed here, but for what is only told (DECLARED): author, machine, times and the like,
which no replay can know. Against the digest on the board (`expect`) even that shows. A number
of a row that is worse than it was changes nothing: the entry has the verifier's.
"""

import copy
import io
import os
import stat
import zipfile

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.leaderboard.bundles import (
    Bundle,
    changed,
    get,
    leaves,
    path_bundle,
    policy_bundle,
    put,
)
from ves_gym.leaderboard.archive import MANIFEST, read_members
from ves_gym.leaderboard.bundle import digest
from ves_gym.leaderboard.errors import BundleError, Code
from ves_gym.leaderboard.npy_io import pack, unpack
from ves_gym.leaderboard.verify import verify

DECLARED = ("name", "author", "about")
_ROW = {
    "id": Code.EXTRA_EPISODE,
    "seed": Code.WRONG_SEEDS,
    "group": Code.EXTRA_EPISODE,
    "length": Code.EPISODE_LENGTH,
}
_FIELDS = {
    "schema": Code.MALFORMED_MANIFEST,
    "track": Code.UNKNOWN_PROBLEM,
    "protocol": Code.OLD_PROTOCOL,
    "problem": Code.UNKNOWN_PROBLEM,
    "kind": Code.MALFORMED_MANIFEST,
    "seeds.which": Code.MALFORMED_MANIFEST,
    "seeds.mark": Code.MALFORMED_MANIFEST,
    "seeds.list": Code.WRONG_SEEDS,
    "spec.environment": Code.OLD_ENVIRONMENT,
    "spec.system": Code.SYSTEM_MISMATCH,
    "spec.evaluator": Code.EVALUATOR_MISMATCH,
    "method.name": Code.MALFORMED_MANIFEST,
    "method.architecture": Code.UNKNOWN_ARCHITECTURE,
    "method.weights": Code.HASH_MISMATCH,
    "method.settings": Code.MALFORMED_MANIFEST,
    "members": Code.HASH_MISMATCH,
    "about.begun": Code.MALFORMED_MANIFEST,
    "about.ended": Code.MALFORMED_MANIFEST,
}


def expected(path):
    """The code for a field changed by the careful forger; None where it is only told."""
    name = ".".join(str(k) for k in path)
    if path[0] == "rows":
        return _ROW.get(path[2])
    if name.startswith("method.seeds") or name == "spec.model":
        return (
            None  # of a policy: which of several trainings; the entry has the verifier's model
        )
    for prefix, code in _FIELDS.items():
        if name == prefix or name.startswith(prefix + "."):
            return code
    return None if path[0] in DECLARED else Code.MALFORMED_MANIFEST


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("bundles")


@pytest.fixture(scope="module")
def policy(folder):
    return policy_bundle(folder)


@pytest.fixture(scope="module")
def paths(folder):
    return path_bundle(folder)


@pytest.fixture
def refused(tmp_path):
    """The code that a bundle is refused with, None if it is not."""

    def check(bundle, *, seal=True, manifest=False, **options):
        place = tmp_path / f"{len(list(tmp_path.iterdir()))}.zip"
        write = bundle.write_manifest if manifest else bundle.write
        write(place, seal=seal)
        return code_of(place, **options)

    return check


def code_of(place, rows=None, **options):
    """The code of a refusal; None of an entry, with `rows` if they are asked for."""
    try:
        entry = verify(place, **options)
        assert rows is None or entry.rows == rows
    except BundleError as error:
        assert str(error).startswith(error.code.slug + ": ") and "\n" not in str(error)
        return error.code
    return None


# --------------------------------------------------------------------------- manifest


@pytest.mark.parametrize("which", ["policy", "paths"])
def test_every_field_changed_without_the_seal_is_a_hash_mismatch(which, request, refused):
    bundle = Bundle(request.getfixturevalue(which))
    whole, fields = bundle.manifest, list(leaves(bundle.manifest))
    assert len(fields) > 150
    wrong = {}
    for path in fields:
        bundle.manifest = copy.deepcopy(whole)
        put(bundle.manifest, path, changed(get(whole, path)))
        code = refused(bundle, seal=False, manifest=True)
        wanted = Code.MALFORMED_MANIFEST if path == ("schema",) else Code.HASH_MISMATCH
        if code is not wanted:
            wrong[path] = code
    assert wrong == {}


def forged(path, fields, refused):
    """Fields that are not answered with their code when changed and sealed again."""
    wrong, known = {}, digest(read_members(path)[MANIFEST])
    told = Bundle(path)  # with everything changed that is only told
    claims = [f for f in fields if f[0] == "rows" and expected(f) is None]
    fields = [f for f in fields if f not in claims]
    for field in claims:
        bundle = Bundle(path)
        put(bundle.manifest, field, changed(get(bundle.manifest, field)))
        if (code := refused(bundle, manifest=True, expect=known)) is not Code.HASH_MISMATCH:
            wrong[field] = code
        code = refused(bundle, manifest=True, rows=verify(path).rows)
        if code not in (None, Code.SCORE_DIFFERS, Code.BELOW_FLOOR):
            wrong[field] = code
    for field in fields:
        bundle = Bundle(path)
        value = changed(get(bundle.manifest, field))
        put(bundle.manifest, field, value)
        if expected(field) is None:
            put(told.manifest, field, value)
            code = refused(bundle, manifest=True, expect=known)
            if code is not Code.HASH_MISMATCH:
                wrong[field] = code
        elif (code := refused(bundle, manifest=True)) is not expected(field):
            wrong[field] = code
    if (code := refused(told, manifest=True)) is not None:
        wrong["told"] = code
    return wrong


def sealed_fields(path, rows):
    """Every field but the seal; of the rows only some."""
    fields = list(leaves(Bundle(path).manifest))
    return [f for f in fields if f[0] != "seal" and (f[0] != "rows" or f[1] in rows)]


def test_every_field_changed_and_sealed_again_is_called_by_its_name(policy, refused):
    fields = sealed_fields(policy, rows=(0,))
    assert len(fields) > 60
    assert forged(policy, fields, refused) == {}


@pytest.mark.slow
def test_every_field_of_every_row_changed_and_sealed_again(policy, refused):
    fields = [f for f in sealed_fields(policy, rows=range(10)) if f[0] == "rows"]
    assert len(fields) == 10 * 13
    assert forged(policy, fields, refused) == {}


@pytest.mark.slow
def test_every_field_of_a_path_changed_and_sealed_again(paths, refused):
    fields = [f for f in sealed_fields(paths, rows=(3,)) if f[0] == "rows"]
    told = [f for f in fields if f[2] in ("seconds", "evaluations", "anytime")]
    assert forged(paths, [f for f in fields if f not in told], refused) == {}
    for field in told:  # of the planner's own run, which no replay sees
        bundle = Bundle(paths)
        put(bundle.manifest, field, changed(get(bundle.manifest, field)))
        assert refused(bundle, manifest=True) in (None, Code.MALFORMED_MANIFEST)


@pytest.mark.parametrize("name", ["score", "E_mean", "E_peak", "E_res", "success"])
def test_a_claim_better_than_the_replay(name, policy, refused):
    bundle = Bundle(policy)
    row = bundle.manifest["rows"][0]
    row[name] = (not row[name]) if name == "success" else row[name] * (1 - 1e-5)
    found = refused(bundle, manifest=True)
    improved = name != "success" or row[name]
    assert found in ((Code.SCORE_DIFFERS, Code.BELOW_FLOOR) if improved else (None,))


def test_a_manifest_of_other_shape_is_malformed(policy, refused):
    def with_(**changes):
        bundle = Bundle(policy)
        bundle.manifest |= changes
        return refused(bundle, manifest=True)

    assert with_(extra=1) is Code.MALFORMED_MANIFEST
    assert with_(rows={}) is Code.MALFORMED_MANIFEST
    assert with_(about=[]) is Code.MALFORMED_MANIFEST
    assert with_(name="two\nlines") is Code.MALFORMED_MANIFEST
    bundle = Bundle(policy)
    del bundle.manifest["method"]["weights"]
    assert refused(bundle, manifest=True) is Code.MALFORMED_MANIFEST
    bundle = Bundle(policy)
    bundle.manifest["about"]["training"] = {"deep": [[[[[[[[[[1]]]]]]]]]]}
    assert refused(bundle, manifest=True) is Code.MALFORMED_MANIFEST


@pytest.mark.parametrize(
    "text",
    [
        b"",
        b"[]",
        b"null",
        b"{",
        b"\xff\xfe",
        b"[" * 100_000,
        b'{"a":' * 50_000 + b"1" + b"}" * 50_000,
        b'{"schema":"ves-bundle/1","schema":"ves-bundle/1"}\n',
        b'{"schema":"ves-bundle/1","x":NaN}\n',
        b'{"schema":"ves-bundle/1","x":1e999}\n',
        b'{"schema":"ves-bundle/1","x":' + b"9" * 5000 + b"}\n",
        b'{"schema": "ves-bundle/1"}\n',
    ],
)
def test_a_text_that_is_no_manifest(text, policy, tmp_path):
    bundle = Bundle(policy)
    place = tmp_path / "b.zip"
    with zipfile.ZipFile(place, "w") as archive:
        for name, data in {**bundle.members, MANIFEST: text}.items():
            archive.writestr(name, data)
    assert code_of(place) is Code.MALFORMED_MANIFEST


def test_rows_left_out_doubled_or_out_of_order(policy, refused):
    def with_(rows):
        bundle = Bundle(policy)
        bundle.manifest["rows"] = rows(bundle.manifest["rows"])
        return refused(bundle, manifest=True)

    assert with_(lambda r: r[:-1]) is Code.MISSING_EPISODE
    assert with_(lambda r: []) is Code.MISSING_EPISODE
    assert with_(lambda r: [*r, r[0]]) is Code.EXTRA_EPISODE
    assert with_(lambda r: [*r[:-1], r[0]]) is Code.EXTRA_EPISODE
    assert with_(lambda r: [*r, {**r[0], "id": "episode-010"}]) is Code.EXTRA_EPISODE
    assert with_(lambda r: r[::-1]) is Code.MALFORMED_MANIFEST


def test_other_seeds(policy, refused):
    """A better set of episodes, told as official ones or simply shifted."""
    bundle = Bundle(policy)
    bundle.manifest["seeds"]["list"] = [k + 10 for k in bundle.manifest["seeds"]["list"]]
    for row in bundle.manifest["rows"]:
        row["seed"] += 10
    assert refused(bundle, manifest=True) is Code.WRONG_SEEDS
    bundle.manifest["seeds"] |= {"which": "official", "mark": "0" * 64}
    assert refused(bundle, manifest=True, salt="a secret of the maintainer") is Code.WRONG_SEEDS


def test_an_energy_below_what_physics_permits(policy, paths, refused):
    bundle = Bundle(policy)
    bundle.manifest["rows"][0]["E_mean"] = -1.0
    assert refused(bundle, manifest=True) is Code.BELOW_FLOOR
    bundle = Bundle(policy)
    row = bundle.manifest["rows"][0]
    row["E_res"] = 2 * row["E_peak"]
    assert refused(bundle, manifest=True) is Code.BELOW_FLOOR
    bundle = Bundle(paths)
    bundle.manifest["rows"][0] |= {"E_mean": 1e-14, "score": 1e-12}
    assert refused(bundle, manifest=True) is Code.BELOW_FLOOR


# ---------------------------------------------------------------------- what is replayed


def test_a_changed_action(policy, refused):
    def with_(change):
        bundle = Bundle(policy)
        actions = unpack(bundle.members["actions.npy"], "actions.npy", (None, 3)).copy()
        bundle.members["actions.npy"] = pack(change(actions))
        return refused(bundle)

    def at(value):
        def change(actions):
            actions[7, 1] = value
            return actions

        return change

    assert with_(lambda a: a) is None  # nothing changed
    assert with_(at(0.987)) is Code.SCORE_DIFFERS
    assert with_(at(np.nan)) is Code.BAD_ACTION
    assert with_(at(np.inf)) is Code.BAD_ACTION
    assert with_(at(1.0001)) is Code.BAD_ACTION
    assert with_(at(-2.0)) is Code.BAD_ACTION
    assert with_(lambda a: a[:-1]) is Code.EPISODE_LENGTH
    assert with_(lambda a: np.r_[a, a[:1]]) is Code.EPISODE_LENGTH
    assert with_(lambda a: a[:, :2]) is Code.BAD_ACTION
    assert with_(lambda a: a[::-1]) is Code.SCORE_DIFFERS


def test_a_changed_action_without_new_digests(policy, refused):
    bundle = Bundle(policy)
    data = bytearray(bundle.members["actions.npy"])
    data[-3] ^= 1
    bundle.members["actions.npy"] = bytes(data)
    assert refused(bundle, seal=False) is Code.HASH_MISMATCH


def test_an_episode_of_other_length(policy, refused):
    """Actions moved from one episode to the next: their number is the same in all."""
    bundle = Bundle(policy)
    bundle.manifest["rows"][0]["length"] -= 1
    bundle.manifest["rows"][1]["length"] += 1
    assert refused(bundle, manifest=True) is Code.EPISODE_LENGTH


def test_a_changed_motion(paths, refused):
    def with_(change):
        bundle = Bundle(paths)
        points = unpack(bundle.members["motions.npy"], "motions.npy", (None, 3)).copy()
        bundle.members["motions.npy"] = pack(change(points))
        return refused(bundle)

    def moved(k, size):
        def change(points):
            points[k] += size
            return points

        return change

    assert with_(moved(0, 1e-3)) is Code.BAD_ACTION  # no rest at the start
    assert with_(moved(slice(0, 6), 1e-3)) is Code.SCORE_DIFFERS  # joins other ends
    assert with_(lambda p: p[:-1]) is Code.EPISODE_LENGTH
    assert with_(lambda p: p * np.nan) is Code.BAD_ACTION


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\x93NUMPY\x01\x00",
        b"\x93NUMPY\x01\x00\xff\xff" + b" " * 100,
        b"\x80\x04\x95",  # a pickle
        b"\x93NUMPY\x01\x00\x46\x00{'descr': '|O', 'fortran_order': False, 'shape': (1, 3), }"
        + b" " * 9,
        b"\x93NUMPY\x01\x00\x56\x00"
        b"{'descr': '<f8', 'fortran_order': False, 'shape': (1099511627775, 3), }".ljust(86),
    ],
)
def test_an_array_that_is_none(data, policy, refused):
    bundle = Bundle(policy)
    bundle.members["actions.npy"] = data
    assert refused(bundle) is Code.BAD_ACTION


# ------------------------------------------------------------------------------ weights


def test_a_byte_of_the_weights(policy, refused):
    """A change that every digest knows of still is another policy than the one that acted."""
    bundle = Bundle(policy)
    good = bundle.members["policy.safetensors"]
    flipped = good[:-2] + bytes([good[-2] ^ 0x40]) + good[-1:]
    bundle.members["policy.safetensors"] = flipped
    assert refused(bundle, seal=False) is Code.HASH_MISMATCH
    assert refused(bundle) is Code.HASH_MISMATCH  # the method names others
    bundle.manifest["method"]["weights"] = [digest(flipped)]
    assert refused(bundle) is Code.BAD_WEIGHTS  # policy.json names others
    text = bundle.members["policy.json"].decode()
    bundle.members["policy.json"] = text.replace(digest(good), digest(flipped)).encode()
    assert refused(bundle) is None  # replayed: the actions are what they were
    assert refused(bundle, level="reproduced") is Code.NOT_REPRODUCED


@pytest.mark.parametrize("spoil", ["header", "length", "nan", "pickle", "empty"])
def test_weights_that_cannot_be_read(spoil, policy, refused):
    bundle = Bundle(policy)
    good = bundle.members["policy.safetensors"]
    data = {
        "header": good[:8] + b"[" + good[9:],
        "length": b"\xff" * 8 + good[8:],
        "nan": good[:-4] + np.float32(np.nan).tobytes(),
        "pickle": b"\x80\x04\x95\x00\x00\x00\x00\x00\x00\x00\x00.",
        "empty": b"",
    }[spoil]
    bundle.members["policy.safetensors"] = data
    bundle.manifest["method"]["weights"] = [digest(data)]
    text = bundle.members["policy.json"].decode()
    bundle.members["policy.json"] = text.replace(digest(good), digest(data)).encode()
    assert refused(bundle) is Code.BAD_WEIGHTS


@pytest.mark.parametrize(
    ("old", "new", "code"),
    [
        (b'"activation": "tanh"', b'"activation": "eval"', Code.UNKNOWN_ARCHITECTURE),
        (b'"output": "clip"', b'"output": "none"', Code.UNKNOWN_ARCHITECTURE),
        (b"ves-policy/1", b"ves-policy/9", Code.UNKNOWN_ARCHITECTURE),
        (b'"sizes": [', b'"sizes": [[', Code.BAD_WEIGHTS),
        (b'"network"', b'"netware"', Code.BAD_WEIGHTS),
        (b'"hold": 8', b'"hold": 0', Code.BAD_WEIGHTS),
    ],
)
def test_another_architecture(old, new, code, policy, refused):
    bundle = Bundle(policy)
    before = bundle.members["policy.json"]
    after = before.replace(old, new)
    assert after != before
    bundle.members["policy.json"] = after
    assert refused(bundle) is code


# ------------------------------------------------------------------------------ archive


def write_zip(place, members, **attributes):
    """A .zip of (name, data) pairs, as they are."""
    with zipfile.ZipFile(place, "w") as archive:
        for name, data in members:
            info = zipfile.ZipInfo(name)
            for key, value in attributes.get(name, {}).items():
                setattr(info, key, value)
            archive.writestr(info, data)
    return place


@pytest.mark.parametrize(
    "name",
    ["../actions.npy", "/actions.npy", "a/actions.npy", "ACTIONS.NPY", "actions.npy ", "C:x",
     "..\\actions.npy", "actions.npy/", ".", "policy-16.json", "policy-0.json", "x.pkl", "é"],
)  # fmt: skip
def test_a_path_in_the_archive(name, policy, tmp_path):
    members = Bundle(policy).members
    pairs = [(name if k == "actions.npy" else k, v) for k, v in members.items()]
    assert code_of(write_zip(tmp_path / "b.zip", pairs)) is Code.UNSAFE_ARCHIVE
    pairs = [*members.items(), (name, b"")]
    assert code_of(write_zip(tmp_path / "c.zip", pairs)) is Code.UNSAFE_ARCHIVE


def test_members_left_out_or_too_many(policy, refused):
    for name in ("actions.npy", "policy.json", "policy.safetensors"):
        for seal in (False, True):
            bundle = Bundle(policy)
            del bundle.members[name]
            assert refused(bundle, seal=seal) is Code.MISSING_MEMBER
    for seal in (False, True):
        bundle = Bundle(policy)
        bundle.members["motions.npy"] = b""
        assert refused(bundle, seal=seal) is Code.EXTRA_MEMBER


def test_no_manifest(policy, tmp_path):
    members = Bundle(policy).members
    del members[MANIFEST]
    place = write_zip(tmp_path / "b.zip", members.items())
    assert code_of(place) is Code.MISSING_MEMBER


def test_links_doubles_and_encryption(policy, tmp_path):
    members = list(Bundle(policy).members.items())
    link = {"external_attr": (stat.S_IFLNK | 0o777) << 16}
    place = write_zip(tmp_path / "a.zip", members, **{"actions.npy": link})
    assert code_of(place) is Code.UNSAFE_ARCHIVE
    with pytest.warns(UserWarning, match="Duplicate"):
        place = write_zip(tmp_path / "b.zip", [*members, members[0]])
    assert code_of(place) is Code.UNSAFE_ARCHIVE
    data = bytearray((write_zip(tmp_path / "c.zip", members)).read_bytes())
    at = data.rindex(b"PK\x01\x02")
    data[at + 8] |= 1  # the flag of an encrypted member
    (tmp_path / "c.zip").write_bytes(data)
    assert code_of(tmp_path / "c.zip") is Code.UNSAFE_ARCHIVE


def test_a_list_of_very_many_members_is_not_read(tmp_path, monkeypatch):
    """Refused by the record at its end, and by the list's length where that one lies."""
    place = tmp_path / "many.zip"
    with zipfile.ZipFile(place, "w") as archive:
        for k in range(5000):
            archive.writestr(f"m{k}", b"")
    monkeypatch.setattr(zipfile, "ZipFile", None)
    assert code_of(place) is Code.UNSAFE_ARCHIVE
    data = bytearray(place.read_bytes())
    at = data.rindex(b"PK\x05\x06")
    data[at + 8 : at + 12] = (5).to_bytes(2, "little") * 2
    place.write_bytes(data)
    assert code_of(place) is Code.UNSAFE_ARCHIVE


def test_a_bomb(policy, tmp_path):
    """A gigabyte of zeros in a megabyte: refused by what it says, and by what it is."""
    members = Bundle(policy).members
    place = tmp_path / "b.zip"
    with zipfile.ZipFile(place, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in members.items():
            if name != "actions.npy":
                archive.writestr(name, data)
        with archive.open("actions.npy", "w", force_zip64=True) as file:
            for _ in range(160):
                file.write(bytes(2**20))
    assert code_of(place) is Code.UNSAFE_ARCHIVE
    data = bytearray(place.read_bytes())
    at = data.rindex(b"PK\x01\x02")
    data[at + 24 : at + 28] = (1000).to_bytes(4, "little")  # its size, a lie
    place.write_bytes(data)
    assert code_of(place) is Code.UNSAFE_ARCHIVE


def test_a_folder_with_links_pipes_and_folders(policy, tmp_path):
    def with_(name, make):
        folder = tmp_path / name
        folder.mkdir()
        for key, data in Bundle(policy).members.items():
            (folder / key).write_bytes(data)
        make(folder)
        return code_of(folder)

    def linked(folder):
        (folder / "actions.npy").rename(tmp_path / "elsewhere.npy")
        (folder / "actions.npy").symlink_to(tmp_path / "elsewhere.npy")

    def piped(folder):
        (folder / "actions.npy").unlink()
        os.mkfifo(folder / "actions.npy")

    def nested(folder):
        (folder / "actions.npy").unlink()
        (folder / "actions.npy").mkdir()

    assert with_("good", lambda folder: None) is None
    assert with_("linked", linked) is Code.UNSAFE_ARCHIVE
    assert with_("piped", piped) is Code.UNSAFE_ARCHIVE
    assert with_("nested", nested) is Code.UNSAFE_ARCHIVE
    assert with_("more", lambda f: (f / "x.py").write_text("")) is Code.UNSAFE_ARCHIVE


# --------------------------------------------------------------------------------- fuzz

FUZZ = settings(
    max_examples=80, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


@pytest.fixture
def guarded(tmp_path):
    """Verify in a folder of its own; nothing else may appear in it."""

    def check(write):
        place = tmp_path / "fuzz.zip"
        write(place)
        before = sorted(p.name for p in tmp_path.iterdir())
        code_of(place)  # a BundleError or nothing: anything else fails the test
        assert sorted(p.name for p in tmp_path.iterdir()) == before

    return check


@FUZZ
@given(data=st.binary(max_size=2000))
def test_fuzzed_files(guarded, data):
    guarded(lambda place: place.write_bytes(data))


@FUZZ
@given(
    edits=st.lists(st.tuples(st.floats(0, 1, exclude_max=True), st.integers(0, 255)),
                   min_size=1, max_size=8),
    cut=st.floats(0, 1),
)  # fmt: skip
def test_fuzzed_archives(guarded, policy, edits, cut):
    """Bytes of the archive's own records, at its end, and anywhere."""
    good = policy.read_bytes()

    def write(place):
        data = bytearray(good)
        for where, value in edits:
            near_end = int(where * 600) if value % 2 else int(where * len(data))
            data[-1 - near_end % len(data)] = value
        place.write_bytes(data[: int(cut * len(data))] if cut < 0.2 else data)

    guarded(write)


_JUNK = st.one_of(
    st.none(), st.booleans(), st.integers(-(2**70), 2**70), st.floats(allow_nan=False,
    allow_infinity=False), st.text(max_size=40), st.just([]), st.just({}), st.just([[]]),
    st.dictionaries(st.text(max_size=5), st.integers(), max_size=2),
)  # fmt: skip


@FUZZ
@given(where=st.floats(0, 1, exclude_max=True), depth=st.integers(1, 4), junk=_JUNK)
def test_fuzzed_manifests(guarded, policy, where, depth, junk):
    """Anything at any place of the manifest, sealed as a forger would.

    Places that only the replay can judge are left to the tests above: they take its time.
    """
    bundle = Bundle(policy)
    fields = [f for f in leaves(bundle.manifest) if f[0] not in ("about", "name", "author")]
    path = fields[int(where * len(fields))][:depth]
    put(bundle.manifest, path, junk)
    if isinstance(junk, (int, float)) and path[0] == "rows" and len(path) == 3:
        return
    guarded(lambda place: bundle.write_manifest(place))


@FUZZ
@given(name=st.text(max_size=30), data=st.binary(max_size=50))
def test_fuzzed_names(guarded, policy, name, data):
    members = list(Bundle(policy).members.items())
    whole = io.BytesIO()
    try:
        write_zip(whole, [*members, (name, data)])
    except (ValueError, UnicodeError, OSError, UserWarning):
        return  # zipfile will not write such a name
    guarded(lambda place: place.write_bytes(whole.getvalue()))


@FUZZ
@given(data=st.binary(max_size=300), head=st.booleans())
def test_fuzzed_arrays(data, head):
    given_ = b"\x93NUMPY\x01\x00" + data if head else data
    with pytest.raises(BundleError):
        unpack(given_, "actions.npy", (None, 3))


@pytest.mark.parametrize(
    "control",
    [
        {"kind": "guided", "jerk": 1e300},
        {"kind": "torque", "fraction": 1e300},
        {"kind": "torque", "damping": [1e300] * 3},
        {"kind": "torque", "damping": [1.0]},
        {"kind": "pd_gains"},
        {"kind": "magic"},
        {"kind": []},
        "module:Class",
        7,
    ],
)
def test_controls_out_of_all_proportion(control, policy, refused):
    bundle = Bundle(policy)
    bundle.manifest["method"]["settings"] = {"control": control}
    assert refused(bundle) is not None


def test_settings_that_are_not_the_methods_to_choose(policy, refused):
    for given_ in ({"duration": 4.0}, {"system": {}}, {"goal": 1}, {"goal": True}):
        bundle = Bundle(policy)
        bundle.manifest["method"]["settings"] = given_
        assert refused(bundle) is Code.MALFORMED_MANIFEST
