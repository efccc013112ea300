"""Model-predictive control by derivatives: iterative linear-quadratic regulation.

Tassa, Erez and Todorov, IEEE/RSJ Int. Conf. on Intelligent Robots and Systems 2012, eq. 5 to 8,
without the second derivatives of the motion (Gauss and Newton). About a motion x_k, u_k,

    Q_x = l_x + A^T V_x',      Q_xx = l_xx + A^T V_xx' A,      Q_ux = B^T V_xx' A,
    Q_u = l_u + B^T V_x',      Q_uu = l_uu + B^T V_xx' B,
    u <- u_k + alpha k + K (x - x_k),     k = -Q_uu^-1 Q_u,     K = -Q_uu^-1 Q_ux,

backwards in time. A and B are the exact derivatives of the engine's Runge-Kutta steps over a
control period (`engine.kernel.sensitivity`); steps alpha are tried side by side on a model.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from ves_gym._util.params import Array, Index
from ves_gym._util.threads import on_one_thread
from ves_gym.baselines.controllers import require_fit
from ves_gym.baselines.mppi import AT_REST, episode_costs, nominal_model, residual_motion_cost
from ves_gym.engine.kernel.sensitivity import rollout_gradients
from ves_gym.envs.control import Guided
from ves_gym.envs.rest_to_rest import RestToRest
from ves_gym.envs.task import Task
from ves_gym.envs.vector import VesVectorEnv
from ves_gym.planners.momentum import torque
from ves_gym.planners.prediction import LinearBase

_STEPS = np.array([0.0, 1.0, 0.7, 0.5, 0.3, 0.2, 0.1, 0.03])  # alpha, a lane each
_PERIOD = 0.5  # s between decisions
_EFFORT = 1e-6  # of an action squared: keeps Q_uu regular
_AT_ONCE = 2  # directions per program: more take long to compile
_ENOUGH = 1e-3  # relative decrease of the cost below which a decision is made


class ControlledMotion(NamedTuple):
    """A motion of the model with its gains, from a period on."""

    first: int  # period
    x: Array  # (periods + 1, size)
    u: Array  # (periods, width)
    gain: Array  # (periods, width, size)


class Ilqr:
    """Improves the actions on a model in space without errors, and feeds back what is measured.

    The state x are the coordinates of base and joints, the base's internal modes, their rates
    and the reference. The model is put where the episode is by `VesVectorEnv.fan_out`.

    Args:
        first, later: iterations of an episode's first decision and of each one after it.
    """

    name = "ilqr"
    privileged = True

    def __init__(self, *, first: int = 12, later: int = 1) -> None:
        self.first, self.later = first, later
        self._of: Task | None = None
        self._model: VesVectorEnv | None = None
        self._motion: list[ControlledMotion] = []

    def reset(self, env: VesVectorEnv, ids: Index) -> None:
        task = env.task
        fits = isinstance(task, RestToRest) and isinstance(task.control, Guided)
        require_fit(self.name, fits, "acts on task rest_to_rest through control guided", env)
        if self._of != task or len(self._motion) != env.num_envs:
            self._model, self._of = nominal_model(env, len(_STEPS)), task
            width = env.batch.width
            still = np.zeros((task.steps, width))
            size = state_of(self._model, measured=False).shape[1]
            none = ControlledMotion(
                0, np.zeros((task.steps + 1, size)), still, np.zeros((task.steps, width, size))
            )
            self._still, self._motion = none, [none] * env.num_envs
        for i in ids.tolist():
            self._motion[i] = self._still

    def act(self, env: VesVectorEnv, observation: Any) -> Array:
        every = max(round(_PERIOD / env.batch.dt), 1)
        out = np.zeros((env.num_envs, env.batch.width))
        steps = env.batch.episodes.steps
        for i, k in enumerate(steps.tolist()):
            if k % every == 0 and k < env.task.steps - 1:
                with on_one_thread():
                    self._decide(env, i, k, self.later if k else self.first)
        x = state_of(env, measured=True)
        hidden = hidden_of(env)
        for i, k in enumerate(steps.tolist()):
            motion = self._motion[i]
            at = min(max(k - motion.first, 0), len(motion.u) - 1)
            away = x[i] - motion.x[at]
            away[hidden] = 0.0  # internal modes: nothing measures them
            out[i] = motion.u[at] + motion.gain[at] @ away
        return np.clip(out, -1.0, 1.0)

    def _decide(self, env: VesVectorEnv, i: int, k: int, iterations: int) -> None:
        """Improve the motion of environment i from period k on."""
        model, old = self._model, self._motion[i]
        assert model is not None
        if k < old.first:  # an episode that nobody asked for
            old = self._still
        done = k - old.first
        motion = ControlledMotion(k, old.x[done:], old.u[done:], old.gain[done:])
        push, best = np.zeros_like(motion.u), np.inf
        for count in range(iterations + 1):  # the first plays the present actions
            model.fan_out(env, i)
            cost, x, u = play(model, motion, push)
            lane = int(cost.argmin()) if count else 0
            better = best - cost[lane]
            if count and not better > 0:
                break
            best = cost[lane]
            motion = ControlledMotion(k, x[:, lane], u[:, lane], motion.gain)
            gain, push = gains(model, motion)
            motion = motion._replace(gain=gain)
            if count and better < _ENOUGH * abs(best):
                break
        self._motion[i] = motion


def hidden_of(env: VesVectorEnv) -> Index:
    """Return where a state has the base's internal modes and their rates."""
    system = env.task.system
    first, m = 6 + system.arm.n, system.base.m
    return np.r_[first : first + m, 2 * first + m : 2 * (first + m)]


