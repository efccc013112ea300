"""A vehicle in space: the force its modes take, unknown modes, and the noise of its pose.

References: closed forms, SciPy, the noise that was added, the numbers hidden. A force is told
to the sensor's accuracy at ports that differentiate a measured pose twice (mode ideal).
"""

import dataclasses
import functools

import numpy as np
import pytest
import scipy

import ves_gym.effects as E
from tests.diagnosis.logs import recorded, told, with_noise
from ves_gym._util.signals import SpectralWindow, margin
from ves_gym.diagnosis.data.measured_run import run_of, run_of_signals
from ves_gym.diagnosis.diagnose import NOTHING, WEAK
from ves_gym.diagnosis.inference.candidates import library
from ves_gym.diagnosis.inference.fit import fit
from ves_gym.diagnosis.inference.model_selection import cost
from ves_gym.diagnosis.inference.signatures import Signatures
from ves_gym.diagnosis.inference.whitened_residuals import WhitenedResiduals
from ves_gym.diagnosis.inputs import system_inputs
from ves_gym.diagnosis.machines.system import SystemMachine
from ves_gym.diagnosis.machines.vehicle_answer import answering_force
from ves_gym.diagnosis.machines.vehicle_force import (
    InnerStart,
    dynamic_stiffness,
    force_of_states,
    vehicle_gap,
)
from ves_gym.effects import BaseExtraMode
from ves_gym.mechanics.dynamics import inertia
from ves_gym.mechanics.link import Inertial, matrix
from ves_gym.mechanics.spatial import rate_matrix
from ves_gym.mechanics.vehicle import (
    BENT_THESIS,
    FREE_FLOATING,
    STRAIGHT_VERTICAL,
    BaseModel,
    InternalModes,
    MatrixVehicle,
    Oscillator,
    Satellite,
    get_vehicle,
)
from ves_gym.system.candidate import Scope
from ves_gym.system.system import System

SYSTEM = System(vehicle=STRAIGHT_VERTICAL)


class Tone:
    """A run whose vehicle moves in a tone, as its exact derivatives have it."""

    name = "tone"

    def __init__(self, f, dt, T=30.0):
        t, w = np.arange(0, T, dt), 2 * np.pi * f
        way = 1e-5 * np.array([1.0, -0.5, 0.2, 0.3, 0.8, -0.4])
        phase = np.exp(1j * w * t)[:, None] * way
        self.dt, self.t, self.way, self.w = dt, t, way, w
        self.length, self.window = len(t), SpectralWindow(len(t), dt, 12.0, margin(dt, 12.0))
        self.base = tuple(x.real for x in (phase, 1j * w * phase, -(w**2) * phase))

    def derived(self, name, uses, make):
        return np.eye(6), np.zeros((len(self.t), 6))  # nothing measured: the force alone


@pytest.mark.parametrize("f", [2.0, 11.0])
@pytest.mark.parametrize("dt", [0.0125, 0.00125])
def test_a_tone_takes_its_dynamic_stiffness_at_any_sampling(f, dt):
    """Reference: the closed form by frequency, once what began with the run has died away."""
    base, run = SYSTEM.actual.base, Tone(f, dt)
    stiffness = dynamic_stiffness(base, np.eye(6), np.array([run.w]))[0]
    expected = -(np.exp(1j * run.w * run.t)[:, None] * (stiffness @ run.way)).real
    late = run.t > 25
    error = np.abs(vehicle_gap(run, base) - expected)[late].max(axis=0)
    assert (error < 3e-3 * np.abs(expected[late]).max()).all()


@pytest.fixture(scope="module")
def log():
    """Noise-free, in space, of a vehicle with internal modes."""
    return recorded(SYSTEM, duration=8.0, record_dt=0.0125)[0]


def cut(log, first):
    """A log without its first samples; the clock begins at zero."""
    fields = {f.name: getattr(log, f.name) for f in dataclasses.fields(log) if f.init}
    taken = {
        k: x[first:] if isinstance(x, np.ndarray) and len(x) == len(log.t) else x
        for k, x in fields.items()
    }
    taken["t"] = taken["t"] - taken["t"][0]
    return dataclasses.replace(log, **taken)


def test_a_run_that_begins_in_motion_differs_by_the_states_of_its_modes(log):
    inputs = system_inputs([cut(log, 200)], SYSTEM, final=0)
    (run,) = inputs.runs
    base = SYSTEM.actual.base
    gap = np.reshape(vehicle_gap(run, base), (-1, *run["y"].shape[-2:]))[0][20:-20]
    decays = [
        InnerStart(run.name, i).force(run, base)[20:-20] for i in range(2 * base.internal.m)
    ]
    columns = np.stack([d.ravel() for d in decays], axis=1)
    columns /= np.linalg.norm(columns, axis=0)
    left = gap.ravel() - columns @ np.linalg.lstsq(columns, gap.ravel(), rcond=1e-9)[0]
    assert np.linalg.norm(left) < 0.05 * np.linalg.norm(gap)
    assert not InnerStart("another", 0).force(run, base).any()


