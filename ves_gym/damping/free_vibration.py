"""Free vibration of a displaced base, joints held by their gains (thesis figures 4-6, 4-7).

Twice: by the linear model that gains are found with, and by the simulator.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import Array, finite
from ves_gym.damping.plant import THESIS_DISPLACEMENT, GainMatrices, plant_at, respond
from ves_gym.mechanics.servo import JointServo
from ves_gym.planners.coupling import modes
from ves_gym.simulation.simulator import Simulator
from ves_gym.simulation.stable_step import with_stable_step
from ves_gym.system.energy import SETTLED, base_energy
from ves_gym.system.system import System

_RECORDS = 16  # of a period of the stiffest base mode


class FreeVibration(NamedTuple):
    """Base motion under several sets of gains on one clock. Leading axis = gains."""

    t: Array  # (N,) s
    y: Array  # (m, N, 6) base pose [m, rad]
    strain: Array  # (m, N) strain energy of the base [J]
    total: Array  # (m, N) its energy E [J]
    swing: Array  # (m, n) largest joint excursion [rad]
    effort: Array  # (m, n) largest joint torque over its limit

    @property
    def E_int(self) -> Array:
        """(m,) integral of the strain energy over the run [J s]."""
        return np.asarray(np.trapezoid(self.strain, self.t, axis=-1))

    @property
    def t_5(self) -> Array:
        """(m,) s until E stays below 5 % of its peak; inf if it does not within the run."""
        late = self.total > SETTLED * self.total.max(axis=-1, keepdims=True)
        last = len(self.t) - late[:, ::-1].argmax(axis=-1)  # the sample after the last above
        return np.asarray(np.r_[self.t, np.inf][last])


def linear_free_vibration(
    system: System,
    q: npt.ArrayLike,
    gains: Sequence[GainMatrices],
    y: npt.ArrayLike = THESIS_DISPLACEMENT,
    *,
    seconds: float = 30.0,
) -> FreeVibration:
    """Simulate the linear model under several sets of gains.

    Args:
        system: arm and vehicle, on motor drives.
        q: (n,) configuration [rad].
        gains: K [N m/rad] and B [N m s/rad], (n, n) each.
        y: (6,) initial displacement of the base [m, rad].
        seconds: of the run [s].
    """
    plant, (t, _) = plant_at(system, q), _clock(system, q, seconds)
    x = np.stack([respond(plant, g, y, t) for g in gains])
    n, w = system.arm.n, len(plant.free) // 2
    s, v = x[..., 6 : 6 + n], x[..., w + 6 : w + 6 + n]
    torque = np.stack(
        [a @ g.K + b @ g.B for a, b, g in zip(s, v, gains, strict=True)]  # K, B symmetric
    )
    return FreeVibration(
        t=t,
        y=x[..., :6],
        strain=np.einsum("mki,ij,mkj->mk", x, plant.strain, x),
        total=np.einsum("mki,ij,mkj->mk", x, plant.total, x),
        swing=np.abs(s).max(axis=1),
        effort=np.abs(torque).max(axis=1) / system.arm.column("tau_max"),
    )


def simulate_free_vibration(
    system: System,
    q: npt.ArrayLike,
    gains: Sequence[GainMatrices],
    y: npt.ArrayLike = THESIS_DISPLACEMENT,
    *,
    seconds: float = 30.0,
) -> FreeVibration:
    """Run the simulator under several sets of gains: large motions, limited motors.

    Diagonal gains act inside the physics step, as those of any servo; the torque by which
    full matrices couple the joints is constant over each physics step. Arguments as those of
    `linear_free_vibration`.

    Raises:
        ParameterError: a joint beyond its limits.
    """
    arm = system.arm
    start = arm.require_within_limits(q)
    K, B = (np.stack([getattr(g, name) for g in gains]) for name in ("K", "B"))
    kp, kd = (np.diagonal(k, axis1=1, axis2=2) for k in (K, B))
    stiff, damped = (tuple(np.maximum(k.max(axis=0), 0.0).tolist()) for k in (kp, kd))
    system = with_stable_step(system, JointServo(kp=stiff, kd=damped))
    t, stride = _clock(system, q, seconds)
    across_K, across_B = (k * (1 - np.eye(arm.n)) for k in (K, B))
    crossed = bool(across_K.any() or across_B.any())
    fine = system.replace(control_dt=system.physics_dt)
    zero = (0.0,) * arm.n
    sim = Simulator(fine, len(gains), servo=JointServo(kp=zero, kd=zero))
    sim.set_gains(kp, kd)
    sim.reset(q=start, y=finite(y, (6,), "y"))
    hold = kp * start
    nodes = np.repeat(hold[:, None], stride + 1, axis=1)

    def command() -> Array:
        state = sim.state
        away = np.einsum("mij,mj->mi", across_K, state.q - start)
        return np.asarray(hold - away - np.einsum("mij,mj->mi", across_B, state.v))

    states, torques, internal = [], [], []
    for k in range(len(t)):
        states.append(sim.state)
        internal.append(sim.base_modes)
        torques.append(sim.evaluate(command())[0])
        if k + 1 == len(t):
            break
        if crossed:
            for _ in range(stride):
                sim.step(command())
        else:
            sim.play(nodes)
    joints, pose, rate = (
        np.stack([getattr(s, name) for s in states], axis=1) for name in ("q", "y", "yd")
    )
    shaken = [np.stack(k) for k in internal if k is not None]
    shaking: Any = tuple(np.stack(shaken, axis=2)) if shaken else None
    energy = base_energy(system, joints, pose, rate, shaking)
    return FreeVibration(
        t=t,
        y=pose,
        strain=energy.strain,
        total=energy.total,
        swing=np.abs(joints - start).max(axis=1),
        effort=np.abs(np.stack(torques, axis=1)).max(axis=1) / arm.column("tau_max"),
    )


def _clock(system: System, q: npt.ArrayLike, seconds: float) -> tuple[Array, int]:
    """Times (N,) of the records [s], and physics steps between them.

    The control period, or what shows a swing of the stiffest base mode by _RECORDS.
    """
    start = system.arm.require_within_limits(q)
    period = 2 * np.pi / float(modes(system, start).omega.max())
    stride = int(np.clip(period / _RECORDS / system.physics_dt, 1, system.substeps))
    dt = stride * np.float64(system.physics_dt)
    return np.arange(round(seconds / float(dt)) + 1) * dt, stride
