"""Any machine described in MJCF, on a fixed base, as a machine with ports: joints and rates.

Laws of friction and the like are written for turning joints of a robot. A slide is seen as
the rack on a pinion of a stated radius r: at x / r rad and (F r) N m. What is reported of it
is again in m, m/s and N.
"""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import mujoco
import numpy as np
import scipy

from ves_gym._util.params import Array, ParameterError, require_positive, unit
from ves_gym._util.signals import differentiated
from ves_gym.diagnosis.data.measured_run import Kinematics, Run
from ves_gym.diagnosis.inference.candidates import Candidate, library
from ves_gym.diagnosis.machines.base import Nuisance, Port
from ves_gym.diagnosis.machines.torque_balance import scales, torque_residual
from ves_gym.effects import (
    JointCoulomb,
    JointDriveGain,
    JointStribeck,
    JointTorqueOffset,
    JointVelocityLag,
    JointViscous,
)
from ves_gym.system.effect import EFFECTS, Effect, TorqueEffect, joint_torque

_BESIDE_LAWS = ("joint/measurement_delay", "joint/rotor_inertia", "joint/velocity_lag")
_LIMITS = ("joint/torque_limit",)  # a mapping file states no limit of the motors
_ON_RACK = {  # unit of a turning joint -> unit of a slide, power of the radius between them
    "N m": ("N", -1),
    "N m s/rad": ("N s/m", -2),
    "kg m^2": ("kg", -2),
    "rad/s": ("m/s", 1),
    "rad": ("m", 1),
}
JOINT_PROPERTIES = (
    "damping",
    "frictionloss",
    "armature",
)  # what laws of the library say of a model, too
_OFF = {  # flags that take it away
    "damping": (mujoco.mjtDisableBit.mjDSBL_DAMPER,),
    "frictionloss": (
        mujoco.mjtDisableBit.mjDSBL_FRICTIONLOSS,
        mujoco.mjtDisableBit.mjDSBL_CONSTRAINT,
    ),
}
_LAGS = (0.02, 0.005, 0.2)  # s, where fits of a low-pass begin
_BREAKAWAY, _STUCK = 2.0, 30.0  # N m above Coulomb's: where fits begin, and most
_FADED = 0.1  # rad/s: what fades later is not of standstill but Coulomb's by another name
_LEAST = 1e-3  # of a channel's own movement: no description is better
_TYPES = {
    int(mujoco.mjtJoint.mjJNT_HINGE): "hinge",
    int(mujoco.mjtJoint.mjJNT_SLIDE): "slide",
}


@dataclass(frozen=True)
class MjcfJoint:
    """A joint as the laws of the library see it."""

    name: str
    type: str = "hinge"  # or "slide"
    radius: float = unit("m", default=1.0)  # of the pinion that a slide is seen on

    def __post_init__(self) -> None:
        if self.type not in ("hinge", "slide"):
            raise ParameterError(
                f"joint {self.name}: type must be hinge or slide, got {self.type!r}"
            )
        require_positive(self, "radius")
        if self.type == "hinge" and self.radius != 1.0:
            raise ParameterError(
                f"joint {self.name}: radius is of slides, this is a hinge, got {self.radius}"
            )


@dataclass(frozen=True)
class Tolerance:
    """Usual errors of a careful description, standard deviations."""

    inertia: float = unit("1", default=0.006)
    gain: float = unit("1", default=0.0006)  # of motor forces and of measured rates
    friction: float = unit("N m", default=0.03)  # at the pinion; per rad/s for viscous

    def __post_init__(self) -> None:
        require_positive(self, "inertia", "gain", "friction")


@dataclass(frozen=True)
class RateError:
    """Rates that are logged too large or too late; of the log, so no simulation has it."""

    gain: tuple[float, ...]  # (n,) relative
    delay: tuple[float, ...]  # (n,) s


@dataclass(frozen=True)
class MjcfVariant:
    """The description with effects and bodies that are heavier."""

    effects: tuple[Effect, ...] = ()
    heavier: tuple[tuple[int, float], ...] = ()  # body, factor of mass and inertia
    rates: tuple[RateError, ...] = ()


