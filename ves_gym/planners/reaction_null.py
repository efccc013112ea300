"""Motion without reaction: along the null space of the base's coupling with the joints.

Joint rates with H_bm(q) q' = 0 leave the base at rest (reaction null space, Nenchev et al.
1999), of dimension n - 6 in general; a free-floating base keeps its attitude where the
disturbance matrix has a null space, of dimension n - 3. Arms with fewer joints have at
places a direction that nearly is one.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import Array, ParameterError
from ves_gym.mechanics.motion import Motion
from ves_gym.planners.coupling import blocks
from ves_gym.planners.hotspot import feasible_part
from ves_gym.planners.prediction import predict
from ves_gym.planners.query import NoPlan, Query
from ves_gym.system.system import System

NEARLY = 0.02  # of the largest coupling (root of the eigenvalue) that counts as none
_STEP = 0.02  # rad along the null space
_LITTLE = 0.1  # of the way to go: a null direction that leads less far on is left
_LONGEST = 2000  # steps


def reaction_null_space(
    system: System, q: npt.ArrayLike, *, attitude: bool = False, share: float = 1e-9
) -> Array:
    """Orthonormal joint directions without reaction on the base, at one configuration.

    Args:
        q: (n,) [rad].
        attitude: only the rotation of a free-floating base has to rest.
        share: of the largest coupling (root of Q's eigenvalue) at which a direction counts.

    Returns:
        (n, k) columns; k = 0 where there is none.
    """
    at = system.arm.require_within_limits(q)
    if not 0 <= share < 1:
        raise ParameterError(f"share must be >= 0 and < 1, got {share}")
    b, K = blocks(system, at), system.base.full()[2]
    moved = np.linalg.solve(b.Mt, b.Hbm)  # of the base, per joint motion
    if attitude:
        rows = moved[3:6]
    elif K.any():  # so that rows^T rows = Q
        values, vectors = np.linalg.eigh(K)
        rows = np.sqrt(np.maximum(values, 0.0))[:, None] * (vectors.T @ moved)
    else:
        rows = np.linalg.cholesky(b.Mt).T @ moved
    _, values, vectors = np.linalg.svd(rows)
    size = np.zeros(system.arm.n)
    size[: len(values)] = values
    return vectors[size <= share * values[0]].T


class ReactionNull:
    """From both ends along (nearly) reactionless directions, the rest straight."""

    name = "reaction-null"
    summary = "along (nearly) reactionless directions from both ends, straight between"

    def __init__(self, share: float = NEARLY) -> None:
        self.share = share

    def find(self, query: Query, seed: int) -> tuple[Motion, dict[str, Any]]:
        """Follow null directions from both ends; deterministic.

        Args:
            query: the ends, the duration and limits.
            seed: not used.

        Returns:
            The motion, and the share of its length along null directions [1].
        """
        start, goal = query.ends
        ahead = self._flow(query.system, start, goal)
        back = self._flow(query.system, goal, ahead[-1])
        path = np.vstack([ahead, back[::-1]])
        path = path[np.r_[True, np.linalg.norm(np.diff(path, axis=0), axis=1) > 1e-9]]
        motion, share = feasible_part(query, path if len(path) > 1 else np.array([start, goal]))
        lengths = [
            float(np.linalg.norm(np.diff(k, axis=0), axis=1).sum()) for k in (ahead, back)
        ]
        gap = float(np.linalg.norm(ahead[-1] - back[-1]))
        self._require_less(query, motion, moved=sum(lengths) > 0)
        return motion, {
            "null_share": sum(lengths) / max(sum(lengths) + gap, 1e-300),  # of the length
            "share": share,  # of the way from the straight line that the limits allow
        }

    def _require_less(self, query: Query, motion: Motion, moved: bool) -> None:
        """Raise NoPlan where an arm that cannot be reactionless gains nothing by trying.

        Args:
            moved: some of the way is along a (nearly) reactionless direction.
        """
        free, (start, goal) = not query.system.base.K.any(), query.ends
        spaces = (reaction_null_space(query.system, q, attitude=free) for q in (start, goal))
        if np.array_equal(start, goal) or any(space.shape[1] for space in spaces):
            return
        n, rest = query.system.arm.n, "keeps a free base from turning" if free else "spares it"
        why = (
            f"no reactionless motion: every motion of {n} joints moves this base; in general it"
            f" takes {4 if free else 7} joints for one that {rest}"
        )
        if not moved:
            raise NoPlan(why)
        ours, straight = (
            predict(query.system, m, query.servo, base=query.base).E_mean
            for m in (motion, query.straight)
        )
        if ours > straight:
            raise NoPlan(
                f"{why}; what comes nearest costs {ours / straight:.3g} x the straight line"
            )

    def _flow(self, system: System, start: Array, goal: Array) -> Array:
        """(k, n) configurations from start towards goal along null directions."""
        arm, path = system.arm, [start]
        low, high = arm.column("q_min"), arm.column("q_max")
        free = not system.base.K.any()
        for _ in range(_LONGEST):
            q, distance = path[-1], float(np.linalg.norm(goal - path[-1]))
            way = self._way(system, q, goal, free)
            length = float(np.linalg.norm(way))
            if length < _LITTLE * distance or length < 1e-9:
                break
            step = min(_STEP / length, 1.0)
            middle = np.clip(q + 0.5 * step * way, low, high)
            q = q + step * self._way(system, middle, goal, free)
            if (q < low).any() or (q > high).any() or np.linalg.norm(goal - q) >= distance:
                break
            path.append(q)
        return np.array(path)

    def _way(self, system: System, q: Array, goal: Array, free: bool) -> Array:
        """The part of the way to the goal that lies in the null space."""
        null = reaction_null_space(system, q, attitude=free, share=self.share)
        return null @ (null.T @ (goal - q))
