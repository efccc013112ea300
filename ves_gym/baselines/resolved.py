"""Resolved-motion control: joint rates that move the tool in space whatever the base does.

Of its place (`Resolved`), or of place and orientation, redundancy spent on the base
(`ResolvedPose`).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium.envs.registration import EnvSpec
from scipy.spatial.transform import Rotation

from ves_gym._util.params import Array, Index
from ves_gym.baselines.controllers import (
    FOLLOW,
    reference_action,
    remember,
    require_fit,
    row_of_step,
)
from ves_gym.envs.berthing_contact import MEET, BerthingContact
from ves_gym.envs.build import get_task
from ves_gym.envs.free_flyer import FreeFlyerReach
from ves_gym.envs.payload_transfer import PayloadTransfer
from ves_gym.envs.pose_reach import PoseReach, goal_pose
from ves_gym.envs.reach import Reach
from ves_gym.envs.scales import straight_energy, straight_motion
from ves_gym.envs.track import Track
from ves_gym.envs.vector import VesVectorEnv
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.attitude import to_matrix
from ves_gym.mechanics.dynamics import inertia, newton_euler
from ves_gym.mechanics.kinematics import (
    joint_positions,
    pose_dexterity,
    tool_frame,
    tool_jacobian,
    tool_twists,
)
from ves_gym.mechanics.latch import LatchTarget
from ves_gym.mechanics.motion import QUINTIC_PEAK_SPEED, quintic
from ves_gym.mechanics.spatial import matvec, rotation, twist, twist_rate
from ves_gym.mechanics.tool_pose import configurations_at_each, joints_for

_MOVE = 0.7  # share of an episode that the way to a target takes
_BEFORE = 0.38  # the same, until before a funnel
_PRESS = 0.03  # m, beyond the end of a funnel that is seen beside where it is
_LEGS = ((0.0, 0.37), (0.45, 0.8))  # the same of the two legs of payload_transfer
_CALM = 0.1  # s before the joints have to be at rest by which they slow down
_REST = 0.8  # of the rate that counts as rest, the most that they then have
_DAMPING = 0.05  # m/rad, of the least squares near singular configurations
LEVER = 0.3  # m per radian, of turn beside place
# of poses
_POSE_MOVE = 0.8  # share of an episode that the way to the pose takes
STARTS = 32  # of the inverse kinematics
_POSE_DAMPING = 0.03  # m/rad, of the least squares near singular configurations
_ROUNDS = 2  # of Newton's method per period
_FIRM = 2.0  # what is asked of the servos beyond their gains, as a multiple of them
_DEXTEROUS = 0.03  # m/rad, `pose_dexterity` below which a configuration counts as dearer
_REACTION = 10.0  # how much a joint motion that pushes the base counts beside one that does not


class Resolved:
    """Leads the tool along a path in space, by joint rates that take back the base's motion.

    The joints follow a plan for a base at rest: for task track the one that the Jacobian
    gives along the path, for berthing_contact too: before the client's funnel, then along its
    axis a little beyond its observed end, until the latch has closed; for reach and
    free_flyer the straight quintic to the nearest joint angles that bring the tool to the
    target, for payload_transfer two of them, to the payload and to the berth. In every period
    the plan is corrected by what the Jacobian says of the distance between path and tool, on
    the base as measured, and of the rate at which the base carries the tool along (resolved
    motion rate control: Whitney, IEEE Trans. Man-Machine Systems 10(2), 1969). At the end of
    free_flyer, whose joints must be at rest on a satellite that turns, they take back no more
    of that than `rest` allows.

    A servo's feed-forward takes the base for still. Where `braced`, the reference is shifted so
    that servo and feed-forward together add the torque of an accelerating base: for arms whose
    servos are soft; where they are stiff it changes little.

    Args:
        name: of the controller.
        follow: see `reference_action` [1/s].
        braced: against the base's acceleration.
    """

    privileged = True
    _plan: Array  # (n, steps + 2, joints) rad
    _path: Array  # (n, steps + 2, 3) of the tool in space [m]
    _base_rate: Array  # (n, 6) a period ago
    _shift: Array  # (n, 2, joints) of the reference, and its rate

    def __init__(
        self, name: str = "resolved", follow: float = FOLLOW, braced: bool = False
    ) -> None:
        self.name, self.follow, self.braced = name, follow, braced

    def settings(self, spec: EnvSpec) -> dict[str, Any]:
        """Joints to lead, where the task's own control moves the tool."""
        fields: Any = get_task(spec.kwargs["task"]).__dataclass_fields__
        chosen = "control" in spec.kwargs or fields["control"].default.per_joint
        return {} if chosen else {"control": {"kind": "joint_velocity"}}

    def reset(self, env: VesVectorEnv, ids: Index) -> None:
        task, s = env.task, env.batch.scene
        fits = isinstance(
            task, (BerthingContact, FreeFlyerReach, PayloadTransfer, Reach, Track)
        )
        require_fit(
            self.name,
            fits and task.control.level == "reference",
            "leads the reference of tasks reach, track, free_flyer, payload_transfer and"
            " berthing_contact",
            env,
        )
        arm, steps = task.system.arm, task.steps
        shapes = {"_plan": (steps + 2, arm.n), "_path": (steps + 2, 3)}
        remember(self, env.num_envs, **shapes, _base_rate=(6,), _shift=(2, arm.n))
        self._base_rate[ids], self._shift[ids] = s.yd_seen[ids], 0.0
        q = s.q[ids]
        if isinstance(task, (BerthingContact, Track)):
            if isinstance(task, Track):
                path = task.path(s)[ids]
            else:
                path = _into(task, s.tool[ids], s.goal[ids])
            plan = [q]
            for point in np.swapaxes(path[:, 1:], 0, 1):
                gap = point - joint_positions(arm, plan[-1])[:, -1]
                inverse = damped_inverse(tool_jacobian(arm, plan[-1]))
                plan.append(plan[-1] + matvec(inverse, gap))
            along = np.stack(plan, axis=1)
        elif isinstance(task, PayloadTransfer):
            along = q[:, None]
            clock = np.arange(steps + 1) / steps
            for goal, (leaves, arrives) in zip(
                (s.goal[ids, :3], s.goal[ids, 3:6]), _LEGS, strict=True
            ):
                before = along[:, -1]
                there, _ = joints_for(arm, goal, before)
                share = quintic((clock - leaves) / (arrives - leaves))[:, None]
                along = along + share * (there - before)[:, None]
            path = joint_positions(arm, along)[..., -1, :]
        else:
            end, _ = joints_for(arm, s.goal[ids, :3], q)
            share = quintic(np.arange(steps + 1) / (_MOVE * steps))[:, None]
            along = q[:, None] + share * (end - q)[:, None]
            path = joint_positions(arm, along)[..., -1, :]
        self._plan[ids] = np.concatenate([along, along[:, -1:]], axis=1)
        self._path[ids] = np.concatenate([path, path[:, -1:]], axis=1)

    def act(self, env: VesVectorEnv, observation: Any) -> Array:
        target = self._target(env)
        if self.braced:
            s, arm, q = env.batch.scene, env.task.system.arm, target[:, 0]
            slope = (s.yd_seen - self._base_rate) / env.batch.dt
            # of half a period ago: foreseen it was worse
            self._base_rate = s.yd_seen.copy()
            torque = base_torque(arm, q, target[:, 1], s.y_seen, s.yd_seen, slope)
            shift = servo_shift(env, q, self._shift, torque)
            self._shift = shift[:, :2]
            target = target + shift
        return reference_action(env, env.task.control, target, self.follow)

    def _target(self, env: VesVectorEnv) -> Array:
        """Return position, rate and acceleration at the period's end (n, 3, joints)."""
        s, arm, dt = env.batch.scene, env.task.system.arm, env.batch.dt
        before, present, then = (row_of_step(env, self._plan, k) for k in (0, 1, 2))
        y: Array = s.y_seen + dt * s.yd_seen  # of the base at the period's end
        reach = joint_positions(arm, present)[:, -1]
        aim = row_of_step(env, self._path, ahead=1)
        drift = carried(twist(y, s.yd_seen), reach)[:, :3]  # of the tool with the base
        if isinstance(env.task, BerthingContact):
            away, moving = self._follow_funnel(env)
            aim = aim + away
            drift = drift - matvec(np.swapaxes(rotation(y), -1, -2), moving)
        desired = seen_from_base(y, aim)
        inverse = damped_inverse(tool_jacobian(arm, present))
        angles = present + matvec(inverse, desired - reach)
        # once more: damping leaves up to a fifth of the gap where the arm is least dexterous
        angles += matvec(inverse, desired - joint_positions(arm, angles)[:, -1])
        reference = [
            angles,
            (then - before) / (2 * dt) - matvec(inverse, drift),
            (then - 2 * present + before) / dt**2,
        ]
        out = np.stack(reference, axis=1)
        if isinstance(env.task, BerthingContact):  # with a load, taking back the sway drives it
            latched = LatchTarget.of(s.payload).carried > 0
            out[latched] = _slowly(s.ref[latched], out[latched], 0.0, dt)
        if isinstance(env.task, FreeFlyerReach):
            remaining = env.task.duration - env.batch.episodes.steps * dt
            calm = remaining <= env.task.hold + _CALM
            out[calm] = _slowly(s.ref[calm], out[calm], _REST * env.task.rest, dt)
        return out

    def _follow_funnel(self, env: VesVectorEnv) -> tuple[Array, Array]:
        """Return the path's end less the planned one (n, 3) [m], and its velocity."""
        s, dt = env.batch.scene, env.batch.dt
        t = LatchTarget.of(s.payload)
        off = t.fixture + s.goal[:, 11:] + dt * t.fixture_velocity - s.goal[:, :3]
        share = quintic(s.time / (_BEFORE * env.task.duration))[:, None]
        return share * off, share * t.fixture_velocity


