"""The leaderboard's numbers against cases worked by hand and closed forms."""

import doctest
from pathlib import Path

import numpy as np
import pytest

from ves_gym._util.params import ParameterError
from ves_gym.leaderboard import statistics as s


def test_the_score_is_the_mean_of_the_middle_half(make_entry):
    """Eight scores: the two lowest and the two highest are cut, 2 + 3 + 4 + 5 remain."""
    entry = make_entry(scores=[0, 1, 2, 3, 4, 5, 6, 700])
    found = s.score([entry])
    assert found.value == 3.5
    assert found.low < 3.5 < found.high
    assert s.score([entry]) == found


def test_a_failure_is_the_worst_not_a_gap(make_entry):
    """Without the failures the mean would be 1.5; with them it is that of 2, 3, 4, 5."""
    entry = make_entry(scores=[0, 1, 2, 3, 4, 5, None, None])
    assert s.score([entry]).value == 3.5
    assert s.score([entry]).high == np.inf
    assert s.score([make_entry(scores=[0, 1, 2, 3, 4, None, None, None])]).value == np.inf
    assert s.middle([entry], "E_mean") == 7.0
    found = s.success([entry])
    assert found.value == 0.75 and found.low < 0.75 < found.high < 1


def test_a_number_that_no_row_has_is_none(make_entry):
    entry = make_entry()
    for row in entry["rows"]:
        row["E_res"] = None
    assert s.middle([entry], "E_res") is None
    assert s.middle([entry], "evaluations") == 40.0
    assert s.middle([entry], "no such") is None


def test_the_order_of_rows_does_not_matter(make_entry, noisy_scores):
    entry = make_entry(scores=noisy_scores(1.0, failed=3), groups=3)
    mixed = {**entry, "rows": entry["rows"][::-1]}
    assert s.score([mixed]) == s.score([entry])
    assert np.array_equal(s.values(mixed), s.values(entry))


def test_training_seeds_are_columns(make_entry):
    entry = make_entry(scores=[1, 2, 3, 4], groups=2)
    for row in entry["rows"]:
        row["score"] += 10 * row["group"]
    assert s.values(entry).tolist() == [[1, 11], [2, 12], [3, 13], [4, 14]]
    assert s.by_training_seed(entry) == [2.5, 12.5]


def test_a_share_is_a_mean_and_its_worst_is_one(make_entry):
    """Ten of a hundred wrong, five failed: 0.15. The middle half alone would say 0."""
    scores = [1.0] * 10 + [None] * 5 + [0.0] * 85
    entry = make_entry(scores=scores, track="discrepancy")
    found = s.score([entry])
    assert found.value == pytest.approx(0.15)
    assert (found.low, found.high) == pytest.approx((0.0931, 0.2328), abs=5e-5)  # Wilson
    assert s.standings([[entry]])[0].score == found


@pytest.mark.parametrize("wrong", [0, 1, 5, 15, 30])
def test_the_interval_of_a_share_holds_with_few_cases(make_entry, wrong):
    """Wilson's ends are the shares from which so many wrong ones are 1.96 deviations away."""
    n = s.MINIMUM["discrepancy"]
    entry = make_entry(scores=[1.0] * wrong + [0.0] * (n - wrong), track="discrepancy")
    found = s.score([entry])
    assert found.value == pytest.approx(wrong / n) and found.low < found.high
    for end in (found.low, found.high):
        if 0 < end < 1:
            assert abs(end - wrong / n) == pytest.approx(
                1.959964 * np.sqrt(end * (1 - end) / n), rel=1e-5
            )


def test_problems_are_strata(make_entry):
    """Within each problem all scores are the same: nothing is left to chance.

    A bootstrap of all rows together would have a width.
    """
    easy = make_entry(scores=[1.0] * 20, problem="easy")
    hard = make_entry(scores=[3.0] * 20, problem="hard")
    assert s.score([easy, hard]) == (2.0, 2.0, 2.0)


