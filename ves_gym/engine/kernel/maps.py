"""Functions of the configuration, compiled, for many configurations at once."""

from __future__ import annotations

from functools import lru_cache, partial

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import Array, ParameterError
from ves_gym.engine.kernel.compiled_function import CompiledFunction
from ves_gym.engine.kernel.numbers import geometry, parameters, structure
from ves_gym.engine.kernel.trace import coupling, inertia_matrix, regressor
from ves_gym.mechanics.arm import Arm, Chain, LinkBodies
from ves_gym.mechanics.dynamics import newton_euler
from ves_gym.mechanics.gravity import gravity_vector, gravity_wrench, minimal_model
from ves_gym.system.system import System


def coupling_matrices(system: System, q: Array) -> Array:
    """Return Q(q) of many configurations.

    Q is of the vehicle, so of the ideal system where an emulated one is given: the emulated
    mode's graph has no M, D and K.

    Args:
        system: arm and vehicle.
        q: (N, n) joint angles [rad].

    Returns:
        (N, n, n) [J/rad^2].
    """
    system, n = system.ideal(), system.arm.n
    return _coupling(system)(q, parameters(system)[1]).reshape(-1, n, n)


@lru_cache(maxsize=16)
def _coupling(system: System) -> CompiledFunction:
    return CompiledFunction(f"coupling {structure(system)}", partial(coupling, system))


@lru_cache(maxsize=64)
def inertia_function(system: System) -> CompiledFunction:
    """(q, p) -> entries of H(q) of arm and base link, row by row (`dynamics.inertia`)."""
    return CompiledFunction(f"inertia {structure(system)}", partial(inertia_matrix, system))


class InertiaMap:
    """H(q) of at most n configurations, over and over (`dynamics.inertia`)."""

    def __init__(self, system: System, n: int) -> None:
        self._size = 6 + system.arm.n
        self._entries = inertia_function(system).buffered(n, parameters(system)[1])

    def __call__(self, q: Array) -> Array:
        """(m, n joints) -> (m, 6 + n, 6 + n), m at most the number given."""
        # in plain order: products of stacks round by the layout of their memory
        return self._entries(q).reshape(-1, self._size, self._size)


@lru_cache(maxsize=64)
def weight_function(arm: Arm) -> CompiledFunction:
    """(q, y, mass, P) -> wrench of the arm's weight on the platform (`gravity.gravity_wrench`).

    In platform axes [N, N m], of the pose y, the arm's mass (1) [kg] and its minimal
    parameters P [kg m].
    """

    def weight(q: Array, y: Array, mass: Array, P: Array) -> Array:
        return gravity_wrench(arm, q, gravity_vector(y), mass[:, 0], P)

    size = minimal_model(arm).size
    return CompiledFunction.of(f"weight {geometry(arm)}", weight, arm.n, 6, 1, size)


def motion_loads(
    arm: Arm, q: Array, v: Array, a: Array, spin: Array, turn: Array, accel: Array
) -> tuple[Array, Array]:
    """Return what `dynamics.newton_euler` does, of many instants (...) with leading axes alike.

    Masses, centres, inertias and rotors are numbers, so that arms that differ in them share
    the code.
    """
    n, key = arm.n, f"load {geometry(arm)}"

    def load(*rows: Array) -> tuple[Array, Array]:
        *motion, numbers = (row[0] for row in rows)
        mass, com, moments, rotors = np.split(numbers, np.cumsum([1, 3, 6]) * (n + 1))
        square = moments.reshape(n + 1, 6)[:, [[0, 1, 2], [1, 3, 4], [2, 4, 5]]]
        bodies = LinkBodies(mass, com.reshape(n + 1, 3), square, rotors)
        chain = Chain(arm.joints, arm.start, bodies)
        q, v, a, spin, turn, accel = motion
        return newton_euler(chain, q, v, a, spin=spin, turn=turn, accel=accel)

    mass, com, inertia, rotors = arm.bodies
    moments = inertia[:, *np.triu_indices(3)]
    numbers = np.concatenate([mass, com.ravel(), moments.ravel(), rotors])
    function = CompiledFunction.of(key, load, n, n, n, 3, 3, 3, len(numbers))
    out = function(q, v, a, spin, turn, accel, numbers)
    return out[..., :n], out[..., n:]


