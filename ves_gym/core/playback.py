"""Play joint motions on a system and record them: motions in, run logs out."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ves_gym.core.motion import Motion, Samples
from ves_gym.core.params import Array, ParameterError
from ves_gym.core.runlog import RunLog
from ves_gym.core.servo import HIGH_GAINS, JointServo
from ves_gym.core.simulator import Simulator, State
from ves_gym.core.spatial import body_wrench, matvec, rate_matrix
from ves_gym.core.system import System


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
    w: Array  # (n, N, 6) wrench of the arm on the base, platform frame [N, N m]

    def log(self, i: int, note: str = "") -> RunLog:
        """Run i as a log that can be saved."""
        initial = {k: getattr(self, k)[i, 0].tolist() for k in ("q", "v", "y", "yd")}
        return RunLog(
            t=self.t,
            q_cmd=self.q_cmd[i],
            v_cmd=self.v_cmd[i],
            q=self.q[i],
            v=self.v[i],
            tau=self.tau[i],
            y=self.y[i],
            yd=self.yd[i],
            w=self.w[i],
            meta={
                "format": "ves-run/1",
                "system": self.system.to_dict(),
                "controller": {
                    "kp": list(self.servo.kp),
                    "kd": list(self.servo.kd),
                    "feedforward": self.servo.feedforward,
                },
                "initial": initial,
                "noise_std": {},
                "duration": self.duration,
                "note": note,
            },
        )


def play_motions(
    system: System,
    motions: Sequence[Motion],
    *,
    servo: JointServo = HIGH_GAINS,
    settle: float = 10.0,
    record_dt: float | None = None,
    y: npt.ArrayLike = 0.0,
    yd: npt.ArrayLike = 0.0,
    progress: Callable[[float], None] | None = None,
) -> Recording:
    """Play motions of one duration in lockstep, then hold the joints for `settle` s.

    Commands run linearly through each physics step.

    Args:
        record_dt: time between records [s], a whole number of physics steps; default the
            control period.
        y, yd: base pose and rate at the start, broadcast to (n, 6).
        progress: called with the fraction done.

    Raises:
        ParameterError: no motion, unequal durations or joints, or a record_dt that is
            not a whole number of physics steps.
        Divergence: a simulation left the meaningful range.
    """
    n, duration = _common(system, motions)
    if not (settle >= 0 and math.isfinite(settle)):
        raise ParameterError(f"settle must be >= 0 s, got {settle!r}")
    dt = system.physics_dt
    stride = _whole(system.control_dt if record_dt is None else record_dt, dt, "record_dt")
    records = int(np.ceil((duration + settle) / (stride * dt) - 1e-9)) + 1
    sim = Simulator(system, n, servo=servo)
    sim.reset(q=np.stack([m.start for m in motions]), y=y, yd=yd)

    edges = np.arange((records - 1) * stride + 1, dtype=np.float64) * np.float64(dt)
    samples = _stack(motions, edges)
    commands = _commands(sim, samples)

    rows: list[tuple[Array, ...]] = []
    for k in range(records):
        state = sim.state
        tau, ydd = sim.evaluate(commands[:, k * stride])
        rows.append((state.q, state.v, tau, state.y, state.yd, _wrench(system, state, ydd)))
        if k + 1 < records:
            sim.play(commands[:, k * stride : (k + 1) * stride + 1])
        if progress is not None and k % 32 == 0:
            progress(k / records)
    names = ("q", "v", "tau", "y", "yd", "w")
    stacked = (np.stack(column, axis=1) for column in zip(*rows, strict=True))
    return Recording(
        system=system,
        servo=servo,
        duration=duration,
        t=edges[::stride],
        q_cmd=samples.q[:, ::stride],
        v_cmd=samples.v[:, ::stride],
        **dict(zip(names, stacked, strict=True)),
    )


def _common(system: System, motions: Sequence[Motion]) -> tuple[int, float]:
    if not motions:
        raise ParameterError("need at least one motion to play, got none")
    durations = sorted({m.duration for m in motions})
    if len(durations) > 1:
        raise ParameterError(f"motions must share one duration, got {durations}")
    for motion in motions:
        if motion.n != system.arm.n:
            raise ParameterError(
                f"a motion for {system.arm.name} needs {system.arm.n} joints, got {motion.n}"
            )
    return len(motions), durations[0]


def _whole(period: float, dt: float, name: str) -> int:
    ratio = period / dt
    if not math.isfinite(ratio) or round(ratio) < 1 or abs(ratio - round(ratio)) > 1e-9 * ratio:
        raise ParameterError(
            f"{name} must be a whole number of physics steps of {dt:g} s, got {period:g} s"
        )
    return round(ratio)


def _stack(motions: Sequence[Motion], t: Array) -> Samples:
    parts = [m.at(t) for m in motions]
    return Samples(t, *(np.stack([p[k] for p in parts]) for k in (1, 2, 3)))


def _commands(sim: Simulator, s: Samples) -> Array:
    """(n, N, joints) drive command at sampled instants: torque, or acceleration."""
    if sim.system.drive == "prescribed":
        return s.a
    tau = sim.servo.torque_feedforward(sim.system.arm, s)
    return sim.servo_command(s.q, s.v, tau)


def _wrench(system: System, state: State, ydd: Array) -> Array:
    """Wrench of the arm on the base in platform axes: what the vehicle's motion takes."""
    base, y, yd = system.base, state.y, state.yd
    # run by run: one matrix product over the batch would round by its size
    force = matvec(base.M, ydd) + matvec(base.D, yd) + matvec(base.K, y)  # conjugate to Y
    turn = np.swapaxes(rate_matrix(y), -1, -2)
    wrench = np.linalg.solve(turn, force[..., None])[..., 0]
    if base.body is not None:
        wrench = wrench + body_wrench(base.body.spatial(), y, yd, ydd)
    return np.asarray(wrench, dtype=np.float64)