def test_an_episode_that_is_missing_or_double_is_named(make_entry):
    entry = make_entry(groups=2)
    with pytest.raises(ParameterError, match="'reach-2s-003', seed 3 is missing in group 1"):
        s.values({**entry, "rows": entry["rows"][:-1]})
    with pytest.raises(ParameterError, match="'reach-2s-000', seed 0, group 0 is there twice"):
        s.values({**entry, "rows": [*entry["rows"], entry["rows"][0]]})


@pytest.mark.parametrize("track", s.MINIMUM)
def test_too_few_episodes_are_refused(make_entry, track):
    least = s.MINIMUM[track]
    s.require_enough(make_entry(scores=[1.0] * least, track=track))
    few = make_entry(scores=[1.0] * (least - 1), groups=5, track=track)
    with pytest.raises(ParameterError, match=f"at least {least} episodes, got {least - 1}"):
        s.require_enough(few)


# ------------------------------------------------------------------------- profiles


def test_a_profile_counts_what_is_below(make_entry):
    entry = make_entry(scores=[1, 2, 3, 4, None])
    found = s.profile([entry], np.array([0.5, 1.0, 2.5, 4.0, 1e9]))
    assert found.share.tolist() == [0.0, 0.2, 0.4, 0.8, 0.8]
    assert (found.low <= found.share).all() and (found.share <= found.high).all()
    assert found.high[0] == 0 and found.high[-1] == 1


def test_the_band_of_a_profile_is_binomial(make_entry):
    """Reference: 1.96 sqrt(p (1 - p) / n) at p = 0.3, n = 400; tolerance: steps of 1 / n."""
    entry = make_entry(scores=[1.0] * 120 + [2.0] * 280)
    found = s.profile([entry], np.array([1.5]))
    half = 1.96 * np.sqrt(0.3 * 0.7 / 400)
    assert found.low[0] == pytest.approx(0.3 - half, abs=0.005)
    assert found.high[0] == pytest.approx(0.3 + half, abs=0.005)


def test_thresholds_are_where_the_scores_are(make_entry):
    some = [make_entry(scores=[0.1, 0.7, None]), make_entry(scores=[3.0, 8.0])]
    at = s.thresholds(some)
    assert {0.1, 0.7, 3.0, 8.0} <= set(at.tolist()) and (at[0], at[-1]) == (0.1, 8.0)
    assert s.profile(some, at).share[[0, -1]].tolist() == pytest.approx([0.2, 0.8])
    many = s.thresholds([make_entry(scores=[*np.linspace(-1, 1, 99), 1e6])])
    assert 50 <= len(many) <= 61 and (many[0], many[-1]) == (-1, 1e6)
    assert 35 <= (np.abs(many) <= 1).sum() <= 42  # two in three among 99 of the 100
    assert np.diff(many[many > 1]) == pytest.approx(1e6 / 19, rel=1e-3)
    for scores in ([2.0], [0.0], [None], [-3.0]):
        at = s.thresholds([make_entry(scores=scores)])
        assert (np.diff(at) > 0).all()


# ----------------------------------------------------------------------- comparison


def test_probability_of_improvement_by_hand(make_entry):
    """Lower on three of five, a tie on one (both failed): 3.5 of 5."""
    a = make_entry("a", scores=[1, 1, 1, 9, None])
    b = make_entry("b", scores=[2, 2, None, 2, None])
    found = s.improvement([a], [b])
    assert found.value == 0.7
    assert s.improvement([b], [a]).value == pytest.approx(0.3)
    assert s.improvement([a], [a]) == (0.5, 0.5, 0.5)


def test_probability_of_improvement_with_training_seeds(make_entry):
    """Episode by episode over all pairs: seeds at 1 and 3 against 2 win one of two."""
    a = make_entry("a", scores=[1.0] * 6, groups=2)
    for row in a["rows"]:
        row["score"] += 2 * row["group"]
    assert s.improvement([a], [make_entry("b", scores=[2.0] * 6)]).value == 0.5


