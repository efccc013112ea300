"""Equations of a base that carries wheels and appendages (`mechanics.carried`), for graphs."""

from __future__ import annotations

from typing import Any

from ves_gym.engine.kernel.mechanics import (
    Expression,
    Model,
    balance_of_forces,
    base_motion,
    is_zero,
    product,
    solve,
    sum_of,
    times,
    transposed,
)
from ves_gym.mechanics.carried import inertia_of, load_of, passive_effort


def body_fixed(
    model: Model, y: list[Any], force: list[Expression], xp: Any
) -> list[Expression]:
    """Return a generalised force on Y with that of the jets, whose wrench turns with the base.

    Args:
        model: with the jets' wrench in platform axes, or without jets.
        y: pose of the base.
        force: on Y.
        xp: namespace of sin and cos.
    """
    if not model.jets:
        return force
    still = [0.0] * 6
    T = base_motion(y, still, still, xp)[0]
    return [a + b for a, b in zip(force, times(transposed(T), model.jets), strict=True)]


def with_carried(
    model: Model,
    z: list[Any],
    zd: list[Any],
    force: list[Any],
    tau: list[Any],
    at: list[Any],
    rate: list[Any],
    xp: Any,
) -> tuple[list[Expression], list[Expression]]:
    """Return z'' of arm and base and the accelerations of the carried bodies' joints.

    Each joint couples with the base alone, so the mass matrix has a diagonal more.

    Args:
        model: numbers or symbols of the system.
        z, zd: state (Y, q) and its rate.
        force: generalised force on Y.
        tau: joint torques of the arm.
        at, rate: coordinates and rates of the carried bodies' joints.
        xp: namespace of the functions.
    """
    mass, loads = balance_of_forces(model, z, zd, force, tau, xp)
    size, k = len(mass), len(model.carried)
    T, spin, turn, accel = base_motion(z[:6], zd[:6], [0.0] * 6, xp)
    down = transposed(T)
    wide = [[*row, *[0.0] * k] for row in mass] + [[0.0] * (size + k) for _ in range(k)]
    taken = [0.0] * 6
    for c, part in enumerate(model.carried):
        entries = inertia_of(part, at[c], xp)
        if entries.locked is not None:
            block = product(down, product(entries.locked, T))
            top = sum_of([row[:6] for row in wide[:6]], block)
            for i in range(6):
                wide[i][:6] = top[i]
        for i, value in enumerate(times(down, entries.across)):
            wide[i][size + c] = wide[size + c][i] = value
        wide[size + c][size + c] = entries.joint
        push, moment, effort = load_of(part, at[c], rate[c], spin, turn, accel, xp)
        taken = [
            a if is_zero(b) else a + b for a, b in zip(taken, (*push, *moment), strict=True)
        ]
        motor = getattr(part, "motor", 0.0)
        loads.append(passive_effort(part, at[c], rate[c]) + motor - effort)
    for i, value in enumerate(times(down, taken)):
        loads[i] = loads[i] - value
    out = solve(wide, loads)
    return out[:size], out[size:]
