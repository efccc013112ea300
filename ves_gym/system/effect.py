"""`Effect`: a named physical deviation from the nominal system.

One concept for error models, randomisation and diagnosis. The parameters of an effect
have a unit, bounds and a null value at which the system is exactly the nominal one.
"""

from __future__ import annotations

import dataclasses
from collections import UserDict
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar, dataclass_transform

import numpy as np

from ves_gym._util.on_demand import load
from ves_gym._util.own import require_free
from ves_gym._util.params import Array, ParameterError, nested_tuples, to_plain, unit
from ves_gym._util.suggest import did_you_mean
from ves_gym.system.candidate import Candidate, Scope, derived

if TYPE_CHECKING:
    from ves_gym.mechanics.arm import Arm
    from ves_gym.mechanics.vehicle import BaseModel
    from ves_gym.system.deviations import Delays, LoopParameters

System = Any  # a `ves_gym.system.system.System`: it is made of effects


class Registry(UserDict[str, "type[Effect]"]):
    """Effects by kind. The library is loaded before the first question: its modules take
    longer to load than a nominal simulation takes to begin."""

    @property
    def data(self) -> dict[str, type[Effect]]:
        """All kinds."""
        load("effects")
        return self._kinds

    @data.setter
    def data(self, kinds: dict[str, type[Effect]]) -> None:
        self._kinds = kinds


EFFECTS = Registry()
# Balance of torques at the joints; force sensor; estimate of the arm's weight; vehicle, real
# or emulated; from the platform's command to its pose.
PORTS = ("joint", "wrench", "gravity", "admittance", "platform")


