"""The reference engine: MuJoCo's native batch of simulations."""

from __future__ import annotations

import ctypes
import os
import weakref
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ves_gym._util.mujoco_loader import mujoco  # before its submodules

# isort: split
from mujoco.batch import MODEL_FIELDS, Batch

from ves_gym._util.params import Array, Index, Mask, ParameterError
from ves_gym.engine.batch_parameters import Laws, bodies_of
from ves_gym.engine.mjcf import (
    LEAST,
    TO_Y,
    add_carried,
    add_hidden,
    add_jets,
    build_laboratory_spec,
    build_spec,
    places,
)
from ves_gym.mechanics.attitude import from_matrix
from ves_gym.mechanics.gravity import GRAVITY
from ves_gym.mechanics.vehicle import ReactionWheel, has_jets
from ves_gym.system.effect import TorqueEffect
from ves_gym.system.effect_rows import EffectRows
from ves_gym.system.system import System

if TYPE_CHECKING:
    from ves_gym.engine.backends.compiled import EngineContact

_BAD = [
    int(w)
    for w in (
        mujoco.mjtWarning.mjWARN_BADQPOS,
        mujoco.mjtWarning.mjWARN_BADQVEL,
        mujoco.mjtWarning.mjWARN_BADQACC,
        mujoco.mjtWarning.mjWARN_BADCTRL,
    )
]


_BATCHES: weakref.WeakSet[Batch] = weakref.WeakSet()


def _keep_in_a_fork() -> None:
    """Let a forked process destroy no batch of its parent: it would wait for threads for ever.

    Gymnasium's `AsyncVectorEnv` forks, and what is garbage in the parent is so in the child.
    """
    for batch in _BATCHES:
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(batch))


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_keep_in_a_fork)


_FOLLOWING = 1e8  # times the arm's own inertia: what a prescribed joint has more of


def following_inertia(system: System) -> float:
    """Armature [kg m^2, kg] of joints that follow their command: MuJoCo prescribes no motion.

    They stray from it by 1e-8 of itself at most, and the torque of their
    drives loses 1e-7 of what moves the whole arm to rounding.
    """
    payload = 0.0 if system.payload is None else system.payload.inertial.mass
    lever = sum(abs(link.a) + abs(link.d) for link in system.arm.links)
    rotor = system.arm.column("rotor_inertia").max()
    return float(_FOLLOWING * (rotor + (system.arm.mass + payload) * max(lever, 1.0) ** 2))


def compile_model(
    system: System, full: bool = False, acting: bool = False, following: float | None = None
) -> mujoco.MjModel:
    """Return the MuJoCo model of a system, as the backend runs it.

    Args:
        system, full, acting, following: see `model_spec`.
    """
    return model_spec(system, full, acting, following).compile()


def model_spec(
    system: System, full: bool = False, acting: bool = False, following: float | None = None
) -> mujoco.MjSpec:
    """Return the MuJoCo specification of a system, before it is compiled.

    Args:
        system: what to simulate.
        full: one layout for every model of one structure, see `build_spec`.
        acting: with actuators for the jets of a satellite, and with what the tool touches.
        following: armature of prescribed joints, by default `following_inertia`.
    """
    if system.mode == "emulated":
        spec = build_laboratory_spec(
            system.arm,
            gravity=(0.0, 0.0, -GRAVITY),
            balance=system.emulator_settings.joint_balance,
            integrator=system.integrator,
            physics_dt=system.physics_dt,
        )
    else:
        spec = build_spec(
            system.arm,
            system.base,
            gravity=(0.0, 0.0, 0.0),
            integrator=system.integrator,
            physics_dt=system.physics_dt,
            whole=full,
        )
        add_carried(spec, system.base)
        if acting and has_jets(system.vehicle):
            add_jets(spec)
    add_hidden(spec, system.arm, system.base if system.mode == "ideal" else None)
    if system.drive == "prescribed":
        heavy = following or following_inertia(system)
        for i in range(system.arm.n):
            spec.joint(f"q_{i + 1}").armature += heavy
            drive = spec.actuator(f"drive_{i + 1}")
            drive.forcelimited = mujoco.mjtLimited.mjLIMITED_FALSE
            drive.gainprm[0] = heavy  # the command is an acceleration
    return spec


