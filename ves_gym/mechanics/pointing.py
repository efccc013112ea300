"""What turns a satellite: jets, wheels, and the law of its attitude.

A jet is on or off. Over a control period its pulse counts by its impulse: the force on the
satellite is thrust times on-time over the period, held. The law is a quaternion PD law, wheels
first, jets for the rest:

    moment = kp * difference(target, attitude) - kd * spin + spin x (J spin + h)

with J the inertia of satellite and arm and h the wheels' momentum; the last term keeps the law
linear while the body turns. Wheels give what they can; when they store too much, jets take it
out of them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar

import numpy as np

from ves_gym._util.params import (
    Array,
    ParameterError,
    Vector,
    finite,
    freeze_arrays,
    require_positive,
    unit,
)
from ves_gym.mechanics import attitude
from ves_gym.mechanics.carried import ReactionWheel
from ves_gym.mechanics.link import require_length_1
from ves_gym.mechanics.spatial import matvec

STANDARD_GRAVITY = 9.80665  # m/s^2: specific impulse in seconds is by definition times this
_LEVER = 1.0  # m: a newton and a newton metre of misfit count alike
_FULL = 1e6  # N: beyond what any jet gives
_THRIFT = 1e-4  # weight of the forces themselves, so that no two jets blow at each other
CREEP = 0.1  # rad/s over which Coulomb friction of a wheel builds up from rest


@dataclass(frozen=True, kw_only=True)
class Jet:
    """A thruster fixed to the satellite, on or off.

    `direction` is that of its force on the satellite. A pulse gives `min_impulse` at least,
    the minimum impulse bit.
    """

    position: Vector = unit("m")  # in platform axes
    direction: Vector = unit("1")  # (3,) unit vector
    thrust: float = unit("N")
    specific_impulse: float = unit("s")
    min_impulse: float = unit("N s", default=0.0)

    def __post_init__(self) -> None:
        freeze_arrays(self)
        finite(self.position, (3,), "Jet.position")
        require_length_1(self.direction, "Jet.direction")
        require_positive(self, "thrust", "specific_impulse")
        require_positive(self, "min_impulse", zero=True)


@lru_cache(maxsize=64)
def wrench_matrix(jets: tuple[Jet, ...]) -> Array:
    """(6, k) wrench at the platform's origin per newton of each of k jets; read-only."""
    out = np.zeros((6, len(jets)))
    for i, jet in enumerate(jets):
        out[:3, i] = jet.direction
        out[3:, i] = np.cross(jet.position, jet.direction)
    out.flags.writeable = False
    return out


def allocated(jets: tuple[Jet, ...], wrench: Array) -> Array:
    """Return mean forces (n, k) [N] of k jets that make a wrench (n, 6) in platform axes at its
    origin, or come nearest to it.

    Least squares with forces >= 0. A wrench beyond the jets' thrust is made smaller as a whole,
    its direction preserved.
    """
    most = np.array([jet.thrust for jet in jets])
    pairs = opposites(jets)
    if pairs is not None:  # what opposite jets give together has any sign
        out = np.maximum(matvec(pairs, wrench), 0.0)
    else:
        out = np.array([_nearest(jets, request) for request in wrench]).reshape(-1, len(jets))
    forces: Array = out / np.maximum(np.max(out / most, axis=1), 1.0)[:, None]
    return forces


def _scaled(jets: tuple[Jet, ...]) -> tuple[Array, Array]:
    """(6 + k, k) rows of the least squares, and scales (6,) of a wrench."""
    scale = np.r_[np.ones(3), np.full(3, 1 / _LEVER)]
    return np.vstack([scale[:, None] * wrench_matrix(jets), _THRIFT * np.eye(len(jets))]), scale


def _nearest(jets: tuple[Jet, ...], wrench: Array) -> Array:
    """Forces (k,) >= 0 whose wrench is nearest to one (6,)."""
    from scipy.optimize import nnls  # heavy, and most systems have no jets

    rows, scale = _scaled(jets)
    if not wrench.any():
        return np.zeros(len(jets))
    out: Array = nnls(rows, np.r_[scale * wrench, np.zeros(len(jets))])[0]
    return out


