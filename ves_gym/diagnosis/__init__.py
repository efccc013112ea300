"""Discrepancy workflow: where simulation and data disagree, what is missing, how to add it."""

from typing import TYPE_CHECKING

from ves_gym._util.lazy import lazily as _lazily

if TYPE_CHECKING:
    from ves_gym.diagnosis.data.measured_run import Run as Run
    from ves_gym.diagnosis.data.measured_run import run_of as run_of
    from ves_gym.diagnosis.data.measured_run import run_of_signals as run_of_signals
    from ves_gym.diagnosis.machines.base import Port as Port
    from ves_gym.diagnosis.machines.joint_library import MjcfJoint as MjcfJoint
    from ves_gym.diagnosis.machines.mapping import read_machine as read_machine
    from ves_gym.diagnosis.machines.mjcf import MjcfVariant as MjcfVariant
    from ves_gym.diagnosis.machines.residual import Parameter as Parameter
    from ves_gym.diagnosis.machines.residual import ResidualMachine as ResidualMachine
    from ves_gym.diagnosis.machines.residual import register_machine as register_machine
    from ves_gym.diagnosis.machines.residual import samples as samples
    from ves_gym.diagnosis.machines.system import SystemMachine as SystemMachine

_HOMES = {
    "MjcfJoint": "machines.joint_library",
    "MjcfVariant": "machines.mjcf",
    "Parameter": "machines.residual",
    "Port": "machines.base",
    "ResidualMachine": "machines.residual",
    "Run": "data.measured_run",
    "SystemMachine": "machines.system",
    "read_machine": "machines.mapping",
    "register_machine": "machines.residual",
    "run_of": "data.measured_run",
    "run_of_signals": "data.measured_run",
    "samples": "machines.residual",
}
__all__ = sorted(_HOMES)
_lazily(__name__, _HOMES)
