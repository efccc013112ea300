"""Controllers: one interface for built-in ones, planners and learned policies.

A controller acts on a whole `VesVectorEnv`. One that is `privileged` reads the true state of
the simulations (`env.batch.scene`): base pose and rate as they are, reference and goal; the
others decide by the observation alone, as a policy does.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from ves_gym._util.params import Array, Index, ParameterError
from ves_gym.envs.control import Control, Gains, Torque
from ves_gym.envs.rest_to_rest import RestToRest
from ves_gym.envs.vector import VesVectorEnv
from ves_gym.mechanics.dynamics import inverse_dynamics
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.servo import OWN_GAINS, JointServo, own_gains

if TYPE_CHECKING:
    from ves_gym.planners.prediction import BaseState
    from ves_gym.planners.query import Query
    from ves_gym.system.system import System

FOLLOW = 24.0  # 1/s: how fast a follower takes back its distance from the plan, by default
_TORQUE_FOLLOW = 12.0  # 1/s: slower, for its torque is held over a control period


class Controller(Protocol):
    """Agent on a vector environment. Every array has the leading axis env.num_envs.

    One that needs settings of the environment has a method `settings(spec)` that returns
    `evaluate` which, by the specification of the registered id.
    """

    name: str

    @property
    def privileged(self) -> bool:
        """True if it reads the true state."""

    def reset(self, env: VesVectorEnv, ids: Index) -> None:
        """Episodes have begun in the environments `ids`."""

    def act(self, env: VesVectorEnv, observation: Any) -> Array:
        """Actions (n, a) for the present observation."""


def require_fit(name: str, fits: bool, work: str, env: VesVectorEnv) -> None:
    """Refuse an environment that a controller cannot act on; `work` is what it does."""
    if not fits:
        raise ParameterError(
            f"controller {name} {work}, got task {env.task.kind} through control"
            f" {env.task.control.kind}"
        )


def remember(controller: object, n: int, **shapes: tuple[int, ...]) -> None:
    """Give a controller arrays (n, ...) of zeros as attributes; those of their shape stay."""
    for name, shape in shapes.items():
        if np.shape(getattr(controller, name, ())) != (n, *shape):
            setattr(controller, name, np.zeros((n, *shape)))


class Zero:
    """Does nothing: the straight line of control guided, no torque of control torque."""

    name = "zero"
    privileged = False

    def reset(self, env: VesVectorEnv, ids: Index) -> None:
        """Nothing to prepare."""

    def act(self, env: VesVectorEnv, observation: Any) -> Array:
        return np.zeros((env.num_envs, env.batch.width))


def episode_rng(env: VesVectorEnv, i: int, seed: int) -> np.random.Generator:
    """Return a generator of the present episode of environment i, whatever runs beside it."""
    e = env.batch.episodes
    return np.random.default_rng((seed, int(e.root[i]), int(e.index[i]), int(e.number[i])))


class Random:
    """Uniform actions, drawn from each episode's own seed: the same whatever runs beside."""

    name = "random"
    privileged = False
    _actions: Array  # (n, steps, width)

    def __init__(self, seed: int = 0) -> None:
        self.seed = seed

    def reset(self, env: VesVectorEnv, ids: Index) -> None:
        shape = (env.task.steps, env.batch.width)
        remember(self, env.num_envs, _actions=shape)
        for i in ids.tolist():
            self._actions[i] = episode_rng(env, i, self.seed).uniform(-1.0, 1.0, shape)

    def act(self, env: VesVectorEnv, observation: Any) -> Array:
        return row_of_step(env, self._actions)


