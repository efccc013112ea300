"""An entry's files: read whole or refused, whatever is in them; nothing is run."""

import copy
import json
import os
import pickle

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.leaderboard.entries import Spoiled, code_of, made_entry, noisy
from ves_gym._util.params import ParameterError
from ves_gym.leaderboard import verify
from ves_gym.leaderboard.entry import LARGEST, Code, Refused, from_bytes, require_name, to_bytes
from ves_gym.leaderboard.files import ENTRY, RECORDING, pack, read_files, unpack, write_files

MISSING = object()


def malformed(data):
    with pytest.raises(Refused) as refused:
        from_bytes(data)
    assert refused.value.code is Code.MALFORMED_ENTRY
    return str(refused.value)


def test_an_entry_comes_back_rounded():
    entry = made_entry(scores=[0.12345678, None, 3.0], track="tasks", kind="controller")
    found = from_bytes(to_bytes(entry))
    assert found.results["score"].tolist() == [[0.12346, np.inf, 3.0]]
    assert found.results["E_mean"].tolist() == [[0.2469, np.inf, 6.0]]
    assert to_bytes(found) == to_bytes(entry) and found.method == entry.method


def test_five_trainings_on_a_hundred_episodes_fit_and_more_are_refused():
    scores = [noisy(1e-2, seed=k) for k in range(5)]
    assert len(to_bytes(made_entry(scores=scores, kind="policy"))) <= LARGEST
    with pytest.raises(ParameterError, match="fewer seeds"):
        to_bytes(made_entry(scores=[noisy(1.0, seed=k) for k in range(12)], kind="policy"))
    assert "at most" in malformed(b" " * (LARGEST + 1))


@pytest.mark.parametrize(
    ("place", "value", "why"),
    [
        (("schema",), "ves-entry/9", "schema"),
        (("track",), "speed", "track"),
        (("problem",), 7, "problem"),
        (("name",), "a\nb", "name"),
        (("author",), "", "author"),
        (("level",), "believed", "level"),
        (("seeds",), "mine", "seeds"),
        (("method", "kind"), "human", "kind"),
        (("method", "seeds"), [], "seeds"),
        (("method", "seeds"), list(range(17)), "seeds"),
        (("method", "weights"), ["ab"], "weights"),
        (("method", "name"), "os.system", "name"),
        (("results", "score"), [], "score"),
        (("results", "score", 0), [0.1], "equal length"),
        (("results", "score", 0, 0), True, "numbers"),
        (("results", "E_mean", 0, 0), -0.1, "not negative"),
        (("results", "E_mean", 0, 0), 1e301, "finite"),
        (("results", "success", 0, 0), 0.5, "0 or 1"),
        (("results", "speed"), [[1.0]], "results"),
        (("more",), 1, "more"),
        (("method",), MISSING, "method"),
    ],
)
def test_an_entry_that_is_none(place, value, why):
    plain = json.loads(to_bytes(made_entry()))
    inner = plain
    for key in place[:-1]:
        inner = inner[key]
    inner[place[-1]] = value
    if value is MISSING:
        del inner[place[-1]]
    assert why in malformed(json.dumps(plain).encode())


def test_what_is_told_is_no_deeper_than_it_can_be_written():
    text = to_bytes(made_entry()).decode()
    for depth in (100, 400, 900, 5000):
        deep = '"about":{"a":' + "[" * depth + "]" * depth + ',"versions"'
        data = text.replace('"about":{"versions"', deep).encode()
        try:
            from_bytes(data)
        except Refused as error:
            assert error.code is Code.MALFORMED_ENTRY and depth > 100


@pytest.mark.parametrize(
    "text",
    [b"", b"[]", b"null", b"{", b"\xff\xfe", b"[" * 9000, b'{"a":' * 3000 + b"1" + b"}" * 3000,
     b'{"schema":"ves-entry/1","schema":"ves-entry/1"}', b'{"x":NaN}', b'{"x":1e999}',
     b'{"x":' + b"9" * 5000 + b"}", b"\x80\x04\x95"],
)  # fmt: skip
def test_a_text_that_is_no_entry(text):
    malformed(text)


def test_names_that_could_be_taken_for_others():
    assert require_name("a-b-2", "name") == "a-b-2"
    for name in ("", "A", "a_b", "-a", "a--b", "a ", "vés", "\u0430", "a/b", "..", "a" * 41):
        with pytest.raises(ParameterError, match="name must be of a-z"):
            require_name(name, "name")


def test_the_file_of_an_entry_is_nobody_elses():
    files = {
        made_entry(**more).file
        for more in (
            {}, {"author": "other"}, {"name": "direct"}, {"problem": "bent-1s"},
            {"track": "damping"}, {"seeds": "official-0123456789abcdef"},
            {"name": "b", "author": "a-b"}, {"name": "b-b", "author": "a"},
        )
    }  # fmt: skip
    assert len(files) == 8
    assert "paths_bent-2s_ves-gym_refined.json" in files


# -------------------------------------------------------------------------- folders


