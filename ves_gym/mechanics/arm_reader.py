"""One reader of arms from files: of a tree of bodies and joints a chain becomes an arm.

A file format is a `Tree` (`urdf.UrdfTree`, `mjcf_arm.MjcfTree`); which bodies move as one, and
what is refused, is decided here, and by `arm_coupling` which joints move. What is written is in
`arm_files`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence, Set
from dataclasses import replace

import numpy as np

from ves_gym._util.params import Array, ParameterError
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.arm_coupling import coupled_joints, moving_joints
from ves_gym.mechanics.arm_tree import ChainChoice, Tree, held
from ves_gym.mechanics.chain import Joint, LinkMass, Lump, arm_of
from ves_gym.mechanics.link import WEIGHTLESS, Capsule, rigid_moments
from ves_gym.mechanics.side_by_side import side_by_side

# Numbers beyond these look like mm, g, kg mm^2 and degrees (this project).
_REACH, _LEAST = 100.0, 1e-6  # m
_DENSITY = 1e4  # kg/m^3: moving mass over the cube of the reach; a PUMA has 60
_GYRATION = 10.0  # radius of gyration over the reach
_SHAPE = 30.0  # of the arm's size; a gripper on its base link has less
_TURNS = 12.6, 1e4  # rad either way: a wrist turns twice, and 1e16 stands for no limit
_ROUND = 1e-12  # of an inertia's largest number


def arm_of_tree(tree: Tree, choice: ChainChoice) -> Arm:
    """Return the arm that a chain of a tree is, or the arms of several on one base; refusals
    name the body or the joint."""
    tips = [choice.tip] if choice.tip is None or isinstance(choice.tip, str) else choice.tip
    if len(tips) == 1:
        return _arm_of_chain(tree, choice, tips[0])
    moved = _chains(tree, choice, [str(tip) for tip in tips])
    arms: list[Arm] = []
    for tip, mine in moved.items():
        others = {name for joints in moved.values() for name in joints - mine}
        rotors = {k: v for k, v in choice.rotors.items() if k not in others}
        arm = _arm_of_chain(tree, choice._replace(rotors=rotors), tip, others)
        arm = replace(arm, name=tip)
        arms.append(replace(arm, base=WEIGHTLESS, base_shape=None) if arms else arm)
    return replace(side_by_side(arms), name=tree.name)


def _chains(tree: Tree, choice: ChainChoice, tips: Sequence[str]) -> dict[str, set[str]]:
    """The joints that move on the way to each of several tips, refused where two share one."""
    if not tips or len(set(tips)) < len(tips):
        raise ParameterError(f"tips must be different, got {', '.join(tips) or 'none'}")
    root = tree.root(choice.root)
    out: dict[str, set[str]] = {}
    for tip in tips:
        chain = tree.chain(root, tree.tip(tip, root)[0])
        joints = {k.name: body for body in chain for k in tree.joints[body] if not k.fixed}
        for other, theirs in out.items():
            for name, body in joints.items():
                if name in theirs and name not in choice.locked:
                    raise ParameterError(
                        f"the arms to {other!r} and {tip!r} share joint {name!r} and its"
                        f" {tree.noun} {body!r}: hold it ({held(name)})"
                    )
        out[tip] = joints.keys() - choice.locked.keys()
    return out


def _arm_of_chain(
    tree: Tree, choice: ChainChoice, tip: str | None, others: Set[str] = frozenset()
) -> Arm:
    """The arm of one chain; what other arms' joints move is no part of it."""
    tree.repair, tree.repairs = choice.repair, []
    root = tree.root(choice.root)
    end, tip = tree.tip(tip, root)
    chain = tree.chain(root, end)
    tree.coupled = coupled = coupled_joints(tree, root, chain, _locked(tree, choice))
    if not coupled.free:
        raise ParameterError(f"no {tree.moving} joint lies between {root!r} and {tip!r}")
    tree.place(root, coupled.at)
    joints, lost = moving_joints(tree, root, chain, coupled)
    rotors = _with_rotors(joints, choice.rotors)
    movers = tree.movers(root, {*joints, *others})
    movers = {body: mover for body, mover in movers.items() if mover not in others}
    for body in choice.massless:
        tree.require(body, "massless")
    tree.unweighed = []
    masses = {
        body: tree.mass(body, mover is not None)
        for body, mover in movers.items()
        if body not in choice.massless
    }
    pieces: dict[str | None, list[LinkMass]] = {name: [] for name in (None, *joints)}
    for body, mass in masses.items():
        if mass is not None:
            pieces[movers[body]].append(mass)
    bare = [k for k in tree.unweighed if not any(piece.mass for piece in pieces[movers[k]])]
    if bare:
        _refuse_unweighed(bare)
    tool = tree.tool(end, tip)
    if choice.check:
        along = [joint for joint in joints.values() if not joint.beside]
        moved = [piece for name in joints for piece in pieces[name]]
        size = _require_plausible(along, tool[1], moved)
    lumps: dict[str | None, Lump] = {None: Lump()}
    lumps |= {name: joint.body for name, joint in joints.items()}
    still = []
    for mover, of in pieces.items():
        for piece in of:
            lumps[mover].add(piece.mass, piece.com, piece.moments)
    _require_bodies(tree, lumps, pieces)
    for body, mover in movers.items():
        if choice.collision:
            capsules = tree.capsules(body)
            if choice.check:
                _require_shapes(body, capsules, size)
            lumps[mover].capsules += capsules
        lumps[mover].meshes += tree.meshes(body)
        for joint in tree.joints[body] if body != root else ():
            if not joint.fixed and joint.name not in joints:
                still.append(f"{joint.name} at {coupled.at[joint.name]:g}")
    notes = [f"read from {tree.path.name}, {root} to {tip}"]
    if still:
        notes.append(f"joints that stand still: {', '.join(still)}")
    names = [joint.name for joint in joints.values() if joint.ratios is not None]
    if names:
        notes.append(f"joints that follow others: {', '.join(names)}")
    if choice.massless:
        notes.append(f"taken to weigh nothing: {', '.join(choice.massless)}")
    if tree.unweighed:
        notes.append(f"no mass in the file, so none: {', '.join(tree.unweighed)}")
    notes += [*tree.repairs, *lost]
    return arm_of(
        tree.name,
        lumps[None],
        list(joints.values()),
        tool,
        source="; ".join([*notes, *tree.notes(list(joints)), *rotors]),
        collision=choice.collision,
        bandwidth=tree.bandwidth,
    )


