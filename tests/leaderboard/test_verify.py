"""Honest entries pass; what is claimed and not found here is refused, each by its code."""

import json
import shutil

import gymnasium as gym
import numpy as np
import pytest

from tests.leaderboard.entries import DAMP, Gentle, Spoiled, code_of, save_random_policy
from ves_gym._util.params import ParameterError
from ves_gym.baselines.evaluate import evaluate
from ves_gym.baselines.policy import load_policy
from ves_gym.baselines.registry import REFERENCES
from ves_gym.leaderboard.entry import Code
from ves_gym.leaderboard.files import ENTRY, RECORDING, unpack
from ves_gym.leaderboard.tracks import damping as gain_track
from ves_gym.leaderboard.tracks.base import require_settings
from ves_gym.leaderboard.verify import add, make_entry, verify_entry
from ves_gym.planners.query import NoPlan
from ves_gym.planners.registry import get_planner

SALT = "a secret of the maintainer"
LINES = ("paths", "bent-1s-quick")
GAINS = ("damping", "gains-bent-quick")

# ---------------------------------------------------------------------------- honest


def test_the_straight_line_scores_one_and_is_answered_again(straight):
    entry = verify_entry(straight)
    assert entry.level == "reproduced" and entry.method.name == "straight"
    np.testing.assert_allclose(entry.results["score"], 1.0, rtol=1e-12)
    assert (entry.results["seconds"] > 0).all()
    assert [p.name for p in straight.iterdir()] == [ENTRY]  # nothing else is needed


def test_a_policy_acts_again_from_its_files_alone(policy):
    entry = verify_entry(policy)
    assert entry.level == "reproduced" and entry.author == "someone"
    assert not (policy / RECORDING).exists()
    direct = evaluate(
        load_policy(policy / "policy-0.json"), "ves/PumaDamp-v0", episodes=10, seed=19_940_000
    )
    assert entry.results["E_peak"][0].tolist() == [row["E_peak"] for row in direct.rows]


def test_a_controller_of_ones_own_is_replayed(own):
    entry = verify_entry(own)
    assert entry.level == "replayed" and entry.method.name == "" and entry.name == "gentle"
    claimed = json.loads((own / ENTRY).read_text())["results"]["score"]
    np.testing.assert_allclose(entry.results["score"], claimed, rtol=1e-4)


class Mute:
    """A planner that answers every other query, with the straight line."""

    name, summary = "mute", "half of the time"
    asked = 0

    def find(self, query, seed):
        self.asked += 1
        if self.asked % 2:
            raise NoPlan("nothing")
        return get_planner("straight").find(query, seed)


@pytest.fixture(scope="module")
def mute(folder):
    """Five straight lines as somebody's own, recorded, and five times nothing."""
    make_entry(folder / "mute", *LINES, Mute())
    return folder / "mute"


def test_a_planner_of_ones_own_is_replayed_and_its_failures_count(mute):
    entry = verify_entry(mute)
    assert entry.level == "replayed"
    assert np.isfinite(entry.results["score"][0]).tolist() == [False, True] * 5
    assert entry.results["success"].tolist() == [[0.0, 1.0] * 5]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("track", "problem", "method"),
    [
        *(
            ("tasks", f"ves/{name}{suffix}-v0-quick", REFERENCES[name])
            for name in ("PumaReach", "PumaDamp", "BeamLQR", "PoseReach")
            for suffix in ("", "Emulated")
        ),
        ("paths", "bent-2s-quick", "direct"),
        ("paths", "bent-4s-obstacles-quick", "direct"),
        ("paths", "servicer-flexible-2s-quick", "refined"),
        ("paths", "bent-iiwa14-2s-quick", "direct"),
        ("tasks", "unknown-space-quick", "adaptive"),
        (*GAINS, "strain"),
    ],
)
def test_what_solves_a_problem_is_answered_again(track, problem, method, tmp_path):
    make_entry(tmp_path / "e", track, problem, method, workers=2)
    results = verify_entry(tmp_path / "e", workers=2).results
    score, solved = results["score"], results["success"] > 0
    if track == "damping":
        assert (score < 1).all()
        return
    assert (np.isfinite(score) == solved).all()
    assert solved.sum() >= (7 if track == "paths" else 0)
    if track == "tasks":
        assert (score[solved] == results["E_mean"][solved]).all()


