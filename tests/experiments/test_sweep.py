"""Sweeps: units with names of their own, done once, whatever dies on the way."""

import json
import os
import shutil
from pathlib import Path

import pytest

from tests.experiments.sweeps import SMALL, files, spec
from ves_gym._util.params import ParameterError, canonical_json, content_hash, from_plain
from ves_gym.experiments import units as u
from ves_gym.experiments.spec import Spec, units_of
from ves_gym.experiments.sweep import merge, sweep, write_rows

ROOT = Path(__file__).parents[2]
POLICY = ROOT / "ves_gym" / "baselines" / "policies" / "BeamLQR" / "ppo"


# ------------------------------------------------------------------------------- units


def test_an_id_is_the_content():
    units = units_of(spec())
    assert [unit.label for unit in units] == [
        "evaluate ves/BeamLQR-v0 zero 0",
        "evaluate ves/BeamLQR-v0 ppo 0",
        "evaluate ves/PumaDamp-v0 random 3",
        "plan reach-0.5s-000 direct 0",
    ]
    assert [unit.id for unit in units] == [unit.id for unit in units_of(spec())]
    for unit in units:
        assert unit.id == content_hash(json.loads(canonical_json(unit.identity)))
        assert {"version", "system", "seed"} <= unit.identity.keys()
    assert len({unit.id for unit in units}) == 4
    twice = {**SMALL, "evaluate": SMALL["evaluate"] * 2}
    assert [unit.id for unit in units_of(spec(twice))] == [unit.id for unit in units]


@pytest.mark.parametrize(
    "change",
    [{"episodes": 3}, {"seeds": [1]}, {"settings": {"vehicle": "straight-vertical-thesis"}}],
    ids=lambda change: next(iter(change)),
)
def test_another_unit_has_another_id(change):
    table = {"envs": ["PumaDamp-v0"], "policies": ["zero"], "episodes": 2}
    (one,), (other,) = (
        units_of(spec({"evaluate": [{**table, **more}]})) for more in ({}, change)
    )
    assert one.id != other.id
    assert (one.identity["system"] != other.identity["system"]) == ("settings" in change)


def test_a_policy_is_named_by_its_weights_not_by_its_place(tmp_path):
    for suffix in (".json", ".safetensors"):
        shutil.copy(POLICY.with_suffix(suffix), tmp_path / f"ppo{suffix}")
    table = {"envs": ["BeamLQR-v0"], "episodes": 2}
    released, file = (
        units_of(spec({"evaluate": [{**table, "policies": [name]}]}), tmp_path)
        for name in ("released", "ppo.json")
    )
    assert released[0].id == file[0].id
    assert str(tmp_path) not in canonical_json(file[0].identity)

    plain = json.loads((tmp_path / "ppo.json").read_text())
    (tmp_path / "ppo.json").write_text(json.dumps({**plain, "weights": "0" * 64}))
    with pytest.raises(ParameterError, match="not the policy any more"):
        u.run_unit(file[0])


# ------------------------------------------------------------------------------- sweeps


def test_every_unit_has_its_files_and_is_done_once(swept):
    folder, report, progress = swept
    ids = {unit.id for unit in units_of(spec())}
    assert set(report.done) == ids and not report.failed and report.complete
    assert files(folder).keys() == files(folder, "about").keys() == {f"{i}.json" for i in ids}
    assert [done for _, done in progress] == [0.25, 0.5, 0.75, 1.0]
    for path in (folder / "results").iterdir():
        text = path.read_text()
        assert u.read_result(path)["rows"] and text == canonical_json(json.loads(text)) + "\n"
        assert os.uname().nodename not in text and "seconds" not in text
        about = json.loads((folder / "about" / path.name).read_text())
        assert about["id"] == path.stem and about["seconds"] > 0
    before = {p: p.stat().st_mtime_ns for p in (folder / "results").iterdir()}
    again = sweep(spec(), folder, workers=2)
    assert again.done == [] and set(again.skipped) == ids
    assert {p: p.stat().st_mtime_ns for p in (folder / "results").iterdir()} == before


