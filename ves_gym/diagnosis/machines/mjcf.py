"""A machine of joints on a fixed base, described in MJCF or URDF, with ports: joints and rates.

Laws of friction and the like are written for turning joints of a robot. A slide is seen as
the rack on a pinion of a stated radius r: at x / r rad and (F r) N m. What is reported of it
is again in m, m/s and N.
"""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, TypeVar

import mujoco
import numpy as np

from ves_gym._util.params import Array, ParameterError
from ves_gym._util.signals import differentiated
from ves_gym.diagnosis.data.measured_run import Kinematics, Run
from ves_gym.diagnosis.inference.candidates import Candidate
from ves_gym.diagnosis.machines.base import Machine, Nuisance, Port
from ves_gym.diagnosis.machines.causes import split
from ves_gym.diagnosis.machines.joint_changes import CarriedBody, RateError, Shaft
from ves_gym.diagnosis.machines.joint_library import (
    MjcfJoint,
    coupled_shaft,
    is_computed,
    joint_candidates,
    payload_candidate,
)
from ves_gym.diagnosis.machines.rigid_bodies import (
    BodyChange,
    MjcfBodies,
    RigidBodies,
    visible_parameters,
)
from ves_gym.diagnosis.machines.servo import low_passed
from ves_gym.diagnosis.machines.tolerances import LEAST, Tolerance, with_known
from ves_gym.diagnosis.machines.torque_balance import scales, torque_residual
from ves_gym.effects import (
    JointCoulomb,
    JointDriveGain,
    JointRotorInertia,
    JointTorqueOffset,
    JointViscous,
)
from ves_gym.system.effect import EFFECTS, Effect, joint_torque

T = TypeVar("T")
_FOUND_GAIN = 0.05  # of a drive whose scale was found in the data


@dataclass(frozen=True)
class MjcfVariant:
    """The description with effects and bodies that are otherwise."""

    effects: tuple[Any, ...] = ()  # of the library, `RateError`, `CarriedBody`, `Shaft`
    bodies: tuple[BodyChange, ...] = ()

    def of(self, kind: type[T]) -> list[T]:
        """Return the effects of a type."""
        return [e for e in self.effects if isinstance(e, kind)]

    def added(self, effects: Sequence[Any]) -> MjcfVariant:
        """Return the description with effects added."""
        return dataclasses.replace(self, effects=(*self.effects, *split(effects)))


