"""`Candidate`: an effect in one place, with the numbers that a fit may choose.

`library` is the library of effects as a diagnosis reads it: every kind that a log can tell,
joint by joint or axis by axis.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ves_gym._util.params import Array, ParameterError
from ves_gym._util.suggest import did_you_mean
from ves_gym.diagnosis.machines.base import WRENCH
from ves_gym.diagnosis.machines.drift import SlowPath
from ves_gym.diagnosis.machines.presliding import Presliding
from ves_gym.mechanics.spatial import AXES
from ves_gym.system.effect import EFFECTS

_XYZ = ("x", "y", "z")
_FILTERS = ("joint/elasticity", "joint/backlash")
_WAVES = 8  # a level and slow cosines of a drift
_FREQUENCIES = tuple(np.geomspace(0.5, 6.0, 20).tolist())  # of an extra mode [Hz]
_REACH = 0.03  # m, about which a payload sits otherwise than thought
_GAPS = (2e-3, *np.geomspace(1e-3, 3e-2, 7).tolist())  # rad
_SHORT = tuple(np.geomspace(0.005, 0.6, 16).tolist())  # parts of what legs stretch in the runs
_CEILINGS = tuple((1 - np.geomspace(0.9, 0.05, 16)).tolist())
_CYCLES = tuple(np.arange(2.0, 130.0, 2.5).tolist())  # of a ripple, per turn

Starts = float | tuple[float, ...]
Fields = Callable[[Array], dict[str, Any]]  # free numbers (k,) -> fields of the effect


@dataclass(frozen=True)
class Candidate:
    """An effect with k free numbers in one place.

    `starts` (s, k) are where fits begin; the first is about what a machine may well have,
    and what the data must be able to show if they are to say that it is not there.
    """

    kind: str
    slot: str  # "joint 2", "F_x", "" where there is only one place
    ports: tuple[str, ...]
    names: tuple[str, ...]
    units: tuple[str, ...]
    starts: tuple[tuple[float, ...], ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    make: Callable[[Array], Any]  # numbers (k,) -> the effect
    factors: tuple[int, ...]  # which of the numbers multiply what the effect does
    sets_in: bool = False  # nothing is proportional to its number: starts are tried as they are
    filters: bool = False  # it passes what was measured on, and changes the noise in it
    blurs: tuple[Callable[[Any], Any], ...] = ()  # effect -> another form that it may have
    within: str = ""  # a simpler kind that is a case of this one
    counts: int | None = None  # numbers it costs, where that is not k
    sparse: bool = False  # coordinates of a thing: those that are about zero cost nothing

    @property
    def name(self) -> str:
        """Kind and place, e.g. "joint/coulomb at joint 2"."""
        return f"{self.kind} at {self.slot}" if self.slot else self.kind

    @property
    def k(self) -> int:
        """Number of free numbers."""
        return len(self.names)

    @property
    def price(self) -> int:
        """Least number of parameters it counts as."""
        return 1 if self.sparse else self.k if self.counts is None else self.counts

    def effect(self, values: Array) -> Any:
        """Return the effect with these numbers (k,), clipped to their ranges."""
        return self.make(np.clip(values, self.low, self.high))


class _Library:
    """Collects candidates of kinds whose ports and mode are there."""

    def __init__(self, ports: Iterable[str], mode: str | None) -> None:
        self.ports, self.mode = frozenset(ports), mode
        self.candidates: list[Candidate] = []

    def add(
        self,
        kind: str,
        ports: str,
        slot: str,
        fields: Fields,
        limits: Mapping[str, tuple[float, float, str]] | None = None,
        fixed: Sequence[str] = (),
        sets_in: bool = False,
        within: str = "",
        blurs: Sequence[Callable[[Any], Any]] = (),
        sparse: bool = False,
        **free: Starts,
    ) -> None:
        """Add a candidate, unless none of its ports is there.

        Args:
            kind: registered effect.
            ports: at which it shows, separated by blanks.
            slot: place, e.g. "joint 2".
            fields: free numbers (k,) -> fields of the effect.
            limits: (low, high, unit) of names that are no field of the effect.
            fixed: numbers that give a shape, not a size, as those without a null do.
            sets_in, within, blurs, sparse: see `Candidate`.
            free: name -> starts.
        """
        cls = EFFECTS[kind]
        active_ports = tuple(p for p in ports.split() if p in self.ports)
        if not active_ports or (self.mode is not None and self.mode not in cls.modes):
            return
        meta = {f.name: f.metadata for f in dataclasses.fields(cls)}  # type: ignore[arg-type]
        ranges = []
        for name in free:
            if limits and name in limits:
                ranges.append(limits[name])
            else:
                ranges.append((*meta[name]["bounds"], meta[name]["unit"]))
        grids = [v if isinstance(v, tuple) else (v,) for v in free.values()]
        starts = np.stack(np.meshgrid(*grids, indexing="ij"), -1).reshape(-1, len(free))
        self.candidates.append(
            Candidate(
                kind=kind,
                slot=slot,
                ports=active_ports,
                names=tuple(free),
                units=tuple(r[2] for r in ranges),
                starts=tuple(map(tuple, starts.tolist())),
                low=tuple(r[0] for r in ranges),
                high=tuple(r[1] for r in ranges),
                make=lambda x: cls(**fields(x)),
                factors=tuple(
                    k
                    for k, name in enumerate(free)
                    if name not in fixed
                    and (name not in meta or meta[name]["null"] is not None)
                ),
                sets_in=sets_in,
                filters=cls.kind in _FILTERS,
                blurs=tuple(blurs),
                within=within,
                sparse=sparse,
            )
        )


def library(
    n: int,
    ports: Sequence[str],
    mode: str | None = None,
    runs: Sequence[str] = (),
    stretch: float = 0.25,
) -> tuple[Candidate, ...]:
    """Return all candidates of a machine with n joints and these ports.

    Args:
        n: joints.
        ports: names.
        mode: of a `System`; effects that do not act in it are left out.
        runs: names of the runs, each of which a drifting sensor goes through in its own way.
        stretch: how far a leg of the platform is told to go in them, in parts of its stroke.
    """
    shelf = _Library(ports, mode)
    for j in range(n):
        _joint(shelf, j, n)
    shelf.add("joint/measurement_delay", "joint wrench", "", _same("delay"), delay=5e-3)
    shelf.add("command/delay", "servo", "", _same("delay"), delay=5e-3)
    shelf.add("payload/mass", "joint wrench", "", _same("mass"), blurs=_PLACES, mass=1.0)
    shelf.add(
        "payload/com",
        "joint wrench",
        "",
        _vector("offset"),
        _three("m", 0.2),
        sparse=True,
        **_equal(_XYZ, 0.02),
    )
    _sensor(shelf)
    if "wrench" in shelf.ports and runs:
        shelf.candidates += [_drift(i, runs) for i in range(6)]
    shelf.add("gravity/mass", "gravity", "", _same("error"), error=1.0)
    shelf.add("gravity/scale", "gravity", "", _same("error"), error=0.01)
    shelf.add(
        "gravity/tilt",
        "gravity",
        "",
        _vector("angles"),
        _three("rad", 0.3),
        sparse=True,
        **_equal(_XYZ, 0.01),
    )
    shelf.add("base/virtual_mass", "admittance base", "", _same("error"), error=0.1)
    shelf.add("base/stiffness", "admittance base", "", _same("error"), error=0.1)
    shelf.add("base/damping", "admittance base", "", _same("error"), error=1.0)
    for i, axis in enumerate(AXES):

        def drag(x: Array, i: int = i) -> dict[str, Any]:
            return {"coefficient": tuple(float(x[0]) * (k == i) for k in range(6))}

        unit = "N s^2/m^2" if i < 3 else "N m s^2"
        shelf.add(
            "base/amplitude_damping",
            "admittance base",
            axis,
            drag,
            {"coefficient": (0.0, 1e6, unit)},
            coefficient=500.0,
        )
    for i, axis in enumerate(_XYZ):
        way = tuple(float(k == i) for k in range(3))

        def mode_along(x: Array, way: tuple[float, ...] = way) -> dict[str, Any]:
            return {"mass": float(x[0]), "frequency": float(x[1]), "direction": way}

        shelf.add(
            "base/extra_mode",
            "admittance base",
            axis,
            mode_along,
            {"frequency": (0.1, 6.5, "Hz")},  # above it a vehicle's own inner modes begin
            mass=2.0,
            frequency=_FREQUENCIES,
        )
    shelf.add("platform/bandwidth", "platform", "", _same("error"), error=0.2)
    shelf.add("platform/damping", "platform", "", _same("error"), error=0.2)
    shelf.add("platform/delay", "platform", "", _same("delay"), delay=5e-3)
    lacking = tuple(1 - stretch * (1 - part) for part in _SHORT)  # more shows in no run
    shelf.add("platform/stroke", "platform", "", _same("travel"), sets_in=True, travel=lacking)
    return tuple(shelf.candidates)


def without(candidates: Sequence[Candidate], kinds: Sequence[str]) -> tuple[Candidate, ...]:
    """Return the library less some kinds of effect.

    Raises:
        ParameterError: a kind that is not in it.
    """
    available = {c.kind for c in candidates}
    for kind in kinds:
        if kind not in available:
            raise ParameterError(
                f"no candidate {kind!r}; known: {', '.join(sorted(available))}"
                f"{did_you_mean(kind, available)}"
            )
    return tuple(c for c in candidates if c.kind not in kinds)


def _joint(shelf: _Library, j: int, n: int) -> None:
    """Add the candidates of joint j of n."""

    def at(value: float, elsewhere: float = 0.0) -> tuple[float, ...]:
        out = [elsewhere] * n
        out[j] = float(value)
        return tuple(out)

    def joint_fields(*names: str) -> Fields:
        return lambda x: {name: at(x[i]) for i, name in enumerate(names)}

    slot = f"joint {j + 1}"

    def add(kind: str, fields: Fields, ports: str = "joint", **options: Any) -> None:
        shelf.add(f"joint/{kind}", ports, slot, fields, **options)

    add("coulomb", joint_fields("torque"), blurs=[Presliding], torque=2.0)
    add("viscous", joint_fields("damping"), damping=3.0)
    add(
        "stribeck",
        lambda x: {
            "coulomb": at(x[0]),
            "stiction": at(x[0] * (1 + x[1])),
            "fade_speed": float(x[2]),
        },
        limits={"breakaway": (0.0, 3.0, "1")},  # of Coulomb's level, above it
        fixed=("breakaway",),
        within="joint/coulomb",
        blurs=[Presliding],
        coulomb=2.0,
        breakaway=1.0,
        fade_speed=(0.05, 0.2),
    )
    add(
        "asymmetry",
        joint_fields("coulomb", "viscous"),
        blurs=[Presliding],
        coulomb=1.0,
        viscous=0.5,
    )
    add("torque_offset", joint_fields("torque"), torque=1.0)
    add("load_friction", joint_fields("coefficient"), blurs=[Presliding], coefficient=0.1)
    add(
        "elasticity",
        lambda x: {"compliance": at(x[0]), "damping": at(x[1], elsewhere=5.0)},
        "joint wrench",
        fixed=("damping",),
        compliance=(1e-4, 3e-4, 3e-5),
        damping=30.0,
    )
    add(
        "backlash",
        joint_fields("gap"),
        "joint wrench",
        limits={"gap": (2e-4, 0.1, "rad")},  # less is the teeth's own compliance
        sets_in=True,
        gap=_GAPS,
    )
    add(  # sine and cosine in place of amplitude and phase: a fit has no corner at zero
        "ripple",
        lambda x: {
            "amplitude": at(np.hypot(x[0], x[1])),
            "phase": at(np.arctan2(x[1], x[0])),
            "cycles": at(x[2], elsewhere=1.0),
        },
        limits={"sine": (-14.0, 14.0, "N m"), "cosine": (-14.0, 14.0, "N m")},
        sine=1.0,
        cosine=1.0,
        cycles=_CYCLES,
    )
    add("rotor_inertia", joint_fields("added"), added=0.3)
    add("drive_gain", joint_fields("error"), error=0.05)
    add("torque_limit", joint_fields("fraction"), sets_in=True, fraction=_CEILINGS)
    add(
        "velocity_lag",
        joint_fields("time_constant"),
        "velocity",
        time_constant=(0.02, 0.005, 0.2),
    )


def _elsewhere(i: int) -> Callable[[Any], Any]:
    """Return a change of a payload that puts it farther along an axis of its link."""
    return lambda e: dataclasses.replace(
        e, position=tuple(x + _REACH * (k == i) for k, x in enumerate(e.position))
    )


_PLACES = tuple(_elsewhere(i) for i in range(3))


def _sensor(shelf: _Library) -> None:
    """Add the candidates of the force sensor."""
    for i, axis in enumerate(WRENCH):
        what, unit = ("force", "N") if i < 3 else ("moment", "N m")
        far = 50.0 if i < 3 else 20.0

        def bias(x: Array, what: str = what, i: int = i) -> dict[str, Any]:
            out = [0.0] * 3
            out[i % 3] = float(x[0])
            return {what: tuple(out)}

        def row(x: Array, i: int = i) -> dict[str, Any]:
            matrix = np.zeros((6, 6))
            matrix[i] = x
            return {"error": tuple(map(tuple, matrix.tolist()))}

        shelf.add("sensor/bias", "wrench", axis, bias, {"bias": (-far, far, unit)}, bias=2.0)
        mixed = dict.fromkeys(WRENCH, (-0.5, 0.5, "1"))
        small = _equal(WRENCH, 0.02)
        shelf.add("sensor/calibration", "wrench", axis, row, mixed, sparse=True, **small)
    shelf.add(
        "sensor/rotation",
        "wrench",
        "",
        _vector("angles"),
        _three("rad", 0.1),
        sparse=True,
        **_equal(_XYZ, 0.01),
    )
    shelf.add("sensor/lag", "wrench", "", _same("error"), error=-0.3)


def _drift(i: int, runs: Sequence[str]) -> Candidate:
    """Return the drift of one signal: in each run a level and slow cosines of its own."""
    k = _WAVES * len(runs)
    unit = "N" if i < 3 else "N m"

    def path(x: Array) -> SlowPath:
        weights = np.reshape(x, (len(runs), _WAVES)).tolist()
        return SlowPath(i, tuple((r, tuple(w)) for r, w in zip(runs, weights, strict=True)))

    return Candidate(
        kind="sensor/drift",
        slot=WRENCH[i],
        ports=("wrench",),
        names=tuple(f"{r} {j}" for r in runs for j in range(_WAVES)),
        units=(unit,) * k,
        starts=((1.0,) * k,),
        low=(-100.0,) * k,
        high=(100.0,) * k,
        make=path,
        factors=tuple(range(k)),
        counts=_WAVES,  # all runs drift by one law
    )


def _same(*names: str) -> Fields:
    return lambda x: {name: float(x[i]) for i, name in enumerate(names)}


def _vector(name: str) -> Fields:
    return lambda x: {name: tuple(x.tolist())}


def _equal(names: Sequence[str], value: float) -> dict[str, Any]:
    """The same start for several numbers."""
    return dict.fromkeys(names, value)


def _three(unit: str, far: float) -> dict[str, tuple[float, float, str]]:
    return dict.fromkeys(_XYZ, (-far, far, unit))