def _into(task: BerthingContact, start: Array, goal: Array) -> Array:
    """Path (k, steps + 1, 3) of the ball: before the funnel, then along its axis."""
    clock, axis = np.arange(task.steps + 1) / task.steps, to_matrix(goal[:, 3:7])[..., 2]
    before = goal[:, :3] - task.away * axis
    first = quintic(clock / _BEFORE)[:, None]
    second = quintic((clock - _BEFORE) / (MEET - _BEFORE))[:, None]
    along = (task.away + _PRESS) * axis
    way = first * (before - start)[:, None] + second * along[:, None]
    return np.asarray(start[:, None] + way)


def _slowly(ref: Array, then: Array, rate: float, dt: float) -> Array:
    """References (k, 3, joints) a period on: `then`, no joint faster than `rate` [rad/s]."""
    angle = np.clip(then[:, 0], ref[:, 0] - rate * dt, ref[:, 0] + rate * dt)
    slow = np.clip(then[:, 1], -rate, rate)
    return np.stack([angle, slow, np.zeros_like(slow)], axis=1)


def seen_from_base(y: Array, place: Array) -> Array:
    """Return places (n, 3) [m] in the axes of a base with pose y (n, 6)."""
    return matvec(np.swapaxes(rotation(y), -1, -2), place - y[:, :3])


