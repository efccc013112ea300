"""The platform as blocks: the line to it, its servo at two levels of detail, its safety."""

from __future__ import annotations

import numpy as np

from ves_gym._util.params import Array
from ves_gym.engine.batch_parameters import Bodies
from ves_gym.hardware.leg_servo import Legs
from ves_gym.hardware.platform import PoseServo, second_order
from ves_gym.hardware.stewart import Stewart
from ves_gym.simulation.blocks.block import (
    Block,
    LoopShape,
    Memory,
    Stepped,
    Values,
    mixed,
    shares,
)
from ves_gym.system.deviations import LoopParameters
from ves_gym.system.emulator_settings import EmulatorSettings

_REFINE = 3  # rounds of scaling a pose to the legs' reach


class ComputingDelay(Block):
    """Control periods between a reading and the command that it causes."""

    name = "computing_delay"
    inputs = ("motion",)
    outputs = ("command",)

    def __init__(self, periods: int) -> None:
        self.periods = periods
        self.memory = {"queue": Memory((periods, 12))}  # commands on their way, oldest first

    def step(self, p: Values, x: Values, u: Values) -> Stepped:
        queue = np.concatenate([x["queue"], u["motion"][:, None]], axis=1)
        return {"queue": queue[:, 1:]}, {"command": queue[:, 0]}

    def start(self, p: Values, u: Values) -> Stepped:
        return {"queue": np.repeat(u["X"][:, None], self.periods, axis=1)}, {"command": u["X"]}


class Safety(Block):
    """Freezes a platform that may not go on (thesis 2.4.2)."""

    name = "safety"
    inputs = ("command", "reading", "command_sent", "frozen")
    outputs = ("command_sent", "frozen")

    def __init__(self, settings: EmulatorSettings, shape: LoopShape) -> None:
        self.settings, self.shape = settings, shape
        self.structure = (settings.stewart, settings.force_max, settings.moment_max)

    def step(self, p: Values, x: Values, u: Values) -> Stepped:
        spec, stewart, reading = self.settings, self.settings.stewart, u["reading"]
        before = stewart.leg_lengths(u["command_sent"][:, :6])
        lengths = stewart.leg_lengths(u["command"][:, :6])
        speeds = np.abs(lengths - before) / self.shape.control_dt
        # asked this way round, what is not a number counts as unsafe
        checks = (
            (stewart.length_min <= lengths).all(axis=-1),
            (lengths <= stewart.length_max).all(axis=-1),
            (speeds <= stewart.speed_max).all(axis=-1),
            _size(reading[:, :3]) <= spec.force_max,
            _size(reading[:, 3:]) <= spec.moment_max,
        )
        safe = np.stack(checks).all(axis=0)
        frozen = np.where(safe, u["frozen"], 1.0)
        sent = np.where(frozen[:, None] != 0.0, standing(u), u["command"])
        return {}, {"command_sent": sent, "frozen": frozen}

    def start(self, p: Values, u: Values) -> Stepped:
        return {}, {"command_sent": u["X"], "frozen": np.zeros(len(u["X"]))}

    def reason(self, before: Array, command: Array, reading: Array) -> str:
        """Say why a platform was frozen.

        Args:
            before, command: (12,) the command before, and the one refused.
            reading: (6,) [N, N m].
        """
        spec, stewart = self.settings, self.settings.stewart
        lengths = stewart.leg_lengths(np.stack([before[:6], command[:6]]))
        outside, far, length = stewart.beyond(lengths[1])
        _, fast, speed = stewart.too_fast(lengths[0], lengths[1], self.shape.control_dt)
        force, moment = (float(np.linalg.norm(k)) for k in np.split(reading, 2))
        if outside:
            return (
                f"leg {far + 1} would be {length:.3f} m long, its range is"
                f" {stewart.length_min:.3f} to {stewart.length_max:.3f} m (outside the"
                " workspace)"
            )
        if not force <= spec.force_max:
            return f"force {force:.0f} N is above the limit of {spec.force_max:g} N"
        if not moment <= spec.moment_max:
            limit = f"{spec.moment_max:g} N m"
            return f"moment {moment:.0f} N m is above the limit of {limit}"
        limit = f"{stewart.speed_max:g} m/s"
        return f"leg {fast + 1} would move at {speed:.2f} m/s, its limit is {limit}"


def _size(vectors: Array) -> Array:
    """Length of vectors (n, 3)."""
    x, y, z = (vectors[:, k] for k in range(3))
    return np.sqrt(x * x + y * y + z * z)


def standing(u: Values) -> Array:
    """Return the last command's pose (n, 12), at rest."""
    pose = u["command_sent"][:, :6]
    return np.concatenate([pose, 0.0 * pose], axis=-1)


