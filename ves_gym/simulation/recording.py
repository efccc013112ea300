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
from ves_gym.simulation.energy_account import EnergyAccount
from ves_gym.simulation.state import Event
from ves_gym.system.disturbance import Disturbance, Watched, disturbance, mount_acceleration
from ves_gym.system.energy import TAIL, Energies, energies
from ves_gym.system.frequency_weight import FAST, FrequencyWeight
from ves_gym.system.runlog import RunLog
from ves_gym.system.runlog_files import QUANTITIES
from ves_gym.system.system import System

WATCHED = ("position", "velocity", "torque")


@dataclass(frozen=True)
class Steps:
    """Arm and base between the records as well, until shortly after the motion."""

    t: Array  # (N,) s
    q: Array  # (n, N, joints)
    v: Array  # (n, N, joints)
    y: Array  # (n, N, 6)


class Watch:
    """n runs between the records as well: extremes of joints and bases, and their ways.

    Axes of `time` [s] and `extreme`, the nearest approach of each joint to its limits: kind
    (`WATCHED`), run, joint. Positions count from the middle of the range.

    Args:
        arm: of all runs.
        n: runs.
        until: time up to which the base is checked [s].
    """

    def __init__(self, arm: Arm, n: int, until: float) -> None:
        self.arm, self.until, self._middle = arm, until, middle_of_range(arm)
        self.time, self.extreme = np.zeros((2, 3, n, arm.n))
        self._before = 0.0  # s, of the last look at the base that is measured
        self._peaks = np.zeros((n, 2))  # m/s^2, rad/s^2
        self._squares = np.zeros((n, 2))  # their time integral
        self._last = np.zeros((n, 2))
        self._bases: list[tuple[float, Array, Array, Array]] = []  # not yet in these
        self._ways: list[tuple[float, Array, Array, Array]] = []

    def look(self, t: float, q: Array, v: Array, y: Array) -> None:
        """Take joints (n, joints) and bases (n, 6) at time t [s] into `steps`."""
        self._ways.append((t, q, v, y))

    def weigh(
        self, t: float, q: Array, v: Array, tau: Array, y: Array, yd: Array, ydd: Array
    ) -> None:
        """Take joints (n, joints), torques and motions of the bases (n, 6) into account."""
        value = np.stack([q - self._middle, v, tau])
        larger = np.abs(value) > np.abs(self.extreme)
        self.extreme[larger] = value[larger]
        self.time[larger] = t
        if t <= self.until + 1e-9:
            self._bases.append((t, y, yd, ydd))

    @property
    def steps(self) -> Steps:
        """Ways of all runs."""
        t, *parts = zip(*self._ways, strict=True)
        return Steps(np.array(t), *(np.stack(part, axis=1) for part in parts))

    def base(self, i: int) -> Watched:
        """Return what was seen of the base of run i."""
        if self._bases:
            self._measure()
        return Watched(self._before, *self._peaks[i], *self._squares[i])

    def _measure(self) -> None:
        """Add all samples at once: singly each would cost as much as a step of the engine."""
        t, *motion = (np.array(part) for part in zip(*self._bases, strict=True))
        self._bases.clear()
        parts = mount_acceleration(self.arm, *motion)
        square = np.stack([np.sum(part**2, axis=-1) for part in parts], axis=-1)
        before = np.concatenate([self._last[None], square[:-1]])
        steps = np.diff(t, prepend=self._before)[:, None, None]
        self._squares = np.add.accumulate([self._squares, *(steps / 2 * (before + square))])[-1]
        np.maximum(self._peaks, np.sqrt(square.max(axis=0)), out=self._peaks)
        self._before, self._last = float(t[-1]), square[-1]


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
    tau_ff: Array | None = None  # (n, N, joints) of a feed-forward that knows the base's motion
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
    watch: Watch | None = None  # of joints and bases, where they were watched
    account: EnergyAccount | None = None  # of the energies meanwhile, where it is kept

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
        self, which: Sequence[int] | None = None, *, tail: float = TAIL, as_it_is: bool = False
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
            watched=None if self.watch is None else self.watch.base(i),
        )

    def energy_residual(self, i: int) -> float | None:
        """Return how far the energy account of run i is open; None where there is none.

        Args:
            i: which run.
        """
        return None if self.account is None else float(self.account.residual[i])

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
        steps = Steps(self.t, self.q, self.v, self.y)
        of = steps if self.watch is None else self.watch.steps
        end = self._until_stop(i, of.t)
        return Steps(of.t[:end], of.q[i, :end], of.v[i, :end], of.y[i, :end])

    def limit_check(self, i: int, *, v_max: Sequence[float] | None = None) -> LimitCheck:
        """Check the joints of run i as they moved, up to its safety stop if it had one.

        A torque is the drives' command, which the simulator clips to their limits.

        Args:
            i: number of the run.
            v_max: (joints,) speed limits besides the arm's own [rad/s].
        """
        arm = self.system.arm
        limits = limits_of(arm, v_max=v_max, motor=self.system.drive == "motor")
        if self.watch is not None:
            times, parts = self.watch.time[:, i], self.watch.extreme[:, i]
            checks = [
                check_limits({k: limits[k]}, t[None], {k: x[None]}, arm.sliding).extremes
                for k, t, x in zip(WATCHED, times, parts, strict=True)
                if k in limits
            ]
            return LimitCheck(tuple(e for part in checks for e in part))
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
                **({"moving_base": True} if self.servo.holds(self.system.arm) else {}),
            },
            "initial": initial,
            "noise_std": {},
            "backend": self.backend,
            "duration": self.duration,
            "note": note,
        }
        if self.system.mode == "emulated":
            meta["events"] = stops
        if self.watch is not None:
            meta["limits"] = self.limit_check(i).to_dict()
        if (residual := self.energy_residual(i)) is not None:
            meta["energy_residual"] = residual
        if self.system.payload is not None:
            captures = [event for event in self.captures if event.simulation == i]
            meta["captures"] = [event.to_dict() for event in captures]
        parts = {name: getattr(self, name) for name in QUANTITIES}
        rows = {name: part[i, :end] for name, part in parts.items() if part is not None}
        return RunLog(t=self.t[:end], meta=meta, **rows)
