"""Honest bundles of every track pass, at both levels; what they prove is computed here."""

import copy
import json
import multiprocessing
import time
from pathlib import Path

import numpy as np
import pytest

from tests.leaderboard.bundles import PATHS, POLICY, Bundle, path_bundle, policy_bundle
from ves_gym._util.params import ParameterError
from ves_gym.baselines.evaluate import evaluate
from ves_gym.baselines.registry import get_controller
from ves_gym.cli.main import main
from ves_gym.leaderboard import lower_bounds, protocol
from ves_gym.leaderboard.audit import drawn
from ves_gym.leaderboard.energy_audit import Account
from ves_gym.leaderboard.entry import check_entry
from ves_gym.leaderboard.errors import BundleError, Code
from ves_gym.leaderboard.journal import append
from ves_gym.leaderboard.npy_io import pack, unpack
from ves_gym.leaderboard.protocol import PROTOCOL, get_problem, seeds_of
from ves_gym.leaderboard.published import publish, reverify
from ves_gym.leaderboard.run import make_bundle
from ves_gym.leaderboard.time_limit import within
from ves_gym.leaderboard.tracks.action_recorder import Recorded, Replayed, in_episode
from ves_gym.leaderboard.tracks.paths import PathTrack
from ves_gym.leaderboard.verify import verify
from ves_gym.mechanics.vehicle import BENT_THESIS
from ves_gym.planners.best_known import key, packaged
from ves_gym.system.system import System

ROOT = Path(__file__).parents[2]
SALT = "a secret of the maintainer"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("bundles")


@pytest.fixture(scope="module")
def policy(folder):
    return policy_bundle(folder)


@pytest.fixture(scope="module")
def paths(folder):
    return path_bundle(folder)


def rejection(path, **options):
    with pytest.raises(BundleError) as refused:
        verify(path, **options)
    return refused.value


# ---------------------------------------------------------------------------- policies


@pytest.mark.parametrize("level", ["replayed", "reproduced"])
def test_a_policy(policy, level):
    entry = verify(policy, level=level)
    assert (entry.track, entry.problem) == POLICY
    assert (entry.kind, entry.name, entry.author) == ("policy", "ppo", "someone")
    assert (
        entry.level == level
        and entry.seeds == "public"
        and entry.protocol == PROTOCOL[entry.track]
    )
    assert entry.score["better"] == "lower"
    assert check_entry(entry.to_dict()) == entry
    assert len(entry.rows) == 10 and all("length" not in row for row in entry.rows)


def test_scores_are_those_of_evaluate(policy):
    """Bit for bit, though that ran the policy and this its recorded actions."""
    from ves_gym.baselines.policy import load_policy, released

    id = "ves/PumaRestToRest-v0"
    found = evaluate(load_policy(released(id)["ppo"]), id, episodes=10, seed=19_940_000)
    entry = verify(policy)
    assert [r["score"] for r in entry.rows] == [-line["return"] for line in found.rows]
    for name in ("E_mean", "E_peak", "E_res", "E_int"):
        assert [r[name] for r in entry.rows] == [line[name] for line in found.rows]


def test_a_folder_proves_what_a_zip_does(policy, folder):
    unpacked = policy_bundle(folder, name="unpacked")
    ours, theirs = Bundle(unpacked), Bundle(policy)
    for member in ("actions.npy", "policy.json", "policy.safetensors"):
        assert ours.members[member] == theirs.members[member]
    assert verify(unpacked).rows == verify(policy).rows


def test_several_policies_are_groups(folder, tmp_path):
    """One, and one a little louder; the same one twice is refused."""
    from ves_gym.baselines.policy import load_policy, released, save_policy

    first = load_policy(released("ves/PumaRestToRest-v0")["ppo"])
    files = []
    for seed in (4, 7):
        first.about = {**first.about, "seed": seed}
        first.weights = tuple((1.01 * W, b) for W, b in first.weights)
        files.append(save_policy(first, tmp_path / f"p{seed}.json"))
    path = make_bundle(folder / "two", *POLICY, files)
    entry = verify(path, level="reproduced")
    assert [r["group"] for r in entry.rows] == [0] * 10 + [1] * 10
    assert [r["score"] for r in entry.rows[:10]] != [r["score"] for r in entry.rows[10:]]
    assert Bundle(path).manifest["method"]["seeds"] == [4, 7]
    with pytest.raises(ParameterError, match="count twice"):
        make_bundle(folder / "same", *POLICY, [files[0], files[0]])


