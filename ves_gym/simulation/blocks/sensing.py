"""What the controller takes from the laboratory: the force sensor's reading, the arm's weight
that is subtracted, and the reading that the arm's own inertia causes."""

from __future__ import annotations

import numpy as np

from ves_gym._util.params import Array
from ves_gym.engine.batch_parameters import Bodies
from ves_gym.engine.kernel.maps import system_function, weight_function
from ves_gym.engine.kernel.numbers import geometry, parameters
from ves_gym.engine.kernel.symbolic import Traced, column, traced
from ves_gym.hardware.admittance import implicit_step
from ves_gym.hardware.force_sensor import ForceSensor, low_pass, noise_steps
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.gravity import gravity_vector, gravity_wrench
from ves_gym.mechanics.spatial import matvec, rate_matrix
from ves_gym.simulation.blocks.block import (
    Block,
    LoopShape,
    Memory,
    Stepped,
    Values,
    mixed,
    shares,
)
from ves_gym.system.deviations import LoopParameters
from ves_gym.system.system import System


class ForceSensorBlock(Block):
    """Six-axis force sensor (thesis 3.2.4, App. D and F; `hardware.force_sensor`)."""

    name = "force_sensor"
    inputs = ("wrench", "draws")
    outputs = ("reading",)

    def __init__(self, sensor: ForceSensor, shape: LoopShape) -> None:
        self.sensor, self.shape = sensor, shape
        self.to_wrench = np.linalg.solve(sensor.frame, np.array(sensor.calibration))
        self._step = np.array([sensor.force_resolution] * 3 + [sensor.moment_resolution] * 3)
        self.nodes = np.arange(shape.nodes) * np.float64(shape.physics_dt)
        self.memory = {
            "filter": Memory((6, 2)),  # output and its rate, platform frame
            "noise": Memory((6, 2), feeds_back=False),  # of variance 1, after the same filter
            "drift": Memory((6,), feeds_back=False),  # in units of its standard deviation
            "zero": Memory((6,), feeds_back=False),  # signal subtracted, sensor frame
        }
        self.structure = (sensor.frame.tolist(), sensor.calibration, self._step.tolist())

    def parameters(self, p: LoopParameters, bodies: Bodies) -> dict[str, Array]:
        e = p.sensor
        period = self.nodes[-1]
        hold, weights = low_pass(e.cutoff, self.nodes)
        (noise_hold, noise_kick), noise_start = noise_steps(e.cutoff, float(period))
        return {
            "hold": hold,
            "weights": weights,
            "to_signal": (np.eye(6) + e.matrix) @ self.sensor.frame,
            "bias": e.bias,
            "noise": e.noise,
            "drift": e.drift,
            "noise_hold": noise_hold,
            "noise_kick": noise_kick,
            "noise_start": noise_start,
            "drift_hold": np.exp(-period / e.drift_time)[:, None],
            "drift_kick": np.sqrt(1 - np.exp(-2 * period / e.drift_time))[:, None],
        }

    def step(self, p: Values, x: Values, u: Values) -> Stepped:
        driven = np.swapaxes(p["weights"] @ u["wrench"], -1, -2)  # (n, 6, 2)
        draws = u["draws"]
        kicks = draws[:, :12].reshape(-1, 6, 2)
        new = {
            "filter": x["filter"] @ np.swapaxes(p["hold"], -1, -2) + driven,
            "noise": x["noise"] @ np.swapaxes(p["noise_hold"], -1, -2)
            + kicks @ np.swapaxes(p["noise_kick"], -1, -2),
            "drift": p["drift_hold"] * x["drift"] + p["drift_kick"] * draws[:, 12:],
            "zero": x["zero"],
        }
        return new, {"reading": self.reading(p, new)}

    def signal(self, p: Values, x: Values) -> Array:
        """Strain signals (n, 6) in the sensor frame, as converted, before the zero."""
        true = matvec(p["to_signal"], x["filter"][..., 0])
        out = true + p["bias"] + p["noise"] * x["noise"][..., 0] + p["drift"] * x["drift"]
        parts = [
            out[:, k] if step == 0 else np.rint(out[:, k] / step) * step
            for k, step in enumerate(self._step.tolist())
        ]
        return np.stack(parts, axis=-1) if self._step.any() else out

    def reading(self, p: Values, x: Values) -> Array:
        """Wrench (n, 6) in the platform frame as the controller takes it."""
        return matvec(self.to_wrench, self.signal(p, x) - x["zero"])

    def start(self, p: Values, u: Values) -> Stepped:
        """Put sensors to rest under the arm's weight; drift starts from zero."""
        weight = u["true_weight"]
        x = {
            "filter": np.stack([weight, np.zeros_like(weight)], axis=-1),
            "noise": u["start_draws"] @ np.swapaxes(p["noise_start"], -1, -2),
            "drift": np.zeros_like(weight),
            "zero": np.broadcast_to(np.array(self.sensor.zero), weight.shape),
        }
        return x, {"reading": self.reading(p, x)}

    def zero_to(self, p: Values, x: Values, wrench: Array) -> Array:
        """Return the zero (m, 6) that makes the present reading `wrench` (App. E step 9).

        Args:
            p, x: parameters and memory of m sensors.
            wrench: (m, 6) [N, N m].
        """
        target = np.linalg.solve(self.to_wrench, wrench[..., None])[..., 0]
        return np.asarray(self.signal(p, x) - target, dtype=np.float64)