class MjcfMachine:
    """Ports `joint` (with a model) and `velocity` of n joints.

    Args:
        joints: in the order of the columns of runs (n,).
        model: of exactly these joints; without one there is no port `joint`. Its `damping`,
            `frictionloss` and `armature` are taken by the laws of the library: friction as
            MuJoCo's solver has it depends on the step.
        effects, rates: what the description has besides the model.

    Raises:
        ParameterError: joints that the model lacks, has besides, or has of another type;
            effects that this machine cannot compute, or for another number of joints.
    """

    def __init__(
        self,
        name: str,
        joints: Sequence[MjcfJoint],
        model: mujoco.MjModel | None = None,
        tolerance: Tolerance | None = None,
        effects: Sequence[Effect] = (),
        rates: Sequence[RateError] = (),
    ) -> None:
        self.name, self.joints, self.mjcf = name, tuple(joints), model
        self.tolerance = tolerance or Tolerance()
        _require_computed(effects, rates, len(self.joints))
        self.nominal = MjcfVariant(tuple(effects), rates=tuple(rates))
        self._radius = np.array([j.radius for j in self.joints])
        names = tuple(j.name for j in self.joints)
        if len(set(names)) < len(names) or not names:
            raise ParameterError(f"joints must have names, each its own, got {names}")
        slides = [j.type == "slide" for j in self.joints]
        ports = []
        if model is not None:
            self._qpos, self.dof = _addresses(model, self.joints)
            self.joint_properties = {
                name: joint_property(model, name)[self.dof] for name in JOINT_PROPERTIES
            }
            ports.append(
                Port(
                    "joint",
                    "motor force less what the motion takes",
                    names,
                    tuple("N" if slide else "N m" for slide in slides),
                    ("q", "tau"),
                )
            )
        ports.append(
            Port(
                "velocity",
                "rate logged less the rate of the position logged",
                names,
                tuple("m/s" if slide else "rad/s" for slide in slides),
                ("q", "v"),
            )
        )
        self.ports = tuple(ports)

    def model(self, effects: Sequence[Effect | RateError]) -> MjcfVariant:
        """Return the description with effects added."""
        rates = tuple(e for e in effects if isinstance(e, RateError))
        added = tuple(e for e in effects if not isinstance(e, RateError))
        nominal = self.nominal
        return MjcfVariant((*nominal.effects, *added), rates=(*nominal.rates, *rates))

    def heavier(self, factor: float) -> MjcfMachine:
        """Return the machine with all masses and inertias by a factor."""
        out = copy.copy(self)
        bodies = range(1, self.mjcf.nbody if self.mjcf is not None else 0)
        out.nominal = dataclasses.replace(
            self.nominal, heavier=tuple((body, factor) for body in bodies)
        )
        return out

    def unknowns(self, run: Run) -> Sequence[Nuisance]:
        """Return nothing: no drift is described."""
        return ()

    def rings(self, runs: Sequence[Run], frequency: float) -> bool:
        """Return False: nothing is known of a controller that could ring."""
        return False

    def floor(self, run: Run, port: str) -> Array:
        """Return (n,) standard deviation below which a residual of the port means nothing."""
        signal = run["tau" if port == "joint" else "v"]
        return _LEAST * np.maximum(np.asarray(signal.std(axis=-2)), 1e-12)

    def candidates(self) -> tuple[Candidate, ...]:
        """Return the library as far as it applies, each effect in the units of its joint."""
        n = len(self.joints)
        every = library(n, [p.name for p in self.ports])
        slots = {f"joint {i + 1}": i for i in range(n)}
        out = []
        for candidate in (c for c in every if _is_computed(EFFECTS[c.kind])):
            candidate = dataclasses.replace(candidate, blurs=())  # one form of every law here
            if candidate.kind == "joint/stribeck":
                candidate = _excess(candidate, slots[candidate.slot], n)
            at = slots.get(candidate.slot)
            out.append(candidate if at is None else _placed(candidate, self.joints[at]))
        for i, joint in enumerate(self.joints):
            only = tuple(float(k == i) for k in range(n))
            out += [_rates(kind, joint.name, only) for kind in ("gain", "delay")]
        if n > 1:  # one firmware in all drives
            out += [_rates(kind, "", (1.0,) * n) for kind in ("delay", "lag")]
        return tuple(out)

    @cached_property
    def nuisances(self) -> tuple[Nuisance, ...]:
        """Small errors of any description of such a machine."""
        allowed, n, out = self.tolerance, len(self.joints), []
        if self.mjcf is not None:
            moving = np.flatnonzero((self.mjcf.body_weldid > 0) & (self.mjcf.body_mass > 0))
            for body in moving.tolist():
                model = dataclasses.replace(self.nominal, heavier=((body, 1.01),))
                name = f"inertia of {self.mjcf.body(body).name or f'body {body}'}"
                out.append(Nuisance(name, ("joint",), model, 0.01, allowed.inertia))
        for i, joint in enumerate(self.joints):

            def at_joint(value: float, i: int = i) -> tuple[float, ...]:
                return tuple(value if k == i else 0.0 for k in range(n))

            for what, effect, step, std in (
                ("gain", JointDriveGain(error=at_joint(0.01)), 0.01, allowed.gain),
                ("friction", JointCoulomb(torque=at_joint(0.1)), 0.1, allowed.friction),
                ("damping", JointViscous(damping=at_joint(0.1)), 0.1, allowed.friction),
                ("zero", JointTorqueOffset(torque=at_joint(0.1)), 0.1, allowed.friction),
            ):
                model, name = MjcfVariant(effects=(effect,)), f"{what} of {joint.name}"
                out.append(Nuisance(name, ("joint",), model, step, std))
            model = MjcfVariant(rates=(RateError(at_joint(0.01), at_joint(0.0)),))
            name = f"gain of the rate of {joint.name}"
            out.append(Nuisance(name, ("velocity",), model, 0.01, allowed.gain))
        return tuple(out)

    def residuals(
        self, run: Run, models: Sequence[MjcfVariant], ports: Sequence[str]
    ) -> dict[str, Array]:
        """Return (m, ..., T, n) per port, as `Machine.residuals`."""
        residual_of = {"joint": self._joint, "velocity": self._velocity}
        return {name: np.stack([residual_of[name](run, m) for m in models]) for name in ports}

    # ----------------------------------------------------------------- ports

    def _joint(self, run: Run, variant: MjcfVariant) -> Array:
        """Motor force less what the motion takes (..., T, n)."""
        r, tau = self._radius, run["tau"]
        late = float(_total(variant, "joint/measurement_delay", "delay"))
        motion, load = run.joints, self._load(run, variant.heavier)
        if late:  # what was logged now happened `late` s ago
            motion = Kinematics(*differentiated(run["q"], run.dt, run.band, ahead=late))
            load = differentiated(load, run.dt, run.band, ahead=late)[0]
        q, v, a = motion
        rotor = _total(variant, "joint/rotor_inertia", "added") / r**2
        dry = JointCoulomb(torque=(0.0,) * len(r)).bound(
            {"torque": self.joint_properties["frictionloss"]}
        )
        needed = (
            load
            + (self.joint_properties["armature"] + rotor) * a
            + self.joint_properties["damping"] * v
        )
        needed = needed - dry.law(np, q / r, v / r, 0.0)
        # what the force does not scale stays out of differences by the force
        steady = [e for e in variant.effects if not scales(e)]
        needed = needed - _laws(steady, q / r, v / r, tau * r) / r
        scaling = [e for e in variant.effects if scales(e)]

        def laws(force: Array) -> Array:
            return _laws(scaling, q / r, v / r, force * r) / r

        return torque_residual(tau, needed, scaling, laws)

    def _load(self, run: Run, heavier: tuple[tuple[int, float], ...]) -> Array:
        """Force at the joints (..., T, n) that the model's motion takes without `HELD`."""
        key = ("load", heavier)
        if key in run.memory:
            return np.asarray(run.memory[key])
        assert self.mjcf is not None
        model = copy.copy(self.mjcf)
        for body, factor in heavier:
            model.body_mass[body] *= factor
            model.body_inertia[body] *= factor
        if heavier:
            mujoco.mj_setConst(model, mujoco.MjData(model))
        for name in JOINT_PROPERTIES:
            getattr(model, f"dof_{name}")[joint_property(model, name) != 0] = 0.0
        data = mujoco.MjData(model)
        n, qpos, dof = len(self.joints), self._qpos, self.dof
        q, v, a = (x.reshape(-1, n) for x in run.joints)
        out = np.empty_like(q)
        at, rate, rise, needed = data.qpos, data.qvel, data.qacc, data.qfrc_inverse
        for k in range(len(q)):
            at[qpos], rate[dof], rise[dof] = q[k], v[k], a[k]
            mujoco.mj_inverse(model, data)
            out[k] = needed[dof]
        run.memory[key] = out.reshape(run["q"].shape)
        return np.asarray(run.memory[key])

    def _velocity(self, run: Run, variant: MjcfVariant) -> Array:
        """Rate logged less the rate of the position logged (..., T, n)."""
        logged, rate = run["v"], run.joints.v.copy()
        delay = np.sum([e.delay for e in variant.rates], axis=0)
        for i in np.flatnonzero(delay):
            position = run["q"][..., i : i + 1]
            late = differentiated(position, run.dt, run.band, ahead=-float(delay[i]))[1]
            rate[..., i] = late[..., 0]
        rate = rate * (1 + np.sum([e.gain for e in variant.rates], axis=0))
        lag = np.broadcast_to(
            _total(variant, "joint/velocity_lag", "time_constant"), self._radius.shape
        )
        reported = rate.copy()
        for i in np.flatnonzero(lag):
            low = ([1.0], [float(lag[i]), 1.0])
            b, a, _ = scipy.signal.cont2discrete(low, run.dt, method="foh")
            b = np.ravel(b)
            start = logged[..., :1, i] - b[0] * rate[..., :1, i]  # it begins as logged
            reported[..., i] = scipy.signal.lfilter(b, a, rate[..., i], axis=-1, zi=start)[0]
        return np.asarray(logged - reported)


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


