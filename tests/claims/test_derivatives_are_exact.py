"""Claim: derivatives of a rollout are exact, along parameters and along commands.

Reference: central differences of the same rollout with a relative step of 1e-4 (truncation
1e-8 of a smooth dependence). Promised: 1e-6 relative; cost of p directions about p rollouts.
"""

import numpy as np
import pytest

from ves_gym._util.params import ParameterError
from ves_gym.effects import JointStribeck
from ves_gym.engine.kernel.numbers import parameters
from ves_gym.engine.kernel.sensitivity import rollout_gradients
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.vehicle import BENT_THESIS, FREE_FLOATING, STRAIGHT_VERTICAL_THESIS
from ves_gym.simulation.playback import play_motions
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.system import System

MOTION = Motion.straight(np.zeros(3), np.deg2rad([60, 40, -30]), 1.0)
CASES = {
    "bent-thesis": (
        System(vehicle=BENT_THESIS),
        ("K11", "D55", "M33", "link2.mass", "link3.com1", "base.mass", "kp1"),
    ),
    "straight": (System(vehicle=STRAIGHT_VERTICAL_THESIS), ("K15", "link2.rotor", "kd3")),
    "floating": (System(vehicle=FREE_FLOATING), ("satellite.mass", "satellite.I33")),
    "friction": (
        System(
            vehicle=BENT_THESIS,
            effects=(JointStribeck(coulomb=(3, 4, 2), stiction=(6, 8, 4), fade_speed=0.3),),
        ),
        tuple(f"joint/stribeck#1.{k}" for k in ("coulomb2", "stiction1", "fade_speed")),
    ),
}


def played(system):
    """(1, k + 1, 3) commands of the motion at the physics steps, and the simulator."""
    sim = Simulator(system)
    sample = MOTION.at(np.arange(801) * system.physics_dt)
    tau = sim.servo.torque_feedforward(system.arm, sample)[None]
    return sim, sim.servo_command(sample.q[None], sample.v[None], tau)


def gains(system, p):
    names = parameters(system)[0]
    for name, value in zip(
        ("kp1", "kp2", "kp3", "kd1", "kd2", "kd3"), (3000, 2000, 1000, 50, 40, 30), strict=True
    ):
        p[:, names.index(name)] = value
    return names, p


@pytest.mark.parametrize(
    "case", [pytest.param(k, marks=pytest.mark.slow) if k == "straight" else k for k in CASES]
)
def test_along_parameters(case):
    system, wrt = CASES[case]
    _, commands = played(system)
    exact = rollout_gradients(system, commands, wrt=wrt)
    names, p = gains(system, np.tile(parameters(system)[1], (2, 1)))
    for j, name in enumerate(wrt):
        k = names.index(name)
        step = 1e-4 * abs(p[0, k])
        values = p.copy()
        values[:, k] += step, -step
        ends = rollout_gradients(system, np.repeat(commands, 2, axis=0), values=values)
        slope = (ends.x[0] - ends.x[1]) / (2 * step)
        np.testing.assert_allclose(exact.dx[0, j], slope, atol=1e-6 * np.abs(slope).max())
        energy = (ends.energy[0] - ends.energy[1]) / (2 * step)
        assert exact.denergy[0, j] == pytest.approx(energy, rel=1e-6, abs=1e-12)


def test_along_commands():
    system = System(vehicle=BENT_THESIS)
    _, commands = played(system)
    along = np.random.default_rng(0).normal(0, 1, (1, 801, 2, 3))
    exact = rollout_gradients(system, commands, along=along)
    for j in range(2):
        step = 1e-3  # N m
        push = step * along[:, :, j]
        ends = rollout_gradients(system, np.concatenate([commands + push, commands - push]))
        slope = (ends.x[0] - ends.x[1]) / (2 * step)
        np.testing.assert_allclose(exact.dx[0, j], slope, atol=1e-6 * np.abs(slope).max())
        energy = (ends.energy[0] - ends.energy[1]) / (2 * step)
        assert exact.denergy[0, j] == pytest.approx(energy, rel=1e-6)


def test_the_rollout_is_the_simulation():
    system = System(vehicle=BENT_THESIS)
    sim, commands = played(system)
    end = rollout_gradients(system, commands)
    sim.play(commands)
    state = sim.state
    there = np.concatenate([state.y, state.q, state.yd, state.v], axis=1)
    np.testing.assert_allclose(end.x, there, atol=1e-12)
    run = play_motions(system, [MOTION], settle=0.0, record_dt=system.physics_dt)
    mean = run.energies(tail=0.0)[0].E_mean
    assert end.energy[0] == pytest.approx(mean, rel=1e-6)  # the log's trapezoidal rule


def test_every_run_has_its_own_derivative():
    system = System(vehicle=BENT_THESIS)
    _, commands = played(system)
    many = np.concatenate([commands, 1.01 * commands, 0.9 * commands])
    together = rollout_gradients(system, many, wrt=("K11",))
    for i in range(3):
        alone = rollout_gradients(system, many[i : i + 1], wrt=("K11",))
        np.testing.assert_array_equal(together.dx[i], alone.dx[0])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"wrt": ("K99",)}, "unknown parameter 'K99'"),
        ({"wrt": ("K12",)}, "unknown parameter 'K12'"),  # zero in this system: structure
        ({"along": np.zeros((1, 5, 1, 3))}, "along must have shape"),
        ({"values": np.zeros((1, 3))}, "values must have shape"),
    ],
)
def test_wrong_arguments_are_refused(change, message):
    _, commands = played(System(vehicle=BENT_THESIS))
    with pytest.raises(ParameterError, match=message):
        rollout_gradients(System(vehicle=BENT_THESIS), commands, **change)


@pytest.mark.parametrize("other", [{"mode": "emulated"}, {"integrator": "euler"}])
def test_other_modes_and_integrators_are_refused(other):
    with pytest.raises(ParameterError, match="need mode ideal and integrator rk4"):
        rollout_gradients(System(vehicle=BENT_THESIS, **other), np.zeros((1, 2, 3)))
