"""Functions of the configuration, compiled, for many configurations at once."""

from __future__ import annotations

from functools import lru_cache, partial

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import Array, ParameterError
from ves_gym.engine.kernel.compiled_function import CompiledFunction
from ves_gym.engine.kernel.numbers import geometry, parameters, structure
from ves_gym.engine.kernel.trace import coupling, inertia_matrix
from ves_gym.mechanics.arm import Arm
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