def carried(base: Array, place: Array) -> Array:
    """Return the twist (n, 6) that a base's (n, 6) gives a place (n, 3), or the rate of it."""
    out = base.copy()
    out[:, :3] += np.cross(base[:, 3:], place)
    return out


def damped_inverse(J: Array, damping: float = _DAMPING, dear: Array | None = None) -> Array:
    """Return damped pseudo-inverses (..., n, m) of the tool's Jacobians.

    Args:
        J: (..., m, n) of places, m = 3, or of places and turns, m = 6.
        damping: of the least squares near singular configurations [m/rad].
        dear: (..., n, n) what joint rates cost beside each other; None: they are alike.
    """
    weighted = J.copy()
    weighted[..., 3:, :] *= LEVER
    across = np.swapaxes(weighted, -1, -2)
    if dear is not None:
        across = np.linalg.solve(dear, across).astype(float)
    out: Array = across @ np.linalg.inv(weighted @ across + damping**2 * np.eye(J.shape[-2]))
    out[..., 3:] *= LEVER
    return out


def servo_shift(env: VesVectorEnv, q: Array, before: Array, torque: Array) -> Array:
    """Return the shift s of a reference that servos and feed-forward turn into a torque.

    M(q) s'' + kd s' + kp s = torque, a period on by the implicit rule of Euler: s, s' and s''
    (n, 3, joints) from s and s' (n, 2, joints) `before`.
    """
    s, dt, arm = env.batch.scene, env.batch.dt, env.task.system.arm
    M = inertia(arm, q)[:, 6:, 6:]
    place, rate = before.swapaxes(0, 1)
    resists = M + (dt * s.kd + dt**2 * s.kp)[:, None] * np.eye(arm.n)
    push = matvec(M, rate) + dt * (torque - s.kp * place)
    after = np.linalg.solve(resists, push[..., None])[..., 0]
    return np.stack([place + dt * after, after, (after - rate) / dt], axis=1)


def base_torque(arm: Arm, q: Array, v: Array, y: Array, yd: Array, ydd: Array) -> Array:
    """Return the joint torques (k, n) [N m] that a moving base asks for beside a still one.

    Args:
        arm: n joints.
        q, v: (k, n) joint angles [rad] and rates [rad/s].
        y, yd, ydd: (k, 6) pose of the base and its derivatives.
    """
    moving, turning = twist(y, yd), twist_rate(y, yd, ydd)
    spin, none = moving[:, 3:], np.zeros_like(v)
    accel = turning[:, :3] + np.cross(spin, moving[:, :3])
    ridden, _ = newton_euler(arm, q, v, none, spin=spin, turn=turning[:, 3:], accel=accel)
    return ridden - newton_euler(arm, q, v, none)[0]


# ---------------------------------------------------------------------------- poses


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
    lag behind is commanded again, `_FIRM` times.
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
        way = _POSE_MOVE * task.duration
        energy = straight_motion(task, way)
        share = quintic(np.arange(steps + 2) / (_POSE_MOVE * steps))[:, None]
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
    """Joint angles (m, joints) that have the tool at each of k poses; q (k, joints) if none."""
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
    return damped_inverse(tool_twists(arm, q), _POSE_DAMPING, dear)
