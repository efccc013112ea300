"""One healthy machine for all tests of the generator."""

import pytest


@pytest.fixture(scope="package")
def description():
    from ves_gym.discrepancy.blind.machine import nominal

    return nominal().to_dict()


@pytest.fixture(scope="package")
def gains():
    from ves_gym.discrepancy.blind.machine import controller

    return controller()


@pytest.fixture(scope="package")
def runner(description, gains):
    pytest.importorskip("numba")
    from ves_gym.discrepancy.blind.cases import Runner

    return Runner(description, gains)


@pytest.fixture(scope="package")
def setup(runner):
    return runner.nominal
