"""What an action means: from numbers in [-1, 1] to the drive of the joints.

Every control keeps the motion the servos follow (`Scene.ref`). Its acceleration runs
linearly through a control period, so that commands are continuous.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar, Protocol

import numpy as np

from ves_gym._util.params import (
    Array,
    ParameterError,
    Vector,
    finite,
    require_one_of,
    require_positive,
    unit,
)
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.kinematics import frames, tool_motions
from ves_gym.mechanics.servo import FREE, OWN_GAINS, JointServo, own_gains
from ves_gym.system.system import System

if TYPE_CHECKING:
    from ves_gym.simulation.simulator import Simulator

CONTROLS: dict[str, type[Control]] = {}


class Moving(Protocol):
    """Measured and reference state that a control reads and moves on: part of `Scene`."""

    time: Array
    q: Array
    v: Array
    ref: Array
    goal: Array
    tau: Array
    kp: Array
    kd: Array


@dataclass(frozen=True, kw_only=True)
class Control:
    """Base of all controls."""

    REGISTRY: ClassVar[dict[str, type[Control]]] = CONTROLS
    kind: ClassVar[str]
    level: ClassVar[str]
    drives: ClassVar[tuple[str, ...]] = ("motor",)
    per_joint: ClassVar[bool] = True  # an action has a number for every joint, or more
    held: ClassVar[bool] = False  # commands are held over a period, and do not run linearly
    # Set in a class whose `command` is a formula of its arguments alone, a simulation per row:
    # the kernel then compiles it (`Task.compiled`).
    compiled: ClassVar[bool] = False

    @property
    def servo(self) -> JointServo:
        """Gains of the joint motors."""
        return OWN_GAINS

    def servo_for(self, system: System) -> JointServo:
        """Return the gains of the motors of an arm on its base.

        Args:
            system: arm and vehicle.

        Raises:
            ParameterError: gains for another number of joints.
        """
        return self.servo.for_arm(system.arm, system.vehicle)

    def width(self, arm: Arm) -> int:
        """Numbers in an action."""
        return arm.n

    def check(self, system: System) -> None:
        """Raise ParameterError where the control does not fit a system."""
        if system.drive not in self.drives:
            kinds = " or ".join(self.drives)
            raise ParameterError(f"control {self.kind} needs drive {kinds}, got {system.drive}")
        if system.drive == "motor":
            try:
                self.servo_for(system)
            except ParameterError as error:
                raise ParameterError(f"control {self.kind}: {error}") from None

    def drive(
        self,
        sim: Simulator,
        s: Moving,
        action: Array,
        remaining: Array,
        follow: Callable[[], Array],
    ) -> None:
        """Run one control period: the command held, or linear from the last one.

        Args:
            sim: the simulations.
            s: as in `command`, and so is the rest.
        """
        start = s.tau
        self.command(s, action, sim.system.arm, sim.system.control_dt, remaining, follow)
        if self.level == "gains":
            sim.set_gains(s.kp, s.kd)
        if self.held:
            sim.step(s.tau)
        else:
            sim.step(start, until=s.tau)

    def command(
        self,
        s: Moving,
        action: Array,
        arm: Arm,
        dt: float,
        remaining: Array,
        follow: Callable[[], Array],
    ) -> None:
        """Set the command at the end of a period, `s.tau`: that of the moved reference.

        Args:
            s: measured and reference state, written.
            action: (n, width) in [-1, 1].
            arm: whose joints.
            dt: control period [s].
            remaining: (n,) s until the deadline, before the period.
            follow: drive command (n, joints) that follows the reference as it is then.
        """
        self.advance(s, action, arm, dt, remaining)
        if self.level != "torque":
            s.tau = follow()

    def advance(self, s: Moving, action: Array, arm: Arm, dt: float, remaining: Array) -> None:
        """Move the reference on by one period, or set gains or torque."""

    def coasting(self, s: Moving, arm: Arm, dt: float) -> Array:
        """Return the action (n, width) that leaves the reference to itself: zero, mostly.

        Args:
            s: reference state.
            arm: whose joints.
            dt: control period [s].
        """
        return np.zeros((len(s.q), self.width(arm)))


def _file(cls: type[Control]) -> type[Control]:
    CONTROLS[cls.kind] = cls
    return cls


def _ramp(s: Moving, a: Array, dt: float) -> None:
    """Move the reference on while its acceleration runs linearly to a."""
    q, v, before = s.ref.swapaxes(0, 1)
    jerk = (a - before) / dt
    q = q + dt * (v + dt * (before / 2 + jerk * (dt / 6)))
    s.ref = np.stack([q, v + dt * (before + a) / 2, a], axis=1)


@_file
@dataclass(frozen=True, kw_only=True)
class Guided(Control):
    """A jerk on top of the quintic that still reaches the goal in time; zero = straight line.

    At every period the reference is led from where it is to rest at the goal at the
    deadline by the quintic through both ends; the action adds `jerk` times itself. In the
    last two periods it adds nothing, so that any policy arrives. The first numbers of the
    task's goal must be the goal's joint angles.
    """

    kind: ClassVar[str] = "guided"
    level: ClassVar[str] = "reference"
    drives: ClassVar[tuple[str, ...]] = ("motor", "prescribed")
    compiled: ClassVar[bool] = True
    jerk: float = unit("rad/s^3", default=400.0)

    def __post_init__(self) -> None:
        require_positive(self, "jerk")

    def advance(self, s: Moving, action: Array, arm: Arm, dt: float, remaining: Array) -> None:
        periods = np.floor(remaining / dt + 0.5)  # whole periods
        moved = guided(s.ref, s.goal[:, : arm.n], np.maximum(periods, 1.0) * dt, dt)
        free = np.where(periods > 2.5, self.jerk, 0.0)[:, None] * action
        s.ref = moved + _pushed(dt) * free[:, None]


def guided(ref: Array, goal: Array, T: Array, dt: float, rate: Array | float = 0.0) -> Array:
    """Return the reference one period on, on the quintic to the goal and no acceleration there.

    q(t) = q + v t + a t^2/2 + c3 t^3 + c4 t^4 + c5 t^5.

    Args:
        ref: (n, 3, joints) angle, rate and acceleration [rad, rad/s, rad/s^2].
        goal: (n, joints) angles at the deadline [rad].
        T: (n,) until the deadline [s].
        dt: period [s].
        rate: (n, joints) at the deadline [rad/s].

    Returns:
        (n, 3, joints).
    """
    q, v, a = ref.swapaxes(0, 1)
    T = T[:, None]
    gap, slope, bend = goal - q - T * (v + T * a / 2), T * (rate - v - T * a), -T * T * a
    c3 = (10 * gap - 4 * slope + bend / 2) / T**3
    c4 = (-15 * gap + 7 * slope - bend) / T**4
    c5 = (6 * gap - 3 * slope + bend / 2) / T**5
    rows = (
        q + dt * (v + dt * (a / 2 + dt * (c3 + dt * (c4 + dt * c5)))),
        v + dt * (a + dt * (3 * c3 + dt * (4 * c4 + dt * 5 * c5))),
        a + dt * (6 * c3 + dt * (12 * c4 + dt * 20 * c5)),
    )
    return np.stack(rows, axis=1)


def _pushed(dt: float) -> Array:
    """(3, 1) what a jerk of one adds to q, v, a over a period."""
    return np.array([[dt**3 / 6], [dt * dt / 2], [dt]])


@dataclass(frozen=True, kw_only=True)
class SmoothReference(Control):
    """Base of controls that move a reference of bounded rate and acceleration.

    The reference brakes before joint limits. What an action asks for is a joint rate at the
    period's end, see `asked`.
    """

    level: ClassVar[str] = "reference"
    drives: ClassVar[tuple[str, ...]] = ("motor", "prescribed")
    a_max: Vector | None = unit("rad/s^2", default=None)  # None: the arm's own

    def check(self, system: System) -> None:
        """See `Control`; one a_max > 0 per joint."""
        super().check(system)
        if self.a_max is None:
            return
        name = f"{type(self).__name__}.a_max"
        if not (finite(self.a_max, (system.arm.n,), name) > 0).all():
            raise ParameterError(f"{name} must be > 0 rad/s^2, got {self.a_max}")

    def limits(self, arm: Arm) -> Array:
        """Return the largest acceleration of every joint (joints,) [rad/s^2]."""
        return arm.column("a_max") if self.a_max is None else np.asarray(self.a_max, float)

    def asked(self, s: Moving, action: Array, arm: Arm, dt: float, rate: Array) -> Array:
        """Return the joint rates (n, joints) that an action asks for [rad/s].

        Args:
            s: reference state.
            action: (n, width) in [-1, 1].
            arm: whose joints.
            dt: control period [s].
            rate: (n, joints) at the period's end if the acceleration ran to zero [rad/s].
        """
        raise NotImplementedError

    def advance(self, s: Moving, action: Array, arm: Arm, dt: float, remaining: Array) -> None:
        most = self.limits(arm)
        q, v, a = s.ref.swapaxes(0, 1)
        # Angle and rate if the acceleration ran to zero within this period. Whatever the
        # acceleration b at its end: angle' = angle + rate dt, rate' = rate + b dt.
        angle, rate = q - a * (dt * dt / 6), v + a * (dt / 2)
        spare = 0.3 * most * dt * dt  # the ramp's share of the angle, and the last partial step
        ahead = angle + rate * dt
        up = _stoppable(arm.column("q_max") - spare - ahead, most, dt)
        down = _stoppable(ahead - arm.column("q_min") - spare, most, dt)
        fast = arm.column("v_max")
        low, high = -np.minimum(down, fast), np.minimum(up, fast)
        speed = np.clip(self.asked(s, action, arm, dt, rate), low, high)
        _ramp(s, np.clip((speed - rate) / dt, -most, most), dt)


@_file
@dataclass(frozen=True, kw_only=True)
class Acceleration(SmoothReference):
    """Acceleration of the reference, a fraction of `a_max`; it brakes before joint limits."""

    kind: ClassVar[str] = "acceleration"
    compiled: ClassVar[bool] = True

    def asked(self, s: Moving, action: Array, arm: Arm, dt: float, rate: Array) -> Array:
        return rate + action * self.limits(arm) * dt


@_file
@dataclass(frozen=True, kw_only=True)
class JointVelocity(SmoothReference):
    """Rates of the reference, a fraction `speed` of the joints' own; `a_max` bounds changes."""

    kind: ClassVar[str] = "joint_velocity"
    compiled: ClassVar[bool] = True
    speed: float = unit("1", default=1.0)

    def __post_init__(self) -> None:
        require_positive(self, "speed")

    def asked(self, s: Moving, action: Array, arm: Arm, dt: float, rate: Array) -> Array:
        return action * (self.speed * arm.column("v_max"))

    def coasting(self, s: Moving, arm: Arm, dt: float) -> Array:
        """See `Control`: the rate that there will be."""
        _, v, a = s.ref.swapaxes(0, 1)
        return (v + a * (dt / 2)) / (self.speed * arm.column("v_max"))