def _addresses(model: mujoco.MjModel, joints: Sequence[MjcfJoint]) -> tuple[Any, Any]:
    """Return the place of each joint in qpos and in qvel, (n,) each."""
    indices = {model.joint(i).name: i for i in range(model.njnt)}
    for name, i in indices.items():
        if int(model.jnt_type[i]) not in _TYPES:
            raise ParameterError(
                f"joint {name or i} of the model is neither hinge nor slide: only machines on"
                " a fixed base, of hinges and slides, are understood"
            )
    for joint in joints:
        if joint.name not in indices:
            raise ParameterError(
                f"the model has no joint {joint.name!r}; it has {', '.join(indices)}"
            )
        actual = _TYPES[int(model.jnt_type[indices[joint.name]])]
        if actual != joint.type:
            raise ParameterError(
                f"joint {joint.name} is a {actual} in the model, a {joint.type} here"
            )
    beside = sorted(set(indices) - {j.name for j in joints})
    if beside:
        raise ParameterError(f"joints of the model without columns: {', '.join(beside)}")
    ids = [indices[j.name] for j in joints]
    return model.jnt_qposadr[ids].copy(), model.jnt_dofadr[ids].copy()


def _is_computed(cls: type[Effect]) -> bool:
    """True for what this machine can compute; the rest of the library is another machine's."""
    if issubclass(cls, TorqueEffect):
        return cls.kind not in _LIMITS
    return cls.kind in _BESIDE_LAWS


