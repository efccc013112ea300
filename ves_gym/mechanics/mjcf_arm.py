"""MJCF files as trees, as MuJoCo compiles them: defaults, includes and units resolved."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ves_gym._util.params import Array, ParameterError
from ves_gym.mechanics.arm_reader import Tree, TreeJoint, body_mass
from ves_gym.mechanics.chain import ENDLESS, Joint, LinkMass, Lump, Segment
from ves_gym.mechanics.meshes import box_corners, capsule_around

_TOOL = "tool"  # site that is the tool where none is named
_KINDS = ("free", "ball", "slide", "hinge")  # of joints, by MuJoCo's number


class MjcfTree(Tree):
    """A compiled model."""

    noun, tip_nouns, moving = "body", "body or the site", "hinge or slide"

    def __init__(self, path: Path) -> None:
        from ves_gym._util.mujoco_loader import mujoco, read_model

        self.path, self.mj = path, mujoco
        self.model = m = read_model(path)
        self.data = mujoco.MjData(m)
        self.name = bytes(m.names).split(b"\0", 1)[0].decode()
        if self.name in ("", "MuJoCo Model"):
            self.name = path.stem
        self.bodies = [self._name("body", k) for k in range(m.nbody)]
        self.parents = {
            self.bodies[k]: self.bodies[m.body_parentid[k]] for k in range(1, m.nbody)
        }
        self.joint_names = [self._name("joint", j) for j in range(m.njnt)]
        self.joints = {body: [] for body in self.bodies}
        for j in range(m.njnt):
            body = self.bodies[m.jnt_bodyid[j]]
            fault = self._fault(j, body)
            self.joints[body].append(TreeJoint(self.joint_names[j], body, fault=fault))
        self.frame = np.eye(3), np.zeros(3)  # of the root
        self.bandwidth = self._numeric("ves_bandwidth", 1, [self.bandwidth])[0]

    def _name(self, kind: str, number: int) -> str:
        which = getattr(self.mj.mjtObj, f"mjOBJ_{kind.upper()}")
        return self.mj.mj_id2name(self.model, which, number) or f"{kind} {number}"

    def _fault(self, j: int, body: str) -> str | None:
        """Why a joint is none of an arm's."""
        kind = _KINDS[self.model.jnt_type[j]]
        if kind == "hinge" or (kind == "slide" and self.model.jnt_limited[j]):
            return None
        name = self.joint_names[j]
        hint = {
            "free": f"root={body!r} stands it on the platform",
            "slide": f"give it a range, or locked={{{name!r}: 0.0}} holds it",
        }.get(kind, "a root below it leaves it out (root=BODY)")
        return (
            f"joint {name!r} of body {body!r} is a {kind} joint: an arm has hinges, and slides"
            f" with a range; {hint}"
        )

    def _numeric(self, name: str, size: int, default: list[Any]) -> list[Any]:
        """Numbers that `Arm.to_mjcf` writes beside what MJCF has elements for."""
        k = self.mj.mj_name2id(self.model, self.mj.mjtObj.mjOBJ_NUMERIC, name)
        if k < 0 or self.model.numeric_size[k] != size:
            return default
        first = self.model.numeric_adr[k]
        values: list[Any] = self.model.numeric_data[first : first + size].tolist()
        return values

    def tip(self, tip: str | None, root: str) -> tuple[str, str]:
        """Return the body that has the tool, which may be a site: the one named `tool`."""
        site = self._site(_TOOL if tip is None else tip)
        if site < 0:
            return super().tip(tip, root)
        return self.bodies[self.model.site_bodyid[site]], self._name("site", site)

    def _site(self, name: str) -> int:
        return int(self.mj.mj_name2id(self.model, self.mj.mjtObj.mjOBJ_SITE, name))

    def place(
        self, root: str, chain: list[str], free: list[TreeJoint], locked: Mapping[str, float]
    ) -> None:
        """Place all bodies; refuse constraints that make the chain no chain."""
        m, d = self.model, self.data
        self._require_open({joint.name for joint in free}, chain)
        d.qpos[:] = m.qpos0
        for name, value in {**{j.name: 0.0 for j in free}, **locked}.items():
            d.qpos[m.jnt_qposadr[self.joint_names.index(name)]] = value
        self.mj.mj_kinematics(m, d)
        at = self.bodies.index(root)
        self.frame = d.xmat[at].reshape(3, 3).copy(), d.xpos[at].copy()

    def _require_open(self, free: set[str], chain: list[str]) -> None:
        m, kinds = self.model, self.mj.mjtEq
        for k in range(m.neq):
            if not m.eq_active0[k]:
                continue
            ends, kind = (int(m.eq_obj1id[k]), int(m.eq_obj2id[k])), kinds(int(m.eq_type[k]))
            if kind == kinds.mjEQ_JOINT:
                names = [self.joint_names[j] if j >= 0 else "a constant" for j in ends]
                for name, other in (names, names[::-1]):
                    if name in free:
                        raise ParameterError(
                            f"joint {name!r} is tied to {other!r} by <equality>: an arm has"
                            " joints of their own; locked= holds it"
                        )
            elif kind in (kinds.mjEQ_CONNECT, kinds.mjEQ_WELD):
                bodies = int(self.mj.mjtObj.mjOBJ_BODY)
                if m.eq_objtype[k] != bodies or any(m.body_mocapid[b] >= 0 for b in ends):
                    continue
                for body in (self.bodies[b] for b in ends):
                    if body in chain:
                        raise ParameterError(
                            f"body {body!r} is held by <equality>: an arm is an open chain"
                        )

    def position(self, joint: TreeJoint, locked: Mapping[str, float]) -> float:
        """Return where a joint stands still: as asked for, or as in the model's own pose."""
        adr = self.model.jnt_qposadr[self.joint_names.index(joint.name)]
        return float(locked.get(joint.name, self.model.qpos0[adr]))

    def chain_joints(self, free: list[TreeJoint]) -> list[Joint]:
        """Return the free joints with their limits."""
        n = len(free)
        speeds, rates = (self._numeric(k, n, [None] * n) for k in ("ves_v_max", "ves_a_max"))
        return [self._joint(*k) for k in zip(free, speeds, rates, strict=True)]

    def _joint(self, joint: TreeJoint, v_max: float | None, a_max: float | None) -> Joint:
        m, d, (R, p) = self.model, self.data, self.frame
        j = self.joint_names.index(joint.name)
        dof = m.jnt_dofadr[j]
        low, high = m.jnt_range[j].tolist() if m.jnt_limited[j] else (-ENDLESS, ENDLESS)
        axis = R.T @ d.xaxis[j]
        return Joint(
            name=joint.name,
            origin=R.T @ (d.xanchor[j] - p),
            axis=axis / np.linalg.norm(axis),
            q_min=low,
            q_max=high,
            body=Lump(),
            rotor_inertia=float(m.dof_armature[dof]),
            v_max=v_max,
            a_max=a_max,
            tau_max=self._torque(j),
            damping=_linear(m.dof_damping[dof]),
            friction=_linear(m.dof_frictionloss[dof]),
            slides=_KINDS[m.jnt_type[j]] == "slide",
        )

    def _torque(self, j: int) -> float | None:
        """The largest torque of a joint's actuators, as far as the file limits it [N m]."""
        m = self.model
        limits = [np.abs(m.jnt_actfrcrange[j]).max()] if m.jnt_actfrclimited[j] else []
        drives = int(self.mj.mjtTrn.mjTRN_JOINT)
        for k in range(m.nu):
            if m.actuator_trntype[k] != drives or m.actuator_trnid[k, 0] != j:
                continue
            gear = abs(float(m.actuator_gear[k, 0]))
            if m.actuator_forcelimited[k]:
                limits.append(gear * np.abs(m.actuator_forcerange[k]).max())
            elif m.actuator_ctrllimited[k] and not m.actuator_biasprm[k].any():
                most = np.abs(m.actuator_ctrlrange[k]).max()
                limits.append(gear * abs(m.actuator_gainprm[k, 0]) * most)
        return float(min(limits)) if limits else None

    def tool(self, body: str, name: str) -> tuple[Array, Array]:
        """Return the frame of the site or body that is the tool."""
        d, site, at = self.data, self._site(name), self.bodies.index(body)
        turn, place = (
            (d.site_xmat[site], d.site_xpos[site]) if site >= 0 else (d.xmat[at], d.xpos[at])
        )
        R, p = self.frame
        return R.T @ turn.reshape(3, 3), R.T @ (place - p)

    def mass(self, body: str, moves: bool) -> LinkMass:
        """Return a body's mass properties."""
        m, d, (R, p), k = self.model, self.data, self.frame, self.bodies.index(body)
        axes, moments = R.T @ d.ximat[k].reshape(3, 3), np.diag(m.body_inertia[k])
        return body_mass(body, float(m.body_mass[k]), R.T @ (d.xipos[k] - p), axes, moments)

    def capsules(self, body: str) -> list[Segment]:
        """Return a body's shapes that meet others."""
        m, d, (R, p), out = self.model, self.data, self.frame, []
        k = self.bodies.index(body)
        for g in range(m.body_geomadr[k], m.body_geomadr[k] + m.body_geomnum[k]):
            shape = None
            if m.geom_contype[g] or m.geom_conaffinity[g]:
                shape = self._capsule(g)
            if shape is not None:
                turn, at = d.geom_xmat[g].reshape(3, 3), d.geom_xpos[g]
                a, b = (R.T @ (turn @ end + at - p) for end in shape[:2])
                out.append((a, b, float(shape[2])))
        return out

    def _capsule(self, g: int) -> Segment | None:
        """A capsule that holds a shape, in its own frame; None of a plane or a height field."""
        m, kinds = self.model, self.mj.mjtGeom
        size, kind = m.geom_size[g], kinds(int(m.geom_type[g]))
        zero, z = np.zeros(3), np.array([0.0, 0.0, 1.0])
        if kind == kinds.mjGEOM_SPHERE:
            return zero, zero, size[0]
        if kind in (kinds.mjGEOM_CAPSULE, kinds.mjGEOM_CYLINDER):
            return -size[1] * z, size[1] * z, size[0]
        if kind in (kinds.mjGEOM_BOX, kinds.mjGEOM_ELLIPSOID):
            return capsule_around(box_corners(size))
        if kind == kinds.mjGEOM_MESH:
            mesh = int(m.geom_dataid[g])
            first = int(m.mesh_vertadr[mesh])
            points = m.mesh_vert[first : first + int(m.mesh_vertnum[mesh])]
            return capsule_around(np.unique(np.array(points, float), axis=0))
        return None

    def notes(self, free: list[TreeJoint]) -> list[str]:
        """Return which springs are left out."""
        stiffness = self.model.jnt_stiffness
        springs = [k.name for k in free if _linear(stiffness[self.joint_names.index(k.name)])]
        return [f"springs left out: {', '.join(springs)}"] if springs else []


def _linear(value: Any) -> float:
    """The linear term of a coefficient, which some versions have as a polynomial."""
    return float(np.atleast_1d(value)[0])
