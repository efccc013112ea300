"""The leaderboard's numbers against cases worked by hand and closed forms."""

import doctest
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.leaderboard.entries import made_entry, noisy
from ves_gym._util.statistics import wilson
from ves_gym.leaderboard import statistics as s


def results(scores, **more):
    return made_entry(scores=scores, kind="controller", **more).results


def test_the_score_is_the_mean_of_the_middle_half():
    """Eight scores: the two lowest and the two highest are cut, 2 + 3 + 4 + 5 remain."""
    found = s.score(results([0, 1, 2, 3, 4, 5, 6, 700]))
    assert found.value == 3.5 and found.low < 3.5 < found.high
    assert s.score(results([0, 1, 2, 3, 4, 5, 6, 700])) == found


def test_a_failure_is_the_worst_not_a_gap():
    """Without the failures the mean would be 1.5; with them it is that of 2, 3, 4, 5."""
    some = results([0, 1, 2, 3, 4, 5, None, None])
    assert s.score(some).value == 3.5 and s.score(some).high == np.inf
    assert s.score(results([0, 1, 2, 3, 4, None, None, None])).value == np.inf
    assert s.middle(some, "E_mean") == 7.0 and s.middle(some, "seconds") is None
    found = s.success(some)
    assert found.value == 0.75 and found.low < 0.75 < found.high < 1


def test_an_episode_is_drawn_with_all_its_groups():
    """Five policies that do the same on every episode are no more evidence than one."""
    one = noisy(1.0)
    assert s.score(results([one] * 5)) == pytest.approx(s.score(results(one)), rel=1e-12)
    assert s.success(results([one] * 5)) == s.success(results(one))


def test_ranks_are_sure_where_the_difference_is():
    """Far apart: sure. The same level, other noise: not. Tied: both have the better rank."""
    some = [
        results(noisy(level, n=50, seed=seed))
        for level, seed in [(10.0, 3), (1.0, 0), (1.0, 1), (5.0, 2)]
    ]
    worst, a, b, third = [k.rank for k in s.standings(some)]
    assert worst == (4, 4, 4) and third == (3, 3, 3)
    assert {a.value, b.value} == {1, 2}
    assert (a.low, a.high) == (b.low, b.high) == (1, 2)
    tied = s.standings([some[1], some[1], some[0]])
    assert [k.rank.value for k in tied] == [1, 1, 3]
    assert [k.score for k in s.standings(some)] == [s.score(k) for k in some]
    none = results([None] * 8)  # those that failed come last together
    assert [k.rank.value for k in s.standings([none, results(range(8)), none])] == [2, 1, 2]


# ------------------------------------------------------------------- success first

SPREAD = np.exp(np.random.default_rng(1).normal(size=100))  # of the same episodes for everyone
ORDER = np.argsort(SPREAD)


def solving(energies, unsolved=()):
    won = ~np.isin(np.arange(100), list(unsolved))
    return results(np.where(won, energies, np.nan), success=won)


def ranks(*some):
    return [place.rank.value for place in s.standings(some, by_success=True)]


def test_who_solves_clearly_less_is_never_above_whatever_the_energy():
    all_of_them = solving(SPREAD)
    easy = solving(1e-6 * SPREAD, unsolved=ORDER[80:])  # only what is easy anyway
    nothing = solving(0 * SPREAD, unsolved=range(100))
    assert ranks(nothing, easy, all_of_them) == [3, 2, 1]
    found = s.standings([all_of_them, easy, nothing], by_success=True)
    assert [k.level for k in found] == [1, 2, 3]
    assert found[0].rank == (1, 1, 1) and found[2].rank == (3, 3, 3)


def test_within_a_class_the_energy_decides():
    """97 of 100 solved are not clearly fewer than 100; half the energy is clearly less."""
    thrifty = solving(SPREAD / 2, unsolved={3, 7, 9})
    assert ranks(solving(SPREAD), thrifty) == [2, 1]
    found = s.standings([solving(SPREAD), thrifty], by_success=True)
    assert [k.level for k in found] == [1, 1]


@pytest.mark.parametrize("left_out", [1, 5, 20, 30])
def test_to_give_an_episode_up_never_pays(left_out):
    """The dearest, the cheapest or any: the score of the same motions gets no better."""
    whole = s.score(solving(SPREAD)).value
    for given_up in (ORDER[-left_out:], ORDER[:left_out], np.arange(left_out)):
        assert s.score(solving(SPREAD, unsolved=given_up)).value >= whole


def test_equal_classes_without_a_finite_score_go_by_what_they_solve():
    """40 and 50 of 100 overlap; more than a quarter unsolved leaves no score."""
    less = solving(SPREAD, unsolved=range(60))
    more = solving(2 * SPREAD, unsolved=range(50))
    none = [solving(SPREAD, unsolved=range(100))] * 2
    assert ranks(less, more, *none) == [2, 1, 3, 3]


def test_classes_by_hand():
    """Of 100: 97 overlaps 100 (95 % intervals 91.5 to 99.0 and 96.3 to 100), 90 does not."""
    share = np.array([[1.0], [0.97], [0.90], [0.5], [0.0], [0.42]])
    assert s.success_classes(share, 100)[:, 0].tolist() == [1, 1, 2, 3, 4, 3]
    assert s.success_classes(np.zeros((3, 2)), 100).tolist() == [[1, 1]] * 3


@given(st.lists(st.integers(0, 100), min_size=1, max_size=12))
def test_classes_keep_what_is_clear_and_nothing_else_apart(hits):
    """Clearly more: a better class. In one class: intervals that overlap."""
    level = s.success_classes(np.array(hits)[:, None] / 100, 100)[:, 0]
    low, high = wilson(np.array(hits) / 100, 100)
    for i in range(len(hits)):
        for j in range(len(hits)):
            if low[i] > high[j]:
                assert level[i] < level[j]
            if level[i] == level[j]:
                assert low[i] <= high[j]


# ------------------------------------------------------------------------- groups


def test_groups_that_do_the_same_are_found():
    one, other = noisy(1.0), noisy(1.0, seed=1)
    near = [k * (1 + 1e-5) for k in one]
    assert s.repeated(results([one, other]), "policy") is None
    assert s.repeated(results([one, other, one]), "controller") == (0, 2)
    assert s.repeated(results([one, near]), "policy") == (0, 1)
    assert s.repeated(results([one, near]), "planner") is None
    assert s.repeated(results([[None] * 5] * 2), "policy") is None
    half = [np.nan if k % 2 else x for k, x in enumerate(one)]
    assert s.repeated(results([one, half]), "policy") is None


def test_the_worked_example_is_what_comes_out():
    page = Path(__file__).parents[2] / "docs" / "leaderboard" / "statistics.md"
    found = doctest.testfile(str(page), module_relative=False)
    assert found.attempted > 8 and found.failed == 0