def test_nothing_is_missing_in_a_log_that_begins_in_motion(log):
    found = told(SYSTEM, [cut(log, 200)], lambda c: "base" in c.ports)
    assert found.verdict in (NOTHING, WEAK), found.sentence


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


def named_on(vehicle, rider):
    """The diagnosis of three noisy logs of a vehicle with a rider that nobody described."""
    described = System(vehicle=vehicle)
    hidden = described.replace(effects=(BaseExtraMode(**rider),))
    logs = recorded(hidden, 11, 3, described=described, duration=7.0, record_dt=DT)
    logs = [with_noise(log, STD, np.random.default_rng(i)) for i, log in enumerate(logs)]
    return told(described, logs, lambda c: c.kind.startswith("base/"), final=None)


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


SIZES = {
    "y": np.array([2e-4] * 3 + [1e-4] * 3),
    "w": np.array([0.5] * 3 + [0.25] * 3),
    "q": np.full(3, 2e-5),
    "tau": np.full(3, 0.1),
}
BENT = System(vehicle=BENT_THESIS)


@functools.cache
def run_of_noisy(system, *effects, noisy=True):
    """A run of 10 s with something hidden, which its description does not say."""
    (log,) = recorded(system.replace(effects=effects))
    sizes = {k: noisy * s for k, s in SIZES.items()}
    return run_of(with_noise(log, sizes, np.random.default_rng(5)), "run")


class NoEstimate:
    """What is taken off the ports where nothing is estimated."""

    def in_torque(self, arm, wrench):
        return 0.0

    def in_wrench(self, arm, key, base, force):
        return 0.0


class Plain(SystemMachine):
    """Ports that differentiate the measured pose and take nothing off."""

    def _pose_noise(self, run):
        return NoEstimate()


def levels(system, run, w=True, machine_type=SystemMachine):
    """Root mean square in the band of the residuals at `joint` and `wrench`."""
    if not w:
        run = dataclasses.replace(run, signals={k: run[k] for k in run.signals if k != "w"})
    machine = machine_type(system)
    ports = ["joint", "wrench"] if w else ["joint"]
    found = machine.residuals(run, [machine.nominal], ports)
    return {
        k: np.sqrt(np.square(np.abs(run.window.spectrum(x[0]))).mean(axis=0))
        for k, x in found.items()
    }


@pytest.mark.parametrize("vehicle", [BENT_THESIS, FREE_FLOATING], ids=["bent", "satellite"])
def test_residuals_are_of_the_order_of_the_sensor_s_noise(vehicle):
    """Without the estimate, or where a log lacks the wrench, they are 48 N, 28 N m, 4.6 N m."""
    system = System(vehicle=vehicle)
    run = run_of_noisy(system)
    found, plain = levels(system, run), levels(system, run, machine_type=Plain)
    assert (found["wrench"] < 6 * SIZES["w"]).all()
    assert plain["wrench"][:3].max() > 40 and plain["wrench"][3:].max() > 20
    assert plain["joint"].max() > 3.0
    assert (found["joint"] < 5 * SIZES["tau"]).all()
    assert levels(system, run, w=False)["joint"].max() > 3.0


def test_an_exact_pose_is_left_alone():
    run = run_of_noisy(BENT, noisy=False)
    found = levels(BENT, run)
    assert max(x.max() for x in found.values()) < 5e-3


@pytest.mark.parametrize("name", ["bent-thesis", "bent"])
def test_the_stiffness_of_a_base_is_what_its_port_says(name):
    """A pose that swings, through the port itself, modes inside the base included."""
    system = System(vehicle=get_vehicle(name))
    dt, f, size = system.control_dt, 3.0, 1e-4 * np.array([1.0, -2, 1.5, 1, 0.5, -1])
    t = dt * np.arange(2000)
    run = dataclasses.replace(run_of_noisy(system, noisy=False))
    still = {k: np.tile(run[k][:1], (len(t), 1)) * (k == "q") for k in ("q", "w")}
    swings = run.with_signals({**still, "y": np.cos(2 * np.pi * f * t)[:, None] * size})
    swings = dataclasses.replace(
        swings, signals={k: swings[k] for k in ("q", "w", "y")}, dt=dt, memory={}
    )
    machine = SystemMachine(system)
    force = machine.residuals(swings, [machine.nominal], ["base"])["base"][0]
    w = np.array([2 * np.pi * f])
    G = dynamic_stiffness(system.actual.base, rate_matrix(np.zeros(6)), w)[0]
    expected = -(np.exp(1j * w * t[:, None]) * (G @ size)).real
    middle = slice(1200, 1800)
    scale = np.abs(expected).max()
    np.testing.assert_allclose(force[middle], expected[middle], atol=0.01 * scale)


