"""What the front door answered on the day the rewriting began, it answers still."""

import pytest

from tests.golden.stored import ROOMS, every_probe, judge, measure, path_of, probes, stored

NAMES = every_probe()


@pytest.mark.parametrize(
    "name",
    [pytest.param(k, marks=pytest.mark.slow if p.slow else ()) for k, (_, p) in NAMES.items()],
)
def test_it_answers_as_before(name):
    room, probe = NAMES[name]
    deviation = judge(probe, stored(room)[name], measure(probe))
    assert deviation.permitted, f"{deviation.where} differs by {deviation.size:.3g} of its size"


def test_every_result_has_its_probe_and_they_stay_small():
    for room in ROOMS:
        assert list(stored(room)) == list(probes(room))
    assert sum(path_of(room).stat().st_size for room in ROOMS) <= 400_000