class CommandLine(Block):
    """The command as the platform receives it: late, or as far as short or slow legs can go."""

    name = "command_line"
    inputs = ("command_sent",)
    outputs = ("command_received",)

    def __init__(self, stewart: Stewart, shape: LoopShape, oldest: int, limited: bool) -> None:
        """`oldest`: commands to look back over; `limited`: legs may be short or slow."""
        self.stewart, self.shape = stewart, shape
        self.oldest, self.limited = oldest, limited
        self.memory = {
            "history": Memory((oldest, 12)),  # earlier commands, newest first
            "received": Memory((12,), feeds_back=limited),
        }
        self.structure = (limited and stewart, oldest)

    def parameters(self, p: LoopParameters, bodies: Bodies) -> dict[str, Array]:
        age = p.platform_delay / self.shape.control_dt
        return {
            "shares": shares(age, self.oldest + 1),
            "travel": p.platform_travel,
            "speed": p.platform_speed,
        }

    def step(self, p: Values, x: Values, u: Values) -> Stepped:
        out = u["command_sent"]
        nodes = np.concatenate([out[:, None], x["history"]], axis=1)
        if self.oldest:
            out = mixed(p["shares"], nodes)
        if self.limited:
            out = self.within_reach(p, out, x["received"])
        return {"history": nodes[:, :-1], "received": out}, {"command_received": out}

    def start(self, p: Values, u: Values) -> Stepped:
        X = u["X"]
        return {"history": np.repeat(X[:, None], self.oldest, axis=1), "received": X}, {}

    def within_reach(self, p: Values, command: Array, last: Array) -> Array:
        """Return commands held back on their way, as far as the legs go.

        Args:
            p: parameters, (n,) each.
            command: (n, 12) pose and rate.
            last: (n, 12) what was received a period ago.
        """
        stewart, dt, speed = self.stewart, self.shape.control_dt, p["speed"]
        before = last[:, :6]
        pose = self.shortened(command[:, :6], p["travel"])
        lengths = stewart.leg_lengths(pose) - stewart.leg_lengths(before)
        haste = np.max(np.abs(lengths), axis=-1) / (dt * stewart.speed_max * (1 - speed))
        late = ~((speed <= 0.0) | (haste <= 1.0))
        slower = before + (pose - before) / np.maximum(haste, 1.0)[:, None]
        pose = np.where(late[:, None], slower, pose)
        changed = (pose != command[:, :6]).any(axis=-1)[:, None]
        rate = np.where(changed, (pose - before) / dt, command[:, 6:])
        return np.concatenate([pose, rate], axis=-1)

    def shortened(self, pose: Array, travel: Array) -> Array:
        """Return poses on their way from home, where legs lack a part of their stroke.

        Args:
            pose: (n, 6) [m, rad].
            travel: (n,) share of the stroke that is missing.
        """
        excess = self._excess(pose, travel)
        beyond = ~((travel <= 0.0) | (excess <= 1.0))
        for _ in range(_REFINE):  # legs stretch almost in proportion
            excess = np.where(beyond, self._excess(pose, travel), 1.0)
            pose = pose / excess[:, None]
        return pose

    def _excess(self, pose: Array, travel: Array) -> Array:
        """(n,) how far poses stretch a leg, in units of what its short stroke allows."""
        stewart = self.stewart
        home = stewart.home_lengths
        stretch = stewart.leg_lengths(pose) - home
        shorter = stretch <= 0.0
        room = np.where(shorter, home - stewart.length_min, stewart.length_max - home)
        most: Array = np.max(np.abs(stretch) / (room * (1 - travel)[:, None]), axis=-1)
        return most


class PosePlatform(Block):
    """A platform whose six coordinates follow their command as a `PoseServo` does."""

    name = "platform"
    inputs = ("command_received",)
    outputs = ("y", "yd", "ydd", "y_measured")

    def __init__(self, servo: PoseServo, shape: LoopShape, *, as_stated: bool = False) -> None:
        """`as_stated`: by the description, whatever the effects."""
        self.servo, self.shape, self.as_stated = servo, shape, as_stated
        self.nodes = np.arange(shape.nodes) * np.float64(shape.physics_dt)
        self.memory = {"y": Memory((6,)), "yd": Memory((6,))}
        self.structure = (servo.rate_feedforward,)

    def parameters(self, p: LoopParameters, bodies: Bodies) -> dict[str, Array]:
        return {"response": self.response(p)}

    def response(self, p: LoopParameters) -> Array:
        """(n, k, 3, 2): e, e', e'' at the nodes per unit of e and e' now."""
        change = 0.0 if self.as_stated else 1.0
        w = 2 * np.pi * self.servo.bandwidth * (1 + change * p.bandwidth)
        zeta = self.servo.damping_ratio * (1 + change * p.damping)
        return second_order(w, zeta, self.nodes)

    def step(self, p: Values, x: Values, u: Values) -> Stepped:
        y_cmd, rate = u["command_received"][:, :6], u["command_received"][:, 6:]
        if not self.servo.rate_feedforward:
            rate = 0.0 * rate
        error = np.stack([x["y"] - y_cmd, x["yd"] - rate], axis=1)  # (n, 2, 6)
        k = self.shape.nodes
        path = (p["response"].reshape(-1, 3 * k, 2) @ error).reshape(-1, k, 3, 6)
        y = y_cmd[:, None] + rate[:, None] * self.nodes[:, None] + path[:, :, 0]
        yd = rate[:, None] + path[:, :, 1]
        out = {"y": y, "yd": yd, "ydd": path[:, :, 2], "y_measured": y[:, -1]}
        return {"y": y[:, -1], "yd": yd[:, -1]}, out

    def start(self, p: Values, u: Values) -> Stepped:
        y, yd = np.split(u["X"], 2, axis=-1)
        return {"y": y, "yd": yd}, {"y_measured": y}

    def present(self, x: Values) -> tuple[Array, Array]:
        """Pose and rate (n, 6) that the legs have now."""
        return x["y"], x["yd"]


