"""What can be wrong with a machine: the effects of the library, and some outside it.

An effect has a slot (a joint, an axis), a magnitude whose zero leaves the machine as it was,
and constants that are drawn. Where the library's law is simple, the truth here is richer:
friction builds up over a bristle's length (LuGre), gears have two inertias and a loss,
backlash has a soft contact, a sensor is turned by a rotation and not by its linear part.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import scipy

from ves_gym._util.params import Array, ParameterError
from ves_gym._util.suggest import did_you_mean
from ves_gym.diagnosis.benchmark.blind import plant as cols
from ves_gym.diagnosis.benchmark.blind.beam import BaseMatrices
from ves_gym.diagnosis.benchmark.blind.mechanics import BodyParameters
from ves_gym.diagnosis.benchmark.blind.setup import MachineSetup

Constants = dict[str, Any]
JOINTS = ("joint 1", "joint 2", "joint 3")
AXES = ("x", "y", "z", "phi_x", "phi_y", "phi_z")
SIGNALS = ("f_x", "f_y", "f_z", "m_x", "m_y", "m_z")
WHOLE = ("",)
TRIES = 4  # at least, of an effect that may be out of the excitation's reach
CONTACT = 2e5  # N m/rad, gear teeth in contact


class Truth(NamedTuple):
    """One kind of effect."""

    kind: str
    port: str  # where it enters: joint, payload, wrench, platform or admittance
    slots: tuple[str, ...]
    start: float  # magnitude the search starts from
    most: float  # largest magnitude that still is this effect
    apply: Callable[[MachineSetup, int, float, Constants], MachineSetup]
    parameters: Callable[[float, Constants], dict[str, Any]]  # as the library names them
    draw: Callable[[np.random.Generator], Constants]


class HiddenEffect(NamedTuple):
    """One effect in one machine."""

    kind: str
    slot: int
    magnitude: float
    constants: Constants

    @property
    def truth(self) -> Truth:
        """Its kind's definition."""
        return TRUTHS[self.kind]

    def applied(self, setup: MachineSetup) -> MachineSetup:
        """The machine with the effect."""
        return self.truth.apply(setup, self.slot, self.magnitude, self.constants)

    def label(self) -> dict[str, Any]:
        """Kind, slot and parameters, plain data."""
        return {
            "kind": self.kind,
            "slot": self.truth.slots[self.slot],
            "magnitude": self.magnitude,
            "parameters": self.truth.parameters(self.magnitude, self.constants),
        }


TRUTHS: dict[str, Truth] = {}


def _nothing(rng: np.random.Generator) -> Constants:
    return {}


def _sign(rng: np.random.Generator) -> Constants:
    return {"sign": 1.0 if rng.random() < 0.5 else -1.0}


def _named(name: str) -> Callable[[float, Constants], dict[str, Any]]:
    return lambda m, c: {name: c.get("sign", 1.0) * m}


def truth(
    kind: str,
    slots: tuple[str, ...],
    start: float,
    most: float,
    parameters: Callable[[float, Constants], dict[str, Any]] | str,
    draw: Callable[[np.random.Generator], Constants] = _nothing,
    port: str = "",
) -> Callable[[Callable[[MachineSetup, int, float, Constants], MachineSetup]], Any]:
    """Register an effect; the decorated function applies it.

    Args:
        kind: of the library, or outside it.
        slots: places.
        start, most: magnitudes, of the search's beginning and at most.
        parameters: magnitude and constants -> as the library names them; a name for one.
        draw: constants.
        port: at which it enters, where that is not said by the kind.
    """

    def file(apply: Callable[[MachineSetup, int, float, Constants], MachineSetup]) -> Any:
        named = _named(parameters) if isinstance(parameters, str) else parameters
        place = port or {"sensor": "wrench", "gravity": "wrench", "base": "admittance"}.get(
            kind.partition("/")[0], kind.partition("/")[0]
        )
        TRUTHS[kind] = Truth(kind, place, slots, start, most, apply, named, draw)
        return apply

    return file


def _put(array: Array, where: Any, value: Any) -> Array:
    out = array.copy()
    out[where] = value
    return out


