"""CasADi graphs as Warp kernels: one simulation a thread, on a GPU or Warp's CPU device.

Warp compiles them on first use and keeps the machine code in its own cache, by their text.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib
from collections.abc import Iterator
from typing import Any

from ves_gym.engine.kernel.scalar import advance_text, graph_text

THREADS = 64  # of a block; one takes all the registers that it can have
_SLOTS = tuple(f"a{k}" for k in range(12))  # arrays of a graph's kernel, unused ones included
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


def advance_kernel(
    motion: Any, observe: Any | None, integrator: str, order: int, real: str
) -> Any:
    """Return the kernel of `scalar.advance_text`, which see."""
    return _advance(load_warp(), advance_text(motion, observe, integrator, order, real), real)


def graph_kernel(graph: Any, real: str, shared: tuple[int, ...] = ()) -> Any:
    """Return the kernel of `scalar.graph_text`, which see, to be run by `launch_graph`."""
    return _graph(load_warp(), graph_text(graph, real, shared), real)


def _advance(wp: Any, text: str, real: str) -> Any:
    number = getattr(wp, real)
    table, flags = wp.array2d(dtype=number), wp.array(dtype=wp.int32)
    types = {
        **dict.fromkeys(("x", "u", "p", "out"), table),
        **dict.fromkeys(("active", "fault"), flags),
        "steps": wp.int32,
        "h": number,
    }

    # Warp reads the text of a kernel; the types are given below, one set for each precision
    def stub(
        i: Any, x: Any, u: Any, p: Any, out: Any, active: Any, fault: Any, steps: Any, h: Any
    ) -> None: ...  # fmt: skip

    run = _native(wp, stub, text, types)

    def advance(
        x: Any, u: Any, p: Any, out: Any, active: Any, fault: Any, steps: Any, h: Any
    ) -> None:
        run(wp.tid(), x, u, p, out, active, fault, steps, h)

    return _kernel(wp, advance, types)


def _graph(wp: Any, text: str, real: str) -> Any:
    types = dict.fromkeys(_SLOTS, wp.array2d(dtype=getattr(wp, real)))

    def stub(
        i: Any, a0: Any, a1: Any, a2: Any, a3: Any, a4: Any, a5: Any, a6: Any, a7: Any, a8: Any,
        a9: Any, a10: Any, a11: Any,
    ) -> None: ...  # fmt: skip

    run = _native(wp, stub, text, types)

    def evaluate(
        a0: Any, a1: Any, a2: Any, a3: Any, a4: Any, a5: Any, a6: Any, a7: Any, a8: Any,
        a9: Any, a10: Any, a11: Any,
    ) -> None:  # fmt: skip
        run(wp.tid(), a0, a1, a2, a3, a4, a5, a6, a7, a8, a9, a10, a11)

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


def launch(kernel: Any, n: int, inputs: list[Any], device: Any, record: bool = False) -> Any:
    """Run a kernel on n simulations; a new one is compiled, or read from Warp's cache.

    Args:
        kernel: of this module.
        n: number of simulations.
        inputs: its arguments.
        device: of Warp.
        record: return the command, whose `launch()` runs it again and again, instead.
    """
    wp = load_warp()
    if (kernel, str(device)) not in _LOADED:
        with _quiet(wp):
            wp.load_module(kernel.module, device=device, block_dim=THREADS)
        _LOADED.add((kernel, str(device)))
    options = {"device": device, "block_dim": THREADS, "record_cmd": record}
    return wp.launch(kernel, dim=n, inputs=inputs, **options)


def launch_graph(kernel: Any, arrays: list[Any], device: Any, record: bool = False) -> Any:
    """`launch` of a `graph_kernel`.

    Args:
        kernel: of `graph_kernel`.
        arrays: (k, n) each: the graph's inputs, then its results.
        device, record: see `launch`.
    """
    filled = [*arrays, *[arrays[-1]] * (len(_SLOTS) - len(arrays))]
    return launch(kernel, arrays[-1].shape[1], filled, device, record)
