"""Machines of other people: an axis that rubs, drives that smooth their rates, an industrial
arm with a coupled wrist.

The data are not part of the project: VES_GYM_DATA says where they are, else `shared/data`
beside the checkout.
"""

import os
import runpy
from pathlib import Path

import numpy as np
import pytest

from ves_gym._util.recordings import read_columns
from ves_gym.diagnosis import diagnose as d
from ves_gym.diagnosis.data.measured_run import run_of_signals
from ves_gym.diagnosis.inference.fit import fit
from ves_gym.diagnosis.machines.mapping import read_machine

ROOT = Path(__file__).parents[2]
DATA = Path(os.environ.get("VES_GYM_DATA", ROOT.parent / "shared" / "data"))


def needed(path):
    if not path.exists():
        pytest.skip(f"measured data not here: {path}; set VES_GYM_DATA to their folder")
    return path


@pytest.mark.slow
def test_friction_of_the_emps_axis_is_named():
    files = [needed(DATA / "emps" / f"DATA_EMPS{k}.mat") for k in ("", "_PULSES")]
    machine, load = read_machine(ROOT / "examples" / "emps" / "emps.toml")
    fitted, final = (load(path) for path in files)
    found = d.diagnose(
        machine,
        [fitted],
        [final],
        candidates=machine.candidates(),
        most=5,
    )
    named = {f.candidate.kind: f.values for f in found.explanations}
    assert {"joint/coulomb", "joint/viscous", "joint/asymmetry"} <= set(named)
    assert named["joint/coulomb"][0] == pytest.approx(20.39, rel=0.05)  # published
    assert named["joint/viscous"][0] == pytest.approx(203.5, rel=0.05)
    # published: 166.7 N s/m one way, 240.4 the other
    assert named["joint/asymmetry"][1] == pytest.approx((166.7 - 240.4) / 2, rel=0.05)
    assert named["joint/measurement_delay"][0] == pytest.approx(0.84e-3, rel=0.1)
    error = runpy.run_path(str(ROOT / "examples" / "emps" / "diagnose.py"))["force_error"]
    better = machine.model(found.effects)
    assert error(machine, final, machine.nominal) > 0.6
    assert error(machine, final, better) <= 0.03


@pytest.mark.slow
def test_the_low_pass_of_the_tiago_drives_is_named():
    folder = needed(DATA / "tiago_arm")
    machine, load = read_machine(ROOT / "examples" / "tiago" / "tiago.toml")
    run = load(folder)
    every = machine.candidates()
    found = d.diagnose(machine, [run], candidates=every)
    first = found.explanations[0]
    assert (first.candidate.kind, first.candidate.slot) == ("joint/velocity_lag", "")
    assert first.values[0] == pytest.approx(0.195, rel=0.05)
    own = [c for c in every if c.kind == "joint/velocity_lag" and c.slot]
    each = fit(found.residuals, own, [np.array([0.1])] * 8)  # every joint by itself
    assert np.ravel(each.values) == pytest.approx([0.195] * 8, rel=0.05)
    models = [machine.nominal, machine.model([first.candidate.effect(first.values)])]
    before, after = (
        np.square(np.abs(run.window.spectrum(x))).sum(axis=0)
        for x in machine.residuals(run, models, ["velocity"])["velocity"]
    )
    assert (after < 0.01 * before).all()


@pytest.mark.slow
def test_friction_and_the_coupled_wrist_of_the_staubli_are_named():
    """Reference: the identified values published with the data (examples/staubli)."""
    folder = needed(DATA / "staubli_tx40")
    example = runpy.run_path(str(ROOT / "examples" / "staubli" / "diagnose.py"))
    found = example["main"](folder)
    named = {(f.candidate.kind, f.candidate.slot) for f in found.explanations}
    assert named == {
        ("joint/friction", "all joints"),
        ("shaft/friction", "joint_5 and joint_6"),
    }
    joints, shaft = example["friction"](found)
    for law, published in example["PUBLISHED"].items():
        assert joints[law] == pytest.approx(published, rel=0.15), law
    for name in ("coulomb", "viscous"):
        assert shaft[name] == pytest.approx(example["SHAFT"][name], rel=0.15)


def test_mapping_files_read_the_columns_that_the_data_sets_document():
    """Reference: the raw columns; of EMPS the drive's gain gtau [N/V] in the file itself."""
    path = needed(DATA / "emps" / "DATA_EMPS.mat")
    run = read_machine(ROOT / "examples" / "emps" / "emps.toml")[1](path)
    raw = read_columns(path)
    force = raw["gtau"][0] * raw["vir"]
    assert set(run.signals) == {"q", "tau"}
    assert_same(run, raw["t"], {"q": raw["qm"][:, None], "tau": force[:, None]})
    path = needed(DATA / "tiago_arm")
    run = read_machine(ROOT / "examples" / "tiago" / "tiago.toml")[1](path)
    raw = read_columns(path)
    joints = ("torso_lift_joint", *(f"arm_{i}_joint" for i in range(1, 8)))
    q, v = (
        np.stack([raw[f"- {name}_{kind}"] for name in joints], axis=1)
        for kind in ("position", "velocity")
    )
    assert set(run.signals) == {"q", "v"}
    assert_same(run, raw["t"], {"q": q, "v": v})


def assert_same(run, t, signals):
    other = run_of_signals(t, signals, run.name, run.band)
    assert all(np.allclose(run[k], other[k], rtol=1e-12) for k in run.signals)