# ------------------------------------------------------------------------------ joints


@truth("joint/coulomb", JOINTS, 1.0, 25.0, "torque")
def _(s: MachineSetup, j: int, m: float, c: Constants) -> MachineSetup:
    f = s.plant.friction
    return s.edit(friction=_put(f, (j, cols.COULOMB), f[j, cols.COULOMB] + m))


@truth("joint/viscous", JOINTS, 3.0, 60.0, "damping")
def _(s: MachineSetup, j: int, m: float, c: Constants) -> MachineSetup:
    f = s.plant.friction
    return s.edit(friction=_put(f, (j, cols.VISCOUS), f[j, cols.VISCOUS] + m))


def _stribeck(rng: np.random.Generator) -> Constants:
    return {"ratio": float(rng.uniform(1.8, 3.0)), "fade": float(rng.uniform(0.06, 0.25))}


@truth(
    "joint/stribeck",
    JOINTS,
    1.0,
    20.0,
    lambda m, c: {"coulomb": m, "stiction": m * c["ratio"], "fade_speed": c["fade"]},
    _stribeck,
)
def _(s: MachineSetup, j: int, m: float, c: Constants) -> MachineSetup:
    f = s.plant.friction.copy()
    f[j, cols.COULOMB] += m
    f[j, cols.STICTION], f[j, cols.FADE] = m * (c["ratio"] - 1), c["fade"]
    return s.edit(friction=f)


@truth("joint/asymmetry", JOINTS, 1.0, 15.0, "coulomb", _sign)
def _(s: MachineSetup, j: int, m: float, c: Constants) -> MachineSetup:
    return s.edit(friction=_put(s.plant.friction, (j, cols.ONE_WAY), c["sign"] * m))


@truth("joint/load_friction", JOINTS, 0.03, 0.4, "coefficient")
def _(s: MachineSetup, j: int, m: float, c: Constants) -> MachineSetup:
    return s.edit(friction=_put(s.plant.friction, (j, cols.LOAD), m))


def _gear(rng: np.random.Generator) -> Constants:
    return {"damping": float(rng.uniform(15.0, 40.0))}


@truth(
    "joint/elasticity",
    JOINTS,
    3e-5,
    6e-4,
    lambda m, c: {"compliance": m, "damping": c["damping"]},
    _gear,
)
def _(s: MachineSetup, j: int, m: float, c: Constants) -> MachineSetup:
    return s.edit(
        stiffness=_put(s.plant.stiffness, j, 1 / m),
        loss=_put(s.plant.loss, j, c["damping"]),
    )


@truth("joint/backlash", JOINTS, 1e-3, 6e-2, "gap")
def _(s: MachineSetup, j: int, m: float, c: Constants) -> MachineSetup:
    return s.edit(
        stiffness=_put(s.plant.stiffness, j, CONTACT),
        loss=_put(s.plant.loss, j, 0.1 * np.sqrt(CONTACT * s.plant.rotor[j])),
        gap=_put(s.plant.gap, j, m / 2),
    )


def _ripple(rng: np.random.Generator) -> Constants:
    return {
        "cycles": float(rng.integers(8, 41)),
        "phase": float(rng.uniform(-np.pi, np.pi)),
    }


@truth(
    "joint/ripple",
    JOINTS,
    1.0,
    15.0,
    lambda m, c: {"amplitude": m, "cycles": c["cycles"], "phase": c["phase"]},
    _ripple,
)
def _(s: MachineSetup, j: int, m: float, c: Constants) -> MachineSetup:
    return s.edit(ripple=_put(s.plant.ripple, j, [m, c["cycles"], c["phase"]]))


@truth("joint/rotor_inertia", JOINTS, 0.3, 4.0, "added")
def _(s: MachineSetup, j: int, m: float, c: Constants) -> MachineSetup:
    return s.edit(rotor=_put(s.plant.rotor, j, s.plant.rotor[j] + m))


@truth("joint/drive_gain", JOINTS, 0.05, 0.45, "error", _sign)
def _(s: MachineSetup, j: int, m: float, c: Constants) -> MachineSetup:
    return s.edit(gain=_put(s.plant.gain, j, s.plant.gain[j] * (1 + c["sign"] * m)))


