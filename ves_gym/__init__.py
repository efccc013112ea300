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

if TYPE_CHECKING:
    from ves_gym import (
        baselines as baselines,
    )
    from ves_gym import (
        diagnosis as diagnosis,
    )
    from ves_gym import (
        effects as effects,
    )
    from ves_gym import (
        experiments as experiments,
    )
    from ves_gym import (
        hardware as hardware,
    )
    from ves_gym import (
        leaderboard as leaderboard,
    )
    from ves_gym import (
        mechanics as mechanics,
    )
    from ves_gym import (
        planners as planners,
    )
    from ves_gym import (
        simulation as simulation,
    )
    from ves_gym._util.params import ParameterError as ParameterError
    from ves_gym.api import (
        calibrate as calibrate,
    )
    from ves_gym.api import (
        check_emulation as check_emulation,
    )
    from ves_gym.api import (
        compare as compare,
    )
    from ves_gym.api import (
        coupling_map as coupling_map,
    )
    from ves_gym.api import (
        diagnose as diagnose,
    )
    from ves_gym.api import (
        energy as energy,
    )
    from ves_gym.api import (
        evaluate as evaluate,
    )
    from ves_gym.api import (
        excitation as excitation,
    )
    from ves_gym.api import (
        plan as plan,
    )
    from ves_gym.api import (
        render as render,
    )
    from ves_gym.api import (
        simulate as simulate,
    )
    from ves_gym.api import (
        train as train,
    )
    from ves_gym.baselines.controllers import Controller as Controller
    from ves_gym.baselines.policy import Policy as Policy
    from ves_gym.baselines.policy import load_policy as load_policy
    from ves_gym.diagnosis.diagnose import Diagnosis as Diagnosis
    from ves_gym.diagnosis.inference.candidates import Candidate as Candidate
    from ves_gym.diagnosis.machines.mjcf import MjcfMachine as MjcfMachine
    from ves_gym.engine.kernel.sensitivity import rollout_gradients as rollout_gradients
    from ves_gym.envs.task import Task as Task
    from ves_gym.envs.task import register_task as register_task
    from ves_gym.leaderboard.run import make_entry as make_entry
    from ves_gym.leaderboard.verify import verify as verify_entry
    from ves_gym.mechanics.arm import Arm as Arm
    from ves_gym.mechanics.arm import Inertial as Inertial
    from ves_gym.mechanics.arm import Link as Link
    from ves_gym.mechanics.arm_library import PUMA_560 as PUMA_560
    from ves_gym.mechanics.motion import Motion as Motion
    from ves_gym.mechanics.servo import JointServo as JointServo
    from ves_gym.mechanics.vehicle import (
        Beam as Beam,
    )
    from ves_gym.mechanics.vehicle import (
        MatrixVehicle as MatrixVehicle,
    )
    from ves_gym.mechanics.vehicle import (
        Satellite as Satellite,
    )
    from ves_gym.mechanics.vehicle import (
        get_vehicle as get_vehicle,
    )
    from ves_gym.planners.case import (
        Case as Case,
    )
    from ves_gym.planners.case import (
        load_case as load_case,
    )
    from ves_gym.planners.query import (
        NoPlan as NoPlan,
    )
    from ves_gym.planners.query import (
        Plan as Plan,
    )
    from ves_gym.planners.query import (
        Planner as Planner,
    )
    from ves_gym.planners.query import (
        Query as Query,
    )
    from ves_gym.planners.registry import register_planner as register_planner
    from ves_gym.simulation.machines import Divergence as Divergence
    from ves_gym.simulation.simulator import Simulator as Simulator
    from ves_gym.simulation.state import State as State
    from ves_gym.system.effect import (
        Effect as Effect,
    )
    from ves_gym.system.effect import (
        parameter as parameter,
    )
    from ves_gym.system.effect import (
        register as register_effect,
    )
    from ves_gym.system.emulator_settings import EmulatorSettings as EmulatorSettings
    from ves_gym.system.energy import Energies as Energies
    from ves_gym.system.energy_balance import EnergyBalance as EnergyBalance
    from ves_gym.system.runlog import RunLog as RunLog
    from ves_gym.system.system import System as System

