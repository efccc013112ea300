"""Stability of an emulation, known before the run (thesis 5.4).

The complete discrete loop of one control period - arm and servo, force sensor, gravity
compensation, admittance, platform - is linearised about rest by central differences of
the simulator itself, so that what is judged is what will run.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.linalg

from ves_gym._util.params import Array, to_plain
from ves_gym._util.tables import table
from ves_gym._util.views import Viewable
from ves_gym.hardware.leg_servo import LegServo
from ves_gym.hardware.platform import PoseServo
from ves_gym.mechanics.dynamics import inertia
from ves_gym.mechanics.servo import OWN_GAINS, JointServo
from ves_gym.mechanics.vehicle import vehicle_name
from ves_gym.simulation.loop_linearisation import SLACK, Linearised, joint_angles
from ves_gym.simulation.loop_linearisation import linearise as linearise_loop
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.system import System

SCHEMA = "ves-emulation-check/1"
_BANDWIDTHS, _GAINS = (0.2, 200.0), (1 / 16, 16.0)  # Hz, 1: searched for the largest stable
_NEAR = 20.0  # Hz: modes reported


@dataclass(frozen=True)
class Mode:
    """One mode of arm and base, in space and as the laboratory shows it."""

    frequency: float  # Hz, ideal
    damping: float  # ratio, ideal
    emulated_frequency: float  # Hz
    emulated_damping: float  # ratio; added damping is the difference


@dataclass(frozen=True, repr=False)
class EmulationCheck(Viewable):
    """Properties of an emulation known before it runs, at one configuration of the arm."""

    spectral_radius: float  # of one control period
    stable: bool
    payload_ratio: float  # largest eigenvalue of M^-1 H_b: arm over vehicle
    max_bandwidth: float | None  # Hz the platform may have; None: no limit up to 200 Hz
    max_gain: float | None  # factor the leg gains may be raised by (leg servos)
    lag: float  # s from wrench to motion, slow motion
    growth: float  # 1/s of the least stable mode; negative decays
    modes: tuple[Mode, ...]
    system: System
    at: Array  # (n,) joint angles [rad]
    searched: bool  # for the largest bandwidth or gain

    def __repr__(self) -> str:
        verdict = "stable" if self.stable else "UNSTABLE"
        return (
            f"<EmulationCheck: {verdict}, spectral radius {self.spectral_radius:.6f}, payload"
            f" ratio {self.payload_ratio:.3g}, lag {1e3 * self.lag:.1f} ms>"
        )

    def to_dict(self) -> dict[str, Any]:
        """Plain data."""
        measured = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "system"}
        return {
            "schema": SCHEMA,
            **{name: to_plain(value) for name, value in measured.items()},
            "system": self.system.to_dict(),
            "system_hash": self.system.hash,
        }

    def __str__(self) -> str:
        system, lab = self.system, self.system.emulator_settings
        compensated = "on" if lab.payload_compensation else "off"
        off = "of the arm's inertia; off is the thesis's loop"
        rows = [
            ("spectral radius", f"{self.spectral_radius:.6f}", "of one control period, <= 1"),
            ("growth", f"{self.growth:+.3f} 1/s", "of the least stable mode"),
            ("payload ratio", f"{self.payload_ratio:.3g}", "arm over vehicle, worst direction"),
            ("compensation", compensated, off),
            ("lag", f"{1e3 * self.lag:.1f} ms", "from wrench to motion, slow motion"),
        ]
        if self.searched and isinstance(lab.platform, PoseServo):
            limit = self.max_bandwidth
            text = f"none up to {_BANDWIDTHS[1]:g} Hz" if limit is None else f"{limit:.2f} Hz"
            nominal = f"this one has {lab.platform.bandwidth:g} Hz"
            rows.append(("largest bandwidth", text, nominal))
        elif self.searched:
            text = "none up to 16" if self.max_gain is None else f"{self.max_gain:.2f}"
            rows.append(("largest gain factor", text, "on K1 and K2 of the legs"))
        modes = []
        for mode in self.modes:
            hertz = (f"{f:.3f}" for f in (mode.frequency, mode.emulated_frequency))
            ratios = (f"{100 * z:.2f}" for z in (mode.damping, mode.emulated_damping))
            added = f"{100 * (mode.emulated_damping - mode.damping):+.2f}"
            modes.append((*hertz, *ratios, added))
        head = ("f [Hz]", "emulated", "damping [%]", "emulated", "added [%]")
        title = "modes of arm and base: in space, and as the laboratory shows them"
        return (
            f"{'stable' if self.stable else 'UNSTABLE'}: {system.arm.name} on"
            f" {vehicle_name(system.vehicle)}, emulated at {1 / system.control_dt:.4g} Hz\n"
            f"{table((), rows)}\n{table(head, modes, title=title, left=())}"
        )


def check_emulation(
    system: System,
    q: npt.ArrayLike = 0.0,
    *,
    servo: JointServo | None = OWN_GAINS,
    search: bool = True,
) -> EmulationCheck:
    """Judge an emulated system at joint angles q.

    Args:
        search: also find the largest stable platform bandwidth (some thirty more loops).

    Raises:
        ParameterError: the system is not emulated, or the platform is position controlled.
    """
    angles = joint_angles(system, q)
    A = linearise(system, angles, servo=servo).A
    z = np.linalg.eigvals(A).astype(np.complex128)
    radius = float(np.abs(z).max())
    limit = largest_stable(system, angles, servo=servo) if search else None
    posed = isinstance(system.emulator_settings.platform, PoseServo)
    return EmulationCheck(
        spectral_radius=radius,
        stable=radius <= 1 + SLACK,
        payload_ratio=_payload_ratio(system, inertia(system.arm, angles)),
        max_bandwidth=limit if posed else None,
        max_gain=None if posed else limit,
        lag=system.emulator_settings.lag(system.control_dt),
        growth=float(np.log(radius) / system.control_dt),
        modes=_modes(
            poles_in_space(*in_space(system, angles, servo=servo)),
            np.log(z[np.abs(z) > 1e-9]) / system.control_dt,
        ),
        system=system,
        at=angles,
        searched=search,
    )


def linearise(
    system: System, q: npt.ArrayLike = 0.0, *, servo: JointServo | None = OWN_GAINS
) -> Linearised:
    """Linearise the loop about rest; see `loop_linearisation`.

    Args:
        system: an emulated one.
        q: joint angles [rad], broadcast to (joints,).
        servo: joint servo, None for bare torques.

    Raises:
        ParameterError: the system is not emulated, or the platform is position controlled.
    """
    return linearise_loop(Simulator, system, q, servo=servo)


def largest_stable(
    system: System, q: npt.ArrayLike = 0.0, *, servo: JointServo | None = OWN_GAINS
) -> float | None:
    """Return the platform at which the loop first becomes unstable, from the slowest one up.

    Args:
        system, q, servo: see `linearise`.

    Returns:
        Bandwidth of a pose servo (0.2 to 200 Hz), or factor on the gains of legs (1/16 to 16);
        the largest one searched is stable where it is None, none where it is the least.
    """
    lab = system.emulator_settings
    described = lab.platform

    def stable(log: float) -> bool:
        factor = float(np.exp(log))
        if isinstance(described, PoseServo):
            platform: PoseServo | LegServo = replace(described, bandwidth=factor)
        else:
            platform = described.scaled(factor)
        faster = system.replace(emulator=replace(lab, platform=platform))
        return linearise(faster, q, servo=servo).spectral_radius <= 1 + SLACK

    ends, count = (_BANDWIDTHS, 25) if isinstance(described, PoseServo) else (_GAINS, 17)
    grid = np.linspace(np.log(ends[0]), np.log(ends[1]), count).tolist()
    broken = next((k for k, log in enumerate(grid) if not stable(log)), None)
    if not broken:
        return None if broken is None else float(np.exp(grid[0]))
    low, high = grid[broken - 1], grid[broken]
    for _ in range(7):
        middle = (low + high) / 2
        low, high = (middle, high) if stable(middle) else (low, middle)
    return float(np.exp(low))


def _payload_ratio(system: System, H: Array) -> float:
    """Largest eigenvalue of M^-1 H_b (inf for a vehicle with a massless direction)."""
    M = system.base.mass_matrix
    if np.linalg.eigvalsh(M)[0] <= 0:
        return float("inf")
    return float(scipy.linalg.eigh(H[:6, :6], M, eigvals_only=True)[-1])


def in_space(
    system: System, q: npt.ArrayLike = 0.0, *, servo: JointServo | None = OWN_GAINS
) -> tuple[Array, Array, Array]:
    """Return M, D, K of base and servo-held joints in mode ideal, linear about rest.

    Args:
        system: arm and vehicle.
        q: joint angles [rad], broadcast to (joints,).
        servo: joint servo, None for bare torques.

    Returns:
        Square in (Y, joints of a motor drive, internal modes of the base): what is emulated.
    """
    base, m = system.base, system.arm.n if system.drive == "motor" else 0
    size = 6 + m + base.m
    M, D, K = np.zeros((3, size, size))
    M[: 6 + m, : 6 + m] = inertia(system.arm, joint_angles(system, q))[: 6 + m, : 6 + m]
    at = np.r_[:6, 6 + m : size]
    for part, block in zip((M, D, K), base.full(), strict=True):
        part[at[:, None], at] += block
    joints = np.arange(6, 6 + m)
    if servo is not None and m:
        servo = servo.for_arm(system.arm, system.vehicle)
        D[joints, joints], K[joints, joints] = servo.kd, servo.kp
    return M, D, K


def poles_in_space(M: Array, D: Array, K: Array) -> npt.NDArray[np.complex128]:
    """Return the eigenvalues of M Y'' + D Y' + K Y = 0 [1/s].

    Args:
        M, D, K: (k, k).
    """
    n = len(M)
    lower = np.linalg.solve(M, np.hstack([-K, -D]))
    companion = np.vstack([np.eye(n, 2 * n, n), lower])
    return np.linalg.eigvals(companion).astype(np.complex128)


def _modes(ideal: npt.NDArray[np.complex128], emulated: Any) -> tuple[Mode, ...]:
    """The ideal system's oscillating modes, each with the loop's nearest pole [1/s]."""
    out, free = [], [s for s in emulated if s.imag > 1e-6]
    for s in sorted((s for s in ideal if s.imag > 1e-6), key=abs):
        if abs(s) > 2 * np.pi * _NEAR or not free:
            continue
        near = min(free, key=lambda k: abs(k - s))
        free.remove(near)
        rates = ((float(abs(k) / 2 / np.pi), float(-k.real / abs(k))) for k in (s, near))
        out.append(Mode(*next(rates), *next(rates)))
    return tuple(out)