def test_a_group_told_twice(policy, tmp_path):
    """The rows and actions of one training doubled, every digest brought up to date."""
    bundle = Bundle(policy)
    rows = bundle.manifest["rows"]
    bundle.manifest["rows"] = [*rows, *({**row, "group": 1} for row in rows)]
    actions = unpack(bundle.members["actions.npy"], "actions.npy", (None, 3))
    bundle.members["actions.npy"] = pack(np.r_[actions, actions])
    for kind in ("json", "safetensors"):
        bundle.members[f"policy-1.{kind}"] = bundle.members[f"policy.{kind}"]
    method = bundle.manifest["method"]
    method |= {"seeds": [4, 5], "weights": 2 * method["weights"]}
    assert rejection(bundle.write(tmp_path / "b.zip")).code is Code.REPEATED_GROUP


@pytest.mark.parametrize("trick", ["noise", "order of hidden units"])
def test_a_copy_of_a_policy_is_no_other_training(trick, policy, folder, tmp_path):
    from ves_gym.baselines.policy import load_policy, released, save_policy

    copied = load_policy(released("ves/PumaRestToRest-v0")["ppo"])
    files = [save_policy(copied, tmp_path / "first.json")]
    (W0, b0), (W1, b1), *last = copied.weights
    draw = np.random.default_rng(0)
    if trick == "noise":
        W0 = (W0 + 1e-5 * draw.standard_normal(W0.shape)).astype(W0.dtype)
    else:
        turn = draw.permutation(len(b0))
        rows = W0.shape[0] == len(b0)
        W0, b0 = (W0[turn] if rows else W0[:, turn]), b0[turn]
        W1 = W1[:, turn] if rows else W1[turn]
    copied.weights = ((W0, b0), (W1, b1), *last)
    files.append(save_policy(copied, tmp_path / "second.json"))
    with pytest.raises(ParameterError, match="do the same"):
        make_bundle(folder / f"copy-{trick[:5]}", *POLICY, files)


@pytest.mark.slow
def test_a_controller_with_settings_of_its_own(folder):
    path = make_bundle(folder / "direct", *POLICY, "direct")
    entry = verify(path, level="reproduced")
    assert entry.kind == "controller" and entry.name == "direct"
    assert entry.about["settings"]["control"] == {"kind": "guided", "jerk": 4000.0}
    assert entry.about["settings"]["privileged"] is True


def test_no_seed_can_be_picked(folder, tmp_path):
    path = make_bundle(folder / "random", *POLICY, "random")
    assert verify(path, level="reproduced").level == "reproduced"
    bundle = Bundle(path)
    bundle.manifest["method"]["seeds"] = [5]
    assert rejection(bundle.write(tmp_path / "b.zip")).code is Code.WRONG_SEEDS
    with pytest.raises(ParameterError, match=r"in order, 16 at most, got 5"):
        make_bundle(folder / "picked", *POLICY, "random", seeds=(5,))


