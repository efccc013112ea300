"""What is wrong is said in one line with the name that was meant, and nothing is written."""

import sys
from pathlib import Path

import numpy as np
import pytest

import ves_gym as vg
from ves_gym.cli.main import main
from ves_gym.simulation.gravity_calibration import calibration_poses

MAST = Path(__file__).parents[2] / "examples" / "mast.pch"
CLOSEST = {  # an unknown name -> the closest known one
    "listt": "list",
    "list planer": "planners",
    "simulate --gaol 1,2,3": "--goal",
    "simulate --settel=1": "--settle",
    "simulate --vehicle bnt": "bent",
    "simulate --arm pumma560": "puma560",
    "simulate --mode emulate": "emulated",
    "simulate --mode emulated --effect gravity/scal:error=0.01": "gravity/scale",
    "simulate --mode emulated --effect gravity/scale:eror=0.01": "error",
    "plan --goal 1,1,1 --planner refind": "refined",
    "benchmark --suite thesi": "thesis",
    "evaluate ves/PumaReech-v0": "ves/PumaReach-v0",
    "train ves/PumaDamp": "ves/PumaDamp-v0",
    "pped --objective strein": "strain",
    "leaderboard verfy a.json": "verify",
    "leaderboard verify a.json --boad b": "--board",
    "leaderboard run pats bent-2s direct": "paths",
    "leaderboard run paths bnt-2s direct": "bent-2s",
}


@pytest.mark.parametrize("line", CLOSEST)
def test_the_closest_known_name_is_offered(line, refused):
    assert f'; did you mean "{CLOSEST[line]}"?' in refused(*line.split())


BAD = """
frobnicate | frobnicate
simulate --frobnicate | --frobnicate
simulate --goal 1,2 | --goal must be 3 angles in degrees, got 2
simulate --goal 1,2,nan | --goal must be 3 angles in degrees, like 0,-45,90, got '1,2,nan'
simulate --goal 1,2,x | --goal must be 3 angles in degrees, like 0,-45,90
simulate --goal 200,0,0 | joint 1 must be within
simulate --arm nowhere.urdf | nowhere.urdf
simulate --gains 1,2/3 | --gains must be own, high, pped, free, or kp/kd
simulate --control-dt 0.003 | 0.003
simulate --physics-dt 0.5 --control-dt 0.5 --vehicle straight-vertical-thesis | physics_dt
simulate --record-dt 0.002 | record_dt
simulate --record-dt 0 | --record-dt must be > 0 s, got 0
simulate --duration -1 | --duration must be > 0 s, got -1
simulate --settle nan | --settle must be >= 0 s, got nan
simulate --disturb 1,2,3 | --disturb must be six numbers
simulate --log run.txt | --log must end in .csv or .parquet
simulate --drive prescribed --gains high | a prescribed drive has no servo
simulate --via 1,1,1 | --via needs --goal
simulate --zero | --zero needs --mode emulated
simulate --grasp 0.1 | a latch needs a system with a payload
simulate --effect joint/coulomb:torque=3 | must be 3 numbers, one per joint, got 1
simulate --vehicle bent-thesis --disturb 10000,0,0,0,0,0 | diverged
simulate --platform-motion x.toml | cannot be read
simulate --learn 2 | --learn needs --mode emulated
simulate --mode emulated --learn 2 --poses 3 | two experiments
simulate --mode emulated --learn 2 --record-dt 0.1 | leave out --record-dt
simulate --mode emulated --poses 0 | --poses must be >= 1, got 0
simulate --mode emulated --platform soon | --platform must be a bandwidth > 0 in Hz
simulate --mode emulated --calibration no.toml | no.toml
plan | plan needs --goal A,B,C, --tool X,Y,Z, or the --case FILE of another plan
plan --goal 1,1,1 --tool 1,1,1 | not allowed with
plan --goal 1,1,1 --seed -1 | --seed must be >= 0
plan --goal 1,1,1 --seed x | --seed must be a whole number >= 0
plan --goal 1,1,1 --v-max 1,0,1 | v_max
plan --tool 0.5,0.3 | three lengths in m
plan --tool 5,0,0 | must be within reach of puma560
plan --goal 1,1,1 --algorithm rrtstar | --algorithm is for planners
plan --goal 1,1,1 --planner ompl-time --algorithm prm | must be one of rrtstar
plan --goal 1,1,1 --bound tpi=1 | tip
plan --goal 1,1,1 --bound tip | NAME=SHARE
plan --goal 1,1,1 --bound tip=-1 | bound tip must be a number > 0, got -1.0
plan --goal 1,1,1 --planner bad-path --bound tip=1 | bounds are for planner calm
plan --goal 1,1,1 --planner straight:tip=1 | bounds are for planner calm
plan --goal 1,1,1 --frequency-weight 1 | HZ:GAIN
plan --goal 1,1,1 --obstacles none.toml | none.toml
plan --goal 1,1,1 --robust-from none.toml | none.toml
benchmark --bounds 0.1,0.2 | --bounds must be like
benchmark --planners straight,best | planner must be one of
benchmark --obstacles some | obstacles must be one of off, on, both
benchmark --suite thesis --obstacles on | thesis has no obstacles
benchmark --durations 3 | --durations must be of 0.5, 1, 2, 4 s, got 3
benchmark --durations x | --durations must be numbers like 1,2,4 [s]
benchmark --first 0 | --first must be >= 1, got 0
benchmark --skip -1 | --skip must be >= 0, got -1
benchmark --skip 100 | --skip 100 leaves none of 100 queries
map --joints 1,1 | from 1 to 3
map --joints a | --joints must be whole numbers
map --duration soon | --duration must be raw or seconds > 0
map --others best --points 5 | --others must be one of given, least, most
map --points 2 | --points must be from 4 to 1001, got 2
pped --vehicle free-floating | stiffness in all six directions
pped --mode emulated | needs mode ideal
pped --drive prescribed | needs drive motor
pped --bounds 1,2,3 | --bounds must be four numbers
pped --bounds 10,1,0.1,1 | Bounds.K must be 0 < least < largest, got 10 and 1
pped --disturb 0,0,0,0,0,0 | a displacement other than zero
pped --map --points 1 | --points must be from 2 to 101, got 1
emulation-check --mode ideal | is about --mode emulated, got ideal
list blocks --mode ideal | is about --mode emulated, got ideal
list planners --vehicle bent | --vehicle is for `list blocks`, got `list planners`
calibrate nowhere.csv | nowhere
calibrate nowhere.csv --iterations 0 | --iterations must be a number >= 1, or limit
view nowhere.csv | nowhere
view nowhere.txt | .parquet
structure a.npz | required: --interface, --units
evaluate ves/Nothing-v0 | Nothing
evaluate PumaDamp-v0 --controller best | controller must be
evaluate PumaDamp-v0 --controller zero,zero | controllers must differ
evaluate PumaDamp-v0 --controller lqr | acts on task lqr
evaluate PumaDamp-v0 --policy none.json | cannot be read
evaluate PumaDamp-v0 --policy model.zip | pickles are not read
evaluate PumaDamp-v0 --policy genius | policy must be a file or folder of policies, or one of
evaluate MacroMicro-v0 --policy genius | policies; ves/MacroMicro-v0 has no released one, got
evaluate PumaDamp-v0 --policy . | no seed-*/best.json
evaluate PumaDamp-v0 --episodes 0 | episodes must be a whole number from 1
train nothing.toml | cannot be read
train PumaRestToRest-v0 --algo dqn | algorithm must be one of
train PumaRestToRest-v0 --seeds one | --seeds must be whole numbers
train PumaRestToRest-v0 --steps 0 | total_timesteps must be >= 1
train PumaRestToRest-v0 --workers 0 | --workers must be >= 1
sweep nothing.toml | cannot be read
sweep spec.toml --workers 0 | --workers must be >= 1
sweep spec.toml --part 3/2 | part must be k of n
sweep spec.toml --part half | --part must be K/N
search spec.toml | expected a table [search]
merge nowhere | expected the folder of a sweep
policy export | needs --onnx
dataset make | --all
dataset make PumaReach/mixd-v0 | did you mean
teleop --duration 1 | give --keys FILE
teleop --keys missing.txt | missing.txt
"""
SPEC = '[[evaluate]]\nenvs = ["BeamLQR-v0"]\npolicies = ["zero"]\nepisodes = 2\n'


