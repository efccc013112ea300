"""`ves-gym leaderboard`: entries made, checked, refused and rendered from the shell."""

import json
import sys

import pytest

from tests.leaderboard.entries import made_entry, noisy, save_random_policy
from ves_gym.leaderboard.entry import from_bytes
from ves_gym.leaderboard.verify import add

RUN = ("leaderboard", "run", "damping", "ves/PumaDamp-v0-quick")


def test_run_and_verify(call, tmp_path):
    status, out, err, result = call(*RUN, "zero", "--name", "nothing", "--author", "someone")
    assert status == 0 and err == "" and "10 of 10 with a score" in out
    place = tmp_path / "out/damping_PumaDamp-v0-quick_someone_nothing"
    assert result == {"schema": "ves-leaderboard-run/1", "folder": str(place)}

    status, out, err, entry = call("leaderboard", "verify", place)
    assert status == 0 and out.startswith("reproduced: nothing on ves/PumaDamp-v0-quick")
    assert from_bytes(json.dumps(entry).encode()).author == "someone"


def test_a_refusal_is_one_line_and_status_1(call, tmp_path):
    call(*RUN, "zero")
    file = tmp_path / "out/damping_PumaDamp-v0-quick_anonymous_zero/entry.json"
    plain = json.loads(file.read_text())
    plain["results"]["score"][0][2] *= 0.5
    file.write_text(json.dumps(plain))
    status, out, err, entry = call("leaderboard", "verify", file)
    assert status == 1 and out == "" and entry is None
    assert err.startswith("ves-gym: rejected: score-differs: 1 of 10") and err.count("\n") == 1


def test_policies_and_what_they_took(call, tmp_path):
    files = [save_random_policy(tmp_path / f"p{k}.json", seed=k) for k in range(2)]
    status, *_ = call(*RUN, *files, "--training", "steps=none")
    assert status == 0
    folder = tmp_path / "out/damping_PumaDamp-v0-quick_anonymous_p0"
    plain = json.loads((folder / "entry.json").read_text())
    assert plain["method"]["seeds"] == [0, 1]
    assert plain["about"]["training"] == {"steps": "none"}
    status, out, _, _ = call("leaderboard", "verify", folder)
    assert status == 0 and "20 of 20" in out


def test_a_planner_of_ones_own_is_loaded_by_its_name(call, refused, tmp_path, monkeypatch):
    (tmp_path / "mypackage.py").write_text(
        "from ves_gym.planners.shaping import Straight\n"
        "class Mine(Straight):\n    name = 'mine'\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "mypackage", raising=False)
    words = ("leaderboard", "run", "paths", "bent-1s-quick")
    assert "mypackage has nothing called Missing" in refused(*words, "mypackage:Missing")
    assert call(*words, "mypackage:Mine")[0] == 0
    folder = tmp_path / "out/paths_bent-1s-quick_anonymous_mine"
    monkeypatch.delitem(sys.modules, "mypackage")
    (tmp_path / "mypackage.py").write_text("raise SystemExit('what was submitted ran')")
    status, out, _, _ = call("leaderboard", "verify", folder)
    assert status == 0 and out.startswith("replayed: mine on bent-1s-quick")


def test_render_writes_the_page(call, refused, tmp_path):
    for name in ("straight", "direct"):
        add(tmp_path / "entries", made_entry(name, scores=noisy(1.0)))
    status, out, _, board = call("leaderboard", "render", tmp_path / "entries")
    assert status == 0 and out.startswith("2 entries\n") and board["schema"] == "ves-board/1"
    first = (tmp_path / "out/index.html").read_bytes()
    call("leaderboard", "render", tmp_path / "entries")
    assert (tmp_path / "out/index.html").read_bytes() == first


def test_a_broken_board_renders_nothing(refused, tmp_path):
    assert "no such board" in refused("leaderboard", "render", tmp_path / "none")
    place = add(tmp_path / "entries", made_entry("direct", scores=noisy(1.0)))
    place.write_bytes(b"{}")
    assert "malformed-entry" in refused("leaderboard", "render", tmp_path / "entries")


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (("run", "speed", "x", "zero"), "track must be one of"),
        (("run", "paths", "bent-3s", "direct"), "problem of track paths must be one of"),
        (("run", "paths", "bent-1s-quick", "a", "b"), "expected one method"),
        (("run", "paths", "bent-1s-quick", "straight", "--seeds", "a"), "--seeds must be"),
        (("run", "paths", "bent-1s-quick", "straight", "--workers", "0"), "--workers must be"),
        (("run", "paths", "bent-1s-quick", "straight", "--name", "A"), "must be of a-z"),
        (("run", "paths", "bent-1s-quick", "straight", "--training", "x"), "KEY=VALUE"),
        (("run", "paths", "bent-1s-quick", "straight", "--salt", "none"), "cannot be read"),
        (("verify", "nothing"), "expected an entry"),
    ],
)
def test_bad_usage(words, why, refused):
    assert why in refused("leaderboard", *words)
