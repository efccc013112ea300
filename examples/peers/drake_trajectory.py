"""Drake's trajectory optimisation on the board's queries, by `pip install drake`.

    ves-gym leaderboard run paths bent-2s drake-wrench --author peer \
        --import examples/peers/drake_trajectory.py

KinematicTrajectoryOptimization with three proxies of a quiet base that one would choose who
plans with Drake: least acceleration of the joints, least torque, and least wrench on a base
that stands still. The arm is the URDF that `Arm.to_urdf` writes.
"""

from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import numpy.typing as npt
from pydrake.autodiffutils import AutoDiffXd
from pydrake.math import BsplineBasis
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import MultibodyForces_
from pydrake.planning import KinematicTrajectoryOptimization
from pydrake.solvers import Solve
from pydrake.trajectories import BsplineTrajectory

import ves_gym as vg

Array = npt.NDArray[Any]  # of floats, or of Drake's AutoDiffXd
POINTS, ORDER = 14, 6  # of the spline: quintic, as `Motion` is
SAMPLES = 33


class Drake:
    """Least integral of the square of something, from rest to rest in a given time."""

    def __init__(self, what: str) -> None:
        self.name = f"drake-{what}"
        self.summary = f"Drake's KinematicTrajectoryOptimization, least {what}"
        self.what = what

    def find(self, query: vg.Query, seed: int) -> tuple[vg.Motion, dict[str, Any]]:
        start, goal = query.ends
        problem = KinematicTrajectoryOptimization(len(start), POINTS, ORDER, query.duration)
        problem.AddDurationConstraint(query.duration, query.duration)
        still = np.zeros(len(start))
        for s, q in ((0.0, start), (1.0, goal)):
            problem.AddPathPositionConstraint(q, q, s)
            problem.AddPathVelocityConstraint(still, still, s)
            problem.AddPathAccelerationConstraint(still, still, s)
        if query.v_max is not None:
            problem.AddVelocityBounds(-np.array(query.v_max), np.array(query.v_max))
        arm = query.system.arm
        problem.AddPositionBounds(arm.column("q_min"), arm.column("q_max"))
        maps = sampled(problem.basis(), query.duration)
        effort = {"acceleration": acceleration, "torque": torque, "wrench": wrench}[self.what]
        points = problem.control_points()  # (joints, POINTS) variables
        machine = plant(arm)

        def cost(x: Array) -> Any:
            control = x.reshape(points.shape)
            instants = np.einsum("jp,osp->soj", control, maps)
            return sum(effort(machine, *instant) for instant in instants)

        program = problem.get_mutable_prog()
        program.AddCost(cost, points.flatten())
        straight = np.linspace(0, 1, POINTS - 4)
        law = np.concatenate([[0, 0], straight, [1, 1]])
        program.SetInitialGuess(points, start[:, None] + np.outer(goal - start, law))
        found = Solve(program)
        if not found.is_success():
            raise vg.NoPlan(f"Drake: {found.get_solution_result().name}")
        spline = problem.ReconstructTrajectory(found)
        times = np.linspace(0, query.duration, 400)
        way = np.hstack([spline.value(t) for t in times]).T
        way[0], way[-1] = start, goal
        return vg.Motion.fit(way, query.duration), {"solver": found.get_solver_id().name()}


for proxy in ("acceleration", "torque", "wrench"):
    vg.register_planner(Drake(proxy))


def sampled(basis: BsplineBasis, duration: float) -> Array:
    """Maps (3, SAMPLES, POINTS) of control points to positions, rates and accelerations."""
    s = np.linspace(0, 1, SAMPLES)
    out = np.zeros((3, SAMPLES, POINTS))
    for k in range(POINTS):
        unit = [np.array([[float(i == k)]]) for i in range(POINTS)]
        law = BsplineTrajectory(basis, unit)
        for order in range(3):
            of = law if order == 0 else law.MakeDerivative(order)
            out[order, :, k] = [of.value(x)[0, 0] / duration**order for x in s]
    return out


@lru_cache(maxsize=4)
def plant(arm: vg.Arm) -> list[tuple[Any, Any]]:
    """The arm in Drake, with derivatives: its base held, and free."""
    out = []
    for held in (True, False):
        machine = MultibodyPlant(0.0)
        with TemporaryDirectory() as folder:
            file = Path(folder) / "arm.urdf"
            arm.to_urdf(file)
            Parser(machine).AddModels(str(file))
        machine.mutable_gravity_field().set_gravity_vector(np.zeros(3))
        if held:
            machine.WeldFrames(machine.world_frame(), machine.GetFrameByName("base"))
        machine.Finalize()
        traced = machine.ToAutoDiffXd()
        out.append((traced, traced.CreateDefaultContext()))
    return out


def acceleration(machine: list[tuple[Any, Any]], q: Array, v: Array, a: Array) -> Any:
    """Square of the joints' acceleration."""
    return a @ a


def torque(machine: list[tuple[Any, Any]], q: Array, v: Array, a: Array) -> Any:
    """Square of the joints' torque."""
    held, context = machine[0]
    held.SetPositions(context, q)
    held.SetVelocities(context, v)
    tau = held.CalcInverseDynamics(context, a, external_forces(held))
    return tau @ tau


def wrench(machine: list[tuple[Any, Any]], q: Array, v: Array, a: Array) -> Any:
    """Square of the wrench that holds the base [N, N m]."""
    free, context = machine[1]
    none = np.zeros(6)
    free.SetPositions(context, np.concatenate([[1.0], none, q]))
    free.SetVelocities(context, np.concatenate([none, v]))
    held = free.CalcInverseDynamics(context, np.concatenate([none, a]), external_forces(free))[
        :6
    ]
    return held @ held


def external_forces(machine: Any) -> Any:
    """No forces from outside."""
    return MultibodyForces_[AutoDiffXd](machine)
