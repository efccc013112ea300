"""The emulation loop linearised by central differences of the simulator that runs it.

What is judged is what will run. The simulator is handed in, so that it can itself ask for
this judgement; `stability` has the questions that users ask.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import Array, ParameterError, content_hash, finite
from ves_gym.hardware.leg_servo import LegServo
from ves_gym.mechanics.servo import OWN_GAINS, JointServo
from ves_gym.system.system import System

SimulatorFactory = Callable[..., Any]  # `Simulator`, or what builds one like it
SLACK = 1e-4  # of |z| <= 1: a free base has a double eigenvalue 1, which differences of 1e-9
# relative accuracy move by its square root
_STEP = 1e-5  # of the central differences, m, rad, N, ... in turn
_RADII: dict[str, float] = {}  # spectral radii of systems judged before


class EmulationWarning(UserWarning):
    """An emulation that is unstable or leaves its assumptions."""


@dataclass(frozen=True)
class Linearised:
    """The whole loop about rest: x+ = A (x + E w), Y+ = C (x + E w).

    x stacks joint angles and rates and the memory of the laboratory; w (6,) is a wrench
    [N, N m] added to the sensor's reading, Y (6,) the platform's measured pose.
    """

    A: Array  # (s, s)
    E: Array  # (s, 6)
    C: Array  # (6, s)
    dt: float  # s, the control period

    @property
    def spectral_radius(self) -> float:
        """Largest eigenvalue magnitude of A."""
        return float(np.abs(np.linalg.eigvals(self.A)).max())

    def compliance(self, f: npt.ArrayLike) -> npt.NDArray[np.complex128]:
        """(m, 6, 6) pose per wrench at frequencies f [Hz]."""
        z = np.exp(2j * np.pi * np.asarray(f, float) * self.dt)
        eye = np.eye(len(self.A))
        inner = np.linalg.solve(z[:, None, None] * eye - self.A, self.A @ self.E)
        return np.asarray(self.C @ (inner + self.E) / z[:, None, None], np.complex128)

    def step(self, wrench: npt.ArrayLike, periods: int) -> Array:
        """Return the pose after a wrench that sets in at 0 and stays.

        Args:
            wrench: (6,) [N, N m].
            periods: control periods.

        Returns:
            (periods + 1, 6) [m, rad].
        """
        x, push = np.zeros(len(self.A)), self.E @ np.asarray(wrench, float)
        out = np.zeros((periods + 1, 6))
        for k in range(periods):
            out[k + 1] = self.C @ (x + push)
            x = self.A @ (x + push)
        return out


def linearise(
    simulator: SimulatorFactory,
    system: System,
    q: npt.ArrayLike = 0.0,
    *,
    servo: JointServo | None = OWN_GAINS,
) -> Linearised:
    """Linearise the whole loop about rest at joint angles q (ideal mode: `engine/linear.py`).

    Noise, drift and the quantisation of transducers and sensor are left out.

    Args:
        simulator: makes the simulator whose steps are differentiated.
        system: an emulated system, in operation microgravity or gravity.
        q: joint angles [rad], broadcast to (joints,).
        servo: joint servo, None for bare torques.

    Returns:
        The transition over one control period, see `Linearised`.

    Raises:
        ParameterError: the system is not emulated, or the platform is position controlled.
    """
    angles, lab = joint_angles(system, q), system.emulator_settings
    if lab.operation == "position":
        raise ParameterError("operation position has no loop that could be unstable")
    sensor = replace(lab.sensor, force_resolution=0.0, moment_resolution=0.0)
    platform = lab.platform
    if isinstance(platform, LegServo):
        platform = replace(platform, resolution=0.0)
    # far from every safety limit
    smooth = replace(lab, sensor=sensor, platform=platform, force_max=1e12, moment_max=1e12)
    quiet = system.replace(emulator=smooth)
    options: dict[str, Any] = {"servo": servo, "warn_at": None}
    if isinstance(platform, LegServo):
        options["compiled"] = False  # each of their gains is code of its own, for one period
    size = _Loop(simulator(quiet, 1, **options), angles).size
    loop = _Loop(simulator(quiet, 2 * size, **options), angles)
    after = loop.step(_STEP * np.vstack([np.eye(size), -np.eye(size)]))
    slope = (after[:size] - after[size:]).T / (2 * _STEP)
    return Linearised(
        slope[:size], np.eye(size)[:, loop.reading], slope[size:], system.control_dt
    )


class _Loop:
    """A simulator whose whole state is read and written as one vector per simulation."""

    def __init__(self, sim: Any, angles: Array) -> None:
        sim.emulation_loop.silence()
        sim.reset(q=angles)
        self.sim, self.loop, self.angles = sim, sim.emulation_loop, angles
        self.joints = sim.joints if sim.system.drive == "motor" else 0
        # only what the loop acts on: anything else would be an eigenvalue 1 of its own
        self.names = self.loop.wiring.dynamic()
        self._gears = bool(sim.system.actual.arm.geared)
        self._ages = sim.joint_delays is not None and sim.joint_delays.measurements_late
        self.rest = [np.array(part) for part in self._parts()]
        self.size = 2 * self.joints + sum(part[0].size for part in self.rest)
        sizes = [self.rest[k][0].size for k in range(self.names.index("reading") + 1)]
        end = 2 * self.joints + sum(sizes)
        self.reading = slice(end - 6, end)
        self.hold = sim.servo_command(
            np.broadcast_to(angles, (sim.n, sim.joints)), np.zeros((sim.n, sim.joints))
        )
        if sim.system.drive == "prescribed":
            self.hold = np.zeros_like(self.hold)

    def _parts(self) -> Iterator[Array]:
        """Arrays that carry over to the next period."""
        for name in self.names:
            yield self.loop.memory[name]
        if self._ages:
            yield self.sim.joint_delays.measurement_history
        if self._gears:
            yield np.stack(self.sim.backend.internal_state(), axis=1)

    def _vector(self) -> Array:
        state = self.sim.state
        moving = [state.q, state.v] if self.joints else []
        parts = [*moving, *self._parts()]
        return np.concatenate([p.reshape(self.sim.n, -1) for p in parts], axis=1)

    def step(self, offsets: Array) -> Array:
        """State and measured pose (n, s + 6) one period after rest + offsets (n, s)."""
        sim, loop, n, m = self.sim, self.loop, self.sim.n, self.joints
        shifted, at = [], 2 * m
        for part in self.rest:
            width = part[0].size
            shifted.append(part + offsets[:, at : at + width].reshape(part.shape))
            at += width
        for name in self.names:
            loop.memory[name] = shifted.pop(0)
        if self._ages:
            sim.joint_delays.measurement_history = shifted.pop(0)
        # the engine's platform stands where the legs do
        memory = {k: loop.memory[f"platform.{k}"] for k in loop.platform.memory}
        y, yd = loop.platform.present(memory)
        q, v = np.tile(self.angles, (n, 1)), np.zeros((n, sim.joints))
        q[:, :m] += offsets[:, :m]
        v[:, :m] = offsets[:, m : 2 * m]
        sim.backend.write(np.arange(n), np.zeros(n), np.hstack([y, q]), np.hstack([yd, v]))
        if self._gears:
            bent = shifted.pop(0)
            sim.backend.set_gear_state(bent[:, 0], bent[:, 1])
        sim.step(self.hold)
        return np.hstack([self._vector(), loop.readings.y])


def joint_angles(system: System, q: npt.ArrayLike) -> Array:
    """Return joint angles as a finite (joints,) array.

    Args:
        system: whose arm.
        q: angles [rad], broadcast.

    Raises:
        ParameterError: another shape, or a number that is not finite.
    """
    try:
        wide = np.broadcast_to(np.asarray(q, float), (system.arm.n,))
    except ValueError:
        wide = np.asarray(q, float)
    return finite(wide, (system.arm.n,), "q")


def warn_if_unstable(
    simulator: SimulatorFactory,
    system: System,
    q: npt.ArrayLike,
    servo: JointServo | None,
) -> None:
    """Issue an `EmulationWarning` for an emulation that is unstable at q.

    Args:
        simulator, system, q, servo: see `linearise`.
    """
    if system.emulator_settings.operation == "position":
        return
    radius = judged_radius(simulator, system, q, servo)
    if unstable(radius):
        warnings.warn(
            f"unstable emulation: each control period multiplies its least stable mode by"
            f" {radius:.6g}. A slower platform, a heavier vehicle or payload_compensation"
            " makes it stable; `ves-gym emulation-check` finds the limit",
            EmulationWarning,
            stacklevel=3,  # the caller of the simulator
        )


def unstable(radius: float) -> bool:
    """True for a spectral radius beyond 1 and the rounding of a double eigenvalue."""
    return radius > 1 + SLACK


def judged_radius(
    simulator: SimulatorFactory, system: System, q: npt.ArrayLike, servo: JointServo | None
) -> float:
    """Return the loop's spectral radius over one control period; each one computed once.

    Args:
        simulator, system, q, servo: see `linearise`.
    """
    # by content: a system may hold arrays, which have no hash of their own
    key = content_hash((system, servo, joint_angles(system, q).tolist()))
    if key not in _RADII:
        _RADII[key] = linearise(simulator, system, q, servo=servo).spectral_radius
    return _RADII[key]
