"""Resolved-rate control of the tool's place and orientation, redundancy spent on the base."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ves_gym._util.params import Array, Index
from ves_gym.baselines.controllers import reference_action, remember, require_fit, row_of_step
from ves_gym.baselines.resolved import LEVER, carried, damped_inverse, seen_from_base
from ves_gym.envs.pose_reach import PoseReach, goal_pose
from ves_gym.envs.scales import straight_energy, straight_motion
from ves_gym.envs.vector import VesVectorEnv
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.dynamics import inertia
from ves_gym.mechanics.kinematics import pose_dexterity, tool_frame, tool_twists
from ves_gym.mechanics.motion import QUINTIC_PEAK_SPEED, quintic
from ves_gym.mechanics.spatial import matvec, rotation, twist
from ves_gym.mechanics.tool_pose import configurations_at_each

_MOVE = 0.8  # share of an episode that the way to the pose takes
STARTS = 32  # of the inverse kinematics
_DAMPING = 0.03  # m/rad, of the least squares near singular configurations
_ROUNDS = 2  # of Newton's method per period
_FIRM = 2.0  # what is asked of the servos beyond their gains, as a multiple of them
_DEXTEROUS = 0.03  # m/rad, `pose_dexterity` below which a configuration counts as dearer
_REACTION = 10.0  # how much a joint motion that pushes the base counts beside one that does not


class ResolvedPose:
    """Leads the tool to a pose in space by joint rates that take back the base's motion.

    Of the configurations that bring the tool to the pose, base at rest, and that a straight
    quintic reaches within the speed limits, the one whose motion is expected to leave the base
    the least energy (`scales.straight_energy`) is planned for. In every period the plan is
    corrected by what the tool's six-row Jacobian says, by damped least squares, of the place
    and turn that are missing on the base as measured, and of the rate at which the base
    carries the tool along (resolved motion rate control: Whitney, IEEE Trans. Man-Machine
    Systems 10(2), 1969). Where joints are left over, of all corrections the one that reacts
    least on the base is taken: the least squares are weighted by the momentum that joint
    rates give the base. Servos are soft (a few Hz) beside a base that sways, so what the joints
    lag behind is asked for again, `_FIRM` times.
    """

    name = "resolved-pose"
    privileged = True
    _plan: Array  # (n, steps + 2, joints) rad
    _rate: Array  # (n, 6) twist of the base a period ago
    _commanded: Array  # (n, 2, joints) angles and rates for now, as of then

    def reset(self, env: VesVectorEnv, ids: Index) -> None:
        task, s = env.task, env.batch.scene
        fits = isinstance(task, PoseReach) and task.control.level == "reference"
        require_fit(self.name, fits, "leads the reference of task pose_reach", env)
        arm, steps = task.system.arm, task.steps
        shapes = {"_plan": (steps + 2, arm.n), "_commanded": (2, arm.n)}
        remember(self, env.num_envs, **shapes, _rate=(6,))
        self._rate[ids] = twist(s.y_seen[ids], s.yd_seen[ids])
        way = _MOVE * task.duration
        energy = straight_motion(task, way)
        share = quintic(np.arange(steps + 2) / (_MOVE * steps))[:, None]
        places, turns = goal_pose(s)
        every = configurations_for(arm, s.q[ids], places[ids], turns[ids])
        for i, ends in zip(ids.tolist(), every, strict=True):
            end = _kindest(arm, s.q[i], ends, way, energy)
            self._plan[i] = s.q[i] + share * (end - s.q[i])

    def act(self, env: VesVectorEnv, observation: Any) -> Array:
        s, arm, dt = env.batch.scene, env.task.system.arm, env.batch.dt
        before, present, then = (row_of_step(env, self._plan, k) for k in (0, 1, 2))
        y = s.y_seen + dt * s.yd_seen  # of the base at the period's end
        q, inverse = joints_at(arm, present, *pose_from_base(y, *tool_frame(arm, present)))
        rate = twist(y, s.yd_seen)
        gain, self._rate = (rate - self._rate) / dt, rate
        drift, gaining = (carried(k, tool_frame(arm, q)[0]) for k in (rate, gain))
        desired = (then - before) / (2 * dt) - matvec(inverse, drift)
        first = (env.batch.episodes.steps == 0)[:, None]
        behind = np.where(first, 0.0, self._commanded[:, 0] - s.q)
        slower = np.where(first, 0.0, self._commanded[:, 1] - s.v)
        self._commanded = np.stack([q, desired], axis=1)
        reference = [
            q + _FIRM * behind,
            desired + _FIRM * slower,
            (then - 2 * present + before) / dt**2 - matvec(inverse, gaining),
        ]
        return reference_action(env, env.task.control, np.stack(reference, axis=1))


def _kindest(arm: Arm, q: Array, ends: Array, seconds: float, energy: straight_energy) -> Array:
    """Of the angles `ends` (m, joints) in reach within `seconds` the kindest to the base."""
    speed = np.abs(ends - q) * (QUINTIC_PEAK_SPEED / seconds) / arm.column("v_max")
    excess = np.maximum(speed.max(axis=1) - 1, 0.0)
    near = np.flatnonzero(excess <= excess.min())
    stiff = np.maximum(_DEXTEROUS / pose_dexterity(arm, ends[near], LEVER), 1.0)
    costs = energy(np.tile(q, (len(near), 1)), ends[near]) * stiff**2
    chosen: Array = ends[near[costs.argmin()]]
    return chosen


def configurations_for(arm: Arm, q: Array, places: Array, turns: Array) -> list[Array]:
    """Joint angles (m, joints) that have the tool at poses, or where it is if there are none.

    Args:
        arm: whose joints.
        q: (k, joints) where it is [rad].
        places: (k, 3) of the tool [m].
        turns: (k, 3, 3) of the tool.
    """
    every = configurations_at_each(arm, places, turns, q, STARTS)
    # nothing better is known than to stay
    return [ends if len(ends) else at[None] for ends, at in zip(every, q, strict=True)]


def pose_from_base(y: Array, place: Array, turn: Array) -> tuple[Array, Array]:
    """Poses in the base's axes, (n, 3) [m] and (n, 3, 3), y (n, 6) the pose of the base."""
    return seen_from_base(y, place), np.swapaxes(rotation(y), -1, -2) @ turn


def joints_at(arm: Arm, q: Array, place: Array, turn: Array) -> tuple[Array, Array]:
    """Angles (n, joints) for poses by Newton's method from q, and the last round's inverse."""
    for _ in range(_ROUNDS):
        at, turned = tool_frame(arm, q)
        missing = Rotation.from_matrix(turn @ np.swapaxes(turned, -1, -2)).as_rotvec()
        inverse = inverse_sparing(arm, q)
        q = q + matvec(inverse, np.concatenate([place - at, missing], axis=1))
    return q, inverse


def inverse_sparing(arm: Arm, q: Array) -> Array:
    """(n, joints, 6) damped inverse of the tool's Jacobian that spares the base."""
    dear = None
    if arm.n > 6:
        H = inertia(arm, q)
        system, pushed = H[:, :6, :6], H[:, :6, 6:]
        pushing = np.swapaxes(pushed, -1, -2) @ np.linalg.solve(system, pushed)
        joints = np.trace(H[:, 6:, 6:], axis1=-2, axis2=-1)[:, None, None] / arm.n
        dear = np.eye(arm.n) + _REACTION * pushing / joints
    return damped_inverse(tool_twists(arm, q), _DAMPING, dear)
