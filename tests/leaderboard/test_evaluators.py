"""An evaluator is what it computes: edits without effect pass, changed constants do not."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import ves_gym
from tests.leaderboard.bundles import Bundle, path_bundle
from ves_gym._util.params import ParameterError
from ves_gym.leaderboard import evaluators, probes, protocol, stored_results
from ves_gym.leaderboard.errors import BundleError, Code
from ves_gym.leaderboard.evaluators import Version
from ves_gym.leaderboard.protocol import PROTOCOL, Problem, get_problem, problems
from ves_gym.leaderboard.run import make_bundle
from ves_gym.leaderboard.verify import verify

PACKAGE = Path(ves_gym.__file__).parent
OLD = Path(__file__).parent / "bundles_0.1.0"  # made by that version
BUNDLES = ("policies", "damping")  # and paths, by rules 1 of that track
EVERY = [
    Problem(track, name)
    for track in PROTOCOL
    for name in problems(track)
    if not name.endswith(protocol.QUICK)
]
# each once: environments of the track damping share theirs with policies
NAMES = {name: problem for problem in EVERY for name in probes.probes_of(problem)}


# ------------------------------------------------------------------------------- probes


@pytest.mark.parametrize("name", NAMES)
def test_a_probe_gives_what_is_stored(name):
    """To 1e-9 of the largest of each series, whatever the processor."""
    stored = stored_results.golden(NAMES[name])[name]
    deviation = probes.compare(stored, probes.measure(NAMES[name], name))
    assert deviation.permitted, deviation


def test_every_environment_and_suite_has_probes():
    for problem in EVERY:
        names = stored_results.probe_names(problem)
        assert set(names) == set(probes.probes_of(problem)) and len(names) >= 2
        assert all(stored_results.is_stored(name) for name in names)
        quick = get_problem(problem.track, problem.name + protocol.QUICK)
        assert evaluators.identity(quick) == evaluators.identity(problem)
    assert len({evaluators.identity(problem) for problem in EVERY}) == len(EVERY)
    size = sum(file.stat().st_size for file in (PACKAGE / "leaderboard/golden").iterdir())
    assert size < 2e6


def test_whole_episodes_end_well_and_badly():
    """Otherwise a changed limit of the joints would show in none."""
    rows = [
        row
        for problem in EVERY
        for name, plain in stored_results.golden(problem).items()
        if "/evaluation" in name
        for row in plain["rows"]
    ]
    assert {row["failed"] for row in rows} == {True, False} and len(rows) == 111


@pytest.mark.parametrize(
    ("stored", "measured", "permitted"),
    [
        ([1.0, 2.0], [1.0, 2.0 + 1e-9], True),
        ([1.0, 2.0], [1.0 + 4e-9, 2.0], False),
        ([[1.0, 1e-6], [0.0, 0.0]], [[1.0, 1e-6 + 1e-13], [0.0, 0.0]], True),  # the floor
        ([[1.0, 1e-3], [0.0, 0.0]], [[1.0, 1e-3 + 1e-10], [0.0, 0.0]], False),  # by columns
        ({"a": 0.0}, {"a": 1e-13}, True),
        ({"a": 0.0}, {"a": 1e-11}, False),
        ({"a": 1}, {"a": 2}, False),
        ({"a": True}, {"a": False}, False),
        ({"a": None}, {"a": 1.0}, False),
        ({"a": 1.0}, {"b": 1.0}, False),
        ({"a": "x", "b": [[1.0], [1.0, 2.0]]}, {"a": "x", "b": [[1.0], [1.0, 2.0]]}, True),
        ([1.0, 2.0], [1.0], False),
        ([{"a": 1.0}], [{"a": 1.1}], False),
    ],
)
def test_comparison(stored, measured, permitted):
    assert probes.compare(stored, measured).permitted == permitted


def test_a_difference_says_where():
    stored = {"rows": [{"E": 1.0}, {"E": 2.0}], "n": 3}
    found = probes.compare(stored, {"rows": [{"E": 1.0}, {"E": 2.2}], "n": 3})
    assert found.where == "rows[1].E" and found.size == pytest.approx(0.1)
    assert probes.compare(stored, {"rows": [{"E": 1.0}, {"E": 2.2}], "n": 4}).where == "n"


def test_the_pattern_is_exact_in_binary():
    for step in range(40):
        action = probes.pattern(step, 6)
        assert np.array_equal(action * 8, np.round(action * 8)) and np.abs(action).max() <= 1


# ---------------------------------------------------------------- edits of the package

_VERIFY = """
import sys
import ves_gym
from ves_gym.leaderboard.errors import BundleError
from ves_gym.leaderboard.probes import require_behaviour
from ves_gym.leaderboard.protocol import get_problem
from ves_gym.leaderboard.verify import verify
print(ves_gym.__file__)
for what in sys.argv[1:]:
    try:
        if what.endswith(".zip"):
            verify(what)
        else:
            require_behaviour(get_problem(*what.split(" ")))
        print("accepted")
    except BundleError as error:
        print(error)
