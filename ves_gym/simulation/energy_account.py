"""Energy accounts of runs in lockstep, updated at every physics step whatever is recorded."""

from __future__ import annotations

import numpy as np
import scipy

from ves_gym._util.params import Array
from ves_gym.mechanics.servo import JointServo
from ves_gym.mechanics.vehicle import has_jets, orbit_of
from ves_gym.system.effect import joint_torque
from ves_gym.system.energy import body_energy, port_energy, vehicle_energies
from ves_gym.system.energy_balance import drive_work
from ves_gym.system.system import System

TRUSTED = 0.01  # of the work through the base, that the energy account may be open by
# of the drives' work, that counts as work through the base at least: of a plan that leaves the
# base a thousandth of it, what the rule of integration misses is no fault of the base's energy
_LEAST = 0.01
_AT_ONCE = 256  # steps that are added up together


class EnergyAccount:
    """Work of the joint drives against what arm and base hold, of n runs.

    Of a system in space whose parts are all in `EnergyBalance`'s equations as arrays:
    `keeps` says of which.

    Args:
        system: as described.
        servo: of its joints.
        n: runs.
    """

    def __init__(self, system: System, servo: JointServo, n: int) -> None:
        self._system, self._gains = system.actual, (np.array(servo.kp), np.array(servo.kd))
        self._rows: list[tuple[float, tuple[Array, ...]]] = []
        self._first = np.full((2, n), np.nan)  # J: of everything, of what is behind the port
        self._sums = np.zeros((2, n))  # J: work less losses; lost behind the port
        self._open, self._scale = np.zeros((2, n))  # J

    @staticmethod
    def keeps(system: System) -> bool:
        """True for systems whose account this is: no latch, contact, gears, wheels, jets, or
        modes that an effect hides, no orbit."""
        acts = has_jets(system.vehicle) or system.base.carried or system.actual.arm.geared
        touches = system.payload is not None or system.contact is not None
        hides = system.actual.base.m != system.base.m
        pulled = orbit_of(system.vehicle) is not None
        return system.mode == "ideal" and not (acts or touches or hides or pulled)

    def enter(self, t: float, *row: Array) -> None:
        """Take a step into account.

        Args:
            t: [s], a physics step after the one before.
            row: q, v, tau (n, joints), y, yd (n, 6) and, of bases with internal modes and arms
                that bend, u, ud (n, m).
        """
        self._rows.append((t, row))
        if len(self._rows) > _AT_ONCE:
            self._add()

    def _add(self) -> None:
        """Add up the steps entered; the last of them begins the next sum."""
        system, t = self._system, np.array([time for time, _ in self._rows])
        q, v, tau, y, yd, *inner = (
            np.stack(part) for part in zip(*(row for _, row in self._rows), strict=True)
        )
        internal = (inner[0], inner[1]) if inner else None
        self._rows = self._rows[-1:]
        laws = joint_torque(system.effects, q, v, tau, system.arm.column("tau_max"))
        stored, lost = port_energy(system, y, yd, internal)
        strain, moving, _ = vehicle_energies(system, y, yd, internal)
        total = strain + moving + body_energy(system, q, y, yd, internal, v)
        begun = np.isnan(self._first[0])
        self._first[:, begun] = np.stack([total[0], stored[0]])[:, begun]
        rubbed = scipy.integrate.cumulative_simpson(
            np.stack([lost, lost - np.sum(laws * v, axis=-1)]), x=t, axis=1, initial=0.0
        )
        work = drive_work(system, self._gains, t, q, v, tau)
        sums = self._sums[:, None] + np.stack([work - rubbed[1], rubbed[0]])
        self._sums = sums[:, -1]
        gap, port = np.stack([sums[0] - total, sums[1] + stored]) + self._first[:, None] * [
            [[1]],
            [[-1]],
        ]
        self._open = np.maximum(self._open, np.abs(gap).max(axis=0))
        driven = _LEAST * np.abs(sums[0]).max(axis=0)
        self._scale = np.maximum(self._scale, np.maximum(np.abs(port).max(axis=0), driven))

    @property
    def residual(self) -> Array:
        """(n,) largest gap over the largest work through the base, or over a hundredth of that
        of the drives where it is more; 0 where nothing moved."""
        if len(self._rows) > 1:
            self._add()
        return np.divide(
            self._open, self._scale, np.zeros_like(self._open), where=self._scale > 0
        )
