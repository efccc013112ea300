"""Track tasks: success first, then energy; and what a forger of either would try."""

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.entries import made_entry
from tests.leaderboard.bundles import Bundle
from ves_gym._util.params import ParameterError
from ves_gym._util.statistics import iqm, rate
from ves_gym.baselines.evaluate import evaluate
from ves_gym.baselines.policy import released
from ves_gym.baselines.registry import CONTROLLERS, REFERENCES, get_controller
from ves_gym.envs.registration import IDS
from ves_gym.leaderboard import statistics as s
from ves_gym.leaderboard.board import make_board
from ves_gym.leaderboard.errors import BundleError, Code
from ves_gym.leaderboard.journal import append, read
from ves_gym.leaderboard.npy_io import pack, pack_levels, unpack_levels
from ves_gym.leaderboard.protocol import TASKS
from ves_gym.leaderboard.run import make_bundle
from ves_gym.leaderboard.tracks.action_recorder import Recorded, Replayed
from ves_gym.leaderboard.tracks.policies import chosen_settings
from ves_gym.leaderboard.tracks.tasks import TaskTrack
from ves_gym.leaderboard.verify import verify

REACH = ("tasks", "ves/PumaReach-v1-quick")
REST = ("tasks", "ves/PumaRestToRest-v1-quick")
LEVELS = TaskTrack.LEVELS


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("bundles")


@pytest.fixture(scope="module")
def solved(folder):
    """All ten solved."""
    return make_bundle(folder / "resolved.zip", *REACH, "resolved")


@pytest.fixture(scope="module")
def idle(folder):
    """None solved, without any energy."""
    return make_bundle(folder / "zero.zip", *REACH, "zero")


@pytest.fixture(scope="module")
def planned(folder):
    return make_bundle(folder / "direct.zip", *REST, "direct")


@pytest.fixture
def refused(tmp_path):
    """What a bundle is refused for."""

    def check(bundle, **options):
        with pytest.raises(BundleError) as error:
            verify(bundle.write(tmp_path / "b.zip"), **options)
        return error.value

    return check


def actions_of(bundle, width=3):
    return unpack_levels(bundle.members["actions.npy"], "actions.npy", width, LEVELS).copy()


# ------------------------------------------------------------------------- problems


def test_the_problems_are_the_latest_version_of_every_task():
    latest = {}
    for id in (k for k in gym.registry if k.startswith("ves/")):
        name, _, version = id.removeprefix("ves/").rpartition("-v")
        if name.removesuffix("Emulated") in IDS:
            latest[name] = max(latest.get(name, 0), int(version))
    assert {f"{name}-v{version}" for name, version in latest.items()} == set(TASKS)
    assert set(REFERENCES) == set(IDS) and set(REFERENCES.values()) <= set(CONTROLLERS)


# ------------------------------------------------------------------- honest bundles


def test_a_score_is_the_energy_of_a_solved_episode(solved, idle):
    entry = verify(solved, level="reproduced")
    assert all(r["success"] and r["score"] == r["E_mean"] > 0 for r in entry.rows)
    assert entry.about["reproduction"]["equal"] == 10
    nothing = verify(idle, level="reproduced")
    assert not any(r["success"] or r["failed"] for r in nothing.rows)
    assert {(r["score"], r["E_mean"]) for r in nothing.rows} == {(None, 0.0)}


def test_the_replay_gives_the_bits(solved):
    for row, told in zip(verify(solved).rows, Bundle(solved).manifest["rows"], strict=True):
        assert all(row[k] == told[k] for k in ("score", "success", "E_mean", "E_peak", "E_res"))


@pytest.mark.slow
@pytest.mark.parametrize("name", TASKS)
def test_every_problem_is_reproduced_to_the_last_bit(name, tmp_path):
    reference = REFERENCES[name.rpartition("-v")[0].removesuffix("Emulated")]
    path = make_bundle(tmp_path / "b.zip", "tasks", f"ves/{name}-quick", reference)
    entry = verify(path, level="reproduced")
    assert entry.about["reproduction"]["equal"] == 10
    assert sum(r["success"] for r in entry.rows) >= 8


def test_actions_are_multiples_of_a_step(solved):
    actions = actions_of(Bundle(solved))
    assert np.array_equal(actions * LEVELS, np.rint(actions * LEVELS))
    assert np.abs(actions).max() <= 1
    ends = np.array([[-1.0, 1.0], [1.0, -1.0], [0.25, -1.0]])
    data = pack_levels(ends, 8192)
    assert np.array_equal(unpack_levels(data, "a", 2, 8192), ends)
    assert unpack_levels(pack_levels(np.zeros((0, 2)), 8), "a", 2, 8).shape == (0, 2)


