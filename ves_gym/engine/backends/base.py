"""The interface of engines."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Protocol

from ves_gym._util.params import Array, Index, Mask

if TYPE_CHECKING:
    from ves_gym.engine.backends.compiled import EngineContact
    from ves_gym.system.effect_rows import EffectRows
    from ves_gym.system.system import System


class BackendWarning(UserWarning):
    """Another engine runs than the fastest one would be."""


class Backend(Protocol):
    """Engine as `Simulator` uses it. Leading axis = simulation.

    Arrays handed out are copies or read-only views; `z` stacks (Y, q), `zd` its rate. `ids`
    are the simulations (k,) that a call is about; of steps None stands for all.
    """

    name: str  # as in `BACKENDS`
    n: int
    contact: EngineContact | None  # of the tool, where the system and the engine have it

    def read(self) -> tuple[Array, Array, Array]:
        """Time (n,) [s], z (n, 6 + joints), zd (n, 6 + joints)."""

    def write(self, ids: Index, time: Array, z: Array, zd: Array) -> None:
        """Set time, z and zd (k, 6 + joints) and clear faults; gears are relaxed then, and
        oscillators at rest on the vehicle."""

    def set_gear_state(self, d: Array, rate: Array) -> None:
        """Set the gears' deflections of all simulations, (n, g) [rad], [rad/s]."""

    def set_base(self, ids: Index, y: Array, yd: Array) -> None:
        """Set the base's pose and rate (k, 6), and nothing else."""

    def set_gains(self, ids: Index, kp: Array, kd: Array) -> None:
        """Set servo gains (k, joints), active at every physics step [N m/rad], [N m s/rad]."""

    def set_carried(self, ids: Index, at: Array, rate: Array) -> None:
        """Set coordinates and rates (k, c) of wheels and appendages."""

    def set_rates(self, ids: Index, zd: Array, gears: Array) -> None:
        """Let rates jump, nothing else (`mechanics/latch.py`): zd (k, 6 + joints), and those
        (k, g + c) of the gears' deflections [rad/s], of wheels and appendages."""

    def set_last_link(self, ids: Index, mass: Array, com: Array, inertia: Array) -> None:
        """Change the last link, which carries something, or no longer: mass (k,) [kg], com
        (k, 3) in its frame [m], inertia (k, 3, 3) about that [kg m^2]."""

    def set_actuators(self, ids: Index, wrench: Array | None, torque: Array | None) -> None:
        """Set what jets and wheels do from now on: a wrench (k, 6) in platform axes at its
        origin [N, N m], and torque (k, w) on the wheels' rotors [N m]; None leaves them."""

    def assign(self, ids: Index, systems: Sequence[System]) -> None:
        """Give simulations systems of their own, alike in structure (`require_alike`); all or
        none of them. State and servo gains stay."""

    def assign_laws(self, ids: Index, rows: EffectRows) -> None:
        """Give simulations torque laws with parameters of their own; bodies stay."""

    def step_sequence(self, commands: Array, ids: Index | None) -> None:
        """Advance k physics steps under commands (n, k + 1, joints), linear over each."""

    def step_on_platform(self, commands: Array, base: Array, ids: Index | None) -> Array:
        """Advance k physics steps on a platform that moves as commanded (mode emulated).

        Args:
            commands: (n, k + 1, joints), base: (n, k + 1, 6) acceleration Y'', both linear
                over each step.

        Returns:
            (n, k + 1, 6) wrench of the arm on the platform at the steps' ends, in platform
            axes at its origin [N, N m]; the first under the new, the last under the old
            commands.
        """

    def internal_state(self) -> tuple[Array, Array]:
        """Coordinates and rates (n, g + c + m) of gears; in space, of what the base carries."""

    def evaluate(self, command: Array) -> tuple[Array, Array]:
        """Drive torque (n, joints) and acceleration zdd (n, 6 + joints) at this state."""

    def faults(self) -> Mask:
        """(n,) bool: simulations whose state is no longer meaningful."""

    def get_state(self) -> dict[str, Array]:
        """Arrays (n, ...) by name: everything needed to continue exactly from here."""

    def set_state(self, state: Mapping[str, Array]) -> None:
        """Return to a state handed out by `get_state`."""


MEANINGLESS = 1e10  # m, rad and their rates; where MuJoCo, too, gives a state up
