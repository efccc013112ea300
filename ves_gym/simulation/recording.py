"""What is recorded of runs on one clock: arrays by run, and the measures taken from them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ves_gym._util.params import Array
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.limits import LimitCheck, check_limits, limits_of, middle_of_range
from ves_gym.mechanics.servo import JointServo
from ves_gym.simulation.capture import Capture
from ves_gym.simulation.loop_reports import Event
from ves_gym.system.disturbance import (
    Disturbance,
    Watched,
    disturbance,
    mount_acceleration,
)
from ves_gym.system.energy import TAIL, Energies, energies
from ves_gym.system.frequency_weight import FAST, FrequencyWeight
from ves_gym.system.runlog import RunLog
from ves_gym.system.system import System

WATCHED = ("position", "velocity", "torque")


@dataclass(frozen=True)
class Extremes:
    """Nearest approach of each joint to its limits, between the records as well.

    Axes: kind (`WATCHED`), run, joint. Positions are from the middle of the range.
    """

    time: Array  # (3, n, joints) s
    value: Array  # (3, n, joints) rad, rad/s, N m

    @staticmethod
    def none(n: int, joints: int) -> Extremes:
        """Return arrays to be filled by `watch`."""
        return Extremes(np.zeros((3, n, joints)), np.zeros((3, n, joints)))

    def watch(self, t: float, position: Array, v: Array, tau: Array) -> None:
        """Take the joints of all runs (n, joints) at time t [s] into account."""
        value = np.stack([position, v, tau])
        larger = np.abs(value) > np.abs(self.value)
        self.value[larger] = value[larger]
        self.time[larger] = t


@dataclass(frozen=True)
class Steps:
    """Arm and base between the records as well, until shortly after the motion."""

    t: Array  # (N,) s
    q: Array  # (n, N, joints)
    v: Array  # (n, N, joints)
    y: Array  # (n, N, 6)


class BaseWatch:
    """Accelerations of n bases between the records as well, until shortly after the motion.

    Args:
        arm: for its mount.
        n: runs.
        until: time up to which it looks [s].
    """

    def __init__(self, arm: Arm, n: int, until: float) -> None:
        self.arm, self.until, self.time = arm, until, 0.0
        self.peaks = np.zeros((n, 2))  # m/s^2, rad/s^2
        self.squares = np.zeros((n, 2))  # their time integral
        self._last = np.zeros((n, 2))
        self._looks: list[tuple[float, Array, Array, Array]] = []  # not yet in these

    def look(self, t: float, y: Array, yd: Array, ydd: Array) -> None:
        """Take the motion of all bases (n, 6) at time t [s] into account."""
        if t <= self.until + 1e-9:
            self._looks.append((t, y, yd, ydd))

    def of(self, i: int) -> Watched:
        """Return what was seen of run i."""
        if self._looks:
            self._measure()
        return Watched(self.time, *self.peaks[i], *self.squares[i])

    def _measure(self) -> None:
        """Add all looks at once: one by one each would cost as much as a step of the engine."""
        t, *motion = (np.array(part) for part in zip(*self._looks, strict=True))
        self._looks.clear()
        parts = mount_acceleration(self.arm, *motion)
        now = np.stack([np.sum(part**2, axis=-1) for part in parts], axis=-1)
        before = np.concatenate([self._last[None], now[:-1]])
        steps = np.diff(t, prepend=self.time)[:, None, None]
        self.squares = np.add.accumulate([self.squares, *(steps / 2 * (before + now))])[-1]
        np.maximum(self.peaks, np.sqrt(now.max(axis=0)), out=self.peaks)
        self.time, self._last = float(t[-1]), now[-1]


@dataclass(frozen=True)
class Recording:
    """A stack of runs on one clock. Leading axis = run."""

    system: System
    servo: JointServo
    duration: float  # of the motions [s]
    t: Array  # (N,) s
    q_cmd: Array  # (n, N, joints)
    v_cmd: Array
    q: Array
    v: Array
    tau: Array  # (n, N, joints) drive torque [N m]
    y: Array  # (n, N, 6)
    yd: Array
    w: Array  # (n, N, 6) wrench of the arm on the base, platform frame [N, N m]; in the
    #           laboratory what the force sensor reports, weight included
    wg: Array | None = None  # (n, N, 6) w less the estimated weight; laboratory only
    y_cmd: Array | None = None  # (n, N, 6) pose the platform is told; laboratory only
    ydd: Array | None = None  # (n, N, 6) acceleration of the base
    u: Array | None = None  # (n, N, m) internal modes of the base, None where it has none
    ud: Array | None = None
    motor: Array | None = None  # (n, N, w) of a satellite's wheels, held to the next record
    jet: Array | None = None  # (n, N, 6) wrench of its jets, platform axes, held likewise
    propellant: Array | None = None  # (n, N, 1) kg, used since the start
    p: Array | None = None  # (n, N, 7) payloads: place and attitude, None without one
    pd: Array | None = None  # (n, N, 6) velocity of the centre of mass, spin in own axes
    # (n, N, 6) wrench of contact on the tool, at the tool, inertial axes [N, N m]
    contact: Array | None = None
    contact_energy: Array | None = None  # (n, N, 1) stored in its springs [J]
    captures: tuple[Capture, ...] = ()  # latches that closed and opened
    events: tuple[Event, ...] = ()  # safety stops; a run is meaningful up to its own
    backend: str = ""  # the engine that ran
    extremes: Extremes | None = None  # of the joints, where they were watched
    base_watch: BaseWatch | None = None  # of the base, likewise
    steps: Steps | None = None  # of both, likewise

    def internal(self, i: Any, part: Any = slice(None)) -> tuple[Array, Array] | None:
        """Return u and u' of the internal modes in run i, None of a base without.

        Args:
            i: which run, or runs.
            part: of the records.
        """
        if self.u is None or self.ud is None:
            return None
        return self.u[i][..., part, :], self.ud[i][..., part, :]

    def energies(
        self,
        which: Sequence[int] | None = None,
        *,
        tail: float = TAIL,
        as_it_is: bool = False,
    ) -> list[Energies]:
        """Return the energy measures of runs.

        Args:
            which: numbers of the runs; None for all.
            tail: how long after the motion E_mean reaches [s].
            as_it_is: of arm and base with their effects; else of the described ones.
        """
        system = self.system.actual if as_it_is else self.system
        rows: Any = slice(None) if which is None else list(which)
        motion = self.t, self.q[rows], self.y[rows], self.yd[rows]
        modes = self._recorded_modes(system, rows)
        return energies(system, *motion, duration=self.duration, tail=tail, internal=modes)

    def disturbance(
        self,
        i: int,
        *,
        tail: float = TAIL,
        as_it_is: bool = False,
        weight: FrequencyWeight = FAST,
    ) -> Disturbance:
        """Return the disturbance measures of run i.

        Args:
            i: which run.
            tail: time after the motion that counts [s].
            as_it_is: of arm and base with their effects; else of the described ones.
            weight: filter of `E_weighted`.
        """
        system = self.system.actual if as_it_is else self.system
        return disturbance(
            system,
            self.t,
            self.q[i],
            self.q_cmd[i],
            self.y[i],
            self.yd[i],
            None if self.ydd is None else self.ydd[i],
            duration=self.duration,
            tail=tail,
            internal=self._recorded_modes(system, i),
            weight=weight,
            watched=None if self.base_watch is None else self.base_watch.of(i),
        )

    def _recorded_modes(self, system: System, i: Any) -> tuple[Array, Array] | None:
        """Internal modes of runs; None where effects have added some, not recorded."""
        modes, size = self.internal(i), system.arm.bends + system.base.hidden
        return modes if modes is None or modes[0].shape[-1] == size else None

    def records(self, i: int) -> int:
        """Records of run i up to its safety stop (that included), all N without one."""
        return self._until_stop(i, self.t)

    def _until_stop(self, i: int, t: Array) -> int:
        stops = [e.time for e in self.events if e.simulation == i]
        if not stops:
            return len(t)
        return min(len(t), max(2, int(np.searchsorted(t, stops[0] + 1e-9)) + 1))

    def closely(self, i: int) -> Steps:
        """Return run i alone at every step that was watched, up to its safety stop.

        Its records where it was not watched.

        Args:
            i: number of the run.
        """
        of = Steps(self.t, self.q, self.v, self.y) if self.steps is None else self.steps
        end = self._until_stop(i, of.t)
        return Steps(of.t[:end], of.q[i, :end], of.v[i, :end], of.y[i, :end])

    def limit_check(
        self,
        i: int,
        *,
        v_max: Sequence[float] | None = None,
    ) -> LimitCheck:
        """Check the joints of run i as they moved, up to its safety stop if it had one.

        A torque is what the drives are told, which the simulator keeps within their limits.

        Args:
            i: number of the run.
            v_max: (joints,) speed limits besides the arm's own [rad/s].
        """
        arm = self.system.arm
        limits = limits_of(arm, v_max=v_max, motor=self.system.drive == "motor")
        if self.extremes is not None:
            times, parts = self.extremes.time[:, i], self.extremes.value[:, i]
            found = [
                check_limits({k: limits[k]}, t[None], {k: x[None]}, arm.sliding).extremes
                for k, t, x in zip(WATCHED, times, parts, strict=True)
                if k in limits
            ]
            return LimitCheck(tuple(e for part in found for e in part))
        end = self.records(i)
        q, v, tau = (part[i, :end] for part in (self.q, self.v, self.tau))
        values = dict(zip(WATCHED, (q - middle_of_range(arm), v, tau), strict=True))
        return check_limits(limits, self.t[:end], values, arm.sliding)

    def log(self, i: int, note: str = "") -> RunLog:
        """Return a run as a log that can be saved: up to its safety stop, if it had one.

        Args:
            i: which run.
            note: of the log's metadata.
        """
        end = self.records(i)
        initial = {k: getattr(self, k)[i, 0].tolist() for k in ("q", "v", "y", "yd")}
        stops = [{"time": e.time, "reason": e.reason} for e in self.events if e.simulation == i]
        meta: dict[str, Any] = {
            "format": "ves-run/1",
            "system": self.system.to_dict(),
            "controller": {
                "kp": list(self.servo.kp),
                "kd": list(self.servo.kd),
                "feedforward": self.servo.feedforward,
            },
            "initial": initial,
            "noise_std": {},
            "backend": self.backend,
            "duration": self.duration,
            "note": note,
        }
        if self.system.mode == "emulated":
            meta["events"] = stops
        if self.extremes is not None:
            meta["limits"] = self.limit_check(i).to_dict()
        if self.system.payload is not None:
            captures = [event for event in self.captures if event.simulation == i]
            meta["captures"] = [event.to_dict() for event in captures]
        return RunLog(
            t=self.t[:end],
            q_cmd=self.q_cmd[i, :end],
            v_cmd=self.v_cmd[i, :end],
            q=self.q[i, :end],
            v=self.v[i, :end],
            tau=self.tau[i, :end],
            y=self.y[i, :end],
            yd=self.yd[i, :end],
            w=self.w[i, :end],
            wg=None if self.wg is None else self.wg[i, :end],
            y_cmd=None if self.y_cmd is None else self.y_cmd[i, :end],
            u=None if self.u is None else self.u[i, :end],
            ud=None if self.ud is None else self.ud[i, :end],
            motor=None if self.motor is None else self.motor[i, :end],
            jet=None if self.jet is None else self.jet[i, :end],
            propellant=None if self.propellant is None else self.propellant[i, :end],
            p=None if self.p is None else self.p[i, :end],
            pd=None if self.pd is None else self.pd[i, :end],
            contact=None if self.contact is None else self.contact[i, :end],
            contact_energy=None
            if self.contact_energy is None
            else self.contact_energy[i, :end],
            meta=meta,
        )
