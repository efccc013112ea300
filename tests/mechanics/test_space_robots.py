"""Free-floating robots against SPARTpy: recorded figures, and SPARTpy where it is installed."""

import dataclasses

import numpy as np
import pytest

from tests.planners.test_reaction_null import null_curve
from tests.space_robots import (
    CHASER,
    ETS_VII,
    ETS_VII_Q,
    GOAL,
    PLANAR,
    PLANAR_Q,
    RATE,
    TURN,
    Q,
    Robot,
    planar_motion,
    possible,
)
from ves_gym._util.params import ParameterError
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.dynamics import inertia, newton_euler
from ves_gym.mechanics.kinematics import frames
from ves_gym.mechanics.link import Inertial, diagonal
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.spatial import rotation
from ves_gym.mechanics.vehicle import Satellite
from ves_gym.simulation.playback import play_motions
from ves_gym.system.system import System

# SPARTpy 1.1.3: python -m tests.space_robots
INERTIA = [
    *(7.429081628569051e02, 3.041287124658934e03, 3.008993516453086e03),
    *(1.661200000000000e03, 1.661200000000000e03, 1.661200000000000e03),
    *(4.292882393755068e01, 5.562129484692445e02, 1.575947084550985e01),
    *(1.128879506681599e02, 6.498602123964324e-01, 1.428125937487634e00, 1.709999999999998e-02),
]  # diagonal, kg m^2 and kg
RESPONSE = [
    *(0.006732153028648, 0.036991155424638, -0.005179530647591),
    *(0.007356800436377, 0.000216471173472, -0.006273414357572),
]  # rad/s, m/s at RATE
FORCES = [
    *(-1.686450371818194e00, -1.490680971503401e02, 1.020842011278787e02),
    *(2.002282288542384e01, 8.971074012999114e01, 1.207835833714813e02),
    *(-8.687125228267586e00, 8.907548323769392e01, 2.070082968132373e01),
    *(-1.049591407261452e01, 8.130391896523282e-01, 1.918538359694137e00),
    9.979139464114787e-04,
]  # N m, N, N m
ACCELERATIONS = [
    *(-3.847271228703620e-08, 2.132281308664882e-02, -1.950043489844183e-02),
    *(2.087988599141810e-02, -2.020882166430854e-03, 2.230136461926499e-03),
    *(-1.365644016154737e00, -1.332229688318522e-01, -2.715519144076515e00),
    *(-1.364073927353825e00, 9.385613699183137e-02, 6.987727232505704e00, 4.128728128876489e02),
]  # rad/s^2, m/s^2, rad/s^2
JACOBIAN = [
    [-0.229719519579091, -0.14005685154302, -0.425066092363827, -0.151731627691832],
    [0.510663331893984, 0.538571705297025, 0.416520204553726, 0.323137392358959],
    [0.395288741039012, 0.629714244131548, 0.799188319329349, 0.929699739098921],
]  # m/rad, m/rad, 1
RESOLVED = [
    *(1.192437353563027, -0.513051945942599, 1.171610260013284, -0.710133703615197),
    *(0.009585915791239, -0.010581677534099, -0.540861963518515),
]  # joints, then base: x, y, angle
ATTITUDE = [
    *(-6.422455936524974e-03, -6.903215547732604e-03, 1.898682214524075e-03),
    *(-1.288316028180026e-03, 2.002417601632193e-04, -1.022507597594331e-05),
    *(2.146601778167543e-03, 2.416391330554270e-02, -1.063895915578136e-02),
    *(3.549954556973543e-03, 1.161745749140149e-03, -6.178635333437594e-05),
    *(-4.151820303575435e-03, -1.465007923499175e-03, 1.222605068560298e-04),
    *(-1.909866437995525e-04, -2.866135669905545e-05, -1.865221682968969e-06),
]  # ETS-VII: rad/s of the base per rad/s, axis by axis

U = np.concatenate([RATE[:6], RATE])


@pytest.fixture
def arm(tmp_path):
    """Read a robot as an Arm whose base link is the satellite."""

    def read(robot: Robot) -> Arm:
        path = tmp_path / "robot.urdf"
        path.write_text(robot.urdf())
        return Arm.from_file(path)

    return read


def order(n, R):
    """(6 + n, 6 + n): our base twist (linear first, base axes) and rates to SPARTpy's."""
    T = np.eye(6 + n)
    T[:6, :6] = 0.0
    T[:3, 3:6], T[3:6, :3] = np.eye(3), R
    return T


def generalised_inertia(arm, q, R):
    T = order(arm.n, R)
    return T @ inertia(arm, q) @ T.T