@pytest.mark.parametrize("simd", [None, "none"])
def test_motions_of_another_planner(simd, paths, folder, tmp_path):
    """Better ones are refused, whatever the machine is said to be; worse ones do nothing."""
    better = Bundle(path_bundle(folder, name=f"direct-{simd}", method="direct"))
    worse = Bundle(paths)
    forged = []
    for mine, its in ((worse, better), (better, worse)):
        bundle = Bundle(paths)
        bundle.manifest = copy.deepcopy(mine.manifest)
        bundle.manifest["rows"] = copy.deepcopy(its.manifest["rows"])
        if simd is not None:
            bundle.manifest["about"]["simd"] = simd
        bundle.members["motions.npy"] = its.members["motions.npy"]
        forged.append(bundle.write(tmp_path / f"{mine.manifest['name']}.zip"))
    assert verify(forged[0]).level == "replayed"  # shown, not ranked
    assert rejection(forged[0], level="reproduced").code is Code.NOT_REPRODUCED
    entry = verify(forged[1], level="reproduced")
    scores = [row["score"] for row in better.manifest["rows"]]
    assert [row["score"] for row in entry.rows] == pytest.approx(scores, rel=1e-6)
    assert entry.about["reproduction"]["equal"] == 0
    assert entry.about["reproduction"]["largest"] > 0.1


def test_a_controller_of_ones_own_is_replayed(folder):
    class Lean:
        name, privileged = "lean", False

        def reset(self, env, ids):
            pass

        def act(self, env, observation):
            return np.full((env.num_envs, 3), 1.5)  # brought back to 1 by the environment

    path = make_bundle(folder / "lean", *POLICY, Lean())
    entry = verify(path)
    assert entry.name == "lean" and entry.about["settings"] == {"privileged": False}
    actions = unpack(Bundle(path).members["actions.npy"], "actions.npy", (None, 3))
    assert (actions == 1.0).all()
    assert rejection(path, level="reproduced").code is Code.NOT_REPRODUCIBLE


@pytest.mark.slow
@pytest.mark.parametrize("name", ["PumaReach", "PumaReachGoal", "PumaTrack", "BeamLQR",
                                  "FreeFlyerReach"])  # fmt: skip
@pytest.mark.parametrize("suffix", ["", "Emulated"])
def test_every_environment(name, suffix, tmp_path):
    from ves_gym.baselines.policy import released

    id = f"ves/{name}{suffix}-v0"
    files = [released(id)["ppo"]]
    path = make_bundle(tmp_path / "b.zip", "policies", f"{id}-quick", files)
    assert verify(path, level="reproduced").level == "reproduced"


# ------------------------------------------------------------------------------- paths


def test_the_straight_line(paths):
    entry = verify(paths, level="reproduced")
    assert (entry.track, entry.problem) == PATHS and entry.kind == "planner"
    assert [r["score"] for r in entry.rows] == [1.0] * 10
    assert [r["id"] for r in entry.rows[:2]] == ["reach-1s-000", "reach-1s-001"]
    assert all(r["seconds"] > 0 for r in entry.rows)


class Own:
    """A planner that nobody else has, and that has no answer to every other query."""

    name, summary = "own", "the straight line, or nothing"

    def __init__(self):
        self.asked = 0

    def find(self, query, seed):
        from ves_gym.planners.query import NoPlan

        self.asked += 1
        if self.asked % 2 == 0:
            raise NoPlan("every other query")
        return query.straight, {"evaluations": 3, "curve": [(0.1, 1, 5.0), (0.2, 3, 4.0)]}


def test_a_planner_of_ones_own_is_replayed_and_its_failures_count(folder):
    path = make_bundle(folder / "own", *PATHS, Own(), author="someone")
    entry = verify(path)
    assert [r["score"] for r in entry.rows] == [1.0, None] * 5
    assert [r["failed"] for r in entry.rows] == [False, True] * 5
    assert entry.rows[0]["evaluations"] == 3
    assert entry.rows[0]["anytime"] == [[0.1, 5.0], [0.2, 4.0]]
    assert entry.rows[1]["E_mean"] is None and not entry.rows[1]["success"]
    assert rejection(path, level="reproduced").code is Code.NOT_REPRODUCIBLE


def test_a_motion_told_as_a_success_that_breaks_a_limit(paths, tmp_path):
    """The way there and back with twice the speed that is allowed."""
    bundle = Bundle(paths)
    points = unpack(bundle.members["motions.npy"], "motions.npy", (None, 3)).copy()
    middle = np.repeat(points[[3]] + 3.0, 1, axis=0)
    bundle.members["motions.npy"] = pack(np.r_[points[:3], middle, points[3:]])
    bundle.manifest["rows"][0]["length"] += 1
    refused = rejection(bundle.write(tmp_path / "b.zip"))
    assert refused.code is Code.SCORE_DIFFERS and "success" in refused.why