def test_a_folder_in_use_is_left_alone(tmp_path):
    (tmp_path / "x").write_text("mine")
    with pytest.raises(ParameterError, match="empty folder"):
        write_files(tmp_path, {ENTRY: b""})
    assert [p.name for p in tmp_path.iterdir()] == ["x"]


def test_what_a_killed_run_left_is_replaced(tmp_path):
    for name in (RECORDING, f".{ENTRY}.x1y2"):
        (tmp_path / name).write_text("half")
    write_files(tmp_path, {ENTRY: b"whole"})
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == {ENTRY: b"whole"}


def test_a_folder_in_use_is_refused_before_the_work(tmp_path, monkeypatch):
    (tmp_path / ENTRY).write_text("{}")
    monkeypatch.setattr(verify, "enter", None)  # the work
    with pytest.raises(ParameterError, match="empty folder"):
        verify.make_entry(tmp_path, "paths", "bent-2s-quick", "straight")


def test_what_is_not_there_is_bad_usage(tmp_path):
    for place in (tmp_path / "none", tmp_path):
        with pytest.raises(ParameterError, match=ENTRY):
            read_files(place)


def test_a_folder_with_links_pipes_folders_and_more(own, tmp_path):
    def with_(name, make):
        folder = Spoiled(own).write(tmp_path / name)
        make(folder)
        return code_of(folder)

    def linked(folder):
        (folder / RECORDING).rename(tmp_path / "elsewhere")
        (folder / RECORDING).symlink_to(tmp_path / "elsewhere")

    def piped(folder):
        (folder / RECORDING).unlink()
        os.mkfifo(folder / RECORDING)

    def nested(folder):
        (folder / RECORDING).unlink()
        (folder / RECORDING).mkdir()

    def large(folder):
        (folder / ENTRY).write_bytes(b" " * (LARGEST + 1))

    assert with_("good", lambda folder: None) is None
    for make in (linked, piped, nested, large):
        assert with_(make.__name__, make) is Code.UNSAFE_FILE
    for k, name in enumerate(("x.py", "policy-16.json", "policy-0.pkl", "entry.json.bak")):
        code = with_(f"more{k}", lambda folder, name=name: (folder / name).write_text(""))
        assert code is Code.UNSAFE_FILE


# ------------------------------------------------------------------------ recordings


def test_recordings_keep_every_bit():
    rng = np.random.default_rng(0)
    recording = [[rng.normal(size=(k, 3)) for k in (0, 5)] for _ in range(2)]
    for ours, theirs in zip(recording, unpack(pack(recording), 2, 2, (3,)), strict=True):
        for a, b in zip(ours, theirs, strict=True):
            assert a.shape == b.shape and a.tobytes() == b.tobytes()


def refusal(data, groups=1, count=2):
    with pytest.raises(Refused) as refused:
        unpack(data, groups, count, (3,))
    return refused.value.code


def test_other_recordings_are_refused():
    two = [[np.zeros((4, 3))] * 2]
    assert refusal(pack(two), count=3) is refusal(pack(two), groups=2) is Code.WRONG_LENGTH
    assert refusal(pack([[np.zeros((4, 2))] * 2])) is Code.BAD_RECORDING
    assert refusal(pack([[np.zeros(())] * 2])) is Code.BAD_RECORDING
    assert refusal(pack([[np.full((4, 3), np.nan)] * 2])) is Code.BAD_RECORDING


@settings(max_examples=40, deadline=None)
@given(data=st.binary(max_size=300), keep=st.integers(0, 200))
def test_fuzzed_recordings(data, keep):
    """Anything, a pickle, and a good file that is cut and goes on as anything."""
    for junk in (data, pickle.dumps(data), pack([[np.zeros((4, 3))] * 2])[:keep] + data):
        assert refusal(junk) in (Code.BAD_RECORDING, Code.WRONG_LENGTH)


def leaves(value, path=()):
    """Places of everything in plain data that is no table or list; empty ones too."""
    items = value.items() if isinstance(value, dict) else enumerate(value)
    for key, item in items:
        if isinstance(item, (dict, list)) and item:
            yield from leaves(item, (*path, key))
        else:
            yield (*path, key)


_JUNK = st.one_of(
    st.none(), st.booleans(), st.integers(-(2**70), 2**70), st.text(max_size=40), st.just([]),
    st.floats(allow_nan=False, allow_infinity=False), st.just({}), st.just([[]]),
    st.dictionaries(st.text(max_size=5), st.integers(), max_size=2),
)  # fmt: skip


@settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(where=st.floats(0, 1, exclude_max=True), depth=st.integers(1, 4), junk=_JUNK)
def test_fuzzed_entries(where, depth, junk):
    """Anything at any place: an entry or a refusal, and no other error."""
    plain = json.loads(to_bytes(made_entry(scores=[[0.1, 0.2], [0.3, None]])))
    fields = list(leaves(plain))
    path = fields[int(where * len(fields))][:depth]
    inner = copy.deepcopy(plain)
    place = inner
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = junk
    try:
        found = from_bytes(json.dumps(inner).encode())
    except Refused as error:
        assert error.code is Code.MALFORMED_ENTRY
    else:
        assert from_bytes(to_bytes(found)).file == found.file
