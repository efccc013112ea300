"""The admittance: sampled exactly, in three forms; other vehicles to the order stated."""

import dataclasses

import numpy as np
import pytest
import scipy.signal

from ves_gym._util.params import ParameterError
from ves_gym.hardware.admittance import (
    admittance_matrices,
    coupled_axes,
    discretise,
    implicit_step,
    integrate,
    rigid_bodies,
)
from ves_gym.mechanics.link import diagonal
from ves_gym.mechanics.spatial import matvec, rotation, skew, twist
from ves_gym.mechanics.vehicle import (
    BENT_THESIS,
    DECOUPLED,
    FREE_FLOATING,
    STRAIGHT_HORIZONTAL_THESIS,
    STRAIGHT_VERTICAL_THESIS,
    MatrixVehicle,
)

DT = 12.5e-3


def linear(M, D, K):
    """X' = g(X, W) of M Y'' + D Y' + K Y = W."""

    def g(X, W):
        m = W.shape[-1]
        y, yd = X[..., :m], X[..., m:]
        ydd = np.linalg.solve(M, (W - yd @ D.T - y @ K.T).T).T
        return np.concatenate([yd, ydd], axis=-1)

    return g


# ------------------------------------------------------------------------- sampling


@pytest.mark.parametrize(
    "vehicle", [BENT_THESIS, STRAIGHT_VERTICAL_THESIS, DECOUPLED], ids=lambda v: v.kind
)
def test_phi_and_gamma_are_those_of_a_zero_order_hold(vehicle):
    """Against scipy.signal.cont2discrete on the state-space form.

    Tolerance: rounding of two matrix exponentials, entries up to the fastest rate.
    """
    base = vehicle.base_model()
    M = base.mass_matrix
    A = np.block([[np.zeros((6, 6)), np.eye(6)], [np.linalg.solve(M, -np.c_[base.K, base.D])]])
    B = np.vstack([np.zeros((6, 6)), np.linalg.inv(M)])
    want = scipy.signal.cont2discrete((A, B, np.eye(12), np.zeros((12, 6))), DT, "zoh")
    phi, gamma = admittance_matrices(base, DT)
    np.testing.assert_allclose(phi, want[0], rtol=0, atol=1e-11 * np.abs(want[0]).max())
    np.testing.assert_allclose(gamma, want[1], rtol=0, atol=1e-11 * np.abs(want[1]).max())


def test_a_vehicle_without_stiffness_drifts():
    """K = 0 (thesis eq. 2.6 would divide by it): uniform acceleration, exactly."""
    m, dt = 5.0, 0.2
    phi, gamma = discretise(np.array([[m]]), np.zeros((1, 1)), np.zeros((1, 1)), dt)
    np.testing.assert_allclose(phi, [[1, dt], [0, 1]], atol=1e-15)
    np.testing.assert_allclose(gamma[:, 0], [dt**2 / 2 / m, dt / m], rtol=1e-14)


def test_a_vehicle_without_mass_is_refused():
    massless = MatrixVehicle(
        M=diagonal(1, 1, 1, 1, 1, 0), D=diagonal(*[1] * 6), K=diagonal(*[1] * 6)
    )
    with pytest.raises(ParameterError, match="without mass cannot be emulated"):
        admittance_matrices(massless.base_model(), DT)


# ---------------------------------------------------------------------------- forms


@pytest.mark.parametrize(
    ("vehicle", "sets"),
    [
        (DECOUPLED, 6),
        (STRAIGHT_VERTICAL_THESIS, 4),  # x with phi_y, y with phi_x
        (STRAIGHT_HORIZONTAL_THESIS, 4),
        (BENT_THESIS, 2),  # in its plane and across
    ],
    ids=["decoupled", "vertical", "horizontal", "bent-thesis"],
)
def test_the_three_forms_give_one_result(vehicle, sets):
    """Tolerance 1e-12: sets of axes are exponentiated apart, else nothing differs."""
    base = vehicle.base_model()
    assert len(coupled_axes(base.mass_matrix, base.D, base.K)) == sets
    phi, gamma = admittance_matrices(base, DT, "coupled")
    forms = ["beam"] + ["decoupled"] * (sets == 6)
    for form in forms:
        a, b = admittance_matrices(base, DT, form)
        np.testing.assert_allclose(a, phi, rtol=0, atol=1e-12 * np.abs(phi).max())
        np.testing.assert_allclose(b, gamma, rtol=0, atol=1e-12 * np.abs(gamma).max())
        assert ((a != 0) | (np.abs(phi) < 1e-12 * np.abs(phi).max())).all()


def test_the_decoupled_form_names_the_axes_that_are_coupled():
    with pytest.raises(
        ParameterError, match=r"diagonal M, D and K, got coupling among x, phi_y"
    ):
        admittance_matrices(STRAIGHT_VERTICAL_THESIS.base_model(), DT, "decoupled")
    # one small number anywhere is enough, in D alone too
    D = np.array(DECOUPLED.D)
    D[1, 5] = D[5, 1] = 1e-9
    base = dataclasses.replace(DECOUPLED.base_model(), D=D)
    with pytest.raises(ParameterError, match="coupling among y, phi_z"):
        admittance_matrices(base, DT, "decoupled")
    with pytest.raises(ParameterError, match="coupled, beam, decoupled, got 'diagonal'"):
        admittance_matrices(base, DT, "diagonal")


