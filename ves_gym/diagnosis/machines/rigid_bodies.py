"""Forces that the motion of rigid bodies on a fixed base takes: MuJoCo's for models in MJCF,
Pinocchio's for URDF.

Inverse dynamics divide by no inertia, so a model that could not be simulated (a last link
without moment of inertia, or with base parameters alone) is good enough here.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol
from xml.etree.ElementTree import Element

import mujoco
import numpy as np

from ves_gym._util.params import Array, ParameterError
from ves_gym._util.reading import named, read_xml
from ves_gym.mechanics.body_numbers import PLACES

JOINT_PROPERTIES = ("damping", "frictionloss", "armature")  # that laws of the library say, too
_OFF = {  # flags that take it away
    "damping": (mujoco.mjtDisableBit.mjDSBL_DAMPER,),
    "frictionloss": (
        mujoco.mjtDisableBit.mjDSBL_FRICTIONLOSS,
        mujoco.mjtDisableBit.mjDSBL_CONSTRAINT,
    ),
}
_TYPES = {
    int(mujoco.mjtJoint.mjJNT_HINGE): "hinge",
    int(mujoco.mjtJoint.mjJNT_SLIDE): "slide",
}
_REACH = 0.3  # m: of point masses that a body's parameters are put together from


@dataclass(frozen=True)
class BodyChange:
    """A body that is otherwise than described."""

    body: int  # in `RigidBodies.bodies`
    scale: float = 1.0  # of mass and inertia
    shift: tuple[float, float, float] = (0.0, 0.0, 0.0)  # of the centre of mass, body axes [m]


class RigidBodies(Protocol):
    """Bodies that n joints move, in the order of these joints."""

    bodies: tuple[str, ...]  # that have mass and move
    last: int  # the body farthest from the base that the joints move, with or without mass

    def load(self, q: Array, v: Array, a: Array, changes: Sequence[BodyChange] = ()) -> Array:
        """Return (T, n) forces at the joints that a motion takes [N m, N].

        Args:
            q, v, a: (T, n) positions, rates, accelerations of the joints.
            changes: bodies otherwise than described.
        """

    def payload(self, q: Array, v: Array, a: Array) -> Array:
        """Return (T, n, 10) forces per unit of each of `PARAMETERS` added to the last body.

        Args:
            q, v, a: (T, n) positions, rates, accelerations of the joints.
        """

    def properties(self) -> dict[str, Array]:
        """Return (n,) each of `JOINT_PROPERTIES`."""


class MjcfBodies:
    """Bodies of a compiled MJCF model.

    Args:
        model: of exactly these joints.
        joints: names and types ("hinge", "slide"), in the order of the columns.

    Raises:
        ParameterError: joints that the model lacks, has besides, or has of another type.
    """

    def __init__(self, model: mujoco.MjModel, joints: Sequence[tuple[str, str]]) -> None:
        self.model = model
        self._qpos, self.dof = _addresses(model, joints)
        ids = np.flatnonzero((model.body_weldid > 0) & (model.body_mass > 0)).tolist()
        self._ids = [int(i) for i in ids]
        self.bodies = tuple(model.body(i).name or f"body {i}" for i in self._ids)
        depth = np.zeros(model.nbody, int)
        for i in range(1, model.nbody):
            depth[i] = depth[model.body_parentid[i]] + int(model.body_jntnum[i])
        self.last = int(np.argmax(depth))

    def properties(self) -> dict[str, Array]:
        """Return (n,) each of `JOINT_PROPERTIES`."""
        return {name: joint_property(self.model, name)[self.dof] for name in JOINT_PROPERTIES}

    def load(self, q: Array, v: Array, a: Array, changes: Sequence[BodyChange] = ()) -> Array:
        """Return as `RigidBodies.load`, without what `JOINT_PROPERTIES` take."""
        model = self._bare()
        for change in changes:
            body = self._ids[change.body]
            model.body_mass[body] *= change.scale
            model.body_inertia[body] *= change.scale
            if any(change.shift):
                model.body_ipos[body] += change.shift
                _moved_apart(model, body)
        return self._inverse(model, q, v, a)

    def payload(self, q: Array, v: Array, a: Array) -> Array:
        """Return as `RigidBodies.payload`: put together from point masses, in which forces
        are linear."""
        none = self._inverse(self._bare(), q, v, a)

        def point(*place: float) -> Array:
            """Forces of 1 kg at a place of the last body's frame."""
            model = self._bare()
            _add_point(model, self.last, np.array(place) * _REACH)
            return self._inverse(model, q, v, a) - none

        origin, eye = point(0, 0, 0), np.eye(3)
        ahead, back = ([point(*(s * e)) for e in eye] for s in (1, -1))
        moment = [(x - y) / (2 * _REACH) for x, y in zip(ahead, back, strict=True)]
        second = {  # of the mass distribution: per sum of m x_i x_j
            (i, i): (ahead[i] + back[i] - 2 * origin) / (2 * _REACH**2) for i in range(3)
        }
        for i, j in ((0, 1), (0, 2), (1, 2)):
            both = point(*(eye[i] + eye[j]))
            mixed = (both - ahead[i] - ahead[j] + origin) / _REACH**2
            second[i, j] = mixed  # m x_i x_j counts twice in it, as the matrix has it twice
        trace = sum(second[i, i] for i in range(3)) / 2
        inertia = [trace - second[i, i] if i == j else -second[i, j] for i, j in PLACES]
        return np.stack([origin, *moment, *inertia], axis=-1)

    def _bare(self) -> mujoco.MjModel:
        model = copy.copy(self.model)
        for name in JOINT_PROPERTIES:
            getattr(model, f"dof_{name}")[joint_property(model, name) != 0] = 0.0
        return model

    def _inverse(self, model: mujoco.MjModel, q: Array, v: Array, a: Array) -> Array:
        data = mujoco.MjData(model)
        qpos, dof = self._qpos, self.dof
        out = np.empty_like(q)
        at, rate, rise, needed = data.qpos, data.qvel, data.qacc, data.qfrc_inverse
        for k in range(len(q)):
            at[qpos], rate[dof], rise[dof] = q[k], v[k], a[k]
            mujoco.mj_inverse(model, data)
            out[k] = needed[dof]
        return out


