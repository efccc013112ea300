"""Gymnasium environments: tasks, single and vector environment, registration."""

from typing import TYPE_CHECKING

from ves_gym._util.lazy import lazily as _lazily
from ves_gym.envs.registration import register

if TYPE_CHECKING:
    from ves_gym.envs.device import DeviceVectorEnv as DeviceVectorEnv
    from ves_gym.envs.env import VesEnv as VesEnv
    from ves_gym.envs.rest_to_rest import RestToRest as RestToRest

__all__ = ["DeviceVectorEnv", "RestToRest", "VesEnv"]

_HOMES = {"DeviceVectorEnv": "device", "RestToRest": "rest_to_rest", "VesEnv": "env"}
__getattr__, __dir__ = _lazily(__name__, _HOMES)

register()
