"""The closest known name is offered; where none is close, nothing is."""

import pytest

from ves_gym._util.params import ParameterError
from ves_gym._util.suggest import did_you_mean

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


@pytest.mark.parametrize("name", ["", "zzz", "mass", None, 3, ["direct"]])
def test_nothing_is_offered_where_no_name_is_close(name):
    """ "mass" is the end of two effects: neither is meant more than the other."""
    assert did_you_mean(name, (*PLANNERS, *EFFECTS)) == ""


def test_what_is_far_too_long_for_a_name_is_not_compared():
    assert did_you_mean("direct" * 1000, PLANNERS) == ""


def test_nothing_is_known():
    assert did_you_mean("direct", ()) == ""


def _planner():
    from ves_gym.planners.registry import get_planner

    get_planner("refind")


def _vehicle():
    from ves_gym.mechanics.vehicle import get_vehicle

    get_vehicle("free-flyin")


def _suite():
    from ves_gym.planners.suites import get_suite
    from ves_gym.system.system import System

    get_suite("reach10", system=System())


def _effect_kind():
    from ves_gym.system.system import System

    System.from_dict({"effects": [{"kind": "joint/coulom"}], "mode": "emulated"})


def _effect_key():
    from ves_gym.system.system import System

    System.from_dict({"effects": [{"kind": "joint/coulomb", "torqe": [1, 1, 1]}]})


def _key():
    from ves_gym.system.system import System

    System.from_dict({"physics_d": 1e-3})


def _choice():
    from ves_gym.system.system import System

    System(mode="emulate")


def _union():
    from ves_gym.mechanics.vehicle import vehicle_from_plain

    vehicle_from_plain({"kind": "matrix"})


def _task():
    from ves_gym.envs.build import get_task

    get_task("reech")


def _setting():
    from ves_gym.envs.build import build_task

    build_task("reach", vehicl="bent")


def _reset_option():
    from ves_gym.envs.build import build_task

    build_task("reach").check_options({"targt": [0, 0, 0]}, ())


def _track():
    from ves_gym.leaderboard.problems import problems

    problems("path")


def _problem():
    from ves_gym.leaderboard.problems import get_problem

    get_problem("paths", "bent-1")


def _controller():
    from ves_gym.baselines.registry import get_controller

    get_controller("hotspt")


def _backend():
    from ves_gym.engine.backends.base import make_backend
    from ves_gym.system.system import System

    make_backend("kernl", System(), 1, 1)


def _environment():
    from gymnasium.vector import AutoresetMode

    from ves_gym.baselines.evaluate import make_vector

    make_vector("ves/PumaReech-v0", 1, AutoresetMode.NEXT_STEP)


def _candidate():
    from types import SimpleNamespace

    from ves_gym.diagnosis.inference.candidates import without

    without([SimpleNamespace(kind="joint/coulomb")], ["joint/coulom"])


REFUSALS = (_planner, _vehicle, _suite, _effect_kind, _effect_key, _key, _choice, _union)
REFUSALS += (_task, _setting, _reset_option, _track, _problem, _controller, _backend)
REFUSALS += (_environment, _candidate)


@pytest.mark.parametrize("refused", REFUSALS, ids=lambda f: f.__name__.strip("_"))
def test_an_unknown_name_is_refused_with_the_closest_known_one(refused):
    with pytest.raises(ParameterError, match=r"; did you mean \"[^\"]+\"\?"):
        refused()
