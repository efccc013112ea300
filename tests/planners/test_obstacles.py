"""Collisions: what is near what, how far, and what changes it."""

from dataclasses import replace

import numpy as np
import pytest

from tests.arms import capsules
from ves_gym._util.params import ParameterError, write_table
from ves_gym.mechanics.kinematics import joint_positions
from ves_gym.mechanics.vehicle import BENT_THESIS, FREE_FLOATING, STRAIGHT_HORIZONTAL_THESIS
from ves_gym.planners.obstacles import (
    Box,
    Collisions,
    Sphere,
    Surroundings,
    collisions,
    read_surroundings,
)
from ves_gym.planners.query import Query, first_violation, sample_path
from ves_gym.system.system import System

BENT = System(vehicle=BENT_THESIS)

BALL = Sphere(centre=(0.6, 0.0, 1.0), radius=0.2)
CRATE = Box(centre=(0.0, 0.8, 0.8), size=(0.3, 0.3, 0.6), angles=(0.0, 0.0, 0.3))
BUSY = Surroundings(obstacles=(BALL, CRATE), clearance=0.01)


def segment_distance(a, b, p):
    """Of a point from a segment."""
    u = np.clip((p - a) @ (b - a) / max((b - a) @ (b - a), 1e-300), 0, 1)
    return np.linalg.norm(a + u * (b - a) - p)


def test_distance_from_a_ball_is_that_of_capsules():
    """Upper arm and forearm by hand, from the kinematics."""
    system, arm = BENT, BENT.arm
    checker = Collisions(system, Surroundings(obstacles=(BALL,), clearance=0.0))
    rng = np.random.default_rng(0)
    compared = 0
    for q in rng.uniform(-1.0, 1.0, (200, 3)):
        near = checker.proximity(q, 0.3)
        pieces = zip(*capsules(arm, q), strict=True)
        by_hand = [segment_distance(a, b, BALL.centre) - BALL.radius - r for a, b, r in pieces]
        expected = min(by_hand)
        if expected < 0.25:
            compared += 1
            with_ball = [d for d in near.distance if any(abs(d - k) < 1e-6 for k in by_hand)]
            assert min(with_ball) == pytest.approx(expected, abs=1e-9)
            assert checker.is_clear(q) == (near.distance.min() >= 0)
    assert compared > 50


def test_the_slope_is_that_of_the_distance():
    """Central differences of 1e-6 rad, on shapes that do not overlap."""
    checker = Collisions(BENT, BUSY)
    rng = np.random.default_rng(1)
    compared = 0
    for q in rng.uniform(-1.5, 1.5, (300, 3)):
        near = checker.proximity(q, 0.1)
        for j, e in enumerate(np.eye(3)):
            sides = [checker.proximity(q + s * 1e-6 * e, 0.2).distance for s in (1, -1)]
            for distance, slope in zip(near.distance, near.slope[:, j], strict=True):
                same = [side[np.abs(side - distance) < 1e-4] for side in sides]
                if distance > 0 and all(
                    len(k) == 1 for k in same
                ):  # the same pair, and no other
                    change = (same[0][0] - same[1][0]) / 2e-6
                    assert slope == pytest.approx(change, abs=1e-5)
                    compared += 1
    assert compared > 300


@pytest.mark.parametrize(
    ("q", "expected"),
    [((0.0, 0.0, 0.0), []), ((0.0, -1.6, 0.05), ["link 3' and platform", "tool and platform"])],
)
def test_it_sees_the_arm_touch_the_vehicle(q, expected):
    checker = Collisions(BENT, Surroundings(clearance=0.0))
    names = checker.contact_names(q)
    assert names == expected
    assert checker.is_clear(np.array(q)) == (not expected)


def test_the_beam_counts():
    """The arm's shoulder low over a beam that lies along -x."""
    q, alone = np.array([np.pi * 0.85, -1.0, 0.0]), Surroundings(clearance=0.0)
    beam, none = (
        Collisions(System(vehicle=k), alone).proximity(q, 3.0).distance.round(6)
        for k in (STRAIGHT_HORIZONTAL_THESIS, FREE_FLOATING)
    )
    assert not np.isin(beam, none).all()


def test_the_forearm_passes_the_column():
    """Folded back beside it, as a PUMA can, 33 mm away; the links know each other."""
    path = np.linspace([0.0, -1.5, -1.0], [0.0, -1.5, -2.3], 40)
    assert collisions(BENT, Surroundings()).first_contact(path) is None
    wide = collisions(BENT, Surroundings(clearance=0.05))
    k = wide.first_contact(path)
    assert k is not None
    assert wide.contact_names(path[k]) == ["link 1 and link 3", "link 1 and link 3'"]


def test_a_motion_is_checked_finely():
    """A needle thinner than the planning resolution is still hit."""
    start, goal = (-0.8, 0.0, 0.0), (0.8, 0.0, 0.0)
    tip = joint_positions(BENT.arm, np.zeros(3))[-1]
    thorn = Sphere(centre=tuple(tip.tolist()), radius=0.01)
    free = Query(system=BENT, start=start, goal=goal, duration=2.0)
    query = replace(free, surroundings=Surroundings(obstacles=(thorn,), clearance=0.0))
    assert first_violation(free, free.straight) is None
    assert "obstacle 1 (sphere)" in first_violation(query, query.straight)
    path = sample_path(query.straight, 0.01)
    assert np.linalg.norm(np.diff(path, axis=0), axis=1).max() < 0.012
    np.testing.assert_array_equal(path[[0, -1]], [start, goal])


def test_files(tmp_path):
    write_table(tmp_path / "room.toml", BUSY)
    assert read_surroundings(tmp_path / "room.toml") == BUSY
    write_table(tmp_path / "room.json", BUSY)
    assert read_surroundings(tmp_path / "room.json") == BUSY
    (tmp_path / "wrong.toml").write_text('[[obstacles]]\nkind = "cone"\n')
    with pytest.raises(ParameterError, match="cone"):
        read_surroundings(tmp_path / "wrong.toml")


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Sphere(centre=(0, 0), radius=1.0), r"Sphere.centre must have shape \(3,\)"),
        (lambda: Sphere(centre=(0, 0, 0), radius=0.0), "Sphere.radius must be > 0 m, got 0.0"),
        (lambda: Box(centre=(0, 0, 0), size=(1, 0, 1)), r"Box.size must be > 0 m"),
        (lambda: Surroundings(clearance=-0.1), "clearance must be >= 0 m, got -0.1"),
        (lambda: Surroundings(obstacles=(1.0,)), "must be Sphere or Box, got 1.0"),
        (lambda: Surroundings(obstacles=[BUSY]), "obstacles must be a tuple, got "),
    ],
)
def test_surroundings_that_are_none(make, message):
    with pytest.raises(ParameterError, match=message):
        make()


def test_clear_and_near_agree():
    """Contacts against distances of convex shapes, on random configurations."""
    checker = Collisions(BENT, BUSY)
    arm, rng = BENT.arm, np.random.default_rng(2)
    verdicts = []
    for q in rng.uniform(arm.column("q_min"), arm.column("q_max"), (500, 3)):
        nearest = checker.proximity(q, 0.2).distance.min(initial=0.2)
        if abs(nearest - BUSY.clearance) > 1e-6:
            verdicts.append(checker.is_clear(q))
            assert verdicts[-1] == (nearest >= BUSY.clearance)
    assert 0.1 < np.mean(verdicts) < 0.95
