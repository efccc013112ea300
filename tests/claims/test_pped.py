"""Claims on PPED (thesis 4.3): joint gains that take vibration out of the base.

Bent beam, 180 mm, thesis mass, q = (45, 0, 0) deg, let go from Y(0) = 0.1 m in x, y, z:
82.3 J. Damping of the beam as the thesis has it (element by element) and modal, 5 %, the
default; consistent mass beside them. References: the thesis's own gains (eq. 4.5, 4.6), the
numbers with which THEORY retraced the thesis, and the full nonlinear simulation.
"""

import dataclasses
import functools

import numpy as np
import pytest
from scipy.stats import spearmanr

from tests.claims.test_the_history import printed_inertia
from ves_gym.damping.configurations import best_configurations, estimated_integral
from ves_gym.damping.free_vibration import simulate_free_vibration
from ves_gym.damping.plant import (
    THESIS_DISPLACEMENT,
    GainMatrices,
    LinearPlant,
    analyse,
    plant_at,
    plants,
    respond,
)
from ves_gym.damping.tuning import Tuned, tune
from ves_gym.mechanics.arm_library import PUMA_560
from ves_gym.mechanics.servo import HIGH_GAINS, PPED_GAINS
from ves_gym.mechanics.vehicle import BENT_THESIS
from ves_gym.planners.coupling import coupling_matrix
from ves_gym.system.system import System

Q45 = np.deg2rad([45.0, 0.0, 0.0])
BEAMS = {
    "elementwise": dataclasses.replace(BENT_THESIS, damping_model="elementwise"),
    "modal": BENT_THESIS,
    "consistent": dataclasses.replace(BENT_THESIS, mass_model="consistent"),
}
EACH_BEAM = pytest.mark.parametrize(
    "beam", [k if k == "modal" else pytest.param(k, marks=pytest.mark.slow) for k in BEAMS]
)
THESIS = {"PPED": GainMatrices.of(PPED_GAINS), "high": GainMatrices.of(HIGH_GAINS)}


@functools.cache
def bent(beam: str) -> LinearPlant:
    return plant_at(System(vehicle=BEAMS[beam]), Q45)


@functools.cache
def best(beam: str, objective: str = "strain", full: bool = False) -> Tuned:
    return tune(bent(beam), objective, full=full)


# ------------------------------------------------------------------ least strain integral


@EACH_BEAM
def test_gains_beat_the_thesis(beam):
    """At most 0.79 of the strain integral of its PPED gains and 0.74 of its high gains."""
    given = {name: analyse(bent(beam), g).E_int for name, g in THESIS.items()}
    found = best(beam).value
    print(f"{beam}: {found:.2f} J s; ", {k: f"{found / v:.3f}" for k, v in given.items()})
    assert found <= 0.79 * given["PPED"]
    assert found <= 0.74 * given["high"]


@EACH_BEAM
def test_full_matrices_leave_less(beam):
    diagonal, full = best(beam).value, best(beam, full=True).value
    print(f"{beam}: full {full:.2f} J s, {full / diagonal:.3f} of diagonal")
    assert full < 0.98 * diagonal


@EACH_BEAM
def test_the_estimator_is_a_poor_objective(beam):
    """Gains that minimise the integral leave 22 to 41 % less than those best by eq. 4.4.

    Eq. 4.4 is flat at its maximum: what other searches for it leave differs by some percent.
    """
    by_estimator = best(beam, "estimator")
    left = analyse(bent(beam), by_estimator.gains).E_int
    less = 1 - best(beam).value / left
    print(f"{beam}: best of eq. 4.4 {by_estimator.value:.2f} leaves {left:.1f} J s: {less:.0%}")
    assert 0.22 <= less <= 0.41
    # and it does not even beat the thesis's PPED gains, which its own measure ranks below
    given = analyse(bent(beam), THESIS["PPED"])
    assert by_estimator.value > given.estimator and left > given.E_int


# ------------------------------------------------------------------- the simulation agrees


@EACH_BEAM
def test_the_full_simulation_agrees(beam):
    """Strain integral over 30 s, large motion and limited motors: within 1 % of the linear
    one for diagonal gains (full matrices and saturated motors 3 %), in the same order."""
    system = System(vehicle=BEAMS[beam])
    sets = [*THESIS.values(), best(beam).gains, best(beam, full=True).gains]
    run = simulate_free_vibration(system, Q45, sets)
    linear = np.array([analyse(bent(beam), g).E_int for g in sets])
    error = run.E_int / linear - 1
    print(f"{beam}: error {np.round(100 * error, 2)} %, effort {run.effort.max(axis=1)}")
    assert np.abs(error[:3]).max() <= 0.015 and abs(error[3]) <= 0.03
    assert run.E_int[2] <= 0.79 * run.E_int[0] and run.E_int[2] <= 0.74 * run.E_int[1]
    assert run.E_int[3] < run.E_int[2]
    assert run.t_5[2] < 0.8 * run.t_5[0] < run.t_5[1]


# ---------------------------------------------------------------------- the thesis itself


