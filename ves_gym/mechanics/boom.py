"""Booms: chains of jointed, flexible members that carry an arm.

A member bends in hinges with springs (rigid finite elements): k in either plane at the k
Gauss-Legendre points of its length L, compliance w_i L / EI each, and one in torsion in its
middle, L / GJ. An end load's bending moment is linear along the member, so two hinges give a
tip's statics exactly; what is approximate is how the member's own mass takes part
(docs/physics.md, section 15; scripts/hinges_needed.py says how far).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import Array, ParameterError, Vector, finite, freeze_arrays, unit
from ves_gym._util.threads import on_one_thread
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.boom_member import (
    BoomJoint,
    BoomMember,
    Flange,
    Hinge,
    add_body,
    diameter,
    hinges_of,
    join,
    turned_lump,
)
from ves_gym.mechanics.chain import Joint, Lump, about_z, angles_of, arm_of, upright
from ves_gym.mechanics.craig_bampton import reduce
from ves_gym.mechanics.dynamics import frames
from ves_gym.mechanics.flexible_base import REACH, FlexibleBase, Reduced
from ves_gym.mechanics.flexure import unfold
from ves_gym.mechanics.serial_chain import Flexure, Inertial, Link, Mount, matrix

_SOFTEST = 1e-9  # of the flange's ways, in compliance over the largest: below it none
_EVENLY = 7  # points of a member that a picture shows


class _Pose(NamedTuple):
    """A boom at rest."""

    events: list[Hinge]  # joints and hinges in their order
    flange: Flange
    centreline: list[tuple[Array, int]]  # points along it (3,), and the events before each


@dataclass(frozen=True, kw_only=True)
class Boom:
    """Members one after the other from a fixed root; an arm stands on the flange at the tip.

    All lengths at zero, in the axes of its root.
    """

    name: str
    members: tuple[BoomMember, ...]
    flange: Vector = unit("rad", default=(0.0, 0.0, 0.0))  # its turn about x, then y, then z
    tip: Inertial | None = None  # a body at the tip, in the root's axes, from the tip
    bandwidth: float | None = unit("Hz", default=None)  # of the servos, see `own_gains`
    source: str

    def __post_init__(self) -> None:
        freeze_arrays(self)
        if not self.members:
            raise ParameterError("Boom.members must hold at least one, got none")

    @property
    def joints(self) -> tuple[BoomJoint, ...]:
        """All joints from the root outwards."""
        return tuple(joint for member in self.members for joint in member.joints)

    def carry(self, arm: Arm) -> Arm:
        """Return boom and arm as one arm: joints of both driven, members bending.

        Args:
            arm: stands on the flange.

        Raises:
            ParameterError: the boom has no joints (`braked` needs none).
        """
        if not self.joints:
            raise ParameterError(f"boom {self.name} has no joints to drive: use Boom.braked")
        events, flange, _ = self._pose(np.zeros(len(self.joints)))
        if events[0].joint is None:
            raise ParameterError(
                f"boom {self.name} must begin with a joint to be driven, got a member without"
            )
        add_body(events[-1].body, arm.base, flange)
        joints: list[Joint] = []
        within: list[list[Hinge]] = []
        for event in events:
            if event.joint is not None:
                joints.append(_joint(event, len(joints)))
                within.append([])
            else:
                join(joints[-1].body, event.body)
                within[-1].append(event)
        R, p = _mounted(arm, flange)
        chain = arm_of(self.name, Lump(), joints, (R, p), source=self.source)
        at = frames(chain, np.zeros(chain.n))
        links = []
        parts = chain.links, at.rotation, at.position, within
        for link, turn, place, hinges in zip(*parts, strict=True):
            flexures = tuple(_flexure(k, turn, place) for k in hinges)
            links.append(replace(link, flexures=flexures or None))
        first = replace(arm.links[0], offset=arm.links[0].offset + (chain.tool_angle or 0.0))
        return replace(
            arm,
            name=f"{self.name}-{arm.name}",
            base=chain.base,
            base_shape=None,
            mount=chain.mount,
            links=(*links, first, *arm.links[1:]),
            bandwidth=self.bandwidth or arm.bandwidth,
            source=f"{chain.source}; on it {arm.source}",
        )

    def braked(self, q: npt.ArrayLike, arm: Arm) -> Arm:
        """Return the arm on the boom, whose joints are on their brakes at q.

        A braked joint is a spring and a damper at its angle, as a hinge of a member is: all
        of the boom is a base link that bends.

        Args:
            q: (joints,) where the boom's joints stand [rad].
            arm: stands on the flange.
        """
        events, flange, _ = self._pose(q)
        add_body(events[-1].body, arm.base, flange)
        total = Lump()
        for event in events:
            join(total, event.body)
        R, p = _mounted(arm, flange)
        still = np.eye(3), np.zeros(3)
        return replace(
            arm,
            name=f"{self.name}-braked-{arm.name}",
            base=total.inertial(*still),
            base_shape=total.shape(*still),
            base_flexures=tuple(_flexure(k, *still) for k in events),
            mount=Mount(position=tuple(p.tolist()), angles=angles_of(R)),
            source=f"{self.source}; on it {arm.source}",
        )

    def reach(self, q: npt.ArrayLike) -> Flange:
        """Return where the flange is at rest.

        Args:
            q: (joints,) [rad].
        """
        return self._pose(q).flange

    @on_one_thread()
    def at(self, q: npt.ArrayLike, modes: int = 6, fastest: float = REACH) -> FlexibleBase:
        """Return the braked boom at q as a linear flexible base: flange and internal modes.

        The linear motion of all hinges and brakes, by Craig and Bampton's reduction to the
        flange's pose. In axes of the flange at rest; its root is fixed.

        Args:
            q: (joints,) where the joints stand [rad].
            modes: internal modes to keep, all where there are fewer.
            fastest: modes faster than this follow the flange [rad/s].

        Raises:
            ParameterError: the flange cannot move along some direction, as that of a straight
                boom along itself.
        """
        beam = unfold(self.braked(q, NOTHING))
        events, flange, centreline = self._pose(q)
        p = len(beam.passive)
        M = beam.inertia(np.zeros(1), np.zeros(p))[6 : 6 + p, 6 : 6 + p]
        K, D = np.diag(beam.stiffness), np.diag(beam.damping)
        back = flange.rotation.T  # to the axes of the flange at rest
        J = np.vstack(
            [back @ _ways(events, flange.position), back @ np.array([k.axis for k in events]).T]
        )
        compliance = (J / beam.stiffness) @ J.T
        size = np.sqrt(np.maximum(np.diag(compliance), 1e-300))
        values, vectors = np.linalg.eigh(compliance / np.outer(size, size))
        if p < 6 or values[0] < _SOFTEST:
            stiff = ", ".join(f"{k:.3g}" for k in vectors[:, 0])
            raise ParameterError(
                f"boom {self.name} at {np.round(np.rad2deg(np.asarray(q, float)), 1).tolist()}"
                f" deg holds its flange rigidly along ({stiff}) of (x, y, z, phi_x, phi_y,"
                " phi_z): a linear base needs all six to give; bend the boom, or simulate"
                " Boom.braked"
            )
        static = (J.T / beam.stiffness[:, None]) @ np.linalg.inv(compliance)
        null = np.linalg.svd(J)[2][6:].T
        T = np.hstack([static, null])
        parts = [T.T @ k @ T for k in (M, K, D)]
        M_z, K_z, D_z = ((k + k.T) / 2 for k in parts)
        reduction = reduce(M_z, K_z, np.arange(6), min(modes, p - 6), damping=D_z)
        moved = np.vstack([back @ _ways(events, at, n) for at, n in centreline]) @ T
        return FlexibleBase(
            structure=Reduced(
                K=matrix(reduction.K),
                M=matrix(reduction.M),
                coupling=matrix(reduction.coupling),
                omega=tuple(reduction.omega.tolist()),
                damping=matrix(reduction.damping if reduction.damping is not None else D_z),
                centreline=matrix(
                    np.array([at - flange.position for at, _ in centreline]) @ back.T
                ),
                static=matrix(moved @ reduction.static),
                shapes=matrix(moved @ reduction.shapes),
                diameter=max(diameter(member) for member in self.members),
            ),
            modes=reduction.m,
            fastest=fastest,
            source=f"{self.source}; joints on their brakes at"
            f" {np.round(np.rad2deg(np.asarray(q, float)), 1).tolist()} deg",
        )

    def _pose(self, q: npt.ArrayLike) -> _Pose:
        """The boom at rest with its joints at q."""
        angles = finite(q, (len(self.joints),), "q")
        events: list[Hinge] = []
        centreline, at = [(np.zeros(3), 0)], np.zeros(3)
        for member in self.members:
            before = len(events)
            events += hinges_of(member, at, events)
            way = np.array(member.vector)
            for share in np.arange(1, _EVENLY + 1) / _EVENLY:
                inner = [
                    k for k in events[before:] if (k.origin - at) @ way < share * way @ way
                ]
                centreline.append((at + share * way, before + len(inner)))
            at = at + way
        if self.tip is not None:
            add_body(events[-1].body, self.tip, Flange(np.eye(3), at))
        flange = Flange(Mount(angles=self.flange).rotation, at)
        places = [i for i, event in enumerate(events) if event.joint is not None]
        # outermost joint first, so that the inner axes are still where they are at zero
        for i, angle in reversed(list(zip(places, angles.tolist(), strict=True))):
            R, p = _about(events[i].axis, angle), events[i].origin
            events[i] = replace(events[i], body=turned_lump(events[i].body, R, p))
            events[i + 1 :] = [event.turned(R, p) for event in events[i + 1 :]]
            centreline = [(p + R @ (k - p), n) if n > i else (k, n) for k, n in centreline]
            flange = Flange(R @ flange.rotation, p + R @ (flange.position - p))
        return _Pose(events, flange, centreline)


def _ways(events: list[Hinge], point: Array, count: int | None = None) -> Array:
    """(3, p) ways of a point per angle of the joints and hinges, the first `count` of them."""
    out = np.zeros((3, len(events)))
    for k, event in enumerate(events[:count]):
        out[:, k] = np.cross(event.axis, point - event.origin)
    return out


def _flexure(event: Hinge, R: Array, p: Array) -> Flexure:
    """A joint or hinge as a passive joint in a frame of rotation R and position p."""
    axis = R.T @ event.axis
    return Flexure(
        origin=tuple((R.T @ (event.origin - p)).tolist()),
        axis=tuple((axis / np.linalg.norm(axis)).tolist()),
        stiffness=event.stiffness,
        damping=event.damping,
        beyond=event.body.inertial(R, p),
    )


def _joint(event: Hinge, number: int) -> Joint:
    """A joint as it is driven."""
    joint = event.joint
    assert joint is not None
    body = Lump()
    join(body, event.body)
    return Joint(
        name=joint.name or f"boom_{number + 1}",
        origin=event.origin,
        axis=event.axis,
        q_min=joint.q_min,
        q_max=joint.q_max,
        body=body,
        rotor_inertia=joint.rotor_inertia,
        v_max=joint.v_max,
        a_max=joint.a_max,
        tau_max=joint.tau_max,
    )


def _mounted(arm: Arm, flange: Flange) -> tuple[Array, Array]:
    """Rotation and position of an arm's first joint on a flange."""
    R, p = flange
    if arm.mount is None:
        return R, p
    return R @ arm.mount.rotation, p + R @ np.array(arm.mount.position)


def _about(axis: Array, angle: float) -> Array:
    """(3, 3) rotation about an axis of length 1."""
    to_z = upright(axis)
    out: Array = to_z @ about_z(angle) @ to_z.T
    return out


NOTHING = Arm(
    name="nothing",
    base=Inertial(mass=0.0, com=(0.0,) * 3, inertia=matrix(np.zeros((3, 3)))),
    links=(
        Link(
            d=0.0,
            a=0.0,
            alpha=0.0,
            inertial=Inertial(mass=0.0, com=(0.0,) * 3, inertia=matrix(np.zeros((3, 3)))),
            q_min=-1.0,
            q_max=1.0,
            v_max=1.0,
            a_max=1.0,
            tau_max=1.0,
        ),
    ),
    source="no arm",
)
