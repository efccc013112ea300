"""The optional GPU engines against the kernel; they run here only where they are installed.

Single precision: 1e-7 relative of numbers whose size is at most the platform's 1e10 kg.
"""

import importlib

import numpy as np
import pytest

from ves_gym._util.params import ParameterError
from ves_gym.effects import JointViscous
from ves_gym.mechanics.vehicle import BENT_THESIS
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.system import System

NEEDS = {"mjx": ("jax", "mujoco.mjx"), "warp": ("warp", "mujoco_warp")}


def installed(name):
    for module in NEEDS[name]:
        pytest.importorskip(module)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "mode"), [("mjx", "ideal"), ("warp", "ideal"), ("warp", "emulated")]
)
def test_a_quarter_of_a_second_agrees_with_the_kernel(name, mode):
    installed(name)
    system, n = System(vehicle=BENT_THESIS, mode=mode), 4
    sims = [Simulator(system, n, backend=k, warn_at=None) for k in (name, "kernel")]
    q = np.random.default_rng(0).normal(0, 0.5, (n, 3))
    hold = sims[0].servo_command(q, 0 * q)
    for sim in sims:
        sim.reset(q=q, y=0.01)
        for k in range(20):
            sim.step(hold + 10 * np.sin(k))
    for device, kernel in zip(sims[0].state, sims[1].state, strict=True):
        np.testing.assert_allclose(device, kernel, atol=2e-4)
    assert sims[0].backend_name == name


@pytest.mark.parametrize("name", NEEDS)
def test_what_is_missing_is_said(name):
    for module in NEEDS[name]:
        if importlib.util.find_spec(module.split(".")[0]) is None:
            break
    else:
        pytest.skip("installed here")
    with pytest.raises(ParameterError, match=f"backend {name} needs the package"):
        Simulator(System(vehicle=BENT_THESIS), backend=name)


@pytest.mark.parametrize(
    ("name", "system", "message"),
    [
        (
            "warp",
            System(vehicle=BENT_THESIS, effects=(JointViscous(damping=(1.0,) * 3),)),
            "no torque laws",
        ),
        ("warp", System(vehicle=BENT_THESIS, integrator="implicitfast"), "got implicitfast"),
        ("mjx", System(vehicle=BENT_THESIS, mode="emulated"), "no mode emulated"),
    ],
)
def test_what_they_cannot_do_is_refused(name, system, message):
    installed(name)
    with pytest.raises(ParameterError, match=message):
        Simulator(system, backend=name, warn_at=None)