class Effect:
    """Base of all effects; see `register_effect` and `parameter`.

    An effect acts in one of five ways (docs/decisions/0012), each a subclass:
    `LaboratoryEffect` changes parameters of the emulation loop, `TorqueEffect` adds a torque
    at the joints, `ArmEffect` and `BaseEffect` say what arm and vehicle really are, while
    all that is computed about them - gravity estimate, payload compensation, feed-forward,
    plans - goes by the description, and `DelayEffect` adds to the delays between joint
    controller and drives.

    `port` says at which component of the loop it enters, for a diagnosis that looks there.
    What a diagnosis may choose of it follows from the parameters (`system/candidate.py`); the
    other declarations help where these do not say enough.
    """

    REGISTRY: ClassVar[Registry] = EFFECTS
    acts: ClassVar[str] = ""  # the method by which it does; each way of acting has its own
    kind: ClassVar[str]  # "place/name"; set by `register_effect`
    modes: ClassVar[tuple[str, ...]] = ("emulated",)
    port: ClassVar[str]  # one of PORTS

    needs_motor: ClassVar[bool] = False  # it is nothing in a joint that follows its command
    # parameters of any length; others of such a shape have one number per joint
    free_length: ClassVar[tuple[str, ...]] = ()
    shows: ClassVar[tuple[str, ...]] = ()  # ports at which logs show it; none: at its own
    places: ClassVar[str] = ""  # joint, axis, row or whole; "": by the shapes of parameters
    sets_in: ClassVar[bool] = False  # it does nothing up to some size, and is no factor above
    builds_up: ClassVar[bool] = False  # a friction: over a distance, after every reversal
    wanders: ClassVar[bool] = False  # a slow random course: a log shows the course, not its law
    within: ClassVar[str] = ""  # simpler kind that is a case of this one
    forms: ClassVar[tuple[Callable[[Any], Any], ...]] = ()  # others that it may have in part
    hidden: ClassVar[str] = ""  # why no log can tell it, where that is so in principle

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):  # type: ignore[arg-type]
            low, high = field.metadata["bounds"]
            value = getattr(self, field.name)
            try:
                array = np.asarray(value)
            except ValueError:
                array = np.empty(0, object)
            shape = field.metadata["shape"]
            fits = array.dtype.kind in "fiu" and len(array.shape) == len(shape)
            fits = fits and all(w in (None, g) for w, g in zip(shape, array.shape, strict=True))
            inside = fits and bool(np.isfinite(array).all())
            if not inside or (array < low).any() or (array > high).any():
                symbol = "" if field.metadata["unit"] == "1" else f" {field.metadata['unit']}"
                size = " x ".join("any" if k is None else str(k) for k in shape) or "one"
                raise ParameterError(
                    f"{self.kind}.{field.name} must be {size} number{'s' * bool(shape)} in"
                    f" [{low:g}, {high:g}]{symbol}, got {value!r}"
                )
            # lists and arrays become what can be compared and hashed
            object.__setattr__(self, field.name, nested_tuples(array.astype(float)))

    @classmethod
    def require_mode(cls, mode: str) -> None:
        """Raise ParameterError where the effect does not act in a mode of a system."""
        if mode not in cls.modes:
            ids = "" if "ideal" in cls.modes else "; environments in it end in Emulated-v0"
            raise ParameterError(
                f"effect {cls.kind} acts in mode {', '.join(cls.modes)}, got mode {mode}{ids}"
            )

    def check(self, system: System) -> None:
        """Raise ParameterError if the effect would do nothing in this system, or not fit it.

        Args:
            system: a `System` that is to have the effect.
        """
        n = system.arm.n
        for field in dataclasses.fields(self):  # type: ignore[arg-type]
            per_joint = None in field.metadata["shape"] and field.name not in self.free_length
            if per_joint and len(getattr(self, field.name)) != n:
                raise ParameterError(
                    f"{self.kind}.{field.name} must be {n} numbers, one per joint, got"
                    f" {len(getattr(self, field.name))}"
                )
        if self.needs_motor:  # a joint that follows its command has no torque of its own
            self.require(system.drive == "motor", f"drive motor, got drive {system.drive}")

    def edit(self, p: LoopParameters) -> None:
        """Add the deviation to the emulation loop's parameters."""

    def wire(self, delays: Delays) -> None:
        """Add to the delays between joint controller and drives."""

    def arm(self, arm: Arm) -> Arm:
        """Return the arm that is really there, from the described one."""
        return arm

    def base(self, base: BaseModel) -> BaseModel:
        """Return the vehicle that is really there, from the described one."""
        return base

    @classmethod
    def candidates(cls, scope: Scope) -> Iterator[Candidate]:
        """Yield what a diagnosis may try: the effect in each place, its numbers free.

        Args:
            scope: the machine.
        """
        yield from derived(cls, scope)

    def require(self, fits: bool, what: str) -> None:
        """Raise ParameterError unless the effect does something: it needs `what`."""
        if not fits:
            raise ParameterError(f"effect {self.kind} would do nothing: it needs {what}")

    def _require_rotors(self, system: System, values: Sequence[float]) -> None:
        """A rotor behind every gear that gives way: where a joint's value is not zero."""
        for joint, (link, value) in enumerate(zip(system.arm.links, values, strict=True), 1):
            if value and link.rotor_inertia == 0:
                raise ParameterError(
                    f"{self.kind} at joint {joint} of {system.arm.name} needs its"
                    " rotor_inertia > 0 kg m^2: a gear that gives way turns against the rotor"
                )

    @property
    def is_null(self) -> bool:
        """True if every parameter is at the value that leaves the system nominal."""
        return all(
            np.all(np.asarray(getattr(self, f.name)) == f.metadata["null"])
            for f in dataclasses.fields(self)  # type: ignore[arg-type]
            if f.metadata["null"] is not None
        )

    def bound(self, values: dict[str, Any]) -> Any:
        """The effect with arrays or symbols for parameters (and `tau_max`), unchecked."""
        out = object.__new__(type(self))
        for name, value in values.items():
            object.__setattr__(out, name, value)
        return out

    def __str__(self) -> str:
        values = {k: v for k, v in to_plain(self).items() if k != "kind"}
        return f"{self.kind}({', '.join(f'{k}={v}' for k, v in values.items())})"


class LaboratoryEffect(Effect):
    """Change of the emulation loop's parameters.

    It adds to them, so that several effects combine and none undoes another.

    Where simulations have values of their own, `edit` is tried with all of them at once: the
    arrays of p, and the parameters, then have the simulations' axis last, so that a text
    written for numbers broadcasts. One that does not is run simulation by simulation.
    """

    acts = "edit"


class TorqueEffect(Effect):
    """Torque at the joints, in mode ideal as in mode emulated.

    A pure function of arrays in plain NumPy, so that one text runs on numbers and is traced
    into the kernel and its derivatives (`engine.kernel.symbolic`).
    """

    modes: ClassVar[tuple[str, ...]] = ("ideal", "emulated")
    port: ClassVar[str] = "joint"
    shows: ClassVar[tuple[str, ...]] = ("joint",)
    acts = "law"
    tau_max: Any  # in `law`: (n,) torque limits of the arm as described [N m]

    def law(self, q: Array, v: Array, tau: Array) -> Any:
        """Return the torque at the joints beside the motors' [N m].

        Parameters of the effect, and `tau_max`, are arrays (or symbols) here, whatever they
        were given as: () or (n,), and (simulations, 1) or (simulations, n) where simulations
        have values of their own (`Simulator.assign`) and the law broadcasts.

        Args:
            q, v: (..., n) joint angles [rad] and rates [rad/s].
            tau: (..., n) command of the motors within the limits of the arm as described [N m];
                it is what logs record.

        Returns:
            (..., n).
        """