def printed_plant() -> LinearPlant:
    """The model of App. G: rotors inside the links, damping element by element."""
    base = BEAMS["elementwise"].base_model()
    M, D, K = printed_inertia(Q45), np.zeros((9, 9)), np.zeros((9, 9))
    M[:6, :6] += base.M
    D[:6, :6], K[:6, :6] = base.D, base.K
    free, drive = np.zeros((18, 18)), np.zeros((18, 3))
    free[:9, 9:] = np.eye(9)
    free[9:], drive[9:] = np.linalg.solve(M, np.hstack([-K, -D])), np.linalg.inv(M)[:, 6:]
    eye = np.eye(9)
    return LinearPlant(
        free=free,
        drive=drive,
        port=eye[6:],
        displacement_map=eye[:, :6],
        K=base.K,
        stiffness=base.K,
        mass=M[:6, :6],
    )


TABLE = {  # gains K, B -> estimator, E_int [J s], t(5 %) of strain [s]: THEORY section 2
    "PPED 4.5": ((210, 33, 20), (72, 55, 17), 6.40, 61.6, 3.6),
    "high 4.6": ((3000, 2000, 1000), (50, 40, 30), 2.17, 65.9, 4.0),
    "max of 4.4": ((20, 94, 24), (26, 87, 18), 6.59, 61.4, 3.6),
    "min of E": ((305, 670, 435), (2.7, 18, 0.1), 1.15, 48.4, 2.7),
}


@pytest.mark.parametrize("name", TABLE)
def test_the_table_of_the_retraced_thesis(name):
    """To the digits printed; gains of its two searches are rounded, which shows in them."""
    K, B, printed, E_int, t_5 = TABLE[name]
    plant, gains = (
        printed_plant(),
        GainMatrices(np.diag(K).astype(float), np.diag(B).astype(float)),
    )
    found = analyse(plant, gains)
    given = name in ("PPED 4.5", "high 4.6")
    assert found.estimator == pytest.approx(printed, abs=5e-3 if given else 0.025)
    assert found.E_int == pytest.approx(E_int, abs=0.05 if given else 0.25)
    t = np.arange(400) * 0.05  # its clock
    y = respond(plant, gains, THESIS_DISPLACEMENT, t)[:, :6]
    strain = 0.5 * np.einsum("ki,ij,kj->k", y, plant.stiffness, y)
    assert strain[0] == pytest.approx(82.3, abs=0.05)
    assert t[np.flatnonzero(strain > 0.05 * strain[0])[-1]] == pytest.approx(t_5, abs=0.051)


def test_the_searches_of_the_retraced_thesis_are_beaten():
    """THEORY's local searches: 48.4 J s, eq. 4.4 at 6.59; several starts find better."""
    assert tune(printed_plant()).value <= 48.4
    assert tune(printed_plant(), "estimator").value >= 6.59


def test_rotors_on_the_joints_change_little():
    """Ours against the model as printed: below 1 % of the integral."""
    for gains in THESIS.values():
        ours, printed = (
            analyse(p, gains).E_int for p in (bent("elementwise"), printed_plant())
        )
        assert ours == pytest.approx(printed, rel=0.01)


def test_what_figures_4_4_and_4_5_show():
    """'The dominant poles are not affected'; 'poles in the -2 to -5 range move closer to,
    or onto, the real axis'. Both hold; the ones that move are the joints' own."""
    poles = {name: analyse(bent("elementwise"), g).poles for name, g in THESIS.items()}
    slow = poles["high"][np.abs(poles["high"]) < 4]
    assert len(slow) == 6  # three pairs: the thesis counts four poles
    for pole in slow:
        assert np.abs(poles["PPED"] - pole).min() <= 0.01 * abs(pole)
    joints = {  # poles that are not near the base's own with the joints locked
        name: [p for p in found if p.imag >= 0 and -p.real > 0.2 * abs(p)]
        for name, found in poles.items()
    }
    assert max(-p.real / abs(p) for p in joints["high"]) < 0.5
    assert min(-p.real / abs(p) for p in joints["PPED"]) > 0.8
    assert sum(p.imag == 0 for p in joints["PPED"]) >= 4


# -------------------------------------------------------------- where the arm damps best


@functools.cache
def sampled(beam: str, count: int) -> tuple[float, float]:
    """Rank correlation of what tuned gains leave with what modal coupling promises, and
    with less trace of raw Q, over random configurations."""
    system = System(vehicle=BEAMS[beam])
    low, high = PUMA_560.column("q_min"), PUMA_560.column("q_max")
    q = np.random.default_rng(1).uniform(low, high, (count, 3))
    left = [tune(plant, starts=4).value for plant in plants(system, q)]
    raw = np.trace(coupling_matrix(system, q), axis1=1, axis2=2)
    return (
        float(spearmanr(estimated_integral(system, q), left)[0]),
        float(spearmanr(-raw, left)[0]),
    )


@pytest.mark.slow
@pytest.mark.parametrize("beam", ["modal", "consistent"])
def test_the_coupling_tells_where_the_arm_damps(beam, count=150):
    """Mode by mode it ranks configurations; the trace of raw Q does not."""
    modal, raw = sampled(beam, count)
    print(f"{beam}, {count}: rank correlation modal {modal:.2f}, raw Q {raw:.2f}")
    assert modal >= 0.5 and raw <= 0.35


@pytest.mark.slow
@pytest.mark.parametrize(("beam", "share"), [("modal", 0.97), ("consistent", 0.70)])
def test_a_better_configuration_is_found(beam, share):
    """Beside the thesis's (45, 0, 0): little to gain with the thesis mass, a third with the
    consistent one."""
    found = best_configurations(System(vehicle=BEAMS[beam]))[0].tuned.value
    print(f"{beam}: {found:.2f} J s, {found / best(beam).value:.3f} of (45, 0, 0)")
    assert found <= share * best(beam).value
