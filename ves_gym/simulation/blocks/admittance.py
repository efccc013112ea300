"""The vehicle as blocks: linear, nonlinear, or together with the arm it carries."""

from __future__ import annotations

import numpy as np

from ves_gym._util.params import Array
from ves_gym.engine.batch_parameters import Bodies
from ves_gym.hardware.admittance import Nonlinear, implicit_step, integrate, rigid_bodies
from ves_gym.mechanics.spatial import matvec, rate_matrix, solve
from ves_gym.simulation.blocks.block import Block, LoopShape, Memory, Stepped, Values
from ves_gym.simulation.blocks.platform import standing
from ves_gym.system.deviations import LoopParameters

_STEP = 1e-6  # of the differences that linearise a vehicle [m, rad] and their rates


class _Admittance(Block):
    """The state (Y, Y') and the m oscillators carried, which all kinds of vehicle share."""

    name = "admittance"
    inputs: tuple[str, ...] = ("reading", "weight", "command_sent", "frozen")
    outputs = ("motion",)

    def __init__(self, shape: LoopShape, carried: int, joints: int = 0) -> None:
        """`carried`: oscillators of the vehicle; `joints` that a servo holds."""
        self.shape, self.carried, self.joints = shape, carried, joints
        coupled = 2 * (joints + carried)  # coordinates, then their rates
        self.memory = {"X": Memory((12,)), "coupled": Memory((coupled,))}
        self.structure = (carried, joints)

    @property
    def oscillators(self) -> tuple[slice, slice]:
        """Coordinates and rates of the oscillators, as slices of `coupled`."""
        m, e = self.joints, self.carried
        return slice(m, m + e), slice(2 * m + e, 2 * (m + e))

    @staticmethod
    def present_state(x: Values, u: Values) -> Array:
        """State (n, 12), at rest where a safety stop holds the platform."""
        return np.where(u["frozen"][:, None] != 0.0, standing(u), x["X"])

    @staticmethod
    def force(X: Array, wrench: Array) -> Array:
        """Generalised force (n, 6) of a wrench in platform axes."""
        return matvec(np.swapaxes(rate_matrix(X[:, :6]), -1, -2), wrench)

    def start(self, p: Values, u: Values) -> Stepped:
        coupled = np.zeros((len(u["X"]), 2 * (self.joints + self.carried)))
        if self.carried:
            coupled[:, self.oscillators[0]] = u["attached"]
            coupled[:, self.oscillators[1]] = u["attached_rate"]
        return {"X": u["X"], "coupled": coupled}, {}


class LinearAdmittance(_Admittance):
    """M Y'' + D Y' + K Y = W, sampled exactly (thesis eq. 2.4 to 2.6), plus drag |Y'| Y'."""

    sparse = ("phi", "gamma", "drag")

    def parameters(self, p: LoopParameters, bodies: Bodies) -> dict[str, Array]:
        return {"phi": bodies.phi, "gamma": bodies.gamma, "drag": bodies.drag}

    def step(self, p: Values, x: Values, u: Values) -> Stepped:
        X = self.present_state(x, u)
        force = self.force(X, u["reading"] - u["weight"])
        force = force - p["drag"] * np.abs(X[:, 6:]) * X[:, 6:]
        # row by row: one matrix product over the batch would round by its size
        if not self.carried:
            X = matvec(p["phi"], X) + matvec(p["gamma"], force)
            return {"X": X, "coupled": x["coupled"]}, {"motion": X}
        at, moving = self.oscillators
        coupled, m = x["coupled"], 6 + self.carried
        state = np.concatenate([X[:, :6], coupled[:, at], X[:, 6:], coupled[:, moving]], -1)
        state = matvec(p["phi"], state) + matvec(p["gamma"], force)
        X = np.concatenate([state[:, :6], state[:, m : m + 6]], axis=-1)
        coupled = np.concatenate([state[:, 6:m], state[:, m + 6 :]], axis=-1)
        return {"X": X, "coupled": coupled}, {"motion": X}


class NonlinearAdmittance(_Admittance):
    """X' = g(X, W), by Runge-Kutta (thesis eq. 2.2): a satellite, or a function of the user."""

    sparse = ("body", "M", "D", "K")

    def __init__(self, shape: LoopShape, custom: Nonlinear | None) -> None:
        super().__init__(shape, 0)
        self.custom = custom
        self.compiles = custom is None

    def parameters(self, p: LoopParameters, bodies: Bodies) -> dict[str, Array]:
        if self.custom is not None:
            return {}
        return {"body": bodies.body, "M": bodies.M, "D": bodies.D, "K": bodies.K}

    def step(self, p: Values, x: Values, u: Values) -> Stepped:
        X = self.present_state(x, u)
        force = self.force(X, u["reading"] - u["weight"])
        g = self.custom or rigid_bodies(p["body"], p["M"], p["D"], p["K"])
        X = integrate(g, X, force, self.shape.control_dt)
        return {"X": X, "coupled": x["coupled"]}, {"motion": X}


