"""`ves-gym leaderboard`: bundles made, checked and refused from the shell."""

import json
import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from ves_gym.cli.main import main
from ves_gym.leaderboard.entry import check_entry
from ves_gym.leaderboard.journal import append, check
from ves_gym.leaderboard.verify import verify

RUN = ("leaderboard", "run", "policies", "ves/PumaRestToRest-v0-quick")


@pytest.fixture(scope="module")
def zero(tmp_path_factory):
    """Folder of a bundle in which nothing moves."""
    place = tmp_path_factory.mktemp("bundle") / "b"
    assert main([*RUN, "zero", "--bundle", str(place)]) == 0
    return place


def test_run_and_verify(call, tmp_path):
    status, out, err, result = call(*RUN, "zero", "--name", "nothing", "--author", "someone")
    assert status == 0 and err == "" and "median score" in out
    assert result["schema"] == "ves-leaderboard-run/1" and len(result["rows"]) == 10
    bundle = tmp_path / "out/policies-ves-PumaRestToRest-v0-quick-nothing.zip"
    assert result["bundle"] == str(bundle)

    status, out, err, entry = call("leaderboard", "verify", bundle)
    assert status == 0 and out.startswith("replayed: nothing on ves/PumaRestToRest-v0-quick")
    assert entry["schema"] == "ves-entry/1" and entry["author"] == "someone"
    assert entry["bundle"] == result["sha256"]

    status, out, _, _ = call("leaderboard", "verify", bundle, "--level", "reproduced",
                             "--digest", result["sha256"])  # fmt: skip
    assert status == 0 and out.startswith("reproduced: ")


def test_a_released_policy_in_a_zip(call, tmp_path):
    place = tmp_path / "b.zip"
    status, out, _, _ = call(*RUN, "ppo", "--training", "hours=3", "--bundle", place)
    assert status == 0 and str(place) in out
    _, _, _, entry = call("leaderboard", "verify", place)
    assert entry["name"] == "ppo" and entry["about"]["training"] == {"hours": "3"}


def test_a_rejection_is_one_line_and_status_1(call, zero, tmp_path):
    shutil.copytree(zero, tmp_path / "b")
    with open(tmp_path / "b/actions.npy", "ab") as file:
        file.write(b"x")
    status, out, err, result = call("leaderboard", "verify", tmp_path / "b")
    assert status == 1 and out == "" and result is None
    assert err.startswith("ves-gym: rejected: hash-mismatch: ") and err.count("\n") == 1
    status, _, err, _ = call("leaderboard", "verify", tmp_path / "b", "--digest", "0" * 64)
    assert status == 1 and err.startswith("ves-gym: rejected: hash-mismatch: ")


def test_an_entry_goes_to_the_board(call, zero, tmp_path):
    board = tmp_path / "entries"
    status, _, _, entry = call("leaderboard", "verify", zero, "--board", board)
    assert status == 0
    (record,) = check(board).records
    assert record.entry == check_entry(entry).shortened()


def test_an_entry_and_its_bundle_go_to_the_board_together(call, zero, tmp_path):
    board = tmp_path / "entries"
    status, out, _, _ = call("leaderboard", "verify", zero, "--board", board, "--publish")
    (record,) = check(board).records
    bundle = tmp_path / "bundles" / f"{Path(record.name).stem}.zip"
    assert status == 0 and f"written {bundle}" in out
    status, out, _, _ = call("leaderboard", "verify", board / record.name)
    assert status == 0 and "100% of 10 rows as on the board" in out


def test_an_entry_without_a_bundle_is_answered_again(call, zero, tmp_path):
    record = append(tmp_path / "entries", verify(zero).shortened())
    status, out, _, _ = call("leaderboard", "verify", tmp_path / "entries" / record.name)
    assert status == 0 and out.startswith("answered again: zero")
    assert "100% of 10 rows as on the board" in out


def test_a_policy_without_a_bundle_cannot_act_again(refused, zero, tmp_path):
    entry = {**verify(zero).shortened(), "kind": "policy", "name": "mine"}
    record = append(tmp_path / "entries", entry)
    why = refused("leaderboard", "verify", tmp_path / "entries" / record.name)
    assert "its bundle is not published" in why
    assert "'mine' is no policy of ves_gym's own" in why


