"""The benchmark's questions: fixed sets of (vehicle, start, goal, duration)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ves_gym._util.params import ParameterError, Vector
from ves_gym._util.suggest import did_you_mean
from ves_gym.mechanics.motion import QUINTIC_PEAK_SPEED
from ves_gym.mechanics.vehicle import get_vehicle
from ves_gym.planners.obstacles import Box, Sphere, Surroundings
from ves_gym.planners.query import Query
from ves_gym.system.system import System

# A rule of the benchmark, not a claim about the machine: joint speeds [rad/s].
SPEED_LIMITS: Vector = tuple(np.deg2rad([82.0, 54.0, 122.0]).tolist())
REACH_RANGE = np.deg2rad([120.0, 60.0, 120.0])  # +- of each joint
REACH_DURATIONS = (0.5, 1.0, 2.0, 4.0)  # s
REACH_SEED = 560  # the published question set
SUITES = ("reach100", "thesis")
OBSTACLES = ("off", "on", "both")
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
    """Queries by vehicle name, and the planners that answer them unless others are asked.

    A query's system is what the motions are played on; planning is for `System.ideal()`.
    """

    name: str
    queries: tuple[tuple[str, Query], ...]
    planners: tuple[str, ...]
    uncompensated_runs: tuple[
        tuple[str, str], ...
    ] = ()  # (query, planner) also played `uncompensated`


def get_suite(
    name: str,
    *,
    system: System,
    vehicle: str | None = None,
    quick: bool = False,
    obstacles: str = "off",
) -> Suite:
    """Return a suite by name.

    Args:
        name: one of `SUITES`.
        system: everything but the vehicle (mode, drive, steps).
        vehicle: name or file; default the suite's own.
        quick: ten queries per duration instead of a hundred (reach100).
        obstacles: off, on, or both, the second time among `REACH_OBSTACLES` (reach100).

    Returns:
        The suite's queries and planners.

    Raises:
        ParameterError: an unknown name, or an option that the suite does not have.
    """
    if obstacles not in OBSTACLES:
        raise ParameterError(
            f"obstacles must be one of {', '.join(OBSTACLES)}, got {obstacles!r}"
            f"{did_you_mean(obstacles, OBSTACLES)}"
        )
    if name == "reach100":
        return reach100(system, vehicle or "bent", 10 if quick else 100, obstacles)
    if name == "thesis":
        if obstacles != "off":
            raise ParameterError(f"suite thesis has no obstacles, got {obstacles!r}")
        return thesis(system, vehicle)
    raise ParameterError(
        f"suite must be one of {', '.join(SUITES)}, got {name!r}{did_you_mean(name, SUITES)}"
    )


def uncompensated(system: System) -> System:
    """The same machine with the arm's weight zeroed once at the start, then left in.

    Errors of the gravity estimate act on nothing there, and go.
    """
    lab = replace(system.emulator_settings, operation="admittance", zero_at_start=True)
    effects = tuple(e for e in system.effects if not e.kind.startswith("gravity/"))
    return system.replace(emulator=lab, effects=effects)


def is_compensated(system: System) -> bool:
    """True if the arm does not weigh on the vehicle: in space, or by subtraction (eq. 2.1)."""
    return system.mode == "ideal" or system.emulator_settings.operation == "microgravity"


def reach100(
    system: System,
    vehicle: str,
    count: int,
    obstacles: str = "off",
    *,
    seed: int = REACH_SEED,
    durations: tuple[float, ...] = REACH_DURATIONS,
) -> Suite:
    """`count` seeded start and goal pairs per duration, uniform in the joint box.

    A pair is drawn again until the straight quintic respects the speed limits. The first k of
    a larger count are those of a smaller one. Among obstacles the ends are the same; some of
    them are then inside one, which a planner has to say.

    Args:
        system: everything but the vehicle; a three-joint arm.
        vehicle: name or file.
        count: pairs per duration.
        obstacles: off, on or both.
        seed: of the question set.
        durations: of the motions [s].

    Returns:
        The suite.

    Raises:
        ParameterError: an arm of another number of joints, or an unknown vehicle.
    """
    mounted = system.replace(vehicle=get_vehicle(vehicle))
    if mounted.arm.n != len(REACH_RANGE):
        raise ParameterError(
            f"reach100 asks a {len(REACH_RANGE)}-joint arm, got {mounted.arm.n} joints"
        )
    queries = []
    for duration in durations:
        rng = np.random.default_rng((seed, round(1000 * duration)))
        accepted = 0
        while accepted < count:
            start, goal = rng.uniform(-1, 1, (2, len(REACH_RANGE))) * REACH_RANGE
            if (np.abs(goal - start) * QUINTIC_PEAK_SPEED / duration > SPEED_LIMITS).any():
                continue
            queries.append(
                (
                    vehicle,
                    Query(
                        system=mounted,
                        start=tuple(start.tolist()),
                        goal=tuple(goal.tolist()),
                        duration=duration,
                        v_max=SPEED_LIMITS,
                        name=f"reach-{duration:g}s-{accepted:03d}",
                    ),
                )
            )
            accepted += 1
    among = [
        (
            v + OBSTACLE_SUFFIX,
            replace(q, name=f"{q.name}-obstacles", surroundings=REACH_OBSTACLES),
        )
        for v, q in queries
    ]
    return Suite(
        name="reach100",
        queries=tuple({"off": queries, "on": among, "both": queries + among}[obstacles]),
        planners=("straight", "hotspot-q", "hotspot-qt", "direct", "refined"),
    )


def thesis(system: System, vehicle: str | None) -> Suite:
    """The thesis's motions: the 180 degree shoulder turn, and a good and a bad path.

    Shoulder: App. A.3, joint 1 through 180 deg in 2 s, joints 2 and 3 at 0, on the
    horizontal straight beam and the bent beam. Good and bad: two paths between the same
    ends on the bent beam (4.2; the thesis prints no joint angles, these are ours). In the
    laboratory the good path is also played without gravity compensation (Figure 4-3).

    Args:
        system: everything but the vehicle.
        vehicle: only the queries on this one; None: all.

    Returns:
        The suite.

    Raises:
        ParameterError: a vehicle that the suite does not have.
    """
    shoulder = (np.deg2rad([-90.0, 0, 0]), np.deg2rad([90.0, 0, 0]), 2.0, "shoulder-180")
    ends = np.deg2rad([0.0, -45, 90]), np.deg2rad([90.0, 45, -45])
    questions = [
        ("straight-horizontal", *shoulder),
        ("bent", *shoulder),
        ("bent", *ends, 3.0, "good-and-bad"),
    ]
    queries = []
    for beam, start, goal, duration, label in questions:
        if vehicle is not None and beam != vehicle:
            continue
        queries.append(
            (
                beam,
                Query(
                    system=system.replace(vehicle=get_vehicle(beam)),
                    start=tuple(start.tolist()),
                    goal=tuple(goal.tolist()),
                    duration=duration,
                    name=label,
                ),
            )
        )
    if not queries:
        beams = sorted({q[0] for q in questions})
        raise ParameterError(
            f"suite thesis runs on {', '.join(beams)}, got {vehicle!r}"
            f"{did_you_mean(vehicle, beams)}"
        )
    return Suite(
        name="thesis",
        queries=tuple(queries),
        planners=("straight", "bad-path", "hotspot-q", "hotspot-qt", "direct"),
        uncompensated_runs=()
        if system.mode == "ideal" or not is_compensated(system)
        else (("good-and-bad", "hotspot-q"),),
    )
