"""Admittance: from the wrench on the vehicle to the motion commanded to the platform.

The vehicle is X' = g(X, W) with X = (Y, Y') (thesis eq. 2.2). A linear vehicle is sampled
exactly, X+ = Phi X + Gamma W (eq. 2.4 to 2.6); any other g is integrated by Runge-Kutta.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy

from ves_gym._util.params import Array, ParameterError, require_one_of
from ves_gym.mechanics.spatial import AXES, body_wrench, matvec, rate_matrix, solve
from ves_gym.mechanics.vehicle import BaseModel

FORMS = ("coupled", "beam", "decoupled")
# X (n, 12), W (n, 6) generalised force conjugate to Y -> X' (n, 12)
Nonlinear = Callable[[Array, Array], Array]
_ROUNDING = 1e-12
_SUBSTEPS = 4  # Runge-Kutta steps per sample; 1e-6 of a 5 Hz mode at 80 Hz


def discretise(M: Array, D: Array, K: Array, dt: float) -> tuple[Array, Array]:
    """Sample M Y'' + D Y' + K Y = W exactly, W held over each sample (thesis eq. 2.5, 2.6).

    Args:
        M, D, K: (m, m), SI units; M positive definite (other than eq. 2.6, K may be singular).
        dt: sample time [s].

    Returns:
        Phi (2m, 2m) and Gamma (2m, m).

    Raises:
        ParameterError: M is not positive definite or dt is not > 0.
    """
    m = len(M)
    _require_mass(M)
    if not dt > 0:
        raise ParameterError(f"the sample time must be > 0 s, got {dt}")
    generator = np.zeros((3 * m, 3 * m))  # of (Y, Y', W)
    generator[:m, m : 2 * m] = np.eye(m)
    generator[m : 2 * m] = np.linalg.solve(M, np.hstack([-K, -D, np.eye(m)]))
    step = scipy.linalg.expm(generator * dt)
    return step[: 2 * m, : 2 * m], step[: 2 * m, 2 * m :]


def _require_mass(M: Array) -> None:
    lowest = float(np.linalg.eigvalsh(M)[0])
    if lowest <= 0:
        raise ParameterError(
            f"an admittance needs a positive definite M, got an eigenvalue {lowest:.3g};"
            " a vehicle without mass cannot be emulated"
        )


def coupled_axes(*matrices: Array) -> list[list[int]]:
    """Sets of axes that no given (symmetric, semidefinite) matrix couples with another set.

    What is below rounding, 1e-12 of the largest that entry could be, does not count.
    """
    joined = np.zeros(matrices[0].shape, bool)
    for k in matrices:
        size = np.sqrt(np.maximum(np.diag(k), 0.0))
        joined |= np.abs(k) > _ROUNDING * np.outer(size, size)
    count, labels = scipy.sparse.csgraph.connected_components(joined, directed=False)
    return [np.flatnonzero(labels == k).tolist() for k in range(count)]


def admittance_matrices(
    base: BaseModel, dt: float, form: str = "coupled"
) -> tuple[Array, Array]:
    """Return Phi (12, 12) and Gamma (12, 6) of a vehicle, by one of the thesis's forms.

    `coupled` treats all axes at once, `beam` each set of coupled axes, `decoupled` each
    axis alone (thesis 2.4.2: cheaper cycles for sparser models). The results agree; the
    decoupled form refuses a vehicle whose axes are coupled. A vehicle with m internal
    modes is taken as a whole, whatever the form: Phi (12 + 2m, 12 + 2m), Gamma (12 +
    2m, 6) of (Y, u, Y', u').

    Args:
        base: M, D, K and internal modes.
        dt: step [s], the wrench held over it.
        form: coupled, beam or decoupled.

    Raises:
        ParameterError: unknown form, or one that cannot hold this vehicle.
    """
    require_admittance(base, form)
    M, D, K = base.full()
    if base.m:
        transition, driven = discretise(M, D, K, dt)
        return transition, driven[:, :6]
    if form == "coupled":
        return discretise(M, D, K, dt)
    sets = coupled_axes(M, D, K)
    phi, gamma = np.zeros((12, 12)), np.zeros((12, 6))
    for axes in sets:
        part = np.ix_(axes, axes)
        a, b = discretise(M[part], D[part], K[part], dt)
        rows = [*axes, *(6 + i for i in axes)]
        phi[np.ix_(rows, rows)], gamma[np.ix_(rows, axes)] = a, b
    return phi, gamma


def require_admittance(base: BaseModel, form: str) -> None:
    """Check that a linear vehicle can be emulated.

    Args:
        base: M, D, K and internal modes.
        form: coupled, beam or decoupled.

    Raises:
        ParameterError: unknown form, or one that cannot hold this vehicle, or no mass.
    """
    require_one_of("admittance form", form, FORMS)
    M, D, K = base.full()
    if form == "decoupled" and not base.m:
        sets = coupled_axes(M, D, K)
        if len(sets) < 6:
            pair = next(s for s in sets if len(s) > 1)
            raise ParameterError(
                "the decoupled admittance form needs diagonal M, D and K, got coupling among"
                f" {', '.join(AXES[i] for i in pair)}"
            )
    _require_mass(M)


def rigid_bodies(inertia: Array, M: Array, D: Array, K: Array) -> Nonlinear:
    """Return g(X, W) of satellites: Newton-Euler, plus constant M, D, K.

    Args:
        inertia: (6, 6) spatial inertia of the body, or (n, 6, 6) of n bodies.
        M, D, K: alike.
    """

    def g(X: Array, W: Array) -> Array:
        y, yd = X[..., :6], X[..., 6:]
        T = rate_matrix(y)
        turned = np.swapaxes(T, -1, -2)
        bias = matvec(turned, body_wrench(inertia, y, yd, 0.0 * y))
        bias = bias + matvec(D, yd) + matvec(K, y)
        ydd = solve(turned @ inertia @ T + M, W - bias)
        return np.concatenate([yd, ydd], axis=-1)

    return g


def integrate(g: Nonlinear, X: Array, W: Array, dt: float) -> Array:
    """Advance X' = g(X, W) by a step of Runge-Kutta 4, W held.

    Args:
        g: rate of the state.
        X: (n, 12) pose and rate.
        W: (n, 6) wrench [N, N m].
        dt: step [s].
    """
    h = dt / _SUBSTEPS
    for _ in range(_SUBSTEPS):
        a = g(X, W)
        b = g(X + h / 2 * a, W)
        c = g(X + h / 2 * b, W)
        d = g(X + h * c, W)
        X = X + h / 6 * (a + 2 * b + 2 * c + d)
    return X


def implicit_step(M: Array, D: Array, K: Array, X: Array, W: Array, dt: float) -> Array:
    """Advance M Y'' + D Y' + K Y = W by the trapezoidal rule.

    For a mass that changes from sample to sample, where a new matrix exponential each time
    would cost more than the simulation; stable at any dt.

    Args:
        M, D, K: (n, m, m).
        X: (n, 2m) coordinates and rates.
        W: (n, m) force, held.
        dt: step [s].

    Returns:
        (n, 2m).
    """
    m = X.shape[-1] // 2
    y, yd = X[..., :m], X[..., m:]
    loss = dt / 2 * D + dt**2 / 4 * K
    # Y+ = Y + dt (Y' + Y'+) / 2 put into the sampled balance of momentum
    push = matvec(M - loss, yd) + dt * (W - matvec(K, y))
    rate = solve(M + loss, push)
    return np.concatenate([y + dt / 2 * (yd + rate), rate], axis=-1)