class MjcfMachine(Machine):
    """Ports `joint` (with a model) and `velocity` of n joints.

    Args:
        joints: in the order of the columns of runs (n,).
        model: of exactly these joints, in MJCF or `RigidBodies` of a URDF; without one there is
            no port `joint`. Its `damping`, `frictionloss` and `armature` are taken by the laws
            of the library: friction as MuJoCo's solver has it depends on the step.
        effects: what the description has besides the model: effects of the library,
            `RateError`, `CarriedBody`, `Shaft`.
        couplings: (n,) each, rates of shafts that several joints turn per rate of each joint.
        known: standard deviations of single tolerances, see `with_known`.

    Raises:
        ParameterError: joints that the model lacks, has besides, or has of another type;
            effects that this machine cannot compute, or for another number of joints.
    """

    def __init__(
        self,
        name: str,
        joints: Sequence[MjcfJoint],
        model: mujoco.MjModel | RigidBodies | None = None,
        tolerance: Tolerance | None = None,
        effects: Sequence[Any] = (),
        *,
        couplings: Sequence[Sequence[float]] = (),
        known: Mapping[str, float] | None = None,
    ) -> None:
        self.name, self.joints = name, tuple(joints)
        self.tolerance, self.known = tolerance or Tolerance(), dict(known or {})
        self.couplings = tuple(tuple(float(r) for r in row) for row in couplings)
        self.nominal = MjcfVariant().added(effects)
        _require_computed(self.nominal, self.couplings, len(self.joints))
        self._radius = np.array([j.radius for j in self.joints])
        names = tuple(j.name for j in self.joints)
        if len(set(names)) < len(names) or not names:
            raise ParameterError(f"joints must have names, each its own, got {names}")
        slides = [j.type == "slide" for j in self.joints]
        self.bodies: RigidBodies | None = None
        ports = []

        def port(name: str, title: str, signal: str, units: tuple[str, str]) -> None:
            every = tuple(units[slide] for slide in slides)
            ports.append(Port(name, title, names, every, ("q", signal), signal=signal))

        if model is not None:
            typed = [(j.name, j.type) for j in self.joints]
            in_mjcf = isinstance(model, mujoco.MjModel)
            self.bodies = MjcfBodies(model, typed) if in_mjcf else model
            self.joint_properties = self.bodies.properties()
            rotors = np.array([j.rotor for j in self.joints])
            self.joint_properties["armature"] = self.joint_properties["armature"] + rotors
            port("joint", "motor force less what the motion takes", "tau", ("N m", "N"))
        title = "rate logged less the rate of the position logged"
        port("velocity", title, "v", ("rad/s", "m/s"))
        self.ports = tuple(ports)
        _ = self.nuisances  # a name in `known` that nothing has is refused here

    @property
    def mjcf(self) -> MjcfBodies | None:
        """The model, where it is MJCF."""
        return self.bodies if isinstance(self.bodies, MjcfBodies) else None

    def model(self, effects: Sequence[Any]) -> MjcfVariant:
        """Return the description with effects added."""
        return self.nominal.added(effects)

    def heavier(self, factor: float) -> MjcfMachine:
        """Return the machine with all masses and inertias by a factor."""
        out = copy.copy(self)
        count = 0 if self.bodies is None else len(self.bodies.bodies)
        out.nominal = dataclasses.replace(
            self.nominal, bodies=tuple(BodyChange(body, factor) for body in range(count))
        )
        return out

    def floor(self, run: Run, port: str) -> Array:
        """Return (n,) standard deviation below which a residual of the port means nothing."""
        signal = run["tau" if port == "joint" else "v"]
        least = LEAST * np.maximum(np.asarray(signal.std(axis=-2)), 1e-12)
        moved = run.window.spectrum(signal)[..., 1:, :]
        size = np.sqrt(np.square(np.abs(moved)).mean(axis=-2))
        return np.asarray(np.maximum(least, self.tolerance.unexplained * size))

    def candidates(self) -> tuple[Candidate, ...]:
        """Return the library as far as it applies, each effect in the units of its joint."""
        out = joint_candidates(self.joints, [p.name for p in self.ports])
        if self.bodies is not None:
            names = [j.name for j in self.joints]
            rotor = dict(zip(names, self.joint_properties["armature"], strict=True))
            out = [  # no less than no rotor
                replace(c, low=(-rotor[c.slot],)) if c.kind == "joint/rotor_inertia" else c
                for c in out
            ]
            out += [coupled_shaft(self.joints, ratio) for ratio in self.couplings]
            out.append(payload_candidate(*visible_parameters(self.bodies, len(self.joints))))
        return tuple(out)

    @cached_property
    def nuisances(self) -> tuple[Nuisance, ...]:
        """Small errors of any description of such a machine."""
        return with_known(self._usual_nuisances(), self.known)

    def _usual_nuisances(self) -> list[Nuisance]:
        allowed, n = self.tolerance, len(self.joints)
        out: list[Nuisance] = []

        def tolerance(
            name: str, port: str, model: MjcfVariant, step: float, std: float
        ) -> None:
            out.append(Nuisance(name, (port,), model, step, std))

        for body, where in enumerate(() if self.bodies is None else self.bodies.bodies):
            shifts = (1e-3 * np.eye(3)).tolist()
            changes = [BodyChange(body, shift=tuple(shift)) for shift in shifts]
            scaled, *shifted = (
                dataclasses.replace(self.nominal, bodies=(change,))
                for change in (BodyChange(body, scale=1.01), *changes)
            )
            tolerance(f"inertia of {where}", "joint", scaled, 0.01, allowed.inertia)
            for axis, model in zip("xyz", shifted, strict=True):
                name = f"centre of mass {axis} of {where}"
                tolerance(name, "joint", model, 1e-3, allowed.centre)
        for i, joint in enumerate(self.joints):

            def at_joint(value: float, i: int = i) -> tuple[float, ...]:
                return tuple(value if k == i else 0.0 for k in range(n))

            gain = _FOUND_GAIN if joint.gain_unknown else allowed.gain
            small = 0.01 * joint.rotor * joint.radius**2
            for what, effect, step, std in (
                ("gain", JointDriveGain(error=at_joint(0.01)), 0.01, gain),
                ("friction", JointCoulomb(torque=at_joint(0.1)), 0.1, allowed.friction),
                ("damping", JointViscous(damping=at_joint(0.1)), 0.1, allowed.friction),
                ("zero", JointTorqueOffset(torque=at_joint(0.1)), 0.1, allowed.friction),
                ("rotor", JointRotorInertia(added=at_joint(small)), 0.01, allowed.inertia),
            ):
                if what == "rotor" and not small:
                    continue
                model = self.nominal.added([effect])
                tolerance(f"{what} of {joint.name}", "joint", model, step, std)
            model = self.nominal.added([RateError(at_joint(0.01), at_joint(0.0))])
            name = f"gain of the rate of {joint.name}"
            tolerance(name, "velocity", model, 0.01, allowed.gain)
        return out

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
        motion, load = run.joints, self._load(run, variant)
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
        needed = needed - dry.law(q / r, v / r, np.zeros(1))
        for shaft in variant.of(Shaft):
            needed = needed + shaft.needed(v, a)
        # what the force does not scale stays out of differences by the force
        every = variant.of(Effect)
        needed = needed - _laws([e for e in every if not scales(e)], q / r, v / r, tau * r) / r
        scaling = [e for e in every if scales(e)]

        def laws(force: Array) -> Array:
            return _laws(scaling, q / r, v / r, force * r) / r

        return torque_residual(tau, needed, scaling, laws)

    def _load(self, run: Run, variant: MjcfVariant) -> Array:
        """Force at the joints (..., T, n) that the motion of the bodies takes."""
        assert self.bodies is not None
        n, shape = len(self.joints), run["q"].shape
        q, v, a = (x.reshape(-1, n) for x in run.joints)
        key = ("load", variant.bodies)
        if key not in run.memory:
            run.memory[key] = self.bodies.load(q, v, a, variant.bodies).reshape(shape)
        load = np.asarray(run.memory[key])
        if payloads := variant.of(CarriedBody):
            if "payload" not in run.memory:
                columns = self.bodies.payload(q, v, a)
                run.memory["payload"] = columns.reshape(*shape, columns.shape[-1])
            carried = sum(p.parameters for p in payloads)
            load = load + run.memory["payload"] @ carried
        return load

    def _velocity(self, run: Run, variant: MjcfVariant) -> Array:
        """Rate logged less the rate of the position logged (..., T, n)."""
        logged, rate = run["v"], run.joints.v.copy()
        errors = variant.of(RateError)
        delay = np.sum([e.delay for e in errors], axis=0)
        for i in np.flatnonzero(delay):
            position = run["q"][..., i : i + 1]
            late = differentiated(position, run.dt, run.band, ahead=-float(delay[i]))[1]
            rate[..., i] = late[..., 0]
        rate = rate * (1 + np.sum([e.gain for e in errors], axis=0))
        lag = np.broadcast_to(
            _total(variant, "joint/velocity_lag", "time_constant"), self._radius.shape
        )
        return np.asarray(logged - low_passed(rate, lag, run.dt, logged[..., 0, :]))