class Hold:
    """Holds the joints where the episode began, by servo gains where the control lets one.

    Control pd_gains takes the gains; torque makes them of joint angles and rates, once per
    control period and on top of the control's own damping; acceleration and pd_target hold
    by the gains they have.
    """

    privileged = True
    _place: Array  # (n, joints) rad

    def __init__(self, name: str = "hold", gains: JointServo | None = None) -> None:
        self.name, self.gains = name, gains

    def reset(self, env: VesVectorEnv, ids: Index) -> None:
        level, kind = env.task.control.level, env.task.control.kind
        if kind == "guided" or (level == "reference" and self.gains is not None):
            raise ParameterError(
                f"controller {self.name} cannot act through control {kind}, which"
                + (" leads to its goal" if kind == "guided" else " has gains of its own")
            )
        q = env.batch.scene.q
        remember(self, len(q), _place=q.shape[1:])
        self._place[ids] = q[ids]

    def act(self, env: VesVectorEnv, observation: Any) -> Array:
        control, s, arm = env.task.control, env.batch.scene, env.task.system.arm
        servo = self.gains
        if servo is None or len(servo.kp) != arm.n:  # the thesis's, for three joints
            servo = own_gains(arm, env.task.system.vehicle)
        kp, kd = np.array(servo.kp), np.array(servo.kd)
        if isinstance(control, Gains):
            return np.tile(gains_action(control, kp, kd), (env.num_envs, 1))
        if isinstance(control, Torque):
            damping = np.array(control.servo_for(env.task.system).kd)
            tau = kp * (self._place - s.q) - (kd - damping) * s.v
            return torque_action(env, control, tau)
        return np.zeros((env.num_envs, env.batch.width))  # the reference rests where it is


class Follow:
    """Plans every episode's motion between its ends, then follows it.

    Through guided, acceleration and pd_target the reference is led along the plan, within
    1e-3 rad of it where the control's limits allow its jerk, of which planners know none.
    Through torque the arm follows by inverse dynamics on a base at rest, held over each
    control period, within about 0.02 rad. The plan is of the nominal system, whatever the
    episode draws.
    """

    privileged = True
    _plan: Array  # (n, steps + 1, 3, joints)

    def __init__(self, name: str, planner: str, seed: int = 0) -> None:
        self.name, self.planner, self.seed = name, planner, seed

    def reset(self, env: VesVectorEnv, ids: Index) -> None:
        task, s = env.task, env.batch.scene
        fits = isinstance(task, RestToRest) and task.control.level != "gains"
        require_fit(self.name, fits, "plans from rest to rest in joint space", env)
        joints = s.q.shape[1]
        remember(self, env.num_envs, _plan=(task.steps + 1, 3, joints))
        for i in ids.tolist():
            query = self._query(env, i)
            self._plan[i] = sampled(self._motion(query), task.steps + 1, env.batch.dt)

    def _query(self, env: VesVectorEnv, i: int) -> Query:
        s = env.batch.scene
        goal = s.goal[i, : s.q.shape[1]]
        return joint_query(env, s.q[i], goal, env.task.duration)

    def _motion(self, query: Query) -> Motion:
        from ves_gym.planners.query import solve
        from ves_gym.planners.registry import get_planner

        plan = solve(get_planner(self.planner), query, self.seed)
        return plan.motion if plan.found else query.straight  # better than not to move

    def act(self, env: VesVectorEnv, observation: Any) -> Array:
        control, s, arm = env.task.control, env.batch.scene, env.task.system.arm
        target = row_of_step(env, self._plan, ahead=1)
        if isinstance(control, Torque):
            q, v, a = np.moveaxis(row_of_step(env, self._plan), 1, 0)
            a = a + _TORQUE_FOLLOW * (2 * (v - s.v) + _TORQUE_FOLLOW * (q - s.q))
            tau = inverse_dynamics(arm, s.q, s.v, a)[0]
            if control.damping is not None:  # what the control takes off again
                tau = tau + np.resize(control.damping, arm.n) * s.v
            return torque_action(env, control, tau)
        return reference_action(env, control, target)


def joint_query(
    env: VesVectorEnv,
    start: Array,
    goal: Array,
    duration: float,
    *,
    system: System | None = None,
    rate: Array | None = None,
    acceleration: Array | None = None,
    base: BaseState | None = None,
) -> Query:
    """Ask a planner for a motion of the arm, within its limits and with the control's servos.

    Args:
        env: whose arm, system and control.
        start, goal, rate, acceleration: (joints,) [rad]; default at rest at the start.
        duration: [s].
        system: default the task's without errors.
        base: its motion at the start; default at rest.
    """
    from ves_gym.planners.query import Query

    task = env.task
    system = task.system.ideal() if system is None else system
    arm = system.arm
    at_start = {"start_rate": rate, "start_acceleration": acceleration}
    moving: Any = {k: tuple(v.tolist()) for k, v in at_start.items() if v is not None}
    servo = OWN_GAINS if task.control.level == "torque" else task.control.servo_for(task.system)
    return Query(
        system=system,
        start=tuple(np.clip(start, arm.column("q_min"), arm.column("q_max")).tolist()),
        goal=tuple(goal.tolist()),
        duration=duration,
        v_max=tuple(arm.column("v_max").tolist()),
        servo=servo,
        base=base,
        **moving,
    )


