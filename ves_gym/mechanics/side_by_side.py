"""Several arms on one base as one `Arm`: their joints one arm after the other.

The arm that works comes last, so that its tool is the tool.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ves_gym._util.params import ParameterError, Vector, finite
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.chain import Lump
from ves_gym.mechanics.link import BANDWIDTH, Limb, Link, Mount

_SAME = 1e-6  # m between first joints, below which both belong to one link


def placed(arm: Arm, position: Vector, angles: Vector = (0.0, 0.0, 0.0)) -> Arm:
    """Return one arm elsewhere on the base, its base link with it, see `Arm.at`."""
    arm.require_alone("Arm.at")
    arm.require_rigid("Arm.at")
    finite(position, (3,), "position")
    R, p = Mount(angles=tuple(angles)).rotation, np.array(position, float)
    followers = tuple(
        replace(k, mount=(k.mount or Mount()).placed(R, p)) if k.on == -1 else k
        for k in arm.followers or ()
    )
    return replace(
        arm,
        base=arm.base.placed(R, p),
        base_shape=arm.base_shape and tuple(k.placed(R, p) for k in arm.base_shape),
        base_meshes=arm.base_meshes and tuple(k.placed(R, p) for k in arm.base_meshes),
        mount=(arm.mount or Mount()).placed(R, p),
        followers=followers or None,
    )


def side_by_side(arms: Sequence[Arm]) -> Arm:
    """Return one arm of several on one base, each where it stands (`Arm.at`): joints in their
    order, the last one's tool. Refused: none, two that share a link, arms that bend or are
    several."""
    arms = tuple(arms)
    for arm in arms:
        if not isinstance(arm, Arm):
            raise ParameterError(f"arms must be of Arm, got {arm!r}")
        arm.require_alone("each of several arms")
        arm.require_rigid("each of several arms")
        arm.require_uncoupled("each of several arms")
    if not arms:
        raise ParameterError("arms must hold at least one arm, got none")
    if len(arms) == 1:
        return arms[0]
    names = _names(arms)
    _require_apart(arms, names)
    root = Lump()
    for arm in arms:
        root.add_body(arm.base)
    shapes = [arm.base_shape for arm in arms if arm.base_shape is not None]
    limbs = [
        Limb(name=name, joints=arm.n, mount=arm.mount, tool_angle=arm.tool_angle)
        for name, arm in zip(names, arms, strict=True)
    ]
    bandwidths = {arm.bandwidth for arm in arms}
    slowest = min(arm.bandwidth or BANDWIDTH for arm in arms)
    return replace(
        arms[-1],
        name=" + ".join(arm.name for arm in arms),
        base=root.inertial(np.eye(3), np.zeros(3)),
        base_shape=tuple(itertools.chain(*shapes)) if shapes else None,
        base_meshes=tuple(k for arm in arms for k in arm.base_meshes or ()) or None,
        beside=tuple(limbs[:-1]),
        links=_links(arms, names),
        bandwidth=slowest if len(bandwidths) > 1 else arms[-1].bandwidth,
        source="; ".join(dict.fromkeys(arm.source for arm in arms)),
    )


def _links(arms: Sequence[Arm], names: Sequence[str]) -> tuple[Link, ...]:
    """Links of all; joints of one name are distinguished by their arm's."""
    counts = Counter(link.name for arm in arms for link in arm.links if link.name)
    return tuple(
        replace(link, name=f"{name}/{link.name}")
        if link.name and counts[link.name] > 1
        else link
        for name, arm in zip(names, arms, strict=True)
        for link in arm.links
    )


def _names(arms: Sequence[Arm]) -> list[str]:
    """Names of the arms, with numbers where two are alike."""
    counts = Counter(arm.name for arm in arms)
    return [
        f"{arm.name}-{k}" if counts[arm.name] > 1 else arm.name for k, arm in enumerate(arms, 1)
    ]


def _require_apart(arms: Sequence[Arm], names: Sequence[str]) -> None:
    """Refuse arms whose first joints are in one place: they would have a link in common."""
    feet = [arm.feet[0].position for arm in arms]
    for i, j in itertools.combinations(range(len(arms)), 2):
        if math.dist(feet[i], feet[j]) < _SAME:
            raise ParameterError(
                f"arms must stand apart, but {names[i]} and {names[j]} share a link: the first"
                f" joints of both are at {feet[i].tolist()} m; move one, Arm.at((0.5, 0, 0))"
            )