@truth("joint/torque_limit", JOINTS, 0.6, 0.97, "fraction")
def _(s: MachineSetup, j: int, m: float, c: Constants) -> MachineSetup:
    return s.edit(ceiling=_put(s.plant.ceiling, j, (1 - m) * s.plant.limit[j]))


@truth("command/delay", WHOLE, 2e-3, 0.08, "delay", port="joint")
def _(s: MachineSetup, j: int, m: float, c: Constants) -> MachineSetup:
    return s._replace(drive=s.drive._replace(late=m))


@truth("joint/measurement_delay", WHOLE, 2e-3, 0.08, "delay")
def _(s: MachineSetup, j: int, m: float, c: Constants) -> MachineSetup:
    return s.edit(age=m)


# ----------------------------------------------------------------------------- payload


def _place(rng: np.random.Generator) -> Constants:
    return {"position": rng.uniform(-0.05, 0.05, 3).tolist()}


@truth(
    "payload/mass",
    WHOLE,
    0.2,
    8.0,
    lambda m, c: {"mass": m, "position": c["position"]},
    _place,
)
def _(s: MachineSetup, j: int, m: float, c: Constants) -> MachineSetup:
    b, place = s.plant.bodies, np.array(c["position"])
    d = place - b.com[-1]
    total = b.mass[-1] + m
    spread = b.mass[-1] * m / total * ((d @ d) * np.eye(3) - np.outer(d, d))
    heavier = BodyParameters(
        b.dh,
        _put(b.mass, -1, total),
        _put(b.com, -1, (b.mass[-1] * b.com[-1] + m * place) / total),
        _put(b.inertia, -1, b.inertia[-1] + spread),
    )
    return s.edit(bodies=heavier)


@truth("payload/com", ("x", "y", "z"), 0.01, 0.25, "offset", _sign)
def _(s: MachineSetup, j: int, m: float, c: Constants) -> MachineSetup:
    b = s.plant.bodies
    moved = _put(b.com, (-1, j), b.com[-1, j] + c["sign"] * m)
    return s.edit(bodies=b._replace(com=moved))


# ------------------------------------------------------------------------ force sensor


@truth("sensor/bias", SIGNALS, 1.0, 60.0, "offset", _sign)
def _(s: MachineSetup, j: int, m: float, c: Constants) -> MachineSetup:
    return s.edit(offset=_put(s.plant.offset, j, s.plant.offset[j] + c["sign"] * m))


def _calibration(rng: np.random.Generator) -> Constants:
    # half are gains, half cross-talk from another signal of the same unit
    return {**_sign(rng), "shift": int(rng.choice([0, 0, 1, 2]))}


def _source(j: int, c: Constants) -> int:
    return j - j % 3 + (j % 3 + c["shift"]) % 3


@truth(
    "sensor/calibration",
    SIGNALS,
    0.01,
    0.4,
    lambda m, c: {"error": c["sign"] * m, "from": c["shift"]},
    _calibration,
)
def _(s: MachineSetup, j: int, m: float, c: Constants) -> MachineSetup:
    error = np.eye(6)
    error[j, _source(j, c)] += c["sign"] * m
    return s.edit(to_signal=error @ s.plant.to_signal)


@truth("sensor/rotation", ("x", "y", "z"), 2e-3, 0.1, "angles", _sign)
def _(s: MachineSetup, j: int, m: float, c: Constants) -> MachineSetup:
    angles = c["sign"] * m * np.eye(3)[j]
    # a vector seen from a frame that is turned by the angles
    turn = scipy.spatial.transform.Rotation.from_rotvec(-angles).as_matrix()
    return s.edit(to_signal=np.kron(np.eye(2), turn) @ s.plant.to_signal)


def _drift(rng: np.random.Generator) -> Constants:
    return {"time": float(rng.uniform(2.0, 15.0))}


@truth("sensor/drift", SIGNALS, 1.0, 18.0, lambda m, c: {"std": m, "time": c["time"]}, _drift)
def _(s: MachineSetup, j: int, m: float, c: Constants) -> MachineSetup:
    return s.edit(creep=_put(s.plant.creep, j, m), creep_time=c["time"])


