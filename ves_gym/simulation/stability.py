"""Stability of an emulation, known before the run (thesis 5.4).

The complete discrete loop of one control period - arm and servo, force sensor, gravity
compensation, admittance, platform - is linearised about rest by central differences of
the simulator itself, so that what is judged is what will run.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.linalg

from ves_gym._util.params import Array, ParameterError, content_hash, finite, to_plain
from ves_gym.hardware.leg_servo import LegServo
from ves_gym.hardware.platform import PoseServo
from ves_gym.mechanics.dynamics import inertia
from ves_gym.mechanics.servo import HIGH_GAINS, JointServo
from ves_gym.system.system import System

_STEP = 1e-5  # of the central differences, m, rad, N, ... in turn
# Slack of |z| <= 1: a free base has a double eigenvalue 1, which differences of 1e-9
# relative accuracy move by its square root.
_SLACK = 1e-4
_LOW, _HIGH = 0.2, 200.0  # Hz, searched for the largest stable bandwidth
_GRID = 25
_NEAR = 20.0  # Hz: modes reported
_RADII: dict[str, float] = {}  # spectral radii found before


class EmulationWarning(UserWarning):
    """An emulation that is unstable or leaves its assumptions."""


@dataclass(frozen=True)
class Mode:
    """One mode of arm and base, in space and as the laboratory shows it."""

    frequency: float  # Hz, ideal
    damping: float  # ratio, ideal
    emulated_frequency: float  # Hz
    emulated_damping: float  # ratio; added damping is the difference


@dataclass(frozen=True)
class EmulationCheck:
    """What is known of an emulation before it runs, at one configuration of the arm."""

    spectral_radius: float  # of one control period
    stable: bool
    payload_ratio: float  # largest eigenvalue of M^-1 H_b: arm over vehicle
    max_bandwidth: float | None  # Hz the platform may have; None: no limit up to 200 Hz
    max_gain: float | None  # factor the leg gains may be raised by (leg servos)
    lag: float  # s from wrench to motion, slow motion
    growth: float  # 1/s of the least stable mode; negative decays
    modes: tuple[Mode, ...]

    def to_dict(self) -> dict[str, Any]:
        """Plain data."""
        plain: dict[str, Any] = to_plain(self)
        for name in ("max_bandwidth", "max_gain"):
            plain.setdefault(name, None)
        return plain


def check_emulation(
    system: System,
    q: npt.ArrayLike = 0.0,
    *,
    servo: JointServo | None = HIGH_GAINS,
    search: bool = True,
) -> EmulationCheck:
    """Judge an emulated system at joint angles q.

    Args:
        search: also find the largest stable platform bandwidth (some thirty more loops).

    Raises:
        ParameterError: the system is not emulated, or the platform is position controlled.
    """
    angles = _angles(system, q)
    A = transition(system, angles, servo=servo)
    z = np.linalg.eigvals(A).astype(np.complex128)
    radius = float(np.abs(z).max())
    H = inertia(system.arm, angles)
    ratio = _payload_ratio(system, H)
    bandwidth = gain = None
    if search:
        if isinstance(system.laboratory.platform, PoseServo):
            bandwidth = max_bandwidth(system, angles, servo=servo)
        else:
            gain = max_gain(system, angles, servo=servo)
    return EmulationCheck(
        spectral_radius=radius,
        stable=radius <= 1 + _SLACK,
        payload_ratio=ratio,
        max_bandwidth=bandwidth,
        max_gain=gain,
        lag=system.laboratory.lag(system.control_dt),
        growth=float(np.log(radius) / system.control_dt),
        modes=_modes(
            poles_in_space(*in_space(system, angles, servo=servo)),
            np.log(z[np.abs(z) > 1e-9]) / system.control_dt,
        ),
    )


def spectral_radius(
    system: System, q: npt.ArrayLike = 0.0, *, servo: JointServo | None = HIGH_GAINS
) -> float:
    """Largest eigenvalue magnitude of the loop's transition over one control period."""
    return float(np.abs(np.linalg.eigvals(transition(system, q, servo=servo))).max())


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

    def compliance(self, f: npt.ArrayLike) -> npt.NDArray[np.complex128]:
        """(m, 6, 6) pose per wrench at frequencies f [Hz]."""
        z = np.exp(2j * np.pi * np.asarray(f, float) * self.dt)
        eye = np.eye(len(self.A))
        inner = np.linalg.solve(z[:, None, None] * eye - self.A, self.A @ self.E)
        return np.asarray(self.C @ (inner + self.E) / z[:, None, None], np.complex128)

    def step(self, wrench: npt.ArrayLike, periods: int) -> Array:
        """(periods + 1, 6) pose after a wrench (6,) that sets in at 0 and stays."""
        x, push = np.zeros(len(self.A)), self.E @ np.asarray(wrench, float)
        out = np.zeros((periods + 1, 6))
        for k in range(periods):
            out[k + 1] = self.C @ (x + push)
            x = self.A @ (x + push)
        return out