class LegServos(Block):
    """A platform on six leg servos (`hardware.leg_servo`): a sample of theirs at a time."""

    name = "platform"
    inputs = ("command_received",)
    outputs = ("y_nodes", "yd_nodes", "ydd_nodes", "legs", "pose")
    stacked = ("y_nodes", "yd_nodes", "ydd_nodes")

    def __init__(self, legs: Legs, *, as_stated: bool = False) -> None:
        """`as_stated`: by the description, whatever the effects."""
        self.legs, self.repeats, self.as_stated = legs, legs.samples, as_stated
        self.memory = {"legs": Memory((legs.leg.size, 6)), "pose": Memory((6,))}
        self.structure = (legs.servo, legs.stewart, legs.leg.steps)

    def parameters(self, p: LoopParameters, bodies: Bodies) -> dict[str, Array]:
        change = 0.0 if self.as_stated else 1.0
        return {"gain": 1 + change * p.bandwidth, "brake": 1 + change * p.damping}

    def step(self, p: Values, x: Values, u: Values) -> Stepped:
        y_cmd = u["command_received"][:, :6]
        gains = p["gain"][:, None], p["brake"][:, None]
        legs, pose, *path = self.legs.advance(x["legs"], x["pose"], y_cmd, *gains)
        memory = {"legs": legs, "pose": pose}
        return memory, {**dict(zip(self.stacked, path, strict=True)), **memory}

    def start(self, p: Values, u: Values) -> Stepped:
        pose = u["X"][:, :6]  # hydraulic legs start from rest, whatever rate the vehicle has
        memory = {"legs": self.legs.at_rest(pose), "pose": pose}
        return memory, memory

    def present(self, x: Values) -> tuple[Array, Array]:
        """Pose and rate (n, 6) that the legs have now."""
        return self.legs.present(x["legs"], x["pose"])


class LegSensors(Block):
    """The path of a platform on legs, and its pose by the measured lengths."""

    name = "leg_sensors"
    inputs = ("y_nodes", "yd_nodes", "ydd_nodes", "legs", "pose")
    outputs = ("y", "yd", "ydd", "y_measured")

    def __init__(self, legs: Legs) -> None:
        self.legs = legs
        self.structure = (legs.servo, legs.stewart)

    def step(self, p: Values, x: Values, u: Values) -> Stepped:
        last = (u["pose"], *self.legs.motion(u["legs"], u["pose"]))
        out = {
            name: np.concatenate([u[f"{name}_nodes"], end[:, None]], axis=1)
            for name, end in zip(("y", "yd", "ydd"), last, strict=True)
        }
        return {}, {**out, "y_measured": self.legs.measured(u["legs"], u["pose"])}

    def start(self, p: Values, u: Values) -> Stepped:
        return {}, {"y_measured": self.legs.measured(u["legs"], u["pose"])}


class EngineInput(Block):
    """Accelerations that bring the engine's platform onto the path, and keep it there.

    The engine runs the accelerations linearly through each step. What that and its own
    rounding leave of Y and Y' at the end of the period is taken out by a correction that is
    linear over the period.
    """

    name = "engine_input"
    inputs = ("y", "yd", "ydd", "y_engine", "yd_engine")
    outputs = ("acceleration",)

    def __init__(self, shape: LoopShape) -> None:
        self.shape, k, h = shape, shape.nodes - 1, shape.physics_dt
        self._duration = k * h
        # where the engine would be at the end: exact integrals of a piecewise linear Y''
        self._once = np.full(k + 1, h)
        self._once[[0, -1]] = h / 2
        self._twice = h * h * np.arange(k, -1.0, -1.0)
        self._twice[0], self._twice[-1] = h * h * (k / 2 - 1 / 6), h * h / 6
        self._clock = np.arange(k + 1)[:, None] * h

    def step(self, p: Values, x: Values, u: Values) -> Stepped:
        t, ydd, rate = self._duration, u["ydd"], u["yd_engine"]
        miss = u["y"][:, -1] - (u["y_engine"] + t * rate + np.matmul(self._twice, ydd))
        miss_rate = u["yd"][:, -1] - (rate + np.matmul(self._once, ydd))
        slope = (6 * miss_rate * t - 12 * miss) / t**3
        start = miss_rate / t - slope * t / 2
        return {}, {"acceleration": ydd + start[:, None] + slope[:, None] * self._clock}