# ---------------------------------------------------------------------------- claims


@pytest.mark.parametrize(
    ("which", "name"), [("own", "score"), ("own", "E_peak"), ("policy", "E_decay")]
)
def test_a_number_claimed_lower_than_it_is(which, name, request, refused):
    spoiled = Spoiled(request.getfixturevalue(which))
    values = spoiled.plain["results"][name][0]
    values[3] *= 0.99
    assert refused(spoiled) is Code.SCORE_DIFFERS
    values[3] *= 1.02 / 0.99  # worse than it is: that costs whoever claims it
    assert refused(spoiled) is None


def test_claims_change_nothing_of_what_comes_out(own, tmp_path):
    spoiled = Spoiled(own)
    for name in ("score", "E_decay"):
        spoiled.plain["results"][name] = [[2 * k for k in spoiled.plain["results"][name][0]]]
    spoiled.plain["level"] = "reproduced"
    entry = verify_entry(spoiled.write(tmp_path / "e"))
    assert entry.level == "replayed"
    assert (entry.results["score"] == verify_entry(own).results["score"]).all()


@pytest.mark.parametrize(
    ("which", "name", "value"),
    [("own", "success", 1), ("own", "E_mean", 0.0), ("straight", "score", 0.5)],
)
def test_what_nobody_has_is_refused(which, name, value, request, refused):
    """The track of `own` has no E_mean."""
    spoiled = Spoiled(request.getfixturevalue(which))
    spoiled.plain["results"][name] = [[value] * 10]
    assert refused(spoiled) is Code.SCORE_DIFFERS


def test_another_method_under_a_name(straight, policy, refused):
    spoiled = Spoiled(straight)
    spoiled.plain["method"]["name"] = "shaped-zvd"  # does not do what the straight line does
    spoiled.plain["results"]["score"] = [[0.2] * 10]
    assert refused(spoiled) is Code.SCORE_DIFFERS
    for name in ("mine", "straight2", ""):
        spoiled.plain["method"]["name"] = name
        assert refused(spoiled) is Code.NOT_REPRODUCIBLE
    spoiled = Spoiled(policy)
    spoiled.plain["method"] |= {"kind": "planner", "weights": []}
    assert refused(spoiled) is Code.UNKNOWN_PROBLEM


@pytest.mark.parametrize(
    ("key", "value", "code"),
    [
        ("track", "paths", Code.UNKNOWN_PROBLEM),
        ("problem", "ves/PumaDamp-v99", Code.UNKNOWN_PROBLEM),
        ("problem", "ves/PumaDamp-v0", Code.WRONG_LENGTH),  # the short one told as the whole
    ],
)
def test_another_problem(key, value, code, own, refused):
    spoiled = Spoiled(own)
    spoiled.plain[key] = value
    assert refused(spoiled) is code


@pytest.mark.parametrize("change", [lambda g: g[:-1], lambda g: [*g, g[0]]])
def test_episodes_left_out_or_told_twice(change, own, refused):
    spoiled = Spoiled(own)
    results = spoiled.plain["results"]
    spoiled.plain["results"] = {k: [change(g) for g in v] for k, v in results.items()}
    assert refused(spoiled) is Code.WRONG_LENGTH


# --------------------------------------------------------------------------- answers


def answers_of(place, shape, count=10):
    """Recorded answers of the one group."""
    data = (place / RECORDING).read_bytes()
    return [answer.copy() for answer in unpack(data, 1, count, shape)[0]]


def with_answer(place, refused, shape, k, change):
    """The code of an entry with the k-th answer changed."""
    spoiled, group = Spoiled(place), answers_of(place, shape)
    group[k] = change(group[k])
    spoiled.record([group])
    return refused(spoiled)


JOINTS = (3,)


@pytest.mark.parametrize(
    ("change", "code"),
    [
        (lambda a: a, None),
        (lambda a: a[:-1], Code.WRONG_LENGTH),  # ended where it looks good
        (lambda a: np.concatenate([a, a[:1]]), Code.WRONG_LENGTH),
        (lambda a: 200 * a, Code.BAD_RECORDING),
        (lambda a: np.nan * a, Code.BAD_RECORDING),
        (lambda a: a[:, :-1], Code.BAD_RECORDING),
    ],
)
def test_changed_actions(change, code, own, refused):
    assert with_answer(own, refused, JOINTS, 3, change) is code


