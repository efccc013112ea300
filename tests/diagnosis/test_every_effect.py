"""Every registered effect, injected at ten times the noise: seen at its port, and named.

A gap is the root mean square by which an effect
changes a channel, over that channel's noise, of the channel that it changes most.
"""

import dataclasses
import functools
import re
from dataclasses import dataclass
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

import ves_gym as vg
from tests.diagnosis.thesis_laboratory import COLOUR, STD, SYSTEM, coloured
from ves_gym.diagnosis import diagnose as d
from ves_gym.diagnosis.data.measured_run import run_of
from ves_gym.diagnosis.excitation import excitation_motions
from ves_gym.diagnosis.inference.candidates import library
from ves_gym.diagnosis.inference.fit import fit
from ves_gym.diagnosis.inference.model_selection import cost
from ves_gym.diagnosis.inference.signatures import Signatures
from ves_gym.diagnosis.inference.whitened_residuals import WhitenedResiduals
from ves_gym.diagnosis.machines.system import SystemMachine
from ves_gym.effects import (
    EFFECTS,
    ArmEffect,
    BaseEffect,
    LaboratoryEffect,
    SensorDrift,
    SensorNoise,
    TorqueEffect,
)
from ves_gym.hardware.platform import PoseServo
from ves_gym.mechanics.vehicle import BENT_THESIS, FREE_FLOATING
from ves_gym.simulation.playback import play_motions

pytestmark = pytest.mark.filterwarnings(
    "ignore::ves_gym.simulation.loop_linearisation.EmulationWarning"
)
ROOT = Path(__file__).parents[2]
NOISE = {**STD, "wg": STD["w"], "y_cmd": STD["y"]}
HISS = SensorNoise(force=tuple(STD["w"][:3].tolist()), moment=tuple(STD["w"][3:].tolist()))
MOTIONS = excitation_motions(1, duration=6.0, seed=1)
SIZES: dict[str, tuple] = {  # kind -> place, numbers of its candidate
    "base/amplitude_damping": ("z", 2.2e4),
    "base/damping": ("", 0.65),
    "base/extra_mode": ("z", 22.0, 3.0),
    "base/stiffness": ("", 0.044),
    "base/virtual_mass": ("", 0.056),
    "command/delay": ("", 0.003),
    "gravity/delay": ("", 0.113),
    "gravity/mass": ("", 0.183),
    "gravity/moment": ("", 0.31, *[0.0] * 8),
    "gravity/scale": ("", 0.002),
    "gravity/tilt": ("", 0.0, 6.6e-4, 0.0),
    "gravity/tool": ("", 0.18, 0.0, 0.0, 0.0),
    "joint/asymmetry": ("joint 2", 3.9, 1.95),
    "joint/backlash": ("joint 3", 0.0045),
    "joint/coulomb": ("joint 2", 4.3),
    "joint/drive_gain": ("joint 2", 0.0665),
    "joint/elasticity": ("joint 2", 1.25e-4, 30.0),
    "joint/load_friction": ("joint 2", 0.082),
    "joint/measurement_delay": ("", 0.0055),
    "joint/ripple": ("joint 2", 3.0, 3.0, 22.0),
    "joint/rotor_inertia": ("joint 2", 1.85),
    "joint/stribeck": ("joint 1", 2.9, 1.0, 0.1),
    "joint/torque_limit": ("joint 2", 0.545),
    "joint/torque_offset": ("joint 2", 3.9),
    "joint/velocity_lag": ("joint 2", 0.019),
    "joint/viscous": ("joint 2", 12.7),
    "payload/body": ("", 0.21, *[0.0] * 9),
    "payload/com": ("", 0.03, 0.0, 0.0),
    "payload/inertia": ("", 1.2),
    "payload/mass": ("", 0.21),
    "platform/bandwidth": ("", -0.23),
    "platform/damping": ("", 2.6),
    "platform/delay": ("", 0.0178),
    "platform/stroke": ("", 0.9741),
    "sensor/bias": ("", 0.0, 0.44, 0.0, 0.0, 0.0, 0.0),
    "sensor/calibration": ("F_y", 0.0, 0.0, 0.0, 0.0, 0.0073, 0.0),
    "sensor/drift": ("M_y", 3.0),
    "sensor/lag": ("", -0.67),
    "sensor/rotation": ("", 5e-4, 0.0, 0.0),
}
UNFED = SYSTEM.replace(  # what a platform does wrong shows where it is told no rates
    emulator=dataclasses.replace(
        SYSTEM.emulator,
        platform=PoseServo(bandwidth=20.0, damping_ratio=0.7, rate_feedforward=False),
    )
)
LIGHT = SYSTEM.replace(  # beside the arm, so that its inertia counts
    vehicle=FREE_FLOATING,
    emulator=dataclasses.replace(SYSTEM.emulator, payload_compensation=True),
)
MACHINES = {
    "payload/inertia": LIGHT,
    **dict.fromkeys(("platform/bandwidth", "platform/damping", "platform/delay"), UNFED),
}
ROUGH = {  # relative error, where it is more than 0.15
    "joint/backlash": 0.3,
    "joint/elasticity": 0.3,
    "joint/stribeck": 0.5,
    "sensor/calibration": 0.3,
}

