"""The admittance's own step run on the signals that it was given, and its inverse.

Where the loop does not compensate the arm's inertia, each period is one step of the vehicle
(`admittance_matrices`, `integrate`): three poses in a row and the wrenches read between them
leave nothing unknown. Where it does, see `compensated`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ves_gym._util.params import Array, Index
from ves_gym.diagnosis.data.measured_run import Run
from ves_gym.diagnosis.machines.compensated import compensated_gap, reference
from ves_gym.diagnosis.machines.controller_signals import (
    ControllerSignals,
    extended,
    on_log_clock,
    taken_in,
)
from ves_gym.diagnosis.machines.recursions import stepped
from ves_gym.hardware.admittance import admittance_matrices, integrate, rigid_bodies
from ves_gym.mechanics.spatial import matvec, rate_matrix
from ves_gym.mechanics.vehicle import BaseModel
from ves_gym.system.system import System

_ROUNDS = 8  # of a fixed point: each gains three digits or more


def force_gap(run: Run, systems: Sequence[System], described: System) -> Array:
    """Return the force taken in less what moves the vehicle as commanded, along its rates.

    Args:
        run: with w, weight, y_cmd; for a compensated loop q and the joint servo's gains.
        systems: m of them, which differ in effects.
        described: the system without candidates.

    Returns:
        (m, ..., T, 6) [N, N m].
    """
    taken = taken_in(run, described)
    if described.emulator_settings.payload_compensation:
        gap = compensated_gap(run, taken, systems, described)
    else:
        gap = np.stack([_plain_gap(taken, s) for s in systems])
    gap = on_log_clock(gap, run, described)
    return gap.reshape(len(systems), *run["y_cmd"].shape)


def sent_rates(run: Run, described: System) -> Array:
    """Return the rate (..., T, 6) that a compensating controller sent with each pose.

    Args:
        run: as `force_gap` takes it.
        described: the system.
    """
    taken = taken_in(run, described)
    sent = reference(run, taken, described).sent[:, :, 6:]
    late = described.emulator_settings.delay + 1
    out = np.concatenate([np.repeat(taken.rate[:1, None], late, 1), sent[:, :-late]], axis=1)
    rates = on_log_clock(out[:, : taken.pose.shape[1]], run, described)
    return np.asarray(np.broadcast_to(rates[0], run["y_cmd"].shape))


def _plain_gap(taken: ControllerSignals, system: System) -> Array:
    """(k, N, 6) of a loop without payload compensation."""
    late = system.emulator_settings.delay
    y = taken.pose[:, late:]  # the vehicle's own state, sent `late` periods later
    force = matvec(np.swapaxes(rate_matrix(y), -1, -2), taken.force[:, : y.shape[1]])
    base = system.actual.base
    gap = _body_gap if base.body is not None else _linear_gap
    return extended(gap(base, y, force, system), taken.pose.shape[1])


def _linear_gap(base: BaseModel, y: Array, force: Array, system: System) -> Array:
    """Of M, D, K with drag and oscillators: by the sampled vehicle's own matrices."""
    phi, gamma = admittance_matrices(
        base, system.control_dt, system.emulator_settings.admittance_form
    )
    half = len(phi) // 2
    pose, rate = np.arange(6), np.arange(half, half + 6)
    inner = np.setdiff1d(np.arange(2 * half), np.r_[pose, rate])  # oscillators

    def block(rows: Index, columns: Index) -> Array:
        return phi[np.ix_(rows, columns)]

    back = np.linalg.inv(block(pose, rate))  # rate that leads from pose to pose
    free = y[:, 1:] - y[:, :-1] @ block(pose, pose).T
    z = np.zeros((*free.shape[:2], len(inner)))
    applied, v = force[:, :-1], np.zeros_like(free)
    start = np.concatenate([base.attached(y[:, 0]), np.zeros((len(y), base.m))], 1)
    for _ in range(_ROUNDS if base.drag is not None else 1):
        if base.drag is not None:
            applied = force[:, :-1] - base.drag * np.abs(v) * v
        moved = free - applied @ gamma[:6].T
        if len(inner):
            onto = block(inner, rate) @ back
            A = block(inner, inner) - onto @ block(pose, inner)
            push = y[:, :-1] @ block(inner, pose).T + applied @ gamma[inner].T + moved @ onto.T
            z = stepped(A, push, start)
        v = (moved - z @ block(pose, inner).T) @ back.T
    end_rate = y[:, :-1] @ block(rate, pose).T + z @ block(rate, inner).T
    end_rate += v @ block(rate, rate).T + applied @ gamma[rate].T
    foreseen = y[:, 1:-1] @ block(pose, pose).T + end_rate[:, :-1] @ block(pose, rate).T
    foreseen += z[:, 1:] @ block(pose, inner).T + applied[:, 1:] @ gamma[:6].T
    across = block(pose, rate)
    share = gamma[:6] + across @ (gamma[rate] - block(rate, rate) @ back @ gamma[:6])
    return np.asarray(-(y[:, 2:] - foreseen) @ np.linalg.inv(share).T)


def _body_gap(base: BaseModel, y: Array, force: Array, system: System) -> Array:
    """Of a satellite: by the loop's own integration."""
    assert base.body is not None
    g = rigid_bodies(base.body.spatial(), base.M, base.D, base.K)
    dt = system.control_dt
    v = (y[:, 1:] - y[:, :-1]) / dt
    for _ in range(_ROUNDS):
        end = integrate(g, np.concatenate([y[:, :-1], v], axis=-1), force[:, :-1], dt)
        v = v + (y[:, 1:] - end[..., :6]) / dt
    begin = np.concatenate([y[:, 1:-1], end[:, :-1, 6:]], axis=-1)
    foreseen = integrate(g, begin, force[:, 1:-1], dt)[..., :6]
    turn = rate_matrix(y[:, 1:-1])
    mass = np.swapaxes(turn, -1, -2) @ base.body.spatial() @ turn + base.M
    return -matvec(mass, y[:, 2:] - foreseen) / dt**2