def transition(
    system: System, q: npt.ArrayLike = 0.0, *, servo: JointServo | None = HIGH_GAINS
) -> Array:
    """(s, s) linear map of the whole loop's state over one control period, about rest at q."""
    return linearise(system, q, servo=servo).A


def linearise(
    system: System, q: npt.ArrayLike = 0.0, *, servo: JointServo | None = HIGH_GAINS
) -> Linearised:
    """The whole loop about rest at joint angles q (mode emulated; ideal: `engine/linear.py`).

    Noise, drift and the quantisation of transducers and sensor are left out.
    """
    from ves_gym.simulation.simulator import Simulator

    angles, lab = _angles(system, q), system.laboratory
    if lab.operation == "position":
        raise ParameterError("operation position has no loop that could be unstable")
    sensor = replace(lab.sensor, force_resolution=0.0, moment_resolution=0.0)
    platform = lab.platform
    if isinstance(platform, LegServo):
        platform = replace(platform, resolution=0.0)
    # far from every safety limit
    smooth = replace(lab, sensor=sensor, platform=platform, force_max=1e12, moment_max=1e12)
    quiet = system.replace(emulator=smooth)
    size = _Loop(Simulator(quiet, 1, servo=servo, warn_at=None), angles).size
    loop = _Loop(Simulator(quiet, 2 * size, servo=servo, warn_at=None), angles)
    after = loop.step(_STEP * np.vstack([np.eye(size), -np.eye(size)]))
    slope = (after[:size] - after[size:]).T / (2 * _STEP)
    return Linearised(
        slope[:size], np.eye(size)[:, loop.reading], slope[size:], system.control_dt
    )


