"""Small motions of arm and base about joints at q: M(q) x'' + D x' + K x = 0.

x stacks the base's coordinates (pose Y, deflections of the arm's flexures, then what is hidden
in the base: wheels, appendages, internal modes), angles of the motors, deflections of geared
links against their motors. No servo: its gains are D and K of the motors.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import Array, Index
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.base_model import BaseModel
from ves_gym.mechanics.dynamics import inverse_dynamics
from ves_gym.mechanics.flexure import ExpandedChain, expand
from ves_gym.mechanics.kinematics import joint_positions, tool_jacobian
from ves_gym.mechanics.modes import InertiaBlocks
from ves_gym.mechanics.spatial import skew


@dataclass(frozen=True, eq=False)
class LinearMotion:
    """M, D, K of an arm on a base, and where in x what stands."""

    arm: Arm
    base: BaseModel

    @property
    def b(self) -> int:
        """Number of the base's coordinates, which come first."""
        return 6 + self.arm.bends + self.base.hidden

    @property
    def bends(self) -> Index:
        """Places of the flexures."""
        return np.arange(6, 6 + self.arm.bends)

    @property
    def wheels(self) -> Index:
        """Places of reaction wheels."""
        return 6 + self.arm.bends + np.arange(len(self.base.wheels))

    @property
    def motors(self) -> Index:
        """Places of the motors."""
        return self.b + np.arange(self.arm.n)

    @property
    def gears(self) -> Index:
        """Places of the gears' deflections."""
        return self.b + self.arm.n + np.arange(len(self.arm.geared))

    @property
    def size(self) -> int:
        """Number of all coordinates."""
        return self.b + self.arm.n + len(self.arm.geared)

    @property
    def passive(self) -> Index:
        """Places of flexures and gears."""
        return np.concatenate([self.bends, self.gears])

    @cached_property
    def _rigid(self) -> Array:
        """(6 + p + n, size) Y, flexures and links per coordinate."""
        p, arm = self.arm.bends, self.arm
        out = np.zeros((6 + p + arm.n, self.size))
        out[: 6 + p, : 6 + p] = np.eye(6 + p)
        out[6 + p :, self.motors] = np.eye(arm.n)
        out[[6 + p + i for i in arm.geared], self.gears] = 1.0
        return out

    @property
    def joints(self) -> Array:
        """(n + p, size) joints of `links`, in their order, per coordinate."""
        chain, p = self.links, self.arm.bends
        out = np.zeros((p + self.arm.n, self.size))
        out[[*chain.passive, *chain.driven]] = self._rigid[6:]
        return out

    @cached_property
    def _constant(self) -> tuple[Array, Array, Array]:
        """M, D, K (size, size) that no configuration changes; M less the geared rotors."""
        arm, chain = self.arm, expand(self.arm)
        M, D, K = np.zeros((3, self.size, self.size))
        at = np.r_[:6, 6 + arm.bends : self.b]
        for part, block in zip((M, D, K), self.base.full(), strict=True):
            part[at[:, None], at] = block
        rotors = np.array([k in arm.geared for k in range(arm.n)]) * arm.column("rotor_inertia")
        M[self.motors, self.motors] = rotors
        springs = [arm.links[i].gear for i in arm.geared]
        for part, name in ((D, "damping"), (K, "stiffness")):
            values = [*getattr(chain, name), *(getattr(gear, name) for gear in springs)]
            part[self.passive, self.passive] = values
        return M, D, K

    @property
    def D(self) -> Array:
        """(size, size) damping."""
        return self._constant[1].copy()

    @property
    def K(self) -> Array:
        """(size, size) stiffness."""
        return self._constant[2].copy()

    @cached_property
    def links(self) -> ExpandedChain:
        """All joints, the rotors of gears left out: what hangs on the gears."""
        loose = tuple(
            replace(link, rotor_inertia=0.0, gear=None) if link.gear is not None else link
            for link in self.arm.links
        )
        return expand(self.arm if not self.arm.geared else replace(self.arm, links=loose))

    def inertia(self, q: npt.ArrayLike) -> Array:
        """Inertia (..., 6 + p + n, 6 + p + n) over base twist, flexures and links at q."""
        return self.links.inertia(q, np.zeros(self.arm.bends))

    def mass(self, H: Array) -> Array:
        """M (..., size, size) from `inertia`."""
        return self._rigid.T @ H @ self._rigid + self._constant[0]

    def blocks(self, q: npt.ArrayLike) -> InertiaBlocks:
        """Return the inertia blocks of base and motors, gears locked, at q (..., n) [rad]."""
        M, b, motors = self.mass(self.inertia(q)), self.b, self.motors
        return InertiaBlocks(
            M[..., :b, :b], M[..., :b, motors], M[..., motors[:, None], motors]
        )

    def loads(self, q: Array, v: Array, a: Array) -> Array:
        """Torque (..., k) that a motion q, v, a (..., n) on a base that stands still asks of
        the springs of flexures and gears [N m]."""
        chain = self.links
        at = [chain.angles(part) for part in (q, v, a)]
        torque, _ = inverse_dynamics(chain.arm, *at)
        return torque[..., self.loaded]

    def tool(self, q: Array) -> Array:
        """Way of the tool (..., 3, size) per coordinate, joints at q (..., n) [m]."""
        chain, p = self.links, self.arm.bends
        angles = chain.angles(q, np.zeros(p))
        by_joints = tool_jacobian(chain.arm, angles)
        rows = np.zeros((*by_joints.shape[:-1], len(self._rigid)))
        rows[..., :3] = np.eye(3)
        rows[..., 3:6] = -skew(joint_positions(chain.arm, angles)[..., -1, :])
        rows[..., 6:] = by_joints[..., [*chain.passive, *chain.driven]]
        return rows @ self._rigid

    @property
    def loaded(self) -> list[int]:
        """Places of flexures and gears among the joints of `links`."""
        return [*self.links.passive, *(self.links.driven[i] for i in self.arm.geared)]
