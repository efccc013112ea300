"""Configurations in which the arm damps best: the coupling's estimate, candidates, maps."""

import dataclasses

import numpy as np
import pytest

from ves_gym._util.params import ParameterError
from ves_gym.damping.configurations import best_configurations, damping_map, estimated_integral
from ves_gym.damping.plant import GainMatrices, analyse, plant_at
from ves_gym.damping.tuning import tune
from ves_gym.mechanics.arm_library import PUMA_560
from ves_gym.mechanics.servo import HIGH_GAINS
from ves_gym.mechanics.vehicle import BENT_THESIS
from ves_gym.planners.coupling import coupling_matrix, modes
from ves_gym.system.system import System

BENT = System(vehicle=BENT_THESIS)

Q = np.deg2rad([45.0, 0.0, 0.0])


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
        (lambda: best_configurations(BENT, samples=3, candidates=4), "candidates <= samples"),
        (lambda: damping_map(BENT, (0, 3), Q), "two different numbers in"),
        (lambda: damping_map(BENT, (0, 1), Q, points=1), "points must be >= 2, got 1"),
        (lambda: damping_map(BENT, (0, 1), [9.0, 0, 0]), "fixed: joint 1"),
        (lambda: estimated_integral(BENT, Q, np.zeros(3)), r"y must have shape \(6,\)"),
    ],
)
def test_wrong_maps_are_refused(call, message):
    with pytest.raises(ParameterError, match=message):
        call()