class GravityEstimate(Block):
    """Weight from measured joints and pose (thesis eq. 3.5, 3.9), possibly an old one."""

    name = "gravity_estimate"
    outputs = ("weight",)

    def __init__(self, arm: Arm, shape: LoopShape, oldest: int, tabulated: bool) -> None:
        """`oldest`: periods to look back over; `tabulated`: from a table, not the model."""
        self.arm, self.shape, self.oldest, self.tabulated = arm, shape, oldest, tabulated
        self._weights = weight_function(arm)
        self.inputs = ("table",) if tabulated else ("q", "y_measured")
        self.memory = {"history": Memory((oldest + 1, 6))}  # earlier estimates, newest first
        geometry = [(k.d, k.a, k.alpha, k.beta, k.offset) for k in arm.links]
        self.structure = (arm.mount, geometry, oldest, tabulated)

    def parameters(self, p: LoopParameters, bodies: Bodies) -> dict[str, Array]:
        return {
            "mass": p.gravity_mass,
            "P": p.gravity_P,
            "tilt": p.gravity_tilt,
            "shares": shares(p.gravity_delay / self.shape.control_dt, self.oldest + 1),
        }

    def estimate(self, p: Values, u: Values) -> Array:
        """Present estimate (n, 6)."""
        if self.tabulated:
            return u["table"]
        g = gravity_vector(self._pose(p, u))
        return gravity_wrench(self.arm, u["q"], g, p["mass"], p["P"])

    @staticmethod
    def _pose(p: Values, u: Values) -> Array:
        """Pose (n, 6) that the estimate is given [m, rad]."""
        y = u["y_measured"]
        return np.concatenate([y[:, :3], y[:, 3:] + p["tilt"]], axis=-1)

    def step(self, p: Values, x: Values, u: Values) -> Stepped:
        fresh = self.estimate(p, u)
        history = np.concatenate([fresh[:, None], x["history"][:, :-1]], axis=1)
        return {"history": history}, {"weight": mixed(p["shares"], history)}

    def start(self, p: Values, u: Values) -> Stepped:
        if self.tabulated:
            fresh = u["table"]
        else:  # what `estimate` gives, sooner
            fresh = self._weights(u["q"], self._pose(p, u), p["mass"][:, None], p["P"])
        history = np.repeat(fresh[:, None], self.oldest + 1, axis=1)
        return {"history": history}, {"weight": fresh}


class ArmInertia(Block):
    """Inertia H(q) of the arm that the compensation goes by (`dynamics.inertia`)."""

    name = "arm_inertia"
    inputs = ("q",)
    outputs = ("inertia",)

    def __init__(self, system: System) -> None:
        """`system` without effects: the arm as described."""
        self.system, self._entries = system, system_function("inertia_matrix", system)
        self.structure = (geometry(system.arm), parameters(system)[0])

    def parameters(self, p: LoopParameters, bodies: Bodies) -> dict[str, Array]:
        return {"scale": 1 + p.payload_scale, "numbers": bodies.numbers}

    def step(self, p: Values, x: Values, u: Values) -> Stepped:
        q, size = u["q"], 6 + self.system.arm.n
        if isinstance(q, Traced):  # the same text, traced
            entries = self._entries.graph(column(q), column(p["numbers"]))
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
        self.memory = {"arm": Memory((2 * joints,)), "filter": Memory((6, 2))}
        self.structure = (joints,)

    def parameters(self, p: LoopParameters, bodies: Bodies) -> dict[str, Array]:
        hold, weights = low_pass(np.full(len(bodies.mass), self.cutoff), self.nodes)
        return {"hold": hold, "weights": weights}

    def step(self, p: Values, x: Values, u: Values) -> Stepped:
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
