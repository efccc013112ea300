"""Every registered effect acts, its null value does not, and both engines say the same.

In each of its modes and on each engine, over thirty control periods of a swinging arm.
"""

import functools

import numpy as np
import pytest

from tests.effects.values import VALUES, effect, null
from ves_gym.mechanics.vehicle import DECOUPLED
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.effect import EFFECTS, PORTS
from ves_gym.system.system import System

BACKENDS = ("kernel", "mujoco")
CASES = [(kind, mode) for kind in sorted(EFFECTS) for mode in EFFECTS[kind].modes]


def system(mode, *effects):
    return System(mode=mode, vehicle=DECOUPLED, effects=effects)


def run(given, backend):
    """Everything seen, per period, two simulations: [(time, y, yd, q, v, readings ...)]."""
    sim = Simulator(given, 2, seed=3, backend=backend, warn_at=None)
    out = []
    for k in range(30):
        phase = 2 * np.pi * k / 40 + np.array([[0.0, 1.0, 2.0], [2.0, 0.0, 1.0]])
        command = sim.servo_command(0.2 * np.sin(phase), np.zeros((2, 3)))
        state = sim.step(command)
        seen = sim.readings if given.mode == "emulated" else ()
        out.append([*state, *seen, *sim.evaluate(command)])
    return out


@functools.cache
def nominal(mode, backend):
    return run(system(mode), backend)


@functools.cache
def typical(kind, mode, backend):
    return run(system(mode, effect(kind)), backend)


def far(a, b):
    """Largest difference of pose or angles over the runs [m, rad]."""
    return max(np.abs(x[i] - y[i]).max() for x, y in zip(a, b, strict=True) for i in (1, 3))


@pytest.mark.parametrize(("kind", "mode"), CASES)
def test_a_typical_value_changes_the_output(kind, mode):
    """Far above rounding (1e-12 m); what the motion does not show, reading or torque does."""
    got, want = typical(kind, mode, "kernel"), nominal(mode, "kernel")
    assert all(np.isfinite(part).all() for row in got for part in row)
    assert far(got, want) > 1e-9


@pytest.mark.parametrize("backend", ["kernel", pytest.param("mujoco", marks=pytest.mark.slow)])
@pytest.mark.parametrize(("kind", "mode"), CASES)
def test_the_null_value_changes_nothing_bit_for_bit(kind, mode, backend):
    assert null(kind).is_null and not effect(kind).is_null
    got, want = run(system(mode, null(kind)), backend), nominal(mode, backend)
    for row, wanted in zip(got, want, strict=True):
        assert all(a.tobytes() == b.tobytes() for a, b in zip(row, wanted, strict=True))


@pytest.mark.parametrize(("kind", "mode"), CASES)
def test_engines_agree(kind, mode):
    """MuJoCo holds what a law gives over each physics step: to 2 % of what the effect does.

    The rest is the engines' own difference, 1e-8 (`docs/claims.md`).
    """
    runs = [typical(kind, mode, backend) for backend in BACKENDS]
    change = far(runs[0], nominal(mode, "kernel"))
    assert far(*runs) < 0.02 * change + 1e-7


def test_every_effect_says_where_it_enters():
    assert set(VALUES) == set(EFFECTS)
    for kind, cls in EFFECTS.items():
        assert cls.port in PORTS, kind
        assert set(cls.modes) <= {"ideal", "emulated"}, kind