@lru_cache(maxsize=64)
def opposites(jets: tuple[Jet, ...]) -> Array | None:
    """(k, 6) matrix whose product with a wrench, where positive, is what the jets give.

    None where a jet has no other that gives the opposite wrench. Where all have, no two of a
    pair fire at once, and the least squares are those of signed forces, one for each pair.
    """
    W = wrench_matrix(jets)
    opposite = np.abs(W[:, :, None] + W[:, None, :]).max(axis=0) < 1e-12  # m, of unit forces
    if not (opposite.sum(axis=1) == 1).all():
        return None
    first = np.flatnonzero(opposite.argmax(axis=1) > np.arange(len(jets)))
    rows, scale = _scaled(tuple(jets[i] for i in first))
    out = np.zeros((len(jets), 6))
    out[first] = np.linalg.pinv(rows)[:, :6] * scale
    out[opposite.argmax(axis=1)[first]] = -out[first]
    return out


@lru_cache(maxsize=64)
def strongest(jets: tuple[Jet, ...], point: tuple[float, ...]) -> Array:
    """Return the largest force [N] and moment [N m] about a point (3,) of the platform's axes
    [m] that jets give along each axis, either way: (6,), read-only; 0 along an axis that they
    cannot push."""
    about = np.vstack([np.eye(6), -np.eye(6)])
    request = _FULL * about
    request[:, 3:] += np.cross(point, request[:, :3])
    obtained = allocated(jets, request) @ wrench_matrix(jets).T
    obtained[:, 3:] -= np.cross(point, obtained[:, :3])
    out: Array = np.maximum((obtained * about).sum(axis=1).reshape(2, 6).min(axis=0), 0.0)
    out.flags.writeable = False
    return out


def pulses(
    jets: tuple[Jet, ...], owed: Array, remaining: Array, force: Array, dt: float
) -> tuple[Array, Array, Array]:
    """Return the impulses that k jets give in a control period dt [s]: none, or no less than a
    pulse.

    The demand adds up until it makes a pulse. One that takes longer than a period goes
    on in the next ones, whatever the demand is then.

    Args:
        owed: (n, k) impulse demanded and not yet delivered [N s].
        remaining: (n, k) impulse that pulses under way have still to give [N s].
        force: (n, k) mean demanded force [N].

    Returns:
        Impulses of this period, then `owed` and `remaining` after it; (n, k) [N s].
    """
    full = np.array([jet.thrust for jet in jets]) * dt
    least = np.array([jet.min_impulse for jet in jets])
    owed = np.minimum(owed + force * dt, full + least)
    begins = (remaining <= 0) & (owed >= least) & (owed > 0)
    remaining = np.where(begins, least, remaining)
    on = begins | (remaining > 0)
    impulse = np.where(on, np.minimum(full, np.maximum(owed, remaining)), 0.0)
    remaining = np.maximum(remaining - impulse, 0.0)
    return (
        impulse,
        np.maximum(owed - impulse, 0.0),
        np.where(remaining < 1e-12 * full, 0.0, remaining),
    )


def propellant(jets: tuple[Jet, ...], impulse: Array) -> Array:
    """Return the propellant (...,) [kg] that impulses (..., k) [N s] of k jets take, impulse /
    (I_sp g_0)."""
    speed = STANDARD_GRAVITY * np.array([jet.specific_impulse for jet in jets])
    out: Array = np.sum(impulse / speed, axis=-1)
    return out


# -------------------------------------------------------------- attitude and wheels


