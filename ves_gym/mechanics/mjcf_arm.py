"""MJCF files as trees, as MuJoCo compiles them: defaults, includes and units resolved."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ves_gym._util.params import Array, ParameterError
from ves_gym.mechanics.arm_reader import Tie, Tree, TreeJoint, body_mass, held
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
            slides = _KINDS[m.jnt_type[j]] == "slide"
            joint = TreeJoint(self.joint_names[j], body, fault=fault, slides=slides)
            self.joints[body].append(joint)
        self.couplings: dict[str, tuple[int, int]] = {}  # follower -> leader's number, equality
        self.ties = list(filter(None, map(self._tie, range(m.neq))))
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
            "free": f"--root {body}, in Python root={body!r}, stands it on the platform",
            "slide": f"give it a range, or hold it ({held(name)})",
        }.get(kind, "a root below it leaves it out (--root BODY, in Python root=)")
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
        """Place all bodies; refuse constraints that close a loop."""
        m, d = self.model, self.data
        self._require_open(root, [joint.name for joint in free])
        d.qpos[:] = m.qpos0
        at_zero = {joint.name: 0.0 for joint in free}
        followers = {k: self._place(k, locked) for k in self.couplings if k not in at_zero}
        for name, value in {**at_zero, **followers, **locked}.items():
            d.qpos[m.jnt_qposadr[self.joint_names.index(name)]] = value
        self.mj.mj_kinematics(m, d)
        at = self.bodies.index(root)
        self.frame = d.xmat[at].reshape(3, 3).copy(), d.xpos[at].copy()

    def _tie(self, k: int) -> Tie | None:
        """The joints that an equality couples."""
        m, kinds = self.model, self.mj.mjtEq
        kind, ends = kinds(int(m.eq_type[k])), (int(m.eq_obj1id[k]), int(m.eq_obj2id[k]))
        if not m.eq_active0[k]:
            return None
        if kind == kinds.mjEQ_JOINT:
            names = tuple(self.joint_names[j] for j in ends if j >= 0)
            leader = names[1] if len(names) > 1 else ""
            self.couplings[names[0]] = ends[1], k
            text = f"joint {names[0]!r} follows {leader or 'a constant'!r} by <equality>"
            return Tie(text, names, names[:1], leader)
        if kind == kinds.mjEQ_TENDON:
            tendons = [t for t in ends if t >= 0]
            names = tuple(dict.fromkeys(j for t in tendons for j in self._led(t)))
            tied = " and ".join(repr(self._name("tendon", t)) for t in tendons)
            return Tie(f"<equality> ties tendon {tied}", names, names) if names else None
        return None

    def _led(self, tendon: int) -> list[str]:
        """Joints over which a tendon leads: its own, or all between its sites."""
        m, kinds, names = self.model, self.mj.mjtWrap, []
        first = int(m.tendon_adr[tendon])
        for w in range(first, first + int(m.tendon_num[tendon])):
            kind, number = kinds(int(m.wrap_type[w])), int(m.wrap_objid[w])
            if kind == kinds.mjWRAP_JOINT:
                names.append(self.joint_names[number])
            elif kind == kinds.mjWRAP_SITE:
                body: str | None = self.bodies[m.site_bodyid[number]]
                while body is not None:
                    names += [joint.name for joint in self.joints[body]]
                    body = self.parents.get(body)
        return names

    def _require_open(self, root: str, free: list[str]) -> None:
        """Refuse an equality between bodies of which one moves against the other."""
        m, kinds, movers = self.model, self.mj.mjtEq, self.movers(root, set(free))
        for k in range(m.neq):
            kind = kinds(int(m.eq_type[k]))
            if not m.eq_active0[k] or kind not in (kinds.mjEQ_CONNECT, kinds.mjEQ_WELD):
                continue
            ends = int(m.eq_obj1id[k]), int(m.eq_obj2id[k])
            if int(m.eq_objtype[k]) == int(self.mj.mjtObj.mjOBJ_SITE):
                ends = int(m.site_bodyid[ends[0]]), int(m.site_bodyid[ends[1]])
            a, b = (movers.get(self.bodies[body]) for body in ends)
            if a == b or any(m.body_mocapid[body] >= 0 for body in ends):
                continue
            low, high = sorted(free.index(name) + 1 if name else 0 for name in (a, b))
            one, other = (self.bodies[body] for body in ends)
            raise ParameterError(
                f"bodies {one!r} and {other!r} are held together by <equality>, which closes a"
                f" loop over {', '.join(map(repr, free[low:high]))}: an arm is an open chain."
                f" Hold what lies between ({held(*free[low:high])})"
            )

    def position(self, joint: TreeJoint, locked: Mapping[str, float]) -> float:
        """Return where a joint stands still: as asked for, as its leader does, or as in the
        model's own pose."""
        return self._place(joint.name, locked)

    def _place(self, name: str, locked: Mapping[str, float], depth: int = 0) -> float:
        m = self.model
        rest = float(m.qpos0[m.jnt_qposadr[self.joint_names.index(name)]])
        if name in locked or name not in self.couplings or depth > m.neq:
            return float(locked.get(name, rest))
        leader, k = self.couplings[name]
        way = 0.0
        if leader >= 0:
            other = self.joint_names[leader]
            start = float(m.qpos0[m.jnt_qposadr[leader]])
            way = self._place(other, locked, depth + 1) - start
        return rest + float(np.polyval(m.eq_data[k, 4::-1], way))

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
        for k in range(m.nu):
            gear = abs(float(m.actuator_gear[k, 0])) * self._arm_of(k, j)
            if not gear:
                continue
            if m.actuator_forcelimited[k]:
                limits.append(gear * np.abs(m.actuator_forcerange[k]).max())
            elif m.actuator_ctrllimited[k] and not m.actuator_biasprm[k].any():
                most = np.abs(m.actuator_ctrlrange[k]).max()
                limits.append(gear * abs(m.actuator_gainprm[k, 0]) * most)
        return float(min(limits)) if limits else None

    def _arm_of(self, k: int, j: int) -> float:
        """Torque at a joint per force of an actuator's gear: on a tendon its coefficient."""
        m, kinds, number = self.model, self.mj.mjtTrn, int(self.model.actuator_trnid[k, 0])
        if m.actuator_trntype[k] in (int(kinds.mjTRN_JOINT), int(kinds.mjTRN_JOINTINPARENT)):
            return float(number == j)
        if m.actuator_trntype[k] != int(kinds.mjTRN_TENDON):
            return 0.0
        first = int(m.tendon_adr[number])
        of = range(first, first + int(m.tendon_num[number]))
        joint = int(self.mj.mjtWrap.mjWRAP_JOINT)
        led = [w for w in of if m.wrap_type[w] == joint and m.wrap_objid[w] == j]
        return abs(sum(float(m.wrap_prm[w]) for w in led))

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
        mass, com = float(m.body_mass[k]), R.T @ (d.xipos[k] - p)
        return body_mass(self, body, mass, com, axes, moments)

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
        """Return which springs, and which tendons that act by themselves, are left out."""
        m, names = self.model, {k.name for k in free}
        springs = [k for k in names if _linear(m.jnt_stiffness[self.joint_names.index(k)])]
        tendons = [
            self._name("tendon", t)
            for t in range(m.ntendon)
            if _linear(m.tendon_stiffness[t])
            or _linear(m.tendon_damping[t])
            or m.tendon_limited[t]
            or m.tendon_frictionloss[t]
            if names & set(self._led(t))
        ]
        out = [f"springs left out: {', '.join(springs)}"] if springs else []
        return out + ([f"tendons left out: {', '.join(tendons)}"] if tendons else [])


def _linear(value: Any) -> float:
    """The linear term of a coefficient, which some versions have as a polynomial."""
    return float(np.atleast_1d(value)[0])
