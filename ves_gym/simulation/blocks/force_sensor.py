"""The force sensor as a block: filter, noise, drift, quantisation, zero, calibration."""

from __future__ import annotations

from typing import Any

import numpy as np

from ves_gym._util.params import Array
from ves_gym.engine.batch_parameters import Bodies
from ves_gym.hardware.force_sensor import ForceSensor, SensorErrors, low_pass, noise_steps
from ves_gym.mechanics.spatial import matvec
from ves_gym.simulation.blocks.block import Block, LoopShape, Memory, Values
from ves_gym.system.deviations import LoopParameters


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

    @property
    def memory(self) -> dict[str, Memory]:
        return {
            "filter": Memory((6, 2)),  # output and its rate, platform frame
            "noise": Memory((6, 2), feeds_back=False),  # of variance 1, after the same filter
            "drift": Memory((6,), feeds_back=False),  # in units of its standard deviation
            "zero": Memory((6,), feeds_back=False),  # signal subtracted, sensor frame
        }

    @property
    def structure(self) -> tuple[Any, ...]:
        return (self.sensor.frame.tolist(), self.sensor.calibration, self._step.tolist())

    def parameters(self, p: LoopParameters, bodies: Bodies) -> dict[str, Array]:
        return self.of_errors(p.sensor)

    def of_errors(self, e: SensorErrors) -> dict[str, Array]:
        """Return the parameters of n sensors with errors."""
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

    def step(
        self, p: Values, x: Values, u: Values
    ) -> tuple[dict[str, Array], dict[str, Array]]:
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

    def start(self, p: Values, u: Values) -> tuple[dict[str, Array], dict[str, Array]]:
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
