"""Energy account of environment episodes: what the drives did against where it went.

In space only: in the laboratory the platform does work of its own. Nor where something is
grasped: the account knows one machine, and what it does at the joints. A sample per control
period is enough, for the drive's command is known to be constant or linear within it, so that
its work is integrated as such; the rest are quadratures.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ves_gym._util.params import Array, Mask
from ves_gym.envs.control import Control
from ves_gym.envs.vector import VesVectorEnv
from ves_gym.system.energy_balance import EnergyBalance
from ves_gym.system.system import System


class Account:
    """Collects the samples of a vector environment's episodes, one call per step."""

    def __init__(self) -> None:
        self._episodes: dict[int, list[Array]] = {}
        self._system: System | None = None
        self._control: Control | None = None

    def observe(self, env: VesVectorEnv, fresh: Mask) -> None:
        """Keep the state before a step; `fresh` (n,): environments that are in an episode."""
        s = env.batch.scene
        self._system, self._control = env.task.system, env.task.control
        modes = env.batch.sim.base_modes or ()  # u and u' of a base with internal modes
        row = np.concatenate([s.q, s.v, s.y, s.yd, s.tau, s.kp, s.kd, *modes], axis=1)
        for i in np.flatnonzero(fresh).tolist():
            self._episodes.setdefault(int(env.batch.episodes.root[i]), []).append(row[i])

    def residuals(self) -> dict[int, float]:
        """Of each episode, by its seed: largest residual over the energy turned over.

        That is the energy at the start and all work, whatever its sign.
        """
        if self._system is None or self._control is None or self._system.mode != "ideal":
            return {}
        return {
            seed: _relative(self._system, self._control, np.stack(rows))
            for seed, rows in self._episodes.items()
            if len(rows) >= 3
        }


def _relative(system: System, control: Control, rows: Array) -> float:
    n = system.arm.n
    parts = np.split(rows, np.cumsum([n, n, 6, 6, n, n, n]), axis=1)
    q, v, y, yd, tau, kp, kd, modes = parts
    u, ud = np.split(modes, 2, axis=1)
    internal = (u, ud) if u.shape[1] else None
    t: Array = np.arange(len(rows)) * np.float64(system.control_dt)
    done = _work(system, control, q, v, tau, kp, kd)
    work: Array = np.r_[0.0, np.cumsum(done)]
    turned_over = float(np.abs(done).sum())
    balance = EnergyBalance.close(
        system, t, q, v, y, yd, work, turned_over=turned_over, internal=internal
    )
    return balance.relative if balance.scale > 0 else 0.0


def _work(
    system: System, control: Control, q: Array, v: Array, tau: Array, kp: Array, kd: Array
) -> Array:
    """(N - 1,) work of the drives in each period [J]: torque c - kp q - kd v, limited."""
    h = system.control_dt
    first, last = tau[1:], tau[1:]  # the command at a period's ends: held over it
    kp, kd = kp[1:], kd[1:]  # of the period, not of the one before
    if control.level == "torque":
        servo: Any = control.servo_for(system.arm)
        gains = (servo.kp, servo.kd)
        kp, kd = (np.broadcast_to(np.resize(k, q.shape[1]), kp.shape) for k in gains)
    elif control.level == "reference":
        first = tau[:-1]  # or linear
    a, b = q[:-1], q[1:]
    area = h / 2 * (a + b) - h**2 / 12 * np.diff(v, axis=0)  # of q, by its ends and slopes
    pushed = last * b - first * a - (last - first) / h * area - kp * (b**2 - a**2) / 2
    middle = 1.5 * (b - a) / h - (v[1:] + v[:-1]) / 4  # rate there, by the same cubic
    damped = kd * h / 6 * (v[:-1] ** 2 + 4 * middle**2 + v[1:] ** 2)
    most = system.arm.column("tau_max")
    raw = (first - kp * a - kd * v[:-1], last - kp * b - kd * v[1:])
    low, high = (np.clip(k, -most, most) for k in raw)
    limited = (np.abs(raw[0]) > most) | (np.abs(raw[1]) > most)
    work = np.where(limited, (low + high) / 2 * (b - a), pushed - damped)
    out: Array = work.sum(axis=1)
    return out