def sampled(motion: Motion, count: int, dt: float) -> Array:
    """Return a motion's angles, rates and accelerations (count, 3, joints), a period apart."""
    samples = motion.at(np.arange(count) * dt)
    return np.stack([samples.q, samples.v, samples.a], axis=1)


def reference_action(
    env: VesVectorEnv, control: Control, target: Array, follow: float = FOLLOW
) -> Array:
    """Actions that lead the reference to a target at the period's end.

    Within a period the reference moves linearly with the action. One number per joint cannot
    set angle, rate and acceleration at once: it sets a + 2 c v + c^2 q, so that what is left
    of all three dies away like exp(-c t).

    Args:
        env, control: in the middle of its episodes.
        target: (n, 3, joints) angle, rate, acceleration.
        follow: c [1/s].
    """
    s, arm, dt = env.batch.scene, env.task.system.arm, env.batch.dt
    if not control.per_joint:
        raise ParameterError(
            f"a plan of {arm.n} joints is followed by a control with a number per joint, got"
            f" control {control.kind}"
        )
    remaining = np.asarray(env.task.duration - env.batch.episodes.steps * dt, dtype=np.float64)
    ends, middle = [], control.coasting(s, arm, dt)
    for small in (-_SMALL, _SMALL):  # at a speed limit only one of them does anything
        moving = SimpleNamespace(time=s.time, q=s.q, v=s.v, ref=s.ref.copy(), goal=s.goal)
        control.advance(moving, middle + small, arm, dt, remaining)
        ends.append(moving.ref)
    mix = np.array([follow**2, 2 * follow, 1.0])
    if control.kind == "pd_target":  # it sets the angle and nothing else
        mix = np.array([1.0, 0.0, 0.0])
    still, slope = mix @ (ends[0] + ends[1]) / 2, mix @ (ends[1] - ends[0]) / (2 * _SMALL)
    free = np.abs(slope) > 0  # the last periods of guided are not
    action = np.where(free, (mix @ target - still) / np.where(free, slope, 1.0), 0.0)
    return np.clip(middle + action, -1.0, 1.0)


_SMALL = 1e-3  # an action far from every limit


class Optimal:
    """The exact optimum of the task lqr."""

    name = "lqr"
    privileged = True

    def reset(self, env: VesVectorEnv, ids: Index) -> None:
        require_fit(self.name, hasattr(env.task, "optimum"), "acts on task lqr", env)

    def act(self, env: VesVectorEnv, observation: Any) -> Array:
        task: Any = env.task
        plan: Array = task.optimum.gains
        gains = plan[np.minimum(env.batch.episodes.steps, len(plan) - 1)]
        tau = -(gains @ task.deviation(env.batch.scene)[:, :, None])[:, :, 0]
        return torque_action(env, task.control, tau)


def gains_action(control: Gains, kp: Array, kd: Array) -> Array:
    """The action of control pd_gains that sets gains (joints,), within its range."""
    parts = []
    for (low, high), gain in ((control.kp, kp), (control.kd, kd)):
        parts.append(2 * np.log(np.clip(gain, low, high) / low) / np.log(high / low) - 1)
    return np.concatenate(parts)


def torque_action(env: VesVectorEnv, control: Torque, tau: Array) -> Array:
    """Actions that ask for torques tau (n, joints) [N m], within their range."""
    full = control.torque(np.ones_like(tau), env.task.system.arm)
    return np.clip(tau / full, -1.0, 1.0)


def row_of_step(env: VesVectorEnv, table: Array, ahead: int = 0) -> Array:
    """Return rows of a table (n, steps, ...) for each episode's present step, or the last."""
    at = np.minimum(env.batch.episodes.steps + ahead, table.shape[1] - 1)
    return table[np.arange(env.num_envs), at]
