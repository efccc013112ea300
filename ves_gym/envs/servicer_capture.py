"""Catch a tumbling satellite with a free-flying servicer, and bring both to rest."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from ves_gym._util.params import Array, Mask, ParameterError, Vector, finite, unit
from ves_gym.envs.arm_task import ArmTask, directions, gap
from ves_gym.envs.base_control import BaseControl, wheels_of
from ves_gym.envs.control import Acceleration, Control
from ves_gym.envs.task import Field, Scene, Start, register_task
from ves_gym.mechanics.arm_library import get_arm
from ves_gym.mechanics.attitude import from_matrix, log, rotate
from ves_gym.mechanics.kinematics import joint_positions, pose_dexterity, tool_frame
from ves_gym.mechanics.latch import BODY, LatchTarget, named
from ves_gym.mechanics.link import Inertial, Mount, diagonal
from ves_gym.mechanics.payload import Payload
from ves_gym.mechanics.spatial import cross, matvec, rotation, twist
from ves_gym.mechanics.vehicle import SERVICER_FLEXIBLE, Satellite
from ves_gym.simulation.capture import fly
from ves_gym.simulation.machines import LEAVE
from ves_gym.system.system import System

if TYPE_CHECKING:
    from ves_gym.simulation.simulator import Simulator

_TRIES = 32  # candidate meetings per episode; the first that is clear and dexterous counts
_JOINTS = 6  # fewer cannot take a fixture as it turns
_LEVER = 0.3  # m per radian, of turn beside place in `dexterous`
_FLIGHT = 200  # steps of the target's motion back from the meeting: below 1e-9 rad in all
_MORE = 5  # numbers drawn beside joint angles: time, mass, spin and its direction

_MEETING = 11  # first column of the goal that tells of it

_BOTH = BaseControl()
_EDGES = (0.9, 0.7, 0.8)  # m


def _box(mass: float) -> tuple[tuple[float, ...], ...]:
    a, b, c = (k * k for k in _EDGES)
    return diagonal(*(mass / 12 * k for k in (b + c, c + a, a + b)))


CLIENT = Payload(
    inertial=Inertial(mass=120.0, com=(0.0, 0.0, 0.0), inertia=_box(120.0)),
    grip=Mount(position=(0.0, 0.0, -0.5)),
    latch_distance=0.02,
    latch_angle=float(np.deg2rad(5.0)),
    size=_EDGES,
    source="this project: a homogeneous box of 0.9 x 0.7 x 0.8 m, its mass drawn anew",
)
SERVICER = replace(
    SERVICER_FLEXIBLE, pointing=None, source=f"{SERVICER_FLEXIBLE.source}, no pointing law"
)


@register_task("servicer_capture")
class ServicerCapture(ArmTask):
    """Catch a tumbling satellite with a free-flying servicer, and bring both to rest.

    The target is a free rigid body: its centre of mass rests, and it tumbles. The latch closes
    by itself once the tool is within its reach of the grapple fixture (2 cm and 5 deg, the
    tool's axes along the fixture's). It must be slower against it than `catch` and turn slower
    than `catch_turn`. That is an exact inelastic impulse. From then on the last link carries
    the target, and arm and wheels take over its angular momentum. Wheels store it; jets remove
    it, for propellant.

    Solved: the target has been carried for the last `hold` seconds. Meanwhile it and the base
    turned slower than `rest` in space, the joints slower than `settled`. The base's attitude
    was within `pointing` of that of the start, and no wheel stored more than the share `full`.

    Drawn: where the arm starts, and a meeting at a time in `meet`. Then the fixture is at the
    tool's pose of joint angles from zero +- `span` that are `dexterous`. The target is beyond
    the tool, clear of the base, and turns about any axis at a rate in `spin`; its state at the
    start follows by flying back. Its mass is drawn between the ends of `mass` on a logarithmic
    scale, its inertia in proportion. Neither is observed: servo, feed-forward and energies E
    know the arm alone.

    Cost:

    - What is missing at the end, between 1 and a half until the target is carried
      (`arm_task.gap` of distance and turn), then down to nothing as target, base and joints
      come to rest.
    - `turn` times the mean angle of the base.
    - `energy` times the mean of its energy E.
    - `fuel` times the propellant.

    The vehicle is `servicer-flexible` without its pointing law. With
    `vehicle="servicer-flexible"` and `base_control=None` the law commands wheels and jets, and
    the action is the joints' alone.

    Only in mode ideal: nothing tumbles in the laboratory, and the platform emulates neither
    wheels nor jets.
    """

    options: ClassVar[tuple[str, ...]] = ("q",)
    compiled: ClassVar[bool] = True
    interacts: ClassVar[bool] = True
    memory: ClassVar[int] = 1  # s, at rest so far
    rows: ClassVar[int] = 1 + _TRIES
    more: ClassVar[int] = _MORE
    controls: ClassVar[tuple[str, ...]] = (
        "acceleration", "joint_velocity", "pd_target", "torque",
    )  # fmt: skip
    positive: ClassVar[tuple[str, ...]] = (
        "dexterous", "away", "catch", "catch_turn", "rest", "settled", "pointing", "full",
        "hold", "tumbled", "far",
    )  # fmt: skip
    not_negative: ClassVar[tuple[str, ...]] = ("turn", "energy", "fuel")
    system: System = System(
        arm=get_arm("puma560-wrist"),
        vehicle=SERVICER,
        physics_dt=10e-3,  # states after 5 s differ by 6e-6 from those of steps of 1.25 ms
        control_dt=50e-3,
        payload=CLIENT,
    )
    control: Control = Acceleration()
    base_control: BaseControl | None = _BOTH
    duration: float = unit("s", default=30.0)
    tail: float = unit("s", default=0.0)
    span: Vector = unit(
        "rad", default=tuple(np.deg2rad([120.0, 60.0, 120.0, 90.0, 80.0, 120.0]).tolist())
    )
    meet: Vector = unit("s", default=(8.0, 12.0))  # from, to
    mass: Vector = unit("kg", default=(60.0, 200.0))  # from, to
    spin: Vector = unit("rad/s", default=(0.05, 0.12))  # from, to
    dexterous: float = unit("m/rad", default=0.05)  # least `tool_pose.pose_dexterity`
    away: float = unit("m", default=0.9)  # least, from the tool's start to the target's centre
    catch: float = unit("m/s", default=0.03)  # of the tool against the fixture, at most
    catch_turn: float = unit("rad/s", default=0.05)  # of the tool against the fixture, at most
    rest: float = unit("rad/s", default=2e-3)  # of target and base in space
    settled: float = unit("rad/s", default=0.01)  # of each joint
    pointing: float = unit("rad", default=float(np.deg2rad(1.0)))  # of the base
    full: float = unit("1", default=0.9)  # share of what a wheel can store
    hold: float = unit("s", default=2.0)
    tumbled: float = unit("rad", default=float(np.deg2rad(45.0)))  # angle of the base: failed
    far: float = unit("m", default=2.0)  # distance that counts as one
    turn: float = unit("1/rad", default=10.0)
    energy: float = unit("1/J", default=3.0)
    fuel: float = unit("1/kg", default=3.0)

    @property
    def tumbles(self) -> bool:
        return self.tumbled > LEAVE

    def __post_init__(self) -> None:
        super().__post_init__()
        system = self.system
        if system.mode != "ideal":
            raise ParameterError(
                f"{self.kind} needs mode ideal, got {system.mode}: in the laboratory a stand"
                " holds the target, which tumbles freely here"
            )
        if not isinstance(system.vehicle, Satellite):
            raise ParameterError(
                f"{self.kind} needs a satellite as its vehicle, got {system.vehicle.kind}"
            )
        if system.payload is None:
            raise ParameterError(
                f"{self.kind} needs a system with a payload, such as system.replace(payload="
                "ves_gym.envs.servicer_capture.CLIENT), got one without"
            )
        if system.arm.n < _JOINTS:
            raise ParameterError(
                f"{self.kind} needs an arm of {_JOINTS} joints or more, which can follow a"
                f" fixture that turns, got {system.arm.name} with {system.arm.n}"
            )
        for name in ("meet", "mass", "spin"):
            low, high = finite(getattr(self, name), (2,), f"{type(self).__name__}.{name}")
            if not 0 < low <= high:
                raise ParameterError(
                    f"{self.kind}.{name} must be 0 < from <= to, got {low:g} to {high:g}"
                )

    # ------------------------------------------------------------------ episodes

    def start(self, u: Array, **options: Array) -> Start:
        """See `Task`.

        Goal: the target's place (3) [m], attitude (4), spin in its own axes (3) [rad/s] and
        mass [kg] at the start; joint angles (joints) [rad] and time [s] of the meeting.
        """
        q, meeting = self._meeting(u, options.get("q"))
        drawn, k = u[:, -_MORE:], len(u)
        clock = self.meet[0] + (self.meet[1] - self.meet[0]) * drawn[:, 0]
        mass = self.mass[0] * (self.mass[1] / self.mass[0]) ** drawn[:, 1]
        fast = self.spin[0] + (self.spin[1] - self.spin[0]) * drawn[:, 2]
        place, turn = tool_frame(self.system.arm, meeting)
        grip, centre = self._fixture
        turn = turn @ grip.T
        attitude, spin = from_matrix(turn), fast[:, None] * directions(drawn[:, 3:])
        inertia = np.tile(self._shape, (k, 1, 1))
        attitude, spin = _flown(attitude, spin, inertia, -clock)
        at = place + matvec(turn, centre)  # of the centre of mass, which rests
        goal = [at, attitude, spin, mass, meeting, clock]
        return Start(q, np.column_stack(goal))

    @cached_property
    def _fixture(self) -> tuple[Array, Array]:
        """Axes (3, 3) of the fixture, and from it to the centre of mass (3,) [m]."""
        payload = self.system.payload
        assert payload is not None
        to_centre = np.array(payload.inertial.com) - np.array(payload.grip.position)
        return payload.grip.rotation, to_centre

    @cached_property
    def _shape(self) -> Array:
        """(3, 3) inertia of the target per mass [m^2]."""
        payload = self.system.payload
        assert payload is not None
        return np.array(payload.inertial.inertia) / payload.inertial.mass

    def _meeting(self, u: Array, q: Array | None) -> tuple[Array, Array]:
        """Joint angles (k, joints) at the start (q, if given) and at the meeting [rad]."""
        arm, payload, rows = self.system.arm, self.system.payload, np.arange(len(u))
        assert payload is not None
        angles = self.angles(u)
        q, ends = angles[:, 0] if q is None else q, angles[:, 1:]
        place, turn = tool_frame(arm, ends)
        grip, to_centre = self._fixture
        centre = place + matvec(turn @ grip.T, np.broadcast_to(to_centre, place.shape))
        shoulder = joint_positions(arm, ends)[..., 1, :]
        beyond = np.linalg.norm(centre - shoulder, axis=-1)
        beyond -= np.linalg.norm(place - shoulder, axis=-1)
        size = np.linalg.norm(payload.edges) / 2
        tool = joint_positions(arm, q)[:, None, -1]
        able = pose_dexterity(arm, ends, _LEVER)
        good = (able >= self.dexterous) & (centre[..., 2] >= size)
        good &= beyond >= np.linalg.norm(to_centre) / 2
        good &= np.linalg.norm(centre - tool, axis=-1) >= self.away
        pick = np.where(good.any(axis=1), good.argmax(axis=1), able.argmax(axis=1))
        return q, ends[rows, pick]

    def payload(self, goal: Array) -> dict[str, Array]:
        """See `Task`. The target begins to fly."""
        payload = self.system.payload
        assert payload is not None
        com = np.array(payload.inertial.com)
        mass, attitude = goal[:, 10], goal[:, 3:7]
        return {
            "mass": mass,
            "inertia": mass[:, None, None] * self._shape,
            "position": goal[:, :3] - rotate(attitude, np.broadcast_to(com, (len(goal), 3))),
            "attitude": attitude,
            "velocity": np.zeros((len(goal), 3)),
            "spin": goal[:, 7:10],
        }

    def closes(self, s: Scene) -> Mask:
        t = LatchTarget.of(s.payload)
        slow = np.linalg.norm(t.relative[:, :3], axis=1) <= self.catch
        slow = slow & (np.linalg.norm(t.relative[:, 3:], axis=1) <= self.catch_turn)
        return slow & (t.reached > 0) & (t.carried == 0)

    def _missing(self, t: LatchTarget) -> Array:
        """(n, 3) rotation vectors from the tool to the fixture [rad]."""
        grip, _ = self._fixture
        return log(from_matrix(t.turn @ grip @ np.swapaxes(t.tool, -1, -2)))

    @cached_property
    def _fastest(self) -> Array:
        """(w,) speeds of the wheels when they are full [rad/s]."""
        return np.array([wheel.speed_max for wheel in wheels_of(self.system)])

    def remember(self, s: Scene, dt: float) -> None:
        t = LatchTarget.of(s.payload)
        still = (t.carried > 0) & (np.abs(s.v) <= self.settled).all(axis=1)
        still &= np.linalg.norm(t.spin, axis=1) <= self.rest
        still &= np.linalg.norm(twist(s.y, s.yd)[:, 3:], axis=1) <= self.rest
        still &= _angle(s) <= self.pointing
        if len(self._fastest):
            still &= (np.abs(s.wheels / self._fastest) <= self.full).all(axis=1)
        s.memory[:, 0] = np.where(still, s.memory[:, 0] + dt, 0.0)

    def success(self, s: Scene) -> Mask:
        """Target, arm and base have come to rest together, and the base points as it did."""
        return s.memory[:, 0] >= self.hold - 1e-9

    def failed(self, s: Scene) -> Mask:
        """The base has turned by more than `tumbled`, or a joint limit is broken."""
        return super().failed(s) | (_angle(s) > self.tumbled)

    def step_info(self, sim: Simulator, ended: Mask) -> dict[str, Any]:
        cargo = sim.payload
        assert cargo is not None
        info: dict[str, Any] = {"capture/carried": cargo.carried.copy()}
        ids, n = np.flatnonzero(ended), len(ended)
        if len(ids):
            lost, momentum, energy = np.zeros(n), np.zeros((n, 6)), np.zeros(n)
            with np.errstate(all="ignore"):  # of what diverged
                momentum[ids], *energies = cargo.ledger(ids)
            energy[ids] = sum(energies)
            lost[ids] = [sum(event.lost for event in k) for k in cargo.history[ids]]
            at_end = {"lost": lost, "momentum": momentum, "energy": energy}
            for name, values in at_end.items():
                info |= {f"capture/{name}": values, f"_capture/{name}": ended}
        return info

    # --------------------------------------------------------------- observation

    def fields(self) -> tuple[Field, ...]:
        w = len(self._fastest)
        wheels = [Field("wheels", "1", np.ones(w), "speed of each wheel in its largest")] * (
            w > 0
        )
        return (
            *self.sensed(base=(np.full(6, 0.2), np.full(6, 0.02))),
            *wheels,
            Field("to_fixture", "m", np.full(3, self.far / 2), "fixture less tool"),
            Field("to_turn", "rad", np.full(3, np.pi), "rotation from the tool to the fixture"),
            Field("closing", "m/s", np.full(3, 0.1), "of the tool against the fixture"),
            Field("turning", "rad/s", np.full(3, 0.2), "of the tool against the fixture"),
            Field("target_spin", "rad/s", np.full(3, self.spin[1]), "of the target"),
            Field("centre", "m", np.full(3, 0.5), "from the fixture to the target's centre"),
            Field("carried", "1", np.ones(1), "whether the latch holds the target"),
            Field("held", "1", np.ones(1), "share of `hold` that all has been at rest"),
            self.time_left,
        )

    def observe(self, s: Scene) -> tuple[Array, ...]:
        """See `Task`. What is of tool and target is in the base's axes."""
        t, to_base = LatchTarget.of(s.payload), np.swapaxes(rotation(s.y_seen), -1, -2)
        free = t.carried[:, None] == 0
        # of the target where the tool is, and then where its fixture is
        closing = t.relative[:, :3] + cross(t.spin, s.tool - t.fixture)
        wheels = [s.wheels / self._fastest] if len(self._fastest) else []
        vectors = (
            t.fixture - s.tool_seen,
            self._missing(t),
            np.where(free, closing, 0.0),
            np.where(free, t.relative[:, 3:], 0.0),
            t.spin,
            t.centre - t.fixture,
        )
        return (
            *self.sense(s),
            *wheels,
            *(matvec(to_base, part) for part in vectors),
            np.where(free, 0.0, 1.0),
            s.memory / self.hold,
            self.left(s),
        )

    # -------------------------------------------------------------------- reward

    def costs(self, s: Scene, dt: float, last: Mask) -> dict[str, Array]:
        share = dt / self.duration
        return {
            "turn": share * self.turn * _angle(s),
            "energy": share * self.energy * s.energy,
            "fuel": np.where(last, self.fuel * s.propellant, 0.0),
        }

    def missing(self, s: Scene) -> Array | None:
        t, payload = LatchTarget.of(s.payload), self.system.payload
        assert payload is not None
        assert payload.latch_angle is not None
        way, turned = np.linalg.norm(t.fixture - s.tool, axis=1), self._missing(t)
        distance = gap(way, payload.latch_distance, self.far)
        turn = gap(np.linalg.norm(turned, axis=1), payload.latch_angle, np.pi)
        speeds = (
            gap(np.linalg.norm(t.spin, axis=1), self.rest, self.spin[1]),
            gap(np.linalg.norm(twist(s.y, s.yd)[:, 3:], axis=1), self.rest, self.spin[1]),
            gap(np.linalg.norm(s.v, axis=1), self.settled, 1.0),
        )
        return np.where(t.carried > 0, sum(speeds) / 3, 1.0 + (distance + turn) / 2) / 2

    def marker(self, s: Scene) -> Array:
        """The fixture."""
        return LatchTarget.of(s.payload).fixture[:, None]


def meeting(s: Scene, joints: int) -> tuple[Array, Array]:
    """Return joint angles (n, joints) [rad] and times (n,) [s] of the meetings drawn.

    Args:
        s: every simulation of the task.
        joints: of the arm.
    """
    return s.goal[:, _MEETING : _MEETING + joints], s.goal[:, _MEETING + joints]


def _angle(s: Scene) -> Array:
    """(n,) angle by which the base has turned since the start [rad]."""
    return np.linalg.norm(log(from_matrix(rotation(s.y))), axis=1)


def _flown(attitude: Array, spin: Array, inertia: Array, time: Array) -> tuple[Array, Array]:
    """Attitude and spin of free bodies after a time (k,) of their own [s]."""
    still, step = np.zeros((len(time), 3)), time[:, None] / _FLIGHT
    bodies = np.hstack([still, attitude, still, spin])
    after = named(fly(bodies, still, inertia, np.repeat(step, _FLIGHT, axis=1)), BODY)
    return after["attitude"], after["spin"]
