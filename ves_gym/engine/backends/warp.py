"""The same MuJoCo model on MuJoCo Warp. Optional: pip install 'ves-gym[gpu]'."""

from __future__ import annotations

from typing import Any

import numpy as np

from ves_gym._util.mujoco_loader import mujoco
from ves_gym._util.params import Array
from ves_gym.engine.backends.device import DeviceBackend
from ves_gym.system.system import System


class WarpBackend(DeviceBackend):
    """Modes ideal and emulated, single precision; kernels are compiled on first use."""

    name = "warp"

    def __init__(self, system: System, n: int, threads: int) -> None:
        import mujoco_warp
        import warp

        super().__init__(system, n, threads)
        self._warp, self._engine = warp, mujoco_warp
        # there is no automatic reset to switch off
        self.host.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        self._model: Any = mujoco_warp.put_model(self.host)
        self._data: Any = mujoco_warp.make_data(self.host, nworld=n)

    def _load(self) -> None:
        """State and gains of all simulations to the device."""
        kind = self._model.actuator_biasprm.dtype
        bias: Any = self._warp.array(self._bias.astype(np.float32), dtype=kind)
        self._model.actuator_biasprm = bias
        for name, values in (
            ("qpos", self._q),
            ("qvel", self._v),
            ("act", self._act),
            ("qfrc_applied", self._push),
        ):
            getattr(self._data, name).assign(values.astype(np.float32))

    def _fetch(self, name: str) -> Array:
        return np.asarray(getattr(self._data, name).numpy(), np.float64)

    def _advance(self, slopes: Array) -> tuple[Array, Array, Array, Array]:
        self._load()
        sensed = np.zeros((*slopes.shape[:2], self.host.nsensordata))
        for k in range(slopes.shape[1]):
            self._data.ctrl.assign(slopes[:, k].astype(np.float32))
            if self.host.nsensordata:  # `step` shows a later stage of Runge-Kutta
                self._engine.forward(self._model, self._data)
                sensed[:, k] = self._fetch("sensordata")
            self._engine.step(self._model, self._data)
        return self._fetch("qpos"), self._fetch("qvel"), self._fetch("act"), sensed

    def _forward(self) -> tuple[Array, Array, Array]:
        self._load()
        self._engine.forward(self._model, self._data)
        return self._fetch("qacc"), self._fetch("actuator_force"), self._fetch("sensordata")