def test_a_damaged_result_is_done_again_and_another_left_alone(swept, here, tmp_path):
    folder, report, _ = swept
    copy = shutil.copytree(folder, tmp_path / "copy")
    unit = units_of(spec())[0]
    path = copy / "results" / f"{unit.id}.json"
    text = path.read_text()
    path.write_text(text[: len(text) // 2])  # torn
    with pytest.warns(UserWarning, match="left out"):
        rows = merge([copy])
    assert {row["unit"] for row in rows} == set(report.done) - {unit.id}
    path.write_text(text.replace('"failed":false', '"failed":true', 1))  # changed
    with pytest.warns(UserWarning, match="does not match its digest; the unit is done again"):
        again = sweep(spec(), copy, workers=here)
    assert again.done == [unit.id]
    assert files(copy) == files(folder)


def test_units_that_fail_are_reported_and_the_others_go_on(here, tmp_path):
    table = {"envs": ["BeamLQR-v0"], "policies": ["resolved", "zero"], "episodes": 1}
    report = sweep(spec({"evaluate": [table]}), tmp_path, workers=here)
    assert len(report.done) == len(report.failed) == 1 and not report.complete
    (id,) = report.failed
    assert "resolved" in report.failed[id]
    again = sweep(spec({"evaluate": [table]}), tmp_path, workers=here)
    assert again.skipped == report.done and set(again.failed) == {id}


def test_parts_of_a_sweep_on_two_machines_are_one_by_copying(swept, here, tmp_path):
    folder, _, _ = swept
    reports = [sweep(spec(), tmp_path / f"{k}", workers=here, part=(k, 2)) for k in (1, 2)]
    assert [len(r.done) for r in reports] == [2, 2]
    rows = merge([tmp_path / "2", tmp_path / "1"])
    for k in (1, 2):
        shutil.copytree(tmp_path / f"{k}", tmp_path / "both", dirs_exist_ok=True)
    assert files(tmp_path / "both") == files(folder)
    assert merge([tmp_path / "both"]) == rows == merge([folder])
    assert sweep(spec(), tmp_path / "both", workers=here).done == []


# -------------------------------------------------------------------------------- merge


def test_rows_are_sorted_and_say_whose_they_are(swept, tmp_path):
    folder, _, _ = swept
    rows = merge([folder])
    assert rows == merge([folder, folder]) and len(rows) == 7
    assert [(r["kind"], r["who"], r["row"]) for r in rows] == [
        ("evaluate", "ppo", 0),
        ("evaluate", "ppo", 1),
        ("evaluate", "zero", 0),
        ("evaluate", "zero", 1),
        ("evaluate", "random", 0),
        ("evaluate", "random", 1),
        ("plan", "direct", 0),
    ]
    assert all(r["E_mean"] is None or r["E_mean"] >= 0 for r in rows)
    write_rows(tmp_path / "a.jsonl", rows)
    again = [json.loads(line) for line in (tmp_path / "a.jsonl").read_text().splitlines()]
    assert again == rows
    with pytest.raises(ParameterError, match=r"expected a \.jsonl or \.parquet name"):
        write_rows(tmp_path / "a.csv", rows)


def test_rows_as_parquet(swept, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    rows = merge([swept[0]])
    for name in ("a", "b"):
        write_rows(tmp_path / f"{name}.parquet", rows)
    assert (tmp_path / "a.parquet").read_bytes() == (tmp_path / "b.parquet").read_bytes()
    table = parquet.read_table(tmp_path / "a.parquet").to_pylist()
    assert [r["E_mean"] for r in table] == [r.get("E_mean") for r in rows]


def test_two_results_of_one_unit_that_differ_are_refused(swept, tmp_path):
    folder, _, _ = swept
    copy = shutil.copytree(folder, tmp_path / "copy")
    path = next((copy / "results").iterdir())
    body = json.loads(path.read_text())
    del body["digest"]
    body["rows"][0]["E_mean"] = 0.125
    path.write_text(canonical_json({**body, "digest": content_hash(body)}) + "\n")
    with pytest.raises(ParameterError, match="two results of one unit that differ"):
        merge([folder, copy])
    with pytest.raises(ParameterError, match="expected the folder of a sweep"):
        merge([tmp_path / "nowhere"])


# ------------------------------------------------------------------------------ bad input


ZERO = {"envs": ["BeamLQR-v0"], "policies": ["zero"]}


@pytest.mark.parametrize(
    ("plain", "message"),
    [
        ({}, "a sweep needs"),
        ({"evaluate": [{"envs": ["BeamLQR-v0"]}]}, "missing key 'policies'"),
        ({"evaluate": [{"envs": ["No-v0"], "policies": ["zero"]}]}, "No"),
        ({"evaluate": [{"envs": ["CartPole-v1"], "policies": ["zero"]}]}, "CartPole"),
        (
            {"evaluate": [{"envs": ["BeamLQR-v0"], "policies": ["magic"]}]},
            "one of zero, random",
        ),
        (
            {"evaluate": [{**ZERO, "episodes": 10**12}]},
            "episodes must be 1 to 1000000, got 10000",
        ),
        ({"evaluate": [{**ZERO, "episodes": True}]}, "episodes must be int, got True"),
        ({"evaluate": [{**ZERO, "settings": {"randomize": [True]}}]}, "randomize must map"),
        ({**SMALL, "seconds": 0.0}, "seconds must be > 0"),
        ({**SMALL, "speed": 1}, "unknown key 'speed'"),
        ({"plan": [{"suite": "reach100", "planners": ["magic"]}]}, "planner must be one of"),
        ({"plan": [{"suite": "none", "planners": ["direct"]}]}, "suite must be one of"),
        (
            {"plan": [{"suite": "reach100", "planners": ["direct"], "durations": [9.0]}]},
            "has durations 0.5, 1, 2, 4 s",
        ),
        ({"train": [{"configs": ["Nothing-ppo"]}]}, "Nothing-ppo.*known: ves/BeamLQR"),
        ({"train": [{"configs": ["BeamLQR-ppo"], "seeds": []}]}, "seeds must be numbers"),
    ],
)
def test_a_bad_spec_is_refused_before_any_work(plain, message, tmp_path):
    with pytest.raises(ParameterError, match=message):
        sweep(from_plain(Spec, plain), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_paths_start_from_the_file(here, tmp_path):
    for suffix in (".json", ".safetensors"):
        shutil.copy(POLICY.with_suffix(suffix), tmp_path / f"mine{suffix}")
    (tmp_path / "s.toml").write_text(
        '[[evaluate]]\nenvs = ["BeamLQR-v0"]\npolicies = ["mine.json"]\nepisodes = 1\n'
    )
    report = sweep(tmp_path / "s.toml", tmp_path / "out", workers=here)
    assert len(report.done) == 1


@pytest.mark.parametrize("part", [(0, 2), (3, 2)])
def test_a_part_that_is_none_is_refused(part, tmp_path):
    with pytest.raises(ParameterError, match="part must be k of n"):
        sweep(spec(), tmp_path / "out", part=part)
