"""The force sensor's accuracy at ports that differentiate a measured pose twice (mode ideal).

`pytest -s` prints the levels, with the estimate of the pose's noise and without. References:
the noise that was added, and the numbers hidden.
"""

import dataclasses

import numpy as np
import pytest

import ves_gym.effects as E
from ves_gym.diagnosis.data.measured_run import run_of
from ves_gym.diagnosis.excitation import excitation_motions
from ves_gym.diagnosis.inference.candidates import library
from ves_gym.diagnosis.inference.fit import fit
from ves_gym.diagnosis.inference.model_selection import Thresholds, _required_gain
from ves_gym.diagnosis.inference.null_law import NullLaw
from ves_gym.diagnosis.inference.signatures import Signatures
from ves_gym.diagnosis.inference.whitened_residuals import WhitenedResiduals
from ves_gym.diagnosis.machines.pose_noise import dynamic_stiffness
from ves_gym.diagnosis.machines.system import SystemMachine
from ves_gym.mechanics.spatial import rate_matrix
from ves_gym.mechanics.vehicle import BENT_THESIS, FREE_FLOATING, get_vehicle
from ves_gym.simulation.playback import play_motions
from ves_gym.system.system import System

NOISE = {
    "y": np.array([2e-4] * 3 + [1e-4] * 3),
    "w": np.array([0.5] * 3 + [0.25] * 3),
    "q": np.full(3, 2e-5),
    "tau": np.full(3, 0.1),
}
BENT = System(vehicle=BENT_THESIS)


def logged(system, *effects, noisy=True):
    """A run of 10 s with something hidden, which its description does not say."""
    motions = excitation_motions(1, system.arm, duration=10.0, seed=3)
    hidden = system.replace(effects=effects)
    recording = play_motions(hidden, motions, settle=1.0, record_dt=system.control_dt, seed=3)
    log, rng = recording.log(0), np.random.default_rng(5)
    parts = {
        k: getattr(log, k) + noisy * rng.standard_normal(getattr(log, k).shape) * s
        for k, s in NOISE.items()
    }
    stated = {"noise_std": {k: (noisy * s).tolist() for k, s in NOISE.items()}}
    return run_of(dataclasses.replace(log, meta={**log.meta, **stated}, **parts), "run")


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
    run = logged(system)
    found, plain = levels(system, run), levels(system, run, machine_type=Plain)
    for what, level in {"before": plain, "after": found}.items():
        print(vehicle.kind, what, {k: np.round(x, 2).tolist() for k, x in level.items()})
    assert (found["wrench"] < 6 * NOISE["w"]).all()
    assert plain["wrench"][:3].max() > 40 and plain["wrench"][3:].max() > 20
    assert plain["joint"].max() > 3.0
    assert (found["joint"] < 5 * NOISE["tau"]).all()
    assert levels(system, run, w=False)["joint"].max() > 3.0


def test_an_exact_pose_is_left_alone():
    run = logged(BENT, noisy=False)
    found = levels(BENT, run)
    assert max(x.max() for x in found.values()) < 5e-3


@pytest.mark.parametrize("name", ["bent-thesis", "bent"])
def test_the_stiffness_of_a_base_is_what_its_port_says(name):
    """A pose that swings, through the port itself, modes inside the base included."""
    system = System(vehicle=get_vehicle(name))
    dt, f, size = system.control_dt, 3.0, 1e-4 * np.array([1.0, -2, 1.5, 1, 0.5, -1])
    t = dt * np.arange(2000)
    run = dataclasses.replace(logged(system, noisy=False))
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


def gained(candidate_kind, *effects, machine_type=SystemMachine):
    """Gain of a kind at its ports, what it needs to be named, its number, its deviation."""
    machine, runs = machine_type(BENT), [logged(BENT, *effects)]
    every = library(3, [p.name for p in machine.ports], "ideal", ["run"], system=BENT)
    candidate = next(c for c in every if c.kind == candidate_kind)
    machine.ports = tuple(p for p in machine.ports if p.name in candidate.ports)
    residuals = WhitenedResiduals(machine, runs)
    null = fit(residuals, (), ())
    score = Signatures(residuals, [candidate]).scores(null.residual, null.tangents, null.size)
    found = fit(residuals, [candidate], [score[0].values])
    needed = _required_gain(residuals, NullLaw(len(every)), Thresholds(), found, 0)
    return null.deviance - found.deviance, needed, found.values[0][0], found.std[0][0]


@pytest.mark.parametrize(
    ("effect", "number", "deviation"),
    [
        (E.PayloadMass(mass=0.05), 0.05, 0.01),
        (E.BaseVirtualMass(error=0.02), 0.02, 0.0025),
        (E.BaseStiffness(error=0.015), 0.015, 0.002),
    ],
    ids=lambda x: getattr(x, "kind", ""),
)
def test_what_is_seen_through_a_noisy_pose(effect, number, deviation):
    """Without the estimate the base's numbers are told half as well, and a payload less."""
    before = gained(effect.kind, effect, machine_type=Plain)
    gain, needed, value, std = gained(effect.kind, effect)
    for what, found in {"before": before, "after": (gain, needed, value, std)}.items():
        least = number * np.sqrt(found[1] / found[0])  # a gain grows by the number squared
        print(
            f"{effect.kind} {what}: gain {found[0]:.1f} of {found[1]:.1f}, {found[2]:.4f} +-"
            f" {found[3]:.4f}; named from about {least:.4f} on"
        )
    assert gain > before[0] and std < before[3]
    assert gain > needed and value == pytest.approx(number, abs=3 * deviation)
    assert std < deviation
    gain, needed, _, _ = gained(effect.kind)
    assert gain < needed