@pytest.mark.parametrize("line", [line for line in BAD.splitlines() if line])
def test_bad_input_is_one_line_and_writes_nothing(line, refused, tmp_path):
    words, _, expected = line.partition(" | ")
    (tmp_path / "spec.toml").write_text(SPEC)
    assert expected in refused(*words.split())


WRITING = (
    "plan --goal 60,40,-30", "simulate", "benchmark --quick", "map", "pped", "emulation-check",
    "studio --goal 60,40,-30", "train PumaDamp-v0", "dataset make --all", "view nowhere.csv",
    "doctor", f"structure {MAST} --interface 4 --units m-kg-s --damping 0.02",
)  # fmt: skip


@pytest.mark.parametrize("line", WRITING)
def test_a_folder_that_cannot_be_filled_is_refused_before_work(
    line, tmp_path, capsys, monkeypatch
):
    """A file in place of the folder, by --out, --json and where nothing is said."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "out").touch()
    (tmp_path / "afile").touch()
    ends = {
        "--out afile": "--out must be a folder in which files can be made, got 'afile'",
        "--out afile/sub": "--out must be a folder in which files can be made, got 'afile/sub'",
        "--json afile/a.json": "the place of --json must be a folder in which files can be",
    }
    if line.split()[0] in ("plan", "benchmark", "map", "pped", "structure"):
        ends[""] = "the default of --out must be a folder in which files can be made, got 'out/"
    if line == "simulate":
        ends["--log afile/a.csv"] = "the place of --log must be a folder in which files can be"
    if line.startswith("structure"):
        ends["--save afile/m.toml"] = "the place of --save must be a folder in which files can"
    for words, sentence in ends.items():
        assert main([*line.split(), *words.split()]) == 2
        error = capsys.readouterr().err
        assert error.startswith(f"ves-gym: error: {sentence}"), words
        assert error.count("\n") == 1 and "a file)" in error


def test_files_of_systems_and_vehicles_are_checked(refused, tmp_path):
    (tmp_path / "system.toml").write_text("physics_d = 0.001\n")
    line = refused("simulate", "--system", "system.toml")
    assert '; did you mean "physics_dt"?' in line
    eye, bad = np.eye(6).tolist(), np.diag([1, 1, -3.0, 1, 1, 1]).tolist()
    text = f'kind = "matrices"\nM = {bad}\nD = {eye}\nK = {eye}\n'
    (tmp_path / "boat.toml").write_text(text)
    line = refused("simulate", "--vehicle", "boat.toml")
    assert "MatrixVehicle.M" in line and "-3" in line


@pytest.fixture
def poses(tmp_path):
    """Write a log of static poses, as a laboratory would; returns its path."""

    def write(meta=None, still=False, w=True):
        q, y = calibration_poses(vg.PUMA_560, 20)
        q[:, 1] = 0.3 if still else q[:, 1]
        meta = {"system": vg.System().to_dict()} if meta is None else meta
        log = vg.RunLog(
            t=np.arange(20), q_cmd=q, v_cmd=0 * q, q=q, y=y, w=np.ones((20, 6)) if w else None,
            meta={"format": "ves-run/1", **meta},
        )  # fmt: skip
        log.save(tmp_path / "poses.csv")
        return tmp_path / "poses.csv"

    return write


def test_a_log_that_tells_too_little_is_named(refused, poses):
    assert "vary joint 2" in refused("calibrate", poses(still=True))
    assert "--arm" in refused("calibrate", poses(meta={}))
    assert "w_1" in refused("calibrate", poses(w=False))
    assert "--check" in refused("calibrate", poses(), "--rezero")
    assert "nowhere" in refused("calibrate", poses(), "--check", "nowhere.csv")


STRUCTURE = [
    ((), "the files hold no damping: --damping must give a ratio"),
    (("--damping", "0.01", "--interface", "9"), "node 9 must have the components"),
    (("--damping", "0.01", "--interface", "4,5"), "a node or six freedoms, got '4,5'"),
    (("--damping", "0.01", "--interface", "four"), "a node or six freedoms, got 'four'"),
    (("--damping", "0.01", "--units", "si"), "units must be one of m-kg-s"),
    (("--damping", "0.01", "--modes", "-1"), "--modes must be a whole number >= 0 or auto"),
    (("--damping", "0.01", "--modes", "99"), "modes must be 0 to 12, got 99"),
    (("--damping", "0.01", "--line", "2:0,0"), "--line must be like 2:0,0,-4"),
    (("--damping", "0.01", "--names", "M=MXX"), "no matrix 'MXX'; known: "),
    (("--damping", "0.01", "--rigid-modes", "6"), "6 rigid motions"),
    (("K=other.npy",), "M=FILE K=FILE and perhaps D=FILE"),
]


@pytest.mark.parametrize(("words", "sentence"), STRUCTURE)
def test_a_structure_that_cannot_be_read_writes_nothing(refused, tmp_path, words, sentence):
    own = ("--interface", "4", "--units", "m-kg-s", "--save", tmp_path / "vehicle.toml")
    files = [word for word in words if word.startswith("K=")]
    options = words[len(files) :]
    assert sentence in refused("structure", MAST, *files, *own, *options)
    assert not (tmp_path / "vehicle.toml").exists()


WRITING = [  # what is begun, and what it can't finish
    (("list", "commands", "--json", "j.json"), "j.json"),
    (("simulate", "--goal", "5,5,5", "--duration", "0.4", "--log", "run.csv"), "run.json"),
    (
        ("simulate", "--goal", "5,5,5", "--duration", "0.4", "--log", "run.parquet"),
        "run.parquet",
    ),
    (("plan", "--goal", "5,5,5"), "case.toml"),
    (("map",), "map_q1_q2.npz"),
    (("leaderboard", "run", "paths", "bent-2s-quick", "straight"), "entry.json"),
]


@pytest.mark.skipif(sys.platform == "win32", reason="a limit of files' sizes")
@pytest.mark.parametrize(("words", "file"), WRITING, ids=lambda k: str(k[0]))
def test_where_there_is_no_room_the_file_is_named_and_none_is_half_written(
    words, file, tmp_path, monkeypatch, capsys
):
    import resource

    monkeypatch.chdir(tmp_path)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, before[1]))  # bytes: EFBIG beyond
    try:
        status = main([*words, "--out", "out"])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    err = capsys.readouterr().err
    assert status == 2 and err.startswith("ves-gym: error: "), err
    assert err.endswith(f"{file}: File too large\n") and err.count("\n") == 1, err
    assert not [p for p in tmp_path.rglob("*") if p.is_file()]


def test_a_program_error_is_not_hidden(monkeypatch):
    """Only what a user can mend is one line; the rest is ours."""
    from ves_gym.cli import doctor

    monkeypatch.setattr(doctor, "_checks", lambda out: [].absent)
    with pytest.raises(AttributeError):
        main(["doctor"])
