"""64 random emulated systems: every operation, platform and vehicle kind, every effect."""

import dataclasses
import itertools

import numpy as np

from tests.effects import values
from ves_gym._util.params import ParameterError
from ves_gym.effects import EFFECTS
from ves_gym.hardware.force_sensor import ForceSensor
from ves_gym.hardware.leg_servo import LEG_SERVOS, LegServo, leg_clock
from ves_gym.hardware.platform import PoseServo
from ves_gym.mechanics.arm import Arm, matrix
from ves_gym.mechanics.arm_library import PUMA_560
from ves_gym.mechanics.vehicle import (
    BENT_THESIS,
    FREE_FLOATING,
    MatrixVehicle,
    Vehicle,
)
from ves_gym.simulation import simulator
from ves_gym.simulation.emulation_loop import EmulationLoop
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.emulator_settings import OPERATIONS, EmulatorSettings
from ves_gym.system.system import System

COUNT, DURATION, SEED = 64, 2.0, 10  # systems; s
KINDS = sorted(kind for kind, effect in EFFECTS.items() if "emulated" in effect.modes)
PLATFORMS = ("pose", "pose, no rate", "legs")
VEHICLES = ("matrices", "beam", "satellite")
# mostly with an estimate of the weight: without one a run soon ends in a safety stop
PLANS = list(
    itertools.product(("microgravity", *OPERATIONS), PLATFORMS, VEHICLES, (True, False))
)


def arm(rng: np.random.Generator) -> Arm:
    """The PUMA with other masses, centres and inertias."""
    links = []
    for link in PUMA_560.links:
        body, share = link.inertial, rng.uniform(0.8, 1.2)
        com = tuple((np.array(body.com) * rng.uniform(0.9, 1.1, 3)).tolist())
        inertial = dataclasses.replace(
            body,
            mass=share * body.mass,
            com=com,
            inertia=matrix(share * np.array(body.inertia)),
        )
        rotor = float(link.rotor_inertia * rng.uniform(0.8, 1.2))
        links.append(dataclasses.replace(link, inertial=inertial, rotor_inertia=rotor))
    return dataclasses.replace(PUMA_560, links=tuple(links), source="test: random")


def vehicle(rng: np.random.Generator, kind: str) -> Vehicle:
    if kind == "satellite":
        body = FREE_FLOATING.body
        share = rng.uniform(0.8, 1.5)
        body = dataclasses.replace(
            body, mass=share * body.mass, inertia=matrix(share * np.array(body.inertia))
        )
        return dataclasses.replace(FREE_FLOATING, body=body, source="test: random")
    if kind == "beam":
        # the thesis's other beams, lighter than the arm about their axes, lose stability when
        # the description errs as much as some effects do, and then amplify rounding
        damping = float(rng.uniform(0.02, 0.1))
        return dataclasses.replace(BENT_THESIS, damping_ratio=damping, source="test: random")

    def spd(scale):
        root = rng.normal(size=(6, 6))
        return matrix(scale * (root @ root.T / 6 + 0.5 * np.eye(6)))

    return MatrixVehicle(M=spd(1500.0), D=spd(1000.0), K=spd(15000.0), source="test: random")


def settings(rng: np.random.Generator, operation, platform, compensation) -> EmulatorSettings:
    servo = LEG_SERVOS[str(rng.choice(list(LEG_SERVOS)))]
    if platform != "legs":
        servo = PoseServo(
            bandwidth=float(rng.uniform(4, 10)), rate_feedforward=platform == "pose"
        )
    # a compensated loop whose sensor is coarse does not feed back what is smaller than its
    # resolution, so that rounding grows up to it, by up to a fifth per control period
    coarse = float(not compensation)
    sensor = ForceSensor(
        cutoff=float(rng.uniform(15, 40)),
        force_resolution=coarse * float(rng.choice([0.0, 0.1])),
        moment_resolution=coarse * float(rng.choice([0.0, 0.05])),
    )
    return EmulatorSettings(
        operation=operation,
        platform=servo,
        sensor=sensor,
        delay=int(rng.integers(0, 3)),
        zero_at_start=bool(rng.integers(2)) and operation == "microgravity",
        payload_compensation=compensation,
    )