ONE_OF_EACH = (  # way of acting: on a model, as a law, with a state, on a signal; at each port
    "base/stiffness", "command/delay", "gravity/tilt", "joint/asymmetry", "joint/elasticity",
    "joint/measurement_delay", "joint/torque_limit", "payload/mass", "platform/delay",
    "sensor/drift", "sensor/rotation",
)  # fmt: skip

ALIKE = {"payload/body": "payload/mass"}  # a body of no more than a mass is one
LEFT = {  # deviance that is more than 20
    ("joint/backlash", "joint"): 1200.0,  # of 1,550: teeth meet between two samples
}


def registered():
    """Effects of the library; those of this file left out."""
    return {k: cls for k, cls in EFFECTS.items() if cls.__module__.startswith("ves_gym.")}


def played(system, *effects):
    """Log of a lively motion, its wrench with noise; the system it names has no effects."""
    whole = system.replace(effects=(*effects, HISS))
    log = play_motions(whole, MOTIONS, settle=1.0).log(0)
    return dataclasses.replace(log, meta={**log.meta, "system": system.to_dict()})


def noisy(log, seed=5, times=1.0):
    """The log as a diagnosis gets it: noise of the wrench went through the loop already."""
    rng = np.random.default_rng(seed)
    stds = {k: s if k == "w" else times * s for k, s in STD.items()}
    parts = {
        k: getattr(log, k) + coloured(s, COLOUR[k], len(log), rng)
        for k, s in stds.items()
        if k != "w"
    }
    meta = {**log.meta, "noise_std": {k: s.tolist() for k, s in stds.items()}}
    return dataclasses.replace(log, meta=meta, **parts)


def gap(log, healthy):
    """Root mean square change over noise of the channel that changes most."""
    change = {k: getattr(log, k) - getattr(healthy, k) for k in NOISE}
    return max(
        float((np.sqrt((x**2).mean(axis=0)) / NOISE[k]).max()) for k, x in change.items()
    )


def library_of(machine, runs):
    """All candidates of a machine."""
    system = machine.system
    ports = [p.name for p in machine.ports]
    names = [run.name for run in runs]
    stretch = machine.stretch(runs)
    return library(system.arm.n, ports, system.mode, names, stretch, system)


def residuals_of(system, log, ports):
    """Residuals at some ports of a log with noise, and the fit of nothing to them."""
    machine = SystemMachine(system)
    machine.ports = tuple(p for p in machine.ports if p.name in ports)
    residuals = WhitenedResiduals(machine, [run_of(log, "run")])
    return residuals, fit(residuals, (), ())


def seen(residuals, null, candidate, count):
    """Evidence for a candidate at its ports, and its numbers.

    Args:
        residuals: at the candidate's ports.
        null: fit of nothing to them.
        candidate: to fit.
        count: candidates in the library.
    """
    signatures = Signatures(residuals, [candidate])
    score = signatures.scores(null.residual, null.tangents, null.size)[0]
    found = fit(residuals, [candidate], [score.values])
    return cost(null, count) - cost(found, count), found.values[0]


