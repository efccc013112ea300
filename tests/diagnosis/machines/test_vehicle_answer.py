"""An unknown mode answers the wrench measured: against SciPy, in noise, and in a diagnosis."""

import dataclasses

import numpy as np
import pytest
import scipy

from ves_gym.diagnosis.data.measured_run import run_of_signals
from ves_gym.diagnosis.diagnose import diagnose
from ves_gym.diagnosis.excitation import excitation_motions
from ves_gym.diagnosis.inputs import system_inputs
from ves_gym.diagnosis.machines.vehicle_answer import answering_force
from ves_gym.diagnosis.machines.vehicle_force import force_of_states
from ves_gym.effects import BaseExtraMode
from ves_gym.mechanics.arm import Inertial, matrix
from ves_gym.mechanics.vehicle import (
    BaseModel,
    InternalModes,
    MatrixVehicle,
    Oscillator,
    Satellite,
)
from ves_gym.simulation.playback import play_motions
from ves_gym.system.system import System

DT, T = 0.0125, 10.0
M = np.diag([420.0, 420.0, 420.0, 160.0, 160.0, 120.0])
K = np.diag([90e3, 120e3, 240e3, 90e3, 110e3, 60e3])
D = 0.05 * 2 * np.sqrt(K * M)
RIDER = {
    "mass": 300.0,
    "frequency": 3.27,
    "damping_ratio": 0.02,
    "direction": (0.0, 1.0, 0.0),
}
NOISE = 5e-5  # m and rad, of the pose
STD = {"q": 1.5e-4, "v": 2e-3, "tau": 0.4, "y": NOISE, "w": 0.3}
TONES = ((0.7, 60.0, 0.3), (1.9, 25.0, 1.1), (3.1, 15.0, 2.0))  # Hz, N, rad


def wrench(t):
    """A push on all coordinates that starts from nothing."""
    tones = sum(a * np.sin(2 * np.pi * f * t + p) for f, a, p in TONES)
    return np.multiply.outer(tones * np.square(np.sin(np.pi * t / T)), np.ones(6))


def integrated(zeta):
    """Time, pose and true force of the rider, by another's integrator from Newton's laws."""
    m, w = RIDER["mass"], 2 * np.pi * RIDER["frequency"]

    def pull(s):
        way, rate = s[12] - s[1], s[13] - s[7]
        return m * (w**2 * way + 2 * zeta * w * rate)

    def rates(t, s):
        force = wrench(t) - D @ s[6:12] - K @ s[:6]
        force[1] += pull(s)
        return np.r_[s[6:12], np.linalg.solve(M, force), s[13], -pull(s) / m]

    t = np.arange(0, T, DT)
    s = scipy.integrate.solve_ivp(
        rates, (0, T), np.zeros(14), "DOP853", t, rtol=1e-10, atol=1e-13
    ).y
    return t, s[:6].T, pull(s)


@pytest.fixture(scope="module")
def motion():
    return integrated(RIDER["damping_ratio"])


def run_with(motion, noise):
    """The run that a log of the motion holds."""
    t, y, _ = motion
    drawn = noise * np.random.default_rng(3).standard_normal(y.shape)
    meta = {"noise_std": {"y": [max(noise, 1e-9)] * 6, "w": [1e-3] * 6}}
    return run_of_signals(t, {"y": y + drawn, "w": wrench(t)}, "run", meta=meta)


def carrying(modes):
    return BaseModel(M, D, K, internal=modes)


def mode(**changes):
    return InternalModes.of((BaseExtraMode(**{**RIDER, **changes}).oscillator,))


def test_a_rider_pulls_as_integrated_by_scipy(motion):
    force = answering_force(run_with(motion, 0.0), carrying(mode()), mode())
    assert np.abs(force[:, 1] - motion[2]).max() < 2e-3 * np.abs(motion[2]).max()
    assert not force[:, [0, 2, 3, 4, 5]].any()


def test_the_noise_of_a_pose_hardly_moves_it(motion):
    """Driven by the pose measured, the same rider is off by a hundred times as much."""
    run, true = run_with(motion, NOISE), motion[2]
    late = slice(50, -50)
    off = (answering_force(run, carrying(mode()), mode())[:, 1] - true)[late].std()
    modes, yd, ydd = mode(), run.base.v, run.base.a
    A, B = -np.diag(modes.omega**2), -(ydd @ modes.coupling)
    ratio = 2 * RIDER["damping_ratio"] * modes.omega[0]
    way = scipy.signal.lsim(([1.0], [1.0, ratio, -A[0, 0]]), B[:, 0], motion[0])[1]
    states = np.stack([way, np.gradient(way, DT)], axis=-1)
    driven = (force_of_states(modes, states, yd)[:, 1] - true)[late].std()
    print(f"off by {off:.3g} N; driven by the pose measured by {driven:.3g} N")
    assert off < 0.3 < 10.0 < driven  # 0.3 N: what a force sensor reads to


