"""Unknown names on the command line are refused beside the closest known one."""

import pytest

from ves_gym.cli.main import main

UNKNOWN = {
    "listt": "list",
    "list planer": "planners",
    "simulate --gaol 1,2,3": "--goal",
    "simulate --settel=1": "--settle",
    "simulate --vehicle bnt": "bent",
    "simulate --mode emulate": "emulated",
    "simulate --mode emulated --effect gravity/scal:error=0.01": "gravity/scale",
    "simulate --mode emulated --effect gravity/scale:eror=0.01": "error",
    "plan --goal 1,1,1 --planner refind": "refined",
    "benchmark --suite thesi": "thesis",
    "evaluate ves/PumaReech-v0": "ves/PumaReach-v0",
    "leaderboard verfy a.json": "verify",
    "leaderboard verify a.json --boad b": "--board",
    "leaderboard run pats bent-2s direct": "paths",
    "leaderboard run paths bnt-2s direct": "bent-2s",
}


@pytest.mark.parametrize("line", UNKNOWN)
def test_the_closest_known_name_is_offered(line, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(line.split()) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1 and err.startswith("ves-gym: error: ")
    assert f'; did you mean "{UNKNOWN[line]}"?' in err
    assert not list(tmp_path.iterdir())


def test_a_key_of_a_system_file(capsys, tmp_path):
    file = tmp_path / "system.toml"
    file.write_text("physics_d = 0.001\n")
    assert main(["simulate", "--system", str(file), "--out", str(tmp_path / "out")]) == 2
    assert '; did you mean "physics_dt"?' in capsys.readouterr().err