__all__ = [
    "PUMA_560",
    "Arm",
    "Beam",
    "Candidate",
    "Case",
    "Controller",
    "Diagnosis",
    "Divergence",
    "Effect",
    "EmulatorSettings",
    "Energies",
    "EnergyBalance",
    "Inertial",
    "JointServo",
    "Link",
    "MatrixVehicle",
    "MjcfMachine",
    "Motion",
    "NoPlan",
    "ParameterError",
    "Plan",
    "Planner",
    "Policy",
    "Query",
    "RunLog",
    "Satellite",
    "Simulator",
    "State",
    "System",
    "Task",
    "calibrate",
    "check_emulation",
    "compare",
    "coupling_map",
    "diagnose",
    "effects",
    "energy",
    "evaluate",
    "excitation",
    "get_vehicle",
    "load_case",
    "load_policy",
    "make_entry",
    "parameter",
    "plan",
    "register_effect",
    "register_planner",
    "register_task",
    "render",
    "rollout_gradients",
    "simulate",
    "train",
    "verify_entry",
]

_HOMES = {
    **dict.fromkeys(
        (
            "calibrate",
            "check_emulation",
            "compare",
            "coupling_map",
            "diagnose",
            "energy",
            "evaluate",
            "excitation",
            "plan",
            "render",
            "simulate",
            "train",
        ),
        "api",
    ),
    "Arm": "mechanics.arm",
    "Beam": "mechanics.vehicle",
    "Candidate": "diagnosis.inference.candidates",
    "Case": "planners.case",
    "Controller": "baselines.controllers",
    "Diagnosis": "diagnosis.diagnose",
    "Divergence": "simulation.machines",
    "Effect": "system.effect",
    "EmulatorSettings": "system.emulator_settings",
    "Energies": "system.energy",
    "EnergyBalance": "system.energy_balance",
    "Inertial": "mechanics.arm",
    "JointServo": "mechanics.servo",
    "Link": "mechanics.arm",
    "MatrixVehicle": "mechanics.vehicle",
    "MjcfMachine": "diagnosis.machines.mjcf",
    "Motion": "mechanics.motion",
    "NoPlan": "planners.query",
    "PUMA_560": "mechanics.arm_library",
    "ParameterError": "_util.params",
    "Plan": "planners.query",
    "Planner": "planners.query",
    "Policy": "baselines.policy",
    "Query": "planners.query",
    "RunLog": "system.runlog",
    "Satellite": "mechanics.vehicle",
    "Simulator": "simulation.simulator",
    "State": "simulation.state",
    "System": "system.system",
    "Task": "envs.task",
    "get_vehicle": "mechanics.vehicle",
    "load_case": "planners.case",
    "load_policy": "baselines.policy",
    "make_entry": "leaderboard.run",
    "parameter": "system.effect",
    "register_effect": "system.effect:register",
    "register_planner": "planners.registry",
    "register_task": "envs.task",
    "rollout_gradients": "engine.kernel.sensitivity",
    "verify_entry": "leaderboard.verify:verify",
}
_ROOMS = (
    "baselines",
    "diagnosis",
    "effects",
    "experiments",
    "hardware",
    "leaderboard",
    "mechanics",
    "planners",
    "simulation",
)  # for what is rarer: the names in their `__all__` are public, too

# What rooms need that lies above them: the library of effects, the drawing of results.
_LOADERS["effects"] = lambda: _import("ves_gym.effects")
_LOADERS["views"] = lambda: _import("ves_gym.report.views")

__getattr__, __dir__ = _lazily(__name__, _HOMES, _ROOMS)
