"""Engines that advance a batch of simulations of one System."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from ves_gym.core.params import Array, Index, Mask, ParameterError

if TYPE_CHECKING:
    from ves_gym.core.system import System


class Backend(Protocol):
    """What `Simulator` needs from an engine. Leading axis = simulation.

    Arrays handed out are copies or read-only views; `z` stacks (Y, q), `zd` its rate.
    """

    n: int

    def read(self) -> tuple[Array, Array, Array]:
        """Time (n,) [s], z (n, 6 + joints), zd (n, 6 + joints)."""

    def write(self, ids: Index, time: Array, z: Array, zd: Array) -> None:
        """Set the state of some simulations and clear their fault."""

    def set_gains(self, ids: Index, kp: Array, kd: Array) -> None:
        """Servo gains (k, joints) of some simulations, active at every physics step."""

    def step(
        self, command: Array, wrench: Array | None, substeps: int, ids: Index | None
    ) -> None:
        """Hold command (n, joints) and generalised base force (n, 6), advance."""

    def play(self, commands: Array, ids: Index | None) -> None:
        """Advance k physics steps, commands (n, k + 1, joints) linear over each step."""

    def evaluate(self, command: Array) -> tuple[Array, Array]:
        """Drive torque (n, joints) and acceleration zdd (n, 6 + joints) at this state."""

    def faults(self) -> Mask:
        """(n,) bool: simulations whose state is no longer meaningful."""

    def get_state(self) -> object:
        """Everything needed to continue exactly from here."""

    def set_state(self, state: object) -> None:
        """Return to a state handed out by `get_state`."""


BACKENDS = ("mujoco",)


def make_backend(name: str, system: System, n: int, threads: int) -> Backend:
    """Build a backend by name; unknown names are an error that lists the known ones."""
    if name not in BACKENDS:
        raise ParameterError(f"backend must be one of {', '.join(BACKENDS)}, got {name!r}")
    from ves_gym.core.backends.mujoco import MujocoBackend

    return MujocoBackend(system, n, threads)