@pytest.mark.slow
@pytest.mark.parametrize("problem", ["reach100-2s-quick", "reach100-4s-obstacles-quick"])
def test_planners(problem, tmp_path):
    path = make_bundle(tmp_path / "b.zip", "paths", problem, "refined", seeds=(0, 1))
    entry = verify(path, level="reproduced")
    scores = [r["score"] for r in entry.rows if r["score"] is not None]
    assert len(entry.rows) == 20 and len(scores) >= 12 and np.median(scores) < 0.5


@pytest.mark.slow
def test_a_hundred_of_each_within_a_minute(tmp_path):
    """100 episodes of a policy and 100 motions of a planner, simulated to the same bits."""
    from ves_gym.baselines.policy import released

    files = [released("ves/PumaRestToRest-v0")["ppo"]]
    whole = (
        make_bundle(tmp_path / "a.zip", "policies", "ves/PumaRestToRest-v0", files),
        make_bundle(tmp_path / "b.zip", "paths", "reach100-2s", "direct", workers=2),
    )
    begin = time.perf_counter()
    entries = [verify(path) for path in whole]
    assert time.perf_counter() - begin <= 60.0
    for entry, path in zip(entries, whole, strict=True):
        assert len(entry.rows) == 100
        for row, told in zip(entry.rows, Bundle(path).manifest["rows"], strict=True):
            assert all(row[k] == told[k] for k in ("score", "E_mean", "E_peak", "E_res"))


# ----------------------------------------------------------------------------- damping


def test_a_policy_on_damp(folder):
    """Less than one: the high gains on the same starts."""
    from ves_gym.baselines.policy import released

    files = [released("ves/PumaDamp-v0")["ppo"]]
    path = make_bundle(folder / "damp", "damping", "ves/PumaDamp-v0-quick", files)
    entry = verify(path)
    assert all(0.3 < r["score"] < 0.9 for r in entry.rows)


@pytest.fixture(scope="module")
def gains(folder):
    return make_bundle(folder / "gains.zip", "damping", "pped-bent-quick", "high")


def test_the_high_gains_score_one(gains):
    entry = verify(gains, level="reproduced")
    assert entry.kind == "gains" and [r["score"] for r in entry.rows] == [1.0] * 5
    assert all(r["E_peak"] >= 25.0 - 1e-9 for r in entry.rows)


@pytest.mark.parametrize(
    ("change", "code"),
    [
        (lambda g: g * np.nan, Code.BAD_ACTION),
        (lambda g: -g, Code.BAD_ACTION),
        (lambda g: 10 * g, Code.BAD_ACTION),  # beyond the bounds
        (lambda g: g + np.triu(np.ones((3, 3)), 1), Code.BAD_ACTION),
        (lambda g: g[:-1], Code.EPISODE_LENGTH),
        (lambda g: g * 0.99, Code.SCORE_DIFFERS),
    ],
)
def test_other_gains(change, code, gains, tmp_path):
    bundle = Bundle(gains)
    given = unpack(bundle.members["gains.npy"], "gains.npy", (None, 2, 3, 3))
    bundle.members["gains.npy"] = pack(change(given))
    assert rejection(bundle.write(tmp_path / "b.zip")).code is code


@pytest.mark.slow
def test_tuned_gains(tmp_path):
    path = make_bundle(tmp_path / "b.zip", "damping", "pped-bent-quick", "strain")
    entry = verify(path, level="reproduced")
    assert all(r["score"] < 1 for r in entry.rows)


# ------------------------------------------------------------------------- discrepancy