class Watched:
    """A controller, and the largest rate of a joint over its limit in its episodes."""

    def __init__(self, name):
        self.inner = get_controller(name)
        self.name, self.privileged, self.largest = name, True, 0.0

    def reset(self, env, ids):
        self.inner.reset(env, ids)

    def act(self, env, observation):
        rates = np.abs(env.batch.scene.v) / env.task.system.arm.column("v_max")
        self.largest = max(self.largest, float(rates.max()))
        return self.inner.act(env, observation)


def test_the_tasks_do_not_limit_rates():
    """Rated speeds are no part of what they ask, unlike in the track paths."""
    largest = {}
    for id, name in (
        ("PumaReach", "resolved"),
        ("PumaDamp", "lqi"),
        ("PumaRestToRest", "adaptive"),
    ):
        watched = Watched(name)
        evaluate(watched, f"ves/{id}-v1", episodes=50, seed=19_940_000)
        largest[name] = watched.largest
    print(largest)
    assert largest["resolved"] < 1.03
    assert largest["lqi"] == pytest.approx(1.65, abs=0.05)
    assert largest["adaptive"] == pytest.approx(2.19, abs=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("id", "name", "most"),
    [
        ("ves/PumaReach-v1", "resolved", 1e-4),
        ("ves/PumaReach-v1", "homing", 4e-3),
        ("ves/PumaReach-v1", "closing", 5e-2),
        ("ves/PumaDamp-v1", "lqi", 1e-4),
        ("ves/BeamLQREmulated-v1", "lqr", 1e-4),
    ],
)
def test_what_the_step_of_an_action_changes(id, name, most):
    """Interquartile mean of E_mean, with and without; `closing` answers its own ripples."""
    law = get_controller(name)
    settings = chosen_settings(law, id)
    found = []
    for levels in (None, LEVELS):
        controller = Recorded(get_controller(name), levels)
        rows = evaluate(controller, id, episodes=100, seed=19_940_000, **settings).rows
        found.append(
            (sum(r["success"] for r in rows), iqm(np.array([r["E_mean"] for r in rows])))
        )
    print(id, name, found)
    assert found[0][0] == found[1][0]
    assert abs(found[1][1] / found[0][1] - 1) < most


# --------------------------------------------------------------------------- attacks


def test_a_success_that_the_replay_does_not_have(idle, refused):
    bundle = Bundle(idle)
    for row in bundle.manifest["rows"]:
        row |= {"success": True, "score": row["E_mean"]}
    error = refused(bundle)
    assert (
        error.code is Code.SCORE_DIFFERS and "success is False, claimed was True" in error.why
    )


def test_an_energy_as_the_score_of_what_was_not_solved(idle, refused):
    """Without the claim to have solved it, the energy of doing nothing would still win."""
    bundle = Bundle(idle)
    for row in bundle.manifest["rows"]:
        row["score"] = row["E_mean"]
    error = refused(bundle)
    assert error.code is Code.SCORE_DIFFERS and "score is None" in error.why


@pytest.mark.parametrize("name", ["score", "E_mean", "E_peak", "E_res", "E_int"])
def test_an_energy_claimed_lower(name, solved, refused):
    bundle = Bundle(solved)
    row = bundle.manifest["rows"][3]
    row[name] *= 1 - 1e-4
    assert refused(bundle).code in (Code.SCORE_DIFFERS, Code.BELOW_FLOOR)
    row[name] = -1e-3
    assert refused(bundle).code in (Code.SCORE_DIFFERS, Code.BELOW_FLOOR)


def test_a_shortened_list_of_episodes(solved, refused):
    """The dear ones left out, with their seeds and actions, everything else in order."""
    bundle = Bundle(solved)
    rows, seeds = bundle.manifest["rows"], bundle.manifest["seeds"]["list"]
    dear = max(range(10), key=lambda k: rows[k]["E_mean"])
    ends = np.cumsum([r["length"] for r in rows])
    actions = np.delete(
        actions_of(bundle), slice(ends[dear] - rows[dear]["length"], ends[dear]), 0
    )
    bundle.members["actions.npy"] = pack_levels(actions, LEVELS)
    del rows[dear]
    assert refused(bundle).code is Code.MISSING_EPISODE
    del seeds[dear]
    assert refused(bundle).code is Code.WRONG_SEEDS


