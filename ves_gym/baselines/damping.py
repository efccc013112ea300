"""Controllers that damp a released base: tuned gains, and motions planned anew as it moves."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium.envs.registration import EnvSpec

from ves_gym._util.params import Array, Index
from ves_gym._util.threads import on_one_thread
from ves_gym.baselines.controllers import (
    gains_action,
    joint_query,
    reference_action,
    remember,
    require_fit,
    row_of_step,
    sampled,
)
from ves_gym.damping.observer import BaseObserver
from ves_gym.damping.plant import plant_at
from ves_gym.damping.tuning import WIDE, tune
from ves_gym.envs.control import Gains
from ves_gym.envs.vector import VesVectorEnv
from ves_gym.mechanics.dynamics import inertia
from ves_gym.mechanics.spatial import matvec
from ves_gym.planners.motion_problem import MotionProblem
from ves_gym.planners.sequential import minimise

_NODES = 60  # of the momentum over a horizon
# of `Receding`
_PERIOD = 0.25  # s between plans
_DELAY = 0.1  # s from a measurement to the plan that it leads to
_HORIZON, _FREE, _ITERATIONS = 3.0, 14, 3  # of a plan: s, coefficients, steps of optimisation
_STARTS = 8  # of a search for gains: the best of 24 is 0.1 % better


class TunedGains:
    """Holds the joints by the diagonal gains that are best for the displacement, by PPED.

    The gains are those of `damping.tuning.tune`: least time integral of the strain energy
    of the nominal linear model after the release, found for every episode.
    """

    name = "tuned"
    privileged = True

    _gains: Array  # (n, 2, joints)

    def __init__(self, seed: int = 0) -> None:
        self.seed = seed

    def settings(self, spec: EnvSpec) -> dict[str, Any]:
        if spec.kwargs.get("task") != "damp":
            return {}
        return {"control": {"kind": "pd_gains", "kp": list(WIDE.K), "kd": list(WIDE.B)}}

    def reset(self, env: VesVectorEnv, ids: Index) -> None:
        s, system = env.batch.scene, env.task.system.ideal()
        fits = isinstance(env.task.control, Gains)
        require_fit(self.name, fits, "sets gains through control pd_gains", env)
        remember(self, env.num_envs, _gains=(2, s.q.shape[1]))
        for i in ids.tolist():
            gains = tune(
                plant_at(system, s.q[i]), y=s.y[i], starts=_STARTS, seed=self.seed
            ).gains
            self._gains[i] = np.diag(gains.K), np.diag(gains.B)

    def act(self, env: VesVectorEnv, observation: Any) -> Array:
        control = env.task.control
        assert isinstance(control, Gains)
        return np.stack([gains_action(control, k[0], k[1]) for k in self._gains])


class Receding:
    """Plans the best motion from the base as measured, and plans it anew while it moves.

    Every `_PERIOD` an observer's estimate of the base is led on over `_DELAY`, in which the
    last plan goes on and the new one is found; from there the plan of least E_mean over
    `_HORIZON`, which ends at rest where the episode began, is the one to follow. A plan starts
    from the last one and takes `_ITERATIONS` steps of the optimisation. The model is the
    nominal system, whatever the episode draws; what is measured is the base's pose.
    """

    name = "receding"
    privileged = True
    _plan: Array  # (n, steps + 2, 3, joints) of the reference
    _momentum: Array  # (n, steps + 2, 6) that it has
    _home: Array  # (n, joints) where it is to end [rad]

    def __init__(self, seed: int = 0) -> None:
        self.seed = seed
        self._observers: dict[int, BaseObserver] = {}

    def settings(self, spec: EnvSpec) -> dict[str, Any]:
        if spec.kwargs.get("task") != "damp":
            return {}
        return {"control": {"kind": "acceleration"}}

    def reset(self, env: VesVectorEnv, ids: Index) -> None:
        task, s = env.task, env.batch.scene
        fits = task.kind == "damp" and task.control.level == "reference"
        require_fit(self.name, fits, "leads the reference of task damp", env)
        n, joints = s.q.shape
        shapes = {"_plan": (task.steps + 2, 3, joints), "_momentum": (task.steps + 2, 6)}
        remember(self, n, **shapes, _home=(joints,))
        system = task.system.ideal()
        for i in ids.tolist():
            self._home[i] = s.q[i]
            self._plan[i], self._momentum[i] = 0.0, 0.0
            self._plan[i, :, 0] = s.q[i]
            observer = BaseObserver(system, s.q[i : i + 1], env.batch.dt)
            observer.begin(s.y_seen[i : i + 1], s.yd_seen[i : i + 1], np.zeros((1, 6)))
            self._observers[i] = observer

    def act(self, env: VesVectorEnv, observation: Any) -> Array:
        s, steps, dt = env.batch.scene, env.batch.episodes.steps, env.batch.dt
        every, late = round(_PERIOD / dt), round(_DELAY / dt)
        with on_one_thread():
            for i, k in enumerate(steps.tolist()):
                if k:
                    u = self._momentum[i, k - 1 : k + 1, None]
                    self._observers[i].step(u[0], u[1], s.y_seen[i : i + 1])
                if k % every == 0 and k + late <= env.task.steps:
                    self._replan(env, i, k, k + late)
        target = row_of_step(env, self._plan, ahead=1)
        return reference_action(env, env.task.control, target)

    def _replan(self, env: VesVectorEnv, i: int, measured: int, begin: int) -> None:
        """Plan simulation i from period `begin` on, by what period `measured` shows."""
        task, dt, observer = env.task, env.batch.dt, self._observers[i]
        state = observer.s
        for k in range(measured, begin):
            u = self._momentum[i, k : k + 2, None]
            state = observer.ahead(state, u[0], u[1])
        base = observer.base_state(0, state[0], self._momentum[i, begin])
        q, v, a = self._plan[i, begin]
        query = joint_query(env, q, self._home[i], _HORIZON, rate=v, acceleration=a, base=base)
        problem = MotionProblem(query, _FREE, nodes=_NODES)
        length = round(_HORIZON / dt)
        ahead = self._plan[i, np.minimum(begin + np.arange(length + 1), task.steps + 1), 0]
        x = problem.near(np.vstack([ahead[:-1], self._home[i]]))
        problem.follow(problem.motion(x))
        motion = problem.motion(minimise(problem, x, _ITERATIONS).x)
        plan = sampled(motion, self._plan.shape[1] - begin, dt)
        self._plan[i, begin:] = plan
        pushing = inertia(task.system.arm, plan[:, 0])[:, :6, 6:]
        self._momentum[i, begin:] = matvec(pushing, plan[:, 1])