@pytest.mark.slow
def test_naming(tmp_path, monkeypatch):
    """Two cases of the thirty; the truth is made anew where the bundle is verified."""
    monkeypatch.setattr(protocol, "_CASES_QUICK", 2)
    for module in ("run", "verify"):  # a probe would see that the problem is another one
        name = f"ves_gym.leaderboard.{module}.require_behaviour"
        monkeypatch.setattr(name, lambda problem: None)
    problem = ("discrepancy", "blind-development-quick")
    path = make_bundle(tmp_path / "b.zip", *problem, "ves-gym", folder=tmp_path / "here")
    entry = verify(path, folder=tmp_path / "there")
    assert entry.kind == "selector" and len(entry.rows) == 2
    assert all(r["score"] in (0.0, 1.0) and r["seconds"] > 0 for r in entry.rows)
    again = verify(path, folder=tmp_path / "here", level="reproduced")
    assert [r["score"] for r in again.rows] == [r["score"] for r in entry.rows]

    def with_(name, old, new):
        bundle = Bundle(path)
        before = bundle.members["answers.json"]
        bundle.members["answers.json"] = before.replace(old, new)
        assert bundle.members["answers.json"] != before
        return rejection(bundle.write(tmp_path / name), folder=tmp_path / "there").code

    first = str(entry.rows[0]["seed"]).encode()
    assert with_("c.zip", b'"index":' + first, b'"index":601') is Code.EPISODE_LENGTH
    assert with_("d.zip", b'"verdict":"', b'"verdict":"x') is Code.BAD_ACTION
    bundle = Bundle(path)  # no answer to a case that it says is right
    answers = json.loads(bundle.members["answers.json"])
    answers["answers"][0] |= {"verdict": "failed", "effects": []}
    bundle.members["answers.json"] = json.dumps(answers).encode()
    bundle.manifest["rows"][0] |= {"score": 0.0, "success": True, "failed": False}
    refused = rejection(bundle.write(tmp_path / "e.zip"), folder=tmp_path / "there")
    assert refused.code is Code.SCORE_DIFFERS


# ------------------------------------------------------------------------------- seeds


def test_official_seeds(folder, tmp_path):
    path = policy_bundle(folder, name="official.zip", salt=SALT)
    manifest = Bundle(path).manifest
    assert manifest["seeds"]["which"] == "official"
    assert manifest["seeds"]["list"][0] > 10**9
    entry = verify(path, salt=SALT)
    assert entry.seeds == "official"
    assert [r["seed"] for r in entry.rows] == list(range(10))  # not the secret ones
    assert rejection(path, salt=SALT + "!").code is Code.WRONG_SEEDS
    with pytest.raises(ParameterError, match="salt"):
        verify(path)
    bundle = Bundle(path)  # told as public
    bundle.manifest["seeds"] |= {"which": "public", "mark": None}
    assert rejection(bundle.write(tmp_path / "b.zip")).code is Code.WRONG_SEEDS


@pytest.mark.slow
def test_official_queries(folder):
    path = path_bundle(folder, name="official-paths.zip", salt=SALT)
    entry = verify(path, salt=SALT)
    assert entry.seeds == "official" and len(entry.rows) == 10
    energies = [r["E_mean"] for r in verify(path_bundle(folder, "public.zip")).rows]
    assert [r["E_mean"] for r in entry.rows] != energies


# -------------------------------------------------------------------------- tolerances


def test_a_tolerance_holds_whatever_the_machine_is_said_to_be(policy, tmp_path):
    """A claim 1e-8 better is rounding, 1e-4 is not; a worse one is the claimant's loss."""

    def off(relative, simd):
        bundle = Bundle(policy)
        bundle.manifest["about"]["simd"] = simd
        for row in bundle.manifest["rows"]:
            row["E_mean"] *= 1 + relative
        return bundle.write(tmp_path / f"{relative}-{len(simd)}.zip")

    here = Bundle(policy).manifest["about"]["simd"]
    rows = verify(policy).rows  # the numbers are always those computed here
    for simd in (here, "elsewhere"):
        assert verify(off(-1e-8, simd)).rows == verify(off(1e-4, simd)).rows == rows
        assert rejection(off(-1e-4, simd)).code is Code.SCORE_DIFFERS