def test_a_run_that_begins_in_motion_begins_as_its_pose_does():
    """Once the rider's start has died away: from rest the vehicle would be 4 % off still."""
    t, y, true = integrated(0.1)
    first, late = 240, slice(240, 400)  # of 3 s; from 6 to 8 s
    meta = {"noise_std": {"y": [1e-9] * 6, "w": [1e-3] * 6}}
    cut = {"y": y[first:], "w": wrench(t)[first:]}
    run = run_of_signals(t[first:] - t[first], cut, "cut", meta=meta)
    modes = mode(damping_ratio=0.1)
    off = answering_force(run, carrying(modes), modes)[:, 1] - true[first:]
    print(
        f"off by {np.abs(off[late]).max() / np.abs(true[first:][late]).max():.3g} of the most"
    )
    assert np.abs(off[late]).max() < 0.02 * np.abs(true[first:][late]).max()


def test_modes_known_and_unknown_answer_together(motion):
    """Two riders, of which either may be the known one: what both pull is the same."""
    run = run_with(motion, 0.0)
    other = InternalModes.of(
        (
            Oscillator(
                mass=40.0, stiffness=40.0 * 30.0**2, damping=20.0, direction=(1.0, 0.0, 0.0)
            ),
        )
    )
    alone = answering_force(run, carrying(mode()), mode())[:, 1]
    beside = answering_force(run, carrying(other.joined(mode())), mode())[:, 1]
    assert np.allclose(alone, beside, atol=1e-6 * np.abs(alone).max())


def noisy(log, seed):
    """A log with white noise on what sensors read."""
    rng = np.random.default_rng(seed)
    read = {
        k: getattr(log, k) + s * rng.standard_normal(getattr(log, k).shape)
        for k, s in STD.items()
    }
    stated = {k: [s] * getattr(log, k).shape[1] for k, s in STD.items()}
    return dataclasses.replace(log, **read, meta={**log.meta, "noise_std": stated})


def named_on(vehicle, rider):
    """The diagnosis of three noisy logs of a vehicle with a rider that nobody described."""
    described = System(vehicle=vehicle)
    hidden = described.replace(effects=(BaseExtraMode(**rider),))
    motions = excitation_motions(3, described.arm, duration=7.0, seed=11)
    recording = play_motions(hidden, motions, settle=1.0, record_dt=DT, seed=11)
    logs = [noisy(recording.log(i), seed=i) for i in range(3)]
    inputs = system_inputs(logs, described)
    library = [c for c in inputs.candidates if c.kind.startswith("base/")]
    return diagnose(inputs.machine, inputs.runs, inputs.final, candidates=library)


@pytest.mark.slow
def test_a_heavy_mode_is_named_with_its_mass_through_the_noise_of_a_pose():
    vehicle = MatrixVehicle(M=M.tolist(), D=D.tolist(), K=K.tolist(), source="this test")
    found = named_on(vehicle, RIDER)
    (name,) = found.explanations
    assert name.candidate.name == "base/extra_mode at y", found.sentence
    assert name.values == pytest.approx([RIDER["mass"], RIDER["frequency"]], rel=0.05)


@pytest.mark.slow
def test_a_mode_on_a_satellite_is_named_along_its_way():
    """Its 60 kg come on top of the 800 kg of the body, which is as described."""
    body = Inertial(mass=800.0, com=(0.0, 0.0, -0.5), inertia=matrix(np.diag([300.0] * 3)))
    rider = {**RIDER, "mass": 60.0, "frequency": 1.9, "direction": (1.0, 0.0, 0.0)}
    found = named_on(Satellite(body=body, source="this test"), rider)
    (name,) = found.explanations
    assert name.candidate.name == "base/extra_mode at x", found.sentence
    assert name.values == pytest.approx([60.0, 1.9], rel=0.05)
    assert found.system.actual.vehicle.extra[0].mass == pytest.approx(60.0, rel=0.05)