@_file
@dataclass(frozen=True, kw_only=True)
class ToolVelocity(SmoothReference):
    """Velocity of the tool along the base's axes, +-1 = `speed`, by damped least squares.

    Joint rates J^T (J J^T + damping^2 I)^-1 v of the reference's Jacobian J (Wampler, IEEE
    Trans. Systems, Man, and Cybernetics 16(1), 1986), all slowed alike where one would pass
    its limit, so that the direction stays. It does not take back what the base does.
    """

    kind: ClassVar[str] = "tool_velocity"
    compiled: ClassVar[bool] = True
    per_joint: ClassVar[bool] = False
    speed: float = unit("m/s", default=0.5)
    damping: float = unit("m/rad", default=0.05)

    def __post_init__(self) -> None:
        require_positive(self, "speed", "damping")

    def width(self, arm: Arm) -> int:
        """Three, along x, y and z."""
        return 3

    def asked(self, s: Moving, action: Array, arm: Arm, dt: float, rate: Array) -> Array:
        across = tool_motions(arm, frames(arm, s.ref[:, 0]))[..., :3]
        J = np.swapaxes(across, -1, -2)
        load = np.linalg.solve(
            J @ across + self.damping**2 * np.eye(3), self.speed * action[..., None]
        )
        rates = (across @ load)[..., 0]
        most = (np.abs(rates) / arm.column("v_max")).max(axis=1)[:, None]
        return rates / np.maximum(most, 1.0)