# ------------------------------------------------------------------- account and floors


def looked_at(id, name, episodes=4):
    """An account of episodes of a controller."""
    account, inner = Account(), get_controller(name)

    class Watched(Recorded):
        def act(self, env, observation):
            account.observe(env, in_episode(env))
            return super().act(env, observation)

    evaluate(Watched(inner), id, episodes=episodes)
    return account


@pytest.mark.parametrize(
    ("id", "name", "most"),
    [
        ("ves/PumaRestToRest-v0", "zero", 1e-4),
        ("ves/PumaDamp-v0", "random", 1e-3),
        ("ves/PumaReach-v0", "random", 2e-2),  # motors at their limits
        ("ves/FreeFlyerReach-v0", "random", 2e-3),
        ("ves/PumaReach-v1", "random", 1e-2),  # a base with internal modes
        ("ves/MacroMicro-v0", "random", 2e-2),
        ("ves/PumaDamp-v1", "high", 8e-2),  # let go with them at work: 12.5 ms are coarse
    ],
)
def test_the_account_of_an_episode_closes(id, name, most):
    residuals = looked_at(id, name).residuals()
    assert len(residuals) == 4
    assert 0 < max(residuals.values()) < most < protocol.LEDGER_EPISODES


def test_there_is_no_account_in_the_laboratory():
    assert looked_at("ves/PumaRestToRestEmulated-v0", "zero", 1).residuals() == {}


def test_there_is_no_account_where_something_is_grasped(tmp_path):
    """It knows one machine: 10 kg that are latched on the way would be energy from nowhere."""
    path = make_bundle(tmp_path / "b.zip", "tasks", "ves/PayloadTransfer-v0-quick", "resolved")
    assert sum(r["success"] for r in verify(path).rows) >= 8
    replayed = Replayed({0: np.zeros((800, 3))})
    evaluate(replayed, "ves/PayloadTransfer-v0", episodes=1)
    assert replayed.account.residuals() == {}
    replayed = Replayed({0: np.ones((320, 3))})
    evaluate(replayed, "ves/PumaReach-v1", episodes=1)
    assert len(replayed.account.residuals()) == 1


def test_energy_from_nowhere_is_found():
    """The account of an episode whose base loses a fifth of its motion on the way."""
    account = looked_at("ves/PumaDamp-v0", "zero", 1)
    (rows,) = account._episodes.values()
    half = len(rows) // 4
    account._episodes[0] = [
        np.where(np.arange(len(r)) < 18, r * (1 if k < half else 0.8), r)
        for k, r in enumerate(rows)
    ]
    assert max(account.residuals().values()) > protocol.LEDGER_EPISODES


def test_a_limit_of_the_account_refuses(policy, paths, monkeypatch):
    """With limits that no simulation can keep."""
    from ves_gym.leaderboard.tracks import paths as motions
    from ves_gym.leaderboard.tracks import policies as episodes

    monkeypatch.setattr(episodes, "LEDGER_EPISODES", 1e-12)
    assert rejection(policy).code is Code.LEDGER_RESIDUAL
    monkeypatch.setattr(motions, "LEDGER_PATHS", 1e-14)
    motions._REMEMBERED.clear()  # what was simulated under the true limit
    assert rejection(paths).code is Code.LEDGER_RESIDUAL


@pytest.mark.parametrize("duration", protocol.DURATIONS)
def test_what_momentum_permits_is_below_all_that_is_known(duration):
    """Far below: it is there for what is impossible, not for what is good."""
    problem = get_problem("paths", f"reach100-{duration}")
    for query in PathTrack().queries(problem, seeds_of(problem, None)):
        least = lower_bounds.path_floor(query.system, *query.ends, query.duration)
        best = packaged()[key(query.system.hash, query.name)]["E_mean"]
        assert 0 < least < 1e-4 * best


