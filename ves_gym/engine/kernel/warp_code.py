"""CasADi graphs as Warp kernels: one simulation a thread, on a GPU or Warp's CPU device.

Warp compiles them on first use and keeps the machine code in its own cache, by their text.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib
from collections.abc import Callable, Iterator
from typing import Any

from ves_gym.engine.kernel.scalar import advance_text, map_text
from ves_gym.engine.kernel.trace import equations, structure
from ves_gym.system.system import System

THREADS = 64  # of a block; one takes all the registers that it can have
_KERNELS: dict[tuple[str, ...], Any] = {}
_LOADED: set[tuple[Any, str]] = set()  # kernel, device


def load_warp() -> Any:
    """Return the package, initialised; it says nothing on standard output."""
    warp: Any = importlib.import_module("warp")  # typed or not, as it is installed or not
    with _quiet(warp):
        warp.init()
    return warp


@contextlib.contextmanager
def _quiet(warp: Any) -> Iterator[None]:
    """Hold back what Warp prints about devices and modules."""
    name, silent = ("log_level", 40) if hasattr(warp.config, "log_level") else ("quiet", True)
    before = getattr(warp.config, name)
    setattr(warp.config, name, silent)
    try:
        yield
    finally:
        setattr(warp.config, name, before)


def advance_kernel(system: System, real: str, record: bool) -> Any:
    """The kernel of `scalar.advance_text`; systems that differ in values only share it.

    Args:
        system: what to simulate.
        real: float64 or float32.
        record: with what is observed.
    """
    key = (structure(system), real, "record" if record else "advance")
    if key not in _KERNELS:
        graphs = equations(system)
        order = 6 + graphs.n + graphs.hidden
        observe = graphs.observe if record else None
        text = advance_text(graphs.motion, observe, system.integrator, order, real)
        _KERNELS[key] = _advance(load_warp(), text, real)
    return _KERNELS[key]


def map_kernel(name: str, system: System, real: str, make: Callable[[], Any]) -> Any:
    """The kernel of `scalar.map_text` for a graph that depends on a system's structure.

    Args:
        name: of the graph.
        system: whose structure.
        real: float64 or float32.
        make: () -> the graph (x, p) -> y.
    """
    key = (structure(system), real, f"map {name}")
    if key not in _KERNELS:
        _KERNELS[key] = _map(load_warp(), map_text(make(), real), real)
    return _KERNELS[key]


def _advance(wp: Any, text: str, real: str) -> Any:
    number = getattr(wp, real)
    table, flags = wp.array2d(dtype=number), wp.array(dtype=wp.int32)
    types = {
        **dict.fromkeys(("x", "u", "p", "out"), table),
        **dict.fromkeys(("active", "fault"), flags),
        **dict.fromkeys(("steps", "each"), wp.int32),
        "h": number,
    }

    # Warp reads the text of a kernel; the types are given below, one set for each precision
    def stub(
        i: Any, x: Any, u: Any, p: Any, out: Any, active: Any, fault: Any, steps: Any,
        each: Any, h: Any,
    ) -> None: ...  # fmt: skip

    run = _native(wp, stub, text, types)

    def advance(
        x: Any, u: Any, p: Any, out: Any, active: Any, fault: Any, steps: Any, each: Any, h: Any
    ) -> None:
        run(wp.tid(), x, u, p, out, active, fault, steps, each, h)

    return _kernel(wp, advance, types)


def _map(wp: Any, text: str, real: str) -> Any:
    types = dict.fromkeys(("x", "p", "y"), wp.array2d(dtype=getattr(wp, real)))

    def stub(i: Any, x: Any, p: Any, y: Any) -> None: ...

    run = _native(wp, stub, text, types)

    def evaluate(x: Any, p: Any, y: Any) -> None:
        run(wp.tid(), x, p, y)

    return _kernel(wp, evaluate, types)


def _native(wp: Any, stub: Any, text: str, types: dict[str, Any]) -> Any:
    """A function whose body is the text; its name is its own, as Warp files it by that."""
    stub.__annotations__ = {"i": wp.int32, **types}
    stub.__qualname__ = f"run_{hashlib.sha256(text.encode()).hexdigest()[:16]}"
    return wp.func_native(text)(stub)


def _kernel(wp: Any, function: Any, types: dict[str, Any]) -> Any:
    """A kernel in a module of its own, without the code of derivatives."""
    function.__annotations__ = types
    return wp.kernel(function, enable_backward=False, module="unique")


def launch(kernel: Any, n: int, inputs: list[Any], device: Any) -> None:
    """Run a kernel on n simulations; a new one is compiled, or read from Warp's cache.

    Args:
        kernel: of this module.
        n: number of simulations.
        inputs: its arguments.
        device: of Warp.
    """
    wp = load_warp()
    if (kernel, str(device)) not in _LOADED:
        with _quiet(wp):
            wp.load_module(kernel.module, device=device, block_dim=THREADS)
        _LOADED.add((kernel, str(device)))
    wp.launch(kernel, dim=n, inputs=inputs, device=device, block_dim=THREADS)
