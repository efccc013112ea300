"""Jets of a satellite: their wrench, which of them make a wrench, whole pulses, propellant.

A jet is on or off. Over a control period its pulse counts by its impulse: the force on the
satellite is thrust times on-time over the period, held.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

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

STANDARD_GRAVITY = 9.80665  # m/s^2: specific impulse in seconds is by definition times this
_LEVER = 1.0  # m: a newton and a newton metre of misfit count alike
_FULL = 1e6  # N: beyond what any jet gives
_THRIFT = 1e-4  # weight of the forces themselves, so that no two jets blow at each other


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
        length = float(np.linalg.norm(finite(self.direction, (3,), "Jet.direction")))
        if abs(length - 1) > 1e-9:
            raise ParameterError(f"Jet.direction must have length 1, got {self.direction}")
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
    """Return mean forces of the jets that make a wrench, or come nearest to it.

    Least squares with forces >= 0. A wrench beyond the jets' thrust is made smaller as a whole,
    its direction kept.

    Args:
        jets: k of them.
        wrench: (n, 6) in platform axes at its origin [N, N m].

    Returns:
        (n, k) [N].
    """
    from scipy.optimize import nnls  # heavy, and most systems have no jets

    k, scale = len(jets), np.r_[np.ones(3), np.full(3, 1 / _LEVER)]
    most = np.array([jet.thrust for jet in jets])
    rows = np.vstack([scale[:, None] * wrench_matrix(jets), _THRIFT * np.eye(k)])
    out = np.zeros((len(wrench), k))
    for i, asked in enumerate(wrench):
        if asked.any():
            out[i] = nnls(rows, np.r_[scale * asked, np.zeros(k)])[0]
    over = np.max(out / most, axis=1, initial=1.0)
    return np.asarray(out / over[:, None], dtype=np.float64)


@lru_cache(maxsize=64)
def strongest(jets: tuple[Jet, ...], point: tuple[float, ...]) -> Array:
    """Return the largest force and moment (6,) that jets give along each axis, either way.

    Args:
        jets: k of them.
        point: (3,) that the moment is about, in platform axes [m].

    Returns:
        Three forces [N], three moments [N m]; read-only. 0 along an axis that they cannot push.
    """
    about = np.vstack([np.eye(6), -np.eye(6)])
    asked = _FULL * about
    asked[:, 3:] += np.cross(point, asked[:, :3])
    given = allocated(jets, asked) @ wrench_matrix(jets).T
    given[:, 3:] -= np.cross(point, given[:, :3])
    out: Array = np.maximum((given * about).sum(axis=1).reshape(2, 6).min(axis=0), 0.0)
    out.flags.writeable = False
    return out


def pulses(
    jets: tuple[Jet, ...], owed: Array, left: Array, force: Array, dt: float
) -> tuple[Array, Array, Array]:
    """Return the impulses that jets give in a control period: none, or no less than a pulse.

    What is asked for adds up until it makes a pulse. One that takes longer than a period goes
    on in the next ones, whatever is asked for then.

    Args:
        jets: k of them.
        owed: (n, k) impulse asked for and not given yet [N s].
        left: (n, k) impulse that pulses under way have still to give [N s].
        force: (n, k) mean force asked for [N].
        dt: control period [s].

    Returns:
        Impulses of this period, then `owed` and `left` after it; (n, k) [N s].
    """
    full = np.array([jet.thrust for jet in jets]) * dt
    least = np.array([jet.min_impulse for jet in jets])
    owed = np.minimum(owed + force * dt, full + least)
    begins = (left <= 0) & (owed >= least) & (owed > 0)
    left = np.where(begins, least, left)
    on = begins | (left > 0)
    given = np.where(on, np.minimum(full, np.maximum(owed, left)), 0.0)
    left = np.maximum(left - given, 0.0)
    return given, np.maximum(owed - given, 0.0), np.where(left < 1e-12 * full, 0.0, left)


def propellant(jets: tuple[Jet, ...], impulse: Array) -> Array:
    """Return the propellant that impulses take, impulse / (I_sp g_0).

    Args:
        jets: k of them.
        impulse: (..., k) [N s].

    Returns:
        (...,) [kg].
    """
    speed = STANDARD_GRAVITY * np.array([jet.specific_impulse for jet in jets])
    out: Array = np.sum(impulse / speed, axis=-1)
    return out
