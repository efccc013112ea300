"""Functions of the configuration, compiled, for many configurations at once."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from ves_gym.core.dynamics import inertia
from ves_gym.core.kernel.blocks import aligned, fill, lanes, unlane
from ves_gym.core.kernel.build import Library, cached
from ves_gym.core.kernel.emit import LANES, emit_map
from ves_gym.core.kernel.trace import coupling, inertia_matrix, parameters, structure
from ves_gym.core.params import Array
from ves_gym.core.system import System

if TYPE_CHECKING:
    import casadi

_CHUNK = 512  # blocks at a time: inputs and outputs stay in the cache
_LIBRARIES: dict[str, Library] = {}


def coupling_matrices(system: System, q: Array) -> Array | None:
    """Q(q) of (N, n) configurations: (N, n, n) [J/rad^2]; None where nothing compiles.

    Q is of the vehicle, so of the space system where an emulated one is given: the
    laboratory's graph has no M, D and K.
    """
    system, n = system.ideal(), system.arm.n
    try:
        return _evaluate("coupling", coupling, system, q, n * n).reshape(-1, n, n)
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
            run = _library("inertia", inertia_matrix, system).map
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


def _library(name: str, graph: Callable[[System], casadi.Function], system: System) -> Library:
    key = f"{name} {structure(system)}"
    if key not in _LIBRARIES:
        _LIBRARIES[key] = cached(key, lambda: emit_map(graph(system)))
    return _LIBRARIES[key]


def _evaluate(
    name: str,
    graph: Callable[[System], casadi.Function],
    system: System,
    x: Array,
    outputs: int,
) -> Array:
    """(N, outputs) of a graph (x, p) -> y at points x (N, k), p those of the system."""
    run = _library(name, graph, system).map
    _, values = parameters(system)
    p = aligned(len(values), LANES)
    p[:] = values[:, None]
    count = len(x)
    out = np.empty((count, outputs))
    size = _CHUNK * LANES

    def part(first: int) -> None:
        some = x[first : first + size]
        given = lanes(some)
        found = aligned(len(given), outputs, LANES)
        run(given.ctypes.data, p.ctypes.data, found.ctypes.data, 0, len(given))
        out[first : first + len(some)] = unlane(found, len(some))

    starts = range(0, count, size)
    if len(starts) < 2:
        for first in starts:
            part(first)
        return out
    with ThreadPoolExecutor(min(os.cpu_count() or 1, len(starts))) as pool:
        list(pool.map(part, starts))
    return out
