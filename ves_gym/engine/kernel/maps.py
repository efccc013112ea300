"""Functions of the configuration, compiled, for many configurations at once."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import Array, ParameterError
from ves_gym.engine.kernel.blocks import aligned, fill, lanes, unlane
from ves_gym.engine.kernel.build import Library, cached
from ves_gym.engine.kernel.emit import LANES, emit_map
from ves_gym.engine.kernel.numbers import geometry, parameters, structure
from ves_gym.engine.kernel.symbolic import column, symbols
from ves_gym.engine.kernel.trace import coupling, inertia_matrix
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.dynamics import inertia
from ves_gym.mechanics.gravity import gravity_vector, gravity_wrench, minimal_model
from ves_gym.system.system import System

if TYPE_CHECKING:
    import casadi

_CHUNK = 512  # blocks at a time: inputs and outputs stay in the cache
_LIBRARIES: dict[str, Library] = {}


def coupling_matrices(system: System, q: Array) -> Array | None:
    """Return Q(q) of many configurations, compiled; None where nothing compiles.

    Q is of the vehicle, so of the ideal system where an emulated one is given: the emulated
    mode's graph has no M, D and K.

    Args:
        system: arm and vehicle.
        q: (N, n) joint angles [rad].

    Returns:
        (N, n, n) [J/rad^2].
    """
    system, n = system.ideal(), system.arm.n
    key, (_, p) = f"coupling {structure(system)}", parameters(system)
    try:
        return _compiled(key, lambda: coupling(system), q, p, n * n).reshape(-1, n, n)
    except (ImportError, RuntimeError, OSError):
        return None


class InertiaMap:
    """H(q) of a fixed number of configurations, over and over (`dynamics.inertia`).

    Compiled where that is possible, NumPy where it is not.
    """

    def __init__(self, system: System, n: int) -> None:
        self.arm, self.size = system.arm, 6 + system.arm.n
        blocks = -(-n // LANES)
        self._q = aligned(blocks, system.arm.n, LANES)
        self._H = aligned(blocks, self.size**2, LANES)
        self._run: Callable[[], None] | None = None
        try:
            key = f"inertia {structure(system)}"
            run = _library(key, lambda: inertia_matrix(system)).map
        except (ImportError, RuntimeError, OSError):
            return
        _, values = parameters(system)
        self._p = aligned(len(values), LANES)
        self._p[:] = values[:, None]
        where = tuple(k.ctypes.data for k in (self._q, self._p, self._H))
        self._run = partial(run, *where, 0, blocks)

    def __call__(self, q: Array) -> Array:
        """(m, n joints) -> (m, 6 + n, 6 + n), m at most the number given."""
        if self._run is None:
            return inertia(self.arm, q)
        fill(self._q, q)
        self._run()
        # in plain order: products of stacks round by the layout of their memory
        return unlane(self._H, len(q)).reshape(-1, self.size, self.size)


class WeightMap:
    """Weight of an arm at many configurations, over and over (`gravity.gravity_wrench`).

    Compiled where that is possible, NumPy where it is not.

    Args:
        arm: its geometry; masses are given with every question.
    """

    def __init__(self, arm: Arm) -> None:
        self.arm, self._room = arm, 0
        self._library: Library | None = None
        with contextlib.suppress(ImportError, RuntimeError, OSError):
            self._library = _library(f"weight {geometry(arm)}", lambda: _weight(arm))

    def __call__(self, q: Array, y: Array, mass: Array, P: Array) -> Array:
        """Return the wrench (m, 6) on the platform, in its axes [N, N m].

        Args:
            q: (m, n joints) [rad].
            y: (m, 6) pose of the platform [m, rad].
            mass: (m,) of the arm [kg].
            P: (m, size) minimal parameters [kg m].
        """
        if self._library is None:
            return gravity_wrench(self.arm, q, gravity_vector(y), mass, P)
        x = np.concatenate([q, y, mass[:, None], P], axis=1)
        if len(x) > self._room:
            blocks = -(-len(x) // LANES)
            self._room = blocks * LANES
            self._x, self._wrench = (aligned(blocks, k, LANES) for k in (x.shape[1], 6))
            # no parameters, so that any address does for theirs
            where = (k.ctypes.data for k in (self._x, self._x, self._wrench))
            self._run = partial(self._library.map, *where, 0, blocks)
        fill(self._x, x)
        self._run()
        return unlane(self._wrench, len(x))


def _weight(arm: Arm) -> casadi.Function:
    """(q, y, mass, P) -> wrench of the arm's weight."""
    import casadi as ca

    n, size = arm.n, minimal_model(arm).size
    x = symbols("x", (1, n + 7 + size))
    pose, mass, P = x[:, n : n + 6], x[:, n + 6], x[:, n + 7 :]
    wrench = gravity_wrench(arm, x[:, :n], gravity_vector(pose), mass, P)
    return ca.Function("weight", [column(x), ca.SX(0, 1)], [ca.cse(column(wrench))])


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


def evaluate(
    key: str, graph: Callable[[], casadi.Function], x: Array, p: Array, outputs: int
) -> Array:
    """Evaluate a graph (x, p) -> y at many points.

    Compiled and stored under `key`; interpreted by CasADi where nothing compiles.

    Args:
        key: names everything the graph depends on.
        graph: makes it.
        x: (..., k) points.
        p: parameters, the same for all.
        outputs: length of y.

    Returns:
        (..., outputs).
    """
    flat = x.reshape(-1, x.shape[-1])
    try:
        out = _compiled(key, graph, flat, p, outputs)
    except (ImportError, RuntimeError, OSError):
        function = graph()
        out = np.array([function(point, p).full().ravel() for point in flat])
    return out.reshape(*x.shape[:-1], outputs)


def _library(key: str, graph: Callable[[], casadi.Function]) -> Library:
    if key not in _LIBRARIES:
        _LIBRARIES[key] = cached(key, lambda: emit_map(graph()))
    return _LIBRARIES[key]


def _compiled(
    key: str, graph: Callable[[], casadi.Function], x: Array, p: Array, outputs: int
) -> Array:
    run = _library(key, graph).map
    numbers = aligned(len(p), LANES)
    numbers[:] = p[:, None]
    count = len(x)
    out = np.empty((count, outputs))
    size = _CHUNK * LANES

    def part(first: int) -> None:
        chunk = x[first : first + size]
        blocks = lanes(chunk)
        results = aligned(len(blocks), outputs, LANES)
        run(blocks.ctypes.data, numbers.ctypes.data, results.ctypes.data, 0, len(blocks))
        out[first : first + len(chunk)] = unlane(results, len(chunk))

    starts = range(0, count, size)
    if len(starts) < 2:
        for first in starts:
            part(first)
        return out
    with ThreadPoolExecutor(min(os.cpu_count() or 1, len(starts))) as pool:
        list(pool.map(part, starts))
    return out