class UrdfBodies:
    """Bodies of a URDF file, its fixed joints merged.

    Args:
        path: the file; meshes need not be there.
        joints: names and types ("hinge", "slide"), in the order of the columns.
        locked: joints that stand still at zero.

    Raises:
        ParameterError: cannot be read; joints that it lacks, has besides, or of another type.
    """

    def __init__(
        self, path: Path, joints: Sequence[tuple[str, str]], locked: Sequence[str] = ()
    ) -> None:
        import pinocchio as pin

        self._pin, self.path = pin, path
        with named(f"model {path}"):
            root = read_xml(path)
            try:
                model = pin.buildModelFromUrdf(str(path))
            except (ValueError, RuntimeError) as error:
                raise ParameterError(f"cannot be read: {error}") from None
        names = list(model.names)[1:]
        for name in (*locked, *(j for j, _ in joints)):
            if name not in names:
                raise ParameterError(
                    f"the model has no joint {name!r}; it has {', '.join(names)}"
                )
        if locked:
            ids = [model.getJointId(name) for name in locked]
            model = pin.buildReducedModel(model, ids, pin.neutral(model))
        beside = sorted(set(names) - {j for j, _ in joints} - set(locked))
        if beside:
            raise ParameterError(
                f"joints of the model without columns: {', '.join(beside)}; give their columns,"
                " or name them in `locked`"
            )
        self._model, self._data = model, model.createData()
        self._ids = [model.getJointId(j) for j, _ in joints]
        for (name, kind), i in zip(joints, self._ids, strict=True):
            short = model.joints[i].shortname()
            actual = "slide" if "JointModelP" in short else "hinge"
            if model.joints[i].nv != 1 or actual != kind:
                raise ParameterError(f"joint {name} is a {actual} in the model, a {kind} here")
        self._at_v = np.array([model.joints[i].idx_v for i in self._ids])
        self._massive = [i for i in range(1, model.njoints) if model.inertias[i].mass > 0]
        links = {j.get("name"): _child(j) for j in root.iter("joint")}
        self.bodies = tuple(links[model.names[i]] for i in self._massive)
        self.last = int(max(range(1, model.njoints), key=lambda i: len(model.supports[i])))
        self._joint_properties = _urdf_properties(root, [j for j, _ in joints])

    def properties(self) -> dict[str, Array]:
        """Return (n,) each of `JOINT_PROPERTIES`."""
        return self._joint_properties

    def load(self, q: Array, v: Array, a: Array, changes: Sequence[BodyChange] = ()) -> Array:
        """Return as `RigidBodies.load`."""
        model = self._model
        if changes:
            model = self._model.copy()
            for change in changes:
                inertial = model.inertias[self._massive[change.body]]
                inertial.mass, inertial.inertia = (
                    change.scale * inertial.mass,
                    change.scale * inertial.inertia,
                )
                inertial.lever = inertial.lever + np.array(change.shift)
        Q, V, A = self._ordered(q, v, a)
        rnea, data = self._pin.rnea, self._data
        out = np.array([rnea(model, data, Q[k], V[k], A[k]) for k in range(len(Q))])
        return out[:, self._at_v]

    def payload(self, q: Array, v: Array, a: Array) -> Array:
        """Return as `RigidBodies.payload`: columns of Pinocchio's regressor."""
        Q, V, A = self._ordered(q, v, a)
        first = 10 * (self.last - 1)
        regressor = self._pin.computeJointTorqueRegressor
        out = np.empty((len(Q), len(self._ids), 10))
        for k in range(len(Q)):
            full = regressor(self._model, self._data, Q[k], V[k], A[k])
            out[k] = full[self._at_v, first : first + 10]
        return out

    def _ordered(self, q: Array, v: Array, a: Array) -> tuple[Array, Array, Array]:
        """Return (T, nq), (T, nv), (T, nv) in the model's order."""
        model = self._model
        Q = np.zeros((len(q), model.nq))
        for column, i in enumerate(self._ids):
            joint, at = model.joints[i], model.joints[i].idx_q
            if joint.nq == 2:  # an endless turn is a point of the circle
                Q[:, at], Q[:, at + 1] = np.cos(q[:, column]), np.sin(q[:, column])
            else:
                Q[:, at] = q[:, column]
        V, A = np.zeros((len(q), model.nv)), np.zeros((len(q), model.nv))
        V[:, self._at_v], A[:, self._at_v] = v, a
        return Q, V, A


