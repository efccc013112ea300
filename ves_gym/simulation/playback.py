"""Play joint motions on a system and record them: motions in, run logs out."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import Array, ParameterError
from ves_gym.mechanics.carried import carried_wrench
from ves_gym.mechanics.motion import Motion, Samples
from ves_gym.mechanics.servo import OWN_GAINS, JointServo
from ves_gym.mechanics.spatial import body_wrench, matvec, rate_matrix, twist, twist_rate
from ves_gym.simulation.capture import Capture
from ves_gym.simulation.energy_account import EnergyAccount
from ves_gym.simulation.recording import Recording, Watch
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.runlog import RunLog
from ves_gym.system.system import System

_OVERSHOOT = 0.2  # s after a motion in which extremes are still looked for at every step
SETTLING = 0.5  # s after a motion in which arm and base are still watched at every step


def play_motions(
    system: System,
    motions: Sequence[Motion],
    *,
    servo: JointServo = OWN_GAINS,
    settle: float = 10.0,
    record_dt: float | None = None,
    y: npt.ArrayLike = 0.0,
    yd: npt.ArrayLike = 0.0,
    platform: Callable[[Array], tuple[Array, Array]] | None = None,
    gravity: Callable[[Array], Array] | None = None,
    latch: Sequence[tuple[float, str]] = (),
    seed: int = 0,
    backend: str = "auto",
    watch: bool = False,
    progress: Callable[[float], None] | None = None,
) -> Recording:
    """Play motions of one duration in lockstep, then hold the joints for `settle` s.

    Commands run linearly through each physics step. In mode emulated a run whose platform
    freezes goes on with the platform at rest; once all have frozen, playing ends.

    Args:
        record_dt: time between records [s], a whole number of physics steps (mode emulated:
            of control periods); default the control period.
        y, yd: base pose and rate at the start, broadcast to (n, 6).
        platform: position control: instants (m,) -> pose and rate to follow, (m, 6) for all
            runs or (n, m, 6).
        gravity: micro-gravity emulation: instants (m,) -> gravity wrench (n, m, 6) or (m, 6)
            that takes the place of the estimate (Learning Method).
        latch: instants of records [s] at which it closes or opens: "grasp" or "release". The
            record there holds the rates after it.
        seed: of sensor noise and drift.
        backend: engine, as `Simulator` takes it.
        watch: check joints and base between the records, too, until shortly after the
            motion: at every physics step, in mode emulated every control period (`Watch`), and
            keep the energy account (`EnergyAccount`). Changes no record.
        progress: called with the fraction done.

    Raises:
        ParameterError: no motion, unequal durations or joints, a record_dt that is not a
            whole number of steps, or a latch that cannot close or open when it is to.
        Divergence: a simulation left the meaningful range.
    """
    n, duration = _common(system, motions)
    if not (settle >= 0 and math.isfinite(settle)):
        raise ParameterError(f"settle must be >= 0 s, got {settle!r}")
    dt, emulated = system.physics_dt, system.mode == "emulated"
    interval = system.control_dt if record_dt is None else record_dt
    stride = _whole_multiple(interval, dt, "record_dt", "physics steps")
    if emulated:
        _whole_multiple(interval, system.control_dt, "record_dt", "control periods")
    records = int(np.ceil((duration + settle) / (stride * dt) - 1e-9)) + 1
    if system.drive == "motor" or not servo.kp:
        servo = servo.for_arm(system.arm, system.vehicle)
    latched = _latched(system, latch, stride * dt, records)
    sim = Simulator(
        system, n, servo=servo, backend=backend, seed=seed, warn_at=motions[0].start
    )

    edges = np.arange((records - 1) * stride + 1, dtype=np.float64) * np.float64(dt)
    moves = [m.at(edges) for m in motions]
    samples = Samples(edges, *(np.stack([move[k] for move in moves]) for k in (1, 2, 3)))
    commands = samples.a  # of a drive that follows its command
    fed = None  # torque that the log tells, as its commands do not
    if system.drive == "motor":
        tau = sim.servo.torque_feedforward(system.arm, samples)
        if sim.servo.holds(system.arm) and _is_foreseen(system):
            last = math.ceil((duration + SETTLING) / dt)
            tau = fed = _fed_forward(system, sim.servo, samples, last, y, yd)
        commands = sim.servo_command(samples.q, samples.v, tau)
    clock = edges[:: system.substeps]
    follow = table = None
    if platform is not None:
        pose, rate = (_per_run(part, clock, n, _FOLLOWED) for part in platform(clock))
        follow = np.concatenate([pose, rate], axis=-1)
    if gravity is not None:
        table = _per_run(gravity(clock), clock, n, "gravity must give wrenches")

    rows: list[dict[str, Array]] = []
    watched = Watch(system.arm, n, duration + _OVERSHOOT) if watch else None
    accounted = watch and EnergyAccount.keeps(system)
    account = EnergyAccount(system, sim.servo, n) if accounted else None
    fine = system.substeps if emulated else 1  # steps between looks at the joints
    if table is not None:
        sim.use_gravity(table[:, :1])
    moving = np.stack([m.at([0.0]).v[0] if m.moving else np.zeros(m.n) for m in motions])
    sim.reset(q=np.stack([m.start for m in motions]), v=moving, y=y, yd=yd)
    captures: list[Capture] = []
    for k in range(records):
        first, last, t = k * stride, (k + 1) * stride, float(edges[k * stride])
        if k in latched:
            captures += _latch(sim, latched[k], commands[:, first])
        row = _row(sim, commands[:, first])
        rows.append(row)
        if watched is not None:
            watched.weigh(t, *(row[name] for name in ("q", "v", "tau", "y", "yd", "ydd")))
            if t <= duration + SETTLING + 1e-9:
                watched.look(t, row["q"], row["v"], row["y"])
        if account is not None and t < duration + _OVERSHOOT:
            account.enter(t, *(row[name] for name in _ACCOUNTED if name in row))
        if (emulated and len(sim.events) >= n) or k + 1 == records:
            break
        spacing = fine if watched is not None and t < duration + SETTLING else stride
        for step in range(first, last, spacing):
            end = min(step + spacing, last)
            part = slice(step // system.substeps, end // system.substeps)
            if table is not None:
                sim.use_gravity(table[:, part.start + 1 : part.stop + 1])
            sim.play(
                commands[:, step : end + 1],
                platform=None if follow is None else follow[:, part],
            )
            if watched is not None and end < last:
                (q, v), state, at = sim.measured, sim.state, float(edges[end])
                watched.look(at, q, v, state.y)
                if t < duration + _OVERSHOOT:
                    tau, ydd = sim.evaluate(commands[:, end])
                    watched.weigh(at, q, v, tau, state.y, state.yd, ydd)
                    if account is not None:
                        modes = sim.base_modes or ()
                        account.enter(at, q, v, tau, state.y, state.yd, *modes)
        if progress is not None and k % 32 == 0:
            progress(k / records)
    columns = {name: np.stack([row[name] for row in rows], axis=1) for name in rows[0]}
    if not emulated:
        shape, parts = columns["y"].shape, [columns[name] for name in ("y", "yd", "ydd")]
        parts += [columns.pop(name) for name in _INNER if name in columns]
        flat = [part.reshape(shape[0] * shape[1], part.shape[-1]) for part in parts]
        y_all, yd_all, ydd_all = flat[:3]
        wrench = base_wrench(system, y_all, yd_all, ydd_all, flat[3:5], flat[5:] or None)
        columns["w"] = wrench.reshape(shape)
    end = (len(rows) - 1) * stride + 1
    return Recording(
        system=system,
        servo=servo,
        duration=duration,
        t=edges[:end:stride],
        q_cmd=samples.q[:, :end:stride],
        v_cmd=samples.v[:, :end:stride],
        tau_ff=None if fed is None else fed[:, :end:stride],
        **columns,
        captures=tuple(captures),
        events=tuple(sim.events),
        backend=sim.backend_name,
        watch=watched,
        account=account,
    )


def _is_foreseen(system: System) -> bool:
    """True where the base moves as in space."""
    return system.mode == "ideal" or system.emulator_settings.operation == "microgravity"


def _fed_forward(
    system: System,
    servo: JointServo,
    samples: Samples,
    last: int,
    y: npt.ArrayLike,
    yd: npt.ArrayLike,
) -> Array:
    """Feed-forward torque (n, N, joints) of commands on the described base that they move.

    The base is that of a simulation in which the joints follow their command exactly.

    Args:
        system, servo: what is played.
        samples: commands at the physics steps.
        last: step up to which the base is looked at in each; once a control period after it.
        y, yd: of the base at the start.
    """
    prescribed = system.ideal().replace(
        drive="prescribed", effects=(), payload=None, contact=None
    )
    sim, end = Simulator(prescribed, len(samples.q)), len(samples.t) - 1
    sim.reset(q=samples.q[:, 0], v=samples.v[:, 0], y=y, yd=yd)
    looks = [*range(min(last, end)), *range(min(last, end), end, system.substeps), end]
    rows = []
    for first, until in zip(looks, [*looks[1:], end], strict=True):
        ydd, state = sim.evaluate(samples.a[:, first])[1], sim.state
        rows.append((state.y, state.yd, ydd))
        if until > first:
            sim.play(samples.a[:, first : until + 1])
    base = [np.stack(part, axis=1) for part in zip(*rows, strict=True)]
    t, *samples_at = samples.t[looks], *(x[:, looks] for x in samples[1:])
    tau = servo.torque_feedforward(system.arm, Samples(t, *samples_at), base)
    between = [[np.interp(samples.t, t, x) for x in run.T] for run in tau]
    return np.moveaxis(np.array(between), 1, 2)


_FOLLOWED = "platform must give poses and rates"
_ACCOUNTED = ("q", "v", "tau", "y", "yd", "u", "ud")
_INNER = ("at", "rate", "torque", "wrench")  # of `_row`, to compute `w` from


def _row(sim: Simulator, command: Array) -> dict[str, Array]:
    """A record of n runs, by the names of a `Recording`, and in space what `w` follows from."""
    state, (q, v) = sim.state, sim.measured
    tau, ydd = sim.evaluate(command)
    out = {"q": q, "v": v, "tau": tau, "y": state.y, "yd": state.yd, "ydd": ydd}
    modes, acts = sim.base_modes, sim.base_actuators
    if modes is not None:
        out |= {"u": modes[0], "ud": modes[1]}
    if acts is not None:
        out |= acts.record()
    if sim.payload is not None:
        s = sim.payload.state
        out["p"] = np.concatenate([s.position, s.attitude], axis=1)
        out["pd"] = np.concatenate([s.velocity, s.spin], axis=1)
    if sim.contact is not None:
        wrench, energy = sim.contact.measured()
        out |= {"contact": wrench, "contact_energy": energy[:, None]}
    if sim.emulation_loop is not None:
        readings = sim.readings
        w = readings.wrench
        return out | {"w": w, "wg": w - readings.gravity, "y_cmd": readings.y_cmd}
    forces = () if acts is None else (acts.torque, acts.wrench)
    inner = (*sim.internal_state, *forces)
    return out | {name: part.copy() for name, part in zip(_INNER, inner, strict=False)}


def _latched(
    system: System, latch: Sequence[tuple[float, str]], interval: float, records: int
) -> dict[int, str]:
    """Commands of the latch at records, by their numbers."""
    if latch and system.payload is None:
        raise ParameterError("a latch needs a system with a payload, got one without")
    out: dict[int, str] = {}
    for time, kind in latch:
        if kind not in ("grasp", "release"):
            raise ParameterError(f"a latch does grasp or release, got {kind!r}")
        k = round(time / interval) if math.isfinite(time) else -1
        if not 0 <= k < records or abs(k * interval - time) > 1e-9 or k in out:
            raise ParameterError(
                f"{kind} must be at a record of its own, a whole number of {interval:g} s up to"
                f" {(records - 1) * interval:g} s, got {time!r} s"
            )
        out[k] = kind
    return out


def _latch(sim: Simulator, kind: str, command: Array) -> list[Capture]:
    """Close or open every latch; the drives' torques (n, joints) before it are noted."""
    if kind == "release":
        return sim.release()
    tau, _ = sim.evaluate(command)
    rows = [tuple(row) for row in tau.tolist()]
    return [event._replace(tau=rows[event.simulation]) for event in sim.grasp()]