def _stoppable(room: Array, most: Array, dt: float) -> Array:
    """Rate from which steps of dt at the deceleration `most` end within the room."""
    half = dt / 2
    root = np.sqrt(half * half + 2 * np.maximum(room, 0.0) / most)
    return most * (root - half)


@_file
@dataclass(frozen=True, kw_only=True)
class Target(Control):
    """Joint positions the servo is sent to, moving by at most `speed` of the arm's v_max."""

    kind: ClassVar[str] = "pd_target"
    level: ClassVar[str] = "reference"
    compiled: ClassVar[bool] = True
    speed: float = unit("1", default=1.0)

    def __post_init__(self) -> None:
        require_positive(self, "speed")

    def advance(self, s: Moving, action: Array, arm: Arm, dt: float, remaining: Array) -> None:
        step = self.speed * arm.column("v_max") * action * dt
        before = s.ref[:, 0]
        moved: Array = np.clip(before + step, arm.column("q_min"), arm.column("q_max"))
        s.ref = np.stack([moved, (moved - before) / dt, np.zeros_like(moved)], axis=1)


@_file
@dataclass(frozen=True, kw_only=True)
class Torque(Control):
    """Motor torque, held over the period; 1 is `fraction` of the motor's limit."""

    kind: ClassVar[str] = "torque"
    level: ClassVar[str] = "torque"
    held: ClassVar[bool] = True
    compiled: ClassVar[bool] = True
    fraction: float = unit("1", default=1.0)
    damping: Vector | None = unit("N m s/rad", default=None)  # None: none

    def __post_init__(self) -> None:
        require_positive(self, "fraction")

    @property
    def servo(self) -> JointServo:
        """Bare torque, or torque on top of joint damping."""
        if self.damping is None:
            return FREE
        return JointServo(kp=(0.0,) * len(self.damping), kd=self.damping, feedforward=False)

    def servo_for(self, system: System) -> JointServo:
        if self.damping is None:
            none = (0.0,) * system.arm.n
            return JointServo(kp=none, kd=none, feedforward=False)
        return self.servo.for_arm(system.arm, system.vehicle)

    def advance(self, s: Moving, action: Array, arm: Arm, dt: float, remaining: Array) -> None:
        s.tau = self.torque(action, arm)

    def torque(self, action: Array, arm: Arm) -> Array:
        """(n, joints) [N m]."""
        return self.fraction * arm.column("tau_max") * action