def visible_parameters(bodies: RigidBodies, n: int) -> tuple[list[int], Array]:
    """Return which of `PARAMETERS` of a payload the forces at the joints can tell, in order.

    A parameter that does the same as those before it is left out.

    Args:
        bodies: of the machine.
        n: joints.

    Returns:
        Their k places, and (k, 10) what each shows of all ten, those left out included.
    """
    q, v, a = np.random.default_rng(0).normal(size=(3, 40, n))
    columns = bodies.payload(q, v, a).reshape(-1, 10)
    taken: list[int] = []
    size = np.linalg.norm(columns, axis=0)
    for k in np.flatnonzero(size > 1e-9 * size.max()).tolist():
        trial = columns[:, [*taken, k]] / size[[*taken, k]]
        if np.linalg.svd(trial, compute_uv=False)[-1] > 1e-6:
            taken.append(k)
    projection = np.linalg.lstsq(columns[:, taken], columns, rcond=None)[0]
    return taken, np.asarray(projection, float)


def joint_property(model: mujoco.MjModel, name: str) -> Array:
    """Return a property as far as it acts and is one number per joint.

    Args:
        model: compiled.
        name: damping, frictionloss or armature.

    Returns:
        (nv,).
    """
    value = np.array(getattr(model, f"dof_{name}"))
    if any(model.opt.disableflags & int(flag) for flag in _OFF.get(name, ())):
        value[:] = 0.0
    if name == "damping" and hasattr(model, "dof_dampingpoly"):  # a law of its own
        value[(model.dof_dampingpoly != 0).any(axis=-1)] = 0.0
    return value


