"""Base momentum and joint torque of a moving arm with their exact derivatives, compiled.

The text of `mechanics/dynamics.py`, traced and differentiated by CasADi, for many instants of a
motion at once: what the optimisers evaluate.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ves_gym._util.params import Array, content_hash
from ves_gym.engine.kernel.compiled_function import CompiledFunction
from ves_gym.engine.kernel.maps import points
from ves_gym.engine.kernel.symbolic import column, symbols
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.dynamics import inertia_parts, newton_euler
from ves_gym.mechanics.linear_motion import LinearMotion

if TYPE_CHECKING:
    import casadi


class BaseMomentum(NamedTuple):
    """u = H_bm(q) v and its derivatives."""

    u: Array  # (..., 6) kg m/s, kg m^2/s
    by_q: Array  # (..., 6, n)
    by_v: Array  # (..., 6, n), H_bm itself


def momentum(arm: Arm, q: Array, v: Array) -> BaseMomentum:
    """Base momentum of joint rates, with derivatives.

    Args:
        arm: n joints.
        q: (..., n) configurations [rad].
        v: (..., n) joint rates [rad/s].

    Returns:
        u = H_bm(q) v (..., 6), and its derivatives by q and v, (..., 6, n) each.
    """
    n = arm.n
    out = _function(_momentum, arm)(points((q, n, "q"), (v, n, "v")))
    slopes = out[..., 6:].reshape(*out.shape[:-1], 2, n, 6)
    by_q, by_v = np.moveaxis(np.swapaxes(slopes, -1, -2), -3, 0)
    return BaseMomentum(out[..., :6], by_q, by_v)


class InverseDynamics(NamedTuple):
    """Joint torque on a base that stands still, and its derivatives."""

    tau: Array  # (..., n) N m
    by: Array  # (..., 3, n, n) by position, rate and acceleration; [.., k, i, j] = dtau_i/dx_j


def torque(arm: Arm, q: Array, v: Array, a: Array) -> InverseDynamics:
    """Inverse dynamics on a base that stands still, with derivatives.

    Args:
        arm: n joints.
        q: (..., n) [rad]. v: (..., n) [rad/s]. a: (..., n) [rad/s^2].

    Returns:
        Joint torque (..., n) [N m], and its derivatives (..., 3, n, n).
    """
    n = arm.n
    at = points((q, n, "q"), (v, n, "v"), (a, n, "a"))
    out = _function(_torque, arm)(at)
    slopes = out[..., n:].reshape(*out.shape[:-1], 3, n, n)
    return InverseDynamics(out[..., :n], np.swapaxes(slopes, -1, -2))


def spring_load(free: LinearMotion, q: Array, v: Array, a: Array) -> InverseDynamics:
    """Torque that flexures and gears have to give, and its derivatives.

    Args:
        free: of an arm with k of them.
        q, v, a: see `torque`.

    Returns:
        (..., k) [N m], and its derivatives (..., 3, k, n).
    """
    chain = free.links
    at = (chain.angles(q, 0.0), chain.angles(v, 0.0), chain.angles(a, 0.0))
    tau, by = torque(chain.arm, *at)
    return InverseDynamics(
        tau[..., free.loaded], by[..., free.loaded, :][..., list(chain.driven)]
    )


@lru_cache(maxsize=16)
def _function(graph: Callable[[Arm], casadi.Function], arm: Arm) -> CompiledFunction:
    # the graphs hold the arm's numbers
    return CompiledFunction(f"{graph.__name__} {content_hash(arm)}", partial(graph, arm))


def _momentum(arm: Arm) -> casadi.Function:
    import casadi as ca

    q, v = symbols("q", (arm.n,)), symbols("v", (arm.n,))
    across = inertia_parts(arm, q).across
    u = column(v @ across)
    out = ca.vertcat(u, ca.vec(ca.jacobian(u, column(q))), column(across))
    return ca.Function("momentum", [column(q, v)], [ca.cse(ca.densify(out))])


def _torque(arm: Arm) -> casadi.Function:
    import casadi as ca

    motion = symbols("x", (3, arm.n))
    x, tau = column(motion), column(newton_euler(arm, *motion)[0])
    out = ca.vertcat(tau, ca.vec(ca.jacobian(tau, x)))
    return ca.Function("torque", [x], [ca.cse(ca.densify(out))])
