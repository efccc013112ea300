"""`FreeDecay`, the closed form, against ten simulated seconds with the joints held."""

import numpy as np
import pytest

from ves_gym.envs.batch import Batch
from ves_gym.envs.build import build_task
from ves_gym.envs.tail import FreeDecay
from ves_gym.mechanics.servo import HIGH_GAINS
from ves_gym.mechanics.vehicle import BENT_THESIS, VEHICLES, MatrixVehicle
from ves_gym.system.energy import base_energy
from ves_gym.system.system import System

TAIL = 10.0  # s
GAINS = HIGH_GAINS.kp, HIGH_GAINS.kd
N = 32


def diagonal(*values):
    return tuple(tuple(map(float, row)) for row in np.diag(values))


# base modes of 17 to 44 Hz, which the closed form samples every 10 ms
STIFF = MatrixVehicle(
    M=diagonal(50, 50, 50, 10, 10, 10),
    K=diagonal(4e6, 4e6, 4e6, 1e6, 1e6, 1e6),
    D=diagonal(1e3, 1e3, 1e3, 300, 300, 300),
)
SYSTEMS = {
    **{k: System(vehicle=VEHICLES[k], physics_dt=2.5e-3) for k in ("bent-thesis", "decoupled")},
    "straight-horizontal-thesis": System(
        vehicle=VEHICLES["straight-horizontal-thesis"], physics_dt=2.5e-3
    ),
    "prescribed joints": System(vehicle=BENT_THESIS, drive="prescribed", physics_dt=2.5e-3),
    "stiff": System(vehicle=STIFF, physics_dt=6.25e-4),
}
MORE = ("bent-thesis", "straight-horizontal-thesis", "prescribed joints")


def ended(system, **settings):
    """N episodes that have just ended, moved about by smooth random actions."""
    gentle = {"control": {"kind": "guided", "jerk": 40.0}}  # joints end near where they are led
    batch = Batch(build_task("rest_to_rest", system=system, **{**gentle, **settings}), N)
    everyone = np.arange(N)
    batch.seed(everyone, 0, everyone)
    batch.reset(everyone)
    noise, push = np.random.default_rng(0), np.zeros((N, batch.width))
    for _ in range(batch.task.steps):
        push = 0.9 * push + noise.uniform(-0.3, 0.3, push.shape)
        batch.step(np.clip(push, -1, 1))
    return batch


def simulated(batch, command):
    """Time integrals of E and of the strain energy while the command is held [J s]."""
    sim, dt = batch.sim, 2.5e-3  # between records
    held = np.repeat(command[:, None], round(dt / batch.system.physics_dt) + 1, axis=1)
    states = [sim.state]
    for _ in range(round(TAIL / dt)):
        sim.play(held)
        states.append(sim.state)
    q, y, yd = (np.stack([getattr(s, k) for s in states]) for k in ("q", "y", "yd"))
    energy = base_energy(batch.system.ideal(), q, y, yd)
    return tuple(np.trapezoid(e, dx=dt, axis=0) for e in (energy.total, energy.strain))


def state(batch, away):
    """(n, 2 (b + joints)) base with its internal modes and joints, and their rates."""
    s, none = batch.scene, np.zeros((len(away), 0))
    u, ud = batch.sim.base_modes or (none, none)
    return np.concatenate([s.y, u, away, s.yd, ud, s.v], axis=1)


def decay(batch, gains=GAINS):
    return FreeDecay(batch.system.ideal(), N, TAIL, gains)