def forces(arm, R, q, u, udot):
    tau, wrench = newton_euler(
        arm, q, u[6:], udot[6:], spin=u[:3], turn=udot[:3], accel=R.T @ udot[3:6]
    )
    return np.concatenate([wrench[3:], R @ wrench[:3], tau])


def accelerations(arm, R, q, u, tau):
    bias = forces(arm, R, q, u, np.zeros_like(u))
    return np.linalg.solve(generalised_inertia(arm, q, R), tau - bias)


def response(arm, q, R):
    H = generalised_inertia(arm, q, R)
    return -np.linalg.solve(H[:6, :6], H[:6, 6:])


def jacobian(arm, q, R):
    """(6, n) generalised Jacobian of the tool: angular first, inertial axes."""
    at = frames(arm, q)
    tip, axes = at.position[-1], at.axis
    levers = tip - at.origin
    base = response(arm, q, R)
    turning = R @ base[:3]
    linear = base[3:] + np.cross(turning.T, R @ tip).T + R @ np.cross(axes, levers).T
    return np.concatenate([turning + R @ axes.T, linear])


def free(arm):
    """The robot as this package simulates it: the base link is the vehicle."""
    nothing = Inertial(mass=0.0, com=(0.0, 0.0, 0.0), inertia=diagonal(0.0, 0.0, 0.0))
    return System(
        arm=dataclasses.replace(arm, base=nothing),
        vehicle=Satellite(body=arm.base, source="elsewhere"),
        drive="prescribed",
    )


def close(ours, theirs, digits):
    assert np.abs(ours - theirs).max() <= 10.0**-digits * np.abs(theirs).max()


def test_dynamics_as_recorded(arm):
    chaser = arm(CHASER)
    close(np.diag(generalised_inertia(chaser, Q, np.eye(3))), INERTIA, 11)
    close(response(chaser, Q, np.eye(3)) @ RATE, RESPONSE, 11)
    close(forces(chaser, TURN, Q, U, U / 10), FORCES, 11)
    close(accelerations(chaser, TURN, Q, U, 10 * U), ACCELERATIONS, 9)


def test_generalised_jacobian_as_recorded(arm):
    planar = arm(PLANAR)
    close(jacobian(planar, PLANAR_Q, np.eye(3))[[3, 4, 2]], JACOBIAN, 12)


def test_resolved_motion_in_simulation(arm):
    """The tool goes along the line in space, and the base ends where SPARTpy puts it."""
    planar = arm(PLANAR)
    path = planar_motion(lambda *at: jacobian(planar, *at), lambda *at: response(planar, *at))
    close(path[-1], np.array(RESOLVED), 7)
    run = play_motions(free(planar), [Motion.fit(path[:, :4], 5.0)], settle=0.0)
    y, q = run.y[0], run.q[0]
    tool = np.array(
        [
            rotation(yk) @ frames(planar, qk).position[-1] + yk[:3]
            for yk, qk in zip(y, q, strict=True)
        ]
    )
    angle = y[:, 5] + q.sum(axis=1)
    moved = np.column_stack([tool[:, :2], angle])
    moved -= moved[0]
    share = moved @ GOAL / (GOAL @ GOAL)
    assert np.abs(moved - share[:, None] * GOAL).max() < 1e-6  # m, rad off the line
    assert np.abs(moved[-1] - GOAL).max() < 1e-6
    assert np.abs(y[-1, [0, 1, 5]] - RESOLVED[4:]).max() < 1e-6
    assert np.abs(y[:, 5]).max() > 0.5  # the base did turn: 31 deg


def test_zero_reaction_manoeuvre_of_ets_vii(arm):
    """The satellite keeps its attitude; straight between the same ends it does not."""
    ets = arm(possible(ETS_VII))
    close(response(ets, ETS_VII_Q, np.eye(3))[:3].ravel(), ATTITUDE, 11)
    system = free(ets)
    path = null_curve(system, ETS_VII_Q, np.eye(6)[2], 2.0, attitude=True)
    assert np.abs(path[-1] - path[0]).max() > 1.0
    motions = [Motion.through(path, 20.0), Motion.straight(path[0], path[-1], 20.0)]
    run = play_motions(system, motions, settle=0.0, record_dt=0.1)
    along, straight = np.rad2deg(np.abs(run.y[:, :, 3:]).max(axis=(1, 2)))
    assert along < 1e-5
    assert straight > 0.2


def test_inertias_of_ets_vii_as_transcribed_are_refused(arm):
    with pytest.raises(ParameterError, match=r"body1: no rigid body.*1\.69"):
        arm(ETS_VII)
