"""Laws of what is hidden, each richer than the textbook's one term.

Friction has bristles, Stribeck's fall and heat; gears have hardening springs and elastic stops.
Each law has one number that sets its size, `level` or alike; zero leaves the machine as it is.
"""

from dataclasses import dataclass, field

import numpy as np

from benchmarks.trial.arm import Array
from benchmarks.trial.hidden import Gear, Law

SLOW = 0.004  # rad/s, below which dry friction fades


@dataclass
class Friction(Law):
    """Dry friction of one joint: Stribeck's fall, bristles, and a level that falls with heat.

    Memory: the bristles' deflection as a share of the level, and heat [1].
    """

    joint_index: int
    level: float  # N m
    stiction: float = 0.0  # beyond the level, as a share of it
    fade: float = 0.08  # rad/s, Stribeck's speed
    heat: float = 0.05  # share of the level that is lost when warm
    warm: float = 20.0  # J that warm it up
    size: int = 2

    def joint(self, t: float, q: Array, v: Array, tau: Array, s: Array, ds: Array) -> Array:
        """Torque against the motion; bristles bend over 0.5 mrad."""
        j = self.joint_index
        speed = v[j]
        level = self.level * (1 + self.stiction * np.exp(-((speed / self.fade) ** 2)))
        level *= 1 - self.heat * (1 - np.exp(-s[1]))
        ds[0] = (speed - abs(speed) * s[0]) / 0.0005 if abs(speed) < 0.05 else 0.0
        if abs(speed) >= 0.05:  # bristles are bent to the end
            ds[0] = (np.sign(speed) - s[0]) * 100.0
        ds[1] = abs(level * speed) / self.warm
        out = np.zeros_like(v)
        out[j] = -level * s[0]
        return out


@dataclass
class Drag(Law):
    """Viscous friction that thins as the grease warms, with a cubic share."""

    joint_index: int
    level: float  # N m s/rad
    cubic: float = 0.08  # s^2/rad^2
    heat: float = 0.05
    warm: float = 20.0  # J
    size: int = 1

    def joint(self, t: float, q: Array, v: Array, tau: Array, s: Array, ds: Array) -> Array:
        """Torque in proportion to the rate, and a little more."""
        j, out = self.joint_index, np.zeros_like(v)
        torque = self.level * (1 - self.heat * (1 - np.exp(-s[0]))) * v[j]
        torque *= 1 + self.cubic * v[j] ** 2
        ds[0] = abs(torque * v[j]) / self.warm
        out[j] = -torque
        return out


@dataclass
class Uneven(Law):
    """Friction that is larger one way than the other."""

    joint_index: int
    level: float  # N m

    def joint(self, t: float, q: Array, v: Array, tau: Array, s: Array, ds: Array) -> Array:
        """Torque towards minus whichever way the joint turns."""
        out = np.zeros_like(v)
        out[self.joint_index] = -self.level * abs(np.tanh(v[self.joint_index] / 0.01))
        return out


@dataclass
class Loaded(Law):
    """Friction of teeth: a share of the torque that the motor gives."""

    joint_index: int
    level: float  # 1

    def joint(self, t: float, q: Array, v: Array, tau: Array, s: Array, ds: Array) -> Array:
        """Torque against the motion."""
        j, out = self.joint_index, np.zeros_like(v)
        out[j] = -self.level * np.hypot(tau[j], 0.2) * np.tanh(v[j] / 0.01)
        return out


@dataclass
class Ripple(Law):
    """Cogging with a second harmonic."""

    joint_index: int
    level: float  # N m
    cycles: float = 12.0
    phase: float = 0.0  # rad
    second: float = 0.15

    def joint(self, t: float, q: Array, v: Array, tau: Array, s: Array, ds: Array) -> Array:
        """Torque that repeats with the angle."""
        j, out = self.joint_index, np.zeros_like(v)
        angle = self.cycles * q[j] + self.phase
        out[j] = self.level * (np.sin(angle) + self.second * np.sin(2 * angle + 0.7))
        return out


@dataclass
class Gain(Law):
    """Drives that give more or less than they are told, each by its own share."""

    shares: Array  # (n,)

    def joint(self, t: float, q: Array, v: Array, tau: Array, s: Array, ds: Array) -> Array:
        """The torque beyond what is told."""
        return np.asarray(self.shares * tau)


@dataclass
class Offset(Law):
    """A torque that is always there."""

    joint_index: int
    level: float  # N m

    def joint(self, t: float, q: Array, v: Array, tau: Array, s: Array, ds: Array) -> Array:
        """The torque."""
        out = np.zeros_like(v)
        out[self.joint_index] = self.level
        return out


@dataclass
class Ceiling(Law):
    """A drive that gives no more than `ceiling`, with a rounded shoulder of 2 %."""

    joint_index: int
    ceiling: float  # N m

    def limit(self, tau: Array) -> Array:
        """What is left of the torque."""
        j, out = self.joint_index, tau.copy()
        x, width = abs(tau[j]), 0.02 * self.ceiling
        over = np.logaddexp(0.0, (x - self.ceiling) / width) * width
        out[j] = np.sign(tau[j]) * (x - over)
        return out


class Elastic(Gear):
    """A gear whose spring hardens as it is wound up."""

    def __init__(
        self, joint: int, rotor: float, compliance: float, ratio: float = 0.15
    ) -> None:
        super().__init__(joint, rotor)
        self.stiffness = 1 / compliance
        self.damping = 2 * ratio * np.sqrt(self.stiffness * rotor)

    def transfer(self, twist: float, rate: float) -> float:
        """Spring, a cubic share (5 % at 5 mrad) and a damper."""
        return self.stiffness * twist * (1 + 0.05 * (twist / 5e-3) ** 2) + self.damping * rate


