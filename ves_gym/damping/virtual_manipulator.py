"""The virtual manipulator (thesis 4.3.1, B.5, B.6): PPED gains for arms on soft bases.

A free-floating arm moves as if massless virtual links joined its base to its centre of
mass, which stands still (Vafa and Dubowsky). Base and arm then are two masses with a
Cartesian spring and damper K_d, B_d between them. These are tuned, and become joint gains
by eq. 4.1 and 4.2. The thesis does not print the two-mass model; ours is exact for an arm
of point masses that its joints move freely, and poor where links and rotors resist turning.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import Array
from ves_gym.damping.analysis import THESIS_DISPLACEMENT
from ves_gym.damping.plant import GainMatrices, LinearPlant, plant_at
from ves_gym.damping.tuning import WIDE, Bounds, Tuned, tune
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.dynamics import inertia
from ves_gym.mechanics.spatial import skew
from ves_gym.system.system import System

# of the Cartesian spring and damper, far wider than what any joint gives
CARTESIAN = Bounds(K=(1.0, 1e7), B=(0.1, 1e6))  # N/m, N s/m


def virtual_jacobian(arm: Arm, q: npt.ArrayLike) -> Array:
    """J_vm: velocity of the base seen from the centre of mass, per joint rate.

    By the momentum H_bm of the joints: what the arm pushes one way, its base goes the other.

    Args:
        arm: n joints.
        q: (..., n) configurations [rad].

    Returns:
        (..., 3, n) [m].
    """
    jacobian: Array = -inertia(arm, q)[..., :3, 6:] / arm.mass
    return jacobian


def joint_gains(arm: Arm, q: npt.ArrayLike, cartesian: GainMatrices) -> GainMatrices:
    """Thesis eq. 4.1 and 4.2: K_vm = J_vm^T K_d J_vm, B_vm = J_vm^T B_d J_vm.

    Args:
        arm: n joints.
        q: (n,) configuration [rad].
        cartesian: K_d [N/m] and B_d [N s/m], (3, 3) each.

    Returns:
        K [N m/rad] and B [N m s/rad], (n, n) each.
    """
    J = virtual_jacobian(arm, q)
    return GainMatrices(J.T @ cartesian.K @ J, J.T @ cartesian.B @ J)


def two_masses(system: System, q: npt.ArrayLike) -> LinearPlant:
    """The vehicle and, beside it, the arm as one mass at its centre: thesis figure 4-3.

    z = (Y, c), c the displacement of the arm's centre of mass [m]; the gains act on c less
    what the base carries it along.

    Args:
        system: arm and vehicle, on motor drives.
        q: (n,) configuration [rad].

    Returns:
        The linear model, of nine coordinates and three gains.

    Raises:
        ParameterError: as `plant_at`.
    """
    arm, base = system.arm, system.base
    model = plant_at(system, q)  # refuses what has no stiffness, or no motors
    H, m = model.mass[:6, :6] - base.mass_matrix, arm.mass  # of the arm, joints locked
    # centre of mass from the first moment in the spatial inertia (`Inertial.spatial`)
    com = np.array([H[5, 1], H[3, 2], H[4, 0]]) / m
    w = 9 + base.m  # coordinates: Y, c, internal modes
    M, D, K = (np.zeros((w, w)) for _ in range(3))
    at = np.r_[:6, 9:w]
    for part, block in zip((M, D, K), base.full(), strict=True):
        part[at[:, None], at] = block
    M[6:9, 6:9] = m * np.eye(3)
    carried = np.hstack([np.eye(3), -skew(com)])  # displacement of the centre with the base
    port = np.hstack([-carried, np.eye(3), np.zeros((3, base.m))])
    free, drive = np.zeros((2 * w, 2 * w)), np.zeros((2 * w, 3))
    free[:w, w:] = np.eye(w)
    free[w:] = np.linalg.solve(M, np.hstack([-K, -D]))
    drive[w:] = np.linalg.solve(M, port.T)
    return LinearPlant(
        free=free,
        drive=drive,
        port=port,
        displacement_map=np.vstack([np.eye(6), carried, base.attached(np.eye(6)).T]),
        K=model.K,
        mass=model.mass,
    )


@dataclass(frozen=True, eq=False, kw_only=True)
class VirtualGains:
    """Gains by way of the virtual manipulator."""

    gains: (
        GainMatrices  # of the joints, eq. 4.1 and 4.2, and the least gains in every direction
    )
    cartesian: GainMatrices  # K_d, B_d, (3, 3) [N/m, N s/m]
    search: Tuned  # what the two masses promise


def tune_virtual(
    system: System,
    q: npt.ArrayLike,
    objective: str = "strain",
    *,
    y: npt.ArrayLike = THESIS_DISPLACEMENT,
    full: bool = False,
    bounds: Bounds = WIDE,
    seed: int = 0,
) -> VirtualGains:
    """Tune the two masses and turn K_d, B_d into joint gains; judge them with `analyse`.

    J_vm has rank 3 at most, so the least gains of `bounds` are added: no joint is left free.
    The largest are not enforced.

    Args:
        system: arm and vehicle, on motor drives.
        q: (n,) configuration [rad].
        objective: one of `tuning.OBJECTIVES`.
        y: (6,) initial displacement of "strain" [m, rad].
        full: symmetric K_d and B_d instead of diagonal ones.
        bounds: of the joint gains [N m/rad, N m s/rad].
        seed: of the random starts.

    Returns:
        Joint gains, Cartesian gains, and the search on the two masses.
    """
    search = tune(two_masses(system, q), objective, y=y, full=full, bounds=CARTESIAN, seed=seed)
    joint = joint_gains(system.arm, q, search.gains)
    least = np.eye(system.arm.n)
    gains = GainMatrices(joint.K + bounds.K[0] * least, joint.B + bounds.B[0] * least)
    return VirtualGains(gains=gains, cartesian=search.gains, search=search)
