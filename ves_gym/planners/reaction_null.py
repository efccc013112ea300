"""Motion without reaction: along the null space of the base's coupling with the joints.

Joint rates with H_bm(q) q' = 0 leave the base at rest (reaction null space, Nenchev et al.
1999), of dimension n - 6 in general; a free-floating base keeps its attitude where the
disturbance matrix has a null space, of dimension n - 3. Arms with fewer joints have at
places a direction that nearly is one.

Along the null space an arm moves without any reaction: with seven joints on a flexible base one
such curve goes through every configuration. Two given ends seldom lie on the same curve:
planner reaction-null gives the motion of least reaction between them and says what is left.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.linalg

from ves_gym._util.params import Array
from ves_gym.mechanics.dynamics import inertia
from ves_gym.mechanics.modes import root
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.spatial import skew
from ves_gym.planners.coupling import blocks, stiffness
from ves_gym.planners.momentum import BaseMomentum, momentum
from ves_gym.planners.motion_problem import MotionProblem
from ves_gym.planners.objective import QuadraticForm
from ves_gym.planners.paths import feasible_part
from ves_gym.planners.prediction import NODES, predict
from ves_gym.planners.query import NoPlan, Query
from ves_gym.planners.sequential import minimise
from ves_gym.system.system import System

NEARLY = 0.02  # of the largest coupling (root of the eigenvalue) that counts as none
_STEP = 0.02  # rad along the null space
_LITTLE = 0.1  # of the way to go: a null direction that leads less far on is left
_LONGEST = 2000  # steps
_TRULY = 1e-9  # of the largest coupling: rounding
_FREE = 16  # control points of a motion of least reaction
_ITERATIONS = 60  # of its optimisation, in each round
_MISSED = 1e-4  # of a limit that a minimum may break
_SAMPLES = 97  # of a motion, for its share along null directions


def reaction_null_space(
    system: System, q: npt.ArrayLike, *, attitude: bool = False, share: float = 1e-9
) -> Array:
    """Orthonormal joint directions (n, k) without reaction on the base, at one configuration.

    Args:
        system: arm and vehicle.
        q: (n,) [rad].
        attitude: only the rotation of a free-floating base has to rest.
        share: of the largest coupling (root of Q's eigenvalue) at which a direction counts.
    """
    at = system.arm.require_within_limits(q)
    b, K = blocks(system, at), stiffness(system)
    moved = np.linalg.solve(b.Mt, b.Hbm)  # of the base, per joint motion
    # rows^T rows = Q, of a free base its kinetic energy
    rows = moved[3:6] if attitude else root(K if K.any() else b.Mt) @ moved
    return np.asarray(scipy.linalg.null_space(rows, rcond=share))


def _over_straight(query: Query, motion: Motion) -> float:
    """Predicted E_mean over the straight line's."""
    ours, straight = (
        predict(query.system, m, query.servo, base=query.base).E_mean
        for m in (motion, query.straight)
    )
    return ours / max(straight, 1e-300)


def _none_for(n: int, free: bool) -> str:
    effect = "keeps a free base from turning" if free else "spares it"
    return (
        f"no reactionless motion: every motion of {n} joints moves this base; in general it"
        f" takes {4 if free else 7} joints for one that {effect}"
    )


class ReactionNull:
    """Motion of least reaction where an arm can be reactionless, else along what nearly is.

    An arm with a reaction null space at both ends takes the motion of least reaction: none at
    all where null directions join the ends. Another goes along (nearly) reactionless directions
    from both ends, the rest straight.
    """

    name = "reaction-null"
    summary = "least reaction; of arms that cannot be reactionless, along what nearly is"

    def __init__(self, share: float = NEARLY) -> None:
        self.share = share

    def find(self, query: Query, seed: int) -> tuple[Motion, dict[str, Any]]:
        """Follow null directions from both ends, or minimise the reaction; deterministic.

        Raises:
            NoPlan: an arm that cannot be reactionless gains nothing by trying.
        """
        stays = query.start == query.goal
        query.system.arm.require_rigid("planner reaction-null")
        free = not query.system.base.K.any()
        null = [reaction_null_space(query.system, q, attitude=free) for q in query.ends]
        if all(space.shape[1] for space in null) and not stays:
            return _least(query, free)
        ahead, back = flows = _flows(query, free, self.share)
        motion, share = feasible_part(query, _joined(query, *flows))
        length = sum(float(np.linalg.norm(np.diff(k, axis=0), axis=1).sum()) for k in flows)
        gap = float(np.linalg.norm(ahead[-1] - back[-1]))
        if not stays and not any(space.shape[1] for space in null):
            why = _none_for(query.system.arm.n, free)
            if length == 0:
                raise NoPlan(why)
            ratio = _over_straight(query, motion)
            if ratio > 1:
                raise NoPlan(f"{why}; what comes nearest costs {ratio:.3g} x the straight line")
        return motion, {
            "null_share": length / max(length + gap, 1e-300),  # of the length
            "share": share,  # of the way from the straight line that the limits allow
        }


def _least(query: Query, free: bool) -> tuple[Motion, dict[str, Any]]:
    """Least reaction from the straight line and, where it leads on, from the null space."""
    problem = ReactionProblem(query, _FREE)
    starts = [problem.straight]
    ahead, back = _flows(query, free, _TRULY)
    if len(ahead) + len(back) > 2:
        path = _joined(query, ahead, back)
        starts.append(problem.of(Motion.through(path, query.duration)))
    minima = [minimise(problem, x, _ITERATIONS) for x in starts]
    best = min(minima, key=lambda m: (m.excess > _MISSED, m.energy))
    motion = problem.motion(best.x)
    remaining = problem.reaction(best.x) / max(problem.reaction(problem.straight), 1e-300)
    ratio = 0.0 if free else _over_straight(query, motion)
    if ratio > 1:
        raise NoPlan(
            f"no reactionless motion joins these ends: {100 * remaining:.3g} % of the"
            f" straight line's reaction is left at least, at {ratio:.3g} x its energy"
        )
    info = {"null_share": _null_share(query.system, motion, free), "reaction": remaining}
    return motion, info | best.info()


def _flows(query: Query, free: bool, share: float) -> tuple[Array, Array]:
    """(k, n) configurations from both ends towards each other, along null directions."""
    arm, (start, goal) = query.system.arm, query.ends
    low, high = arm.column("q_min"), arm.column("q_max")

    def way(q: Array, goal: Array) -> Array:
        """The part of the way to the goal that lies in the null space."""
        null = reaction_null_space(query.system, q, attitude=free, share=share)
        return np.asarray(null @ (null.T @ (goal - q)))

    def flow(start: Array, goal: Array) -> Array:
        path = [start]
        for _ in range(_LONGEST):
            q, distance = path[-1], float(np.linalg.norm(goal - path[-1]))
            on = way(q, goal)
            length = float(np.linalg.norm(on))
            if length < _LITTLE * distance or length < 1e-9:
                break
            step = min(_STEP / length, 1.0)
            q = q + step * way(np.clip(q + 0.5 * step * on, low, high), goal)
            if (q < low).any() or (q > high).any() or np.linalg.norm(goal - q) >= distance:
                break
            path.append(q)
        return np.array(path)

    ahead = flow(start, goal)
    return ahead, flow(goal, ahead[-1])


def _joined(query: Query, ahead: Array, back: Array) -> Array:
    """Way-points (k, n) [rad] along the flows from both ends, without repeated ones."""
    path = np.vstack([ahead, back[::-1]])
    path = path[np.r_[True, np.linalg.norm(np.diff(path, axis=0), axis=1) > 1e-9]]
    return path if len(path) > 1 else np.array(query.ends)


def _null_share(system: System, motion: Motion, free: bool) -> float:
    """Share of a motion's length in joint space that lies in the null space [1]."""
    s = motion.at(np.linspace(0, motion.duration, _SAMPLES))
    low, high = system.arm.column("q_min"), system.arm.column("q_max")
    along = 0.0
    for q, v in zip(np.clip(s.q, low, high), s.v, strict=True):
        null = reaction_null_space(system, q, attitude=free)
        along += float(np.linalg.norm(null.T @ v))
    return along / max(float(np.linalg.norm(s.v, axis=1).sum()), 1e-300)


class ReactionProblem(MotionProblem):
    """Mean square reaction of a query's motions, and their limits, by free control points x."""

    def __init__(self, query: Query, free: int) -> None:
        self._body: Array | None = None
        if not query.system.base.K.any():
            self._body = query.system.base.mass_matrix[:6, :6]
        start, goal = query.ends
        weight = _weight(query.system, (start + goal) / 2)
        super().__init__(query, free, MeanSquare(weight, query.duration))

    def momentum(self, x: Array) -> tuple[Array, Array]:
        """Samples of what the base has to balance, and their derivative by x.

        Momentum (6 (N + 1),); of a free base the angular part about the common centre of mass
        (3 (N + 1),) [kg m^2/s].
        """
        position, velocity, _ = self._bases
        control = self.control(x)
        q = position @ control
        sample = momentum(self.arm, q, velocity @ control)
        if self._body is not None:
            sample = _about_centre(sample, inertia(self.arm, q)[:, :6, :6] + self._body)
        return self.chained(sample)

    def reaction(self, x: Array) -> float:
        """Root mean square reaction [J^(1/2)/s; of a free base rad/s]."""
        return float(np.sqrt(2 * self.energy.value(self.momentum(x)[0])))


class MeanSquare(QuadraticForm):
    """Half the mean over time of u^T weight u, u (N + 1, k), in the place of E_mean."""

    def __init__(self, weight: Array, duration: float) -> None:
        self.t = np.linspace(0, duration, NODES + 1)
        share = np.full(NODES + 1, 1 / NODES)  # of the trapezoid rule
        share[[0, -1]] /= 2
        size = len(share) * len(weight)
        form = np.zeros((size + 1, size + 1))
        form[:-1, :-1] = np.kron(np.diag(share), weight) / 2
        super().__init__(form)


def _weight(system: System, at: Array) -> Array:
    """R^T R of the momentum (6, 6), or of a free base's angular one about the centre (3, 3)."""
    Mt, K = blocks(system, at).Mt, stiffness(system)
    if system.base.K.any():
        moved = np.linalg.inv(Mt)[:, :6]
        return np.asarray(moved.T @ K @ moved, np.float64)
    mass = Mt[0, 0]
    centre = skew(_centre(Mt))
    turned = np.linalg.inv(Mt[3:6, 3:6] - mass * centre @ centre.T)
    return np.asarray(turned.T @ turned, np.float64)


def _centre(M: Array) -> Array:
    """Centre of mass (..., 3) [m] from a spatial inertia (..., 6, 6)."""
    return np.stack([M[..., 5, 1], M[..., 3, 2], M[..., 4, 0]], axis=-1) / M[..., :1, 0]


def _about_centre(sample: BaseMomentum, M: Array) -> BaseMomentum:
    """Angular momentum of the joints about the common centre of mass, M the inertia of all."""
    u, by_q, by_v = sample
    centre, moved = _centre(M), by_v[:, :3] / M[:, :1, :1]  # its derivative by the joints
    push = u[:, :3]
    return BaseMomentum(
        u[:, 3:6] - np.cross(centre, push),
        by_q[:, 3:6]
        - np.cross(moved, push[:, :, None], axis=1)
        - np.cross(centre[:, :, None], by_q[:, :3], axis=1),
        by_v[:, 3:6] - np.cross(centre[:, :, None], by_v[:, :3], axis=1),
    )
