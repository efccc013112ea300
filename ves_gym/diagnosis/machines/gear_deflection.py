"""How gears give under the torque through them: springs, and play between teeth.

Derived in docs/diagnosis.md, What a gear does at a port.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ves_gym._util.params import Array
from ves_gym._util.signals import differentiated, noise_power
from ves_gym.diagnosis.data.measured_run import Run, cached
from ves_gym.diagnosis.machines.arm_load import bodies_of
from ves_gym.diagnosis.machines.recursions import crossing, deflection
from ves_gym.diagnosis.machines.torque_balance import filtered, winding_noise
from ves_gym.effects.joint_drive import HARD
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.dynamics import inertia

_TURNS_OVER = 0.4  # of the band: what of a torque decides on which side teeth lie
_NO_TURN = 3.0  # standard deviations of noise about which a torque moves no teeth
_TELLS = 10.0  # the same from which a torque logged tells what a link takes
_CROSSES = 0.6  # of the band: what of the motion leads a link across its gap
_CREEPS = 20.0  # N m s/rad with which noise allows to tell when a narrow gap is crossed at once
_OFF = 0.5  # of the gap found, by which an angle in flight is off
_CLEARLY = 5.0  # times its noise, as power, from which a balance shows a flight
_WIDE, _NARROW = 3.0, 1e-3  # standard deviations of an angle; weight that is not worth a flight


def deflections(
    arm: Arm, torque: Array, taken: Array, run: Run, hardening: Sequence[int] = ()
) -> Array:
    """Return the angle by which gears give (..., T, n) [rad].

    Args:
        arm: with gears.
        torque: (..., T, n) through them.
        taken: (..., T, n) that links would take if they followed their motors.
        run: measured.
        hardening: joints whose springs harden.
    """
    out = np.zeros_like(torque)
    for i, link in enumerate(arm.links):
        gear = link.gear
        if gear is None:
            continue
        if gear.gap:
            out[..., i] = _between_teeth(arm, i, torque[..., i], taken[..., i], run)
        else:
            hard = HARD if i in hardening else np.inf
            out[..., i] = deflection(
                torque[..., i], 1 / gear.compliance, gear.damping, 0.0, run.dt, hard
            )
    return out


def _between_teeth(arm: Arm, i: int, torque: Array, taken: Array, run: Run) -> Array:
    """Angle by which a rotor leads its link through play (..., T).

    What the motion takes is known worse than the torque logged, whose sign tells on which side
    teeth lie. A gap that is wide beside the noise of the angles takes a link time to cross, in
    which the torque is zero and tells nothing; one that is not is crossed at once, by a torque
    without what noise may be: noise that turned it over would be all that is seen of it.
    """
    gear = arm.links[i].gear
    assert gear is not None
    stiffness, half = 1 / gear.compliance, gear.gap / 2
    top = _TURNS_OVER * run.band
    slow = _low(torque, run, top)
    noise = 0.0
    if "tau" in run:
        rotors = arm.column("rotor_inertia")
        key = tuple(rotors.tolist()), top
        noises = cached(run.memory, "windings", key, lambda: winding_noise(run, rotors, top))
        noise = max(float(noises[i]), 1e-12)
    sure = _beyond(slow, _NO_TURN * noise)
    thick = max(gear.damping, _CREEPS)
    at_once = deflection(sure * slow, stiffness, thick, half, run.dt)
    weight = _flight(gear.gap, i, run)
    if weight < _NARROW:
        return at_once
    slow_share = _beyond(slow, _TELLS * noise)
    load = slow_share * slow + (1 - slow_share) * _low(taken, run, _CROSSES * run.band)
    heavy = _inertias(arm, run)[:, 6 + i, 6 + i] - arm.links[i].rotor_inertia
    flown = crossing(load, heavy, gear.damping, half, run.dt) + sure * slow / stiffness
    return np.asarray((1 - weight) * at_once + weight * flown)


def backlash_reaction(
    arm: Arm, torque_gap: Array, run: Run, noisy: Array
) -> tuple[Array, Array]:
    """Return what links in flight do elsewhere, beside what is foretold of them.

    When teeth part and meet is foretold roughly, and the balance of torques at the joint shows
    what a link does instead, where that is clearly more than noise: angles are off by a part
    of the gap. (Weighed as Wiener's filter does, one joint's balance took the noise of pose and
    motion out of the others', and was likelier for being quieter.)

    Args:
        arm: with gears.
        left: (..., T, n) torque that acts less the torque that should have been [N m].
        run: measured.
        noisy: (n,) share of the noise of torques, as power, that the torques told have.

    Returns:
        Torques at other joints (..., T, n), and wrench of the arm on its base (..., T, 6).
    """
    torques, wrench = np.zeros_like(torque_gap), np.zeros((*torque_gap.shape[:-1], 6))
    f, of_angles = run.padded_frequencies, run.noise_of_angles
    w4 = (2 * np.pi * f) ** 4
    of_torque = noise_power(run.noise["tau"], f, run.dt)
    of_pose = noise_power(run.noise["y"], f, run.dt) if "y" in run.noise else np.zeros((1, 6))
    inertias = _inertias(arm, run)
    mean = inertias.mean(axis=0)
    for j, off in enumerate(_errors_of_flights(arm, run)):
        if not off:
            continue
        rotor, of_base = arm.links[j].rotor_inertia, mean[:6, 6 + j] ** 2
        of_motion = mean[6 + j, 6 + j] ** 2 * of_angles[:, j] + of_pose @ of_base
        noise = noisy[j] * of_torque[:, j] + w4 * of_motion
        even = off**2 * f[-1] / run.band * (f <= run.band)  # as far as the band
        information = (mean[6 + j, 6 + j] - rotor) ** 2 * w4 * even
        share = 1 / (1 + (_CLEARLY * noise / np.maximum(information, 1e-30)) ** 2)
        column = inertias[:, :, 6 + j]
        sooner = filtered(torque_gap[..., j], share) / (column[:, 6 + j] - rotor)  # rad/s^2
        reaction = sooner[..., None] * column
        reaction[..., 6 + j] = 0.0
        torques += reaction[..., 6:]
        wrench -= reaction[..., :6]
    return torques, wrench


def has_free_play(arm: Arm, run: Run) -> bool:
    """Return True if a link of an arm flies across the gap of its gear."""
    return bool(_errors_of_flights(arm, run).any())


def _flight(gap: float, i: int, run: Run) -> float:
    """Return the weight, 0 to 1, of a link flying across a gap at joint i, not being there."""
    wide = (gap / (_WIDE * float(run.noise["q"].std[i]) + 1e-12)) ** 4
    return wide / (1 + wide)


def _errors_of_flights(arm: Arm, run: Run) -> Array:
    """Return standard deviations of angles foretold of links that fly (n,) [rad]; 0: none."""
    out = np.zeros(arm.n)
    for i, link in enumerate(arm.links):
        if link.gear is None:
            continue
        weight = _flight(link.gear.gap, i, run)
        if weight >= _NARROW:
            out[i] = _OFF * weight * link.gear.gap
    return out


def _beyond(x: Array, least: float) -> Array:
    """Return how sure it is that x is not noise of a size, 0 to 1; sure where there is none."""
    return -np.expm1(-np.square(x / least)) if least else np.ones_like(x)


def _low(x: Array, run: Run, top: float) -> Array:
    """Return a signal (..., T) up to a frequency [Hz]."""
    return np.asarray(differentiated(x[..., None], run.dt, top)[0][..., 0])


def _inertias(arm: Arm, run: Run) -> Array:
    """Inertia matrices of base and joints (T, 6 + n, 6 + n), rotors included."""
    key = bodies_of(arm), tuple(arm.column("rotor_inertia").tolist())

    def computed() -> Array:
        return inertia(arm, run["q"].reshape(-1, run.length, arm.n)[0])

    return cached(run.memory, "inertias", key, computed)