class CoupledAdmittance(_Admittance):
    """Vehicle and arm together (docs/physics.md, payload compensation).

    What is sent is where the vehicle will be once the platform is there.
    """

    inputs = (
        "reading", "weight", "payload", "inertia", "kp", "kd", "command_sent", "frozen",
    )  # fmt: skip
    sparse = ("M", "D", "K", "drag", "wide", "body")

    def __init__(
        self,
        shape: LoopShape,
        carried: int,
        joints: int,
        lag: float,
        nonlinear: bool,
        custom: Nonlinear | None,
    ) -> None:
        """`lag` of sensor, computer and platform [s]; `nonlinear`: the vehicle has a body."""
        super().__init__(shape, carried, joints)
        self.lag, self.nonlinear, self.custom = lag, nonlinear, custom
        self.compiles = custom is None
        self.structure = (carried, joints, lag, nonlinear)

    def parameters(self, p: LoopParameters, bodies: Bodies) -> dict[str, Array]:
        parts = {"M": bodies.M, "D": bodies.D, "K": bodies.K, "drag": bodies.drag}
        if self.carried:
            parts["wide"] = bodies.wide
        if self.nonlinear and self.custom is None:
            parts["body"] = bodies.body
        return parts

    def step(self, p: Values, x: Values, u: Values) -> Stepped:
        X = self.present_state(x, u)
        force = self.force(X, u["reading"] - u["weight"] + u["payload"])
        M, D, K, state, W = self.coupled_system(p, X, x["coupled"], force, u)
        state = implicit_step(M, D, K, state, W, self.shape.control_dt)
        X, coupled = self.split(state)
        # sensor, computer and platform delay motion by a known time: send it ahead by that
        ahead = self.split(implicit_step(M, D, K, state, W, self.lag))[0]
        return {"X": X, "coupled": coupled}, {"motion": ahead}

    def start(self, p: Values, u: Values) -> Stepped:
        """Set the state back by what is commanded to the platform ahead."""
        x, _ = super().start(p, u)
        X, coupled = x["X"], x["coupled"]
        moving = np.any(X, axis=1) | np.any(coupled, axis=1)
        if self.nonlinear:
            moving[:] = True
        elif not moving.all():  # what rests where nothing pulls has been there before as well
            p, u = ({k: v[moving] for k, v in values.items()} for values in (p, u))
        if moving.any():
            force = np.zeros((int(moving.sum()), 6))
            system = self.coupled_system(p, X[moving], coupled[moving], force, u)
            before = self.split(implicit_step(*system, -self.lag))
            X, coupled = X.copy(), coupled.copy()
            X[moving], coupled[moving] = before
        return {"X": X, "coupled": coupled}, {"payload": np.zeros((len(X), 6))}

    def coupled_system(
        self, p: Values, X: Array, coupled: Array, force: Array, u: Values
    ) -> tuple[Array, Array, Array, Array, Array]:
        """Return M, D, K, state and force of vehicle and servo-held joints as one system.

        Args:
            p, u: see `step`.
            X: (n, 12) of the vehicle.
            coupled: (n, 2 m) of joints and oscillators.
            force: (n, 6) generalised.
        """
        n, m = len(X), self.joints
        k, size = m + self.carried, 6 + m
        M, D, K = (np.zeros_like(X, shape=(n, 6 + k, 6 + k)) for _ in range(3))
        turn = np.zeros_like(X, shape=(n, size, size))
        turn[:, range(size), range(size)] = 1.0
        turn[:, :6, :6] = rate_matrix(X[:, :6])
        H = u["inertia"][:, :size, :size]
        M[:, :size, :size] = np.swapaxes(turn, -1, -2) @ H @ turn
        if not self.nonlinear:
            M[:, :6, :6] += p["M"]
            D[:, :6, :6], K[:, :6, :6] = p["D"], p["K"]
            D[:, range(6), range(6)] += p["drag"] * np.abs(X[:, 6:])  # by its secant
        else:  # linearised about this instant; a force held would feed energy into a spring
            mobility, offset, by_y, by_yd = self._linearised(p, X)
            body = inverse(mobility)
            M[:, :6, :6] += body
            K[:, :6, :6], D[:, :6, :6] = -body @ by_y, -body @ by_yd
            offset = offset - matvec(by_y, X[:, :6]) - matvec(by_yd, X[:, 6:])
            force = force + matvec(body, offset)
        joints = np.arange(6, 6 + m)
        D[:, joints, joints], K[:, joints, joints] = u["kd"][:, :m], u["kp"][:, :m]
        if self.carried:
            at = np.r_[:6, 6 + m : 6 + k]
            for which, part in enumerate((M, D, K)):
                part[:, at[:, None], at] += p["wide"][:, which]
        parts = [X[:, :6], coupled[:, :k], X[:, 6:], coupled[:, k:]]
        force = np.concatenate([force, np.zeros((n, k))], axis=-1)
        return M, D, K, np.concatenate(parts, axis=-1), force

    def split(self, X: Array) -> tuple[Array, Array]:
        """State of the vehicle (n, 12) and of all else (n, 2m) from that of both."""
        m = self.joints + self.carried
        base = np.concatenate([X[:, :6], X[:, 6 + m : 12 + m]], axis=-1)
        return base, np.concatenate([X[:, 6 : 6 + m], X[:, 12 + m :]], axis=-1)

    def _linearised(self, p: Values, X: Array) -> tuple[Array, Array, Array, Array]:
        """Y'' = mobility W + rest of X' = g(X, W) at W = 0, and the rest's slopes.

        Returns:
            (n, 6, 6), (n, 6), slopes along Y (n, 6, 6) and along Y' (n, 6, 6).
        """
        g = self.custom or rigid_bodies(p["body"], p["M"], p["D"], p["K"])
        zero = np.zeros((len(X), 6))
        tries = [(X, zero), *((X, zero + push) for push in np.eye(6))]
        tries += [(X + _STEP * way, zero) for way in np.eye(12)]
        out = np.stack([g(*point) for point in tries])[..., 6:]
        offset = out[0]
        change = np.moveaxis(out[1:] - offset, 0, -1)
        slope = change[..., 6:] / _STEP
        return change[..., :6], offset, slope[..., :6], slope[..., 6:]


def inverse(A: Array) -> Array:
    """Return A^-1 of matrices (n, m, m)."""
    eye = np.eye(A.shape[-1])
    return np.stack([solve(A, np.broadcast_to(e, A.shape[:-1])) for e in eye], axis=-1)
