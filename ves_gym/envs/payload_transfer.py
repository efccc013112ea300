"""Pick up a free-floating payload of unknown mass, carry it, and berth it at rest."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from ves_gym._util.params import Array, Mask, ParameterError, Vector, finite, unit
from ves_gym.envs.arm_task import ArmTask, braked, gap
from ves_gym.envs.control import Control, ToolVelocity
from ves_gym.envs.reach import reachable
from ves_gym.envs.task import Field, Scene, Start, register_task
from ves_gym.mechanics.attitude import from_angles, to_matrix
from ves_gym.mechanics.kinematics import joint_positions
from ves_gym.mechanics.latch import LatchTarget
from ves_gym.mechanics.link import Inertial, Mount, diagonal
from ves_gym.mechanics.payload import Payload
from ves_gym.mechanics.spatial import matvec, rotation
from ves_gym.mechanics.vehicle import BENT_THESIS
from ves_gym.system.system import System

_TRIES = 16  # candidates per place and episode; the first that is near and dexterous counts
_LEG = 0.35  # share of an episode that a straight motion of either leg takes

_BERTHED, _HELD = range(2)  # columns of the memory

BOX = Payload(
    inertial=Inertial(mass=8.0, com=(0.0, 0.0, 0.0), inertia=diagonal(0.12, 0.12, 0.12)),
    grip=Mount(position=(0.0, 0.0, -0.15)),
    latch_distance=0.02,
    size=(0.3, 0.3, 0.3),
    source="this project: a cube of 0.3 m, its mass drawn for every episode",
)


@register_task("payload_transfer")
class PayloadTransfer(ArmTask):
    """Fetch a floating payload of unknown mass and berth it at rest, on a base that sways.

    The payload floats at rest in space. The latch closes by itself once the tool is within its
    reach of the grapple fixture (2 cm) and slower against it than `catch`. That is an exact
    inelastic impulse, after which the last link carries the payload. The berth, a point fixed
    in space, takes it once the fixture has been within `tolerance` and slower than `rest` for
    `hold` seconds. The latch then opens, and the episode is solved.

    The mass is drawn between the ends of `mass` on a logarithmic scale, the centre of mass up
    to `off_centre` from the middle along each axis. Neither is observed: servo, feed-forward,
    energies E and gravity estimate know the arm alone. Angles of start, payload and berth are
    drawn as in task reach. Both legs are straight quintics of a third of the episode, within
    the speed limits and at least `away` long.

    Cost:

    - What is missing at the end, between 1 and a half until the payload is carried, then down
      to nothing until it is berthed (`arm_task.gap`, up to `far`). A speed counts as the way
      that it makes in `brake`.
    - `thrift` times E_mean over that expected of the two straight legs, at least a quarter of
      its median.

    Arms with slender wrists need lighter payloads (`mass`). In the laboratory a stand carries
    the payload until the latch closes. Then its weight, which the gravity estimate does not
    know, is emulated as a force of the arm on the base.
    """

    options: ClassVar[tuple[str, ...]] = ("q",)
    compiled: ClassVar[bool] = True
    memory: ClassVar[int] = 2
    interacts: ClassVar[bool] = True
    rows: ClassVar[int] = 1 + 2 * _TRIES
    more: ClassVar[int] = 4
    positive: ClassVar[tuple[str, ...]] = (
        "dexterous", "catch", "tolerance", "rest", "hold", "far", "off_centre", "away",
    )  # fmt: skip
    not_negative: ClassVar[tuple[str, ...]] = ("thrift", "brake")
    leg: ClassVar[float] = _LEG
    system: System = System(vehicle=BENT_THESIS, physics_dt=2.5e-3, payload=BOX)
    control: Control = ToolVelocity()
    duration: float = unit("s", default=10.0)
    tail: float = unit("s", default=0.0)
    span: Vector = unit("rad", default=tuple(np.deg2rad([120.0, 60.0, 120.0]).tolist()))
    dexterous: float = unit("m/rad", default=0.1)  # least `tool.dexterity` at both places
    away: float = unit("m", default=0.3)  # least length of either leg
    mass: Vector = unit("kg", default=(2.0, 20.0))  # from, to
    off_centre: float = unit("m", default=0.03)  # of the centre of mass, along each axis
    catch: float = unit("m/s", default=0.05)  # of the tool against the fixture, at most
    tolerance: float = unit("m", default=0.03)  # of the fixture from the berth
    rest: float = unit("m/s", default=0.05)  # of the fixture, at most
    hold: float = unit("s", default=0.5)
    far: float = unit("m", default=2.0)  # distance that counts as one
    brake: float = unit("s", default=0.3)
    thrift: float = unit("1", default=0.01)

    def __post_init__(self) -> None:
        super().__post_init__()
        low, high = finite(self.mass, (2,), "PayloadTransfer.mass")
        if not 0 < low <= high:
            raise ParameterError(f"{self.kind}.mass must be 0 < from <= to, got {self.mass} kg")
        if self.system.payload is None:
            raise ParameterError(
                f"{self.kind} needs a system with a payload, such as system.replace(payload="
                "ves_gym.envs.payload_transfer.BOX), got one without"
            )

    # ------------------------------------------------------------------ episodes

    def start(self, u: Array, **options: Array) -> Start:
        """See `Task`.

        Goal: fixture and berth (3, 3) [m], mass [kg], centre of mass (3) [m], scale [J].
        """
        arm, drawn = self.system.arm, u[:, -4:]
        q, pick, berth = self.places(u, options.get("q"))
        low, high = self.mass
        goal = [
            joint_positions(arm, pick)[:, -1],
            joint_positions(arm, berth)[:, -1],
            low * (high / low) ** drawn[:, 0],
            self.off_centre * (2 * drawn[:, 1:] - 1),
            self.scale_of(q, pick, berth),
        ]
        return Start(q, np.column_stack(goal))

    def places(self, u: Array, q: Array | None = None) -> tuple[Array, ...]:
        """Joint angles (k, joints) at the start, at the payload and at the berth [rad]."""
        arm, angles, leg = self.system.arm, self.angles(u), _LEG * self.duration
        q = angles[:, 0] if q is None else q
        limits = self.dexterous, self.away
        pick = reachable(arm, q, angles[:, 1 : 1 + _TRIES], leg, *limits)
        return q, pick, reachable(arm, pick, angles[:, 1 + _TRIES :], leg, *limits)

    def payload(self, goal: Array) -> dict[str, Array]:
        """See `Task`. The payload floats with its fixture at the goal's first point."""
        payload = self.system.payload
        assert payload is not None
        described, turn = payload.inertial, to_matrix(from_angles(payload.angles))
        share = goal[:, 6] / described.mass
        return {
            "mass": goal[:, 6],
            "com": np.array(described.com) + goal[:, 7:10],
            "inertia": share[:, None, None] * np.array(described.inertia),
            "position": goal[:, :3] - turn @ np.array(payload.grip.position),
        }

    def closes(self, s: Scene) -> Mask:
        t = LatchTarget.of(s.payload)
        slow = np.linalg.norm(t.relative[:, :3], axis=1) <= self.catch
        free: Mask = (t.carried == 0) & (s.memory[:, _BERTHED] == 0)
        return free & (t.reached > 0) & slow

    def remember(self, s: Scene, dt: float) -> None:
        """See `Task`. The berth takes the payload."""
        t, memory = LatchTarget.of(s.payload), s.memory
        off = np.linalg.norm(t.fixture - s.goal[:, 3:6], axis=1)
        there = (t.carried > 0) & (off <= self.tolerance)
        there = there & (np.linalg.norm(t.fixture_velocity, axis=1) <= self.rest)
        memory[:, _HELD] = np.where(there, memory[:, _HELD] + dt, 0.0)
        done = memory[:, _HELD] >= self.hold - 1e-9
        memory[:, _BERTHED] = np.where(done, 1.0, memory[:, _BERTHED])

    def opens(self, s: Scene) -> Mask:
        """See `Task`. The berth holds the payload."""
        carried: Mask = LatchTarget.of(s.payload).carried > 0
        return carried & self.success(s)

    def success(self, s: Scene) -> Mask:
        """The payload is in its berth."""
        return s.memory[:, _BERTHED] > 0

    # --------------------------------------------------------------- observation

    def fields(self) -> tuple[Field, ...]:
        reach = np.full(3, self.far / 2)
        return (
            *self.sensed(),
            Field("to_payload", "m", reach, "fixture less tool, in the base's axes"),
            Field("to_berth", "m", reach, "berth less fixture, in the base's axes"),
            Field("to_next", "m", np.full(3, 0.05), "the first until carried, then the second"),
            Field("closing", "m/s", np.full(3, 0.1), "of tool against fixture, then in space"),
            Field("carried", "1", np.ones(1), "whether the latch holds the payload"),
            Field("held", "1", np.ones(1), "share of `hold` that the berth has had it"),
            self.time_left,
        )

    def observe(self, s: Scene) -> tuple[Array, ...]:
        to_base = np.swapaxes(rotation(s.y_seen), -1, -2)
        t = LatchTarget.of(s.payload)
        ways = t.fixture - s.tool_seen, s.goal[:, 3:6] - t.fixture
        carried = t.carried[:, None] > 0
        _, closing = self._segment(s)
        return (
            *self.sense(s),
            *(matvec(to_base, k) for k in (*ways, np.where(carried, *ways[::-1]), closing)),
            np.where(carried, 1.0, 0.0),
            s.memory[:, _HELD, None] / self.hold,
            self.left(s),
        )

    def _segment(self, s: Scene) -> tuple[Array, Array]:
        """Way (n, 3) [m] that is left to the fixture, then to the berth, and its rate [m/s]."""
        t = LatchTarget.of(s.payload)
        carried = t.carried[:, None] > 0
        way = np.where(carried, s.goal[:, 3:6] - t.fixture, t.fixture - s.tool)
        return way, np.where(carried, t.fixture_velocity, t.relative[:, :3])

    # -------------------------------------------------------------------- reward

    def costs(self, s: Scene, dt: float, last: Mask) -> dict[str, Array]:
        return self.energy_costs(s, dt, s.goal[:, 10])

    def missing(self, s: Scene) -> Array | None:
        way, closing = self._segment(s)
        missing = gap(braked(way, closing, self.brake), self.tolerance, self.far)
        phase = np.where(LatchTarget.of(s.payload).carried > 0, missing, 1.0 + missing) / 2
        return np.where(s.memory[:, _BERTHED] > 0, 0.0, phase)

    def marker(self, s: Scene) -> Array:
        """The fixture, then the berth."""
        return np.stack([LatchTarget.of(s.payload).fixture, s.goal[:, 3:6]], axis=1)
