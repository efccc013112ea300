"""Discrepancy workflow: where simulation and data disagree, what is missing, how to add it."""

from typing import TYPE_CHECKING

from ves_gym._util.lazy import lazily as _lazily

if TYPE_CHECKING:
    from ves_gym.diagnosis.data.measured_run import run_of as run_of
    from ves_gym.diagnosis.machines.joint_library import MjcfJoint as MjcfJoint
    from ves_gym.diagnosis.machines.mapping import read_machine as read_machine
    from ves_gym.diagnosis.machines.mjcf import MjcfVariant as MjcfVariant
    from ves_gym.diagnosis.machines.system import SystemMachine as SystemMachine

__all__ = ["MjcfJoint", "MjcfVariant", "SystemMachine", "read_machine", "run_of"]

_HOMES = {
    "MjcfJoint": "machines.joint_library",
    "MjcfVariant": "machines.mjcf",
    "SystemMachine": "machines.system",
    "read_machine": "machines.mapping",
    "run_of": "data.measured_run",
}
__getattr__, __dir__ = _lazily(__name__, _HOMES)