def _refuse_unweighed(names: Sequence[str]) -> None:
    """Refuse links of which nothing says what they weigh, nor what moves along, all at once."""
    quoted = ", ".join(map(repr, names))
    what = f"link {quoted} has" if len(names) == 1 else f"links {quoted} have"
    flags = " ".join(f"--massless {name}" for name in names)
    raise ParameterError(
        f"{what} a shape, but no <inertial>: mass is unknown ({flags}, in Python"
        f" massless={list(names)}, takes it to be nothing)"
    )


def _locked(tree: Tree, choice: ChainChoice) -> dict[str, float]:
    """Return the joints that are to stand still, and where [rad, m]."""
    every = {joint.name: joint for joints in tree.joints.values() for joint in joints}
    out = {}
    for name, value in choice.locked.items():
        if name not in every:
            raise ParameterError(f"locked: no joint {name!r}; there are {', '.join(every)}")
        turns = choice.degrees and not every[name].slides
        out[name] = math.radians(value) if turns else float(value)
    return out


def _with_rotors(joints: Mapping[str, Joint], rotors: Mapping[str, float]) -> list[str]:
    """Set rotor inertias [kg m^2] that are given beside the file; return the note on them."""
    for name, value in rotors.items():
        if name not in joints:
            raise ParameterError(
                f"rotors: no moving joint {name!r}; there are {', '.join(joints)}"
            )
        if not (math.isfinite(value) and value >= 0):
            raise ParameterError(
                f"rotors: inertia about joint {name!r} must be >= 0 kg m^2, got {value!r}"
            )
        joints[name].rotor_inertia = float(value)
    if not rotors:
        return []
    values = (f"{name} {value:g} kg m^2" for name, value in rotors.items())
    return [f"rotor inertia given beside the file: {', '.join(values)}"]


