"""Gymnasium environments: tasks, single and vector environment, registration."""

from typing import TYPE_CHECKING

from ves_gym._util.lazy import lazily as _lazily
from ves_gym.envs.registration import register

if TYPE_CHECKING:
    from ves_gym.envs.control import Control as Control
    from ves_gym.envs.control import get_control as get_control
    from ves_gym.envs.device import DeviceVectorEnv as DeviceVectorEnv
    from ves_gym.envs.env import VesEnv as VesEnv
    from ves_gym.envs.rest_to_rest import RestToRest as RestToRest
    from ves_gym.envs.task import Field as Field
    from ves_gym.envs.task import Scene as Scene
    from ves_gym.envs.task import Start as Start
    from ves_gym.envs.vector import VesVectorEnv as VesVectorEnv

_HOMES = {
    "Control": "control",
    "DeviceVectorEnv": "device",
    "Field": "task",
    "RestToRest": "rest_to_rest",
    "Scene": "task",
    "Start": "task",
    "VesEnv": "env",
    "VesVectorEnv": "vector",
    "get_control": "control",
}
__all__ = sorted(_HOMES)
_lazily(__name__, _HOMES)

register()