def weigh_poses(
    system: System, q: npt.ArrayLike, y: npt.ArrayLike, *, seconds: float = 1.0, seed: int = 0
) -> RunLog:
    """Hold arm and platform still in each of m poses and record the force sensor.

    The platform stays under position control while the wrench is measured (thesis 3.4.5),
    one row per pose, the mean of `seconds`. The sensor's drift is that of a warm sensor,
    independent from pose to pose.

    Args:
        system: mode emulated; its operation does not matter.
        q: (m, joints) joint angles. y: (m, 6) platform poses.
    """
    angles, poses = np.atleast_2d(np.asarray(q, float)), np.atleast_2d(np.asarray(y, float))
    # zeroed anew in each pose the sensor would show nothing
    lab = replace(system.emulator_settings, operation="position", zero_at_start=False)
    effects = tuple(e for e in system.effects if not e.kind.startswith("gravity/"))
    still = system.replace(emulator=lab, effects=effects)
    sim = Simulator(still, len(angles), seed=seed, warn_at=None)
    sim.reset(q=angles, y=poses)
    assert sim.emulation_loop is not None
    sim.emulation_loop.warm_up()
    zeros = np.zeros_like(angles)
    hold = zeros if still.drive == "prescribed" else sim.servo_command(angles, zeros)
    total, pose, count = np.zeros((len(angles), 6)), np.zeros((len(angles), 6)), 0
    for _ in range(max(1, round(seconds / system.control_dt))):
        sim.step(hold, platform=poses)
        total, pose, count = total + sim.readings.wrench, pose + sim.readings.y, count + 1
    if sim.events:
        event = sim.events[0]
        raise ParameterError(f"pose {event.simulation + 1}: {event.reason}")
    return RunLog(
        t=np.arange(len(angles)) * np.float64(seconds),
        q_cmd=angles,
        v_cmd=zeros,
        q=sim.state.q,
        y=pose / count,
        w=total / count,
        meta={"format": "ves-run/1", "system": still.to_dict(), "note": "static poses"},
    )


