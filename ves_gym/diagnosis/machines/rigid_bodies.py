"""Forces that the motion of rigid bodies on a fixed base takes: MuJoCo's for models in MJCF,
Pinocchio's for URDF.

Inverse dynamics divide by no inertia, so a model that could not be simulated (a last link
without moment of inertia, or with base parameters alone) is good enough here.
"""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import mujoco
import numpy as np

from ves_gym._util.params import Array, ParameterError
from ves_gym._util.reading import named, read_xml
from ves_gym.mechanics.body_numbers import POINT_MASSES, per_number

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
        """Return (T, n) forces at the joints [N m, N] that a motion (T, n) takes."""

    def payload(self, q: Array, v: Array, a: Array) -> Array:
        """Return (T, n, 10) forces per unit of each of `PARAMETERS` added to the last body."""

    def properties(self) -> dict[str, Array]:
        """Return (n,) each of `JOINT_PROPERTIES`."""


class MjcfBodies:
    """Bodies of a compiled MJCF model of exactly these joints, names and types.

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
        """Return as `RigidBodies.payload`: forces of point masses span it."""
        model = self._bare()
        model.body_mass[:] = model.body_inertia[:] = 0.0
        _moved_apart(model, self.last)
        empty, forces = self._inverse(model, q, v, a), []
        model.body_mass[self.last] = 1.0
        for point in POINT_MASSES:
            model.body_ipos[self.last] = point.com
            forces.append(self._inverse(model, q, v, a) - empty)
        return np.moveaxis(np.tensordot(per_number(), np.stack(forces), 1), 0, -1)

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
    """Bodies of a URDF file, its fixed joints merged; meshes need not be there.

    Args:
        path: the file.
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
            read_xml(path)
            try:
                model = pin.buildModelFromUrdf(str(path))
            except (ValueError, RuntimeError) as error:
                raise ParameterError(f"cannot be read: {error}") from None
        names = list(model.names)[1:]
        for name in (k for k in locked if k not in names):
            raise ParameterError(_lacking(name, names))
        if locked:
            ids = [model.getJointId(name) for name in locked]
            model = pin.buildReducedModel(model, ids, pin.neutral(model))
        kinds = {}
        for name, joint in zip(list(model.names)[1:], list(model.joints)[1:], strict=True):
            slides = "JointModelP" in joint.shortname()
            kinds[name] = "" if joint.nv != 1 else "slide" if slides else "hinge"
        _require_joints(kinds, joints, "; give their columns, or name them in `locked`")
        self._model, self._data = model, model.createData()
        self._ids = [model.getJointId(j) for j, _ in joints]
        self._at_v = np.array([model.joints[i].idx_v for i in self._ids])
        self._massive = [i for i in range(1, model.njoints) if model.inertias[i].mass > 0]
        links = {
            f.parentJoint: f.name
            for f in reversed(list(model.frames))
            if f.type == pin.FrameType.BODY
        }
        self.bodies = tuple(links[i] for i in self._massive)
        self.last = int(max(range(1, model.njoints), key=lambda i: len(model.supports[i])))

    def properties(self) -> dict[str, Array]:
        """Return (n,) each of `JOINT_PROPERTIES`; a URDF has no armature."""
        model = self._model
        every = (model.damping, model.friction, np.zeros(model.nv))
        return {k: x[self._at_v] for k, x in zip(JOINT_PROPERTIES, every, strict=True)}

    def load(self, q: Array, v: Array, a: Array, changes: Sequence[BodyChange] = ()) -> Array:
        """Return as `RigidBodies.load`."""
        model = self._model
        if changes:
            model = self._model.copy()
            for change in changes:
                inertial = model.inertias[self._massive[change.body]]
                inertial.mass = change.scale * inertial.mass
                inertial.inertia = change.scale * inertial.inertia
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
    """Return which k of `PARAMETERS` of a payload the forces at n joints can tell, in order.

    One that does the same as those before it is left out. Beside them, (k, 10), what each shows
    of all ten, those left out included.
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
    """Return one of `JOINT_PROPERTIES` (nv,), as far as it acts and is one number a joint."""
    value = np.array(getattr(model, f"dof_{name}"))
    if any(model.opt.disableflags & int(flag) for flag in _OFF.get(name, ())):
        value[:] = 0.0
    if name == "damping" and hasattr(model, "dof_dampingpoly"):  # a law of its own
        value[(model.dof_dampingpoly != 0).any(axis=-1)] = 0.0
    return value


def _addresses(model: mujoco.MjModel, joints: Sequence[tuple[str, str]]) -> tuple[Any, Any]:
    """Return the place of each joint in qpos and in qvel, (n,) each."""
    indices = {model.joint(i).name: i for i in range(model.njnt)}
    kinds = {k: _TYPES.get(int(model.jnt_type[i]), "") for k, i in indices.items()}
    _require_joints(kinds, joints)
    ids = [indices[j] for j, _ in joints]
    return model.jnt_qposadr[ids].copy(), model.jnt_dofadr[ids].copy()


def _require_joints(
    kinds: Mapping[str, str], joints: Sequence[tuple[str, str]], remedy: str = ""
) -> None:
    """Refuse joints (name, type) that a model lacks, has besides, or has of another type."""
    for name in (k for k, kind in kinds.items() if not kind):
        raise ParameterError(
            f"joint {name} of the model is neither hinge nor slide: only machines on a fixed"
            " base, of hinges and slides, are understood"
        )
    for name, kind in joints:
        if name not in kinds:
            raise ParameterError(_lacking(name, kinds))
        if kinds[name] != kind:
            raise ParameterError(f"joint {name} is a {kinds[name]} in the model, a {kind} here")
    if beside := sorted(set(kinds) - {j for j, _ in joints}):
        raise ParameterError(
            f"joints of the model without columns: {', '.join(beside)}{remedy}"
        )


def _lacking(name: str, names: Iterable[str]) -> str:
    return f"the model has no joint {name!r}; it has {', '.join(names)}"


def _moved_apart(model: mujoco.MjModel, body: int) -> None:
    """Tell MuJoCo that a body's centre of mass is no longer where its frame is.

    Constants of the model (`mj_setConst`) are of solvers; inverse dynamics use none of them.
    """
    model.body_sameframe[body] = 0
    model.body_simple[body] = 0
