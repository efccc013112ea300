"""Claim: what stands on the committed board is what anybody gets who makes it again.

The page is that of the entries, their files hold, and entries made anew from their
problem and method alone have the rows of the board (which holds six digits): all of them for
episodes and releases, 95 % of searched paths, where rounding may lead elsewhere.
"""

import json
import re
import runpy
from pathlib import Path

import numpy as np
import pytest

from ves_gym.baselines.policy import released
from ves_gym.baselines.registry import CONTROLLERS
from ves_gym.leaderboard.board import divided, make_board
from ves_gym.leaderboard.evaluators import resolve, version_of
from ves_gym.leaderboard.journal import check
from ves_gym.leaderboard.protocol import get_problem
from ves_gym.leaderboard.run import make_bundle
from ves_gym.leaderboard.verify import verify

PLACE = Path(__file__).parents[2] / "docs/leaderboard"
NUMBERS = ("score", "E_mean", "E_decay", "E_peak", "E_res", "E_int")
TOLERANCE = 1e-5  # relative; six digits are on the board


@pytest.fixture(scope="module")
def journal():
    return check(PLACE / "entries")


def test_the_files_hold_and_everything_was_verified(journal):
    assert journal.problems == ()
    entries = [record.entry for record in divided(journal.records)[0]]
    assert len(entries) >= 100
    assert {e["track"] for e in entries} >= {"paths", "policies", "damping"}
    assert all(e["level"] == "reproduced" for e in entries)


def test_every_entry_belongs_to_the_evaluator_of_its_version(journal):
    """Superseded ones too; none is history, for no behaviour was changed on purpose."""
    for record in journal.records:
        e = record.entry
        problem = get_problem(e["track"], e["problem"])
        version = resolve(e["track"], problem.base, e["about"]["evaluator"])
        assert version == version_of(problem), record.name
        assert version.protocol == e["protocol"]
    present, past = divided(journal.records)
    assert len(present) == 168 and past == []


def test_the_board_has_every_entry_that_make_leaderboard_fills(journal):
    script = runpy.run_path(str(PLACE.parents[1] / "scripts" / "leaderboard.py"))
    wanted = {(w.track, w.problem, w.method) for w in script["table"](blind=False)}
    there = {(e["track"], e["problem"], e["name"]) for e in (r.entry for r in journal.records)}
    assert len(wanted) == 168 and wanted <= there


def test_the_page_is_that_of_the_journal(journal):
    """Hash, entries and order; the statistics to five digits, whatever NumPy sums them."""
    page = (PLACE / "index.html").read_text("utf-8")
    (text,) = re.findall(r'<script type="application/json"[^>]*>(.*?)</script>', page, re.S)
    shown, made = json.loads(text), make_board(journal)
    assert shown["head"] == made["head"] == journal.head
    assert shown["entries"] == len(journal.records) and shown["unranked"] == made["unranked"]
    assert shown["history"] == made["history"]
    for a, b in zip(shown["tracks"], made["tracks"], strict=True):
        for one, other in zip(a["groups"], b["groups"], strict=True):
            assert names(one) == names(other)
            for x, y in zip(one["entries"], other["entries"], strict=True):
                np.testing.assert_allclose(numbers(x["score"]), numbers(y["score"]), rtol=1e-5)


def names(group):
    return [(e["name"], e["bundle"]) for e in group["entries"]]


def numbers(estimate):
    return [np.inf if k is None else k for k in estimate]


QUICK = [
    ("damping", "ves/PumaDamp-v0", "pped"),
    pytest.param("policies", "ves/PumaReach-v0", "ppo", marks=pytest.mark.bits),
]
LONG = [
    ("paths", "reach100-4s", "shaped-zv"),
    ("policies", "ves/PumaRestToRest-v0", "ppo"),
    ("policies", "ves/PumaReachEmulated-v0", "ppo"),
    ("paths", "reach100-2s", "refined"),
    ("paths", "reach100-2s-obstacles", "straight"),
]


@pytest.mark.parametrize(
    ("track", "problem", "name"),
    QUICK + [pytest.param(*k, marks=pytest.mark.slow) for k in LONG],
)
def test_an_entry_made_anew_has_its_rows(journal, track, problem, name, tmp_path):
    (there,) = [
        r.entry
        for r in divided(journal.records)[0]
        if (r.entry["track"], r.entry["problem"], r.entry["name"]) == (track, problem, name)
    ]
    files = released(problem) if problem.startswith("ves/") else {}
    method = [files[name]] if name in files and name not in CONTROLLERS else name
    here = verify(make_bundle(tmp_path / "b.zip", track, problem, method))
    alike = [
        all(near(a.get(k), b.get(k)) for k in NUMBERS) and a["id"] == b["id"]
        for a, b in zip(here.rows, there["rows"], strict=True)
    ]
    print(f"{name} on {problem}: {sum(alike)} of {len(alike)} rows alike")
    assert np.mean(alike) >= (0.95 if track == "paths" else 0.99)


def near(a, b):
    if a is None or b is None:
        return a is b
    return abs(a - b) <= TOLERANCE * abs(b) + 1e-9