def _require_computed(
    effects: Sequence[Effect], rates: Sequence[RateError], joints: int
) -> None:
    for effect in effects:
        if not _is_computed(type(effect)):
            known = ", ".join(sorted(k for k, cls in EFFECTS.items() if _is_computed(cls)))
            raise ParameterError(
                f"effect {effect.kind} is not computed for MJCF; these are: {known}"
            )
    for entry in (*effects, *rates):
        for field in dataclasses.fields(entry):  # type: ignore[arg-type]
            value = getattr(entry, field.name)
            if isinstance(value, tuple) and len(value) != joints:
                kind = getattr(entry, "kind", "rate")
                raise ParameterError(
                    f"effect {kind}.{field.name} must have {joints} numbers, got {len(value)}"
                )


def _laws(effects: Sequence[Effect], q: Array, v: Array, tau: Array) -> Array:
    """(..., n) torque of the effects at the pinions [N m]."""
    return joint_torque(effects, q, v, tau, np.full(q.shape[-1], np.inf))


def _excess(candidate: Candidate, joint: int, n: int) -> Candidate:
    """Of Stribeck friction what is beside Coulomb's, a candidate of its own: no name holds
    another, and the simpler comes first."""

    def make(x: Array) -> Effect:
        level = tuple(float(x[0]) if i == joint else 0.0 for i in range(n))
        return JointStribeck(coulomb=(0.0,) * n, stiction=level, fade_speed=float(x[1]))

    return dataclasses.replace(
        candidate,
        names=("breakaway", "fade_speed"),
        units=("N m", "rad/s"),
        starts=((_BREAKAWAY, _FADED / 2), (_BREAKAWAY, _FADED)),
        low=(0.0, candidate.low[-1]),
        high=(_STUCK, _FADED),
        make=make,
        factors=(0,),
    )


