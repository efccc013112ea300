"""State of n simulations, what is reported of them, the snapshot that holds it all, and the
arguments of a batch: which simulations, and numbers that broadcast to one shape."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import Array, Index, ParameterError
from ves_gym.mechanics.attitude import from_angles
from ves_gym.mechanics.spatial import twist
from ves_gym.system.system import System

Tree = Mapping[str, Mapping[str, Array]]  # component -> name -> array (n, ...)


class State(NamedTuple):
    """State of every simulation. Leading axis = simulation."""

    time: Array  # (n,) s
    y: Array  # (n, 6) base pose [m, rad]
    yd: Array  # (n, 6) its rate
    q: Array  # (n, joints) rad
    v: Array  # (n, joints) rad/s

    @property
    def attitude(self) -> Array:
        """(n, 4) unit quaternions of the base, scalar first, its axes to inertial ones."""
        return from_angles(self.y[:, 3:])

    @property
    def spin(self) -> Array:
        """(n, 3) angular velocity of the base in its own axes [rad/s]."""
        return twist(self.y, self.yd)[:, 3:]


class Event(NamedTuple):
    """A safety check that froze the platform (thesis 2.4.2)."""

    simulation: int
    time: float  # s
    reason: str

    def __str__(self) -> str:
        return f"platform frozen at t = {self.time:.4f} s: {self.reason}"


class Readings(NamedTuple):
    """Signals of the controller at one instant. Leading axis n."""

    wrench: Array  # (n, 6) sensor reading, platform frame [N, N m]
    gravity: Array  # (n, 6) estimate of its static part
    y: Array  # (n, 6) measured pose
    y_cmd: Array  # (n, 6) commanded pose


@dataclass(frozen=True)
class Snapshot:
    """Everything needed to continue exactly from here (`Simulator.snapshot`); picklable."""

    system_hash: str
    backend_name: str
    n: int
    assigned: Mapping[int, System]
    arrays: Tree

    def fanned_out(self, i: int, n: int) -> Snapshot:
        """Return the snapshot of n simulations that all are where simulation i was.

        Whatever was assigned to it and its random generator are copied too: under the same
        commands all n go on alike, noise included.

        Raises:
            ParameterError: no such simulation.
        """
        if not 0 <= i < self.n:
            raise ParameterError(f"fan_out needs a simulation of 0 to {self.n - 1}, got {i}")
        arrays = {
            part: {name: np.repeat(values[i : i + 1], n, axis=0) for name, values in of.items()}
            for part, of in self.arrays.items()
        }
        system = self.assigned.get(i)
        assigned = {} if system is None else dict.fromkeys(range(n), system)
        return replace(self, n=n, assigned=assigned, arrays=arrays)


def generator_arrays(generators: Sequence[np.random.Generator]) -> dict[str, Any]:
    """Return the states of generators as an array (n,) of tables."""
    return {"state": np.array([k.bit_generator.state for k in generators], object)}


def set_generators(
    generators: Sequence[np.random.Generator], arrays: Mapping[str, Array]
) -> None:
    """Return generators to states of `generator_arrays`."""
    states: Any = arrays["state"]
    for state, generator in zip(states, generators, strict=True):
        generator.bit_generator.state = state


# --------------------------------------------------------------------- arguments of a batch


def simulation_ids(ids: npt.ArrayLike | None, n: int) -> Index:
    """(k,) whole numbers of simulations, given so, by a mask (n,), or None for all n."""
    if ids is None:
        return np.arange(n)
    index = np.asarray(ids)
    if index.dtype == bool and index.shape == (n,):
        return np.flatnonzero(index)
    valid = index.ndim == 1 and (np.issubdtype(index.dtype, np.integer) or not index.size)
    if not valid or (index < 0).any() or (index >= n).any():
        raise ParameterError(f"ids must be whole numbers in [0, {n}), got {ids!r}")
    rising = (index[1:] > index[:-1]).all()
    if not rising and (np.diff(np.sort(index)) == 0).any():  # `np.unique` loads numpy.ma
        raise ParameterError(f"ids must name each simulation once, got {ids!r}")
    return index.astype(np.intp)


def broadcast(value: npt.ArrayLike, name: str, shape: tuple[int, ...]) -> Array:
    """`value` as finite float64 numbers of a shape; `name` is what an error calls it."""
    expected = f"{name} must be numbers of shape {shape}, got"
    array = numbers(value, expected)
    if array.shape != shape:
        try:
            array = np.broadcast_to(array, shape)
        except ValueError:
            raise ParameterError(f"{expected} {array.shape}") from None
    if not np.isfinite(array).all():
        where = np.argwhere(~np.isfinite(array))[0].tolist()
        raise ParameterError(f"{name} must be finite, got {array[tuple(where)]} at {where}")
    return array


def numbers(value: npt.ArrayLike, expected: str) -> Array:
    """`value` as a float64 array; text, truth values, None and ragged rows are errors."""
    try:
        array = np.asarray(value)
    except ValueError:
        raise ParameterError(f"{expected} ragged rows") from None
    if array.dtype.kind not in "fiu":
        raise ParameterError(f"{expected} {value!r}")
    return array.astype(np.float64)