def _changes(reference: mujoco.MjModel, model: mujoco.MjModel, which: str) -> dict[str, Any]:
    """Return fields that differ from this backend's model, all but gains and options."""
    out = {}
    for name in MODEL_FIELDS:
        if name.startswith("opt.") or name == "actuator_biasprm":
            continue
        mine, values = getattr(reference, name), getattr(model, name)
        if values.shape != mine.shape:
            raise ParameterError(
                f"{which}: MuJoCo's model has another layout, its {name} has shape"
                f" {values.shape}, not {mine.shape}"
            )
        if not np.array_equal(values, mine):
            out[name] = values
    return out


def _set_body(
    batch: Batch, ids: Index, body: int, mass: Array, com: Array, inertia: Array
) -> None:
    """Change mass properties of a body in simulations (k,).

    Args:
        batch: the simulations.
        ids: (k,) which.
        body: its number in the model.
        mass, com, inertia: (k,), (k, 3), (k, 3, 3) in the body's frame.
    """
    moments, axes = np.linalg.eigh(inertia)
    axes = axes * np.where(np.linalg.det(axes) < 0, -1.0, 1.0)[:, None, None]
    values = {
        "body_mass": mass,
        "body_ipos": com,
        "body_iquat": from_matrix(axes),
        "body_inertia": np.maximum(moments, LEAST),
        "body_sameframe": np.zeros(len(ids)),  # its axes are no longer the body's
    }
    for name, numbers in values.items():
        batch.expand(name)[ids, body] = numbers