def test_a_cheap_episode_in_the_place_of_a_dear_one(own, refused):
    spoiled, group = Spoiled(own), answers_of(own, JOINTS)
    cheap, *_, dear = np.argsort(spoiled.plain["results"]["score"][0]).tolist()
    group[dear] = group[cheap]
    for values in spoiled.plain["results"].values():
        values[0][dear] = values[0][cheap]
    spoiled.record([group])
    assert refused(spoiled) in (Code.SCORE_DIFFERS, Code.WRONG_LENGTH)


@pytest.mark.parametrize(
    ("change", "code"),
    [
        # no rest at the start
        (lambda p: p + np.eye(len(p))[:, :1] * 1e-3, Code.BAD_RECORDING),
        (lambda p: p + 1e-3, Code.SCORE_DIFFERS),  # joins other ends
        (lambda p: p[:3], Code.BAD_RECORDING),
        (lambda p: p[:0], Code.SCORE_DIFFERS),  # none, told as one
        (lambda p: np.repeat(p, 200, axis=0), Code.BAD_RECORDING),
    ],
)
def test_changed_motions(change, code, mute, refused):
    assert with_answer(mute, refused, JOINTS, 5, change) is code


def test_gains_of_ones_own(folder, refused, monkeypatch):
    """Matrices that are none are refused; the high gains, recorded, score one."""
    monkeypatch.setattr(gain_track, "SECONDS", 2.0)
    place = folder / "gains"
    make_entry(place, *GAINS, gain_track.tuner("high"), name="mine")
    spoiled, group = Spoiled(place), answers_of(place, (3, 3), count=5)
    for change, code in (
        (lambda g: g * np.nan, Code.BAD_RECORDING),
        (lambda g: -g, Code.BAD_RECORDING),
        (lambda g: 100 * g, Code.BAD_RECORDING),  # beyond the bounds
        (lambda g: g + np.triu(np.ones((3, 3)), 1), Code.BAD_RECORDING),
        (lambda g: g[:1], Code.WRONG_LENGTH),
    ):
        spoiled.record([[change(g) for g in group]])
        assert refused(spoiled) is code
    entry = verify_entry(place)
    assert entry.method.kind == "gains" and entry.level == "replayed"
    np.testing.assert_allclose(entry.results["score"], np.ones((1, 5)), rtol=1e-9)


# -------------------------------------------------------------------------- policies


def flipped(data):
    """A byte of the weights that another has changed."""
    return data[:-2] + bytes([data[-2] ^ 0x40]) + data[-1:]


@pytest.mark.parametrize(
    ("which", "change"),
    [
        ("policy-0.safetensors", flipped),
        ("policy-0.json", lambda data: data.replace(b'"tanh"', b'"eval"')),
        ("policy-0.json", lambda data: b"[" * 2000),
        ("policy-0.safetensors", lambda data: b"\x80\x04\x95."),
    ],
)
def test_policies_that_are_changed_or_cannot_be_read(which, change, policy, refused):
    spoiled = Spoiled(policy)
    before = spoiled.files[which]
    spoiled.files[which] = change(before)
    assert spoiled.files[which] != before and refused(spoiled) is Code.BAD_POLICY


def test_a_policy_that_is_not_there_or_fits_elsewhere(policy, refused):
    spoiled = Spoiled(policy)
    for name in ("policy-0.json", "policy-0.safetensors"):
        del spoiled.files[name]
    assert refused(spoiled) is Code.NOT_REPRODUCIBLE
    spoiled = Spoiled(policy)
    spoiled.plain |= {"track": "tasks", "problem": "ves/BeamLQR-v0-quick"}
    assert refused(spoiled) is Code.BAD_POLICY


def test_a_copy_of_a_policy_is_no_other_training(tmp_path):
    """With a little noise on its weights."""
    files = [
        save_random_policy(tmp_path / f"{k}.json", noise=n) for k, n in enumerate((0, 1e-6))
    ]
    with pytest.raises(ParameterError, match="count twice"):
        make_entry(tmp_path / "e", *DAMP, files)