@dataclass(frozen=True, kw_only=True)
class AttitudeControl:
    """Settings of the law: a bandwidth, its damping, its limits, when jets unload the wheels.

    Gains follow from the inertia J of satellite and arm: kp = J w^2 and kd = 2 zeta J w at
    w = 2 pi `bandwidth`. `spin_max` limits the angular velocity that an error of attitude asks
    for. Jets dump when a wheel's momentum exceeds the share `dump_above` of what it can store,
    until none exceeds `dump_below`.
    """

    kind: ClassVar[str] = "attitude"
    bandwidth: float = unit("Hz", default=0.05)
    damping_ratio: float = unit("1", default=0.7)
    spin_max: float = unit("rad/s", default=0.05)
    moment_max: float = unit("N m", default=20.0)  # of the law, each axis
    dump_above: float = unit("1", default=0.7)
    dump_below: float = unit("1", default=0.3)
    dump_time: float = unit("s", default=20.0)  # momentum of wheels over it is the jets' moment

    def __post_init__(self) -> None:
        require_positive(
            self, "bandwidth", "damping_ratio", "spin_max", "moment_max", "dump_time"
        )
        require_positive(self, "dump_below", "dump_above", zero=True)
        if not 0 <= self.dump_below <= self.dump_above <= 1:
            raise ParameterError(
                "AttitudeControl must have 0 <= dump_below <= dump_above <= 1, got"
                f" {self.dump_below:g} and {self.dump_above:g}"
            )

    def gains(self, inertia: Array) -> tuple[Array, Array]:
        """Return kp [N m/rad] and kd [N m s/rad] of an inertia (..., 3, 3), see `moment`."""
        kd = inertia * (4 * np.pi * self.damping_ratio * self.bandwidth)
        return self.rate * kd, kd

    @property
    def rate(self) -> float:
        """Demanded spin per angle of error, kp / kd [1/s]."""
        return math.pi * self.bandwidth / self.damping_ratio

    def moment(
        self, inertia: Array, target: Array, q: Array, spin: Array, stored: Array
    ) -> Array:
        """Return the moment (n, 3) on the satellite that the law asks for, in body axes [N m].

        Args:
            inertia: (n, 3, 3) of satellite and arm about the common centre of mass, its axes.
            target, q: (n, 4) attitudes.
            spin: (n, 3) angular velocity in body axes [rad/s].
            stored: (n, 3) momentum of the wheels in body axes [N m s].
        """
        # kp e = kd (kp / kd) e: a large error asks for a spin, and no more than spin_max
        request = self.rate * attitude.difference(target, q)
        size = np.linalg.norm(request, axis=-1, keepdims=True)
        request = request / np.maximum(size / self.spin_max, 1.0)
        gyroscopic = np.cross(spin, matvec(inertia, spin) + stored)
        return np.clip(
            matvec(self.gains(inertia)[1], request - spin) + gyroscopic,
            -self.moment_max,
            self.moment_max,
        )


def about_centre(locked: Array) -> Array:
    """Inertia (..., 3, 3) about the centre of mass, of a spatial inertia (..., 6, 6)."""
    mass, first = locked[..., :1, :1], locked[..., 3:, :3]
    return locked[..., 3:, 3:] + first @ first / mass


def wheel_axes(wheels: tuple[ReactionWheel, ...]) -> Array:
    """(3, k) spin axes of k wheels in body axes."""
    return np.array([wheel.axis for wheel in wheels], dtype=np.float64).reshape(-1, 3).T


def wheel_torques(wheels: tuple[ReactionWheel, ...], moment: Array) -> Array:
    """Return motor torques (n, k) on the rotors of k wheels [N m] whose reaction on the
    satellite is a moment (n, 3) in body axes, or nearest to it; of all that do the least
    squares."""
    return -matvec(shares(wheels), moment)


@lru_cache(maxsize=64)
def shares(wheels: tuple[ReactionWheel, ...]) -> Array:
    """(k, 3) what each of k wheels takes of a moment: the pseudo-inverse; read-only."""
    out = np.asarray(np.linalg.pinv(wheel_axes(wheels)), dtype=np.float64)
    out.flags.writeable = False
    return out


def on_rotors(
    wheels: tuple[ReactionWheel, ...], torque: Array, speed: Array, dt: float
) -> Array:
    """Return what acts on the rotors: motors `within_limits`, less Coulomb friction.

    Friction is that of the speed at the start of the period. It builds up from rest over
    `CREEP`, or over twice what it would change the speed by in a period.
    """
    rubbing, inertia = (
        np.array([getattr(wheel, name) for wheel in wheels]) for name in ("coulomb", "inertia")
    )
    slow = np.maximum(CREEP, 2 * rubbing * dt / inertia)
    out: Array = within_limits(wheels, torque, speed, dt) - rubbing * np.tanh(speed / slow)
    return out


def within_limits(
    wheels: tuple[ReactionWheel, ...], torque: Array, speed: Array, dt: float
) -> Array:
    """Return motor torques within torque and momentum limits.

    Of torque (n, k) demanded on the rotors [N m], held over dt [s] at their speed (n, k)
    against the satellite [rad/s]. A motor never takes its wheel beyond `speed_max` within the
    period; beyond it (the body may turn under the wheel) it brakes only.
    """
    inertia, most, fastest = (
        np.array([getattr(wheel, name) for wheel in wheels])
        for name in ("inertia", "torque_max", "speed_max")
    )
    up = np.maximum((fastest - speed) * inertia / dt, 0.0)
    down = np.minimum((-fastest - speed) * inertia / dt, 0.0)
    return np.clip(torque, np.maximum(-most, down), np.minimum(most, up))
