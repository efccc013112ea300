"""The balance of torques at driven joints, told in the torque that the log holds."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ves_gym._util.params import Array
from ves_gym._util.signals import noise_power
from ves_gym.diagnosis.data.measured_run import Run, cached
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.dynamics import inertia
from ves_gym.mechanics.link import Gear
from ves_gym.system.effect import Effect, TorqueEffect, joint_torque

_PUSH = 1e-6  # relative, of a difference
_TRIED = 4  # random states in which a law is asked about the torque
_NO_LIMIT = 1e9  # N m
_POSES = 20  # of a run, for its mean inertia
_LEAST = 0.3  # of an error in the torque that a balance shows, where a gear and its link ring


@lru_cache(maxsize=1024)
def scales(effect: Effect) -> bool:
    """Return True for a law that changes with the torque, short of a limit of it."""
    if not isinstance(effect, TorqueEffect):
        return False
    widths = [np.size(x) for x in vars(effect).values() if np.size(x) > 1]
    q, v, tau = np.random.default_rng(0).normal(size=(3, _TRIED, min(widths, default=1)))
    most = np.full(q.shape[-1], _NO_LIMIT)
    weak, strong = (joint_torque([effect], q, v, k * tau, most) for k in (1.0, 2.0))
    return bool((weak != strong).any())


def torque_residual(
    tau: Array, needed: Array, effects: Iterable[Effect], laws: Callable[[Array], Array]
) -> Array:
    """Return the torque logged less the torque that should have been (..., T, n).

    Not what acts less what is needed: a drive that gives less would seem to explain any
    residual by making all of it smaller.

    Args:
        tau: (..., T, n) logged [N m].
        needed: (..., T, n) that the motion takes, by the motors and by `laws`.
        effects: those in `laws`.
        laws: torque logged -> torque that the effects add to it.
    """
    added = laws(tau)
    balance = tau + added - needed
    if not any(map(scales, effects)):
        return balance
    push = _PUSH * np.maximum(np.abs(tau), 1.0)
    return np.asarray(balance / (1 + (laws(tau + push) - added) / push))


@dataclass(frozen=True)
class Winding:
    """A gear that its torque winds up while its link lags: what of it a motion shows."""

    joint: int
    visible: Array  # (K,) complex, 1 - H: of an error in the torque, what a balance shows
    moved: Array  # (K,) power of the noise that the link's motion has in a balance [(N m)^2]
    turned: Array  # (K,) that the rotor's has in the torque through the gear
    both: Array  # (K,) of their product


def windings(arm: Arm, run: Run) -> list[Winding]:
    """Return the gears without play of an arm on a run, at the frequencies of twice its length.

    The torque logged winds a gear of stiffness k and damping d up, and the link that lags takes
    less by its inertia M: of an error e in it the balance of torques shows (1 - H) e, with
    H = M w^2 / (k + i w d) (mean inertia of the run, other joints and the base held).
    """
    geared = [
        (j, link.gear, link.rotor_inertia)
        for j, link in enumerate(arm.links)
        if link.gear is not None and not link.gear.gap
    ]
    return (
        cached(run.memory, "gears", arm, lambda: _windings(arm, run, geared)) if geared else []
    )


def _windings(arm: Arm, run: Run, geared: Sequence[tuple[int, Gear, float]]) -> list[Winding]:
    angles = run["q"].reshape(-1, *run["q"].shape[-2:])[0, :: max(run.length // _POSES, 1)]
    inertias = inertia(arm, angles).mean(axis=0)
    f, of_angles = run.padded_frequencies, run.noise_of_angles
    w = 2 * np.pi * f
    of_pose = noise_power(run.noise["y"], f, run.dt) if "y" in run.noise else np.zeros((1, 6))
    out = []
    for j, gear, rotor in geared:
        moved = inertias[6 + j, 6 + j] - rotor
        visible = 1 - moved * w**2 / (gear.stiffness + 1j * w * gear.damping)
        of_angle, of_base = w**4 * of_angles[:, j], w**4 * (of_pose @ inertias[:6, 6 + j] ** 2)
        out.append(
            Winding(
                j,
                visible,
                moved**2 * of_angle + of_base,
                rotor**2 * of_angle,
                rotor * moved * of_angle,
            )
        )
    return out


def winding_noise(run: Run, rotors: Array, top: float) -> Array:
    """Return the standard deviations of noise in torques through gears, up to `top` (n,) [N m].

    They are the torques logged, less what rotors take: inertia times acceleration.

    Args:
        run: measured, torques too.
        rotors: (n,) inertias [kg m^2].
        top: [Hz].
    """
    f = run.padded_frequencies
    taken = rotors**2 * (2 * np.pi * f[:, None]) ** 4 * run.noise_of_angles
    power = noise_power(run.noise["tau"], f, run.dt) + taken
    return np.asarray(np.sqrt((power * (f <= top)[:, None]).mean(axis=0)))


def filtered(x: Array, transfer: Array) -> Array:
    """Return a signal (..., T) through a filter, zeros behind it.

    Args:
        x: (..., T).
        transfer: (K,) complex, at the frequencies of twice its length.
    """
    length = x.shape[-1]
    spectrum = np.fft.rfft(x, 2 * length, axis=-1) * transfer
    return np.asarray(np.fft.irfft(spectrum, 2 * length, axis=-1)[..., :length])


def in_torque_logged(balance: Array, gears: Sequence[Winding]) -> Array:
    """Return a balance of torques at joints as an error of the torque logged (..., T, n).

    Left as a balance, a soft gear would seem to explain whatever is left in the torque where
    1 - H is small, and would be unlikely for passing its noise on where that is large. Where a
    gear and its link ring the motion tells the torque badly: there no more than `_LEAST` is
    divided by.

    Args:
        balance: (..., T, n) torque logged less the torque that should have been [N m].
        gears: of the arm on the run.
    """
    out = balance.copy() if gears else balance
    for g in gears:
        out[..., g.joint] = filtered(
            balance[..., g.joint], 1 / np.maximum(np.abs(g.visible), _LEAST)
        )
    return out


def through_gears(
    torque: Array, balance: Array, gears: Sequence[Winding], run: Run, noisy: Array
) -> Array:
    """Return the torque that winds gears up, by torques logged and motion together (..., T, n).

    What is left in a torque logged, its noise or a friction nobody described, is not what the
    link feels. The balance shows it, with the noise of the motion: its best linear estimate by
    frequency (Wiener) is taken off.

    Args:
        torque: (..., T, n) logged, less what rotors take [N m].
        balance: (..., T, n) torque logged less the torque that should have been, links having
            lagged as the torque logged has them.
        gears: of the arm on the run.
        run: for the noise of its torques.
        noisy: (n,) share of it, as power, that the torques told have.
    """
    out = torque.copy()
    f = run.padded_frequencies
    of_torque = noise_power(run.noise["tau"], f, run.dt)
    for g in gears:
        noise_part = noisy[g.joint] * of_torque[:, g.joint] + g.turned
        total = np.abs(g.visible) ** 2 * noise_part + g.moved + 2 * g.visible.real * g.both
        share = (np.conj(g.visible) * noise_part + g.both) / np.where(total > 0, total, 1.0)
        out[..., g.joint] -= filtered(balance[..., g.joint], share)
    return out