def test_a_cheap_episode_in_the_place_of_a_dear_one(solved, refused):
    bundle = Bundle(solved)
    rows = bundle.manifest["rows"]
    cheap, dear = (f(range(10), key=lambda k: rows[k]["E_mean"]) for f in (min, max))
    rows[dear] = {**rows[cheap], "id": rows[dear]["id"], "seed": rows[dear]["seed"]}
    assert refused(bundle).code is Code.SCORE_DIFFERS
    rows[dear] |= {"id": rows[cheap]["id"], "seed": rows[cheap]["seed"]}
    assert refused(bundle).code is Code.EXTRA_EPISODE


def test_the_short_problem_told_as_the_whole(solved, refused):
    bundle = Bundle(solved)
    bundle.manifest["problem"] = "ves/PumaReach-v1"
    assert refused(bundle).code is Code.WRONG_SEEDS


def test_an_episode_ended_where_it_looks_solved(solved, refused):
    """A success counts at the deadline; the last periods cannot be left away."""
    bundle = Bundle(solved)
    bundle.manifest["rows"][-1]["length"] -= 20
    bundle.members["actions.npy"] = pack_levels(actions_of(bundle)[:-20], LEVELS)
    assert refused(bundle).code is Code.EPISODE_LENGTH


def test_a_success_of_an_episode_that_leaves_the_limits(planned, refused):
    """The last motion drives on through a joint's end: told as whole, and told as it ends."""
    bundle = Bundle(planned)
    rows = bundle.manifest["rows"]
    assert rows[-1]["success"]
    last, actions = rows[-1]["length"], actions_of(bundle)
    actions[-last:] = 1.0
    bundle.members["actions.npy"] = pack_levels(actions, LEVELS)
    assert refused(bundle).code is Code.EPISODE_LENGTH
    seed = bundle.manifest["seeds"]["list"][-1]
    played = Replayed({seed: actions[-last:]})
    (found,) = evaluate(played, "ves/PumaRestToRest-v1", episodes=1, seed=seed).rows
    assert found["failed"] and not found["success"] and found["length"] < last
    rows[-1]["length"] = found["length"]
    cut = actions[: len(actions) - last + found["length"]]
    bundle.members["actions.npy"] = pack_levels(cut, LEVELS)
    error = refused(bundle)
    assert (
        error.code is Code.SCORE_DIFFERS and "success is False, claimed was True" in error.why
    )


@pytest.mark.parametrize(
    "data",
    [
        lambda a: pack(a),  # float64, as other tracks have it
        lambda a: pack_levels(a * 1.01, LEVELS),
        lambda a: pack_levels(a[:, :2], LEVELS),
        lambda a: pack_levels(a, LEVELS)[:-2],
        lambda a: b"",
    ],
)
def test_actions_that_are_none(data, solved, refused):
    bundle = Bundle(solved)
    actions = actions_of(bundle)
    actions[5] = 1.0
    bundle.members["actions.npy"] = data(actions)
    assert refused(bundle).code is Code.BAD_ACTION


def test_an_easier_task_cannot_be_chosen(solved, planned, refused):
    """Neither how near the tool must come, nor jerks that the id does not permit."""
    bundle = Bundle(solved)
    bundle.manifest["method"]["settings"] = {"tolerance": 0.5}
    assert refused(bundle).code is Code.MALFORMED_MANIFEST
    bundle = Bundle(planned)
    bundle.manifest["method"]["settings"] = {"control": {"kind": "guided", "jerk": 4000.0}}
    error = refused(bundle)
    assert error.code is Code.MALFORMED_MANIFEST and "names its control" in error.why


def test_a_method_that_asks_for_an_easier_control(folder):
    class Eager:
        name, privileged = "eager", False

        def settings(self, spec):
            return {"control": {"kind": "guided", "jerk": 4000.0}}

        def act(self, env, observation):
            raise AssertionError("asked for nothing")

    with pytest.raises(ParameterError, match="names its control"):
        make_bundle(folder / "eager.zip", *REST, Eager())


def test_a_method_that_does_something_else_when_run_again(solved, refused):
    bundle = Bundle(solved)
    bundle.manifest["method"]["name"] = "homing"
    assert refused(bundle, level="reproduced").code is Code.NOT_REPRODUCED


# --------------------------------------------------------------------------- ranking


def entry(name, energies, unsolved=(), **more):
    """An entry of 100 episodes: energies of all of them, and which were not solved."""
    made = made_entry(
        name,
        scores=energies,
        track="tasks",
        problem="ves/PumaReach-v1",
        kind="controller",
        score={"name": "E_mean of solved episodes", "unit": "J", "better": "lower"},
        **more,
    )
    for k, row in enumerate(made["rows"]):
        row |= {"E_mean": float(energies[k]), "failed": False}
        if k in unsolved:
            row |= {"score": None, "success": False}
    return made