def test_a_base_of_other_stiffness_with_its_modes_inside():
    """One of its modes 3 % off: the others over (Y, u) stay as they are; SciPy's modes."""
    base = System(vehicle=get_vehicle("bent")).base
    M, D, K = base.full()
    squares, ways = scipy.linalg.eigh(K, M)
    for i in (0, 5, len(K) - 1):
        momentum = M @ ways[:, i]
        stiffer = K + 0.0609 * squares[i] * np.outer(momentum, momentum)
        other = base.with_full(D, stiffer)
        moved = np.ones(len(K))
        moved[i] = 1.0609
        m, d, k = other.full()
        np.testing.assert_allclose(
            np.sort(squares * moved), scipy.linalg.eigvalsh(k, m), rtol=1e-6
        )
        assert np.trace(np.linalg.solve(m, d)) == pytest.approx(np.trace(np.linalg.solve(M, D)))
        assert other.internal.damping.shape == base.internal.damping.shape


def loaded_modes(base):
    """Frequencies of a base under the locked arm, by SciPy."""
    M, _, K = base.condensed()
    squares = scipy.linalg.eigvalsh(K, M + inertia(BENT.arm, np.zeros(3))[:6, :6])
    return np.sqrt(squares) / (2 * np.pi)


def test_a_mode_that_is_off_leaves_the_others_alone():
    """3 % in the frequency of each mode in turn; SciPy's modes."""
    base = BENT.actual.base
    frequencies = loaded_modes(base)
    candidates = list(E.BaseMode.candidates(Scope(3, BENT)))
    slots = [f"{f:.3g} Hz, mode {i + 1}" for i, f in enumerate(frequencies)]
    assert [c.slot for c in candidates] == slots
    for i, c in enumerate(candidates):
        stiffer = loaded_modes(c.effect(np.array([0.03])).base(base))
        expected = frequencies * (1 + 0.03 * np.eye(6)[i])
        np.testing.assert_allclose(stiffer, expected, rtol=1e-9)
    assert not list(E.BaseMode.candidates(Scope(3, System(vehicle=FREE_FLOATING))))


def gained(candidate_kind, *effects, machine_type=SystemMachine):
    """Gain of a kind at its ports, evidence for it, its number, its deviation."""
    machine, runs = machine_type(BENT), [run_of_noisy(BENT, *effects)]
    every = library(3, [p.name for p in machine.ports], "ideal", ["run"], system=BENT)
    candidate = next(c for c in every if candidate_kind in (c.kind, c.name))
    machine.ports = tuple(p for p in machine.ports if p.name in candidate.ports)
    residuals = WhitenedResiduals(machine, runs)
    null = fit(residuals, (), ())
    score = Signatures(residuals, [candidate]).scores(null.residual, null.tangents, null.size)
    found = fit(residuals, [candidate], [score[0].values])
    evidence = cost(null, len(every)) - cost(found, len(every))
    return null.deviance - found.deviance, evidence, found.values[0][0], found.std[0][0]


@pytest.mark.parametrize(
    ("effect", "number", "deviation"),
    [
        (E.PayloadMass(mass=0.05), 0.05, 0.01),
        pytest.param(E.BaseVirtualMass(error=0.02), 0.02, 0.0025, marks=pytest.mark.slow),
        pytest.param(E.BaseStiffness(error=0.015), 0.015, 0.002, marks=pytest.mark.slow),
    ],
    ids=lambda x: getattr(x, "kind", ""),
)
def test_what_is_seen_through_a_noisy_pose(effect, number, deviation):
    """Without the estimate the base's numbers are told half as well, and a payload less."""
    before = gained(effect.kind, effect, machine_type=Plain)
    gain, evidence, value, std = gained(effect.kind, effect)
    assert gain > before[0] and std < before[3]
    assert evidence > 0 and value == pytest.approx(number, abs=3 * deviation)
    assert std < deviation
    _, evidence, _, _ = gained(effect.kind)
    assert evidence < 0


@pytest.mark.slow
@pytest.mark.parametrize("i", [0, 3, 5])
def test_one_mode_of_a_base_is_named_by_its_frequency(i):
    """3 % off, all others as described."""
    candidate = list(E.BaseMode.candidates(Scope(3, BENT)))[i]
    _, evidence, value, std = gained(candidate.name, candidate.effect(np.array([0.03])))
    assert evidence > 0 and value == pytest.approx(0.03, abs=3 * std)
    _, evidence, _, _ = gained(candidate.name)
    assert evidence < 0
