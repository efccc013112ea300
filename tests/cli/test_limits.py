"""One rule of limits: the same motion gets the same verdict from every command."""

import numpy as np
import pytest

ENDS = ("--goal", "60,40,-30", "--duration", "1.5")
BENCH = (
    "benchmark",
    "--suite",
    "thesis",
    "--vehicle",
    "straight-horizontal-thesis",
    "--workers",
    "1",
)
BENCH += ("--no-figures",)


def _played(call, tmp_path, *words):
    file = tmp_path / "motion.json"
    file.write_bytes((tmp_path / "out" / "motion.json").read_bytes())
    return call("simulate", "--motion", file, "--settle", "0.5", *words)


@pytest.mark.parametrize("words", [("--planner", "straight"), (), ("--v-max", "none")])
def test_plan_and_simulate_say_the_same_of_a_motion(call, tmp_path, words):
    _, out, _, planned = call("plan", *ENDS, *words)
    _, _, err, played = _played(call, tmp_path)
    assert planned["limits"]["reference"] == played["limits"]["reference"]
    for kind in ("velocity", "torque"):  # positions settle after the motion, at the records
        ours, theirs = (r["limits"]["simulated"]["extremes"][kind] for r in (planned, played))
        assert ours == theirs
    for of, who in (("reference", "reference"), ("simulated", "simulated arm")):
        inside = planned["limits"][of]["inside"]
        assert f"{who} {'' if inside else 'NOT '}inside the limits" in out
        assert inside == (f"{who}: " not in err)
        for line in (k for k in err.splitlines() if f"{who}: " in k):
            assert line.partition(f"{who}: ")[2] in out  # the same sentence
    expected = {"straight": (True, True), "": (True, False), "none": (False, False)}
    verdicts = tuple(planned["limits"][of]["inside"] for of in ("reference", "simulated"))
    assert verdicts == expected[words[-1] if words else ""]


def test_plan_keeps_the_speed_limits_of_the_arm_unless_told_otherwise(call):
    _, _, _, own = call("plan", *ENDS)
    _, _, _, same = call("plan", *ENDS, "--v-max", "82,54,122")
    _, _, _, free = call("plan", *ENDS, "--v-max", "none")
    np.testing.assert_allclose(own["path"], same["path"], atol=1e-9)
    assert free["simulated"]["E_mean"] < own["simulated"]["E_mean"]
    late = ("plan", "--goal", "110,0,0", "--duration", "1")
    for planner, why in (
        ("straight", "velocity of joint 1 "),
        ("direct", "no motion: joint 1 "),
    ):
        status, out, _, result = call(*late, "--planner", planner)
        assert status == 1 and not result["feasible"] and result["failure"] in out
        assert result["failure"].startswith(why)


def test_the_check_is_at_the_physics_step_whatever_is_recorded(call):
    fast = ("simulate", "--goal", "90,0,0", "--duration", "0.5", "--settle", "0.5")
    _, _, _, fine = call(*fast)
    _, _, _, coarse = call(*fast, "--record-dt", "0.0625")
    assert fine["limits"]["reference"] == coarse["limits"]["reference"]
    for kind in ("velocity", "torque"):
        ours, theirs = (r["limits"]["simulated"]["extremes"][kind] for r in (fine, coarse))
        assert ours == theirs


def test_benchmark_counts_successes_that_leave_the_limits(call):
    """The shoulder turn of the thesis is twice as fast as our arm may be; nobody asked."""
    status, out, _, result = call(*BENCH, "--planners", "straight")
    (row,) = result["rows"]
    assert status == 0 and row["success"] and row["failure"] is None
    assert row["reference_breaks"].startswith(
        "velocity of joint 1 reaches 2.06 of its limit at"
    )
    assert row["arm_breaks"].startswith("velocity of joint 1 reaches 2.")
    assert result["summary"][0]["reference_breaks"] == result["summary"][0]["arm_breaks"] == 1
    assert "reference NOT inside the limits, of the successes: straight 1" in out
    assert f"such as straight, {row['query']}: {row['arm_breaks']}" in out.replace("\n", "")
