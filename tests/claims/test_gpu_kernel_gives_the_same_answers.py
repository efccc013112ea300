"""Claim: the equations as Warp code give the answers of the compiled kernel.

Each random system of the kernel's own claim runs on both, with the same random commands: 2 s
of the PUMA 560 on the bent beam here; every structure and every machine in mode emulated among
the slow tests. On Warp's CPU device, whose text is the GPU's.

Tolerance: 1e-9 of max(1, value) for state, torque and acceleration in float64 (measured:
1e-13); in float32 1e-4 of the state. A link heavier by one part in 1e6 is seen in float64.
"""

import numpy as np
import pytest

from tests.arms import heavier
from tests.claims import test_kernel_gives_the_same_answers as kernel_claim
from tests.claims.test_kernel_gives_the_same_answers import (
    MACHINES,
    STRUCTURES,
    gap,
    label,
    machines,
    reading_gap,
    run,
    state_gap,
    systems,
)
from ves_gym._util.optional import installed
from ves_gym.mechanics.vehicle import BENT_THESIS
from ves_gym.system.system import System

pytestmark = [
    pytest.mark.skipif(not installed("warp"), reason="warp-lang is not installed"),
    pytest.mark.filterwarnings("ignore:backend gpu-kernel:UserWarning"),
]
DOUBLE, SINGLE = 1e-9, 1e-4


def agree(system, seed):
    ours, theirs = (run(system, seed, backend) for backend in ("gpu-kernel", "kernel"))
    assert ours.frozen == theirs.frozen
    assert state_gap(ours, theirs) <= DOUBLE
    assert gap(ours.ydd, theirs.ydd) <= DOUBLE
    assert gap(ours.torque, theirs.torque) <= DOUBLE
    return ours, theirs


def test_two_seconds_of_the_puma_on_the_bent_beam(monkeypatch):
    monkeypatch.setattr(kernel_claim, "PERIODS", 160)
    _, theirs = agree(System(vehicle=BENT_THESIS), 0)
    assert len(theirs.state["y"]) >= 160
    assert np.abs(theirs.state["y"]).max() > 0.01
    other = run(heavier(System(vehicle=BENT_THESIS), 1 + 1e-6), 0, "gpu-kernel")
    assert state_gap(other, theirs) > 2 * DOUBLE


@pytest.mark.slow
@pytest.mark.parametrize("index", range(len(STRUCTURES)), ids=label)
def test_ideal(index):
    for k, system in enumerate(systems(index)[:3]):
        agree(system, 1000 * index + k)


@pytest.mark.slow
@pytest.mark.parametrize("name", MACHINES)
def test_emulated(name):
    for k, system in enumerate(machines(name)[:2]):
        ours, theirs = agree(system, 100 * list(MACHINES).index(name) + k)
        assert reading_gap(ours, theirs) <= DOUBLE


@pytest.mark.slow
def test_single_precision():
    ours, theirs = (
        run(System(vehicle=BENT_THESIS), 0, k) for k in ("gpu-kernel-float32", "kernel")
    )
    assert 1e-9 < state_gap(ours, theirs) <= SINGLE