def _per_run(values: Array, t: Array, n: int, what: str) -> Array:
    """(n, N, 6) values given at the instants t for all runs, or for each."""
    values = np.asarray(values, float)
    if values.shape not in ((len(t), 6), (n, len(t), 6)):
        raise ParameterError(
            f"{what} of shape ({len(t)}, 6) or ({n}, {len(t)}, 6), got {values.shape}"
        )
    return np.broadcast_to(values, (n, len(t), 6))


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


def _whole_multiple(period: float, dt: float, name: str, what: str) -> int:
    ratio = period / dt
    if not math.isfinite(ratio) or round(ratio) < 1 or abs(ratio - round(ratio)) > 1e-9 * ratio:
        raise ParameterError(
            f"{name} must be a whole number of {what} of {dt:g} s, got {period:g} s"
        )
    return round(ratio)


def base_wrench(
    system: System,
    y: Array,
    yd: Array,
    ydd: Array,
    hidden: Sequence[Array] | None = None,
    actuators: Sequence[Array] | None = None,
) -> Array:
    """Return the wrench of the arm on the base: what the vehicle's motion takes; also traced.

    Args:
        system: arm and vehicle.
        y, yd, ydd: (n, 6) motion of the base.
        hidden: `Simulator.internal_state`, where the vehicle carries something.
        actuators: torque of its wheels' motors and wrench of its jets, where it has them.

    Returns:
        (n, 6) in platform axes [N, N m].
    """
    base = system.actual.base
    # run by run: one matrix product over the batch would round by its size
    force = matvec(base.M, ydd) + matvec(base.D, yd) + matvec(base.K, y)  # conjugate to Y
    if base.drag is not None:
        force = force + base.drag * np.abs(yd) * yd
    if base.internal is not None:
        assert hidden is not None
        _, D, K = base.internal.matrices()
        for matrix, part, internal in ((K, y, hidden[0]), (D, yd, hidden[1])):
            stacked = np.concatenate([part, internal[:, -base.m :]], axis=-1)
            force = force + matvec(matrix[:6], stacked)
    turn = np.swapaxes(rate_matrix(y), -1, -2)
    wrench: Array = np.asanyarray(np.linalg.solve(turn, force[..., None])[..., 0])
    if base.body is not None:
        wrench = wrench + body_wrench(base.body.spatial(), y, yd, ydd)
    if actuators is not None:
        if base.carried and hidden is not None:
            first = len(system.actual.arm.geared) + system.arm.bends
            carried = slice(first, first + len(base.carried))
            at, rate = hidden[0][:, carried], hidden[1][:, carried]
            moving = twist(y, yd), twist_rate(y, yd, ydd)
            wrench = wrench + carried_wrench(base.carried, at, rate, *moving, actuators[0])
        wrench = wrench - actuators[1]
    return wrench
