"""Links that bend: an arm with flexures as the chain of all its joints.

For whatever does not ask here, an `Arm` with flexures is the arm with rigid links.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import Array
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.chain import flexures_as_links
from ves_gym.mechanics.dynamics import inertia
from ves_gym.mechanics.kinematics import Frames, frames, joint_positions


class ExpandedChain(NamedTuple):
    """An arm with all its joints as links, and which of them are passive."""

    arm: Arm  # n + p links, none of them bends
    driven: tuple[int, ...]  # (n,) place of each driven joint among all
    passive: tuple[int, ...]  # (p,) of each flexure
    stiffness: Array  # (p,) [N m/rad]
    damping: Array  # (p,) [N m s/rad]

    def angles(self, q: npt.ArrayLike, d: npt.ArrayLike = 0.0) -> Array:
        """Return coordinates, or rates, in the order of the chain (..., n + p), of driven
        joints (..., n) and deflections (..., p)."""
        driven, bent = np.asarray(q, float), np.asarray(d, float)
        batch = np.broadcast_shapes(driven.shape[:-1], bent.shape[:-1])
        out = np.empty((*batch, self.arm.n))
        out[..., list(self.driven)], out[..., list(self.passive)] = driven, bent
        return out

    def inertia(self, q: npt.ArrayLike, d: npt.ArrayLike) -> Array:
        """Return the inertia matrix (..., 6 + p + n, 6 + p + n) over base twist, flexures and
        driven joints, at q (..., n) and deflections (..., p) [rad]."""
        order = np.r_[:6, 6 + np.array(self.passive, int), 6 + np.array(self.driven, int)]
        H = inertia(self.arm, self.angles(q, d))
        return H[..., order[:, None], order]

    def tool(self, q: npt.ArrayLike, d: npt.ArrayLike) -> Array:
        """Return the tool's place (..., 3) in the platform-top frame [m], at q (..., n) and
        deflections (..., p) [rad]."""
        return joint_positions(self.arm, self.angles(q, d))[..., -1, :]


@lru_cache(maxsize=64)
def expand(arm: Arm) -> ExpandedChain:
    """Return the chain of all joints of an arm whose links may bend."""
    if not arm.bends:
        return ExpandedChain(arm, tuple(range(arm.n)), (), np.zeros(0), np.zeros(0))
    rigid, driven, passive, springs = flexures_as_links(arm)
    stiffness, damping = (
        np.array([getattr(k, s) for k in springs]) for s in ("stiffness", "damping")
    )
    return ExpandedChain(rigid, tuple(driven), tuple(passive), stiffness, damping)


def link_frames(arm: Arm, q: npt.ArrayLike, u: Array | None = None) -> Frames:
    """Return the frames of an arm's links, those between its flexures among them, at q (..., n)
    and, of u (..., p + m), its p deflections [rad] (None: straight)."""
    if not arm.bends:
        return frames(arm, q)
    chain = expand(arm)
    return frames(chain.arm, chain.angles(q, 0.0 if u is None else u[..., : arm.bends]))
