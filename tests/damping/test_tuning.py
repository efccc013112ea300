"""PPED: the linear plant, its measures, their gradients, the search; best configurations."""

import dataclasses

import numpy as np
import pytest

from tests.arms import WRIST_GAINS, pinocchio_terms, six_joint_arm
from ves_gym._util.params import ParameterError
from ves_gym.damping.configurations import best_configurations, damping_map, estimated_integral
from ves_gym.damping.plant import (
    THESIS_DISPLACEMENT,
    GainMatrices,
    analyse,
    estimator,
    plant_at,
    respond,
)
from ves_gym.damping.tuning import OBJECTIVES, Bounds, objective_of, tune
from ves_gym.engine.mjcf import TO_Y
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.arm_files import pinocchio_model
from ves_gym.mechanics.arm_library import PUMA_560
from ves_gym.mechanics.link import matrix
from ves_gym.mechanics.servo import HIGH_GAINS, PPED_GAINS, JointServo
from ves_gym.mechanics.vehicle import (
    BENT_THESIS,
    DECOUPLED,
    FREE_FLOATING,
    MatrixVehicle,
)
from ves_gym.planners.coupling import coupling_matrix, modes
from ves_gym.system.system import System

BENT = System(vehicle=BENT_THESIS)

Q = np.deg2rad([45.0, 0.0, 0.0])
FULL = GainMatrices(  # symmetric, positive definite
    np.array([[300.0, 80, -20], [80, 200, 40], [-20, 40, 90]]),
    np.array([[20.0, 4, 1], [4, 15, -3], [1, -3, 8]]),
)
SYSTEMS = {
    "bent, full gains": (BENT, FULL),
    "six joints": (
        System(arm=six_joint_arm(), vehicle=DECOUPLED),
        GainMatrices.of(WRIST_GAINS),
    ),
}


def bent(q=Q):
    return plant_at(BENT, q)


# ------------------------------------------------------------------------- the plant


@pytest.mark.parametrize("name", ["bent, full gains", "six joints"])
def test_the_plant_is_pinocchios_inertia_with_the_vehicles_matrices(name):
    """(H_pin + M) z'' + D z' + K z = 0, gains on the joints. Tolerance: rounding."""
    system, gains = SYSTEMS[name]
    n, rng = system.arm.n, np.random.default_rng(0)
    model = pinocchio_model(system.arm, system.base)
    order = np.r_[TO_Y, 6 : 6 + n]
    for q in 0.5 * rng.uniform(system.arm.column("q_min"), system.arm.column("q_max"), (2, n)):
        at = np.r_[np.zeros(6), q]
        M = pinocchio_terms(model, model.createData(), at, 0 * at)[0][np.ix_(order, order)]
        M[:6, :6] += system.base.M
        D, K = np.zeros((2, 6 + n, 6 + n))
        D[:6, :6], K[:6, :6] = system.base.D, system.base.K
        D[6:, 6:], K[6:, 6:] = gains.B, gains.K
        expected = np.linalg.solve(M, np.hstack([-K, -D]))
        closed = plant_at(system, q).closed(gains)
        np.testing.assert_allclose(
            closed[6 + n :], expected, atol=1e-9 * np.abs(expected).max()
        )
        np.testing.assert_array_equal(closed[: 6 + n], np.eye(6 + n, 2 * (6 + n), 6 + n))


@pytest.mark.parametrize(
    ("system", "q", "message"),
    [
        (System(vehicle=FREE_FLOATING), Q, "stiffness in all six directions"),
        (
            System(vehicle=BENT_THESIS, drive="prescribed"),
            Q,
            "needs drive motor, not prescribed",
        ),
        (System(vehicle=BENT_THESIS, mode="emulated"), Q, "needs mode ideal, got emulated"),
        (BENT, [3.0, 0, 0], "joint 1 must be within"),
        (BENT, [0.0, 0], r"q must have shape \(3,\)"),
    ],
)
def test_what_has_no_plant_is_refused(system, q, message):
    with pytest.raises(ParameterError, match=message):
        plant_at(system, q)


# -------------------------------------------------------------------------- measures


