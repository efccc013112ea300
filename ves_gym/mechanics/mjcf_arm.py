"""Arms from MJCF files, as MuJoCo compiles them: defaults, includes and units resolved."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from ves_gym._util.params import Array, ParameterError
from ves_gym.mechanics.chain import (
    ENDLESS,
    ChainChoice,
    Joint,
    LinkMass,
    Lump,
    arm_of,
    given_rotors,
    require_body,
    require_plausible,
)
from ves_gym.mechanics.meshes import capsule_around
from ves_gym.mechanics.serial_chain import BANDWIDTH, SerialChain

_TOOL = "tool"  # site that is the tool where none is named
NUMBERS = "ves_v_max", "ves_a_max", "ves_bandwidth"  # <numeric> of what MJCF has no place for


def read_mjcf(path: str | os.PathLike[str], choice: ChainChoice) -> SerialChain:
    """Read an arm from an MJCF file, see `Arm.from_mjcf`.

    Args:
        path: the file.
        choice: the chain in it.

    Raises:
        ParameterError: names the body or the joint, and what is wrong with it.
    """
    path = Path(path)
    try:
        return _Reader(path, choice.root).arm(choice)
    except ParameterError as error:
        raise ParameterError(f"{path.name}: {error}") from None


class _Reader:
    """A compiled model, and what it is asked for by name."""

    def __init__(self, path: Path, root: str | None) -> None:
        from ves_gym._util.mujoco_loader import mujoco

        self.path, self.mj = path, mujoco
        try:
            self.model = mujoco.MjModel.from_xml_path(str(path))
        except (ValueError, OSError) as error:
            raise ParameterError(f"MuJoCo cannot compile it: {error}") from None
        self.data = mujoco.MjData(self.model)
        self.root = 0 if root is None else self._id("body", root, "root")

    def arm(self, choice: ChainChoice) -> SerialChain:
        """Return the chain to the tip."""
        m, d = self.model, self.data
        tip, _, locked, collision, check, rotors = choice
        end, site = self._tip(tip)
        chain = self._chain(end)
        on_chain = [j for body in chain for j in self._joints(body)]
        for name in locked:
            self._id("joint", name, "locked")
        hinges = [j for j in on_chain if self._name("joint", j) not in locked]
        for j in hinges:
            self._require_hinge(j)
        if not hinges:
            raise ParameterError(f"no hinge or slide lies between its root and {tip or end!r}")
        self._require_free(hinges, chain)
        d.qpos[:] = m.qpos0
        for j in hinges:
            d.qpos[m.jnt_qposadr[j]] = 0.0
        for name, value in locked.items():
            d.qpos[m.jnt_qposadr[self._id("joint", name, "locked")]] = value
        self.mj.mj_kinematics(m, d)

        frame = (d.xmat[self.root].reshape(3, 3), d.xpos[self.root])
        lumps, pieces = {-1: Lump()} | {j: Lump() for j in hinges}, []
        still: list[str] = []
        for body in self._subtree(chain[0] if self.root == 0 else self.root):
            mover = self._mover(body, set(hinges))
            names = [self._name("joint", j) for j in self._joints(body) if j not in hinges]
            still += [f"{k} at {locked.get(k, 0.0):g}" for k in names if body != self.root]
            piece = self._piece(body, frame)
            require_body(piece)
            lumps[mover].add(piece)
            if mover >= 0:
                pieces.append(piece)
            if collision:
                lumps[mover].capsules += self._capsules(body, frame)
        joints = [self._joint(j, lumps[j], frame) for j in hinges]
        given = given_rotors(joints, rotors)
        values = self._numbers(len(joints))
        for k, joint in enumerate(joints):
            joint.v_max = values["ves_v_max"][k] if "ves_v_max" in values else None
            joint.a_max = values["ves_a_max"][k] if "ves_a_max" in values else None
        R, p = (d.site_xmat, d.site_xpos) if site >= 0 else (d.xmat, d.xpos)
        at = site if site >= 0 else end
        tool = (frame[0].T @ R[at].reshape(3, 3), frame[0].T @ (p[at] - frame[1]))
        if check:
            require_plausible(joints, tool[1], pieces)
        top = self._name("body", self.root)
        notes = [f"read from {self.path.name}, {top} to {self._tool_name(end, site)}"]
        if still:
            notes.append(f"joints that stand still: {', '.join(still)}")
        springs = [self._name("joint", j) for j in hinges if _first(m.jnt_stiffness[j])]
        if springs:
            notes.append(f"springs left out: {', '.join(springs)}")
        notes += given
        bandwidth = values.get("ves_bandwidth", [BANDWIDTH])[0]
        return arm_of(
            self._model_name(),
            lumps[-1],
            joints,
            tool,
            source="; ".join(notes),
            collision=collision,
            bandwidth=float(bandwidth),
        )

    # ------------------------------------------------------------------- names, tree

    def _id(self, kind: str, name: str, what: str) -> int:
        kinds = self.mj.mjtObj
        number = int(
            self.mj.mj_name2id(self.model, getattr(kinds, f"mjOBJ_{kind.upper()}"), name)
        )
        if number < 0:
            count = getattr(self.model, {"body": "nbody", "joint": "njnt"}[kind])
            names = ", ".join(self._name(kind, k) for k in range(count))
            raise ParameterError(f"{what}: no {kind} {name!r}; there are {names}")
        return number

    def _name(self, kind: str, number: int) -> str:
        which = getattr(self.mj.mjtObj, f"mjOBJ_{kind.upper()}")
        return self.mj.mj_id2name(self.model, which, number) or f"{kind} {number}"

    def _model_name(self) -> str:
        name = bytes(self.model.names).split(b"\0", 1)[0].decode()
        return name if name and name != "MuJoCo Model" else self.path.stem

    def _tool_name(self, end: int, site: int) -> str:
        return self._name("site", site) if site >= 0 else self._name("body", end)

    def _joints(self, body: int) -> list[int]:
        first = int(self.model.body_jntadr[body])
        return list(range(first, first + int(self.model.body_jntnum[body])))

    def _subtree(self, top: int) -> list[int]:
        inside = {top}
        for body in range(top + 1, self.model.nbody):
            if int(self.model.body_parentid[body]) in inside:
                inside.add(body)
        return sorted(inside)

    def _tip(self, tip: str | None) -> tuple[int, int]:
        """Body and site (-1: none) of the tool."""
        m, find = self.model, self.mj.mj_name2id
        target = _TOOL if tip is None else tip
        site = int(find(m, self.mj.mjtObj.mjOBJ_SITE, target))
        if site >= 0:
            return int(m.site_bodyid[site]), site
        if tip is not None:
            return self._id("body", tip, "tip"), -1
        parents = set(m.body_parentid[1:].tolist())
        inside = self._subtree(self.root)
        ends = [
            b
            for b in inside
            if b not in parents and any(self._joints(k) for k in self._above(b))
        ]
        if len(ends) == 1:
            return ends[0], -1
        names = ", ".join(self._name("body", b) for b in ends)
        if not ends:
            raise ParameterError(f"no joint moves beyond {self._name('body', self.root)!r}")
        raise ParameterError(
            f"has {len(ends)} ends: {names}; name the body or the site that is the tool"
            f" (tip={self._name('body', ends[0])!r}, or"
            f" {self.path.name}#{self._name('body', ends[0])})"
        )

    def _above(self, body: int) -> list[int]:
        """The body and its parents up to the root, without it."""
        out = []
        while body not in (self.root, 0):
            out.append(body)
            body = int(self.model.body_parentid[body])
        return out

    def _chain(self, end: int) -> list[int]:
        chain = self._above(end)[::-1]
        if not chain or int(self.model.body_parentid[chain[0]]) != self.root:
            names = self._name("body", self.root), self._name("body", end)
            raise ParameterError("no chain leads from {!r} to {!r}".format(*names))
        return chain

    def _mover(self, body: int, hinges: set[int]) -> int:
        """The last hinge that moves a body, -1: none."""
        for k in self._above(body):
            hinged = [j for j in self._joints(k) if j in hinges]
            if hinged:
                return hinged[-1]
        return -1

    # -------------------------------------------------------------------- what it has

    def _require_hinge(self, j: int) -> None:
        kinds = ("free", "ball", "slide", "hinge")
        kind = kinds[int(self.model.jnt_type[j])]
        if kind == "hinge" or (kind == "slide" and self.model.jnt_limited[j]):
            return
        name, body = self._name("joint", j), self._name("body", self.model.jnt_bodyid[j])
        hint = {
            "free": f"root={body!r} stands it on the platform",
            "slide": f"give it a range, or locked={{{name!r}: 0.0}} holds it",
        }.get(kind, "a root below it leaves it out (root=BODY)")
        raise ParameterError(
            f"joint {name!r} of body {body!r} is a {kind} joint: an arm has hinges, and slides"
            f" with a range; {hint}"
        )

    def _require_free(self, hinges: list[int], chain: list[int]) -> None:
        """Refuse constraints that make the chain no chain."""
        m, kinds = self.model, self.mj.mjtEq
        for k in range(m.neq):
            if not m.eq_active0[k]:
                continue
            first_id, second_id = int(m.eq_obj1id[k]), int(m.eq_obj2id[k])
            kind = kinds(int(m.eq_type[k]))
            if kind == kinds.mjEQ_JOINT:
                for j in (first_id, second_id):
                    if j in hinges:
                        other = second_id if j == first_id else first_id
                        tied = self._name("joint", other) if other >= 0 else "a constant"
                        raise ParameterError(
                            f"joint {self._name('joint', j)!r} is tied to {tied!r} by"
                            " <equality>: an arm has joints of their own; locked= holds it"
                        )
            elif kind in (kinds.mjEQ_CONNECT, kinds.mjEQ_WELD):
                if int(m.eq_objtype[k]) != int(self.mj.mjtObj.mjOBJ_BODY):
                    continue
                moved = [b for b in (first_id, second_id) if b in chain]
                mocap = [b for b in (first_id, second_id) if m.body_mocapid[b] >= 0]
                if moved and not mocap:
                    raise ParameterError(
                        f"body {self._name('body', moved[0])!r} is held by <equality>: an arm"
                        " is an open chain"
                    )

    def _piece(self, body: int, frame: tuple[Array, Array]) -> LinkMass:
        m, d = self.model, self.data
        R, p = frame
        axes = R.T @ d.ximat[body].reshape(3, 3)
        moments = (axes * m.body_inertia[body]) @ axes.T
        return LinkMass(
            self._name("body", body),
            float(m.body_mass[body]),
            R.T @ (d.xipos[body] - p),
            (moments + moments.T) / 2,
        )

    def _joint(self, j: int, body: Lump, frame: tuple[Array, Array]) -> Joint:
        m, d = self.model, self.data
        R, p = frame
        dof = int(m.jnt_dofadr[j])
        low, high = m.jnt_range[j].tolist() if m.jnt_limited[j] else (-ENDLESS, ENDLESS)
        axis = R.T @ d.xaxis[j]
        return Joint(
            name=self._name("joint", j),
            origin=R.T @ (d.xanchor[j] - p),
            axis=axis / np.linalg.norm(axis),
            q_min=low,
            q_max=high,
            body=body,
            rotor_inertia=float(m.dof_armature[dof]),
            tau_max=self._torque(j),
            damping=_first(m.dof_damping[dof]),
            friction=_first(m.dof_frictionloss[dof]),
            slides=int(m.jnt_type[j]) == int(self.mj.mjtJoint.mjJNT_SLIDE),
        )

    def _torque(self, j: int) -> float | None:
        """The largest torque of a joint's actuators, as far as the file limits it [N m]."""
        m = self.model
        limits = [np.abs(m.jnt_actfrcrange[j]).max()] if m.jnt_actfrclimited[j] else []
        for k in range(m.nu):
            if int(m.actuator_trntype[k]) != int(self.mj.mjtTrn.mjTRN_JOINT):
                continue
            if int(m.actuator_trnid[k, 0]) != j:
                continue
            gear = abs(float(m.actuator_gear[k, 0]))
            if m.actuator_forcelimited[k]:
                limits.append(gear * np.abs(m.actuator_forcerange[k]).max())
            elif m.actuator_ctrllimited[k] and not m.actuator_biasprm[k].any():
                most = np.abs(m.actuator_ctrlrange[k]).max()
                limits.append(gear * abs(m.actuator_gainprm[k, 0]) * most)
        return float(min(limits)) if limits else None

    def _numbers(self, n: int) -> dict[str, list[float]]:
        """Numbers that `Arm.to_mjcf` writes beside what MJCF has elements for."""
        m, out = self.model, {}
        for name in NUMBERS:
            k = int(self.mj.mj_name2id(m, self.mj.mjtObj.mjOBJ_NUMERIC, name))
            if k >= 0:
                first, size = int(m.numeric_adr[k]), int(m.numeric_size[k])
                if size in (1, n):
                    out[name] = m.numeric_data[first : first + size].tolist()
        return out

    def _capsules(
        self, body: int, frame: tuple[Array, Array]
    ) -> list[tuple[Array, Array, float]]:
        """A body's shapes that meet others, as capsules that hold them."""
        m, d, out = self.model, self.data, []
        R, p = frame
        first = int(m.body_geomadr[body])
        for g in range(first, first + int(m.body_geomnum[body])):
            if m.geom_contype[g] or m.geom_conaffinity[g]:
                shape = self._capsule(g)
                if shape is not None:
                    turn, at = d.geom_xmat[g].reshape(3, 3), d.geom_xpos[g]
                    a, b = (R.T @ (turn @ k + at - p) for k in shape[:2])
                    out.append((a, b, float(shape[2])))
        return out

    def _capsule(self, g: int) -> tuple[Array, Array, float] | None:
        """A capsule that holds a shape, in its own frame; None of a plane or a height field."""
        m, kinds = self.model, self.mj.mjtGeom
        size, kind = m.geom_size[g], kinds(int(m.geom_type[g]))
        zero, z = np.zeros(3), np.array([0.0, 0.0, 1.0])
        if kind == kinds.mjGEOM_SPHERE:
            return zero, zero, size[0]
        if kind in (kinds.mjGEOM_CAPSULE, kinds.mjGEOM_CYLINDER):
            return -size[1] * z, size[1] * z, size[0]
        if kind in (kinds.mjGEOM_BOX, kinds.mjGEOM_ELLIPSOID):
            corners = np.array(np.meshgrid(*[[-1.0, 1.0]] * 3)).reshape(3, -1).T
            return capsule_around(corners * size)
        if kind == kinds.mjGEOM_MESH:
            mesh = int(m.geom_dataid[g])
            first = int(m.mesh_vertadr[mesh])
            points: Any = m.mesh_vert[first : first + int(m.mesh_vertnum[mesh])]
            return capsule_around(np.unique(np.array(points, float), axis=0))
        return None


def _first(value: Any) -> float:
    """The linear term of a coefficient, which some versions have as a polynomial."""
    return float(np.atleast_1d(value)[0])
