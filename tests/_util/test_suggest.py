"""The closest known name is offered; where none is close, nothing is."""

from types import SimpleNamespace

import pytest

from ves_gym._util.params import ParameterError, read_table
from ves_gym._util.reading import read_bytes
from ves_gym._util.suggest import did_you_mean
from ves_gym.baselines.evaluate import spec_of
from ves_gym.baselines.registry import get_controller
from ves_gym.diagnosis.inference.candidates import without
from ves_gym.engine.backends import make_backend
from ves_gym.envs.build import build_task, get_task
from ves_gym.leaderboard.problems import get_problem, problems
from ves_gym.mechanics.arm_library import get_arm
from ves_gym.mechanics.vehicle import get_vehicle, vehicle_from_plain
from ves_gym.planners.registry import get_planner
from ves_gym.planners.suites import get_suite
from ves_gym.system.runlog import RunLog
from ves_gym.system.system import System

PLANNERS = ("straight", "direct", "refined", "refined-long", "hotspot-q", "hotspot-qt")
EFFECTS = ("joint/coulomb", "joint/viscous", "payload/mass", "gravity/mass", "gravity/scale")


@pytest.mark.parametrize(
    ("name", "known", "expected"),
    [
        ("refind", PLANNERS, "refined"),
        ("Direct", PLANNERS, "direct"),
        ("hotspot_qt", PLANNERS, "hotspot-qt"),
        ("joint/coulom", EFFECTS, "joint/coulomb"),
        ("coulomb", EFFECTS, "joint/coulomb"),
        ("viscos", EFFECTS, "joint/viscous"),
        ("PumaReach", ("ves/PumaReach-v0", "ves/PumaDamp-v0"), "ves/PumaReach-v0"),
        ("physics_d", ("physics_dt", "control_dt"), "physics_dt"),
    ],
)
def test_the_closest_name_is_offered(name, known, expected):
    assert did_you_mean(name, known) == f'; did you mean "{expected}"?'


@pytest.mark.parametrize("name", ["", "zzz", "mass", None, 3, ["direct"], "direct" * 1000])
def test_nothing_is_offered_where_no_name_is_close(name):
    """ "mass" is the end of two effects: neither is meant more than the other."""
    assert did_you_mean(name, (*PLANNERS, *EFFECTS)) == did_you_mean("direct", ()) == ""


REFUSALS = {
    "planner": lambda: get_planner("refind"),
    "vehicle": lambda: get_vehicle("free-flyin"),
    "suite": lambda: get_suite("reach10", system=System()),
    "effect": lambda: System.from_dict({"effects": [{"kind": "joint/coulom"}]}),
    "effect's key": lambda: System.from_dict(
        {"effects": [{"kind": "joint/coulomb", "torqe": [1, 1, 1]}]}
    ),
    "key": lambda: System.from_dict({"physics_d": 1e-3}),
    "choice": lambda: System(mode="emulate"),
    "kind": lambda: vehicle_from_plain({"kind": "matrix"}),
    "task": lambda: get_task("reech"),
    "setting": lambda: build_task("reach", vehicl="bent"),
    "option": lambda: build_task("reach").check_options({"targt": [0, 0, 0]}, ()),
    "track": lambda: problems("path"),
    "problem": lambda: get_problem("paths", "bent-1"),
    "controller": lambda: get_controller("hotspt"),
    "backend": lambda: make_backend("kernl", System(), 1, 1),
    "environment": lambda: spec_of("ves/PumaReech-v0"),
    "candidate": lambda: without([SimpleNamespace(kind="joint/coulomb")], ["joint/coulom"]),
}


def test_an_environment_with_a_slip_is_answered_by_its_id_alone():
    """All ids are a wall; they come where none is close."""
    with pytest.raises(ParameterError) as slip:
        spec_of("ves/PumaDump")
    text = "no environment 'ves/PumaDump'; did you mean \"ves/PumaDamp-v0\"?"
    assert str(slip.value) == f"{text} (`ves-gym list environments`)"
    with pytest.raises(ParameterError, match=r"known: ves/BeamLQR-v0, .*Capture-v0"):
        spec_of("ves/Nothing-v0")


@pytest.mark.parametrize("name", REFUSALS)
def test_an_unknown_name_is_refused_with_the_closest_known_one(name):
    with pytest.raises(ParameterError, match=r"; did you mean \"[^\"]+\"\?"):
        REFUSALS[name]()


def test_a_file_that_is_not_there_has_the_closest_beside_it(tmp_path):
    """Of the same ending; a table, bytes, an arm and a log all say so."""
    for name in ("falcon.toml", "falcon.csv", "other.toml"):
        (tmp_path / name).write_text("")
    reads = {".toml": (read_table, read_bytes, get_arm), ".csv": (read_bytes, RunLog.load)}
    for suffix, readers in reads.items():
        for read in readers:
            with pytest.raises(ValueError, match=rf'; did you mean "falcon{suffix}"\?$'):
                read(tmp_path / f"falcom{suffix}")
            with pytest.raises(ValueError, match=r"No such file or directory$"):
                read(tmp_path / f"unlike{suffix}")