@pytest.mark.parametrize("name", ["bent, full gains", "six joints"])
def test_the_strain_integral_is_that_of_the_response(name):
    """Lyapunov's closed form against Simpson's rule on the response, to 1e-6."""
    system, gains = SYSTEMS[name]
    plant = plant_at(system, np.full(system.arm.n, 0.3))
    y = np.array([0.02, -0.01, 1e-4, 0.01, 0.02, -0.01])
    analysis = analyse(plant, gains, y)
    fastest = np.abs(analysis.poles.imag).max()
    end = 16 / -analysis.poles.real.max()
    t = np.linspace(0, end, 2 * int(end * fastest * 10) + 1)
    x = respond(plant, gains, y, t)
    strain = 0.5 * np.einsum("ki,ij,kj->k", x[:, :6], system.base.K, x[:, :6])
    weights = np.r_[1, np.tile([4, 2], (len(t) - 3) // 2), 4, 1] * t[1] / 3
    assert weights @ strain == pytest.approx(analysis.E_int, rel=1e-6)


def test_no_displacement_is_worse_than_the_worst():
    """Per joule of initial strain energy; the one named reaches it."""
    plant, gains = bent(), GainMatrices.of(PPED_GAINS)
    analysis = analyse(plant, gains)
    at_worst = analyse(plant, gains, analysis.worst_y)
    assert 0.5 * analysis.worst_y @ plant.stiffness @ analysis.worst_y == pytest.approx(1.0)
    assert at_worst.E_int == pytest.approx(analysis.worst, rel=1e-9)
    rng = np.random.default_rng(0)
    for y in rng.normal(size=(50, 6)) @ np.linalg.inv(np.linalg.cholesky(plant.stiffness)):
        energy = 0.5 * y @ plant.stiffness @ y
        assert analyse(plant, gains, y).E_int / energy <= analysis.worst * (1 + 1e-9)


def test_estimator_is_equation_4_4():
    """By hand: a pair of ratio 0.6 at 5 rad/s, a real pole at 2; a pole at 0 is left out."""
    expected = 2 * 0.6 * (1 - 5 / 12) + 1.0 * (1 - 2 / 12)
    assert estimator([-3 + 4j, -3 - 4j, -2, 0]) == pytest.approx(expected)


def test_free_joints_never_come_to_rest():
    none = GainMatrices(np.zeros((3, 3)), np.zeros((3, 3)))
    analysis = analyse(bent(), none)
    assert np.isinf([analysis.E_int, analysis.t_5, analysis.worst]).all()
    plain = analysis.to_dict()
    assert plain["E_int"] is None and plain["worst_y"] is None and plain["estimator"] > 0


@pytest.mark.parametrize(
    ("gains", "y", "message"),
    [
        (
            GainMatrices(np.eye(2), np.eye(3)),
            THESIS_DISPLACEMENT,
            r"K must have shape \(3, 3\)",
        ),
        (
            GainMatrices(np.eye(3), np.full((3, 3), np.nan)),
            THESIS_DISPLACEMENT,
            "B must be finite",
        ),
        (GainMatrices.of(HIGH_GAINS), (0.1, 0.1), r"y must have shape \(6,\)"),
    ],
)
def test_wrong_gains_and_displacements_are_refused(gains, y, message):
    with pytest.raises(ParameterError, match=message):
        analyse(bent(), gains, y)


# -------------------------------------------------------------------------- gradients


@pytest.mark.parametrize("objective", OBJECTIVES)
@pytest.mark.parametrize("gains", [GainMatrices.of(PPED_GAINS), FULL], ids=["diagonal", "full"])
def test_gradients_are_those_of_differences(objective, gains):
    """d / dA along random directions of the gains; central differences of 1e-4 of them."""
    plant = bent(np.deg2rad([30.0, -20, 40]))
    value = objective_of(plant, objective)
    _, slope = value(plant.closed(gains))
    rng = np.random.default_rng(0)
    for _ in range(6):
        way = GainMatrices(*(1e-4 * np.abs(g).max() * rng.normal(size=(3, 3)) for g in gains))
        above, below = (
            value(plant.closed(GainMatrices(gains.K + k * way.K, gains.B + k * way.B)))[0]
            for k in (1, -1)
        )
        change = plant.closed(way) - plant.free
        assert (above - below) / 2 == pytest.approx(np.sum(slope * change), rel=1e-5, abs=1e-9)


# ------------------------------------------------------------------------- the search


def test_the_search_beats_random_gains_and_keeps_its_bounds():
    plant, bounds = bent(), Bounds(K=(30.0, 600.0), B=(1.0, 50.0))
    tuned = tune(plant, bounds=bounds, starts=6)
    full = tune(plant, bounds=bounds, starts=2, full=True)
    assert full.value < 0.99 * tuned.value
    for gains in (tuned.gains, full.gains):
        for gain, (low, high) in zip(gains, (bounds.K, bounds.B), strict=True):
            np.testing.assert_allclose(gain, gain.T, rtol=1e-12)
            values = np.linalg.eigvalsh(gain)
            assert low * (1 - 1e-9) <= values[0] and values[-1] <= high * (1 + 1e-9)
    assert np.count_nonzero(tuned.gains) == 6
    assert analyse(plant, tuned.gains).E_int == pytest.approx(tuned.value, rel=1e-9)
    rng = np.random.default_rng(0)
    for _ in range(100):
        K = np.exp(rng.uniform(*np.log(bounds.K), 3))
        B = np.exp(rng.uniform(*np.log(bounds.B), 3))
        assert analyse(plant, GainMatrices(np.diag(K), np.diag(B))).E_int > tuned.value


def test_each_objective_is_best_at_what_it_asks():
    """Against the gains found for the others and the thesis's."""
    plant = bent()
    searches = {name: tune(plant, name, starts=5) for name in OBJECTIVES}
    judged = {name: analyse(plant, tuned.gains) for name, tuned in searches.items()}
    judged["thesis"] = analyse(plant, GainMatrices.of(PPED_GAINS))
    measures = {"strain": "E_int", "worst": "worst", "estimator": "estimator"}
    for objective, measure in measures.items():
        values = {name: getattr(damping, measure) for name, damping in judged.items()}
        best = max if objective == "estimator" else min
        assert best(values, key=values.__getitem__) == objective
        assert values[objective] == pytest.approx(searches[objective].value, rel=1e-6)


def test_a_known_start_is_not_made_worse():
    good = tune(bent(), starts=2).gains
    tuned = tune(bent(), starts=1, first=good)
    assert tuned.value <= analyse(bent(), good).E_int * (1 + 1e-6)


def test_a_base_that_no_gains_bring_to_rest_is_refused():
    """Undamped, and a single joint about the axis of its link's mass: it moves only phi_z."""
    arm = Arm(name="one", base=PUMA_560.base, links=PUMA_560.links[:1], source="test")
    base = DECOUPLED.base_model()
    zero = matrix(np.zeros((6, 6)))
    vehicle = MatrixVehicle(M=matrix(base.M), D=zero, K=matrix(base.K))
    plant = plant_at(System(arm=arm, vehicle=vehicle), [0.0])
    with pytest.raises(ParameterError, match="neither its own damping nor the joints"):
        tune(plant)
    servo = JointServo(kp=(100.0,), kd=(10.0,))
    assert np.isinf(analyse(plant, GainMatrices.of(servo)).E_int)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"objective": "speed"}, "must be one of strain, worst, estimator, got 'speed'"),
    ],
)
def test_wrong_searches_are_refused(options, message):
    with pytest.raises(ParameterError, match=message):
        tune(bent(), **options)