@pytest.mark.parametrize("name", ["bent", "decoupled", "free-flying", "prescribed joints"])
def test_coupled_modes_are_the_exact_motion(name):
    """Against the matrix exponential, from anywhere; a state's numbers are its own."""
    vehicle, rng = VEHICLES.get(name, BENT_THESIS), np.random.default_rng(0)
    drive = "prescribed" if name == "prescribed joints" else "motor"
    system = System(vehicle=vehicle, drive=drive, physics_dt=2.5e-3)
    b = len(system.base.full()[0])
    q, kp, kd = rng.uniform(-2, 2, (N, 3)), *(np.tile(k, (N, 1)) for k in GAINS)
    parts = [((N, 6), 1e-2), ((N, b - 6), 0.0), ((N, 3), 1e-2)]
    x = np.hstack([rng.normal(size=size) * s for size, s in parts + parts])
    compiled = FreeDecay(system, N, TAIL, GAINS)
    assert not compiled.exact
    exact = FreeDecay(system, N, TAIL, None)(q, x, kp, kd)
    found = compiled(q, x, kp, kd)
    np.testing.assert_allclose(compiled(q[:3], x[:3], kp[:3], kd[:3]), np.stack(found)[:, :3])
    for ours, truth in zip(found, exact, strict=True):
        error = np.abs(ours - truth) / np.maximum(truth, 1e-12)
        print(f"{name}: median {np.median(error):.1e}, max {error.max():.1e}")
        assert np.median(error) <= 1e-3
        assert error.max() <= 1e-2


@pytest.mark.parametrize("arm", ["ur5e"])
def test_joints_near_critical_damping_are_counted_exactly(arm):
    """Modes give 1e242 J s there, or no number; a system with them does not use them."""
    batch = Batch(build_task("reach", arm=arm), 1)
    assert batch.free_decay.exact
    assert not Batch(build_task("reach"), 1).free_decay.exact


@pytest.mark.parametrize(
    "name", ["decoupled", "stiff", *(pytest.param(k, marks=pytest.mark.slow) for k in MORE)]
)
@pytest.mark.parametrize("duration", [0.5, pytest.param(2.0, marks=pytest.mark.slow)])
def test_tail_is_the_simulated_one(name, duration):
    """Within 1 % in the median; the largest of 32 within 3 %."""
    batch = ended(SYSTEMS[name], duration=duration)
    s = batch.scene
    away = s.q - s.ref[:, 0]
    predicted = decay(batch)(s.q, state(batch, away), s.kp, s.kd)
    for ours, truth in zip(predicted, simulated(batch, batch._command()), strict=True):
        error = np.abs(ours / truth - 1)
        print(f"{name}, {duration} s: median {np.median(error):.1e}, max {error.max():.1e}")
        assert np.median(error) <= 0.01
        assert error.max() <= 0.03


@pytest.mark.parametrize("vehicle", ["bent-thesis", "bent"])
def test_tail_of_an_episode_is_part_of_its_mean(vehicle):
    """E_mean and the reward's last term come from it."""
    batch = Batch(build_task("rest_to_rest", vehicle=vehicle), N)
    everyone = np.arange(N)
    batch.seed(everyone, 0, everyone)
    batch.reset(everyone)
    during = np.zeros(N)
    for _ in range(batch.task.steps):
        left = 1 + batch.episodes.total
        before = batch.scene.energy.copy()
        *_, info = batch.step(np.zeros((N, 3)))
        during += (before + batch.scene.energy) * batch.dt / 2
    s = batch.scene
    away = s.q - s.ref[:, 0]
    tail, _ = decay(batch)(s.q, state(batch, away), s.kp, s.kd)
    mean = (during + tail) / (batch.task.duration + TAIL)
    np.testing.assert_allclose(info["energy/E_mean"], mean, rtol=1e-12)
    scale = np.maximum(s.goal[:, 3], batch.task.least_energy) * (batch.task.duration + TAIL)
    paid = info["reward/tail"] / (left * (1 + batch.episodes.total))
    np.testing.assert_allclose(paid, -tail / scale, rtol=1e-9)


def test_free_joints_are_caught_where_they_are():
    """Torque control: from the end on, the high-gain servos hold the joints at rest."""
    batch = ended(
        System(vehicle=BENT_THESIS, physics_dt=2.5e-3), control="torque", duration=0.25
    )
    s = batch.scene
    np.testing.assert_array_equal(s.kp, np.tile(HIGH_GAINS.kp, (N, 1)))
    none = np.zeros_like(s.q)
    predicted, _ = decay(batch)(s.q, state(batch, none), s.kp, s.kd)
    batch.sim.set_gains(s.kp, s.kd)
    truth, _ = simulated(batch, batch.sim.servo_command(s.q, none))
    error = np.abs(predicted / truth - 1)
    print(f"caught: median {np.median(error):.1e}, max {error.max():.1e}")
    assert np.median(error) <= 0.05  # they may move by tens of degrees while they are caught