def _rates(what: str, slot: str, where: tuple[float, ...]) -> Candidate:
    """A way in which the joints marked with 1 in `where` (n,) report their rates."""
    none = (0.0,) * len(where)

    def make(x: Array) -> Any:
        values = tuple(float(x[0]) * w for w in where)
        if what == "lag":
            return JointVelocityLag(time_constant=values)
        return RateError(values, none) if what == "gain" else RateError(none, values)

    name, symbol, starts, low, high = {
        "gain": ("gain", "1", (0.05,), -0.5, 0.5),
        "delay": ("delay", "s", (0.01, 0.1), 0.0, 0.5),
        "lag": ("time_constant", "s", _LAGS, 0.0, 1.0),
    }[what]
    return Candidate(
        kind="joint/velocity_lag" if what == "lag" else f"velocity/{what}",
        slot=slot,
        ports=("velocity",),
        names=(name,),
        units=(symbol,),
        starts=tuple((x,) for x in starts),
        low=(low,),
        high=(high,),
        make=make,
        factors=(0,),
    )


def _placed(candidate: Candidate, joint: MjcfJoint) -> Candidate:
    """A candidate under its joint's name; of a slide in m and N."""
    if joint.type == "hinge":
        return dataclasses.replace(candidate, slot=joint.name)
    into = [_ON_RACK.get(u, (u, 0)) for u in candidate.units]
    factor = np.array([joint.radius**power for _, power in into])

    def scaled(values: Sequence[float]) -> tuple[float, ...]:
        return tuple((np.array(values) * factor).tolist())

    return dataclasses.replace(
        candidate,
        slot=joint.name,
        units=tuple(name for name, _ in into),
        starts=tuple(scaled(s) for s in candidate.starts),
        low=scaled(candidate.low),
        high=scaled(candidate.high),
        make=lambda x: candidate.make(
            np.clip(np.asarray(x) / factor, candidate.low, candidate.high)
        ),
    )


def _total(variant: MjcfVariant, kind: str, field: str) -> Any:
    """Sum of a field over the effects of a kind; 0.0 where there is none."""
    parts = [np.array(getattr(e, field), float) for e in variant.effects if e.kind == kind]
    return sum(parts[1:], parts[0]) if parts else 0.0
