"""A small sweep that tests share."""

import pytest

from tests.experiments.sweeps import spec
from ves_gym.experiments.sweep import sweep


@pytest.fixture(scope="session")
def swept(tmp_path_factory):
    """Folder, report and progress of a small sweep, done by two workers."""
    folder, progress = tmp_path_factory.mktemp("sweep"), []
    report = sweep(spec(), folder, workers=2, progress=lambda *words: progress.append(words))
    return folder, report, progress