@truth("sensor/lag", WHOLE, 0.2, 0.85, lambda m, c: {"error": -m})
def _(s: MachineSetup, j: int, m: float, c: Constants) -> MachineSetup:
    return s.edit(filter=s.plant.filter * (1 - m))


@truth("gravity/mass", WHOLE, 0.2, 15.0, "error", _sign)
def _(s: MachineSetup, j: int, m: float, c: Constants) -> MachineSetup:
    return s.edit(surplus=s.plant.surplus + c["sign"] * m)


@truth("gravity/tilt", ("x", "y"), 1e-3, 0.08, "angles", _sign)
def _(s: MachineSetup, j: int, m: float, c: Constants) -> MachineSetup:
    return s.edit(tilt=_put(s.plant.tilt, j, c["sign"] * m))


@truth("gravity/scale", WHOLE, 2e-3, 0.15, "error", _sign)
def _(s: MachineSetup, j: int, m: float, c: Constants) -> MachineSetup:
    return s.edit(scale=s.plant.scale * (1 + c["sign"] * m))


# ---------------------------------------------------------------- platform, admittance


@truth("platform/delay", WHOLE, 3e-3, 0.03, "delay")
def _(s: MachineSetup, j: int, m: float, c: Constants) -> MachineSetup:
    return s.edit(late=m)


@truth("platform/bandwidth", WHOLE, 0.15, 0.7, "error", _sign)
def _(s: MachineSetup, j: int, m: float, c: Constants) -> MachineSetup:
    w = s.plant.servo[0] * (1 + c["sign"] * m)
    return s.edit(servo=_put(s.plant.servo, 0, w))


HALF_STROKE = 0.4  # m, of the legs about home; a fraction of it is lacking


@truth("platform/stroke", WHOLE, 0.96, 0.9995, "travel")
def _(s: MachineSetup, j: int, m: float, c: Constants) -> MachineSetup:
    return s.edit(stroke=np.full(6, (1 - m) * HALF_STROKE))


@truth("base/virtual_mass", WHOLE, 0.05, 0.6, "error", _sign)
def _(s: MachineSetup, j: int, m: float, c: Constants) -> MachineSetup:
    return s._replace(base=s.base._replace(M=s.base.M * (1 + c["sign"] * m)))


@truth("base/stiffness", WHOLE, 0.03, 0.6, "error", _sign)
def _(s: MachineSetup, j: int, m: float, c: Constants) -> MachineSetup:
    return s._replace(base=s.base._replace(K=s.base.K * (1 + c["sign"] * m)))


def _loss(m: float, c: Constants) -> float:
    """Relative change of the damping, which stays positive."""
    return max(c["sign"] * m, -0.98)


@truth("base/damping", WHOLE, 0.3, 5.0, lambda m, c: {"error": _loss(m, c)}, _sign)
def _(s: MachineSetup, j: int, m: float, c: Constants) -> MachineSetup:
    return s._replace(base=s.base._replace(D=s.base.D * (1 + _loss(m, c))))


@truth("base/amplitude_damping", AXES[:3], 300.0, 1e5, "coefficient")
def _(s: MachineSetup, j: int, m: float, c: Constants) -> MachineSetup:
    return s.edit(drag=_put(s.plant.drag, j, m))


def _mode(rng: np.random.Generator) -> Constants:
    return {"frequency": float(rng.uniform(0.8, 3.0)), "damping_ratio": 0.02}


@truth(
    "base/extra_mode",
    AXES[:3],
    2.0,
    60.0,
    lambda m, c: {
        "mass": m,
        "frequency": c["frequency"],
        "damping_ratio": c["damping_ratio"],
    },
    _mode,
)
def _(s: MachineSetup, j: int, m: float, c: Constants) -> MachineSetup:
    """A mass on a spring at the tip, moving along one axis."""
    n, w = len(s.base.M), 2 * np.pi * c["frequency"]
    M, D, K = (np.pad(k, (0, 1)) for k in s.base)
    M[j, j] += m
    M[j, n] = M[n, j] = M[n, n] = m
    K[n, n], D[n, n] = m * w**2, 2 * c["damping_ratio"] * w * m
    return s._replace(base=BaseMatrices(M, D, K))