class ArmEffect(Effect):
    """Difference of the arm from its description."""

    modes: ClassVar[tuple[str, ...]] = ("ideal", "emulated")
    port: ClassVar[str] = "joint"
    shows: ClassVar[tuple[str, ...]] = ("joint", "wrench")
    acts = "arm"


class BaseEffect(Effect):
    """Difference of the vehicle, real or emulated, from its description."""

    modes: ClassVar[tuple[str, ...]] = ("ideal", "emulated")
    port: ClassVar[str] = "admittance"
    shows: ClassVar[tuple[str, ...]] = ("admittance", "base")
    acts = "base"


class DelayEffect(Effect):
    """Delay between joint controller and drives."""

    modes: ClassVar[tuple[str, ...]] = ("ideal", "emulated")
    port: ClassVar[str] = "joint"
    shows: ClassVar[tuple[str, ...]] = ("joint", "wrench", "servo", "velocity")
    acts = "wire"


KINDS = (LaboratoryEffect, TorqueEffect, ArmEffect, BaseEffect, DelayEffect)


def parameter(
    symbol: str,
    *,
    bounds: tuple[float, float],
    null: float | None = 0.0,
    shape: tuple[int | None, ...] = (),
    default: Any = dataclasses.MISSING,
    start: float | tuple[float, ...] | None = None,
    search: tuple[float, float] | None = None,
    name: str = "",
    quiets: bool = False,
) -> Any:
    """Return a field of an effect.

    Args:
        symbol: unit.
        bounds: smallest and largest value.
        null: value that leaves the system nominal; None: has none of its own.
        shape: () for a number; None in it for any length.
        default: None given, the null value filled into the shape.
        start: about what a machine may have, where a diagnosis begins; several where nothing
            leads from one to the next. None given, it follows from bounds and null, and a
            number that has a default and no null value is left there.
        search: range that a diagnosis looks in, where that is not all of `bounds`.
        name: that a diagnosis gives the number, where it is not the field's.
        quiets: the larger it is, the less of a log's noise the effect passes on.
    """
    if default is dataclasses.MISSING and null is not None and None not in shape:
        filled = np.full(tuple(k for k in shape if k is not None), null)
        default = nested_tuples(filled)
    metadata = {"start": start, "search": search, "name": name, "quiets": quiets}
    return unit(symbol, default=default, bounds=bounds, null=null, shape=shape, **metadata)


E = TypeVar("E", bound=type[Effect])


@dataclass_transform(
    kw_only_default=True, frozen_default=True, field_specifiers=(parameter, unit)
)
def register_effect(kind: str) -> Callable[[E], E]:
    """Class decorator: file an effect under "place/name"; a name already taken is an error.

    A class that is no dataclass yet becomes one, frozen and with keywords alone.
    """

    def decorate(cls: E) -> E:
        if not issubclass(cls, KINDS):
            choices = ", ".join(k.__name__ for k in KINDS)
            bases = ", ".join(k.__name__ for k in cls.__bases__)
            raise ParameterError(
                f"effect {kind!r} must be a subclass of one of {choices}, got {bases}"
            )
        if "__dataclass_params__" not in vars(cls):
            dataclasses.dataclass(frozen=True, kw_only=True)(cls)  # in place
        if any(getattr(cls, cls.acts) is vars(k).get(cls.acts) for k in (Effect, TorqueEffect)):
            raise ParameterError(f"effect {kind!r} must have the method {cls.acts}, got none")
        if (got := getattr(cls, "port", None)) not in PORTS:
            choices = ", ".join(PORTS)
            raise ParameterError(
                f"effect {kind!r}: port must be one of {choices}, got {got!r}"
                f"{did_you_mean(got, PORTS)}"
            )
        require_free(kind, "effect", cls, EFFECTS.get(kind))
        cls.kind = kind
        EFFECTS[kind] = cls
        return cls

    return decorate


def joint_torque(
    effects: Iterable[Effect], q: Array, v: Array, tau: Array, tau_max: Array
) -> Array:
    """Return the torque of all laws among the effects [N m].

    Args:
        effects: of a system.
        q, v: (..., n) joint angles [rad] and rates [rad/s].
        tau: (..., n) motor torques [N m].
        tau_max: (n,) their limits [N m].

    Returns:
        (..., n).
    """
    out = np.zeros(q.shape)
    for effect in effects:
        if isinstance(effect, TorqueEffect):
            fields = dataclasses.fields(effect)  # type: ignore[arg-type]
            values = {f.name: np.asarray(getattr(effect, f.name), float) for f in fields}
            out = out + effect.bound({**values, "tau_max": tau_max}).law(q, v, tau)
    return out