@functools.cache
def healthy(system):
    """The log of a system with nothing hidden, and its library."""
    log = played(system)
    return log, library_of(SystemMachine(system), [run_of(log, "run")])


@functools.cache
def quiet(system, ports):
    """Residuals of its log with nothing hidden, and the fit of nothing."""
    return residuals_of(system, noisy(healthy(system)[0]), ports)


@functools.cache
def whole(system):
    """Residuals at all ports of its log with nothing hidden."""
    run = run_of(noisy(healthy(system)[0]), "run")
    return WhitenedResiduals(SystemMachine(system), [run])


@pytest.fixture(scope="module", autouse=True)
def forget():
    yield
    for memory in (healthy, quiet, whole):
        memory.cache_clear()


def injected(every, kind):
    """(candidate, its numbers, the effect) of a kind."""
    slot, *numbers = SIZES[kind]
    candidate = next(c for c in every if (c.kind, c.slot) == (kind, slot))
    if kind == "sensor/drift":  # its numbers are the course that it happens to take
        return candidate, None, SensorDrift(moment=(0.0, numbers[0], 0.0), time=2.0)
    return candidate, np.array(numbers), candidate.effect(np.array(numbers))


def test_every_effect_that_can_be_named_is_tried_here():
    """Those of space alone are named in machines/test_vehicle_force.py."""
    effects = registered().items()
    nameable = {k for k, cls in effects if not cls.hidden and SYSTEM.mode in cls.modes}
    assert set(SIZES) == nameable


def each(kinds, but=()):
    """Parameters of a test, of which one of each way of acting is not slow, `but` for some."""
    quick = set(ONE_OF_EACH).difference(but)
    return [k if k in quick else pytest.param(k, marks=pytest.mark.slow) for k in kinds]


@pytest.mark.parametrize("kind", each(SIZES))
def test_an_effect_of_ten_times_the_noise_is_seen_at_its_port(kind):
    """Its candidate gains what a name needs, finds the numbers, and is quiet without it."""
    system = MACHINES.get(kind, SYSTEM)
    null, every = healthy(system)
    candidate, numbers, effect = injected(every, kind)
    log = played(system, effect)
    assert 8.0 < gap(log, null) < 14.0
    residuals = residuals_of(system, noisy(log), candidate.ports)
    evidence, found = seen(*residuals, candidate, len(every))
    assert evidence > 0
    if numbers is not None:
        clear = numbers != 0
        np.testing.assert_allclose(found[clear], numbers[clear], rtol=ROUGH.get(kind, 0.15))
    evidence, _ = seen(*quiet(system, tuple(candidate.ports)), candidate, len(every))
    assert evidence < 0


SILENT = {  # of which test_ports.py and test_admittance.py say the same, if not at every port
    "base/amplitude_damping", "base/damping", "base/extra_mode", "base/stiffness",
    "base/virtual_mass", "gravity/mass", "joint/coulomb", "joint/elasticity",
    "joint/velocity_lag", "payload/com", "payload/inertia", "payload/mass",
    "platform/bandwidth", "sensor/bias",
}  # fmt: skip


@pytest.mark.parametrize("kind", each((k for k in SIZES if k != "sensor/drift"), SILENT))
def test_an_effect_that_is_described_leaves_nothing(kind):
    """At every port, without noise: what is left could be taken for a second effect."""
    system = MACHINES.get(kind, SYSTEM)
    _, _, effect = injected(healthy(system)[1], kind)
    log = play_motions(system.replace(effects=(effect,)), MOTIONS, settle=1.0).log(0)
    residuals, machine = whole(system), SystemMachine(system)
    for port in (p.name for p in residuals.ports):
        values = machine.residuals(run_of(log, "run"), [machine.model([effect])], [port])[port]
        left = float((residuals.whitened(port, [values]) ** 2).sum())
        assert left < LEFT.get((kind, port), 20.0), port


