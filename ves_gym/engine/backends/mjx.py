"""The same MuJoCo model on JAX (MJX). Optional: pip install 'ves-gym[gpu]'."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from ves_gym._util.params import Array, ParameterError
from ves_gym.engine.backends.device import DeviceBackend
from ves_gym.system.system import System


class MjxBackend(DeviceBackend):
    """Mode ideal only: MJX has no force sensor. Double precision with JAX_ENABLE_X64=1.

    Every number of steps is compiled once, which takes tens of seconds on a CPU.
    """

    name = "mjx"

    def __init__(self, system: System, n: int, threads: int) -> None:
        import jax
        from mujoco import mjx

        super().__init__(system, n, threads)
        if system.mode != "ideal":
            raise ParameterError(
                "backend mjx has no force sensor, so no mode emulated: use kernel or mujoco"
            )
        model = mjx.put_model(self.host)
        self._rollout = jax.jit(jax.vmap(partial(_rollout, mjx, jax, model)))
        self._once = jax.jit(jax.vmap(partial(_forward, mjx, model)))

    def _advance(self, slopes: Array) -> tuple[Array, Array, Array, Array]:
        out = self._rollout(self._bias, self._q, self._v, self._act, self._push, slopes)
        q, v, act = (np.asarray(part, np.float64) for part in out)
        return q, v, act, np.zeros((*slopes.shape[:2], 0))

    def _forward(self) -> tuple[Array, Array, Array]:
        out = self._once(self._bias, self._q, self._v, self._act, self._push)
        acceleration, force = (np.asarray(part, np.float64) for part in out)
        return acceleration, force, np.zeros((self.n, 0))


def _data(mjx: Any, model: Any, bias: Any, q: Any, v: Any, act: Any, push: Any) -> Any:
    model = model.replace(actuator_biasprm=bias)
    data = mjx.make_data(model).replace(qpos=q, qvel=v, act=act, qfrc_applied=push)
    return model, data


def _rollout(
    mjx: Any, jax: Any, model: Any, bias: Any, q: Any, v: Any, act: Any, push: Any, slopes: Any
) -> Any:
    """One simulation through slopes (k, nu) of its commands."""

    def step(state: Any, slope: Any) -> Any:
        angles, rates, commands = state
        filled, data = _data(mjx, model, bias, angles, rates, commands, push)
        data = mjx.step(filled, data.replace(ctrl=slope))
        return (data.qpos, data.qvel, data.act), None

    return jax.lax.scan(step, (q, v, act), slopes)[0]


def _forward(mjx: Any, model: Any, bias: Any, q: Any, v: Any, act: Any, push: Any) -> Any:
    filled, data = _data(mjx, model, bias, q, v, act, push)
    data = mjx.forward(filled, data)
    return data.qacc, data.actuator_force
