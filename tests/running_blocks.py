"""Single blocks of the emulation loop that keep their memory between calls."""

import copy
from types import SimpleNamespace

import numpy as np

from ves_gym.hardware.force_sensor import SensorErrors
from ves_gym.hardware.leg_servo import Legs
from ves_gym.hardware.platform import second_order
from ves_gym.simulation.blocks.block import LoopShape
from ves_gym.simulation.blocks.platform import LegSensors, LegServos, PosePlatform
from ves_gym.simulation.blocks.sensing import ForceSensorBlock
from ves_gym.simulation.blocks.wiring import Wiring


def shape_of(nodes):
    return LoopShape(len(nodes), 3, float(nodes[-1]), float(nodes[1]))


class Running:
    """A block, its parameters and its memory of n simulations."""

    def __init__(self, block, p, n):
        self.block, self.p, self.n = block, p, n
        self.x, self.signals = {}, {}

    def rows(self, ids):
        return {k: v[ids] for k, v in self.p.items()}

    def start(self, ids, u):
        x, signals = self.block.start(self.rows(ids), u)
        for mine, theirs in ((self.x, x), (self.signals, signals)):
            for name, rows in theirs.items():
                mine.setdefault(name, np.zeros((self.n, *rows.shape[1:])))
                mine[name] = mine[name].copy()
                mine[name][ids] = rows

    def step(self, u):
        self.x, signals = self.block.step(self.p, self.x, u)
        self.signals.update(signals)
        return signals

    def get_state(self):
        return copy.deepcopy((self.x, self.signals))

    def set_state(self, state):
        self.x, self.signals = copy.deepcopy(state)


class RunningPlatform(Running):
    """A platform, on pose servos or legs."""

    def reset(self, ids, y, yd=0.0):
        y = np.broadcast_to(y, (len(ids), 6))
        self.start(ids, {"X": np.concatenate([y, np.broadcast_to(yd, y.shape)], axis=-1)})

    def advance(self, y_cmd, yd_cmd=0.0):
        rate = np.broadcast_to(yd_cmd, np.shape(y_cmd))
        signals = self.step({"command_received": np.concatenate([y_cmd, rate], axis=-1)})
        return signals["y"], signals["yd"], signals["ydd"]

    def measured(self):
        return self.signals["y_measured"]

    @property
    def y(self):
        return self.x["y"]

    @property
    def yd(self):
        return self.x["yd"]


def pose_platform(servo, n, nodes, bandwidth=None, damping_ratio=None):
    """Platforms on a pose servo, with bandwidth [Hz] and damping ratio of their own."""
    w = 2 * np.pi * np.broadcast_to(servo.bandwidth if bandwidth is None else bandwidth, (n,))
    zeta = servo.damping_ratio if damping_ratio is None else damping_ratio
    response = second_order(w, np.broadcast_to(zeta, (n,)), nodes)
    out = RunningPlatform(PosePlatform(servo, shape_of(nodes)), {"response": response}, n)
    out.reset(np.arange(n), np.zeros((n, 6)))
    return out


def leg_platform(servo, stewart, n, control_dt, physics_dt):
    """Platforms on leg servos, at home."""
    out = RunningLegs(Legs(servo, stewart, control_dt, physics_dt), n)
    out.reset(np.arange(n), np.zeros((n, 6)))
    return out


class RunningLegs(RunningPlatform):
    """Leg servos and what measures them."""

    def __init__(self, legs, n):
        super().__init__(LegServos(legs), {"gain": np.ones(n), "brake": np.ones(n)}, n)
        self.sensors = LegSensors(legs)
        self.wiring = Wiring([self.block, self.sensors], [], ["command_received"])

    def reset(self, ids, y, yd=0.0):
        super().reset(ids, y, yd)
        self.signals.update(self.sensors.start({}, self.signals)[1])

    def step(self, u):
        x = {f"platform.{k}": v for k, v in self.x.items()}
        changed, signals = self.wiring.run(self.wiring.before, {"platform": self.p}, x, u)
        self.x = {k: changed[f"platform.{k}"] for k in self.x}
        self.signals.update(signals)
        return signals


class RunningSensor(Running):
    """n force sensors with errors, noise and drift drawn from n generators."""

    def __init__(self, sensor, errors: SensorErrors, nodes):
        n = len(errors.bias)
        self.errors = errors
        block = ForceSensorBlock(sensor, shape_of(nodes))
        super().__init__(block, block.parameters(SimpleNamespace(sensor=errors), None), n)

    def reset(self, ids, wrench, generators):
        noisy = self.errors.random()
        draws = [
            generators[i].standard_normal((6, 2)) if noisy[i] else np.zeros((6, 2))
            for i in ids.tolist()
        ]
        self.start(ids, {"true_weight": wrench, "start_draws": np.stack(draws)})

    def advance(self, nodes, generators):
        noisy = self.errors.random()
        draws = [
            g.standard_normal(18) if noisy[i] else np.zeros(18)
            for i, g in enumerate(generators)
        ]
        self.step({"wrench": nodes, "draws": np.stack(draws)})

    def signal(self):
        return self.block.signal(self.p, self.x)

    def reading(self):
        return self.block.reading(self.p, self.x)

    def zero_to(self, ids, wrench):
        x = {k: v[ids] for k, v in self.x.items()}
        self.x["zero"] = self.x["zero"].copy()
        self.x["zero"][ids] = self.block.zero_to(self.rows(ids), x, wrench)
