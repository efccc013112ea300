"""A plan followed on a machine that is not as described: estimated, or known (`Oracle`).

The arm's equation is linear in what is unknown of it (Slotine and Li, Int. J. Robotics Research
6(3), 1987; Siciliano et al., Robotics, 2009, 7.2.1): with a payload of mass m at the tool and
Coulomb friction f,

    tau - tau_described(q, v, a) = m phi(q, v, a) - f sign(v),

phi the torque that one kilogram more needs, base motion as measured. Recursive least squares
finds (m, f) while the arm moves; what the servo's feed-forward then lacks is supplied through
its gains, and the remaining motion is planned anew for the arm with that payload. The base from
which it is planned is that of the linear model under the motion so far, not the measured one:
in the laboratory that one also carries the payload's weight, which no plan can take away.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np

from ves_gym._util.params import Array, Index
from ves_gym._util.threads import on_one_thread
from ves_gym.baselines.controllers import (
    Follow,
    joint_query,
    reference_action,
    remember,
    require_fit,
    row_of_step,
    sampled,
)
from ves_gym.baselines.resolved import base_torque, servo_shift
from ves_gym.damping.observer import BaseObserver
from ves_gym.effects.payload import PayloadMass
from ves_gym.envs.rest_to_rest import RestToRest
from ves_gym.envs.vector import VesVectorEnv
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.dynamics import inertia, inverse_dynamics
from ves_gym.mechanics.motion import Motion
from ves_gym.planners.direct import Direct
from ves_gym.planners.prediction import BaseState
from ves_gym.planners.query import Query, solve
from ves_gym.system.effect import joint_torque
from ves_gym.system.system import System

_SETTLE = 0.1  # s between the end of a plan with a payload and the deadline
_REPLAN = (0.35, 0.7, 1.05)  # s after the start, at which the motion is planned anew
_DELAY = 0.1  # s from a measurement to the plan that it leads to
_PRIOR = (5.0, 3.0)  # kg, N m: standard deviations of payload and friction before any motion
_NOISE = 2.0  # N m of torque that the equation leaves unexplained
_HEAVIEST = 15.0  # kg
_SIGN = 0.02  # rad/s over which friction builds up
_HEAVY = 1.0  # kg more on the tool, for the slope phi
_FASTER = 1.05  # times a speed limit that a new plan may ask: it begins where the old one is


class Adaptive(Follow):
    """Plans, finds the payload and the friction on the way, compensates and plans anew.

    Reads joint angles and rates and the base as measured; the machine's drawn errors stay
    hidden from it.
    """

    _shift: Array  # (n, 2, joints) what is added to the plan, and its rate
    _before: list[Array]  # q, v, torque, y, yd a period ago
    _periods: Array  # (n,) since the first, -1 at a start
    _information: Array  # (n, 1 + joints, 1 + joints)
    _evidence: Array  # (n, 1 + joints)
    _planned_for: Array  # (n,) kg

    def __init__(self, seed: int = 0) -> None:
        super().__init__("adaptive", "direct", seed)

    @property
    def payload(self) -> Array:
        """(n,) mass at the tool as estimated [kg]."""
        return np.clip(self._estimate[:, 0], 0.0, _HEAVIEST)

    @property
    def _estimate(self) -> Array:
        means = np.linalg.solve(self._information, self._evidence[..., None])
        return np.asarray(means[..., 0], dtype=np.float64)

    def reset(self, env: VesVectorEnv, ids: Index) -> None:
        _require_reference(self.name, env)
        super().reset(env, ids)
        joints, measured = env.task.system.arm.n, self._measured(env)
        if np.shape(getattr(self, "_shift", ())) != (env.num_envs, 2, joints):
            self._before = measured
        remember(
            self,
            env.num_envs,
            _shift=(2, joints),
            _information=(1 + joints, 1 + joints),
            _evidence=(1 + joints,),
            _planned_for=(),
            _periods=(),
        )
        weights: Array = np.r_[_PRIOR[0], np.full(joints, _PRIOR[1])] ** -2.0
        self._information[ids], self._evidence[ids] = np.diag(weights), 0.0
        self._shift[ids], self._planned_for[ids], self._periods[ids] = 0.0, 0.0, -1
        for before, value in zip(self._before, measured, strict=True):
            before[ids] = value[ids]

    def act(self, env: VesVectorEnv, observation: Any) -> Array:
        self._learn(env)
        steps, dt = env.batch.episodes.steps, env.batch.dt
        # whole kilograms: the planner compiles its maps for every arm that it is given
        payload = np.round(self.payload)
        with on_one_thread():
            for i, k in enumerate(steps.tolist()):
                due = any(round(t / dt) == k for t in _REPLAN)
                if due and payload[i] != self._planned_for[i]:
                    self._replan(env, i, k, float(payload[i]))
        target = row_of_step(env, self._plan, ahead=1)
        return reference_action(env, env.task.control, target + self._lacking(env, target))

    # ------------------------------------------------------------------ estimation

    def _measured(self, env: VesVectorEnv) -> list[Array]:
        """Angles, rates, servo torque, pose of the base and its rate, (n, ...) each."""
        s, arm = env.batch.scene, env.task.system.arm
        q, v, a = s.ref.swapaxes(0, 1)
        tau = s.kp * (q - s.q) + s.kd * (v - s.v) + inverse_dynamics(arm, q, v, a)[0]
        return [k.copy() for k in (s.q, s.v, tau, s.y_seen, s.yd_seen)]

    def _learn(self, env: VesVectorEnv) -> None:
        """Take the last period into account."""
        arm, dt, last = env.task.system.arm, env.batch.dt, self._before
        new = self._before = self._measured(env)
        q, v, tau, y = ((a + b) / 2 for a, b in zip(last[:4], new[:4], strict=True))
        a = (new[1] - last[1]) / dt
        yd = (new[3] - last[3]) / dt  # the pose is measured better than its rate
        ydd = np.where(self._periods[:, None] > 0, (yd - last[4]) / dt, 0.0)
        new[4][:] = yd
        needed = [
            inverse_dynamics(k, q, v, a)[0] + base_torque(k, q, v, y, yd, ydd)
            for k in (arm, loaded(arm, _HEAVY))
        ]
        begun = env.batch.episodes.steps > 0
        self._periods = self._periods + 1
        unexplained = np.where(begun[:, None], tau - needed[0], 0.0)
        slope = np.zeros((len(q), arm.n, 1 + arm.n))
        slope[:, :, 0] = (needed[1] - needed[0]) / _HEAVY
        slope[:, :, 1:] = np.tanh(v / _SIGN)[:, :, None] * np.eye(arm.n)
        slope *= begun[:, None, None] / _NOISE
        across = np.swapaxes(slope, 1, 2)
        self._information += across @ slope
        self._evidence += (across @ (unexplained / _NOISE)[..., None])[..., 0]

    def _lacking(self, env: VesVectorEnv, target: Array) -> Array:
        """Shift (n, 3, joints) of the reference that gives what the feed-forward lacks.

        That is the torque of payload and friction along the plan.
        """
        arm = env.task.system.arm
        q, v, a = target.swapaxes(0, 1)
        friction = np.clip(self._estimate[:, 1:], 0.0, None)
        plain, heavy = (inverse_dynamics(k, q, v, a)[0] for k in (arm, loaded(arm, _HEAVY)))
        missing = self.payload[:, None] * (heavy - plain) / _HEAVY
        missing = missing + friction * np.tanh(v / _SIGN)
        shift = servo_shift(env, q, self._shift, missing)
        self._shift = shift[:, :2]
        return shift

    # -------------------------------------------------------------------- planning

    def _replan(self, env: VesVectorEnv, i: int, k: int, payload: float) -> None:
        """Plan the motion from `_DELAY` on for the arm with its payload."""
        dt, system = env.batch.dt, env.task.system.ideal()
        arm = loaded(system.arm, payload)
        begin = k + round(_DELAY / dt)
        q, v, a = self._plan[i, begin]
        query = joint_query(
            env,
            q,
            env.batch.scene.goal[i, : arm.n],
            env.task.duration - (_SETTLE if payload else 0.0) - begin * dt,
            system=system.replace(arm=arm),
            rate=v,
            acceleration=a,
            base=self._base_at(env, arm, i, begin),
        )
        plan = solve(Direct(), query, self.seed)
        if plan.found and _slow_enough(plan.motion, arm):
            self._plan[i, begin:] = sampled(plan.motion, self._plan.shape[1] - begin, dt)
            self._planned_for[i] = payload

    def _base_at(self, env: VesVectorEnv, arm: Arm, i: int, begin: int) -> BaseState:
        """Motion of the base when a plan begins, by the linear model from the start on."""
        q, v, _ = self._plan[i, : begin + 1].swapaxes(0, 1)
        u = (inertia(arm, q)[:, :6, 6:] @ v[..., None])[..., 0]
        system = env.task.system.ideal().replace(arm=arm)
        observer = BaseObserver(system, q[begin], env.batch.dt)
        state = observer.s
        for before, after in pairwise(u):
            state = observer.ahead(state, before[None], after[None])
        return observer.base_state(0, state[0], u[-1])


class Oracle(Follow):
    """Follows `direct`'s plan for the machine as it was drawn, which it knows completely.

    A bound for whoever has to find the machine out, and a teacher. Torque of payload, friction
    and other torque effects along the plan is supplied as `Adaptive` does it. What a laboratory
    adds (platform, sensors) it does not know.
    """

    _shift: Array  # (n, 2, joints) what is added to the plan, and its rate
    _missing: Array  # (n, steps + 1, joints) torque that the feed-forward lacks [N m]

    def __init__(self, seed: int = 0) -> None:
        super().__init__("oracle", "direct", seed)

    def reset(self, env: VesVectorEnv, ids: Index) -> None:
        _require_reference(self.name, env)
        super().reset(env, ids)
        arm, task = env.task.system.arm, env.task
        remember(self, env.num_envs, _shift=(2, arm.n), _missing=(task.steps + 1, arm.n))
        self._shift[ids] = 0.0
        for i in ids.tolist():
            q, v, a = self._plan[i].swapaxes(0, 1)
            tau, _ = inverse_dynamics(arm, q, v, a)
            actual = _drawn_system(env, i)
            needed, _ = inverse_dynamics(actual.arm, q, v, a)
            beside = joint_torque(actual.effects, q, v, tau, arm.column("tau_max"))
            self._missing[i] = needed - tau - beside

    def _query(self, env: VesVectorEnv, i: int) -> Query:
        s, system = env.batch.scene, _drawn_system(env, i)
        goal = s.goal[i, : system.arm.n]
        return joint_query(env, s.q[i], goal, env.task.duration - _SETTLE, system=system)

    def act(self, env: VesVectorEnv, observation: Any) -> Array:
        target = row_of_step(env, self._plan, ahead=1)
        missing = row_of_step(env, self._missing, ahead=1)
        shift = servo_shift(env, target[:, 0], self._shift, missing)
        self._shift = shift[:, :2]
        return reference_action(env, env.task.control, target + shift)


def _drawn_system(env: VesVectorEnv, i: int) -> System:
    """The machine of simulation i in space: arm and base as they are, effects beside them."""
    return env.batch.sim.systems[i].ideal().actual


def _require_reference(name: str, env: VesVectorEnv) -> None:
    fits = isinstance(env.task, RestToRest) and env.task.control.level == "reference"
    require_fit(name, fits, "leads the reference of task rest_to_rest", env)


def _slow_enough(motion: Motion, arm: Arm) -> bool:
    """Return True if a motion keeps the speed limits, nearly."""
    v = motion.at(np.linspace(0.0, motion.duration, 100)).v
    return bool((np.abs(v) <= _FASTER * arm.column("v_max")).all())


def loaded(arm: Arm, mass: float) -> Arm:
    """Return the arm with a point mass [kg] at its tool."""
    return PayloadMass(mass=mass).arm(arm)
