"""A proposed merge with bundles: what it may hold, and what of it comes onto the board."""

import shutil
import subprocess

import pytest

from scripts import take_in as script
from ves_gym._util.params import ParameterError
from ves_gym.leaderboard.journal import check
from ves_gym.leaderboard.published import bundle_of
from ves_gym.leaderboard.run import make_bundle

ALONE = shutil.which("unshare") and not subprocess.run([*script.ALONE, "true"]).returncode


@pytest.fixture(scope="module")
def bundle(tmp_path_factory):
    path = tmp_path_factory.mktemp("bundle") / "b.zip"
    problem = ("policies", "ves/BeamLQR-v0-quick")
    return make_bundle(path, *problem, "zero", name="still", author="someone").read_bytes()


@pytest.fixture
def propose(tmp_path):
    """Commit files on a branch; returns the arguments of `proposed`."""
    repository = tmp_path / "repository"
    repository.mkdir()

    def git(*words):
        name = ("-c", "user.name=a", "-c", "user.email=a@example.org")
        subprocess.run(["git", *name, *words], cwd=repository, check=True, capture_output=True)

    git("init", "-b", "main")
    (repository / "setup.py").write_text("safe = True\n")
    git("add", ".")
    git("commit", "-m", "board")

    def commit(files):
        git("checkout", "-B", "proposal", "main")
        for name, data in files.items():
            path = repository / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.unlink(missing_ok=True)
            if isinstance(data, str):
                path.symlink_to(data)
            elif data is not None:
                path.write_bytes(data)
        git("add", "-A")
        git("commit", "-m", "mine", "--allow-empty")
        git("checkout", "main")
        return repository, "main", "proposal"

    return commit


def test_bundles_are_read_out_of_git_and_nothing_is_checked_out(propose):
    where = propose({script.PLACE + "a.zip": b"one", script.PLACE + "b.zip": b"two"})
    assert script.proposed(*where) == {"a.zip": b"one", "b.zip": b"two"}
    assert not (where[0] / script.PLACE).exists()


@pytest.mark.parametrize(
    "files",
    [
        {},
        {"setup.py": b"evil = True\n"},
        {"setup.py": None},
        {script.PLACE + "a.zip": b"x", "ves_gym/leaderboard/verify.py": b""},
        {"docs/leaderboard/entries/policies-x-0123456789abcdef.json": b"{}"},
        {script.PLACE + "a.json": b"{}"},
        {script.PLACE + "deep/a.zip": b"x"},
        {script.PLACE + "a.zip": "../../../setup.py"},
        {script.PLACE + "a.zip": b"x" * 2_000_001},
        {script.PLACE + f"{k}.zip": b"x" for k in range(21)},
    ],
)
def test_a_proposal_that_is_more_than_bundles_is_refused(propose, files):
    with pytest.raises(ParameterError, match=r"a proposal|a plain file"):
        script.proposed(*propose(files))


def test_a_commit_that_looks_like_an_option(propose):
    repository, base, _ = propose({})
    with pytest.raises(ParameterError, match="git rev-parse"):
        script.proposed(repository, base, "--output=/tmp/x")


@pytest.mark.skipif(not ALONE, reason="no process without network can be made here")
@pytest.mark.parametrize("damaged", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_what_holds_is_taken_in_with_the_rows_found_here(
    propose, bundle, damaged, tmp_path, capsys
):
    """Verified where there is no network; one that is cut short beside it changes nothing."""
    cut = {script.PLACE + f"cut-{k}.zip": bundle[:-40] for k in range(damaged)}
    repository, base, head = propose({script.PLACE + "good.zip": bundle, **cut})
    board = tmp_path / "entries"
    words = [base, head, "--repository", str(repository), "--board", str(board)]
    assert script.main(words) == damaged
    out = capsys.readouterr().out
    assert f"1 of {1 + damaged} taken in" in out
    assert out.count("rejected: unsafe-archive") == damaged
    journal = check(board)
    (record,) = journal.records
    assert journal.problems == () and record.entry["level"] == "reproduced"
    assert record.entry["author"] == "someone"
    assert bundle_of(board / record.name).exists()
    assert (tmp_path / "index.html").exists()


@pytest.mark.skipif(not ALONE, reason="no process without network can be made here")
def test_there_is_no_network_where_bundles_are_verified():
    code = "import socket; socket.create_connection(('127.0.0.1', 9), 1)"
    done = subprocess.run(
        [*script.ALONE, "python3", "-c", code], capture_output=True, text=True, check=False
    )
    assert "unreachable" in done.stderr.lower() or "refused" in done.stderr.lower()
    names = subprocess.run(
        [*script.ALONE, "cat", "/proc/net/dev"], capture_output=True, text=True, check=True
    ).stdout
    assert [row.split(":")[0].strip() for row in names.splitlines()[2:]] == ["lo"]