def _require_bodies(
    tree: Tree, lumps: Mapping[str | None, Lump], pieces: Mapping[str | None, list[LinkMass]]
) -> None:
    """Refuse links that move as one and are no rigid body together; or take the nearest one,
    where the tree is to be repaired. Links that are none by themselves are noted."""
    alone: list[str] = []
    for mover, lump in lumps.items():
        about = lump.moments
        nearest = rigid_moments(about) if lump.mass else np.zeros((3, 3))
        if _alike(about, nearest):
            bodies = ((k.link, k.moments) for k in pieces[mover])
            alone += [name for name, x in bodies if not _alike(x, rigid_moments(x))]
            continue
        names = ", ".join(k.link for k in pieces[mover])
        was, now = (
            ", ".join(f"{k:.4g}" for k in np.linalg.eigvalsh(x)) for x in (about, nearest)
        )
        if not tree.repair:
            raise ParameterError(
                f"{tree.noun} {names}: no rigid body of {lump.mass:.4g} kg has principal"
                f" moments {was} kg m^2: --repair, in Python repair=True, takes the nearest,"
                f" {now}"
            )
        tree.repairs.append(f"principal moments of {names} {was} taken as {now} kg m^2")
        lump.moments = nearest
    if alone:
        tree.repairs.append(
            f"inertia of {', '.join(alone)}, which no rigid body has, taken as it is: with what"
            " moves along it is one"
        )


def _alike(one: Array, other: Array) -> bool:
    return bool(np.abs(one - other).max() <= _ROUND * np.abs(one).max())


def _require_shapes(body: str, capsules: list[Capsule], size: float) -> None:
    """Refuse shapes far larger than the arm, which look like mm."""
    largest = max((k.radius + math.dist(k.start, k.end) for k in capsules), default=0.0)
    if largest > _SHAPE * size:
        raise ParameterError(
            f"link {body!r} has a shape of {largest:.4g} m on an arm of {size:.3g} m: shapes"
            ' must be in m, this one looks like mm (give the mesh scale="0.001 0.001 0.001",'
            " --no-collision, in Python collision=False, leaves shapes out, --no-check takes"
            " them)"
        )


def _require_plausible(joints: list[Joint], tool: Array, pieces: list[LinkMass]) -> float:
    """Return the arm's size [m]; refuse lengths, masses, inertias and ranges that look like mm,
    g, kg mm^2 and degrees."""
    for joint in joints:
        farthest = max(joint.q_min, joint.q_max, key=abs)
        if not joint.slides and _TURNS[0] < abs(farthest) < _TURNS[1]:
            raise ParameterError(
                f"joint {joint.name!r} goes to {farthest:.4g} rad,"
                f" {abs(farthest) / math.tau:.3g} turns: limits must be in rad, these look like"
                " degrees (--no-check, in Python check=False, takes them)"
            )
    points = np.array([*(joint.origin for joint in joints), tool])
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    reach = float(steps.sum())
    if reach > _REACH:
        k = int(steps.argmax())
        raise ParameterError(
            f"what joint {joints[k].name!r} moves is {steps[k]:.4g} m long and the whole arm"
            f" {reach:.4g} m: lengths must be in m, these look like mm (--no-check,"
            " in Python check=False, takes them)"
        )
    if reach < _LEAST:  # a wheel about its own axis: there is no length to compare with
        return math.inf
    distances = [np.linalg.norm(k.com - points, axis=1).min() for k in pieces if k.mass]
    size = max([reach, 1e-3, *(2 * float(k) for k in distances)])
    for piece in pieces:
        largest = float(np.abs(piece.moments).max())
        if piece.mass and largest > piece.mass * (_GYRATION * size) ** 2:
            raise ParameterError(
                f"link {piece.link!r} of {piece.mass:.4g} kg has an inertia of {largest:.4g}"
                f" kg m^2, a radius of gyration of {math.sqrt(largest / piece.mass):.3g} m on"
                f" an arm of {size:.3g} m: inertias must be in kg m^2, these look like kg mm^2"
                " (--no-check, in Python check=False, takes them)"
            )
    total = sum(piece.mass for piece in pieces)
    if total > _DENSITY * size**3:
        heaviest = max(pieces, key=lambda piece: piece.mass)
        raise ParameterError(
            f"link {heaviest.link!r} has {heaviest.mass:.4g} kg and all that moves {total:.4g}"
            f" kg on {size:.3g} m: masses must be in kg, these look like g (--no-check,"
            " in Python check=False, takes them)"
        )
    return size
