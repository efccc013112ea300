"""A small sweep that tests share, and a pool in this process."""

from concurrent.futures import ThreadPoolExecutor

import pytest

from tests.experiments.sweeps import spec
from ves_gym.experiments.sweep import sweep


@pytest.fixture(scope="session")
def swept(tmp_path_factory):
    """Folder, report and progress of a small sweep, done by two workers."""
    folder, progress = tmp_path_factory.mktemp("sweep"), []
    report = sweep(spec(), folder, workers=2, progress=lambda *words: progress.append(words))
    return folder, report, progress


@pytest.fixture(scope="session")
def here():
    """Runs jobs in this process: what is tested is not where they run."""
    with ThreadPoolExecutor(1) as pool:
        yield pool