@pytest.mark.parametrize(
    ("times", "told"), [(1.0, True), pytest.param(8.0, False, marks=pytest.mark.slow)]
)
def test_a_spring_that_swings_in_the_band_is_not_charged_for_the_noise(times, told):
    """8 Hz, hardly damped: it multiplies the noise of angles, and more damping leaves less.

    Under little noise the damping is told; under much it comes out larger, with its deviation,
    and the spring gains about twice of what it does with the damping that fits best.
    """
    candidate = next(c for c in healthy(SYSTEM)[1] if c.name == "joint/elasticity at joint 3")
    log = played(SYSTEM, candidate.effect(np.array([4e-4, 14.0])))
    residuals, null = residuals_of(SYSTEM, noisy(log, times=times), candidate.ports)
    plain, found = (
        fit(residuals, [c], [np.array([3e-4, 30.0])])
        for c in (dataclasses.replace(candidate, quiets=()), candidate)
    )
    compliance, damping = found.values[0]
    assert compliance == pytest.approx(4e-4, rel=0.3)
    if told:
        assert found.deviance == plain.deviance
        assert damping == pytest.approx(14.0, rel=0.1)
    else:
        assert null.deviance - found.deviance > 1.5 * (null.deviance - plain.deviance)
        assert damping > 14.0
        assert found.std[0][1] > 2 * plain.std[0][1]


@pytest.mark.slow
@pytest.mark.parametrize("kind", SIZES)
def test_an_effect_of_ten_times_the_noise_is_named(kind):
    """Against the whole library, from one run."""
    system = MACHINES.get(kind, SYSTEM)
    candidate, _, effect = injected(healthy(system)[1], kind)
    log = noisy(played(system, effect))
    machine, runs = SystemMachine(system), [run_of(log, "run")]
    found = d.diagnose(machine, runs, candidates=library_of(machine, runs))
    (explanation,) = found.explanations
    kind = ALIKE.get(kind, kind)
    assert (kind, candidate.slot) in {
        (r.candidate.kind, r.candidate.slot) for r in explanation.rivals
    }, found.sentence
    assert found.verdict in d.NAMING_VERDICTS


# ------------------------------------------------------------- effects of one's own


@pytest.fixture(scope="module")
def own():
    """Effects as a user writes them: nothing but what they do."""

    @vg.register_effect("own/fluid")
    @dataclass(frozen=True, kw_only=True)
    class Fluid(TorqueEffect):
        """Drag in proportion to the square of the rate."""

        modes = ("ideal", "emulated")
        port = "joint"
        drag: tuple[float, ...] = vg.parameter(
            "N m s^2/rad^2", bounds=(0.0, 200.0), shape=(None,)
        )

        def law(self, q, v, tau):
            return -self.drag * np.abs(v) * v

    @vg.register_effect("own/forgotten_tool")
    @dataclass(frozen=True, kw_only=True)
    class ForgottenTool(LaboratoryEffect):
        """The weight estimate lacks a tool, and its moment with an arm of 0.4 m."""

        port = "gravity"
        mass: float = vg.parameter("kg", bounds=(0.0, 10.0))

        def edit(self, p):
            p.gravity_mass = p.gravity_mass - self.mass
            p.gravity_P = p.gravity_P - 0.4 * self.mass

    @vg.register_effect("own/guy_wire")
    @dataclass(frozen=True, kw_only=True)
    class GuyWire(BaseEffect):
        """A wire that holds the vehicle along z."""

        modes = ("ideal", "emulated")
        port = "admittance"
        stiffness: float = vg.parameter("N/m", bounds=(0.0, 1e6))

        def base(self, base):
            wire = np.zeros((6, 6))
            wire[2, 2] = self.stiffness
            return dataclasses.replace(base, K=base.K + wire) if self.stiffness else base

    @vg.register_effect("own/heavy_link")
    @dataclass(frozen=True, kw_only=True)
    class HeavyLink(ArmEffect):
        """The second link has more mass than described."""

        modes = ("ideal", "emulated")
        port = "joint"
        added: float = vg.parameter("kg", bounds=(0.0, 10.0))

        def arm(self, arm):
            if self.is_null:
                return arm
            link = arm.links[1]
            inertial = dataclasses.replace(link.inertial, mass=link.inertial.mass + self.added)
            heavier = dataclasses.replace(link, inertial=inertial)
            return dataclasses.replace(arm, links=(arm.links[0], heavier, *arm.links[2:]))

    kinds = (Fluid, ForgottenTool, GuyWire, HeavyLink)
    yield {cls.kind: cls for cls in kinds}
    for cls in kinds:
        del EFFECTS[cls.kind]


