"""A loop that compensates the arm's inertia, run backwards: from commands to wrenches.

The controller moves vehicle and servo-held joints as one system, H of the arm and all, by the
trapezoidal rule; it adds to each reading what the arm's inertia must have done to it, and sends
the state ahead by the loop's lag (`simulation.blocks`). Here the same steps are solved
for the wrench under which they end at the command that the log holds (docs/diagnosis.md).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import scipy

from ves_gym._util.params import Array
from ves_gym.diagnosis.data.measured_run import NEAR, Run
from ves_gym.diagnosis.machines.controller_signals import ControllerSignals, extended
from ves_gym.diagnosis.machines.platform_response import Platforms, loop_shape
from ves_gym.diagnosis.machines.recursions import wrenches
from ves_gym.engine.batch_parameters import Bodies
from ves_gym.hardware.admittance import implicit_step
from ves_gym.hardware.platform import PoseServo
from ves_gym.mechanics.dynamics import inertia
from ves_gym.mechanics.spatial import matvec, rate_matrix
from ves_gym.simulation.blocks.admittance import CoupledAdmittance
from ves_gym.simulation.blocks.sensing import PayloadCompensation
from ves_gym.system.deviations import LoopParameters
from ves_gym.system.system import System

_PASSES = 30  # at most, until a trajectory is its own linearisation
_STIFF = 4.0  # of w^2 dt lag: from there on a command says nothing about its own wrench


@dataclass(frozen=True)
class Trajectory:
    """The controller's own state at N instants, and what it sent; rows first."""

    state: Array  # (r, N, 2 s) vehicle, joints, oscillators, then their rates
    sent: Array  # (r, N, 12) pose and rate that went into the queue
    needed: Array  # (r, N, 6) generalised force that the motion takes
    payload: Array  # (r, N, 6) predicted reading of the arm's inertia, platform frame [N, N m]


@dataclass(frozen=True)
class _Ways:
    """Forces that a command tells, and those of modes too stiff for it."""

    soft: Array  # (6, n) forces to be found
    output: Array  # (n, 6) what they move
    stiff: Array  # (6, 6) part of a force that is taken as it was read
    steady: Array  # (6, 6) force per pose that is missed there
    back: Array  # (12, 6) correction of pose and rate per pose that is missed there

    @staticmethod
    def of(mass: Array, stiffness: Array, dt: float, lag: float) -> _Ways:
        """Return those of a vehicle with its arm.

        The trapezoidal rule turns the state (w y, y') of a mode by 2 atan(w t / 2) in a step
        t. Where period and lag together turn it by more than half a turn, wrenches found from
        commands would grow without end. Such a mode runs under the wrench that was read, and
        what it misses corrects its state (an observer without memory after two periods).

        Args:
            mass, stiffness: (6, 6).
            dt, lag: s.
        """
        squared, shape = scipy.linalg.eigh(stiffness, mass)
        push, soft = mass @ shape, squared * dt * lag < _STIFF
        steady, back = np.zeros((6, 6)), np.zeros((12, 6))
        for k in np.flatnonzero(~soft):
            w = float(np.sqrt(squared[k]))
            once, extra = (2 * np.arctan(w * t / 2) for t in (dt, lag))
            step = np.array([[np.cos(once), np.sin(once)], [-np.sin(once), np.cos(once)]])
            output = np.array([np.cos(once + extra), np.sin(once + extra)])
            ends = np.linalg.inv(np.stack([output, output @ step]))
            gain = step @ step @ ends[:, 1]  # Ackermann: both poles at 0
            direct, eye = 1 - output[0], np.eye(2)
            push_once = eye[0] - step[:, 0] - gain * direct
            settled = np.linalg.solve(eye - step + np.outer(gain, output), push_once)
            reply = output @ settled + direct  # miss per steady displacement
            steady += squared[k] / reply * np.outer(push[:, k], push[:, k])
            back += np.outer(
                np.r_[shape[:, k] * gain[0], shape[:, k] * gain[1] * w], push[:, k]
            )
        hard = push[:, ~soft] @ shape[:, ~soft].T
        return _Ways(push[:, soft], push[:, soft].T, hard, steady, back)


def compensated_gap(
    run: Run, taken: ControllerSignals, systems: Sequence[System], described: System
) -> Array:
    """Return the force taken in less what moves vehicle and arm together, along the rates.

    Args:
        run: measured signals.
        taken: what the controller took in, k copies.
        systems: m of them, which differ in effects.
        described: the system without candidates.

    Returns:
        (m, k, N, 6) [N, N m].
    """
    stated = reference(run, taken, described)
    paths = []
    for system in systems:
        is_nominal = system is described and len(taken.pose) == 1
        path = stated if is_nominal else _inverse(run, taken, system, described, stated)
        paths.append(path)
    late, gaps = described.emulator_settings.delay, []
    for path in _loaded(run, taken, paths, systems, described):
        turned = np.swapaxes(rate_matrix(path.state[..., :6]), -1, -2)
        gap = matvec(turned, taken.force + path.payload) - path.needed
        gaps.append(extended(gap[:, : gap.shape[1] - 1 - late], gap.shape[1]))
    return np.stack(gaps)


