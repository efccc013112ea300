"""Joints of a chain that move, and those that follow them in proportion."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from ves_gym._util.params import Array, ParameterError
from ves_gym.mechanics.arm_tree import Coupled, Tie, Tree, held
from ves_gym.mechanics.chain import ENDLESS, Joint

_ROUND = 1e-12  # determinant of followers that follow each other, below which they are a ring


def coupled_joints(
    tree: Tree, root: str, chain: list[str], locked: Mapping[str, float]
) -> Coupled:
    """Return the joints of a chain that move and their followers; refuse what no arm has.

    Who holds a follower undoes its tie; it stands still where all that it follows does.
    """
    joints = {k.name: k for of in tree.joints.values() for k in of}
    on_chain = [joint for body in chain for joint in tree.joints[body]]
    loose = [k for k in on_chain if not k.fixed and k.name not in locked]
    ties = _ties(tree, root, {k.name for k in loose}, locked)
    free = [k for k in loose if k.name not in ties]
    n = len(free)
    rows = {k: np.zeros(n + 1) for k in joints}  # rates to the free ones, and where they are
    for name, row in rows.items():
        row[n] = locked.get(name, tree.rest(name))
    rows |= {joint.name: np.eye(n + 1)[k] for k, joint in enumerate(free)}
    rows |= _solved(tree, ties, rows)
    moving = {k: row[:n] for k, row in rows.items() if row[:n].any()}
    for tie in ties.values():
        if tie.bend:
            involved = [k for k in tie.ratios if k in moving or k in ties]
            _refuse(tie, involved, [tie.follower])
    for name in moving:
        if fault := joints[name].fault:
            raise ParameterError(fault)
    return Coupled(free, moving, {name: float(row[n]) for name, row in rows.items()})


def _ties(
    tree: Tree, root: str, loose: set[str], locked: Mapping[str, float]
) -> dict[str, Tie]:
    """Ties beyond the root by their followers; refuse those that cannot be satisfied.

    A follower off the chain of what is not there stands still.
    """
    joints = {k.name for of in tree.joints.values() for k in of}
    beyond = {k.name for body in tree.movers(root, set()) if body != root
              for k in tree.joints[body]}  # fmt: skip
    out: dict[str, Tie] = {}
    for tie in tree.ties:
        if math.isnan(tie.shift):  # by a tendon between sites
            involved = [k for k in (tie.follower, *tie.ratios) if k in loose]
            _refuse(tie, involved, involved)
            continue
        there = tie.ratios.keys() <= joints
        if tie.follower not in beyond or tie.follower in locked:
            continue
        if tie.follower in out or (not there and tie.follower in loose):
            what = "and follows others too" if there else "which is not there"
            raise ParameterError(f"{tie.what}, {what}: hold it ({held(tie.follower)})")
        if there:
            out[tie.follower] = tie
    return out


def _solved(tree: Tree, ties: Mapping[str, Tie], rows: Mapping[str, Array]) -> dict[str, Array]:
    """Rows of followers from those of all others: rates to the free joints, and where they
    are."""
    names = list(ties)
    if not names:
        return {}
    among = np.eye(len(names))  # followers less what they follow of each other = what is known
    constants = np.zeros((len(names), len(next(iter(rows.values())))))
    for i, tie in enumerate(ties.values()):
        constants[i, -1] = tie.shift
        if tie.bend:  # of what stands still; else refused
            way = sum(k * (rows[j][-1] - tree.rest(j)) for j, k in tie.bend[1].items())
            constants[i, -1] += np.polyval([*tie.bend[0][::-1], 0.0, 0.0], way)
        for leader, ratio in tie.ratios.items():
            if leader in ties:
                among[i, names.index(leader)] -= ratio
            else:
                constants[i] += ratio * rows[leader]
    if abs(np.linalg.det(among)) < _ROUND:
        raise ParameterError(
            f"joints {', '.join(map(repr, names))} follow each other in a ring: hold one"
            f" ({held(names[0])})"
        )
    return dict(zip(names, np.linalg.solve(among, constants), strict=True))


def _refuse(tie: Tie, moving: list[str], remedy: list[str]) -> None:
    """Refuse a tie in no proportion, of which joints would move, unless some are held."""
    if moving:
        involved, hold = (", ".join(map(repr, names)) for names in (moving, remedy))
        raise ParameterError(
            f"{tie.what}, but not in proportion, and {involved} would move: hold {hold}"
            f" ({held(*remedy)})"
        )


def moving_joints(
    tree: Tree, root: str, chain: list[str], coupled: Coupled
) -> tuple[dict[str, Joint], list[str]]:
    """Return all joints that move, from base to tool and then beside these, and what is lost;
    followers' limits are in those of what they follow."""
    on_chain = [k for body in chain for k in tree.joints[body] if k.name in coupled.moving]
    others = [body for body in tree.movers(root, set()) if body not in (root, *chain)]
    beside = [k for body in others for k in tree.joints[body] if k.name in coupled.moving]
    joints = {joint.name: joint for joint in tree.moving_joints([*on_chain, *beside])}
    free, lost = [joints[k.name] for k in coupled.free], []
    movers = tree.movers(root, set(joints))
    for mine in beside:
        inner = [k.name for k in tree.joints[mine.body] if k.name in joints]
        before = inner[: inner.index(mine.name)]
        joints[mine.name].beside = True
        joints[mine.name].on = [movers[tree.parents[mine.body]], *before][-1]
    for name, ratios in coupled.moving.items():
        if joints[name] in free:
            continue
        joints[name].ratios = ratios
        leaders = np.flatnonzero(ratios)
        if len(leaders) == 1:
            k = int(leaders[0])
            _restrict(tree, free[k], joints[name], float(ratios[k]), coupled.at[name])
        else:
            lost.append(f"limits and friction of {name}, which follows several, left out")
    return joints, lost


def _restrict(tree: Tree, leader: Joint, follower: Joint, ratio: float, shift: float) -> None:
    """Keep a follower's limits by those of the joint that it follows, and add its friction."""
    if abs(follower.q_min) < ENDLESS or abs(follower.q_max) < ENDLESS:
        ends = sorted((end - shift) / ratio for end in (follower.q_min, follower.q_max))
        low, high = max(leader.q_min, ends[0]), min(leader.q_max, ends[1])
        if low < high:
            leader.q_min, leader.q_max = low, high
        elif tree.repair:
            tree.repairs.append(f"limits of {follower.name}, a follower, left out")
        else:
            raise ParameterError(
                f"joint {follower.name!r} follows {leader.name!r}, whose limits of"
                f" {leader.q_min:.4g} to {leader.q_max:.4g} leave it no range within its own"
                f" {follower.q_min:.4g} to {follower.q_max:.4g}: --repair, in Python"
                f" repair=True, leaves these out, or hold it ({held(follower.name)})"
            )
    for name in ("v_max", "a_max"):
        if most := getattr(follower, name):
            most /= abs(ratio)
            setattr(leader, name, min(getattr(leader, name) or most, most))
    leader.damping = (leader.damping or 0.0) + ratio**2 * (follower.damping or 0.0)
    leader.friction = (leader.friction or 0.0) + abs(ratio) * (follower.friction or 0.0)
    follower.damping = follower.friction = None
