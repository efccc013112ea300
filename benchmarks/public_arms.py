"""Arms of public URDF and MJCF files against Pinocchio and MuJoCo reading the same files.

    pip install example-robot-data robosuite rtb-data   (models alone; nothing is imported)
    python -m benchmarks.public_arms FOLDER...          (folders to look for the files in)

Prints, per model, the largest relative difference of mass matrix, bias and tool Jacobian, over
twenty configurations and rates, of the arm as read and of what comes back after writing it.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np

from ves_gym._util.params import Array
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.arm_library import get_arm
from ves_gym.mechanics.dynamics import inertia, inverse_dynamics
from ves_gym.mechanics.kinematics import frames

GRAVITY = (1.0, -2.0, -9.81)
# file, tool; the packages that ship them: example-robot-data, robosuite, rtb-data
MODELS = (
    ("ur_description/urdf/ur5_robot.urdf", "tool0"),
    ("ur_description/urdf/ur10_robot.urdf", "tool0"),
    ("panda_description/urdf/panda.urdf", "panda_hand_tcp"),
    ("xarm_description/urdf/xarm7.urdf", "link_eef"),
    ("baxter_description/urdf/baxter.urdf", "left_gripper"),
    ("kinova_description/robots/kinova.urdf", "j2s6s200_end_effector"),
    ("so_arm_description/urdf/so101.urdf", "gripper_frame_link"),
    ("sawyer_description/urdf/sawyer_arm.urdf", "right_l6"),
    ("kuka_kr16/urdf/kr16_2.urdf", "tool0"),
    ("robots/panda/robot.xml", "right_hand"),
    ("robots/ur5e/robot.xml", "right_hand"),
    ("robots/iiwa/robot.xml", "right_hand"),
    ("robots/sawyer/robot.xml", "right_hand"),
    ("robots/jaco/robot.xml", "right_hand"),
    ("robots/kinova3/robot.xml", "right_hand"),
)
Reading = tuple[Array, Array, Array]


def of_arm(arm: Arm, q: Array, v: Array) -> Reading:
    """Mass matrix without rotors, bias and tool Jacobian (6, n) of an arm."""
    at = frames(arm, q)
    J = np.concatenate([np.cross(at.axis, at.position[-1] - at.origin), at.axis], axis=1)
    H = inertia(arm, q)[6:, 6:] - np.diag(arm.column("rotor_inertia"))
    return H, inverse_dynamics(arm, q, v, 0 * q, GRAVITY)[0], J.T


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


def main(folders: list[str]) -> int:
    """Compare every model that is found."""
    found = 0
    print("model, joints: mass matrix, bias, Jacobian; after writing and reading again")
    for file, tool in MODELS:
        paths = [p for folder in folders for p in Path(folder).rglob(Path(file).name)]
        paths = [p for p in paths if str(p).endswith(file)]
        if not paths:
            print(f"{file}: not found")
            continue
        path, mjcf = paths[0], file.endswith(".xml")
        arm = Arm.from_file(path, tip=tool, collision=False)
        names = [str(link.name) for link in arm.links]
        theirs = (ByMujoco if mjcf else ByPinocchio)(path, tool, names)
        first = differences(lambda q, v, a=arm: of_arm(a, q, v), theirs, arm.n)
        with tempfile.TemporaryDirectory() as folder:
            again = Path(folder) / ("arm.mjcf" if mjcf else "arm.urdf")
            (arm.to_mjcf if mjcf else arm.to_urdf)(again)
            back = get_arm(again)
        second = differences(lambda q, v, a=back: of_arm(a, q, v), theirs, arm.n)
        numbers = [" ".join(f"{k:.1e}" for k in row) for row in (first, second)]
        print(f"{file}, {arm.n}: {numbers[0]}; {numbers[1]}")
        found += 1
    return 0 if found >= 6 else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
