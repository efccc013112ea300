"""The arm's weight, and the minimal parameters that predict it (thesis 3.4, App. C)."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.arms import planar_arm, six_joint_arm
from ves_gym._util.params import ParameterError
from ves_gym.engine.mjcf import TO_Y
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.arm_files import pinocchio_model
from ves_gym.mechanics.arm_library import PUMA_560
from ves_gym.mechanics.dynamics import inverse_dynamics
from ves_gym.mechanics.gravity import (
    GravityModel,
    gravity_vector,
    mass_parameters,
    minimal_model,
    moment_regressor,
)
from ves_gym.mechanics.link import Inertial, Link, diagonal
from ves_gym.mechanics.side_by_side import side_by_side
from ves_gym.mechanics.vehicle import VEHICLES
from ves_gym.system.system import System


def random_arm(seed: int) -> Arm:
    """One to six joints, any lengths and twists, some of them parallel or at right angles."""
    rng = np.random.default_rng(seed)

    def body():
        com = tuple(rng.uniform(-0.5, 0.5, 3).tolist())
        return Inertial(mass=rng.uniform(0.1, 20), com=com, inertia=diagonal(0.1, 0.1, 0.1))

    def link():
        alpha = rng.choice([0.0, np.pi / 2, -np.pi / 2, np.pi, rng.uniform(-np.pi, np.pi)])
        return Link(
            d=rng.choice([0.0, rng.uniform(-1, 1)]),
            a=rng.choice([0.0, rng.uniform(-1, 1)]),
            alpha=float(alpha),
            offset=rng.uniform(-1, 1),
            inertial=body(),
            q_min=-3.0,
            q_max=3.0,
            v_max=1.0,
            a_max=1.0,
            tau_max=1.0,
        )

    links = tuple(link() for _ in range(rng.integers(1, 7)))
    return Arm(name=f"random-{seed}", base=body(), links=links, source="test")


ARMS = {
    "puma": PUMA_560,
    "planar": planar_arm(),
    "wrist": six_joint_arm(),
    "two arms": side_by_side([random_arm(7).at((0.3, 0.2, 0.1), (0.3, 0.0, 0.5)), PUMA_560]),
    **{f"random-{seed}": random_arm(seed) for seed in range(6)},
}
each_arm = pytest.mark.parametrize("arm", ARMS.values(), ids=ARMS.keys())
seeds = st.integers(0, 2**32 - 1)


def draw(arm, shape=(), seed=0):
    rng = np.random.default_rng(seed)
    return rng.uniform(-3, 3, (*shape, arm.n)), rng.uniform(-1.2, 1.2, (*shape, 6))


def test_puma_has_the_nine_parameters_of_the_thesis_in_order():
    """C.2, with P6 restored and m0 d0 left out of P3 (docs/errata.md); d1 is d0 + d1 there."""
    model = minimal_model(PUMA_560)
    assert model.descriptions == (
        "m0 r0x",
        "m0 r0y",
        "m0 r0z + m1 r1y + (m1 + m2 + m3) d1",
        "m1 r1x",
        "m1 r1z + m2 r2z + (m2 + m3) d2 + m3 r3z + m3 d3",
        "m2 r2x + (m2 + m3) a2",
        "m2 r2y",
        "m3 r3x + m3 a3",
        "m3 r3y",
    )
    assert model.size == 9
    assert [text.startswith(n) for text, n in zip(model.descriptions, model.names, strict=True)]


def test_puma_parameters_are_those_measured():
    """C.3 'physically measured': m3 = 8.99 kg, d3 = 0.0934 m, r1z = 0; half a last digit."""
    one, two, three = PUMA_560.links
    measured = dataclasses.replace(
        PUMA_560,
        links=(
            dataclasses.replace(one, inertial=dataclasses.replace(one.inertial, com=(0, 0, 0))),
            two,
            dataclasses.replace(
                three, d=0.0934, inertial=dataclasses.replace(three.inertial, mass=8.99)
            ),
        ),
    )
    P = minimal_model(measured).parameters()
    np.testing.assert_allclose(P[[0, 1, 3, 8]], 0, atol=1e-15)
    np.testing.assert_allclose(P[[4, 5, 7]], [-5.308, 5.065, 2.617], atol=5e-4)
    assert P[6] == pytest.approx(0.1044, abs=5e-5)


@each_arm
def test_minimal_size_is_the_rank_of_pinocchio_s_regressor(arm):
    """Moment rows of the base joints, columns of base and links, any free fall."""
    pin = pytest.importorskip("pinocchio")
    base = dataclasses.replace(System(vehicle=VEHICLES["free-floating"]).base, body=None)
    model = pinocchio_model(arm, base)
    data, rng, rows = model.createData(), np.random.default_rng(1), []
    zero = np.zeros(6 + arm.n)
    for q in rng.uniform(-3, 3, (40, arm.n)):
        model.gravity.linear[:] = rng.standard_normal(3)
        Y = pin.computeJointTorqueRegressor(model, data, np.r_[np.zeros(6), q], zero, zero)
        rows.append(Y[3:6, 50:])
    assert np.linalg.matrix_rank(np.vstack(rows), rtol=1e-9) == minimal_model(arm).size
    C = minimal_model(arm).regressor(rng.uniform(-3, 3, (40, arm.n)))
    assert np.linalg.cond(C.reshape(120, -1)) < 1e3  # what is kept is well determined


@each_arm
def test_weight_agrees_with_inverse_dynamics_and_pinocchio(arm):
    """Tolerance: rounding of up to 1 kN m."""
    q, y = draw(arm, (20,))
    g = gravity_vector(y)
    found = GravityModel.of(arm).wrench(arm, q, y)
    rest = np.zeros_like(q)
    expected = inverse_dynamics(arm, q, rest, rest, gravity=g)[1]
    np.testing.assert_allclose(found, expected, rtol=0, atol=2e-12)

    pin = pytest.importorskip("pinocchio")
    base = dataclasses.replace(System(vehicle=VEHICLES["free-floating"]).base, body=None)
    model = pinocchio_model(arm, base)
    data, still = model.createData(), np.zeros(6 + arm.n)
    for k in range(len(q)):
        model.gravity.linear[:] = g[k]
        force = pin.rnea(model, data, np.r_[np.zeros(6), q[k]], still, still)
        np.testing.assert_allclose(found[k], -force[TO_Y], rtol=0, atol=1e-11)


@given(seeds)
@settings(max_examples=50, deadline=None)
def test_minimal_parameters_lose_nothing(seed):
    """For any arm and masses, c = W mass_parameters = C P and moment = G P."""
    arm = random_arm(seed)
    q, y = draw(arm, (3,), seed)
    model, g = minimal_model(arm), gravity_vector(y)
    P = model.parameters()
    assert model.size == 3 + 2 * arm.n == len(set(model.names))
    moment = moment_regressor(arm, q) @ mass_parameters(arm)
    np.testing.assert_allclose(model.regressor(q) @ P, moment, rtol=0, atol=1e-11)
    np.testing.assert_allclose(model.G(q, g) @ P, np.cross(moment, g), rtol=0, atol=1e-10)
    wrench = GravityModel.of(arm).wrench(arm, q, y)
    np.testing.assert_allclose(wrench[:, 3:], model.G(q, g) @ P, rtol=0, atol=1e-10)


def test_bad_input_is_named():
    q, y = draw(PUMA_560)
    with pytest.raises(ParameterError, match="mass must be > 0 kg"):
        GravityModel(mass=-1.0, P=(0.0,) * 9)
    with pytest.raises(ParameterError, match="finite"):
        GravityModel(mass=1.0, P=(np.nan,) * 9)
    with pytest.raises(ParameterError, match="9 entries"):
        GravityModel(mass=1.0, P=(0.0,) * 8).wrench(PUMA_560, q, y)
    with pytest.raises(ParameterError, match=r"\(\.\.\., 3\)"):
        minimal_model(PUMA_560).regressor(np.zeros(2))
    with pytest.raises(ParameterError, match="geometry"):
        minimal_model(PUMA_560).parameters(planar_arm())