OWN = {  # kind -> name of its number, value at ten times the noise, place
    "own/fluid": ("drag", 19.0, "joint 2"),
    "own/forgotten_tool": ("mass", 0.23, ""),
    "own/guy_wire": ("stiffness", 1900.0, ""),
    "own/heavy_link": ("added", 0.185, ""),
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", OWN)
def test_an_effect_of_one_s_own_is_named_with_no_other_edit(own, kind):
    name, value, place = OWN[kind]
    effect = own[kind](**{name: (0.0, value, 0.0) if place else value})
    log = played(SYSTEM, effect)
    assert 8.0 < gap(log, healthy(SYSTEM)[0]) < 14.0
    found = vg.diagnose(noisy(log), as_logged=True)
    assert [(f.candidate.kind, f.candidate.slot) for f in found.explanations] == [(kind, place)]
    assert found.explanations[0].values == pytest.approx([value], rel=0.1)
    assert vg.System.from_dict(found.system.to_dict()) == found.system  # written, read again
    assert found.system.effects[-1].kind == kind


def test_an_effect_of_one_s_own_is_compiled_and_randomised(own):
    """The kernel against MuJoCo, which holds a law's torque over a step; and random numbers."""
    bodies = (own["own/guy_wire"](stiffness=1900.0), own["own/heavy_link"](added=0.5))
    laws = (own["own/fluid"](drag=(5.0, 19.0, 3.0)),)
    push = np.array([[20.0, -30, 10], [5.0, 10, -5]])
    for effects, tolerance in ((bodies, 1e-9), (laws, 1e-3)):
        states = []
        for backend in ("mujoco", "kernel"):
            sim = vg.Simulator(
                vg.System(vehicle=BENT_THESIS, effects=effects), 2, backend=backend
            )
            for k in range(40):
                state = sim.step(push * np.cos(0.3 * k))
            states.append(np.concatenate([state.q, state.v, state.y, state.yd], axis=1))
        np.testing.assert_allclose(*states, rtol=0, atol=tolerance)
    ranges = {
        "own/fluid": {"drag": [[0.0] * 3, [20.0] * 3]},
        "own/forgotten_tool": {"mass": [0.0, 0.5]},
    }
    env = gym.make_vec("ves/PumaReachEmulated-v0", num_envs=3, randomize=ranges)
    env.reset(seed=0)
    drawn = [{e.kind: e for e in system.effects} for system in env.unwrapped.batch.sim.systems]
    assert len({row["own/forgotten_tool"].mass for row in drawn}) == 3
    assert len({row["own/fluid"].drag for row in drawn}) == 3
    env.step(env.action_space.sample())
    env.close()


@pytest.mark.slow
def test_effects_of_one_s_own_are_quiet_where_nothing_is_missing(own):
    found = vg.diagnose(noisy(healthy(SYSTEM)[0]), as_logged=True)
    assert found.verdict == d.NOTHING
    assert set(own) <= {c.kind for c in found.signatures.candidates}


# ------------------------------------------------------------------------ what is said


def test_the_page_counts_what_can_be_named():
    page = (ROOT / "docs" / "diagnosis.md").read_text("utf-8")
    named, of = map(int, re.search(r"(\d+) of (\d+) effects can be named", page).groups())
    hidden = {kind: cls.hidden for kind, cls in registered().items() if cls.hidden}
    assert of == len(registered())
    assert named == of - len(hidden)
    items = page.replace("\n  ", " ").splitlines()
    for kind, reason in hidden.items():
        assert any(f"`{kind}`" in item and item.endswith(f": {reason}") for item in items), kind