def _addresses(model: mujoco.MjModel, joints: Sequence[tuple[str, str]]) -> tuple[Any, Any]:
    """Return the place of each joint in qpos and in qvel, (n,) each."""
    indices = {model.joint(i).name: i for i in range(model.njnt)}
    for name, i in indices.items():
        if int(model.jnt_type[i]) not in _TYPES:
            raise ParameterError(
                f"joint {name or i} of the model is neither hinge nor slide: only machines on"
                " a fixed base, of hinges and slides, are understood"
            )
    for name, kind in joints:
        if name not in indices:
            raise ParameterError(
                f"the model has no joint {name!r}; it has {', '.join(indices)}"
            )
        actual = _TYPES[int(model.jnt_type[indices[name]])]
        if actual != kind:
            raise ParameterError(f"joint {name} is a {actual} in the model, a {kind} here")
    beside = sorted(set(indices) - {j for j, _ in joints})
    if beside:
        raise ParameterError(f"joints of the model without columns: {', '.join(beside)}")
    ids = [indices[j] for j, _ in joints]
    return model.jnt_qposadr[ids].copy(), model.jnt_dofadr[ids].copy()


def _add_point(model: mujoco.MjModel, body: int, place: Array) -> None:
    """Put 1 kg at a place (3,) of a body's frame."""
    mass, com = float(model.body_mass[body]), model.body_ipos[body].copy()
    turn = np.empty(9)
    mujoco.mju_quat2Mat(turn, model.body_iquat[body])
    R = turn.reshape(3, 3)
    about = R @ np.diag(model.body_inertia[body]) @ R.T
    total = mass + 1.0
    centre = (mass * com + place) / total
    for m, c in ((mass, com - centre), (1.0, place - centre)):
        about = about + m * (c @ c * np.eye(3) - np.outer(c, c))
    value, axes = np.linalg.eigh(about)
    axes = axes * np.sign(np.linalg.det(axes))
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, axes.ravel())
    model.body_mass[body], model.body_ipos[body] = total, centre
    model.body_inertia[body], model.body_iquat[body] = value, quaternion
    _moved_apart(model, body)


def _moved_apart(model: mujoco.MjModel, body: int) -> None:
    """Tell MuJoCo that a body's centre of mass is no longer where its frame is.

    Constants of the model (`mj_setConst`) are of solvers; inverse dynamics use none of them.
    """
    model.body_sameframe[body] = 0
    model.body_simple[body] = 0


def _child(joint: Element) -> str:
    link = joint.find("child")
    return "" if link is None else link.get("link", "")


def _urdf_properties(root: Element, joints: Sequence[str]) -> dict[str, Array]:
    """Return what <dynamics> of each joint says (n,); a URDF has no armature."""
    dynamics = {j.get("name"): j.find("dynamics") for j in root.iter("joint")}

    def number(joint: str, key: str) -> float:
        element = dynamics.get(joint)
        text = "0" if element is None else element.get(key, "0")
        try:
            return float(text)
        except ValueError:
            raise ParameterError(
                f"joint {joint}: {key} must be a number, got {text!r}"
            ) from None

    return {
        "damping": np.array([number(j, "damping") for j in joints]),
        "frictionloss": np.array([number(j, "friction") for j in joints]),
        "armature": np.zeros(len(joints)),
    }
