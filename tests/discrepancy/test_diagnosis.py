"""From logs with something hidden to its name, on machines the simulator knows nothing of."""

import numpy as np
import pytest

from ves_gym.core.params import ParameterError
from ves_gym.core.system import System
from ves_gym.discrepancy import diagnosis as d
from ves_gym.discrepancy.candidates import library, without
from ves_gym.discrepancy.runs import require_plausible, run_of
from ves_gym.discrepancy.system_machine import SystemMachine


def diagnosed(logs, leave_out=()):
    system = System.from_dict(logs[0].meta["system"])
    machine = SystemMachine(system)
    runs = [run_of(log, f"run-{i}") for i, log in enumerate(logs)]
    ports = [p.name for p in machine.ports]
    candidates = library(system.arm.n, ports, system.mode, [r.name for r in runs[:-1]])
    found = d.diagnose(machine, runs[:-1], runs[-1:], candidates=without(candidates, leave_out))
    return machine, found


def names(found):
    return {(f.candidate.kind, f.candidate.slot) for f in found.found}


def test_a_correct_description_is_left_alone(hidden):
    _, found = diagnosed(hidden(seed=1))
    assert found.verdict == d.NOTHING
    assert found.found == ()


def test_a_gain_is_named_and_the_gap_shrinks(hidden):
    machine, found = diagnosed(hidden(("joint/drive_gain", 1, 0.03, {"sign": 1.0}), seed=2))
    assert names(found) == {("joint/drive_gain", "joint 2")}
    assert found.found[0].values[0] == pytest.approx(0.03, rel=0.1)
    before, after = (
        np.array([getattr(g, side) for g in found.final]) for side in ("before", "after")
    )
    worst = before.argmax()
    assert found.final[worst].port == "joint" and found.final[worst].channel == "tau_2"
    assert after[worst] ** 2 - 1 < 0.1 * (before[worst] ** 2 - 1)
    assert (after <= 1.02 * np.maximum(before, 1)).all()  # no other channel is worse
    better = machine.model(d.added(found)).system
    assert System.from_dict(better.to_dict()) == better


@pytest.mark.slow
def test_two_effects_at_two_ports_are_both_named(hidden):
    logs = hidden(("sensor/lag", 0, 0.3, {"sign": -1.0}), ("joint/viscous", 0, 2.0, {}), seed=3)
    _, found = diagnosed(logs)
    assert names(found) == {("sensor/lag", ""), ("joint/viscous", "joint 1")}


def test_what_is_not_in_the_library_gets_no_wrong_name(hidden):
    logs = hidden(("base/stiffness", 0, 0.1, {"sign": 1.0}), seed=4)
    own = ("base/stiffness", "base/virtual_mass", "base/extra_mode", "base/damping")
    _, found = diagnosed(logs, leave_out=(*own, "base/amplitude_damping"))
    assert found.verdict == d.UNKNOWN
    assert d.added(found) == ()
    assert "not in the library" in found.sentence


def test_a_log_without_torques_says_what_it_cannot_tell(hidden):
    import dataclasses

    bare = []
    for log in hidden(seed=1):
        meta = {k: v for k, v in log.meta.items() if k != "controller"}
        bare.append(dataclasses.replace(log, tau=None, meta=meta))
    _, found = diagnosed(bare)
    assert found.untestable == {"joint": ("tau",), "servo": ("tau", "controller")}


def test_numbers_in_another_unit_are_asked_about(hidden):
    import dataclasses

    log = hidden(seed=1)[0]
    system = System.from_dict(log.meta["system"])
    with pytest.raises(ParameterError, match=r"run: q reaches .*is it in degrees\?"):
        require_plausible(dataclasses.replace(log, q=np.rad2deg(log.q)), system, "run")
    with pytest.raises(ParameterError, match=r"y reaches .*millimetres"):
        require_plausible(dataclasses.replace(log, y=1e4 * log.y), system, "run")
    cut = np.r_[0:500, 600 : len(log)]
    parts = {k: getattr(log, k)[cut] for k in ("t", "q", "q_cmd", "v_cmd", "y")}
    gappy = dataclasses.replace(
        log, **parts, v=None, tau=None, w=None, wg=None, y_cmd=None, yd=None
    )
    with pytest.raises(ParameterError, match=r"row 501: .* cut the log at the gap"):
        require_plausible(gappy, system, "run")


def test_a_library_that_lacks_the_kind_to_leave_out_says_so():
    with pytest.raises(ParameterError, match="no candidate 'joint/magic'"):
        without(library(3, ["joint"], "ideal"), ["joint/magic"])
