"""Small honest entries, made by the real run, and how a spoiled one is refused."""

import pytest

from tests.leaderboard.entries import DAMP, Gentle, code_of, save_random_policy
from ves_gym.leaderboard.verify import make_entry


@pytest.fixture
def refused(tmp_path):
    """The code of a spoiled entry."""
    return lambda spoiled, **options: code_of(
        spoiled.write(tmp_path / f"e{len(list(tmp_path.iterdir()))}"), **options
    )


@pytest.fixture(scope="session")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("entries")


@pytest.fixture(scope="session")
def straight(folder):
    """Ten straight lines."""
    make_entry(folder / "straight", "paths", "bent-1s-quick", "straight")
    return folder / "straight"


@pytest.fixture(scope="session")
def policy(folder):
    """Ten episodes of a policy."""
    file = save_random_policy(folder / "mine.json")
    make_entry(folder / "policy", *DAMP, [file], author="someone")
    return folder / "policy"


@pytest.fixture(scope="session")
def own(folder):
    """Ten episodes of a controller of one's own, recorded."""
    make_entry(folder / "own", *DAMP, Gentle())
    return folder / "own"
