"""How gears give under the torque through them: springs, and play between teeth.

Derived in docs/diagnosis.md, What a gear does at a port.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ves_gym._util.params import Array
from ves_gym._util.signals import differentiated
from ves_gym.diagnosis.data.measured_run import Run, kept
from ves_gym.diagnosis.machines.torque_balance import winding_noise
from ves_gym.effects.joint_elasticity import HARD
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.dynamics import inertia

_TURNS_OVER = 0.4  # of the band: what of a torque decides on which side teeth lie
_NO_TURN = 3.0  # standard deviations of noise about which a torque moves no teeth
_TELLS = 10.0  # the same from which a torque logged tells what a link takes
_CROSSES = 0.6  # of the band: what of the motion leads a link across its gap
_CREEPS = 20.0  # N m s/rad with which noise allows to tell when a narrow gap is crossed at once
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
    from ves_gym.diagnosis.machines.recursions import deflection  # numba takes a second to load

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
    from ves_gym.diagnosis.machines.recursions import crossing, deflection

    gear = arm.links[i].gear
    assert gear is not None
    stiffness, half = 1 / gear.compliance, gear.gap / 2
    top = _TURNS_OVER * run.band
    slow = _low(torque, run, top)
    noise = 0.0
    if "tau" in run:
        noise = max(float(_noise_through(arm, run, top)[i]), 1e-12)
    sure = _beyond(slow, _NO_TURN * noise)
    thick = max(gear.damping, _CREEPS)
    at_once = deflection(sure * slow, stiffness, thick, half, run.dt)
    wide = (gear.gap / (_WIDE * float(run.noise["q"].std[i]) + 1e-12)) ** 4
    if wide < _NARROW:
        return at_once
    known = _beyond(slow, _TELLS * noise)
    load = known * slow + (1 - known) * _low(taken, run, _CROSSES * run.band)
    heavy = _inertias(arm, run)[:, i] - arm.links[i].rotor_inertia
    flown = crossing(load, heavy, gear.damping, half, run.dt) + sure * slow / stiffness
    return np.asarray((at_once + wide * flown) / (1 + wide))


def _beyond(x: Array, least: float) -> Array:
    """Return how sure it is that x is not noise of a size, 0 to 1; sure where there is none."""
    return -np.expm1(-np.square(x / least)) if least else np.ones_like(x)


def _low(x: Array, run: Run, top: float) -> Array:
    """Return a signal (..., T) up to a frequency [Hz]."""
    return np.asarray(differentiated(x[..., None], run.dt, top)[0][..., 0])


def _inertias(arm: Arm, run: Run) -> Array:
    """Inertia about each joint, others held (T, n), rotors included; computed once per arm."""

    def computed() -> Array:
        q = run["q"].reshape(-1, run.length, arm.n)[0]
        n = np.arange(arm.n)
        return inertia(arm, q)[:, 6 + n, 6 + n]

    return kept(run.memory, "inertias", arm, computed)  # type: ignore[no-any-return]


def _noise_through(arm: Arm, run: Run, top: float) -> Array:
    """Noise of the torques through gears up to `top` Hz (n,) [N m], computed once per arm."""
    rotors = arm.column("rotor_inertia")
    key = tuple(rotors.tolist()), top
    noise = kept(
        run.memory, "noise through gears", key, lambda: winding_noise(run, rotors, top)
    )
    return noise  # type: ignore[no-any-return]