def test_pairs_are_of_the_same_episode(make_entry):
    """Episodes differ a hundredfold, a is always 1 % lower: that is certain.

    Reference: unpaired (Mann-Whitney), it would be 0.5 and a bit.
    """
    levels = np.geomspace(1, 100, 50)
    a, b = make_entry("a", scores=0.99 * levels), make_entry("b", scores=levels)
    assert s.improvement([a], [b]) == (1.0, 1.0, 1.0)


def test_the_interval_of_an_improvement_holds_the_truth(make_entry):
    """P(N(0, 1) < N(d, 1)) = Phi(d / sqrt(2)): 0.7 at d = 0.7416; 200 trials of 60 episodes.

    Tolerance: three standard errors of 200 trials at 95 %, and 1 % for the bootstrap.
    """
    rng = np.random.default_rng(11)
    held = 0
    for _ in range(200):
        x, y = rng.normal(size=60), rng.normal(0.7416, 1.0, 60)
        found = s.improvement([make_entry("a", scores=x)], [make_entry("b", scores=y)])
        held += found.low <= 0.7 <= found.high
    assert 0.89 <= held / 200 <= 0.997


def test_other_episodes_are_not_compared(make_entry):
    with pytest.raises(ParameterError, match="did not play the same episodes"):
        s.improvement([make_entry(scores=[1, 2])], [make_entry(scores=[1, 2, 3])])
    with pytest.raises(ParameterError, match="did not play the same episodes"):
        s.standings([[make_entry(scores=[1, 2])], [make_entry(scores=[1, 2], problem="other")]])


def test_ranks_are_sure_where_the_difference_is(make_entry, noisy_scores):
    """Far apart: sure. The same level, other noise: not. Tied: both have the better rank."""
    entries = [
        [make_entry(str(k), scores=noisy_scores(level, seed=seed))]
        for k, (level, seed) in enumerate([(10.0, 3), (1.0, 0), (1.0, 1), (5.0, 2)])
    ]
    worst, a, b, third = [k.rank for k in s.standings(entries)]
    assert worst == (4, 4, 4) and third == (3, 3, 3)
    assert {a.value, b.value} == {1, 2}
    assert (a.low, a.high) == (b.low, b.high) == (1, 2)
    assert [k.rank.value for k in s.standings([entries[1], entries[1], entries[0]])] == [
        1,
        1,
        3,
    ]
    assert [k.score for k in s.standings(entries)] == [s.score(e) for e in entries]


def test_all_that_failed_come_last_together(make_entry):
    none = make_entry(scores=[None] * 8)
    found = s.standings([[none], [make_entry(scores=range(8))], [none]])
    assert [k.rank.value for k in found] == [2, 1, 2]


# -------------------------------------------------------------------------- anytime


def test_an_anytime_curve_ends_in_the_score(make_entry):
    """Costs 8, 4, 2 at 1, 2, 4 s and a score of 0.5: the score stood at 2, 1, 0.5."""
    entry = make_entry(scores=[0.5] * 8)
    for row in entry["rows"]:
        row["anytime"] = [[1.0, 8.0], [2.0, 4.0], [4.0, 2.0]]
    at = np.array([0.5, 1.0, 3.0, 4.0, 9.0])
    assert s.anytime(entry, at).tolist() == [np.inf, 2.0, 1.0, 0.5, 0.5]
    assert s.anytime(entry, at)[-1] == s.score([entry]).value


def test_rows_without_a_solution_hold_an_anytime_curve_up(make_entry):
    entry = make_entry(scores=[0.5] * 5 + [None] * 3)
    for row in entry["rows"]:
        row["anytime"] = [[1.0, 2.0]] if row["score"] is not None else []
    assert s.anytime(entry, np.array([2.0])).tolist() == [np.inf]


def test_the_worked_example_is_what_comes_out():
    page = Path(__file__).parents[2] / "docs" / "leaderboard" / "statistics.md"
    found = doctest.testfile(str(page), module_relative=False)
    assert found.attempted > 10 and found.failed == 0