def test_two_trainings_are_groups_and_one_told_twice_is_refused(tmp_path, refused):
    files = [save_random_policy(tmp_path / f"{k}.json", seed=k) for k in (3, 5)]
    made = make_entry(tmp_path / "e", *DAMP, files)
    assert made.method.seeds == (3, 5) and made.results["score"].shape == (2, 10)
    spoiled = Spoiled(tmp_path / "e")
    for end in ("json", "safetensors"):
        spoiled.files[f"policy-1.{end}"] = spoiled.files[f"policy-0.{end}"]
    method, results = spoiled.plain["method"], spoiled.plain["results"]
    method["weights"] = [method["weights"][0]] * 2
    spoiled.plain["results"] = {k: [v[0], v[0]] for k, v in results.items()}
    assert refused(spoiled) is Code.REPEATED_GROUP


# -------------------------------------------------------------------- seeds, settings


def test_no_seed_can_be_picked(straight, tmp_path, refused):
    spoiled = Spoiled(straight)
    spoiled.plain["method"]["seeds"] = [7]
    assert refused(spoiled) is Code.WRONG_SEEDS
    with pytest.raises(ParameterError, match="in order"):
        make_entry(tmp_path / "e", *LINES, "straight", seeds=(1,))


def test_official_seeds(folder, refused):
    place = folder / "official"
    make_entry(place, *DAMP, "zero", salt=SALT)
    entry = verify_entry(place, salt=SALT)
    assert entry.seeds.startswith("official-") and SALT not in (place / ENTRY).read_text()
    assert code_of(place, salt=SALT + "!") is Code.WRONG_SEEDS
    with pytest.raises(ParameterError, match="salt"):
        verify_entry(place)
    spoiled = Spoiled(place)  # results on secret seeds, told as of public ones
    spoiled.plain["seeds"] = "public"
    assert refused(spoiled) is Code.SCORE_DIFFERS


@pytest.mark.parametrize(
    "settings",
    [
        {"duration": 4.0},
        {"goal": 1},
        {"goal": True},
        {"control": {"kind": "torque", "damping": [1e300] * 3}},
        {"control": {"kind": "magic"}},
        {"control": "module:Class"},
    ],
)
def test_settings_that_are_not_the_methods_to_choose(settings, own, refused):
    spoiled = Spoiled(own)
    spoiled.plain["method"]["settings"] = settings
    assert refused(spoiled) is not None


def test_a_control_that_an_id_names_stays():
    id, *_ = (k for k, spec in gym.registry.items() if "control" in spec.kwargs)
    with pytest.raises(ParameterError, match="names its control"):
        require_settings(id, {"control": {"kind": "guided", "jerk": 4000.0}})


# ------------------------------------------------------------------------- the board


def whole(entry, **changes):
    """An entry of a whole problem, for a board."""
    results = {k: np.tile(v, 10) for k, v in entry.results.items()}
    made = {**vars(entry), "problem": entry.problem.removesuffix("-quick"), "results": results}
    return type(entry)(**{**made, **changes})


def test_an_entry_goes_to_the_board_and_is_verified_there(straight, own, tmp_path):
    entry = verify_entry(straight)
    with pytest.raises(ParameterError, match="first try"):
        add(tmp_path / "entries", entry)
    place = add(tmp_path / "entries", whole(entry))
    assert place.name == "paths_bent-1s_anonymous_straight.json"
    with pytest.raises(ParameterError, match="cannot replace"):
        add(tmp_path / "entries", whole(entry, level="replayed"))
    alone = tmp_path / "alone.json"  # a file of the board, without its folder
    shutil.copy(straight / ENTRY, alone)
    assert verify_entry(alone).level == "reproduced"
    shutil.copy(own / ENTRY, alone)
    assert code_of(alone) is Code.NOT_REPRODUCIBLE


@pytest.mark.parametrize(
    ("problem", "method", "name", "why"),
    [
        (DAMP, "nonsense", None, "or one of zero, random"),
        (DAMP, ["a.json", "b.json"], None, r"a\.json"),
        (LINES, "nonsense", None, "planner must be"),
        (GAINS, "nonsense", None, "gains must be"),
        (DAMP, Gentle(), "Gentle One", "name must be of a-z"),
    ],
)
def test_bad_usage_is_no_refusal(problem, method, name, why, tmp_path):
    with pytest.raises(ParameterError, match=why):
        make_entry(tmp_path / "e", *problem, method, name=name)
    assert not (tmp_path / "e").exists()