def test_what_is_no_bundle_and_no_entry_says_what_it_is(call, refused, zero, tmp_path):
    """What a reader may try first: the wrong file, the wrong folder, a damaged file."""
    board = tmp_path / "entries"
    append(board, verify(zero).shortened())
    for command in ("check", "render"):
        assert f"they are in {board}" in refused("leaderboard", command, tmp_path)
    (tmp_path / "other.json").write_text("{}")
    assert "is no entry of a board" in refused("leaderboard", "verify", tmp_path / "other.json")
    (tmp_path / "page.html").write_text("<html>")
    (tmp_path / "cut.zip").write_bytes(b"PK" + bytes(50))
    unsafe = {
        "page.html": "is no .zip file",
        "cut.zip": "damaged or cut short",
        "entries": "is no file of a bundle, which has manifest.json",
    }
    for name, why in unsafe.items():
        status, _, err, _ = call("leaderboard", "verify", tmp_path / name)
        assert status == 1 and "unsafe-archive" in err and why in err


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (("leaderboard",), "ACTION"),
        (("leaderboard", "verify", "nothing.zip"), "expected a bundle"),
        (("leaderboard", "verify", "\x1b[31m\u202e.zip"), r"\x1b[31m\u202e.zip: expected"),
        (("leaderboard", "verify", "x" * 9000), "... (9"),
        (("leaderboard", "verify", "x.zip", "--publish"), "--publish is of the board"),
        (("leaderboard", "verify", "pyproject.toml/x.json"), "cannot be read"),
        (("leaderboard", "run", "speed", "x", "y"), "track"),
        (("leaderboard", "run", "paths", "reach100-9s", "direct"), "problem"),
        (("leaderboard", "run", "paths", "reach100-1s-quick", "nonsense"), "planner"),
        (("leaderboard", "run", "paths", "reach100-1s-quick", "direct", "refined"), "one"),
        ((*RUN, "nonsense"), "policy"),
        ((*RUN, "zero", "--seeds", "a"), "--seeds"),
        ((*RUN, "zero", "--seeds", "1,1"), "0, 1, ... in order"),
        ((*RUN, "zero", "--salt", "nothing"), "cannot be read"),
        ((*RUN, "zero", "--training", "hours"), "KEY=VALUE"),
        ((*RUN, "zero", "--workers", "0"), "--workers"),
        (("leaderboard", "run", "damping", "pped-bent-quick", "nonsense"), "gains"),
        (("leaderboard", "run", "discrepancy", "blind-sealed-quick", "ves-gym"), "salt"),
        (("leaderboard", "import-sb3", "nothing.zip", "p.json"), "cannot be read"),
    ],
)
def test_bad_usage(words, why, refused):
    assert why in refused(*words)


@pytest.mark.slow
def test_import_sb3_says_what_it_trusts(call, refused, tmp_path):
    pytest.importorskip("stable_baselines3")
    import gymnasium as gym
    from stable_baselines3 import PPO

    import ves_gym  # noqa: F401  registers the environments
    from ves_gym.baselines.sb3 import Sb3VecEnv

    vector = gym.make_vec("ves/PumaRestToRest-v0", num_envs=1, autoreset_mode="SameStep")
    model = PPO("MlpPolicy", Sb3VecEnv(vector), n_steps=8, batch_size=8, device="cpu")
    model.save(tmp_path / "model.zip")
    words = ("leaderboard", "import-sb3", tmp_path / "model.zip", tmp_path / "p.json")
    assert "would run code" in refused(*words)
    assert not (tmp_path / "p.json").exists()

    status, out, _, _ = call(*words, "--trust", "--hold", "4")
    assert status == 0 and "its pickles were run" in out
    plain = json.loads((tmp_path / "p.json").read_text())
    assert plain["schema"] == "ves-policy/1" and plain["network"]["hold"] == 4
    status, _, _, _ = call(*RUN, tmp_path / "p.json", "--bundle", tmp_path / "b")
    assert status == 0
    assert call("leaderboard", "verify", tmp_path / "b", "--level", "reproduced")[0] == 0


@pytest.mark.skipif(shutil.which("ssh-keygen") is None, reason="OpenSSH is not installed")
def test_a_signed_name_on_the_board(call, tmp_path):
    """Signed and registered; the same author without the key, or with another, is refused."""
    for name in ("mine", "theirs"):
        subprocess.run(
            ["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", tmp_path / name], check=True
        )
    bundle, board = tmp_path / "b.zip", tmp_path / "entries"
    call(*RUN, "zero", "--author", "A. Name", "--bundle", bundle)
    verify = ("leaderboard", "verify", bundle, "--board", board)
    status, out, _, _ = call(*verify)
    assert status == 0 and "not signed\n" in out

    def refused(*words):
        (tmp_path / "result.json").unlink(missing_ok=True)
        status, out, err, result = call(*words)
        assert status == 2 and out == "" and result is None, out + err
        assert err.startswith("ves-gym: error: ") and err.count("\n") == 1
        return err

    sign = ("leaderboard", "sign", bundle, "--key")
    assert "no such key file" in refused(*sign, tmp_path / "none")
    status, out, _, result = call(*sign, tmp_path / "mine")
    assert status == 0 and result["schema"] == "ves-leaderboard-sign/1"
    assert out == f"signed {bundle} by {result['key']}\n"
    assert "unsigned entries" in refused(*verify)
    assert "--board" in refused("leaderboard", "verify", bundle, "--adopt")
    status, out, _, _ = call(*verify, "--adopt")
    assert status == 0 and f"signed by {result['key']}\n" in out

    call(*sign, tmp_path / "theirs")
    assert "signs with" in refused(*verify)
    assert [r.entry["about"].get("key") for r in check(board).records] == [None, result["key"]]

    with zipfile.ZipFile(bundle, "a") as archive:
        archive.writestr("manifest.json.sig2", b"")
    status, _, err, _ = call(*sign, tmp_path / "mine")
    assert status == 1 and err.startswith("ves-gym: rejected: unsafe-archive: ")


def test_an_entry_is_what_it_was_whatever_the_threads():
    """A beam computed on two threads has other bits, and its environment another hash."""
    here = Path(__file__).parents[2]
    place = here / "docs" / "leaderboard" / "entries"
    entry = place / "tasks-pumadampemulated-v1-zero-b387144143c52777.json"
    threads = {"OMP_NUM_THREADS": "2", "OPENBLAS_NUM_THREADS": "2"}
    program = str(Path(sys.executable).with_name("ves-gym"))
    command = [program, "leaderboard", "verify", str(entry)]
    done = subprocess.run(
        command, env={**os.environ, **threads}, cwd=here, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert "100% of 100 rows" in done.stdout