class _Loop:
    """A simulator whose whole state is read and written as one vector per simulation."""

    def __init__(self, sim: Any, angles: Array) -> None:
        sim.laboratory.sensor.silence()
        sim.reset(q=angles)
        self.sim, self.lab, self.angles = sim, sim.laboratory, angles
        # only what the loop acts on: anything else would be an eigenvalue 1 of its own
        self.joints = sim.joints if sim.system.drive == "motor" else 0
        self.names = ["X", "sent", "queue", "reading", "estimate", "past"]
        if sim.laboratory.compensating:
            self.names += ["sway", "felt", "payload"]
        elif sim.laboratory.carried[0].size:
            self.names += ["sway"]
        lab = sim.laboratory  # a model of its own, or the machine itself
        self._gears = bool(sim.system.actual.arm.geared)
        self._ages = sim.line is not None and sim.line.old
        self._modelled = lab.compensating and lab.model is not lab.follower
        self.rest = [part.copy() for part in self._parts()]
        self.size = 2 * self.joints + sum(part[0].size for part in self.rest)
        before = 2 * self.joints + sum(part[0].size for part in self.rest[:3])
        self.reading = slice(before, before + 6)  # X, sent and queue come first
        self.hold = sim.servo_command(
            np.broadcast_to(angles, (sim.n, sim.joints)), np.zeros((sim.n, sim.joints))
        )
        if sim.system.drive == "prescribed":
            self.hold = np.zeros_like(self.hold)

    def _parts(self) -> Iterator[Array]:
        """Arrays of the laboratory that carry over to the next period."""
        for name in self.names:
            yield getattr(self.lab.state, name)
        if self.lab.state.late.shape[1]:
            yield self.lab.state.late
        if self._ages:
            yield self.sim.line.past
        if self._gears:
            yield np.stack(self.sim.backend.hidden(), axis=1)
        yield self.lab.sensor.state.filter
        yield from self.lab.follower.get_state()
        if self._modelled:
            yield from self.lab.model.get_state()

    def _vector(self) -> Array:
        state = self.sim.state
        moving = [state.q, state.v] if self.joints else []
        parts = [*moving, *self._parts()]
        return np.concatenate([p.reshape(self.sim.n, -1) for p in parts], axis=1)

    def step(self, offsets: Array) -> Array:
        """State and measured pose (n, s + 6) one period after rest + offsets (n, s)."""
        sim, lab, n, m = self.sim, self.lab, self.sim.n, self.joints
        shifted, at = [], 2 * m
        for part in self.rest:
            width = part[0].size
            shifted.append(part + offsets[:, at : at + width].reshape(part.shape))
            at += width
        s = lab.state
        for name in self.names:
            setattr(s, name, shifted.pop(0))
        if s.late.shape[1]:
            s.late = shifted.pop(0)
        if self._ages:
            sim.line.past = shifted.pop(0)
        bent = shifted.pop(0) if self._gears else None
        lab.sensor.state.filter = shifted.pop(0)
        held = len(lab.follower.get_state())
        lab.follower.set_state(tuple(shifted[:held]))
        if self._modelled:
            lab.model.set_state(tuple(shifted[held:]))
        # the engine's platform stands where the follower's does
        kept = lab.follower.get_state()
        y, yd, _ = lab.follower.advance(s.sent[:, :6], s.sent[:, 6:])
        lab.follower.set_state(kept)
        q, v = np.tile(self.angles, (n, 1)), np.zeros((n, sim.joints))
        q[:, :m] += offsets[:, :m]
        v[:, :m] = offsets[:, m : 2 * m]
        sim.backend.write(
            np.arange(n), np.zeros(n), np.hstack([y[:, 0], q]), np.hstack([yd[:, 0], v])
        )
        if bent is not None:
            sim.backend.bend(bent[:, 0], bent[:, 1])
        sim.step(self.hold)
        return np.hstack([self._vector(), lab.follower.measured()])


def max_bandwidth(
    system: System, q: npt.ArrayLike = 0.0, *, servo: JointServo | None = HIGH_GAINS
) -> float | None:
    """Bandwidth [Hz] at which the loop first becomes unstable, from 0.2 Hz up.

    None if it is stable up to 200 Hz; 0.2 if it is nowhere.
    """
    lab = system.laboratory
    if not isinstance(lab.platform, PoseServo):
        raise ParameterError(f"max_bandwidth needs a pose servo, got {lab.platform.kind}")
    platform: PoseServo = lab.platform

    def stable(log: float) -> bool:
        fast = replace(lab, platform=replace(platform, bandwidth=float(np.exp(log))))
        return spectral_radius(system.replace(emulator=fast), q, servo=servo) <= 1 + _SLACK

    return _first_loss(stable, np.linspace(np.log(_LOW), np.log(_HIGH), _GRID))


def max_gain(
    system: System, q: npt.ArrayLike = 0.0, *, servo: JointServo | None = HIGH_GAINS
) -> float | None:
    """Factor on the leg gains at which the loop first becomes unstable, from 1/16 to 16."""
    lab = system.laboratory
    if not isinstance(lab.platform, LegServo):
        raise ParameterError(f"max_gain needs a leg servo, got {lab.platform.kind}")
    platform: LegServo = lab.platform

    def stable(log: float) -> bool:
        fast = replace(lab, platform=platform.scaled(float(np.exp(log))))
        return spectral_radius(system.replace(emulator=fast), q, servo=servo) <= 1 + _SLACK

    return _first_loss(stable, np.linspace(-np.log(16), np.log(16), 17))