def points(*parts: tuple[npt.ArrayLike, int, str]) -> Array:
    """Values (..., width) with their widths and names, side by side: (..., all widths).

    Leading axes broadcast; a single number stands for all of its width.

    Raises:
        ParameterError: another width, axes that do not broadcast, or a value not finite.
    """
    arrays = []
    for value, width, name in parts:
        array = np.asarray(value, float)
        array = np.full(width, array) if array.ndim == 0 else array
        if array.shape[-1] != width:
            raise ParameterError(f"{name} must have shape (..., {width}), got {array.shape}")
        if not np.isfinite(array).all():
            raise ParameterError(f"{name} must be finite, got {array.tolist()}")
        arrays.append(array)
    try:
        batch = np.broadcast_shapes(*(k.shape[:-1] for k in arrays))
    except ValueError:
        got = ", ".join(f"{k[2]} {a.shape}" for k, a in zip(parts, arrays, strict=True))
        raise ParameterError(f"leading axes must broadcast, got {got}") from None
    wide = [np.broadcast_to(k, (*batch, k.shape[-1])) for k in arrays]
    return np.concatenate(wide, axis=-1)


# -------------------------------- inverse dynamics as a matrix times the inertial numbers
#
# It is linear in mass, first moment and inertia about the frame of each body, so the derivative
# of the traced Newton-Euler equations is the regressor. `mechanics/gravity.py` keeps the fewest
# combinations of these numbers that the weight shows.


def inertial_parameters(arm: Arm) -> Array:
    """(10 (n + 1) + n,) numbers that `inertia_regressor` multiplies.

    Base first, of each body m [kg], m c (3) [kg m] and its inertia about the origin of its
    frame xx, xy, yy, xz, yz, zz [kg m^2] (Pinocchio's order); then the rotor inertias.
    """
    from ves_gym.mechanics.body_numbers import numbers_of_body  # which a diagnosis needs

    bodies = (arm.base, *(link.inertial for link in arm.links))
    return np.concatenate([*map(numbers_of_body, bodies), arm.column("rotor_inertia")])


def inertia_regressor(
    arm: Arm,
    q: npt.ArrayLike,
    v: npt.ArrayLike,
    a: npt.ArrayLike,
    *,
    spin: npt.ArrayLike = 0.0,
    turn: npt.ArrayLike = 0.0,
    accel: npt.ArrayLike = 0.0,
) -> Array:
    """Inverse dynamics on a moving base, per inertial number of the arm.

    Args:
        q, v, a: (..., n) joint angles [rad], rates [rad/s], accelerations [rad/s^2].
        spin, turn: (..., 3) angular velocity and acceleration of the base, platform axes.
        accel: (..., 3) acceleration of its origin less that of free fall, platform axes.

    Returns:
        (..., 6 + n, 10 (n + 1) + n): times `inertial_parameters` it is the wrench that the
        arm exerts on its base at the platform-top origin [N, N m] and the joint torques
        [N m], as in `dynamics.inverse_dynamics`. Leading axes broadcast.

    Raises:
        ParameterError: wrong shapes, or numbers that are not finite.
    """
    n = arm.n
    at = points(
        (q, n, "q"),
        (v, n, "v"),
        (a, n, "a"),
        (spin, 3, "spin"),
        (turn, 3, "turn"),
        (accel, 3, "accel"),
    )
    jacobian = _regressor(arm)(at).reshape(*at.shape[:-1], 10 * (n + 1) + n, 6 + n)
    return np.swapaxes(jacobian, -1, -2)


@lru_cache(maxsize=16)
def _regressor(arm: Arm) -> CompiledFunction:
    return CompiledFunction(f"regressor {geometry(arm)}", partial(regressor, arm))
