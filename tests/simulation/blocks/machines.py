"""Emulated systems: every operation, platform and kind of vehicle, and every effect."""

from dataclasses import replace
from functools import cache

import numpy as np

from tests.effects import values
from ves_gym._util.params import ParameterError
from ves_gym.effects import EFFECTS
from ves_gym.hardware.force_sensor import ForceSensor
from ves_gym.hardware.leg_servo import FILTERED, FILTERED_FEEDBACK, LOW_GAINS, leg_clock
from ves_gym.hardware.platform import PoseServo
from ves_gym.mechanics.vehicle import BENT_THESIS, DECOUPLED, FREE_FLOATING
from ves_gym.simulation import simulator
from ves_gym.simulation.emulation_loop import EmulationLoop
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.emulator_settings import EmulatorSettings
from ves_gym.system.system import System

DURATION = 1.0  # s
KINDS = sorted(kind for kind, effect in EFFECTS.items() if "emulated" in effect.modes)
COARSE = ForceSensor(cutoff=30.0, force_resolution=0.1, moment_resolution=0.05)
LABORATORIES = (  # vehicle, settings
    (BENT_THESIS, {}),
    (FREE_FLOATING, {"payload_compensation": False, "platform": PoseServo(bandwidth=4.0)}),
    (DECOUPLED, {"operation": "admittance", "zero_at_start": False, "delay": 2}),
    (BENT_THESIS, {"operation": "position", "platform": PoseServo(rate_feedforward=False)}),
    (DECOUPLED, {"payload_compensation": False, "platform": FILTERED, "sensor": COARSE}),
    (FREE_FLOATING, {"platform": FILTERED_FEEDBACK, "delay": 0}),
    (BENT_THESIS, {"payload_compensation": False, "platform": LOW_GAINS}),
    (DECOUPLED, {"zero_at_start": True, "sensor": replace(COARSE, force_resolution=0.0)}),
)
COUNT = len(LABORATORIES)


def plain(index: int) -> System:
    """System `index` without effects."""
    vehicle, settings = LABORATORIES[index]
    emulator, clock = EmulatorSettings(**settings), {}
    if not isinstance(emulator.platform, PoseServo):
        control, physics = leg_clock(emulator.platform)
        clock = {"control_dt": control, "physics_dt": physics}
    drive = "prescribed" if index in (3, 6) else "motor"
    return System(mode="emulated", vehicle=vehicle, emulator=emulator, drive=drive, **clock)


@cache
def systems() -> tuple[System, ...]:
    """All of them; every effect is in the next one, by turns, that it acts in."""
    out = [plain(k) for k in range(COUNT)]
    for turn, kind in enumerate(KINDS):
        for index in range(turn, turn + COUNT):
            at = index % COUNT
            if out[at].emulator.operation == "position":
                continue  # every effect in a loop that is closed
            try:
                out[at] = out[at].replace(effects=(*out[at].effects, values.effect(kind)))
                break
            except ParameterError:  # it would do nothing there
                continue
    return tuple(out)


def system(index: int) -> System:
    """System `index`."""
    return systems()[index]


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
