"""Claim: on a free-floating base, linear and angular momentum stay what they were.

Momentum comes from Pinocchio's centroidal momentum of the recorded states, carried to the
inertial origin; nothing of our own dynamics is used. Rotors turn with their joints only
and carry no momentum of the base (docs/physics.md), so their inertia is left out.

Tolerance: 1e-8 of the momentum that the single bodies carry (the sum of their norms,
at its largest over the run: about 30 kg m/s and 35 kg m^2/s), the rk4 error at the
default step being about 1e-11. The same drift in SI units is also below 1e-8.
"""

import numpy as np
import pinocchio as pin
import pytest

from ves_gym.engine.mjcf import TO_Y
from ves_gym.mechanics.arm_files import pinocchio_model
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.vehicle import BENT_THESIS, FREE_FLOATING, FREE_FLYING
from ves_gym.simulation.playback import play_motions
from ves_gym.simulation.recording import Recording
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.system import System

MOTION = Motion.straight(np.deg2rad([-40, -20, 0]), np.deg2rad([60, 40, -30]), 2.0)
AT_REST = np.zeros(6)
DRIFTING = np.array([0.10, -0.05, 0.02, 0.05, 0.10, -0.08])  # m/s, rad/s
TOLERANCE = 1e-8


def momenta(run: Recording) -> tuple[np.ndarray, np.ndarray]:
    """(N, 6) momentum about the inertial origin; (2,) momentum carried by single bodies."""
    model = pinocchio_model(run.system.arm, run.system.base)
    model.armature[:] = 0.0
    data = model.createData()
    total, carried = [], []
    for k in range(len(run.t)):
        z = np.r_[run.y[0, k][TO_Y], run.q[0, k]]
        zd = np.r_[run.yd[0, k][TO_Y], run.v[0, k]]
        h = pin.computeCentroidalMomentum(model, data, z, zd)
        total.append(np.r_[h.linear, h.angular + np.cross(data.com[0], h.linear)])
        pin.forwardKinematics(model, data, z, zd)
        parts = [
            data.oMi[j].act(model.inertias[j] * data.v[j])
            for j in range(1, model.njoints)
            if model.inertias[j].mass > 0
        ]
        norms = [[np.linalg.norm(k) for k in (part.linear, part.angular)] for part in parts]
        carried.append(np.sum(norms, axis=0))
    return np.array(total), np.max(carried, axis=0)


def drift(run: Recording) -> tuple[float, float, float]:
    """Largest change: linear, angular (both relative), and of any component in SI units."""
    total, carried = momenta(run)
    change = np.abs(total - total[0])
    linear, angular = change[:, :3].max(), change[:, 3:].max()
    return linear / carried[0], angular / carried[1], float(change.max())


@pytest.mark.parametrize("drive", ["motor", "prescribed"])
@pytest.mark.parametrize("yd", [AT_REST, DRIFTING], ids=["at rest", "drifting"])
def test_momentum_is_kept(yd, drive):
    run = play_motions(System(vehicle=FREE_FLOATING, drive=drive), [MOTION], settle=2.0, yd=yd)
    assert np.abs(run.y[0, -1] - run.y[0, 0]).max() > 0.01  # the base did move
    assert max(drift(run)) <= TOLERANCE
    if not yd.any():
        total, _ = momenta(run)
        assert np.abs(total).max() <= TOLERANCE


def test_a_beam_takes_momentum_up():
    """The detector fires: the bent beam's spring is an outside force."""
    run = play_motions(System(vehicle=BENT_THESIS), [MOTION], settle=0.0)
    assert drift(run)[0] > 0.1


def test_jets_change_momentum_by_their_impulse():
    """Free-flying: 10 N along x for 1 s from rest give 10 kg m/s, within the jets' turning.

    The wrench acts in the platform's axes; with the force through the origin the base
    turns by less than 0.05 rad, so the impulse along x is right to 2e-3.
    """
    system = System(vehicle=FREE_FLYING)
    sim = Simulator(system)
    before, after = sim.state, sim.state
    for _ in range(80):
        after = sim.step(base_wrench=[10.0, 0, 0, 0, 0, 0])
    stacked = {
        name: np.stack([getattr(before, name), getattr(after, name)], axis=1)
        for name in ("q", "v", "y", "yd")
    }
    empty = np.zeros((1, 2, 3))
    run = Recording(
        system=system,
        servo=sim.servo,
        duration=1.0,
        t=np.array([0.0, 1.0]),
        q_cmd=empty,
        v_cmd=empty,
        tau=empty,
        w=np.zeros((1, 2, 6)),
        **stacked,
    )
    total, _ = momenta(run)
    assert total[1, 0] == pytest.approx(10.0, rel=2e-3)
