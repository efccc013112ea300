"""Engines that advance a batch of simulations of one System, by name."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING

from ves_gym._util.optional import require
from ves_gym._util.params import ParameterError, require_one_of
from ves_gym.engine.backends.base import Backend, BackendWarning
from ves_gym.mechanics.vehicle import orbit_of

if TYPE_CHECKING:
    from ves_gym.system.system import System

BACKENDS = ("auto", "kernel", "mujoco", "gpu-kernel", "gpu-kernel-float32")


def make_backend(name: str, system: System, n: int, threads: int) -> Backend:
    """Build a backend by name; unknown names are an error that lists the known ones.

    `auto` is the compiled kernel, and MuJoCo with a `BackendWarning` where a kernel cannot be
    compiled on this machine.

    Raises:
        ParameterError: unknown name, `kernel` where it cannot be compiled, or MuJoCo for a
            system with contact or on an orbit.
    """
    require_one_of("backend", name, BACKENDS)
    if name not in ("auto", "kernel", "mujoco"):
        require(f"backend {name}", "warp")
        from ves_gym.engine.backends.gpu_kernel import KINDS

        return next(kind for kind in KINDS.values() if kind.name == name)(system, n, threads)
    if name != "mujoco":
        try:
            from ves_gym.engine.backends.kernel import KernelBackend

            return KernelBackend(system, n, threads)
        except (ImportError, RuntimeError, OSError) as error:
            reason = f"the kernel cannot be compiled here ({type(error).__name__}: {error})"
            if name == "kernel" or system.contact is not None or orbit_of(system.vehicle):
                raise ParameterError(f"backend kernel: {reason}") from error
            warnings.warn(f"{reason}; MuJoCo runs instead", BackendWarning, stacklevel=3)
    if system.contact is not None:
        raise ParameterError(
            "backend mujoco has no contact at the tool: use kernel (or auto), or a system"
            " without contact"
        )
    if orbit_of(system.vehicle) is not None:
        raise ParameterError(
            "backend mujoco has no gravity gradient: use kernel (or auto), or a satellite"
            " without orbit"
        )
    from ves_gym.engine.backends.mujoco import MujocoBackend

    return MujocoBackend(system, n, threads)
