"""Every effect shows at its magnitude, and at zero leaves the machine as it was."""

import numpy as np
import pytest

pytest.importorskip("numba")

from ves_gym._util.params import ParameterError
from ves_gym.diagnosis.benchmark.blind.effects import LIBRARY, OUTSIDE, TRUTHS, drawn
from ves_gym.diagnosis.benchmark.blind.excitation import KINDS, draw
from ves_gym.diagnosis.benchmark.blind.magnitude import gap, search
from ves_gym.diagnosis.benchmark.blind.noise import losses
from ves_gym.diagnosis.benchmark.blind.setup import with_nuisance
from ves_gym.diagnosis.benchmark.blind.simulate import SEARCH_STEP, silent

SAMPLES = 1001
# a mode needs some mass, and gears that are not rigid stay a little elastic
LEAST = {"joint/elasticity": 2.5e-6, "joint/backlash": 1e-7, "base/extra_mode": 1e-6}


@pytest.fixture(scope="module")
def plain(runner):
    """Two motions on the healthy machine."""
    rng = np.random.default_rng(11)
    motions = [draw(kind, runner.limits, rng) for kind in (KINDS[0], KINDS[3])]
    return motions, runner.records(runner.nominal, motions, quiet(), SEARCH_STEP)


def quiet(share=0.0):
    rng = np.random.default_rng(5)
    return [silent(SAMPLES)._replace(lost=losses(SAMPLES, share, rng)) for _ in range(2)]


def played(runner, plain, effect):
    share = effect.magnitude if effect.kind == "outside/packet_loss" else 0.0
    changed = effect.truth.apply(
        runner.nominal, effect.slot, effect.magnitude, effect.constants
    )
    return runner.records(changed, plain[0], quiet(share), SEARCH_STEP)


@pytest.mark.parametrize("kind", TRUTHS)
def test_effect_shows_at_its_magnitude_and_not_at_zero(runner, plain, kind):
    reached = []
    for effect in drawn(kind, np.random.default_rng(1)):
        strong = effect._replace(magnitude=max(effect.magnitude, 0.7 * effect.truth.most))
        reached.append(gap(played(runner, plain, strong), plain[1]))
        none = gap(
            played(runner, plain, effect._replace(magnitude=LEAST.get(kind, 0.0))), plain[1]
        )
        assert none == 0.0 if kind not in LEAST else none < 0.6
    assert max(reached) > 1.5


def test_kinds_are_complete():
    assert len(LIBRARY) == 31 and len(OUTSIDE) == 6


def test_label_names_kind_slot_and_value():
    effect = drawn("joint/stribeck", np.random.default_rng(2))[0]._replace(magnitude=2.0)
    label = effect.label()
    assert label["kind"] == "joint/stribeck" and label["slot"].startswith("joint ")
    assert label["parameters"]["coulomb"] == 2.0
    assert label["parameters"]["stiction"] > 2.0


def test_unknown_effect_is_named():
    with pytest.raises(ParameterError, match=r"joint/coulomb.*got 'joint/cuolomb'"):
        drawn("joint/cuolomb", np.random.default_rng(0))


@pytest.mark.parametrize("wanted", [1.5, 3.0, 10.0])
@pytest.mark.parametrize("law", [lambda x: 7 * x, lambda x: max(0.0, 50 * (x - 0.6)) ** 2])
def test_search_finds_the_magnitude(law, wanted):
    x, reached = search(law, wanted, 0.3, 2.0)
    assert reached == law(x)
    assert reached == pytest.approx(wanted, rel=0.05)


def test_search_gives_the_largest_where_too_little():
    x, reached = search(lambda x: x, 10.0, 0.3, 2.0)
    assert (x, reached) == (2.0, 2.0)


def test_search_keeps_away_from_where_the_machine_runs_off():
    _, reached = search(lambda x: np.inf if x > 1 else 2 * x, 1.5, 1.9, 2.0)
    assert reached == pytest.approx(1.5, rel=0.05)


def test_nuisances_are_about_noise(runner, plain):
    """Usual ones stay below twice the noise, large ones are twice as large."""
    usual, large = (
        [
            gap(
                runner.records(
                    with_nuisance(runner.nominal, np.random.default_rng(k), factor),
                    plain[0], quiet(), SEARCH_STEP,
                ),
                plain[1],
            )
            for k in range(6)
        ]
        for factor in (1.0, 2.0)
    )  # fmt: skip
    assert 0.2 < np.median(usual) < 1.5 and max(usual) < 2.5
    assert 1.6 < np.median(large) / np.median(usual) < 2.4