def _first_loss(stable: Any, grid: Array) -> float | None:
    last = None
    for log in grid:
        if not stable(float(log)):
            break
        last = float(log)
    else:
        return None
    if last is None:
        return float(np.exp(grid[0]))
    low, high = last, float(log)
    for _ in range(7):
        middle = (low + high) / 2
        low, high = (middle, high) if stable(middle) else (low, middle)
    return float(np.exp(low))


def _angles(system: System, q: npt.ArrayLike) -> Array:
    try:
        wide = np.broadcast_to(np.asarray(q, float), (system.arm.n,))
    except ValueError:
        wide = np.asarray(q, float)
    return finite(wide, (system.arm.n,), "q")


def _payload_ratio(system: System, H: Array) -> float:
    """Largest eigenvalue of M^-1 H_b (inf for a vehicle with a massless direction)."""
    M = system.base.mass_matrix
    if np.linalg.eigvalsh(M)[0] <= 0:
        return float("inf")
    return float(scipy.linalg.eigh(H[:6, :6], M, eigvals_only=True)[-1])


def in_space(
    system: System, q: npt.ArrayLike = 0.0, *, servo: JointServo | None = HIGH_GAINS
) -> tuple[Array, Array, Array]:
    """M, D, K of base and servo-held joints in space, linear about rest at q.

    (6 + n) square for a motor drive, (6, 6) for a prescribed one: what is emulated.
    """
    base, m = system.base, system.arm.n if system.drive == "motor" else 0
    M = inertia(system.arm, _angles(system, q))[: 6 + m, : 6 + m].copy()
    D, K = np.zeros((2, 6 + m, 6 + m))
    M[:6, :6] += base.mass_matrix
    D[:6, :6], K[:6, :6] = base.D, base.K
    if servo is not None and m:
        D[6:, 6:], K[6:, 6:] = np.diag(servo.kd), np.diag(servo.kp)
    return M, D, K


def poles_in_space(M: Array, D: Array, K: Array) -> npt.NDArray[np.complex128]:
    """Eigenvalues [1/s] of M Y'' + D Y' + K Y = 0."""
    n = len(M)
    left = np.linalg.solve(M, np.hstack([-K, -D]))
    whole = np.vstack([np.eye(n, 2 * n, n), left])
    return np.linalg.eigvals(whole).astype(np.complex128)


def _modes(ideal: npt.NDArray[np.complex128], emulated: Any) -> tuple[Mode, ...]:
    """The ideal system's oscillating modes, each with the loop's nearest pole [1/s]."""
    out, free = [], [s for s in emulated if s.imag > 1e-6]
    for s in sorted((s for s in ideal if s.imag > 1e-6), key=abs):
        if abs(s) > 2 * np.pi * _NEAR or not free:
            continue
        near = min(free, key=lambda k: abs(k - s))
        free.remove(near)
        out.append(
            Mode(
                float(abs(s) / 2 / np.pi),
                float(-s.real / abs(s)),
                float(abs(near) / 2 / np.pi),
                float(-near.real / abs(near)),
            )
        )
    return tuple(out)


def warn_if_unstable(
    system: System, q: npt.ArrayLike, servo: JointServo | None, stacklevel: int = 3
) -> None:
    """Issue an `EmulationWarning` for an emulation that is unstable at q."""
    if system.laboratory.operation == "position":
        return
    # by content: a system may hold arrays, which have no hash of their own
    key = content_hash((system, servo, _angles(system, q).tolist()))
    if key not in _RADII:
        _RADII[key] = spectral_radius(system, q, servo=servo)
    radius = _RADII[key]
    if radius > 1 + _SLACK:
        warnings.warn(
            f"unstable emulation: each control period multiplies its least stable mode by"
            f" {radius:.6g}. A slower platform, a heavier vehicle or payload_compensation"
            " makes it stable; `ves-gym emulation-check` finds the limit",
            EmulationWarning,
            stacklevel=stacklevel,
        )
