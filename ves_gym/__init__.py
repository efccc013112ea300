"""A PUMA 560 on a long flexible beam in micro-gravity, judged by the energy in its base.

Everything public is here: `import ves_gym as vg`. Names are imported when they are first
used, so the import itself costs little more than Gymnasium's. What is rarer is under
`vg.simulation`, `vg.planners`, ... (docs/api.md).
"""

from importlib import import_module as _import
from typing import TYPE_CHECKING

from ves_gym import envs as envs  # files every environment with Gymnasium
from ves_gym._util.lazy import lazily as _lazily
from ves_gym._util.on_demand import LOADERS as _LOADERS
from ves_gym._util.version import __version__ as __version__

if TYPE_CHECKING:  # for editors and type checkers: the same names as in the table below
    from ves_gym import (
        baselines as baselines,
        diagnosis as diagnosis,
        effects as effects,
        experiments as experiments,
        hardware as hardware,
        leaderboard as leaderboard,
        mechanics as mechanics,
        planners as planners,
        simulation as simulation,
    )
    from ves_gym._util.params import ParameterError as ParameterError
    from ves_gym.api import (
        calibrate as calibrate,
        check_emulation as check_emulation,
        compare as compare,
        coupling_map as coupling_map,
        diagnose as diagnose,
        energy as energy,
        evaluate as evaluate,
        excitation as excitation,
        export as export,
        plan as plan,
        render as render,
        simulate as simulate,
        train as train,
    )
    from ves_gym.baselines.controllers import Controller as Controller
    from ves_gym.baselines.policy import Policy as Policy, load_policy as load_policy
    from ves_gym.diagnosis.diagnose import Diagnosis as Diagnosis
    from ves_gym.diagnosis.inference.candidates import Candidate as Candidate
    from ves_gym.diagnosis.machines.mjcf import MjcfMachine as MjcfMachine
    from ves_gym.engine.kernel.sensitivity import rollout_gradients as rollout_gradients
    from ves_gym.envs.task import Task as Task, register_task as register_task
    from ves_gym.leaderboard.verify import (
        make_entry as make_entry,
        verify_entry as verify_entry,
    )
    from ves_gym.mechanics.arm import Arm as Arm
    from ves_gym.mechanics.link import Inertial as Inertial, Link as Link
    from ves_gym.mechanics.arm_library import PUMA_560 as PUMA_560
    from ves_gym.mechanics.motion import Motion as Motion
    from ves_gym.mechanics.servo import JointServo as JointServo
    from ves_gym.mechanics.vehicle import (
        Beam as Beam,
        MatrixVehicle as MatrixVehicle,
        Satellite as Satellite,
        get_vehicle as get_vehicle,
    )
    from ves_gym.planners.case import Case as Case, load_case as load_case
    from ves_gym.planners.query import (
        NoPlan as NoPlan,
        Plan as Plan,
        Planner as Planner,
        Query as Query,
    )
    from ves_gym.planners.registry import register_planner as register_planner
    from ves_gym.simulation.machines import Divergence as Divergence
    from ves_gym.simulation.simulator import Simulator as Simulator
    from ves_gym.simulation.state import State as State
    from ves_gym.system.effect import (
        Effect as Effect,
        parameter as parameter,
        register_effect as register_effect,
    )
    from ves_gym.system.emulator_settings import EmulatorSettings as EmulatorSettings
    from ves_gym.system.energy import Energies as Energies
    from ves_gym.system.energy_balance import EnergyBalance as EnergyBalance
    from ves_gym.system.runlog import RunLog as RunLog
    from ves_gym.system.system import System as System

_TABLE = {  # module -> names
    "_util.params": "ParameterError",
    "api": "calibrate check_emulation compare coupling_map diagnose energy evaluate excitation"
    " export plan render simulate train",
    "baselines.controllers": "Controller",
    "baselines.policy": "Policy load_policy",
    "diagnosis.diagnose": "Diagnosis",
    "diagnosis.inference.candidates": "Candidate",
    "diagnosis.machines.mjcf": "MjcfMachine",
    "engine.kernel.sensitivity": "rollout_gradients",
    "envs.task": "Task register_task",
    "leaderboard.verify": "make_entry verify_entry",
    "mechanics.arm": "Arm",
    "mechanics.link": "Inertial Link",
    "mechanics.arm_library": "PUMA_560",
    "mechanics.motion": "Motion",
    "mechanics.servo": "JointServo",
    "mechanics.vehicle": "Beam MatrixVehicle Satellite get_vehicle",
    "planners.case": "Case load_case",
    "planners.query": "NoPlan Plan Planner Query",
    "planners.registry": "register_planner",
    "simulation.machines": "Divergence",
    "simulation.simulator": "Simulator",
    "simulation.state": "State",
    "system.effect": "Effect parameter register_effect",
    "system.emulator_settings": "EmulatorSettings",
    "system.energy": "Energies",
    "system.energy_balance": "EnergyBalance",
    "system.runlog": "RunLog",
    "system.system": "System",
}
_HOMES = {name: module for module, names in _TABLE.items() for name in names.split()}
# for what is rarer: the names in their `__all__` are public, too
_ROOMS = ("baselines", "diagnosis", "effects", "experiments", "hardware", "leaderboard",
          "mechanics", "planners", "simulation")  # fmt: skip
__all__ = sorted([*_HOMES, "effects"])

# What rooms need that lies above them: the library of effects, the drawing of results.
_LOADERS["effects"] = lambda: _import("ves_gym.effects")
_LOADERS["views"] = lambda: _import("ves_gym.report.views")

_lazily(__name__, _HOMES, _ROOMS)
