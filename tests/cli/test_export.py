"""`export`, and `view --rerun`: runs and machines for the tools of others."""

import pytest
from fmpy.validation import validate_fmu
from rerun.chunk import RrdReader
from rosbags.rosbag2 import Reader

from ves_gym.system.runlog import RunLog


def test_a_run_as_mcap(call, run_log, tmp_path):
    status, out, _, result = call("export", "mcap", run_log)
    assert status == 0 and result["schema"] == "ves-export/1" and "written" in out
    with Reader(tmp_path / "out" / "run.mcap") as reader:
        assert reader.topics["/joint_states"].msgcount == len(RunLog.load(run_log))


def test_a_machine_as_an_fmu(call, tmp_path):
    status, *_ = call("export", "fmu", "--vehicle", "decoupled", "--gains", "100/10")
    assert status == 0
    assert validate_fmu(str(tmp_path / "out" / "system.fmu")) == []


def test_runs_side_by_side_for_rerun(call, run_log, tmp_path):
    (tmp_path / "other").mkdir()
    RunLog.load(run_log).save(tmp_path / "other" / "run.csv")
    status, out, _, result = call("view", run_log, "other/run.csv", "--rerun", "runs.rrd")
    assert status == 0 and "rerun" in out
    names = [f"{run_log.parent.name}/run", "other/run"]
    assert list(result["runs"]) == names
    chunks = RrdReader(tmp_path / "out" / "runs.rrd").stream().to_chunks()
    entities = {chunk.entity_path for chunk in chunks}
    assert {f"/{name.replace('/', chr(92) + '/')}/base/link_1" for name in names} <= entities


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--rerun", "a.gif"), "--rerun must be a .rrd name, got 'a.gif'"),
        (("--rerun", "a.rrd", "--fps", "10"), "leave out --size, --fps and --speed"),
        (("again.csv", "--gif", "a.gif"), "take one LOG, got 2"),
        (("again.csv", "--rerun", "a.rrd"), "again.csv"),
    ],
)
def test_what_does_not_go_together_is_refused(words, said, refused, run_log):
    assert said in refused("view", run_log, *words)


def test_the_same_run_twice_is_refused(refused, run_log):
    line = refused("view", run_log, run_log, "--rerun", "a.rrd")
    assert "runs need different names" in line


def test_a_machine_without_words_is_refused(refused):
    assert "no words for jets" in refused("export", "fmu", "--vehicle", "free-flying")