def _require_computed(
    variant: MjcfVariant, couplings: Sequence[Sequence[float]], joints: int
) -> None:
    for effect in variant.of(Effect):
        if not is_computed(type(effect)):
            known = ", ".join(sorted(k for k, cls in EFFECTS.items() if is_computed(cls)))
            raise ParameterError(
                f"effect {effect.kind} is not computed for MJCF; these are: {known}"
            )
    for entry in variant.effects:
        for name, value in vars(entry).items():
            alike = isinstance(value, tuple) and not isinstance(entry, CarriedBody)
            if alike and len(value) != joints:
                kind = getattr(entry, "kind", type(entry).__name__.lower())
                raise ParameterError(
                    f"effect {kind}.{name} must have {joints} numbers, got {len(value)}"
                )
    for ratio in couplings:
        if len(ratio) != joints:
            raise ParameterError(f"a coupling has {joints} numbers, got {len(ratio)}")


def _laws(effects: Sequence[Effect], q: Array, v: Array, tau: Array) -> Array:
    """(..., n) torque of the effects at the pinions [N m]."""
    return joint_torque(effects, q, v, tau, np.full(q.shape[-1], np.inf))


def _total(variant: MjcfVariant, kind: str, field: str) -> Any:
    """Sum of a field over the effects of a kind; 0.0 where there is none."""
    parts = [np.array(getattr(e, field), float) for e in variant.of(Effect) if e.kind == kind]
    return sum(parts[1:], parts[0]) if parts else 0.0
