"""The joint servo's port: a controller that is known, run on what it was given."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy

from ves_gym._util.params import Array
from ves_gym._util.signals import differentiated, noise_power
from ves_gym.diagnosis.data.measured_run import Run
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.dynamics import inverse_dynamics
from ves_gym.system.system import System


def servo_gap(
    run: Run, system: System, arm: Arm, off: Sequence[Sequence[float]], swing: Array
) -> Array:
    """Return the motor torque less what the controller asks for.

    Args:
        run: with q_cmd, v_cmd, q, tau, the controller's gains and, if logged, its tau_ff.
        system: whose delays and lags of signals count.
        arm: as described, for the feed-forward.
        off: errors of kp and kd, relative, (n,) each; none: the gains are as stated.
        swing: (T, n) rates that the angles do not show [rad/s].

    Returns:
        (..., T, n) [N m].
    """
    gains = run.meta["controller"]
    kp, kd = (
        np.asarray(gains[name], float) * (1 + np.asarray(error))
        for name, error in zip(("kp", "kd"), off or (0.0, 0.0), strict=True)
    )
    delays = system.delays()
    ahead = -float(delays.command[0])
    command = differentiated(run["q_cmd"], run.dt, run.band, ahead=ahead)
    q, v, _ = run.angles
    v = low_passed(v + swing, delays.lag[0], run.dt)
    demand = (command[0] - q) * kp + (command[1] - v) * kd
    if "tau_ff" in run:
        demand = demand + differentiated(run["tau_ff"], run.dt, run.band, ahead=ahead)[0]
    elif gains.get("feedforward", False):
        demand = demand + inverse_dynamics(arm, *command)[0]
    most = arm.column("tau_max")
    return np.asarray(run["tau"] - np.clip(demand, -most, most))


def commanded_torque_weight(run: Run) -> Array:
    """Return the share that what was asked has in the best estimate of a motor torque (n,).

    Both are the torque with noise of their own: the log's sensor, and the gains times the noise
    of angles and of their differences, as `servo_gap` has them. Mixed by their variances they
    tell it best, and the mixture and the difference of the two are no longer correlated.

    Args:
        run: with the controller's gains.
    """
    gains = run.meta["controller"]
    kp, kd = (np.asarray(gains[name], float) for name in ("kp", "kd"))
    f = np.asarray(np.fft.rfftfreq(run.length, run.dt), float)
    inside, w = f <= run.band, 2 * np.pi * f[:, None]
    of_angles = noise_power(run.noise["q"], f, run.dt)
    of_commands = ((kp**2 + kd**2 * w**2) * of_angles)[inside].mean(axis=0)
    logged = noise_power(run.noise["tau"], f, run.dt)[inside].mean(axis=0)
    total = of_commands + logged
    return np.asarray(np.where(total > 0, logged / np.where(total > 0, total, 1.0), 0.0))


def low_passed(rate: Array, lag: Array, dt: float, begins: Array | None = None) -> Array:
    """Return rates through a first-order low-pass each, straight from sample to sample.

    Args:
        rate: (..., T, n) [rad/s].
        lag: (n,) time constants [s]; 0: none.
        dt: s between samples.
        begins: (..., n) what comes out at the first sample; None: the first rate, held before.

    Returns:
        (..., T, n).
    """
    out = rate.copy()
    for i in np.flatnonzero(lag):
        low = ([1.0], [float(lag[i]), 1.0])
        b, a, _ = scipy.signal.cont2discrete(low, dt, method="foh")
        b, first = np.ravel(b), rate[..., :1, i]
        start = (first if begins is None else begins[..., None, i]) - b[0] * first
        out[..., i] = scipy.signal.lfilter(b, a, rate[..., i], axis=-1, zi=start)[0]
    return out