def state_of(env: VesVectorEnv, measured: bool) -> Array:
    """Return states (n, 2 s + 3 joints): coordinates, rates, reference.

    Args:
        env: whose.
        measured: the base as the sensors see it, internal modes as zero.
    """
    s, m = env.batch.scene, env.task.system.base.m
    modes = None if measured else env.batch.sim.base_modes
    u, ud = modes if modes is not None else (np.zeros((len(s.q), m)),) * 2
    y, yd = (s.y_seen, s.yd_seen) if measured else (s.y, s.yd)
    return np.concatenate([y, s.q, u, yd, s.v, ud, s.ref.reshape(len(s.q), -1)], axis=1)


def play(
    model: VesVectorEnv, motion: ControlledMotion, push: Array
) -> tuple[Array, Array, Array]:
    """Play a motion with its gains on every lane, alpha times a push added.

    Args:
        model: where the motion begins; played on.
        motion: with gains.
        push: (periods, width) k of the equation.

    Returns:
        Costs (lanes,), states (periods + 1, lanes, size) and actions (periods, lanes, width).
    """
    before, states, actions = episode_costs(model), [state_of(model, measured=False)], []
    running = np.ones(len(_STEPS), bool)  # a lane that fails begins no new episode
    for k in range(len(motion.u)):
        away = states[-1] - motion.x[k] if push.any() else np.zeros_like(states[-1])
        u = motion.u[k] + _STEPS[:, None] * push[k] + away @ motion.gain[k].T
        u = np.clip(u, -1.0, 1.0)
        _, ended, truncated, _ = model.batch.step(u, ~running)
        running &= ~(ended | truncated)
        states.append(state_of(model, measured=False))
        actions.append(u)
    task = model.task
    assert isinstance(task, RestToRest)
    straight = model.batch.goals[:, task.system.arm.n]
    # the task counts small energies by a floor; here the straight line's counts as one
    cost = (episode_costs(model) - before) * np.maximum(task.least_energy / straight, 1.0)
    cost = cost + residual_motion_cost(model)
    return np.nan_to_num(cost, nan=np.inf), np.stack(states), np.stack(actions)


def gains(model: VesVectorEnv, motion: ControlledMotion) -> tuple[Array, Array]:
    """Return the gains K (periods, width, size) and pushes k (periods, width) of a motion.

    Args:
        model: that the motion is of.
        motion: its states and actions.
    """
    A, B = derivatives(model, motion)
    weights, tail = costs(model, motion)
    size, width = A.shape[1], B.shape[2]
    V, slope = tail, tail @ motion.x[-1]
    K, push = np.zeros((len(A), width, size)), np.zeros((len(A), width))
    for k in range(len(A) - 1, -1, -1):
        V = V + weights[k]
        slope = slope + weights[k] @ motion.x[k + 1]
        Q_uu = B[k].T @ V @ B[k] + _EFFORT * np.eye(width)
        if np.abs(B[k]).max() == 0:  # the last periods of guided are not free
            V, slope = A[k].T @ V @ A[k], A[k].T @ slope
            continue
        Q_u = B[k].T @ slope + _EFFORT * motion.u[k]
        Q_ux = B[k].T @ V @ A[k]
        solved = -np.linalg.solve(Q_uu, np.column_stack([Q_u, Q_ux]))
        push[k], K[k] = solved[:, 0], solved[:, 1:]
        slope = A[k].T @ slope + Q_ux.T @ push[k]
        V = A[k].T @ V @ A[k] + Q_ux.T @ K[k]
        V = (V + V.T) / 2
    return K, push