class MujocoBackend:
    """`Backend` on `mujoco.batch.Batch`; see `Backend` for what each method does."""

    name = "mujoco"
    contact: EngineContact | None = None

    def __init__(self, system: System, n: int, threads: int) -> None:
        self.n = n
        self.joints = system.arm.n
        self.prescribed = system.drive == "prescribed"
        self.system, self._nthread = system, threads
        self._following = following_inertia(system)
        ideal = system.mode == "ideal"
        self._carried = system.base.m if ideal else 0
        parts = system.base.carried if ideal else ()
        # coordinates of the motors; those of gears, flexures and followers lie between them
        self._motors: Any = slice(6, 6 + self.joints)
        motors, passive, self._followers = places(system.arm)
        self._ratios = np.array([k.ratios for k in system.arm.followers or ()])
        if len(passive) or len(self._followers):
            self._motors = motors
        where = np.arange(6 + self.joints + len(passive) + len(self._followers))
        self._order = np.r_[TO_Y, where[self._motors]]
        carried = len(where) + np.arange(len(parts) + self._carried)
        self._internal = np.r_[passive, carried]
        self._parts = len(where) + np.arange(len(parts))  # coordinates of wheels, appendages
        wheels = [k for k in parts if isinstance(k, ReactionWheel)]  # the first of them
        self._wheels = self._parts[: len(wheels)]
        has_law = any(isinstance(e, TorqueEffect) for e in system.effects)
        self._laws = Laws(system, n) if has_law else None
        self._full = False  # the layout of `compile_model`
        self._systems = [system] * n
        self._limits = np.tile(system.arm.column("tau_max"), (n, 1))
        self._varied: set[str] = set()  # fields of the model that differ, gains apart
        self._load(compile_model(system, acting=True))

    def _compiled(self, system: System) -> mujoco.MjModel:
        """The model of a system in the layout of all."""
        return compile_model(system, full=True, acting=True, following=self._following)

    def _load(self, model: mujoco.MjModel) -> None:
        """Run this model."""
        self.model = model
        self.batch = Batch(model, self.n, self._nthread)
        _BATCHES.add(self.batch)
        self._qpos, self._qvel = self.batch.bind("qpos"), self.batch.bind("qvel")
        self._time = self.batch.bind("time")
        self._command = self.batch.bind("act")
        self._applied = self.batch.bind("qfrc_applied")
        self._force, self._qacc = self.batch.bind("actuator_force"), self.batch.bind("qacc")
        emulated = self.system.mode == "emulated"
        first = 6 if emulated else 0  # after the platform's, before the jets'
        self._drives = slice(first, first + self.joints)
        self._bias: Array | None = None
        self._sensed = self.batch.bind("sensordata") if emulated else None

    def read(self) -> tuple[Array, Array, Array]:
        return self._time.copy(), self._qpos[:, self._order], self._qvel[:, self._order]

    def write(self, ids: Index, time: Array, z: Array, zd: Array) -> None:
        # clears warm starts, history and whatever else the state row holds
        self.batch.reset(np.sort(ids), stage=mujoco.mjtStage.mjSTAGE_NONE.value)
        self.batch.warning[ids] = 0
        self._time[ids] = time
        self._qpos[np.ix_(ids, self._order)] = z
        self._qvel[np.ix_(ids, self._order)] = zd
        if len(self._followers):
            self._qpos[np.ix_(ids, self._followers)] = z[:, 6:] @ self._ratios.T
            self._qvel[np.ix_(ids, self._followers)] = zd[:, 6:] @ self._ratios.T
        for row, i in enumerate(ids.tolist() if self._carried else []):
            base, m = self._systems[i].base, self._carried  # at rest on the vehicle
            self._qpos[i, self._internal[-m:]] = base.attached(z[row, :6])
            self._qvel[i, self._internal[-m:]] = base.attached(zd[row, :6])

    def set_rates(self, ids: Index, zd: Array, gears: Array) -> None:
        self._qvel[np.ix_(ids, self._order)] = zd
        if len(self._followers):
            self._qvel[np.ix_(ids, self._followers)] = zd[:, 6:] @ self._ratios.T
        self._qvel[np.ix_(ids, self._internal[: gears.shape[1]])] = gears

    def set_last_link(self, ids: Index, mass: Array, com: Array, inertia: Array) -> None:
        last = self.model.body(f"link_{self.joints}").id
        turn, place = self.system.arm.links[-1].far_end  # the engine's frame is at the joint
        gained = mass - self.batch.expand("body_mass")[ids, last]
        moments = turn @ inertia @ turn.T
        _set_body(self.batch, ids, last, mass, place + com @ turn.T, moments)
        above = last
        while above:  # and what stands on the bodies below it
            self.batch.expand("body_subtreemass")[ids, above] += gained
            above = int(self.model.body_parentid[above])

    def set_gains(self, ids: Index, kp: Array, kd: Array) -> None:
        if self._bias is None:
            self._bias = self.batch.expand("actuator_biasprm")
        self._bias[ids, self._drives, 1] = -kp
        self._bias[ids, self._drives, 2] = -kd

    def assign(self, ids: Index, systems: Sequence[System]) -> None:
        pairs = list(zip(ids.tolist(), systems, strict=True))
        others = {i for i, k in pairs if bodies_of(k) != bodies_of(self._systems[i])}
        reference = self.model
        if others and not self._full:
            reference = self._compiled(self.system)
        changes_of: dict[tuple[int, int], dict[str, Any]] = {}  # of the arms and vehicles seen
        for i, system in pairs:
            if i in others and bodies_of(system) not in changes_of:
                model = self._compiled(system)
                changes_of[bodies_of(system)] = _changes(
                    reference, model, f"system of simulation {i}"
                )
        rows_of_laws = {}
        if self._laws is not None:
            rows_of_laws = {i: self._laws.row(k, f"system of simulation {i}") for i, k in pairs}
        if reference is not self.model:
            state = self.get_state()
            self._load(reference)
            self.set_state(state)
            self._full = True
        for i, system in pairs:
            if self._laws is not None:
                self._laws.put(i, rows_of_laws[i])
                self._limits[i] = system.arm.column("tau_max")
            if i in others:
                change = changes_of[bodies_of(system)]
                for name in self._varied | change.keys():
                    self.batch.expand(name)[i] = change.get(name, getattr(reference, name))
                self._varied |= change.keys()
            self._systems[i] = system

    def assign_laws(self, ids: Index, rows: EffectRows) -> None:
        self.assign(ids, [rows.system(row).actual for row in range(len(rows))])

    def set_base(self, ids: Index, y: Array, yd: Array) -> None:
        self._qpos[np.ix_(ids, TO_Y)], self._qvel[np.ix_(ids, TO_Y)] = y, yd

    def set_gear_state(self, d: Array, rate: Array) -> None:
        gears = self._internal[: d.shape[1]]
        self._qpos[:, gears], self._qvel[:, gears] = d, rate

    def set_carried(self, ids: Index, at: Array, rate: Array) -> None:
        where = np.ix_(ids, self._parts)
        self._qpos[where], self._qvel[where] = at, rate

    def set_actuators(self, ids: Index, wrench: Array | None, torque: Array | None) -> None:
        if wrench is not None:
            self._command[ids, self._drives.stop :] = wrench
        if torque is not None:
            self._applied[np.ix_(ids, self._wheels)] = torque

    def internal_state(self) -> tuple[Array, Array]:
        return self._qpos[:, self._internal], self._qvel[:, self._internal]

    def _push(self) -> None:
        """Set the torque of the effects' laws, held until the next physics step."""
        if self._laws is not None:
            q, v = self._qpos[:, self._motors], self._qvel[:, self._motors]
            torque = self._laws.torque(q, v, self._motor_torque(q, v))
            self._applied[:, self._motors] = torque

    def _motor_torque(self, q: Array, v: Array) -> Array:
        """Return (n, joints) the motors' commanded torques within their limits [N m]."""
        tau = self._command[:, self._drives] * self.model.actuator_gainprm[self._drives, 0]
        if self._bias is not None:
            tau += self._bias[:, self._drives, 1] * q + self._bias[:, self._drives, 2] * v
        if not self.prescribed:
            tau = np.clip(tau, -self._limits, self._limits)
        return np.asarray(tau, dtype=np.float64)

    def step_sequence(self, commands: Array, ids: Index | None) -> None:
        slopes = np.zeros((self.n, commands.shape[1] - 1, self.model.nu))
        slopes[..., self._drives] = np.diff(commands, axis=1) / self.model.opt.timestep
        self._command[:, self._drives] = commands[:, 0]
        slopes = slopes if ids is None else slopes[ids]
        for part in np.split(slopes, slopes.shape[1], axis=1) if self._laws else [slopes]:
            self._push()
            self.batch.rollout(part.shape[1], part, record=(), ids=ids)

    def step_on_platform(self, commands: Array, base: Array, ids: Index | None) -> Array:
        assert self._sensed is not None
        rows = slice(None) if ids is None else ids
        nodes = np.concatenate([base[..., TO_Y], commands], axis=-1)
        self._command[:] = nodes[:, 0]
        slopes = np.diff(nodes, axis=1) / self.model.opt.timestep
        out = np.zeros((self.n, nodes.shape[1], 6))
        at, commands = 0, slopes[rows]
        for part in np.split(commands, commands.shape[1], axis=1) if self._laws else [commands]:
            self._push()
            sensed = self.batch.rollout(part.shape[1], part, record=("sensordata",), ids=ids)
            # the engine reports what the platform exerts on the arm
            out[rows, at : at + part.shape[1]] = -sensed["sensordata"]
            at += part.shape[1]
        self._push()
        self.batch.forward(ids)
        out[:, -1] = -self._sensed
        return out

    def evaluate(self, command: Array) -> tuple[Array, Array]:
        self._command[:, self._drives] = command
        self._push()
        self.batch.forward()
        acceleration = self._qacc[:, self._order]
        torque = self._force[:, self._drives].copy()
        if self.prescribed:
            torque -= self._following * acceleration[:, 6:]
        return torque, acceleration

    def faults(self) -> Mask:
        finite = np.isfinite(self._qpos).all(1) & np.isfinite(self._qvel).all(1)
        bad: Mask = ~finite | (self.batch.warning[:, _BAD, 1] > 0).any(1)
        return bad

    def get_state(self) -> dict[str, Array]:
        bias = {} if self._bias is None else {"bias": self._bias.copy()}
        return {"state": self.batch.state.copy(), "warning": self.batch.warning.copy()} | bias

    def set_state(self, state: Mapping[str, Array]) -> None:
        self.batch.state[:] = state["state"]
        self.batch.warning[:] = state["warning"]
        if "bias" in state:
            bias = state["bias"]
            kp, kd = -bias[:, self._drives, 1], -bias[:, self._drives, 2]
            self.set_gains(np.arange(self.n), kp, kd)
