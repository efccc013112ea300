"""Rollouts with exact derivatives: along parameters of the system and along commands.

The tangent of the motion is integrated with the motion, by the same Runge-Kutta steps, so
the derivative is that of the computed result and not of the differential equation alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import Array, ParameterError
from ves_gym._util.suggest import did_you_mean
from ves_gym.engine.kernel.build import LANES
from ves_gym.engine.kernel.compiled_function import Stepper, aligned, lanes, unlane
from ves_gym.engine.kernel.numbers import parameters, structure
from ves_gym.engine.kernel.trace import tangents
from ves_gym.mechanics.servo import OWN_GAINS, JointServo
from ves_gym.system.system import System


@dataclass(frozen=True)
class Rollout:
    """Ends of n runs, and their derivatives along m directions."""

    time: float  # s
    x: Array  # (n, 2 s) state (Y, q, internal modes of the base) and rates, s of each
    dx: Array  # (n, m, 2 s)
    energy: Array  # (n,) mean base energy E(t) over the run [J]
    denergy: Array  # (n, m)


def rollout_gradients(
    system: System,
    commands: npt.ArrayLike,
    *,
    x0: npt.ArrayLike = 0.0,
    wrt: tuple[str, ...] = (),
    along: npt.ArrayLike | None = None,
    starts: npt.ArrayLike | None = None,
    servo: JointServo | None = OWN_GAINS,
    values: npt.ArrayLike | None = None,
) -> Rollout:
    """Play commands and differentiate what comes out.

    Args:
        system: mode ideal, integrator rk4; what runs is `system.actual`.
        commands: (n, k + 1, joints) drive commands at the physics steps, linear between.
        x0: start (n, 2 s) as `Rollout.x`, broadcast.
        wrt: parameters by name (`parameters(system.actual)[0]`): K11, link2.mass, kp1, ... A
            number that is zero in the system is structural and has no derivative.
        along: (n, k + 1, c, joints) directions of the commands, c of them.
        starts: (n, c, 2 s) how the start moves along each of these; None: not at all.
        servo: gains of the motors; None for bare torque.
        values: (n, len(parameters)) of p per run; default the system's own, with the gains.

    Returns:
        Derivatives in the order wrt, then along.

    Raises:
        ParameterError: an unknown name, wrong shapes, another mode or integrator.
    """
    if system.mode != "ideal" or system.integrator != "rk4":
        raise ParameterError(
            "derivatives of rollouts need mode ideal and integrator rk4, got"
            f" {system.mode} and {system.integrator}"
        )
    system = system.actual
    names, nominal = parameters(system)
    unknown = [name for name in wrt if name not in names]
    if unknown:
        raise ParameterError(
            f"wrt: unknown parameter {unknown[0]!r}; known: {', '.join(names)}"
            f"{did_you_mean(unknown[0], names)}"
        )
    joints = system.arm.n
    samples = np.asarray(commands, float)
    if samples.ndim != 3 or samples.shape[1] < 2 or samples.shape[2] != joints:
        raise ParameterError(
            f"commands must have shape (n, k + 1, {joints}), k >= 1, got {samples.shape}"
        )
    n, nodes, _ = samples.shape
    push = np.zeros((n, nodes, 0, joints)) if along is None else np.asarray(along, float)
    if push.ndim != 4 or push.shape[:2] != (n, nodes) or push.shape[3] != joints:
        raise ParameterError(
            f"along must have shape ({n}, {nodes}, c, {joints}), got {push.shape}"
        )
    c, m, size = push.shape[2], len(wrt) + push.shape[2], 6 + joints + system.base.m
    size += system.arm.bends
    p = np.tile(nominal, (n, 1)) if values is None else np.array(values, float)
    if p.shape != (n, len(names)):
        raise ParameterError(f"values must have shape ({n}, {len(names)}), got {p.shape}")
    if servo is not None and values is None and system.drive == "motor":
        servo = servo.for_arm(system.arm, system.vehicle)
        for name, gains in (("kp", servo.kp), ("kd", servo.kd)):
            for i in range(joints):
                p[:, names.index(f"{name}{i + 1}")] = gains[i]

    width = 2 * size + 1
    x = np.zeros((n, width * (1 + m)))
    x[:, : 2 * size] = np.broadcast_to(np.asarray(x0, float), (n, 2 * size))
    u = np.zeros((n, nodes, 1 + c, 6 + joints))
    u[:, :, 0, 6:], u[:, :, 1:, 6:] = samples, push
    if starts is not None:
        first = np.asarray(starts, float)
        if first.shape != (n, c, 2 * size):
            raise ParameterError(
                f"starts must have shape ({n}, {c}, {2 * size}), got {first.shape}"
            )
        x.reshape(n, 1 + m, width)[:, 1 + len(wrt) :, : 2 * size] = first
    out = _advance(system, wrt, c, x, u.reshape(n, nodes, -1), p)
    parts, time = out.reshape(n, 1 + m, width), (nodes - 1) * system.physics_dt
    return Rollout(
        time=time,
        x=parts[:, 0, :-1],
        dx=parts[:, 1:, :-1],
        energy=parts[:, 0, -1] / time,
        denergy=parts[:, 1:, -1] / time,
    )


def _advance(
    system: System, wrt: tuple[str, ...], controls: int, x: Array, u: Array, p: Array
) -> Array:
    key = f"tangents {wrt} {controls} {structure(system)}"
    stepper = Stepper(key, partial(tangents, system, wrt, controls), "rk4")
    rows, inputs, values = lanes(x), lanes(u.reshape(len(u), -1)), lanes(p)
    nx, nu, steps = x.shape[1], u.shape[2], u.shape[1] - 1
    scratch, unread = aligned(3 * nx + nu, LANES), aligned(1, LANES)
    strides, h = ((steps + 1) * nu, nu), system.physics_dt
    memory = rows, inputs, values, unread, scratch
    stepper.steps(*memory, steps=steps, h=h, strides=strides, record=False)(0, len(rows))
    return unlane(rows, len(x))
