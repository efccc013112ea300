"""Friction that depends on how joints have moved: a fine integration, a loop, its port."""

import dataclasses

import numpy as np
import scipy

import ves_gym as vg
from ves_gym.diagnosis.data.measured_run import run_of
from ves_gym.diagnosis.excitation import excitation_motions
from ves_gym.diagnosis.machines.system import SystemMachine
from ves_gym.effects import JointMemory
from ves_gym.mechanics.vehicle import BENT_THESIS
from ves_gym.simulation.playback import play_motions
from ves_gym.system.deviations import BENT, FORGOTTEN, RESTING, advanced, fresh, friction

NOTHING = (0.0,) * 3
STICKS = JointMemory(
    lasting=(3.0, 5.0, 2.0), rested_fast=NOTHING, rested=(20.0,) * 3, rested_slow=NOTHING
)
SPACE = vg.System(vehicle=BENT_THESIS)


def test_states_follow_their_equations():
    """Reference: SciPy's integrator, at a rate that does not change."""
    for rate in (-0.3, 1e-3, 0.0):

        def slopes(t, x, rate=rate):
            bent = (rate - abs(rate) * x[0]) / BENT
            ages = [
                (1 - a) / T - abs(rate) / FORGOTTEN * a
                for a, T in zip(x[1:], RESTING, strict=True)
            ]
            return [bent, *ages]

        start = [0.4, 0.2, 0.5, 0.9]
        exact = scipy.integrate.solve_ivp(
            slopes, (0, 0.02), start, rtol=1e-10, atol=1e-12, method="LSODA"
        ).y[:, -1]
        bristle, age = advanced(np.array(0.4), np.array(start[1:]), np.array(rate), 0.02)
        np.testing.assert_allclose([bristle, *age], exact, atol=1e-7)


def test_it_takes_energy_out_but_for_what_bristles_hold():
    """At any motion, and whatever the weights are."""
    rng = np.random.default_rng(0)
    dt, v = 1e-4, np.cumsum(rng.standard_normal((4000, 50)), axis=0) * 1e-3
    levels = rng.uniform(-10, 20, (50, 1 + len(RESTING)))
    x, work, most = fresh((50,)), np.zeros(50), 0.0
    for rate in v:
        x = advanced(*x, rate, dt)
        work += friction(levels, *x) * rate * dt
        most = max(most, float(work.max()))
    assert most < np.abs(levels).sum(axis=1).max() * BENT / 2
    assert work.max() < 0 or (levels.sum(axis=1) < 0).any()


def test_a_log_of_it_is_what_its_port_expects():
    """Torques logged are the motors'; with the effect described nothing is left of it."""
    system = SPACE
    motions = excitation_motions(1, system.arm, duration=4.0, seed=2)
    log = play_motions(system.replace(effects=(STICKS,)), motions, settle=0.5).log(0)
    stated = {"system": system.to_dict(), "noise_std": {"v": [1e-5] * 3}}
    run = run_of(dataclasses.replace(log, meta={**log.meta, **stated}), "run")
    machine = SystemMachine(system)
    models = [machine.nominal, machine.model([STICKS])]
    left = machine.residuals(run, models, ["joint"])["joint"]
    before, after = np.sqrt(np.mean(np.square(np.abs(run.window.spectrum(left))), axis=1))
    assert before[1] > 2.0 and after[1] < 0.3 * before[1]


def test_a_state_saved_goes_on_as_it_was():
    sim = vg.Simulator(SPACE.replace(effects=(STICKS,)), 2)
    sim.reset()
    for k in range(20):
        sim.step(20 * np.cos(0.3 * k) * np.ones((2, 3)))
    saved = sim.snapshot()
    first = [sim.step(15.0).q for _ in range(10)][-1]
    sim.restore(saved)
    again = [sim.step(15.0).q for _ in range(10)][-1]
    np.testing.assert_allclose(first, again, atol=1e-12)