@_file
@dataclass(frozen=True, kw_only=True)
class Gains(Control):
    """Gains of the joint servos around the configuration held; -1 to 1 spans low to high.

    An action is (kp of every joint, kd of every joint), on a logarithmic scale.
    """

    kind: ClassVar[str] = "pd_gains"
    level: ClassVar[str] = "gains"
    held: ClassVar[bool] = True
    compiled: ClassVar[bool] = True
    kp: tuple[float, float] = unit("N m/rad", default=(10.0, 4000.0))
    kd: tuple[float, float] = unit("N m s/rad", default=(5.0, 200.0))

    def __post_init__(self) -> None:
        for name in ("kp", "kd"):
            low, high = getattr(self, name)
            if not 0 < low < high:
                raise ParameterError(f"Gains.{name} must be 0 < low < high, got {low}, {high}")

    def width(self, arm: Arm) -> int:
        """Numbers in an action."""
        return 2 * arm.n

    def advance(self, s: Moving, action: Array, arm: Arm, dt: float, remaining: Array) -> None:
        s.kp, s.kd = self.gains(action)

    def gains(self, action: Array) -> tuple[Array, Array]:
        """kp, kd (n, joints)."""
        n = action.shape[1] // 2
        out = []
        for (low, high), part in ((self.kp, action[:, :n]), (self.kd, action[:, n:])):
            out.append(low * (high / low) ** ((part + 1) / 2))
        return out[0], out[1]


def get_control(name: str) -> Control:
    """A control of default settings by name."""
    require_one_of("control", name, CONTROLS)
    return CONTROLS[name]()


def for_system(control: Control, system: System) -> Control:
    """Return a task's default control for an arm of another number of joints.

    Accelerations are then the arm's own, and damping is that of its own gains.

    Args:
        control: the default.
        system: arm and vehicle.
    """
    if isinstance(control, SmoothReference) and control.a_max is not None:
        return control if len(control.a_max) == system.arm.n else replace(control, a_max=None)
    if not isinstance(control, Torque) or control.damping is None:
        return control
    if len(control.damping) == system.arm.n:
        return control
    return replace(control, damping=own_gains(system.arm, system.vehicle).kd)