def test_strain_cannot_vanish_at_once():
    system = System(vehicle=BENT_THESIS)
    least = lower_bounds.strain_floor(system, 25.0, 26.0)
    assert 0.05 < least < 2.0  # of the released policy 5 J s and more
    assert (
        lower_bounds.strain_floor(system, 25.0, 1e6) < least
    )  # thrown about, it could be faster
    assert lower_bounds.strain_floor(system, 0.0, 1.0) == 0.0


# ----------------------------------------------------------------------------- bad usage


def test_bad_usage_is_no_rejection(policy, folder):
    with pytest.raises(ParameterError, match="level"):
        verify(policy, level="believed")
    with pytest.raises(ParameterError, match="expected a bundle"):
        verify(folder / "nothing.zip")
    with pytest.raises(ParameterError, match="planner"):
        make_bundle(folder / "x", *PATHS, "nonsense")
    with pytest.raises(ParameterError, match="controller"):
        make_bundle(folder / "x", *POLICY, "nonsense")
    with pytest.raises(ParameterError, match="in order"):
        make_bundle(folder / "x", *POLICY, "zero", seeds=(1, 1))
    with pytest.raises(ParameterError, match="empty folder"):
        policy_bundle(folder, name="")
    assert not (folder / "x").exists()


# ------------------------------------------------------------------- published bundles


@pytest.fixture
def board_with_bundle(paths, tmp_path):
    """A board of one entry, its bundle beside it."""
    record = append(tmp_path / "entries", verify(paths).shortened())
    place = publish(tmp_path / "entries", record, paths)
    return tmp_path / "entries" / record.name, place


def test_an_entry_is_verified_by_its_published_bundle(board_with_bundle, capsys):
    file, place = board_with_bundle
    assert place.stem == file.stem and place.parent.name == "bundles"
    assert reverify(file).alike == 1.0
    assert drawn(file.parent, 0.02, seed=1) == [file]
    assert main(["leaderboard", "verify", str(file)]) == 0
    assert "100% of 10 rows as on the board" in capsys.readouterr().out


def test_a_bundle_that_is_not_the_entrys_is_refused(board_with_bundle, tmp_path):
    file, place = board_with_bundle
    other = path_bundle(tmp_path, "other.zip", author="another")
    place.write_bytes(other.read_bytes())
    with pytest.raises(BundleError) as refused:
        reverify(file)
    assert refused.value.code is Code.HASH_MISMATCH
    place.unlink()
    done = reverify(file)  # its planner plans again
    assert done.again and done.alike == 1.0
    assert drawn(file.parent, 0.02, seed=1) == []


def test_rows_on_the_board_that_the_bundle_does_not_give(paths, tmp_path):
    """An entry entered by hand, with a false score: its bundle gives it away."""
    entry = verify(paths).shortened()
    for row in entry["rows"]:
        row["score"] = 0.5
    record = append(tmp_path / "entries", entry)
    place = publish(tmp_path / "entries", record, paths)
    with pytest.raises(BundleError, match=r"score-differs.*0% of the entry's rows"):
        reverify(tmp_path / "entries" / record.name)
    place.unlink()  # and without it its method does
    with pytest.raises(BundleError, match=r"score-differs.*0% of the entry's rows"):
        reverify(tmp_path / "entries" / record.name)


def test_verifying_takes_no_longer_than_it_may(paths, capsys):
    """Ended with its process; a refusal, and an entry, come back from there as they are."""
    assert main(["leaderboard", "verify", str(paths), "--seconds", "0.05"]) == 1
    assert "rejected: too-long: not done after 0.05 s" in capsys.readouterr().err
    words = ["leaderboard", "verify", str(paths), "--level", "reproduced", "--workers", "2"]
    assert main([*words, "--seconds", "600"]) == 0  # workers of its own, ended with it
    assert "reproduced: straight" in capsys.readouterr().out
    assert main([*words, "--seconds", "0.05"]) == 1
    assert multiprocessing.active_children() == []
    entry = within(600, verify, str(paths))
    assert entry == verify(paths)
    with pytest.raises(BundleError) as refused:
        within(600, verify, str(paths), expect="0" * 64)
    assert refused.value.code is Code.HASH_MISMATCH
