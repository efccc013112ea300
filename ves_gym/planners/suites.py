"""The benchmark's questions: fixed sets of (vehicle, start, goal, duration)."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from ves_gym._util.params import Array, ParameterError, require_one_of
from ves_gym._util.suggest import did_you_mean
from ves_gym.effects.base import BaseDamping, BaseStiffness
from ves_gym.effects.joint_drive import CommandDelay
from ves_gym.effects.joint_friction import JointCoulomb, JointViscous
from ves_gym.effects.payload import PayloadMass
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.arm_library import PUMA_560, get_arm
from ves_gym.mechanics.flexible_base import FlexibleBase
from ves_gym.mechanics.motion import QUINTIC_PEAK_SPEED
from ves_gym.mechanics.vehicle import get_vehicle, has
from ves_gym.planners.obstacles import Box, Sphere, Surroundings
from ves_gym.planners.query import Query
from ves_gym.system.effect import Effect
from ves_gym.system.system import System

# Rules of the benchmark, not claims about the machine
REACH_DURATIONS = (0.5, 1.0, 2.0, 4.0)  # s, of the PUMA, see `reach_durations`
REACH_SEED = 560  # the published question set
_GRID = 60.0  # deg: a joint's range is cut to a multiple of it
_WIDEST = 180.0  # deg, +-: further on lies the same place
_RAREST = 1000  # draws an acceptable pair may take, on average
# reach100 asked of an arm with six joints, and of those with seven
ARM_SUITES = {f"reach100-{arm}": arm for arm in ("ur5e", "iiwa14", "canadarm2")}
SUITES = ("reach100", *ARM_SUITES, "thesis", "transfer")
OBSTACLES = ("off", "on", "both")
MORE_MODES = 14  # of the structure that suite transfer judges on
# Two crates and a ball within reach: a quarter of the straight lines of 4 s run into one.
REACH_OBSTACLES = Surroundings(
    obstacles=(
        Box(centre=(0.55, 0.45, 0.75), size=(0.2, 0.2, 0.9)),
        Box(centre=(-0.45, -0.55, 1.15), size=(0.25, 0.25, 0.25)),
        Sphere(centre=(0.0, -0.75, 0.6), radius=0.15),
    ),
    clearance=0.02,
)
OBSTACLE_SUFFIX = ", obstacles"  # after the name of a vehicle


@dataclass(frozen=True, kw_only=True)
class Suite:
    """Queries by vehicle name, and the planners that answer them by default.

    A query's system is what the motions are played on; planning is for `System.ideal()`, or
    for the system `described` under the query's vehicle name.
    """

    name: str
    queries: tuple[tuple[str, Query], ...]
    planners: tuple[str, ...]
    described: Mapping[str, System] = field(default_factory=dict)  # what is known of vehicles


def get_suite(
    name: str,
    *,
    system: System,
    vehicle: str | None = None,
    obstacles: str = "off",
) -> Suite:
    """Return a suite by name.

    Args:
        name: one of `SUITES`.
        system: everything but the vehicle (mode, drive, steps).
        vehicle: name or file; default the suite's own.
        obstacles: off, on, or both, the second time among `REACH_OBSTACLES` (reach100).

    Raises:
        ParameterError: an unknown name, or an option that the suite does not have.
    """
    require_one_of("obstacles", obstacles, OBSTACLES)
    require_one_of("suite", name, SUITES)
    if name in ("thesis", "transfer") and obstacles != "off":
        raise ParameterError(f"suite {name} has no obstacles, got {obstacles!r}")
    if name == "thesis":
        return thesis(system, vehicle)
    vehicle = vehicle or "bent"
    if name == "transfer":
        return transfer(system, vehicle, 10)
    if name in ARM_SUITES:
        arm = get_arm(ARM_SUITES[name])
        if system.arm not in (PUMA_560, arm):
            raise ParameterError(
                f"suite {name} asks {ARM_SUITES[name]}, got {system.arm.name} (reach100 asks"
                " any arm)"
            )
        system = system.replace(arm=arm)
    return replace(reach100(system, vehicle, 100, obstacles), name=name)


def part_of(
    suite: Suite, durations: Sequence[float] | None = None, *, first: int | None, skip: int = 0
) -> Suite:
    """Return a suite with some of its queries.

    Args:
        suite: the whole.
        durations: to answer [s]; None: all.
        first, skip: how many of each vehicle and duration (None: all), after leaving out some.

    Raises:
        ParameterError: a duration that the suite does not have, or nothing is left.
    """
    available = sorted({q.duration for _, q in suite.queries})
    selected = available if durations is None else durations
    if not set(selected) <= set(available):
        ours, theirs = (", ".join(f"{k:g}" for k in part) for part in (available, selected))
        raise ParameterError(f"--durations must be of {ours} s, got {theirs}")
    counted: Counter[tuple[str, float]] = Counter()
    chosen = []
    for vehicle, query in suite.queries:
        counted[vehicle, query.duration] += 1
        k = counted[vehicle, query.duration]
        if query.duration in selected and skip < k <= skip + (first or len(suite.queries)):
            chosen.append((vehicle, query))
    if not chosen:
        raise ParameterError(f"--skip {skip} leaves none of {max(counted.values())} queries")
    return replace(suite, queries=tuple(chosen))


def transfer(system: System, vehicle: str, count: int) -> Suite:
    """Return reach100's first questions, planned on one base (`vehicle`) and judged on others.

    Raises:
        ParameterError: mode emulated, or a system with effects.
    """
    if system.mode != "ideal" or system.effects:
        raise ParameterError(
            "suite transfer needs mode ideal and no effects (it judges on machines with its"
            f" own), got mode {system.mode} and {len(system.effects)} effects"
        )
    questions = reach100(system, vehicle, count).queries
    described = questions[0][1].system
    machines = others_of(described)
    queries = tuple(
        (name, replace(query, system=machine))
        for name, (machine, _) in machines.items()
        for _, query in questions
    )
    return Suite(
        name="transfer",
        queries=queries,
        planners=("straight", "direct", "refined", "robust", "robust-worst"),
        described={name: known_as for name, (_, known_as) in machines.items()},
    )


def others_of(described: System) -> dict[str, tuple[System, System]]:
    """Return machines beside the described one: name -> (as it is, as planners know it).

    More internal modes, stiffness 20 % off, damping a tenth and twice, a payload known and not,
    joint friction, a late command, and several of these at once.
    """
    n = described.arm.n

    def of(*effects: Effect) -> System:
        return described.replace(effects=effects)

    heavy = PayloadMass(mass=5.0)
    friction = JointCoulomb(torque=(2.0,) * n), JointViscous(damping=(1.0,) * n)
    soft, stiff = BaseStiffness(error=-0.2), BaseStiffness(error=0.2)
    weak, strong = BaseDamping(error=-0.9), BaseDamping(error=1.0)
    out = {"as described": (described, described)}
    if isinstance(described.vehicle, FlexibleBase):
        finer = replace(described.vehicle, modes=MORE_MODES)
        out["more modes"] = described.replace(vehicle=finer), described
    if has(described.vehicle, "K"):
        out["stiffness -20 %"] = of(soft), described
        out["stiffness +20 %"] = of(stiff), described
    if has(described.vehicle, "D"):
        out["damping x 0.1"] = of(weak), described
        out["damping x 2"] = of(strong), described
    out["payload 2.5 kg"] = of(PayloadMass(mass=2.5)), described
    out["payload 5 kg"] = of(heavy), described
    loaded = described.replace(arm=of(heavy).actual.arm)
    out["payload 5 kg, known"] = loaded, loaded  # to the servo as well
    out["friction"] = of(*friction), described
    out["command 12.5 ms late"] = of(CommandDelay(delay=0.0125)), described
    if has(described.vehicle, "K") and has(described.vehicle, "D"):
        out["soft, weak, 5 kg"] = of(soft, weak, heavy), described
        out["stiff, weak, 5 kg, friction"] = of(stiff, weak, heavy, *friction), described
    return out


def reach_range(arm: Arm) -> Array:
    """Return how far from the middle of its range each joint starts and ends, (n,) [rad].

    The largest whole multiple of 60 deg inside its limits, at most 180 deg; of 30, 15, ... deg
    for a joint that has less. The PUMA's 160, 110 and 135 deg become 120, 60 and 120.
    """
    half = np.rad2deg(arm.column("q_max") - arm.column("q_min")) / 2
    out = []
    for reach in np.minimum(half, _WIDEST) * (1 + 1e-12):
        grid = _GRID
        while grid > reach:
            grid /= 2
        out.append(grid * math.floor(reach / grid))
    return np.deg2rad(out)


def reach_durations(arm: Arm) -> tuple[float, ...]:
    """Return the durations of an arm's questions [s]: the PUMA's times a power of two.

    By the time that the joint in the middle needs for its `reach_range` at its largest rate.
    """
    ours, puma = (np.median(reach_range(of) / of.column("v_max")) for of in (arm, PUMA_560))
    factor = 2.0 ** round(math.log2(ours / puma))
    return tuple(factor * duration for duration in REACH_DURATIONS)


def reach_obstacles(arm: Arm) -> Surroundings:
    """Return `REACH_OBSTACLES` as much larger as the arm is longer than the PUMA."""
    ours, puma = (sum(math.hypot(k.a, k.d) for k in of.links) for of in (arm, PUMA_560))
    size = ours / puma

    def scaled(obstacle: Sphere | Box) -> Sphere | Box:
        centre = tuple(size * x for x in obstacle.centre)
        if isinstance(obstacle, Sphere):
            return replace(obstacle, centre=centre, radius=size * obstacle.radius)
        return replace(obstacle, centre=centre, size=tuple(size * x for x in obstacle.size))

    return replace(REACH_OBSTACLES, obstacles=tuple(map(scaled, REACH_OBSTACLES.obstacles)))


def reach100(
    system: System,
    vehicle: str,
    count: int,
    obstacles: str = "off",
    *,
    seed: int = REACH_SEED,
    durations: tuple[float, ...] | None = None,
) -> Suite:
    """`count` seeded start and goal pairs per duration, uniform in a box of joint space.

    The box is `reach_range` about the middle of every joint's range. A pair is drawn again
    until the straight quintic respects the arm's speed limits; of many joints a few at a time,
    which gives the same distribution in fewer draws. The first k of a larger count are
    those of a smaller one. Among obstacles the ends are the same; some of them are then inside
    one, which a planner has to say.

    Args:
        system: everything but the vehicle.
        vehicle: name or file.
        count: pairs per duration.
        obstacles: off, on or both; they grow with the arm (`reach_obstacles`).
        seed: of the question set.
        durations: of the motions [s]; default those of the arm (`reach_durations`).
    """
    mounted = system.replace(vehicle=get_vehicle(vehicle))
    arm = mounted.arm
    limits = tuple(arm.column("v_max").tolist())
    queries = []
    for duration in reach_durations(arm) if durations is None else durations:
        for k, (start, goal) in enumerate(_ends(arm, duration, seed, count)):
            label = f"reach-{duration:g}s-{k:03d}"
            query = Query(system=mounted, start=start, goal=goal, duration=duration,
                          v_max=limits, name=label)  # fmt: skip
            queries.append((vehicle, query))
    room = reach_obstacles(arm)
    among = [
        (v + OBSTACLE_SUFFIX, replace(q, name=f"{q.name}-obstacles", surroundings=room))
        for v, q in queries
    ]
    return Suite(
        name="reach100",
        queries=tuple({"off": queries, "on": among, "both": queries + among}[obstacles]),
        planners=("straight", "hotspot-q", "hotspot-qt", "direct", "refined", "calm"),
    )


@lru_cache(maxsize=64)  # every command and figure asks a suite for all its questions
def _ends(
    arm: Arm, duration: float, seed: int, count: int
) -> tuple[tuple[tuple[float, ...], tuple[float, ...]], ...]:
    """Starts and goals of `count` questions of a duration."""
    rng = np.random.default_rng((seed, round(1000 * duration)))
    drawn = (_drawn(arm, duration, rng) for _ in range(count))
    return tuple((tuple(start.tolist()), tuple(goal.tolist())) for start, goal in drawn)


def _drawn(arm: Arm, duration: float, rng: np.random.Generator) -> tuple[Array, Array]:
    """Start and goal (n,) between which the straight quintic keeps the speed limits."""
    width, limit = reach_range(arm), arm.column("v_max")
    ends = np.empty((2, arm.n))
    for part in _groups(width, limit * duration / QUINTIC_PEAK_SPEED):
        while True:
            pair = rng.uniform(-1, 1, (2, len(width[part]))) * width[part]
            speed = np.abs(pair[1] - pair[0]) * QUINTIC_PEAK_SPEED / duration
            if (speed <= limit[part]).all():
                break
        ends[:, part] = pair
    start, goal = ends + (arm.column("q_min") + arm.column("q_max")) / 2
    return start, goal


def _groups(width: Array, furthest: Array) -> list[slice]:
    """Joints in a row drawn together: as many as leave one pair in `_RAREST` acceptable.

    Args:
        width: (n,) +- of each joint [rad]. furthest: (n,) between start and goal [rad].
    """
    part = np.minimum(furthest / (2 * width), 1.0)
    firsts, share = [0], 1.0
    for j, accepted in enumerate(part * (2 - part)):
        share *= accepted
        if share < 1 / _RAREST and j > firsts[-1]:
            firsts.append(j)
            share = accepted
    return [slice(a, b) for a, b in itertools.pairwise([*firsts, len(width)])]


def thesis(system: System, vehicle: str | None) -> Suite:
    """The thesis's motions: the 180 degree shoulder turn, and a good and a bad path.

    Shoulder: App. A.3, joint 1 through 180 deg in 2 s, joints 2 and 3 at 0, on the
    horizontal straight beam and the bent beam. Good and bad: two paths between the same
    ends on the bent beam (4.2; the thesis prints no joint angles, these are ours).
    The beams are condensed as in its Appendix A. With a `vehicle`, bent or straight-horizontal
    (by finite elements) or one of the suite's own, only the queries on this one.

    Raises:
        ParameterError: a vehicle that the suite does not have, or an arm of other than three
            joints.
    """
    if system.arm.n != 3:
        raise ParameterError(
            "suite thesis asks the thesis's arm, of 3 joints: got"
            f" {system.arm.n} ({system.arm.name}); reach100 asks any arm"
        )
    shoulder = ([-90.0, 0, 0], [90.0, 0, 0], 2.0, "shoulder-180")  # deg, deg, s
    questions = [
        ("straight-horizontal-thesis", *shoulder),
        ("bent-thesis", *shoulder),
        ("bent-thesis", [0.0, -45, 90], [90.0, 45, -45], 3.0, "good-and-bad"),
    ]
    queries = []
    for beam, *degrees, duration, label in questions:
        if vehicle not in (None, beam, beam.removesuffix("-thesis")):
            continue
        name = vehicle or beam
        start, goal = (tuple(np.deg2rad(end).tolist()) for end in degrees)
        on = system.replace(vehicle=get_vehicle(name))
        query = Query(system=on, start=start, goal=goal, duration=duration, name=label)
        queries.append((name, query))
    if not queries:
        beams = sorted({q[0] for q in questions})
        beams += [beam.removesuffix("-thesis") for beam in beams]
        raise ParameterError(
            f"suite thesis runs on {', '.join(beams)}, got {vehicle!r}"
            f"{did_you_mean(vehicle, beams)}"
        )
    return Suite(
        name="thesis",
        queries=tuple(queries),
        planners=("straight", "bad-path", "hotspot-q", "hotspot-qt", "direct"),
    )
