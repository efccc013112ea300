"""MJCF files as trees, as MuJoCo compiles them: defaults, includes and units resolved."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ves_gym._util.params import Array, ParameterError
from ves_gym.mechanics.arm_tree import Tie, Tree, TreeJoint, held
from ves_gym.mechanics.attitude import to_matrix
from ves_gym.mechanics.chain import ENDLESS, Joint, LinkMass, Lump
from ves_gym.mechanics.link import Capsule, MeshFile
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
        self.ties = []
        for k in range(m.neq):
            self.ties += filter(None, [self._tie(k)])
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

    def place(self, root: str, at: Mapping[str, float]) -> None:
        """Place all bodies; refuse constraints that close a loop."""
        m, d = self.model, self.data
        self._require_open(root)
        self._require_motors()
        d.qpos[:] = m.qpos0
        for name, value in at.items():
            j = self.joint_names.index(name)
            if _KINDS[m.jnt_type[j]] in ("slide", "hinge"):
                d.qpos[m.jnt_qposadr[j]] = value
        self.mj.mj_kinematics(m, d)
        k = self.bodies.index(root)
        self.frame = d.xmat[k].reshape(3, 3).copy(), d.xpos[k].copy()

    def rest(self, joint: str) -> float:
        """Return where a joint is in the model's own pose."""
        m = self.model
        return float(m.qpos0[m.jnt_qposadr[self.joint_names.index(joint)]])

    def _tie(self, k: int) -> Tie | None:
        """The joints that an equality couples."""
        m, kinds = self.model, self.mj.mjtEq
        kind, ends = kinds(int(m.eq_type[k])), (int(m.eq_obj1id[k]), int(m.eq_obj2id[k]))
        if not m.eq_active0[k] or kind not in (kinds.mjEQ_JOINT, kinds.mjEQ_TENDON):
            return None
        start, slope, *curve = m.eq_data[k, :5].tolist()
        if kind == kinds.mjEQ_JOINT:
            names = [self.joint_names[j] for j in ends if j >= 0]
            sums = [{name: 1.0} for name in names]
            what = f"joint {names[0]!r} follows {names[1] if names[1:] else 'a constant'!r}"
        else:
            tendons = [t for t in ends if t >= 0]
            sums = [self._sum(t) for t in tendons]
            tied = " and ".join(repr(self._name("tendon", t)) for t in tendons)
            what = f"<equality> ties tendon {tied}"
        if len(sums) == 1:
            sums, curve = [*sums, {}], []
        return self._equation(what, sums, start, slope, tuple(curve) if any(curve) else ())

    def _equation(
        self,
        what: str,
        sums: list[dict[str, float]],
        start: float,
        slope: float,
        curve: tuple[float, ...],
    ) -> Tie | None:
        """Return that one sum of joints is start + slope times another, both from rest, and
        its second power on."""
        total = dict(sums[0])
        for name, part in sums[1].items():
            total[name] = total.get(name, 0.0) - slope * part
        if not any(total.values()):
            return None
        taken = {tie.follower for tie in self.ties}
        able = [name for of in sums for name in reversed(of) if total[name]]
        follower = next((k for k in able if k not in taken), able[0])
        factor = total.pop(follower)
        ratios = {name: -part / factor for name, part in total.items() if part or curve}
        shift = start / factor + self.rest(follower)
        shift -= sum(ratio * self.rest(name) for name, ratio in ratios.items())
        bend = tuple(k / factor for k in curve), sums[1]
        return Tie(what, follower, ratios, shift, bend if curve or math.isnan(factor) else None)

    def _sum(self, tendon: int) -> dict[str, float]:
        """Coefficients of the joints that a fixed tendon leads over; NaN of a spatial one."""
        m, joint = self.model, int(self.mj.mjtWrap.mjWRAP_JOINT)
        first, out = int(m.tendon_adr[tendon]), dict.fromkeys(self._led(tendon), math.nan)
        for w in range(first, first + int(m.tendon_num[tendon])):
            if m.wrap_type[w] == joint:
                name = self.joint_names[m.wrap_objid[w]]
                before = 0.0 if math.isnan(out[name]) else out[name]
                out[name] = before + float(m.wrap_prm[w])
        return out

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

    def _require_open(self, root: str) -> None:
        """Refuse an equality between bodies of which one moves against the other."""
        m, kinds, free = self.model, self.mj.mjtEq, list(self.coupled.moving)
        movers = self.movers(root, set(free))
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
            this, other = (self.bodies[body] for body in ends)
            raise ParameterError(
                f"bodies {this!r} and {other!r} are held together by <equality>, which closes a"
                f" loop over {', '.join(map(repr, free[low:high]))}: an arm is an open chain."
                f" Hold what lies between ({held(*free[low:high])})"
            )

    def moving_joints(self, joints: list[TreeJoint]) -> list[Joint]:
        """Return joints with their limits."""
        n = len(joints)
        speeds, rates = (self._numeric(k, n, [None] * n) for k in ("ves_v_max", "ves_a_max"))
        return [self._joint(*k) for k in zip(joints, speeds, rates, strict=True)]

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
            tau_max=self._torque(joint.name),
            damping=_linear(m.dof_damping[dof]),
            friction=_linear(m.dof_frictionloss[dof]),
            slides=_KINDS[m.jnt_type[j]] == "slide",
        )

    def _torque(self, name: str) -> float | None:
        """The largest torque of the actuators of a joint and its followers, as far as the file
        limits it [N m]; None of a follower."""
        m, names = self.model, [k.name for k in self.coupled.free]
        if name not in names:
            return None
        j, levers = self.joint_names.index(name), self._levers()[:, names.index(name)]
        limits = [np.abs(m.jnt_actfrcrange[j]).max()] if m.jnt_actfrclimited[j] else []
        motors: dict[tuple[int, int], list[float]] = {}  # by joint or tendon
        for k in np.flatnonzero(levers).tolist():
            force = self._force(k)
            if force is not None:
                where = int(m.actuator_trntype[k]), int(m.actuator_trnid[k, 0])
                motors.setdefault(where, []).append(abs(levers[k]) * force)
        if motors:
            limits.append(sum(min(of) for of in motors.values()))
        return float(min(limits)) if limits else None

    def _levers(self) -> Array:
        """(actuators, n) torque at each joint that follows none per force times gear."""
        out = np.zeros((self.model.nu, len(self.coupled.free)))
        for name, ratios in self.coupled.moving.items():
            j = self.joint_names.index(name)
            out += np.outer([self._arm_of(k, j) for k in range(len(out))], ratios)
        return out

    def _require_motors(self) -> None:
        """Refuse joints that tendons pull together, with fewer motors than joints."""
        levers = self._levers()
        several = np.count_nonzero(levers, axis=1) > 1
        pulled = np.flatnonzero(levers[several].any(axis=0))
        if np.linalg.matrix_rank(levers[:, pulled]) < len(pulled):
            names = [self.coupled.free[i].name for i in pulled]
            motor = self._name("actuator", int(np.flatnonzero(several)[0]))
            raise ParameterError(
                f"actuator {motor!r} pulls {', '.join(map(repr, names))} together by a tendon:"
                f" each joint of an arm has a motor. Hold all but one ({held(*names[1:])}), or"
                " couple them by <equality>"
            )

    def _force(self, k: int) -> float | None:
        """The most that an actuator exerts times its gear, as far as the file limits it."""
        m, gear = self.model, abs(float(self.model.actuator_gear[k, 0]))
        if m.actuator_forcelimited[k]:
            return gear * float(np.abs(m.actuator_forcerange[k]).max())
        if m.actuator_ctrllimited[k] and not m.actuator_biasprm[k].any():
            most = np.abs(m.actuator_ctrlrange[k]).max()
            return gear * float(abs(m.actuator_gainprm[k, 0]) * most)
        return None

    def _arm_of(self, k: int, j: int) -> float:
        """Torque at a joint per force of an actuator's gear: on a tendon its coefficient."""
        m, kinds, number = self.model, self.mj.mjtTrn, int(self.model.actuator_trnid[k, 0])
        if m.actuator_trntype[k] in (int(kinds.mjTRN_JOINT), int(kinds.mjTRN_JOINTINPARENT)):
            return float(number == j)
        if m.actuator_trntype[k] != int(kinds.mjTRN_TENDON):
            return 0.0
        part = self._sum(number).get(self.joint_names[j], 0.0)
        return 0.0 if math.isnan(part) else part

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
        return LinkMass(body, mass, com, axes @ moments @ axes.T)

    def capsules(self, body: str) -> list[Capsule]:
        """Return a body's shapes that meet others."""
        m, d, (R, p), out = self.model, self.data, self.frame, []
        k = self.bodies.index(body)
        for g in range(m.body_geomadr[k], m.body_geomadr[k] + m.body_geomnum[k]):
            shape = None
            if m.geom_contype[g] or m.geom_conaffinity[g]:
                shape = self._capsule(g)
            if shape is not None:
                turn, at = d.geom_xmat[g].reshape(3, 3), d.geom_xpos[g]
                out.append(shape.placed(R.T @ turn, R.T @ (at - p)))
        return out

    def _capsule(self, g: int) -> Capsule | None:
        """A capsule that holds a shape, in its own frame; None of a plane or a height field."""
        m, kinds = self.model, self.mj.mjtGeom
        size, kind = m.geom_size[g], kinds(int(m.geom_type[g]))
        zero, z = np.zeros(3), np.array([0.0, 0.0, 1.0])
        if kind == kinds.mjGEOM_SPHERE:
            return Capsule.of(zero, zero, size[0])
        if kind in (kinds.mjGEOM_CAPSULE, kinds.mjGEOM_CYLINDER):
            return Capsule.of(-size[1] * z, size[1] * z, size[0])
        if kind in (kinds.mjGEOM_BOX, kinds.mjGEOM_ELLIPSOID):
            return capsule_around(box_corners(size))
        if kind == kinds.mjGEOM_MESH:
            mesh = int(m.geom_dataid[g])
            first = int(m.mesh_vertadr[mesh])
            points = m.mesh_vert[first : first + int(m.mesh_vertnum[mesh])]
            return capsule_around(np.unique(np.array(points, float), axis=0))
        return None

    def meshes(self, body: str) -> list[MeshFile]:
        """Return the meshes of a body that meet nothing, all where none are for drawing."""
        m, d, (R, p), k = self.model, self.data, self.frame, self.bodies.index(body)
        first = m.body_geomadr[k]
        geoms = np.arange(first, first + m.body_geomnum[k])
        geoms = geoms[m.geom_type[geoms] == int(self.mj.mjtGeom.mjGEOM_MESH)]
        drawn = geoms[(m.geom_contype[geoms] == 0) & (m.geom_conaffinity[geoms] == 0)]
        out = []
        for g in (drawn if len(drawn) else geoms).tolist():
            mesh = int(m.geom_dataid[g])
            file = bytes(m.paths)[m.mesh_pathadr[mesh] :].split(b"\0", 1)[0].decode()
            turn = R.T @ d.geom_xmat[g].reshape(3, 3) @ to_matrix(m.mesh_quat[mesh]).T
            at = R.T @ (d.geom_xpos[g] - p) - turn @ m.mesh_pos[mesh]  # of the file's origin
            if m.mesh_pathadr[mesh] >= 0 and Path(file).is_file():
                scale = tuple(m.mesh_scale[mesh].tolist())
                out.append(MeshFile(file=file, scale=scale).placed(turn, at))
        return out

    def notes(self, moving: list[str]) -> list[str]:
        """Return which springs, and which tendons that act by themselves, are left out."""
        m, names = self.model, set(moving)
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
