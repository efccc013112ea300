"""The task berthing_contact: a probe into the funnel of a free client."""

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest

from tests.envs.test_compiled import pair, require_alike
from ves_gym._util.params import ParameterError
from ves_gym.baselines.evaluate import evaluate
from ves_gym.baselines.registry import get_controller
from ves_gym.envs.batch import Batch
from ves_gym.envs.berthing_contact import DROGUE, BerthingContact
from ves_gym.envs.build import build_task
from ves_gym.mechanics.attitude import rotate

ID = "ves/BerthingContact-v0"
# a surface without a force to speak of: all else is the same
SOFT = {"stiffness": 1e-3, "damping": 0.0, "friction": 0.0, "tangential_damping": 0.0}


def test_the_funnel_guides_a_probe_that_is_aimed_beside_it():
    """The reference aims at what is seen, up to 17 mm beside where it is."""
    solved = []
    for contact in (DROGUE, replace(DROGUE, **SOFT)):
        system = BerthingContact().system.replace(contact=contact)
        result = evaluate(get_controller("resolved"), ID, episodes=12, threads=1, system=system)
        solved.append(sum(row["success"] for row in result.rows))
    print(f"{solved[0]} of 12 with contact, {solved[1]} without")
    assert solved[0] >= 11
    assert solved[1] <= 3


def bounced(batch: Batch) -> None:
    """Put the clients before the probe, aside, on their way to it."""
    cargo, ids = batch.sim.payload, np.arange(batch.n)
    q, grip = batch.goals[:, 3:7], np.tile(cargo.grip[0], (batch.n, 1))
    off = np.array([[0.06, 0.0, 0.07], [0.0, 0.1, 0.03], [0.0, 0.0, 0.0], [0.03, 0.03, 0.02]])
    place = batch.scene.tool + rotate(q, off - grip)
    velocity = rotate(q, np.tile([-0.02, -0.02, -0.1], (batch.n, 1)))
    cargo.change(ids, position=place, attitude=q, velocity=velocity)
    batch.scene.goal[:, :3] = batch.scene.tool  # there it is not lost
    batch.set_state(batch.get_state())


def test_compiled_steps_are_those_of_numpy_in_contact_and_through_the_latch():
    batches = pair(build_task("berthing_contact"), 4)
    for batch in batches:
        bounced(batch)
    rng, touched = np.random.default_rng(0), 0
    for _ in range(60):
        action = rng.uniform(-1.0, 1.0, (4, 3))
        ours, theirs = (batch.step(action) for batch in batches)
        require_alike(ours[0], theirs[0], "reward")
        for name, value in ours[3].items():
            require_alike(value, theirs[3][name], name)
        for name in ("payload", "contact", "memory", "q", "y"):
            require_alike(*(getattr(batch.scene, name) for batch in batches))
        touched += np.count_nonzero(batches[0].scene.contact[:, 6])
        a, b = (batch.sim.payload.carried for batch in batches)
        np.testing.assert_array_equal(a, b)
    assert touched > 10


def test_a_client_bounces_off_and_the_base_feels_it():
    """What it gains of momentum is what the base's motion and the joints' torques take."""
    ends = []
    for law in ({}, SOFT):
        system = BerthingContact().system
        system = system.replace(contact=replace(system.contact, **law))
        batch = Batch(BerthingContact(system=system), 4)
        batch.seed(np.arange(4), 5, np.arange(4))
        batch.reset(np.arange(4))
        bounced(batch)
        energy = np.zeros(4)
        for _ in range(60):
            batch.step(np.zeros((4, 3)))
            energy = np.maximum(energy, batch.scene.energy)
        ends.append((batch.sim.payload.state.velocity, energy))
    hit = np.linalg.norm(ends[0][0] - ends[1][0], axis=1) > 0.05
    assert hit.sum() >= 2
    assert (ends[0][1][hit] > 1e-3).all() and (ends[1][1] < 1e-6).sum() >= 3


def test_a_force_that_is_too_large_and_a_lost_client_end_the_episode():
    for settings, last in (({"strength": 1.0}, "breaks"), ({"lost": 1e-3}, "is lost")):
        batch = Batch(build_task("berthing_contact", **settings), 4)
        batch.seed(np.arange(4), 5, np.arange(4))
        batch.reset(np.arange(4))
        bounced(batch)
        over = np.zeros(4, bool)
        for _ in range(60):
            _, terminated, _, info = batch.step(np.zeros((4, 3)), over)
            assert not info["success"][terminated].any(), last
            over |= terminated
        assert over.sum() >= 2, last


def test_the_client_is_met_where_it_is_if_nothing_touches_it():
    env = gym.make_vec(ID, num_envs=8, drift=0.05)
    env.reset(seed=3)
    task, batch = env.unwrapped.task, env.unwrapped.batch
    for _ in range(round(0.7 * task.steps)):
        batch.step(np.zeros((8, 3)))
    fixture, _ = batch.sim.payload.fixture()
    off = np.linalg.norm(fixture - batch.goals[:, :3], axis=1)
    assert np.median(off) <= 1e-9  # where the arm, at rest, is not in its way


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"mass": (0.0, 3.0)}, "mass must be 0 < from <= to"),
        ({"system": BerthingContact().system.replace(contact=None)}, "contact on it"),
        ({"mode": "emulated"}, "System.contact needs mode ideal"),
        ({"strength": 0.0}, "strength must be > 0"),
    ],
)
def test_refused(settings, message):
    with pytest.raises(ParameterError, match=message):
        build_task("berthing_contact", **settings)