@pytest.mark.parametrize("K", [(5.0, 1.0), (0.0, 10.0), (1.0,)])
def test_wrong_bounds_are_refused(K):
    with pytest.raises(ParameterError, match=r"Bounds\.K"):
        Bounds(K=K)


# ------------------------------------------------------------------------------- configurations


def test_the_promise_of_joints_that_give_nothing_is_the_base_alone():
    """Rotors so heavy that the joints stand still, one mode released: its closed form."""
    links = tuple(dataclasses.replace(k, rotor_inertia=1e8) for k in PUMA_560.links)
    system = System(vehicle=BENT_THESIS, arm=dataclasses.replace(PUMA_560, links=links))
    shapes = modes(system, Q).shapes
    plant = plant_at(system, Q)
    for i in range(6):
        y = 1e-2 * shapes[:, i]
        integral = analyse(plant, GainMatrices.of(HIGH_GAINS), y).E_int
        # modal damping of the bare beam is not quite modal with the arm on it
        assert estimated_integral(system, Q, y) == pytest.approx(integral, rel=0.02)


def test_candidates_are_tuned_ranked_and_apart():
    options = {"samples": 300, "candidates": 2, "seed": 3}
    progress = []
    ranked = best_configurations(BENT, **options, progress=progress.append)
    repeated = best_configurations(BENT, **options)
    values = [c.tuned.value for c in ranked]
    assert values == sorted(values) and progress == [0.5, 1.0]
    for a, b in zip(ranked, repeated, strict=True):
        np.testing.assert_array_equal(a.q, b.q)
        PUMA_560.require_within_limits(a.q)
        assert a.estimated == pytest.approx(float(estimated_integral(BENT, a.q)))
        judged = analyse(plant_at(BENT, a.q), a.tuned.gains).E_int
        assert judged == pytest.approx(a.tuned.value, rel=1e-9)
    gaps = [np.abs(a.q - b.q).max() for a in ranked for b in ranked if a is not b]
    assert min(gaps) > 0.5


def test_a_map_is_tuned_node_by_node():
    system = BENT
    section = damping_map(system, (0, 2), Q, points=2)
    assert section.tuned.shape == section.estimated.shape == section.coupling.shape == (2, 2)
    assert section.axes[0] == pytest.approx(np.deg2rad([-160, 160]))
    q = np.array([section.axes[0][0], 0.0, section.axes[1][1]])
    Q_here = coupling_matrix(system, q)
    assert section.coupling[0, 1] == pytest.approx(np.trace(Q_here))
    assert section.estimated[0, 1] == pytest.approx(float(estimated_integral(system, q)))
    # two searches from other starts: rounding alone has them end 1 to 4 % apart
    best = tune(plant_at(system, q), starts=6).value
    assert section.tuned[0, 1] == pytest.approx(best, rel=0.05)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: damping_map(BENT, (0, 1), Q, points=1), "points must be >= 2, got 1"),
        (lambda: damping_map(BENT, (0, 1), [9.0, 0, 0]), "fixed: joint 1"),
        (lambda: estimated_integral(BENT, Q, np.zeros(3)), r"y must have shape \(6,\)"),
    ],
)
def test_wrong_maps_are_refused(call, message):
    with pytest.raises(ParameterError, match=message):
        call()
