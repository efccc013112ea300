"""Problems, seeds and their salt."""

from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from ves_gym._util.params import ParameterError
from ves_gym.leaderboard.entry import Code, Method
from ves_gym.leaderboard.problems import SCORES, get_problem, problems, read_salt, seeds_of
from ves_gym.leaderboard.tracks.paths import PathTrack, path_queries
from ves_gym.mechanics.flexible_base import FlexibleBase
from ves_gym.planners.execution_check import solve_with_reserve
from ves_gym.planners.registry import get_planner

SALT = "a secret of the maintainer"


def test_problems_of_every_track():
    assert sum(len(problems(track)) for track in SCORES) / 2 <= 40
    ids = {k for k in gym.registry if k.startswith("ves/")}
    asked = {get_problem(t, k).environment for t in ("tasks", "damping") for k in problems(t)}
    assert asked - {None} == ids
    assert {"gains-bent", "ves/PumaDampEmulated-v0"} < set(problems("damping"))
    for track in SCORES:
        for name in problems(track):
            problem = get_problem(track, name)
            assert problem.kinds and problem.count > 0
            assert problem.quick == name.endswith("-quick")
    with pytest.raises(ParameterError, match="track must be one of"):
        problems("speed")
    with pytest.raises(ParameterError, match="problem of track paths"):
        get_problem("paths", "bent-3s")


def test_queries_are_reach100_on_finite_elements():
    problem = get_problem("paths", "bent-2s-obstacles-quick")
    queries = path_queries(problem, seeds_of(problem, None))
    assert len(queries) == 10 and queries[0].surroundings is not None
    assert {q.duration for q in queries} == {2.0}
    assert isinstance(queries[0].system.vehicle, FlexibleBase)
    free = get_problem("paths", "bent-2s")
    assert path_queries(free, seeds_of(free, None))[0].start == queries[0].start
    assert path_queries(free, seeds_of(free, SALT))[0].start != queries[0].start


@pytest.mark.parametrize(
    ("name", "joints", "count"),
    [("bent-iiwa14-2s", 7, 100), ("servicer-flexible-2s-quick", 3, 10), ("thesis", 3, 2)],
)
def test_queries_of_other_arms_and_bases(name, joints, count):
    problem = get_problem("paths", name)
    queries = path_queries(problem, seeds_of(problem, None))
    assert len(queries) == count == problem.count
    assert {q.system.arm.n for q in queries} == {joints}


def test_who_shakes_the_mount_fails_where_calm_is_asked():
    """`refined` has a tenth of the energy, and seven times the acceleration."""
    for name, well in (("bent-2s-calm-quick", 0.0), ("bent-2s-quick", 1.0)):
        problem = get_problem("paths", name)
        seeds = seeds_of(problem, None)
        track = PathTrack(problem, seeds, Method(kind="planner", name="refined"))
        query = path_queries(problem, seeds)[0]
        plan = solve_with_reserve(get_planner("refined"), query)
        points = np.array(plan.motion.control)
        nothing = np.zeros((0, 3))
        found = track.replay([[points, *[nothing] * 9]])
        assert found["success"][0, 0] == well and found["acceleration"][0, 0] > 2
        assert np.isfinite(found["score"][0, 0]) == bool(well)
        assert not found["success"][0, 1:].any()


def test_official_seeds_are_secret_and_differ():
    roots = set()
    for track in SCORES:
        for name in problems(track):
            problem = get_problem(track, name)
            public, official = seeds_of(problem, None), seeds_of(problem, SALT)
            assert public.name == "public" and official.name.startswith("official-")
            assert 0 <= official.root < 2**56 and official == seeds_of(problem, SALT)
            assert official.name != seeds_of(problem, SALT + "!").name
            assert SALT not in str(official)
            roots.add(official.root)
    assert len(roots) == sum(len(problems(track)) for track in SCORES) / 2  # quick ones share


def test_a_salt_from_a_file(tmp_path):
    file = tmp_path / "salt"
    file.write_text(f"  {SALT}\n")
    assert read_salt(file) == SALT
    file.write_text("short")
    with pytest.raises(ParameterError, match="at least 16"):
        read_salt(file)
    with pytest.raises(ParameterError, match="cannot be read"):
        read_salt(tmp_path / "none")


def test_every_code_is_documented():
    """In docs/leaderboard.md, with the words of the code itself."""
    page = (Path(__file__).parents[2] / "docs/leaderboard.md").read_text("utf-8")
    for code in Code:
        assert f"| `{code.slug}` | {code.value} |" in page
    for track in SCORES:
        assert f"- *{track}* (" in page
