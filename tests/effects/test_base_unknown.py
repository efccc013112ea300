"""A spring and a damper more are those of a vehicle that has them, and a satellite has none."""

import dataclasses

import numpy as np

from ves_gym import System
from ves_gym.effects import BaseUnknown
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.vehicle import DECOUPLED
from ves_gym.simulation.playback import play_motions

EFFECT = BaseUnknown(
    stiffness=(50.0, 0.0, 20.0, 3.0, 0.0, 1.0), damping=(2.0, 1.0, 0.0, 0.0, 0.5, 0.2)
)


def test_it_moves_as_a_vehicle_that_has_them():
    stiff = dataclasses.replace(
        DECOUPLED,
        K=np.array(DECOUPLED.K) + np.diag(EFFECT.stiffness),
        D=np.array(DECOUPLED.D) + np.diag(EFFECT.damping),
    )
    motion = Motion.straight([0.3, 0.5, 0.4], [0.6, 0.2, 0.1], 2.0)
    ours, theirs = (
        play_motions(system, [motion]).log(0)
        for system in (
            System(vehicle=DECOUPLED, effects=(EFFECT,)),
            System(vehicle=stiff),
        )
    )
    plain = play_motions(System(vehicle=DECOUPLED), [motion]).log(0)
    np.testing.assert_allclose(ours.y, theirs.y, atol=1e-12)
    assert np.abs(ours.y - plain.y).max() > 1e-5