def reference(run: Run, taken: ControllerSignals, described: System) -> Trajectory:
    """Return the trajectory of the description (one row), linearised about itself.

    Args:
        run: measured signals.
        taken: what the controller took in.
        described: the system.
    """
    memory = _memory(run)
    if "controller" not in memory:
        first = ControllerSignals(taken.force[:1], taken.pose[:1], taken.rate[:1], taken.q)
        y = first.pose
        size = 6 + _moving(described) + described.actual.base.m
        state = np.zeros((1, y.shape[1], 2 * size))
        state[..., :6] = y
        state[..., size : size + 6] = np.gradient(y, described.control_dt, axis=1)
        path = Trajectory(state, np.empty(0), np.empty(0), np.zeros_like(y))
        for _ in range(_PASSES):
            before = path
            path = _inverse(run, first, described, described, before)
            path = _loaded(run, first, [path], [described], described)[0]
            moved = np.abs(path.state - before.state)[..., :6].max()
            # m, rad; N, N m: it is its own linearisation
            if moved < 1e-12 and np.abs(path.payload - before.payload).max() < 1e-9:
                break
        memory["controller"] = path
    return memory["controller"]


def _memory(run: Run) -> dict[Any, Any]:
    """Return the memory of a run, or, for noisy copies, of the run itself."""
    near: dict[Any, Any] = run.memory.get(NEAR, {})
    return near if "controller" in near else run.memory


def _moving(system: System) -> int:
    """Joints that give way in the compensation's model."""
    return system.arm.n if system.drive == "motor" else 0


def _signals(
    run: Run, taken: ControllerSignals, system: System, described: System
) -> dict[str, Array]:
    """Inertia (N, 6 + n, 6 + n) of the arm and gains (1, m) that the compensation knows."""
    memory = _memory(run)
    if "inertia" not in memory:
        memory["inertia"] = inertia(described.arm, taken.q)
    H = (1 + system.loop_parameters.payload_scale[0]) * memory["inertia"]
    gains = run.meta["controller"] if _moving(described) else {"kp": (), "kd": ()}
    return {"inertia": H, **{k: np.array([gains[k]], float) for k in ("kp", "kd")}}


def _inverse(
    run: Run, taken: ControllerSignals, system: System, described: System, near: Trajectory
) -> Trajectory:
    """Wrenches that make the commands of the log, linearised about a trajectory near it."""
    m, dt = _moving(system), system.control_dt
    base, lag = system.actual.base, system.emulator_settings.lag(dt)
    k = m + base.m
    size = 6 + k
    block = CoupledAdmittance(loop_shape(system), base.m, m, lag, base.body is not None, None)
    at, rates = np.split(near.state[0], 2, axis=-1)
    X = np.concatenate([at[:, :6], rates[:, :6]], axis=-1)
    N, none = len(X), np.zeros((len(X), 6))
    numbers = block.parameters(
        system.loop_parameters, Bodies.of(system, False, False, np.empty(0))
    )
    signals = _signals(run, taken, system, described)
    coupled = np.zeros((N, 2 * k))
    M, D, K, _, offset = block.coupled_system(numbers, X, coupled, none, signals)
    begin = np.zeros((len(taken.pose), 2 * size))
    begin[:, :6], begin[:, size : size + 6] = taken.pose[:, 0], taken.rate
    begin[:, 6 + m : size] = base.attached(taken.pose[:, 0])
    begin[:, size + 6 + m :] = base.attached(taken.rate)
    free, first = np.zeros((len(begin), size)), np.zeros(len(begin), int)
    begin = implicit_step(M[first], D[first], K[first], begin, free, -lag)
    late = system.emulator_settings.delay + 1
    target = extended(taken.pose[:, late:], N)
    memory = _memory(run)
    if "ways" not in memory:
        mass, stiffness = (part[:, :6, :6].mean(axis=0) for part in (M, K))
        memory["ways"] = _Ways.of(mass, stiffness, dt, lag)
    ways: _Ways = memory["ways"]
    turned = np.swapaxes(rate_matrix(X[:, :6]), -1, -2)
    read = matvec(ways.stiff @ turned, taken.force + near.payload)
    state, sent, amounts, missed = wrenches(
        M, D, K, offset, read, ways.soft, ways.output, ways.back, target, begin, dt, lag
    )
    needed = read + amounts @ ways.soft.T + missed @ ways.steady.T
    return Trajectory(state, sent, needed, near.payload)


