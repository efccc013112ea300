"""What the arm's own inertia does to the reading, as blocks."""

from __future__ import annotations

from typing import Any

import numpy as np

from ves_gym._util.params import Array
from ves_gym.engine.batch_parameters import Bodies
from ves_gym.engine.kernel.maps import inertia_function
from ves_gym.engine.kernel.numbers import geometry, parameters
from ves_gym.engine.kernel.symbolic import Traced, column, traced
from ves_gym.engine.kernel.trace import inertia_matrix
from ves_gym.hardware.admittance import implicit_step
from ves_gym.hardware.force_sensor import low_pass
from ves_gym.mechanics.spatial import matvec, rate_matrix
from ves_gym.simulation.blocks.block import Block, LoopShape, Memory, Values
from ves_gym.system.deviations import LoopParameters
from ves_gym.system.system import System


class ArmInertia(Block):
    """Inertia H(q) of the arm that the compensation goes by (`dynamics.inertia`)."""

    name = "arm_inertia"
    inputs = ("q",)
    outputs = ("inertia",)

    def __init__(self, system: System) -> None:
        """`system` without effects: the arm as described."""
        self.system, self._entries = system, inertia_function(system)

    @property
    def structure(self) -> tuple[Any, ...]:
        return (geometry(self.system.arm), parameters(self.system)[0])

    def parameters(self, p: LoopParameters, bodies: Bodies) -> dict[str, Array]:
        return {"scale": 1 + p.payload_scale, "numbers": bodies.numbers}

    def step(
        self, p: Values, x: Values, u: Values
    ) -> tuple[dict[str, Array], dict[str, Array]]:
        q, size = u["q"], 6 + self.system.arm.n
        if isinstance(q, Traced):  # the same text, traced
            entries = inertia_matrix(self.system)(column(q), column(p["numbers"]))
            H = traced([entries[k] for k in range(size**2)], (1, size, size))
            return {}, {"inertia": p["scale"][:, None, None] * H}
        return {}, {"inertia": self.rows(p, q)}

    def rows(self, p: Values, q: Array) -> Array:
        """H (m, 6 + n, 6 + n) of some simulations.

        Args:
            p: parameters of m simulations.
            q: (m, n) [rad].
        """
        size = 6 + self.system.arm.n
        H = self._entries(q, p["numbers"]).reshape(-1, size, size)
        return np.asarray(p["scale"][:, None, None] * H, dtype=np.float64)


class PayloadCompensation(Block):
    """Predicts the reading that the arm's inertia causes, by models of platform and sensor."""

    name = "payload_compensation"
    outputs = ("payload",)

    def __init__(self, shape: LoopShape, joints: int, cutoff: float, modelled: bool) -> None:
        """`joints` that a servo holds; `cutoff` of the sensor as stated [Hz]; `modelled`: the
        platform is not as stated, so that a model of it stands in."""
        self.shape, self.joints, self.cutoff = shape, joints, cutoff
        self._suffix = "_model" if modelled else ""
        path = tuple(f"{k}{self._suffix}" for k in ("y", "yd", "ydd"))
        self.inputs = ("inertia", "kp", "kd", *path)
        self.nodes = np.arange(shape.nodes) * np.float64(shape.physics_dt)

    @property
    def memory(self) -> dict[str, Memory]:
        return {"arm": Memory((2 * self.joints,)), "filter": Memory((6, 2))}

    @property
    def structure(self) -> tuple[Any, ...]:
        return (self.joints,)

    def parameters(self, p: LoopParameters, bodies: Bodies) -> dict[str, Array]:
        hold, weights = low_pass(np.full(len(bodies.mass), self.cutoff), self.nodes)
        return {"hold": hold, "weights": weights}

    def step(
        self, p: Values, x: Values, u: Values
    ) -> tuple[dict[str, Array], dict[str, Array]]:
        H, m, dt = u["inertia"], self.joints, self.shape.control_dt
        y, yd, ydd = (u[f"{k}{self._suffix}"] for k in ("y", "yd", "ydd"))
        T = rate_matrix(y[:, 0])
        arm, steady = x["arm"], np.zeros_like(H, shape=(len(y), 6))
        if m:
            mean = matvec(T, (yd[:, -1] - yd[:, 0]) / dt)
            across = H[:, :6, 6 : 6 + m]
            D, K = (np.zeros_like(H, shape=(len(y), m, m)) for _ in range(2))
            D[:, range(m), range(m)], K[:, range(m), range(m)] = u["kd"], u["kp"]
            push = -matvec(np.swapaxes(across, -1, -2), mean)
            inner = H[:, 6 : 6 + m, 6 : 6 + m]
            response = implicit_step(inner, D, K, arm, push, dt)
            steady = matvec(across, (response[:, m:] - arm[:, m:]) / dt)
            arm = response
        # the inertia holds over the period, so it may act after the sensor's filter
        driven = np.swapaxes(p["weights"] @ ydd, -1, -2)  # (n, 6, 2)
        total = p["weights"].sum(axis=-1)[:, None, :]  # of an input that holds
        filtered = x["filter"] @ np.swapaxes(p["hold"], -1, -2)
        filtered = filtered + (H[:, :6, :6] @ T) @ driven + steady[..., None] * total
        return {"arm": arm, "filter": filtered}, {"payload": filtered[..., 0]}
