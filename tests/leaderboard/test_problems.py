"""Problems, seeds and their salt."""

from pathlib import Path

import gymnasium as gym
import pytest

from ves_gym._util.params import ParameterError
from ves_gym.leaderboard.entry import Code
from ves_gym.leaderboard.problems import SCORES, get_problem, problems, read_salt, seeds_of
from ves_gym.leaderboard.tracks.paths import path_queries
from ves_gym.mechanics.flexible_base import FlexibleBase

SALT = "a secret of the maintainer"


def test_problems_of_every_track():
    assert len(problems("paths")) == 2 * 12
    ids = {k for k in gym.registry if k.startswith("ves/")}
    assert {get_problem("tasks", k).environment for k in problems("tasks")} == ids
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
    problem = get_problem("paths", "straight-horizontal-2s-obstacles-quick")
    queries = path_queries(problem, seeds_of(problem, None))
    assert len(queries) == 10 and queries[0].surroundings is not None
    assert {q.duration for q in queries} == {2.0}
    assert isinstance(queries[0].system.vehicle, FlexibleBase)
    free = get_problem("paths", "straight-horizontal-2s")
    assert path_queries(free, seeds_of(free, None))[0].start == queries[0].start
    assert path_queries(free, seeds_of(free, SALT))[0].start != queries[0].start


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
        assert f"| *{track}* |" in page