SPREAD = np.exp(np.random.default_rng(1).normal(size=100))  # of the same episodes for everyone
ORDER = np.argsort(SPREAD)


def ranks(*entries):
    return [place.rank.value for place in s.standings([[e] for e in entries])]


def test_who_solves_clearly_less_is_never_above_whatever_the_energy():
    all_of_them = entry("all", SPREAD)
    easy = entry("easy", 1e-6 * SPREAD, unsolved=set(ORDER[80:]))  # only what is easy anyway
    nothing = entry("nothing", 0 * SPREAD, unsolved=set(range(100)))
    assert ranks(nothing, easy, all_of_them) == [3, 2, 1]
    first, second, third = s.standings([[all_of_them], [easy], [nothing]])
    assert [first.level, second.level, third.level] == [1, 2, 3]
    assert first.rank == (1, 1, 1) and third.rank == (3, 3, 3)


def test_within_a_class_the_energy_decides():
    """97 of 100 solved are not clearly fewer than 100; half the energy is clearly less."""
    all_of_them, thrifty = (
        entry("all", SPREAD),
        entry("thrifty", SPREAD / 2, unsolved={3, 7, 9}),
    )
    assert ranks(all_of_them, thrifty) == [2, 1]
    assert [p.level for p in s.standings([[all_of_them], [thrifty]])] == [1, 1]


@pytest.mark.parametrize("left_out", [1, 5, 20, 30])
def test_to_give_an_episode_up_never_pays(left_out):
    """The dearest, the cheapest or any: the score of the same motions gets no better."""
    whole = s.score([entry("whole", SPREAD)]).value
    for given_up in (ORDER[-left_out:], ORDER[:left_out], np.arange(left_out)):
        assert s.score([entry("part", SPREAD, unsolved=set(given_up))]).value >= whole


def test_equal_classes_without_a_finite_score_go_by_what_they_solve():
    """40 and 50 of 100 overlap; more than a quarter unsolved leaves no score."""
    less = entry("less", SPREAD, unsolved=set(range(60)))
    more = entry("more", 2 * SPREAD, unsolved=set(range(50)))
    none = [entry(k, SPREAD, unsolved=set(range(100))) for k in "ab"]
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
    ends = [rate(np.arange(100) < k) for k in hits]
    for a, la in zip(ends, level, strict=True):
        for b, lb in zip(ends, level, strict=True):
            if a.low > b.high:
                assert la < lb
            if la == lb:
                assert a.low <= b.high and b.low <= a.high
    assert sorted(set(level.tolist())) == list(range(1, level.max() + 1))


def test_energies_are_compared_in_the_episodes_that_both_solved():
    """The law is twice as dear in what both solve; what one alone solves says nothing."""
    law = entry("law", 2 * SPREAD, unsolved={0, 1})
    mine = entry(
        "mine", np.where(np.arange(100) < 50, SPREAD, 1e3), unsolved=set(range(50, 100))
    )
    found, n = s.energy_over(mine, law)
    assert n == 48 and found == pytest.approx((0.5, 0.5, 0.5))
    assert s.energy_over(entry("few", SPREAD, unsolved=set(range(9, 100))), law) is None
    still = entry("still", 0 * SPREAD)
    assert s.energy_over(mine, still) is None
    with pytest.raises(ParameterError, match="did not play the same"):
        s.energy_over({**mine, "problem": "ves/PumaTrack-v1"}, law)


def test_the_board_tells_class_and_energy_over_the_reference(tmp_path):
    place = tmp_path / "entries"
    append(place, entry("idle", 0 * SPREAD, unsolved=set(range(100))))
    append(place, entry("mine", SPREAD / 2))
    append(place, entry("resolved", SPREAD))
    (track,) = make_board(read(place))["tracks"]
    (group,) = track["groups"]
    told = [(e["name"], e["class"], e.get("over")) for e in group["entries"]]
    law = {"law": "resolved", "episodes": 100}
    assert told == [
        ("mine", 1, {**law, "ratio": [0.5, 0.5, 0.5]}),
        ("resolved", 1, {**law, "ratio": [1.0, 1.0, 1.0]}),
        ("idle", 2, None),
    ]
    assert group["entries"][2]["E_mean"] == 0.0  # of all episodes, as it is
    assert track["title"] == "Tasks" and group["score"]["unit"] == "J"


def test_a_policy_bundle_of_the_track(folder):
    """A released policy, its control by its own settings."""
    files = [released("ves/PumaReach-v1")["closing-dagger"]]
    entry = verify(make_bundle(folder / "p.zip", *REACH, files), level="reproduced")
    assert entry.kind == "policy" and sum(r["success"] for r in entry.rows) >= 8
