"""The latch: an exact inelastic impulse between tool and grapple fixture.

Forces between two bodies that meet are large and short. In the limit the positions stand
still, every finite force (springs, dampers, motors) drops out, and what is left is linear:
M (z'+ - z'-) = -J^T p for the arm with its base, M_t (v+ - v-) = X^T p for the target, and
S^T (J z'+ - X v+) = 0 along the directions S that close (docs/physics.md).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import Array, ParameterError
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.attitude import from_matrix, log, rotate, to_matrix, torque_free_step
from ves_gym.mechanics.base_model import BaseModel
from ves_gym.mechanics.carried import carried_inertia
from ves_gym.mechanics.dynamics import inertia
from ves_gym.mechanics.kinematics import ToolState, tool_frame, tool_state, tool_twists
from ves_gym.mechanics.spatial import cross, matvec, rate_matrix, rotation, skew

DIRECTIONS = ("x", "y", "z", "about_x", "about_y", "about_z")  # of a relative twist


class Impulse(NamedTuple):
    """Impulse of a latch and its effect. Leading axes = simulation."""

    rates: Array  # (..., N) of the arm with its base after it
    twist: Array  # (..., 6) of the target's centre of mass after it, inertial axes
    impulse: Array  # (..., 6) on the target at the fixture, inertial axes [N s, N m s]
    lost: Array  # (...,) energy lost, in closed form [J]
    relative: Array  # (..., 6) twist of the tool against the fixture before it


def inelastic(
    mass: Array,
    rates: Array,
    J: Array,
    body_mass: Array,
    twist: Array,
    X: Array,
    closed: npt.ArrayLike | None = None,
    prescribed: Sequence[int] = (),
) -> Impulse:
    """Close a latch.

    The impulse p = L S^T dV, L = (S^T (J M^-1 J^T + X M_t^-1 X^T) S)^-1, takes the relative
    twist dV along S away and with it the energy 1/2 (S^T dV)^T L (S^T dV).

    Args:
        mass, rates: (..., N, N) of the arm with its base, and (..., N) before.
        J: (..., 6, N) twist of the tool, inertial axes, linear part first.
        body_mass: (..., 6, 6) of the target about its centre of mass, inertial axes.
        twist: (..., 6) of that point before [m/s, rad/s].
        X: (..., 6, 6) from it to the twist at the fixture.
        closed: (6, k) or (..., 6, k) directions S, None for all six.
        prescribed: coordinates whose rates no impulse changes.
    """
    S = np.eye(6) if closed is None else np.asarray(closed, float)
    relative = matvec(J, rates) - matvec(X, twist)
    Jt, Xt, St = (np.swapaxes(part, -1, -2) for part in (J, X, S))
    arm = response(mass, Jt, prescribed)
    body: Array = np.asarray(np.linalg.solve(body_mass, Xt), np.float64)
    compliance = St @ (J @ arm + X @ body) @ S
    gap = matvec(np.broadcast_to(St, (*relative.shape[:-1], *St.shape[-2:])), relative)
    force = np.linalg.solve(compliance, gap[..., None])[..., 0]
    impulse: Array = np.asarray((S @ force[..., None])[..., 0], np.float64)
    return Impulse(
        rates - matvec(arm, impulse),
        twist + matvec(body, impulse),
        impulse,
        0.5 * np.sum(gap * force, axis=-1),
        relative,
    )


def response(mass: Array, impulse: Array, prescribed: Sequence[int] = ()) -> Array:
    """Return the change of the rates by impulses (..., N, k) on each coordinate of a mass (...,
    N, N); prescribed coordinates keep theirs."""
    free = np.setdiff1d(np.arange(mass.shape[-1]), prescribed)
    out = np.zeros(impulse.shape)
    out[..., free, :] = np.linalg.solve(mass[..., free[:, None], free], impulse[..., free, :])
    return out


def directions_of(names: object) -> Array | None:
    """Return some of `DIRECTIONS` by name as (6, k) independent columns, or numbers (6, k) as
    they are; None stands for all six."""
    if names is None:
        return None
    if isinstance(names, (list, tuple)) and all(isinstance(k, str) for k in names):
        if not names or len(set(names)) < len(names) or not set(names) <= set(DIRECTIONS):
            raise ParameterError(
                f"directions must be some of {', '.join(DIRECTIONS)}, each once, got {names!r}"
            )
        return np.eye(6)[:, [DIRECTIONS.index(str(k)) for k in names]]
    columns = np.asarray(names)
    numeric = columns.dtype.kind in "fiu" and columns.ndim == 2 and columns.shape[0] == 6
    if not numeric or not 1 <= np.linalg.matrix_rank(columns) == columns.shape[1]:
        raise ParameterError(
            f"directions must be names or independent columns (6, k), got {names!r}"
        )
    return columns.astype(np.float64)


def tool_in_space(arm: Arm, y: Array, base: Array, q: Array, v: Array) -> ToolState:
    """Return pose and twist of the tool in inertial axes, of base pose y and twist (n, 6) in
    its own axes, angles and rates (n, joints) of the links."""
    tool, R = tool_state(arm, q, v, base), rotation(y)
    motion = [matvec(R, tool.twist[:, :3]), matvec(R, tool.twist[:, 3:])]
    return ToolState(
        y[:, :3] + matvec(R, tool.place), R @ tool.turn, np.concatenate(motion, axis=1)
    )


class LatchTarget(NamedTuple):
    """A payload beside the tool: in space, inertial axes. Leading axis = simulation."""

    carried: Array  # (n,) 1 or 0
    reached: Array  # (n,) 1 where the tool is within the latch's reach of the fixture
    distance: Array  # (n,) from the tool to the fixture [m]
    angle: Array  # (n,) between their axes [rad]
    fixture: Array  # (n, 3) [m]
    centre: Array  # (n, 3) of mass [m]
    velocity: Array  # (n, 3) of it [m/s]
    spin: Array  # (n, 3) [rad/s]
    relative: Array  # (n, 6) twist of the tool against the fixture, at the tool
    turn: Array  # (n, 3, 3) from the payload's axes
    tool: Array  # (n, 3, 3) from the tool's axes

    def rows(self) -> Array:
        """(n, `TARGET`) all of it side by side."""
        return np.concatenate([k.reshape(len(k), -1) for k in self], axis=1)

    @staticmethod
    def of(rows: Array) -> LatchTarget:
        """Return what lies in rows (n, `TARGET`)."""
        parts = np.split(rows, np.cumsum(_WIDTHS)[:-1], axis=1)
        turns = [k.reshape(len(k), 3, 3) for k in parts[9:]]
        return LatchTarget(*(k[:, 0] for k in parts[:4]), *parts[4:9], *turns)

    @property
    def fixture_velocity(self) -> Array:
        """(n, 3) [m/s]."""
        return self.velocity + cross(self.spin, self.fixture - self.centre)


_WIDTHS = (1, 1, 1, 1, 3, 3, 3, 3, 6, 9, 9)  # of the fields of a `LatchTarget`, in rows
TARGET = sum(_WIDTHS)


BODY = {"position": 3, "attitude": 4, "velocity": 3, "spin": 3}  # of a free payload, in rows
# what else tells of a payload, in rows
NUMBERS = {
    "com": 3, "inertia": 9, "carried": 1, "place": 3, "turn": 9, "grip": 3, "grip_axes": 9,
    "latch_distance": 1, "latch_angle": 1,
}  # fmt: skip


def named(rows: Array, widths: Mapping[str, int]) -> dict[str, Array]:
    """Return the parts of rows (n, k) by name."""
    parts = np.split(rows, np.cumsum(list(widths.values()))[:-1], axis=1)
    return dict(zip(widths, parts, strict=True))


def flown(rows: Array, com: Array, inertia: Array, time: Array) -> Array:
    """Return free payloads a step later: straight, and turning as free bodies do.

    Rows (n, k) of `BODY`, centres of mass (n, 3) in own axes [m], inertia (n, 9) about them and
    steps (n, 1) [s], of which one of zero leaves a body where it is, to the bit.
    """
    body, J = named(rows, BODY), inertia.reshape(len(rows), 3, 3)
    centre = body["position"] + rotate(body["attitude"], com) + time * body["velocity"]
    q, w = torque_free_step(body["attitude"], body["spin"], J, time)
    moved = [centre - rotate(q, com), q, body["velocity"], w]
    return np.where(time != 0.0, np.concatenate(moved, axis=1), rows)


def target(tool: ToolState, axes: Array, body: Mapping[str, Array]) -> LatchTarget:
    """Return where a payload is, free or carried, as seen from the tool in space, inertial
    axes.

    `axes` (3, 3) are from the tool's to the last link's; `body` is (n, k) of what `BODY` and
    `NUMBERS` name: the motion of a free payload; its pose in the last link's frame where it is
    carried; com and grip in its own axes.
    """
    turned, grip = (body[k].reshape(len(tool.place), 3, 3) for k in ("turn", "grip_axes"))
    carried, link = body["carried"] > 0, tool.turn @ axes.T
    turn = np.where(carried[..., None], link @ turned, to_matrix(body["attitude"]))
    origin = np.where(carried, tool.place + matvec(link, body["place"]), body["position"])
    centre = origin + matvec(turn, body["com"])
    linear, angular = tool.twist[:, :3], tool.twist[:, 3:]
    with_tool = linear + cross(angular, centre - tool.place)
    velocity = np.where(carried, with_tool, body["velocity"])
    spin = np.where(carried, angular, matvec(turn, body["spin"]))
    fixture = origin + matvec(turn, body["grip"])
    distance = np.linalg.norm(fixture - tool.place, axis=1)
    away = log(from_matrix(np.swapaxes(turn @ grip, -1, -2) @ tool.turn))
    angle = np.linalg.norm(away, axis=1)
    reached = distance <= body["latch_distance"][:, 0]
    reached = reached & (angle <= body["latch_angle"][:, 0])
    there = velocity + cross(spin, tool.place - centre)  # of the payload where the tool is
    relative = np.concatenate([linear - there, angular - spin], axis=1)
    return LatchTarget(
        body["carried"][:, 0], reached, distance, angle, fixture, centre, velocity, spin,
        relative, turn, tool.turn,
    )  # fmt: skip


class ToolMotion(NamedTuple):
    """Tool and mass matrix of an arm with its base, by the rates (base twist, q', gears')."""

    place: Array  # (..., 3) of the tool in space [m]
    turn: Array  # (..., 3, 3) from the last link's axes to the inertial ones
    J: Array  # (..., 6, N) twist of the tool, inertial axes
    mass: Array  # (..., N, N)


def tool_motion(arm: Arm, base: BaseModel, y: Array, q: Array, hidden: Array) -> ToolMotion:
    """Return tool, Jacobian and mass matrix, gears, wheels and appendages as coordinates.

    The base's rate is its twist in its own axes, which has no singular attitude. Internal modes
    of the base are masses of their own that springs hold (`InternalModes`): no impulse reaches
    them. Wheels and appendages of a satellite take their share of one. At base pose y (..., 6),
    angles q (..., n) of rotors, and hidden (..., g + c) deflections of gears, by which the
    links turn further, and coordinates of wheels and appendages.
    """
    n, g, c = arm.n, len(arm.geared), len(base.carried)
    angles = q.copy()
    angles[..., list(arm.geared)] += hidden[..., :g]
    R = rotation(y)
    place, turn = tool_frame(arm, angles)
    # rates of the rotors and gears to those of the links
    P = np.eye(6 + n, 6 + n + g + c)
    for k, i in enumerate(arm.geared):
        P[6 + i, 6 + n + k] = 1.0
    driven = np.zeros(6 + n + g + c)
    driven[6 : 6 + n] = arm.column("rotor_inertia")
    H = inertia(arm, angles) - np.diag(driven[: 6 + n])
    if base.body is not None:
        H[..., :6, :6] += base.body.spatial()
    if base.M.any():
        T = np.linalg.inv(rate_matrix(y))
        H[..., :6, :6] += np.swapaxes(T, -1, -2) @ base.M @ T
    mass = P.T @ H @ P + np.diag(driven)
    if c:
        locked, across, joints = carried_inertia(base.carried, hidden[..., g:])
        mass[..., :6, :6] += locked
        mass[..., :6, -c:] += across
        mass[..., -c:, :6] += np.swapaxes(across, -1, -2)
        mass[..., -c:, -c:] += joints[..., None] * np.eye(c)

    local = np.zeros((*y.shape[:-1], 6, 6 + n))
    local[..., :3, :3] = local[..., 3:, 3:6] = np.eye(3)
    local[..., :3, 3:6] = -skew(place)
    local[..., 6:] = tool_twists(arm, angles)
    world = np.zeros((*y.shape[:-1], 6, 6))
    world[..., :3, :3] = world[..., 3:, 3:] = R
    link = R @ turn @ arm.tool_rotation.T
    return ToolMotion(y[..., :3] + matvec(R, place), link, world @ local @ P, mass)


def base_jump(
    arm: Arm,
    base: BaseModel,
    y: Array,
    q: Array,
    impulse: Array,
    prescribed: Sequence[int] = (),
) -> Array:
    """Return the twist (..., 6) that an impulse (..., 6) on what the tool holds, inertial axes,
    leaves in the base, its axes; see `tool_motion`, gears relaxed, and `inelastic`."""
    hidden = np.zeros((*q.shape[:-1], len(arm.geared) + len(base.carried)))
    at = tool_motion(arm, base, y, q, hidden)
    push = -np.einsum("...ij,...i->...j", at.J, impulse)
    return response(at.mass, push[..., None], prescribed)[..., :6, 0]


def free_mass(mass: Array, inertia: Array, turn: Array) -> Array:
    """Return a free body's mass matrix about its centre of mass, inertial axes (..., 6, 6), of
    mass (...,), inertia (..., 3, 3) in own axes and turn (..., 3, 3) from these."""
    M = np.zeros((*np.shape(mass), 6, 6))
    M[..., :3, :3] = np.asarray(mass)[..., None, None] * np.eye(3)
    M[..., 3:, 3:] = turn @ inertia @ np.swapaxes(turn, -1, -2)
    return M


def to_point(com: Array, at: Array) -> Array:
    """Return X (..., 6, 6) from a rigid body's twist at `com` to that at another point (...,
    3)."""
    X = np.zeros((*com.shape[:-1], 6, 6))
    X[..., :3, :3] = X[..., 3:, 3:] = np.eye(3)
    X[..., :3, 3:] = -skew(at - com)
    return X


def body_momentum(mass: Array, twist: Array, com: Array) -> Array:
    """Return linear and angular momentum of a free body about the inertial origin, of mass
    (..., 6, 6) about its centre `com` (..., 3) and twist (..., 6) there, inertial axes."""
    out = matvec(mass, twist)
    out[..., 3:] += np.cross(com, out[..., :3])
    return out