LIBRARY = tuple(TRUTHS)

# ----------------------------------------------------------------- outside the library


@truth("outside/packet_loss", WHOLE, 0.1, 0.8, "share", port="wrench")
def _(s: MachineSetup, j: int, m: float, c: Constants) -> MachineSetup:
    return s  # the run's noise carries the losses


def _mains(rng: np.random.Generator) -> Constants:
    return {
        "frequency": float(rng.uniform(49.9, 50.1)),
        "phase": float(rng.uniform(0, 2 * np.pi)),
        "share": rng.uniform(-1, 1, 6).tolist(),
    }


@truth("outside/mains_pickup", WHOLE, 1.0, 60.0, "amplitude", _mains, port="wrench")
def _(s: MachineSetup, j: int, m: float, c: Constants) -> MachineSetup:
    return s.edit(
        pickup=m * np.array(c["share"]),
        mains=np.array([2 * np.pi * c["frequency"], c["phase"]]),
    )


@truth("outside/dwell_stiction", JOINTS, 4.0, 60.0, "torque", port="joint")
def _(s: MachineSetup, j: int, m: float, c: Constants) -> MachineSetup:
    return s.edit(friction=_put(s.plant.friction, (j, cols.RESTING), m))


def _floor(rng: np.random.Generator) -> Constants:
    return {
        "frequency": rng.uniform(4.0, 14.0, 3).tolist(),
        "phase": rng.uniform(0, 2 * np.pi, 3).tolist(),
        "share": rng.uniform(0.3, 1.0, 3).tolist(),
        "direction": float(rng.uniform(0, 2 * np.pi)),
    }


@truth("outside/floor_vibration", WHOLE, 0.01, 1.0, "acceleration", _floor, port="platform")
def _(s: MachineSetup, j: int, m: float, c: Constants) -> MachineSetup:
    rows = [
        [m * a, 2 * np.pi * f, p, np.cos(c["direction"]), np.sin(c["direction"])]
        for a, f, p in zip(c["share"], c["frequency"], c["phase"], strict=True)
    ]
    return s.edit(floor=np.array(rows))


def _hose(rng: np.random.Generator) -> Constants:
    share = rng.uniform(0.4, 1.0, 3) * rng.choice([-1.0, 1.0], 3)
    return {"share": share.tolist(), "slack": float(rng.uniform(-0.6, 0.3))}


@truth("outside/hose_drag", WHOLE, 2.0, 80.0, "stiffness", _hose, port="joint")
def _(s: MachineSetup, j: int, m: float, c: Constants) -> MachineSetup:
    return s.edit(hose=np.array([m, *c["share"], c["slack"], 0.2]))


def _rolling(rng: np.random.Generator) -> Constants:
    return {
        "frequency": float(rng.uniform(0.08, 0.3)),
        "phase": float(rng.uniform(0, 2 * np.pi)),
    }


@truth("outside/rolling_base", WHOLE, 1e-3, 0.05, "angle", _rolling, port="platform")
def _(s: MachineSetup, j: int, m: float, c: Constants) -> MachineSetup:
    return s.edit(rock=np.array([m, 2 * np.pi * c["frequency"], c["phase"]]))


OUTSIDE = tuple(k for k in TRUTHS if k not in LIBRARY)


def drawn(kind: str, rng: np.random.Generator) -> list[HiddenEffect]:
    """Return tries of a kind, as large as the search starts: its slots in random order.

    Kinds with few slots have each of them again, with other constants (and signs).

    Args:
        kind: of effect.
        rng: of slots and constants.

    Raises:
        ParameterError: no such kind.
    """
    if kind not in TRUTHS:
        raise ParameterError(
            f"effect must be one of {', '.join(TRUTHS)}, got {kind!r}"
            f"{did_you_mean(kind, TRUTHS)}"
        )
    t = TRUTHS[kind]
    order = rng.permutation(len(t.slots)).tolist()
    order *= -(-TRIES // len(order))
    return [HiddenEffect(kind, slot, t.start, t.draw(rng)) for slot in order]