# ---------------------------------------------------------------------- Runge-Kutta


def test_runge_kutta_approaches_the_exact_step_with_order_four():
    """A damped, coupled linear vehicle under a held wrench, against its exact sampling."""
    base = BENT_THESIS.base_model()
    g = linear(base.M, base.D, base.K)
    rng = np.random.default_rng(0)
    X0, W = rng.normal(size=(3, 12)) * 1e-2, rng.normal(size=(3, 6)) * 100
    errors = []
    for steps in (4, 8, 16):
        dt = 0.4 / steps
        phi, gamma = admittance_matrices(base, dt)
        X = exact = X0
        for _ in range(steps):
            X, exact = integrate(g, X, W, dt), exact @ phi.T + W @ gamma.T
        errors.append(np.abs(X - exact).max())
    order = np.log2(np.array(errors[:-1]) / errors[1:])
    np.testing.assert_allclose(order, 4.0, atol=0.3)


def test_a_satellite_keeps_its_momentum():
    """Linear and angular momentum in inertial axes, four seconds of tumbling at 0.5 rad/s.

    Tolerance: Runge-Kutta 4 at 3 ms, some (w h)^4 = 1e-11 per radian.
    """
    body = FREE_FLOATING.body
    moments = diagonal(187.5, 120.0, 90.0)  # a cube would not tumble
    body = dataclasses.replace(body, inertia=moments)
    base = dataclasses.replace(FREE_FLOATING, body=body).base_model()
    inertia = body.spatial()
    g = rigid_bodies(inertia, base.M, base.D, base.K)

    def momentum(X):
        y = X[:, :6]
        h = matvec(inertia, twist(y, X[:, 6:]))
        R = rotation(y)
        p = matvec(R, h[:, :3])
        return np.hstack([p, matvec(R, h[:, 3:]) + np.cross(y[:, :3], p)])

    X = np.zeros((2, 12))
    X[:, 6:] = [[0.1, -0.2, 0.05, 0.3, 0.2, -0.35], [0, 0, 0, 0.5, 0.01, 0.02]]
    before, start = momentum(X), X
    for _ in range(200):
        X = integrate(g, X, np.zeros((2, 6)), DT)
    assert np.abs(X[:, 3:6] - start[:, 3:6]).max() > 0.5  # it did turn
    np.testing.assert_allclose(momentum(X), before, rtol=0, atol=1e-8 * np.abs(before).max())


def test_a_wrench_changes_the_satellites_momentum_at_its_own_rate():
    """Newton and Euler at one instant: m a of the centre of mass, I w' about it."""
    body = FREE_FLOATING.body
    g = rigid_bodies(body.spatial(), *np.zeros((3, 6, 6)))
    W = np.array([[3.0, -2.0, 5.0, 1.0, 4.0, -6.0]])
    ydd = g(np.zeros((1, 12)), W)[0, 6:]
    com = np.array(body.com)
    a = ydd[:3] + np.cross(ydd[3:], com)
    np.testing.assert_allclose(body.mass * a, W[0, :3], rtol=1e-12)
    moment = W[0, 3:] - skew(com) @ W[0, :3]
    np.testing.assert_allclose(np.array(body.inertia) @ ydd[3:], moment, rtol=1e-12)


# ------------------------------------------------------------------------- implicit


def test_the_trapezoidal_rule_has_order_two():
    base = BENT_THESIS.base_model()
    M, D, K = base.M, base.D, base.K
    rng = np.random.default_rng(1)
    X0, W = rng.normal(size=(2, 12)) * 1e-2, rng.normal(size=(2, 6)) * 100
    errors = []
    for steps in (40, 80, 160):
        dt = 0.4 / steps
        phi, gamma = admittance_matrices(base, dt)
        X = exact = X0
        for _ in range(steps):
            X = implicit_step(np.array([M] * 2), D, K, X, W, dt)
            exact = exact @ phi.T + W @ gamma.T
        errors.append(np.abs(X - exact).max())
    order = np.log2(np.array(errors[:-1]) / errors[1:])
    np.testing.assert_allclose(order, 2.0, atol=0.2)


@pytest.mark.parametrize("dt", [1e-3, 12.5e-3, 1.0])
def test_the_trapezoidal_rule_is_stable_however_stiff(dt):
    """Spectral radius of the step with a 1 Hz and a 16 kHz mode, undamped and damped.

    Tolerance: rounding of the solve, condition 1e10.
    """
    M, K = np.array([[5.0, 1.0], [1.0, 3.0]]), np.diag([200.0, 3e10])
    for D in (np.zeros((2, 2)), 1e-4 * K):
        step = implicit_step(
            np.array([M] * 4), D, K, np.eye(4), np.zeros((4, 2)), dt
        )  # rows: images of the unit states
        scaled = step.T * np.array([1, 1, dt, dt]) / np.array([1, 1, dt, dt])[:, None]
        assert np.abs(np.linalg.eigvals(scaled)).max() < 1 + 1e-6
