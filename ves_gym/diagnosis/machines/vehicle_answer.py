"""How a vehicle in space answers the wrench that was measured on it.

A mode that rings makes much of the noise in a measured pose: 0.05 mm, twice differentiated,
drive 300 kg on a soft spring as hard as an arm does, and the mode keeps them for seconds. A
force sensor's noise moves no vehicle. So what an unknown mode does to its vehicle is taken from
the motion that both together would have under the wrench measured, not from the pose measured:
what is left then has the noise of the description alone, whatever the mode (the error of the
output, beside that of the equation: Ljung, System Identification, ch. 4; derived in
docs/diagnosis.md).
"""

from __future__ import annotations

import numpy as np
import scipy

from ves_gym._util.params import Array
from ves_gym.diagnosis.data.measured_run import Run
from ves_gym.diagnosis.machines.recursions import stepped
from ves_gym.diagnosis.machines.vehicle_force import along_rates, force_of_states
from ves_gym.mechanics.vehicle import BaseModel, InternalModes

_ORDER = 4  # coefficients of a cubic
_SURE = 1e-9  # of a coordinate's size: noise is no less


def answering_force(run: Run, base: BaseModel, new: InternalModes) -> Array:
    """Return the force of unknown modes on a vehicle that answers the wrench (..., T, 6).

    Args:
        run: with y and w.
        whole: the vehicle with them, last of its modes, and no body that turns. A drag that
            grows with the rate is left out of its answer.
        new: the modes.
    """
    _, force = along_rates(run)
    states = _answer(run, base, force)
    n, m = states.shape[-1] // 2, new.m
    yd, way = states[..., n : n + 6], states[..., n - m : n] - states[..., :6] @ new.coupling
    rate = states[..., 2 * n - m :] - yd @ new.coupling
    return force_of_states(new, np.concatenate([way, rate], axis=-1), yd)


def _answer(run: Run, base: BaseModel, force: Array) -> Array:
    """Return the states (..., T, 2 n) of M x'' + D x' + K x = force on the first six.

    The vehicle begins as is nearest to the pose measured, its modes at rest beside it.
    """
    M, D, K = base.full()
    coupling = np.zeros((6, 0)) if base.internal is None else base.internal.coupling
    n, size = len(M), run.length
    inverse = np.linalg.inv(M)
    # exact for the spline through the force: its derivatives are states that nothing drives
    flow = np.zeros((2 * n + 6 * _ORDER, 2 * n + 6 * _ORDER))
    flow[:n, n : 2 * n] = np.eye(n)
    flow[n : 2 * n, :n], flow[n : 2 * n, n : 2 * n] = -inverse @ K, -inverse @ D
    flow[n : 2 * n, 2 * n : 2 * n + 6] = inverse[:, :6]
    flow[2 * n : -6, 2 * n + 6 :] = np.eye(6 * (_ORDER - 1))
    step = scipy.linalg.expm(flow * run.dt)[: 2 * n]
    pushes = run.derived("wrench's spline", ("y", "w"), lambda: _spline(run, force))
    pushes = (pushes @ step[:, 2 * n :].T).reshape(-1, size, 2 * n)
    within = step[:, : 2 * n]
    forced = stepped(within, pushes, np.zeros((len(pushes), 2 * n)))
    # a base that moves carries its modes with it: u = P^T Y
    carried = np.zeros((2, 6, 2, n))
    carried[0, :, 0] = carried[1, :, 1] = np.hstack([np.eye(6), coupling])
    free = stepped(within, np.zeros((12, size, 2 * n)), carried.reshape(12, 2 * n))
    y = run["y"].reshape(-1, size, 6)
    weight = 1 / np.maximum(run.noise["y"].std, _SURE * np.abs(y).max(axis=(0, 1)) + 1e-12)
    modes = (free[..., :6] * weight).reshape(12, -1)
    gap = ((y - forced[..., :6]) * weight).reshape(len(y), -1)
    unit = np.linalg.norm(modes, axis=1)
    modes = modes / unit[:, None]
    begun = np.linalg.solve(modes @ modes.T, modes @ gap.T).T / unit
    out = forced + np.einsum("ci,itj->ctj", begun, free)
    return np.asarray(out).reshape(*force.shape[:-1], 2 * n)


def _spline(run: Run, force: Array) -> Array:
    """Return a force and the derivatives of the cubic spline through it (..., T, 6 _ORDER)."""
    t = run.dt * np.arange(run.length)
    spline = scipy.interpolate.CubicSpline(t, force, axis=-2)
    return np.concatenate([spline(t, k) for k in range(_ORDER)], axis=-1)