class Play(Gear):
    """A gear with play: teeth meet on elastic stops, with a film of oil between."""

    def __init__(self, joint: int, rotor: float, gap: float) -> None:
        super().__init__(joint, rotor)
        self.gap = gap
        self.stiffness = 6.0e4 * max(rotor, 0.3)
        self.damping = 0.25 * np.sqrt(self.stiffness * rotor)
        self.soft = max(0.05 * gap, 2e-5)

    def transfer(self, twist: float, rate: float) -> float:
        """Soft shoulders at half the gap; the damper acts where teeth touch."""
        side = np.sign(twist) or 1.0
        x = (abs(twist) - self.gap / 2) / self.soft
        deep = self.soft * np.logaddexp(0.0, x)
        touch = 1 / (1 + np.exp(-np.clip(x, -40, 40)))
        return float(side * self.stiffness * deep + touch * self.damping * rate)


@dataclass
class AmplitudeDrag(Law):
    """A base whose damping grows with its speed."""

    axis: int
    level: float

    def force(self, y: Array, yd: Array) -> Array:
        """Force on the base (6,)."""
        out = np.zeros(6)
        out[self.axis] = -self.level * abs(yd[self.axis]) * yd[self.axis]
        return out

    def base(self, t: float, y: Array, yd: Array, s: Array, ds: Array) -> Array:
        """The same in space."""
        return self.force(y, yd)


@dataclass
class Rider(Law):
    """A mass on a spring that the base carries along one direction, of which nobody knows."""

    level: float  # kg
    frequency: float  # Hz
    direction: Array  # (3,), of unit length
    ratio: float = 0.02
    size: int = 2

    def base(self, t: float, y: Array, yd: Array, s: Array, ds: Array) -> Array:
        """Force of its spring, a little harder when far out."""
        w = 2 * np.pi * self.frequency
        far = s[0] - self.direction @ y[:3]
        pull = w**2 * far * (1 + (far / 0.05) ** 2) + 2 * self.ratio * w * (
            s[1] - self.direction @ yd[:3]
        )
        ds[:] = s[1], -pull
        out = np.zeros(6)
        out[:3] = self.level * pull * self.direction
        return out


# ---- of no library ------------------------------------------------------------------------


@dataclass
class Cable(Law):
    """A cable that is slack over part of the range, then pulls ever harder, and creaks."""

    joint_index: int
    level: float  # N m/rad^1.5
    slack: float = 0.15  # rad
    middle: float = 0.0  # rad

    def joint(self, t: float, q: Array, v: Array, tau: Array, s: Array, ds: Array) -> Array:
        """Torque back to the middle, with a loss where taut."""
        j, out = self.joint_index, np.zeros_like(v)
        far = q[j] - self.middle
        taut = max(abs(far) - self.slack, 0.0)
        out[j] = -self.level * taut**1.5 * (np.sign(far) + 0.3 * np.tanh(v[j] / 0.01))
        return out


@dataclass
class Detent(Law):
    """A magnet that catches the joint at two angles."""

    joint_index: int
    level: float  # N m
    places: Array = field(default_factory=lambda: np.array([-0.2, 0.35]))  # rad
    width: float = 0.05  # rad

    def joint(self, t: float, q: Array, v: Array, tau: Array, s: Array, ds: Array) -> Array:
        """Torque towards each place, largest `width` away from it."""
        j, out = self.joint_index, np.zeros_like(v)
        x = (q[j] - self.places) / self.width
        out[j] = -self.level * float(np.sum(x * np.exp((1 - x**2) / 2)))
        return out


@dataclass
class Patches(Law):
    """Dry friction in patches: its level depends on where the joint stands."""

    joint_index: int
    level: float  # N m
    cycles: float = 9.0
    phase: float = 0.0

    def joint(self, t: float, q: Array, v: Array, tau: Array, s: Array, ds: Array) -> Array:
        """Friction between a tenth of the level and all of it."""
        j, out = self.joint_index, np.zeros_like(v)
        share = 0.1 + 0.9 * max(np.sin(self.cycles * q[j] + self.phase), 0.0) ** 2
        out[j] = -self.level * share * np.tanh(v[j] / 0.01)
        return out


@dataclass
class Thermal(Law):
    """A drive whose torque constant falls with the root of the heat in its winding."""

    joint_index: int
    level: float  # share lost per root of (N m)^2 s
    size: int = 1

    def joint(self, t: float, q: Array, v: Array, tau: Array, s: Array, ds: Array) -> Array:
        """The torque that is lost."""
        j, out = self.joint_index, np.zeros_like(v)
        ds[0] = tau[j] ** 2 - s[0] / 15.0
        out[j] = -min(self.level * np.sqrt(max(s[0], 0.0)), 0.9) * tau[j]
        return out


@dataclass
class Hysteresis(Law):
    """A joint of the base's structure that slips: Bouc and Wen's law on one axis."""

    axis: int
    level: float  # N or N m
    slip: float = 0.002  # m or rad
    size: int = 1

    def base(self, t: float, y: Array, yd: Array, s: Array, ds: Array) -> Array:
        """Force of what sticks."""
        rate = yd[self.axis]
        ds[0] = (rate - 0.5 * abs(rate) * s[0] * abs(s[0]) - 0.5 * rate * s[0] ** 2) / self.slip
        out = np.zeros(6)
        out[self.axis] = -self.level * s[0]
        return out