def _ride(
    run: Run, described: System, start: Array, commands: Array
) -> Callable[[int], dict[str, Array]]:
    """Path of r platforms as described in each period, periods in order.

    Args:
        run: measured signals.
        described: the system.
        start: (r, 12) pose and rate.
        commands: (r, N, 12).
    """
    settings, rows = described.emulator_settings, len(commands)
    stated = LoopParameters.nominal(described.arm, settings, rows)
    if isinstance(settings.platform, PoseServo):
        platforms = Platforms(described, stated, start[:, :6], start[:, 6:])
        return lambda k: platforms.advance(commands[:, k])
    memory = _memory(run)
    if "legs" not in memory:  # legs are sent lengths only: one path serves all
        nominal = LoopParameters.nominal(described.arm, settings, 1)
        legs = Platforms(described, nominal, start[:1, :6], start[:1, 6:])
        memory["legs"] = [legs.advance(part[None]) for part in commands[0]]
    paths: list[dict[str, Array]] = memory["legs"]
    return lambda k: {
        name: np.broadcast_to(paths[k][name], (rows, *paths[k][name].shape[1:]))
        for name in ("y", "yd", "ydd")
    }


def _predicted(
    block: PayloadCompensation, H: Array, gains: dict[str, Array], path: dict[str, Array]
) -> Array:
    """Return the readings (r, P, 6) that the compensation predicts of P periods.

    Its step is affine in its memory: of all periods at once it is asked for the constant, and
    for each entry of the joints' state alone; what goes from period to period is products.

    Args:
        block: the compensation.
        H: (m, P, 6 + n, 6 + n) inertias that it goes by, of m systems.
        gains: (1, n) of the joints' servos.
        path: (r, P, nodes, 6) of r platforms, system by system.
    """
    single: Any = SimpleNamespace(mass=np.ones(1))  # the block counts arms
    numbers, entries = block.parameters(single, single), 2 * block.joints
    (m, P), rows = H.shape[:2], len(path["y"])

    def step(arm: Array, H: Array, path: dict[str, Array]) -> tuple[Array, Array]:
        x = {"arm": arm, "filter": np.zeros((len(arm), 6, 2))}
        u = {"kp": gains["kp"], "kd": gains["kd"], "inertia": H, **path}
        after, _ = block.step(numbers, x, u)
        return after["arm"], after["filter"]

    every = np.repeat(H, rows // m, axis=0).reshape(rows * P, *H.shape[2:])
    at_rest = np.zeros((rows * P, entries))
    flat = {k: x.reshape(rows * P, *x.shape[2:]) for k, x in path.items()}
    pushed, read = step(at_rest, every, flat)
    units = np.tile(np.eye(entries), (m * P, 1))
    still = {k: np.zeros((len(units), *x.shape[2:])) for k, x in path.items()}
    repeated = np.repeat(H.reshape(m * P, *H.shape[2:]), entries, axis=0)
    turned, response = step(units, repeated, still)
    turned = turned.reshape(m, P, entries, entries).swapaxes(-1, -2)
    response = np.moveaxis(response.reshape(m, P, entries, 12), 2, -1)  # (m, P, 12, entries)
    pushed, read = pushed.reshape(rows, P, entries), read.reshape(rows, P, 6, 2)
    of, hold = np.repeat(np.arange(m), rows // m), np.swapaxes(numbers["hold"], -1, -2)
    arm, filtered = np.zeros((rows, entries)), np.zeros((rows, 6, 2))
    out = np.empty((rows, P, 6))
    for k in range(P):
        seen = matvec(response[of, k], arm).reshape(rows, 6, 2)
        filtered = filtered @ hold + seen + read[:, k]
        arm = matvec(turned[of, k], arm) + pushed[:, k]
        out[:, k] = filtered[..., 0]
    return out


def _loaded(
    run: Run,
    taken: ControllerSignals,
    paths: Sequence[Trajectory],
    systems: Sequence[System],
    described: System,
) -> list[Trajectory]:
    """Trajectories of m systems with the reading that each predicts of the arm's inertia."""
    m, sent = len(paths), np.stack([path.sent for path in paths])
    copies, N = sent.shape[1:3]
    settings, shape = described.emulator_settings, loop_shape(described)
    start = np.tile(np.concatenate([taken.pose[:, 0], taken.rate], axis=-1), (m, 1))
    waiting = np.repeat(start[:, None], settings.delay, axis=1)
    commands = np.concatenate([waiting, sent.reshape(m * copies, N, 12)], axis=1)
    ride = _ride(run, described, start, commands)
    rides = [ride(k) for k in range(N - 1)]
    path = {k: np.stack([x[k] for x in rides], axis=1) for k in ("y", "yd", "ydd")}
    signals = [_signals(run, taken, system, described) for system in systems]
    H = np.stack([k["inertia"][: N - 1] for k in signals])
    block = PayloadCompensation(shape, _moving(described), settings.sensor.cutoff, False)
    payload = np.zeros((m * copies, N, 6))
    payload[:, 1:] = _predicted(block, H, signals[0], path)
    parts = np.split(payload, m)
    return [replace(path, payload=part) for path, part in zip(paths, parts, strict=True)]