def derivatives(model: VesVectorEnv, motion: ControlledMotion) -> tuple[Array, Array]:
    """Return A (periods, size, size) and B (periods, size, width) along a motion.

    Args:
        model: that the motion is of.
        motion: its states and actions.
    """
    system, n = model.task.system, model.task.system.arm.n
    servo, N = model.task.control.servo_for(system), len(motion.u)
    half = motion.x.shape[1] - 3 * n
    ref = motion.x[:, half:].reshape(-1, 3, n)
    # what the drives are sent, and how it follows the reference
    sent = torque(system.arm, ref[:, 0], ref[:, 1], ref[:, 2])
    kp, kd = np.array(servo.kp), np.array(servo.kd)
    command = sent.tau + kp * ref[:, 0] + kd * ref[:, 1]
    by = np.concatenate([sent.by[:, j] for j in range(3)], axis=2)  # (N + 1, n, 3 n)
    by[:, :, :n] += np.diag(kp)
    by[:, :, n : 2 * n] += np.diag(kd)

    share = np.linspace(0.0, 1.0, system.substeps + 1)[:, None]
    nodes = command[:-1, None] * (1 - share) + command[1:, None] * share
    count = half + 2 * n
    count += -count % _AT_ONCE
    starts, along = np.zeros((count, half)), np.zeros((len(share), count, n))
    starts[:half] = np.eye(half)
    for j in range(n):
        along[:, half + j, j], along[:, half + n + j, j] = 1 - share[:, 0], share[:, 0]
    parts = []
    for first in range(0, count, _AT_ONCE):
        piece = slice(first, first + _AT_ONCE)
        out = rollout_gradients(
            system,
            nodes,
            x0=motion.x[:-1, :half],
            along=np.broadcast_to(along[:, piece], (N, len(share), _AT_ONCE, n)),
            starts=np.broadcast_to(starts[piece], (N, _AT_ONCE, half)),
            servo=servo,
        )
        parts.append(out.dx)
    slopes = np.swapaxes(np.concatenate(parts, axis=1), 1, 2)  # (N, half, count)
    moved, pushed = reference_slopes(model, motion.first, N)
    before, after = slopes[:, :, half : half + n], slopes[:, :, half + n : half + 2 * n]
    A = np.zeros((N, half + 3 * n, half + 3 * n))
    A[:, :half, :half] = slopes[:, :, :half]
    A[:, :half, half:] = before @ by[:-1] + after @ by[1:] @ moved
    A[:, half:, half:] = moved
    B = np.concatenate([after @ by[1:] @ pushed, pushed], axis=1)
    return A, B


def reference_slopes(model: VesVectorEnv, first: int, N: int) -> tuple[Array, Array]:
    """Return how a period's end moves with the reference at its start, and with the action.

    Control guided moves it linearly, so differences are exact.

    Args:
        model: whose control it is.
        first: period.
        N: periods.

    Returns:
        (N, 3 n, 3 n) and (N, 3 n, width).
    """
    control, arm, dt = model.task.control, model.task.system.arm, model.batch.dt
    n = arm.n
    rows = 1 + 4 * n
    out = []
    for k in range(first, first + N):
        ref, action = np.zeros((rows, 3 * n)), np.zeros((rows, n))
        ref[1 : 1 + 3 * n] = np.eye(3 * n)
        action[1 + 3 * n :] = np.eye(n)
        at = SimpleNamespace(
            ref=ref.reshape(rows, 3, n), goal=np.zeros((rows, n)), q=ref[:, :n], v=ref[:, n:]
        )
        remaining = np.full(rows, model.task.duration - k * dt)
        control.advance(at, action, arm, dt, remaining)
        flat = at.ref.reshape(rows, -1)
        out.append((flat[1:] - flat[0]).T)
    both = np.stack(out)
    return both[:, :, : 3 * n], both[:, :, 3 * n :]


def costs(model: VesVectorEnv, motion: ControlledMotion) -> tuple[Array, Array]:
    """Return weights of the states after each period (N, size, size), and that of the tail.

    The cost is half of x^T W x: the base's energy, in the tail too, over that of the straight
    line, and a price of joints that still move at the end.

    Args:
        model: that the motion is of.
        motion: its states.
    """
    task, n = model.task, model.task.system.arm.n
    linear = LinearBase(task.system, task.control.servo)
    b, size = linear.b, motion.x.shape[1]
    scale = float(model.batch.goals[0, n]) * (task.duration + task.tail)
    # (base, joint error) of the linear base from (Y, q, modes) and the reference
    order = np.r_[np.arange(6), np.arange(6 + n, b + n), np.arange(6, 6 + n)]
    half = b + n
    pick = np.zeros((2 * half, size))
    pick[np.arange(half), order] = 1.0
    pick[np.arange(half) + half, order + half] = 1.0
    pick[b + np.arange(n), 2 * half + np.arange(n)] = -1.0
    M = linear.mass(linear.inertia(motion.x[1:, 6 : 6 + n]))
    out = np.zeros((len(M), size, size))
    for k, m in enumerate(M):
        T = _momenta(m)
        out[k] = pick.T @ (T.T @ linear.weight(m) @ T) @ pick
    T = _momenta(M[-1])
    tail = pick.T @ (T.T @ linear.tail(M[-1]) @ T) @ pick * (2 / scale)
    rates = half + 6 + np.arange(n)
    tail[rates, rates] += AT_REST
    return out * (2 * model.batch.dt / scale), tail


def _momenta(M: Array) -> Array:
    """Return (x, M x') from (x, x')."""
    size = len(M)
    out = np.eye(2 * size)
    out[size:, size:] = M
    return out