def system(index: int) -> System:
    """System `index`: one effect, up to three more, in the first plan that fits."""
    rng = np.random.default_rng((SEED, index))
    for at in rng.permutation(len(PLANS)).tolist():
        operation, platform, what, compensation = PLANS[at]
        if index < len(KINDS) and operation == "position":
            continue  # every effect in a loop that is closed, too
        emulator, clock = settings(rng, operation, platform, compensation), {}
        if isinstance(emulator.platform, LegServo):
            names = ("control_dt", "physics_dt")
            clock = dict(zip(names, leg_clock(emulator.platform), strict=True))
        plain = System(
            mode="emulated",
            arm=arm(rng),
            vehicle=vehicle(rng, what),
            drive=str(rng.choice(["motor", "motor", "prescribed"])),
            emulator=emulator,
            **clock,
        )
        first = _with(plain, KINDS[index % len(KINDS)])
        if first is not None:
            break
    for kind in rng.choice(KINDS, rng.integers(4)).tolist():
        first = _with(first, kind) or first
    return first


def _with(plain: System, kind: str) -> System | None:
    """The system with an effect at its typical value; None where it would do nothing."""
    if kind in [e.kind for e in plain.effects]:
        return None
    try:
        return plain.replace(effects=(*plain.effects, values.effect(kind)))
    except ParameterError:
        return None


# ------------------------------------------------------------------------------ runs


def simulator_of(monkeypatch, system: System, n: int, *, compiled: bool, **options):
    """A simulator on the compiled engine, its blocks compiled or in NumPy."""
    with monkeypatch.context() as patch:
        if not compiled:

            def in_numpy(*args, compiled):
                return EmulationLoop(*args, compiled=False)

            patch.setattr(simulator, "EmulationLoop", in_numpy)
        return Simulator(system, n, backend="kernel", threads=1, warn_at=None, **options)


def run(sim, seed: int, duration: float, nudge: float = 0.0) -> list[list[np.ndarray]]:
    """State, coordinates inside and readings after every control period of a random motion.

    The rate at which a gear rings in its play is left out: the engine's own, and the same.
    `nudge` [m, rad, ...] is added to the start.
    """
    rng = np.random.default_rng(1000 + seed)
    n, joints, system = sim.n, sim.joints, sim.system
    sim.reset(
        q=rng.uniform(-0.5, 0.5, (n, joints)) + nudge,
        v=rng.uniform(-0.1, 0.1, (n, joints)),
        y=rng.uniform(-0.01, 0.01, (n, 6)) + nudge,
        yd=rng.uniform(-0.02, 0.02, (n, 6)) + nudge,
    )
    size, speed = rng.uniform(0.1, 0.4, (n, joints)), rng.uniform(2, 6, (n, joints))
    start, sway = sim.state.q - nudge, rng.uniform(-0.01, 0.01, (n, 6))
    rest, out = sim.state.y - nudge, []
    position = system.emulator_settings.operation == "position"
    for i in range(round(duration / system.control_dt)):
        t, more = i * system.control_dt, {}
        if position:
            pose, rate = rest + sway * (1 - np.cos(3 * t)), 3 * sway * np.sin(3 * t)
            more["platform"] = np.concatenate([pose, rate], axis=-1)
        turn, turning = size * np.sin(speed * t), size * speed * np.cos(speed * t)
        if system.drive == "prescribed":
            sim.step(-speed * speed * turn, **more)
        else:
            sim.step(sim.servo_command(start + turn, turning), **more)
        out.append([*sim.state[1:], sim.internal_state[0], *sim.readings])
    return out


SIZES = (1.0,) * 5 + (1e3, 1e3, 1.0, 1.0)  # state, internal; wrenches [N, N m], poses


def gap(ours, theirs) -> float:
    """Largest difference of two runs, of max(size, value)."""
    worst = 0.0
    for a, b in zip(ours, theirs, strict=True):
        for mine, other, size in zip(a, b, SIZES, strict=True):
            assert np.isfinite(other).all()
            if other.size:
                relative = np.abs(mine - other) / np.maximum(size, np.abs(other))
                worst = max(worst, float(relative.max()))
    return worst