"""


def copied(folder):
    """A copy of the package: hard links, so that only edited files are new."""
    place = folder / "ves_gym"
    try:
        shutil.copytree(PACKAGE, place, copy_function=os.link)
    except (OSError, shutil.Error):  # another file system
        shutil.rmtree(place, ignore_errors=True)
        shutil.copytree(PACKAGE, place)
    return place


def edited(file, text):
    """Write a file anew; the original that it may be linked to stays."""
    file.unlink()
    file.write_text(text, encoding="utf-8")


def verified(folder, *what):
    """What a fresh process says that runs the copy in a folder."""
    done = subprocess.run(
        [sys.executable, "-c", _VERIFY, *what],
        capture_output=True, text=True, cwd=folder, timeout=600,
        env={**os.environ, "PYTHONPATH": str(folder)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    used, *lines = done.stdout.splitlines()
    assert Path(used).is_relative_to(folder)
    return lines


def test_a_comment_in_every_file_leaves_every_bundle_valid(tmp_path):
    """A comment at the end, line ends of Windows, and blank lines at the beginning."""
    for file in sorted(copied(tmp_path).rglob("*.py")):
        text = file.read_text("utf-8")
        head = "# a comment\n\n\n" if "__future__" in text else ""
        edited(file, f"{head}{text}\n# another\n".replace("\n", "\r\n"))
    bundles = [str(OLD / f"{name}.zip") for name in BUNDLES]
    own = str(path_bundle(tmp_path))
    assert verified(tmp_path, *bundles, own) == ["accepted"] * 3


# file, a constant, another one, what is verified, part of the name of the probe
MUTATIONS = {
    "mass of a link": (
        "mechanics/puma.py", "mass=17.4", "mass=17.41", "paths reach100-1s", "reach100-1s/",
    ),
    "speed limit of a joint": (
        "mechanics/puma.py", "radians(54)", "radians(54.1)",
        "paths reach100-1s", "reach100-1s/motions",
    ),
    "wall of the bent beam": (
        "mechanics/vehicle.py", "wall=0.007", "wall=0.00701", "damping.zip", "pped-bent/",
    ),
    "damping of beams": (
        "mechanics/vehicle.py",
        'damping_ratio: float = unit("1", default=0.05)',
        'damping_ratio: float = unit("1", default=0.0501)',
        "paths reach100-1s", "reach100-1s/",
    ),
    "servo gain": (
        "mechanics/servo.py", "kp=(3000.0, 2000.0, 1000.0)", "kp=(3000.0, 2001.0, 1000.0)",
        "damping.zip", "pped-bent/releases",
    ),
    "penalty of a failure": (
        "envs/episode.py", "FAILURE = -2.0", "FAILURE = -2.5",
        "policies ves/BeamLQR-v0", "BeamLQR-v0/evaluation-policies",
    ),
    "weight of a reward": (
        "envs/reach.py", 'thrift: float = unit("1", default=0.2)',
        'thrift: float = unit("1", default=0.21)',
        "policies ves/PumaReach-v0", "PumaReach-v0/episode",
    ),
    "duration of a task": (
        "envs/rest_to_rest.py", 'duration: float = unit("s", default=2.0)',
        'duration: float = unit("s", default=2.5)',
        "policies ves/PumaRestToRest-v0", "PumaRestToRest-v0/episode",
    ),
    "noise of the force sensor": (
        "effects/sensor.py", "force=(0.35, 0.2, 0.4)", "force=(0.35, 0.2, 0.41)",
        "policies.zip", "PumaReachEmulated-v0/episode",
    ),
    "bandwidth of the platform": (
        "hardware/platform.py", 'bandwidth: float = unit("Hz", default=8.0)',
        'bandwidth: float = unit("Hz", default=8.1)', "policies.zip", "PumaReachEmulated-v0/",
    ),
    "what counts as solved": (
        "envs/reach.py", "s.memory[:, 1] >= self.hold", "s.memory[:, 1] >= self.duration",
        "tasks ves/PumaReach-v1", "PumaReach-v1/solved",
    ),
    "spread of the gravity estimate": (
        "envs/registration.py", "[-0.005, 0.005]", "[-0.005, 0.006]",
        "policies.zip", "PumaReachEmulated-v0/episode",
    ),
    "tolerance of a replay": (
        "leaderboard/protocol.py", "RELATIVE = 1e-6", "RELATIVE = 1e-5",
        "paths reach100-1s", "reach100-1s/rules-paths",
    ),
    "seeds of episodes": (
        "leaderboard/protocol.py", "_PUBLIC_EPISODES = 19_940_000",
        "_PUBLIC_EPISODES = 19_950_000",
        "policies ves/BeamLQR-v0", "BeamLQR-v0/rules-policies",
    ),
    "seed of the suite": (
        "planners/suites.py", "REACH_SEED = 560", "REACH_SEED = 561",
        "paths reach100-1s", "reach100-1s/rules-paths",
    ),
    "speeds of the suite": (
        "planners/suites.py", "[82.0, 54.0, 122.0]", "[82.0, 54.0, 123.0]",
        "paths reach100-1s", "reach100-1s/queries",
    ),
    "an obstacle": (
        "planners/suites.py", "centre=(0.55, 0.45, 0.75)", "centre=(0.55, 0.46, 0.75)",
        "paths reach100-2s-obstacles", "reach100-2s-obstacles/queries",
    ),
    "seconds after a motion": (
        "system/energy.py", "TAIL = 10.0", "TAIL = 10.5", "paths reach100-1s", "reach100-1s/",
    ),
    "room of a lower bound": (
        "leaderboard/lower_bounds.py", "_ROOM = 4.0", "_ROOM = 3.0",
        "paths reach100-1s", "reach100-1s/queries",
    ),
    "share of an energy account": (
        "leaderboard/protocol.py", "LEDGER_EPISODES = 0.1", "LEDGER_EPISODES = 0.2",
        "policies.zip", "PumaReachEmulated-v0/rules-policies",
    ),
    "noise of the blind benchmark": (
        "diagnosis/benchmark/blind/noise.py", "np.array([1.3e-4, 2e-4, 2.5e-4])",
        "np.array([1.3e-4, 2e-4, 2.6e-4])", "discrepancy blind-development", "blind/case",
    ),
}  # fmt: skip


SLOW = {  # what they show, others show as well
    "speed limit of a joint", "damping of beams", "bandwidth of the platform",
    "spread of the gravity estimate", "seeds of episodes", "speeds of the suite",
    "share of an energy account",
}  # fmt: skip


@pytest.mark.parametrize(
    "name", [pytest.param(k, marks=pytest.mark.slow if k in SLOW else ()) for k in MUTATIONS]
)
def test_a_changed_constant_refuses_and_names_the_probe(name, tmp_path):
    part, before, after, what, probe = MUTATIONS[name]
    file = copied(tmp_path) / part
    text = file.read_text("utf-8")
    assert before in text, f"{part} has no {before!r} any more: bring this test up to date"
    edited(file, text.replace(before, after, 1))
    target = str(OLD / what) if what.endswith(".zip") else what
    (line,) = verified(tmp_path, target)
    assert re.match(rf"evaluator-changed: probe {re.escape(probe)}", line), line


# -------------------------------------------------------------------------- old bundles


@pytest.mark.parametrize("level", ["replayed", "reproduced"])
@pytest.mark.parametrize("name", BUNDLES)
def test_a_bundle_of_0_1_0(name, level):
    """Read as it is: its hash of sources is one that was measured."""
    entry = verify(OLD / f"{name}.zip", level=level)
    assert entry.level == level and entry.about["versions"]["ves_gym"] == "0.1.0"
    assert evaluators.history_reason(entry.to_dict()) is None


def test_a_bundle_by_older_rules_is_refused():
    with pytest.raises(BundleError) as refused:
        verify(OLD / "paths.zip")
    assert refused.value.code is Code.OLD_PROTOCOL
    assert refused.value.why == "version 1 of track paths, now it is 2"


def test_sources_that_nobody_measured(tmp_path):
    bundle = Bundle(path_bundle(tmp_path))
    bundle.manifest["spec"]["evaluator"] = "ab" * 32
    with pytest.raises(BundleError) as refused:
        verify(bundle.write(tmp_path / "b.zip"))
    assert refused.value.code is Code.EVALUATOR_MISMATCH
    assert "no known evaluator of reach100-1s: make the bundle again" in refused.value.why


def test_sources_of_another_track(tmp_path):
    damping = Bundle(OLD / "damping.zip").manifest["spec"]["evaluator"]
    bundle = Bundle(path_bundle(tmp_path))
    bundle.manifest["spec"]["evaluator"] = damping
    with pytest.raises(BundleError, match="no known evaluator"):
        verify(bundle.write(tmp_path / "b.zip"))


def test_another_machine_loosens_nothing(tmp_path):
    """What is said of packages and processor changes no tolerance, and no number."""
    bundle = Bundle(path_bundle(tmp_path))
    honest = verify(bundle.write(tmp_path / "a.zip"))
    bundle.manifest["about"]["versions"] = {"ves_gym": "9.9.9", "numpy": "0"}
    bundle.manifest["about"]["simd"] = "none"
    row = bundle.manifest["rows"][0]
    row["E_mean"] *= 1 - 1e-7
    assert verify(bundle.write(tmp_path / "b.zip")).rows == honest.rows
    row["E_mean"] *= 1 - 1e-5
    with pytest.raises(BundleError, match="score-differs"):
        verify(bundle.write(tmp_path / "c.zip"))


# ------------------------------------------------------------------------- new versions


@pytest.fixture
def second_version(monkeypatch):
    """reach100-1s in version 2, as if recorded: its results are those of version 1."""
    problem = get_problem("paths", "reach100-1s")
    monkeypatch.setitem(protocol.VERSIONS, ("paths", "reach100-1s"), 2)
    table = json.loads(json.dumps(stored_results.read_golden("evaluators.json")))
    rows = table["versions"]["paths"]["reach100-1s"]
    rows["2.2"] = [evaluators.identity(problem)]
    monkeypatch.setattr(evaluators, "_table", lambda: table)
    return problem


def test_a_new_version_starts_empty(second_version, tmp_path):
    path = make_bundle(tmp_path / "new.zip", "paths", "reach100-1s-quick", "straight")
    (old,) = evaluators.registered("paths", "reach100-1s")[Version(2, 1)]
    bundle = Bundle(path)
    bundle.manifest["spec"]["evaluator"] = old
    with pytest.raises(BundleError) as refused:
        verify(bundle.write(tmp_path / "old.zip"))
    assert refused.value.code is Code.EVALUATOR_MISMATCH
    assert refused.value.why == "version 2.1 of reach100-1s then, 2.2 now"
    entry = verify(path).to_dict()
    assert evaluators.history_reason(entry) is None
    entry["about"]["evaluator"] = old
    why = evaluators.history_reason(entry)
    assert why == "version 2.1 of the problem, today 2.2"
    other = get_problem("paths", "reach100-2s")  # still in its first
    about = {**entry["about"], "evaluator": evaluators.identity(other)}
    other = {**entry, "problem": other.name, "about": about}
    assert evaluators.history_reason(other) is None


def test_what_makes_an_entry_history(make_entry, monkeypatch):
    reason = evaluators.history_reason
    entry = make_entry()
    assert reason(entry) is None
    assert reason({**entry, "problem": "reach100-3s"}) == "the problem is no longer asked"
    strange = {**entry, "about": {**entry["about"], "evaluator": "ab" * 32}}
    assert reason(strange) == "by an evaluator that no version is known to equal"
    monkeypatch.setitem(PROTOCOL, "paths", 3)
    assert reason(entry) == "rules 2 of the track, today 3"


def test_results_recorded_anew_without_a_new_version_show(monkeypatch):
    """Then the present identity is not that of the version in the table."""
    problem = get_problem("paths", "reach100-1s")
    assert evaluators.resolve("paths", problem.base, evaluators.identity(problem)) == (2, 1)
    file = stored_results.read_golden("reach100-1s.json")
    changed = json.loads(json.dumps(file))
    changed["reach100-1s/queries"]["number"] += 1
    plain = {**stored_results.golden(problem), **{k: changed[k] for k in changed}}
    monkeypatch.setattr(evaluators, "golden", lambda problem: plain)
    assert evaluators.resolve("paths", problem.base, evaluators.identity(problem)) is None


def test_the_table_of_evaluators():
    table = stored_results.read_golden("evaluators.json")
    for problem in EVERY:
        rows = evaluators.registered(problem.track, problem.base)
        assert evaluators.identity(problem) in rows[evaluators.version_of(problem)]
    known = {
        digest
        for bases in table["versions"].values()
        for versions in bases.values()
        for digests in versions.values()
        for digest in digests
    }
    assert len(table["sources"]) == 7
    for row in table["sources"].values():
        assert set(row["identities"].values()) <= known
        assert row["largest"] <= probes.RELATIVE and row["ves_gym"] == "0.1.0"
    assert str(Version(1, 2)) == "1.2"


def test_code_that_is_not_its_version_makes_no_bundles(tmp_path, monkeypatch):
    changed = probes.Deviation("rows[0].E_mean", 0.01, False)
    monkeypatch.setattr(probes, "first_difference", lambda p: ("reach100-1s/motions", changed))
    with pytest.raises(ParameterError, match="probe reach100-1s/motions: rows") as refused:
        make_bundle(tmp_path / "b.zip", "paths", "reach100-1s-quick", "straight")
    assert "differs by 0.01 of its size from version 2.1 of reach100-1s" in str(refused.value)
    assert not (tmp_path / "b.zip").exists()
