"""From logs with something hidden to its name, on machines the simulator knows nothing of.

Whole diagnoses of such machines are in tests/golden/test_diagnoses.py.
"""

import dataclasses
import types

import numpy as np
import pytest

from tests.diagnosis.conftest import MOVES, SINES
from tests.diagnosis.logs import told
from ves_gym._util.params import ParameterError
from ves_gym.diagnosis.data.measured_run import require_plausible, run_of
from ves_gym.diagnosis.inference import model_selection
from ves_gym.diagnosis.inference.candidates import library, without
from ves_gym.diagnosis.inference.fit import Fit
from ves_gym.diagnosis.inference.held_back import group_squares, likeliness
from ves_gym.diagnosis.inference.model_selection import (
    Thresholds,
    _acts_long_enough,
    _required_gain,
)
from ves_gym.diagnosis.inference.null_law import NullLaw
from ves_gym.diagnosis.inference.whitened_residuals import WhitenedResiduals
from ves_gym.diagnosis.machines.system import SystemMachine
from ves_gym.effects import JointElasticity
from ves_gym.system.system import System

KINDS = ("joint/coulomb", "joint/viscous", "joint/drive_gain", "joint/torque_offset")


@pytest.fixture(scope="module")
def plain(hidden):
    """Logs of a machine that is as described."""
    return hidden(seed=1, runs=(SINES, MOVES))


def test_a_gear_that_is_not_there_damps_no_noise(plain):
    machine = SystemMachine(System.from_dict(plain[0].meta["system"]))
    runs = [run_of(log, f"run-{i}") for i, log in enumerate(plain)]
    residuals = WhitenedResiduals(machine, runs)
    soft = JointElasticity(compliance=(0.0, 2e-5, 0.0), damping=(0.0, 30.0, 0.0))
    highest = ("joint", 1, runs[0].band)  # of the ranges of frequency
    groups = [(g.port, g.channel, g.high) for g in residuals.groups]
    group = residuals.groups[groups.index(highest)]
    moved = residuals.under([machine.model([soft])], ["joint", "wrench"])[0]
    plain = np.mean(residuals.null[group.part] ** 2)
    assert np.mean(moved[group.part] ** 2) > 0.95 * plain
    _, squares, noise = group_squares(residuals, moved)
    at = groups.index(highest)
    assert squares[at] / noise[at] > 0.95 * plain
    assert likeliness(residuals, moved) > likeliness(residuals, residuals.null)


def test_a_limit_must_act_longer_than_a_step_between_samples(plain):
    machine = SystemMachine(System.from_dict(plain[0].meta["system"]))
    run = run_of(plain[0], "run")
    residuals = WhitenedResiduals(machine, [run])
    every = library(machine.system.arm.n, ["joint"], "emulated")
    limit = next(c for c in every if c.name == "joint/torque_limit at joint 2")
    highest = np.sort(np.abs(run["tau"][:, 1]))[::-1]
    most = machine.system.arm.column("tau_max")[1]
    for samples, long_enough in ((4, False), (40, True)):
        ceiling = 1 - 0.5 * (highest[samples - 1] + highest[samples]) / most
        one = types.SimpleNamespace(candidates=[limit], values=[np.array([ceiling])])
        model = machine.model([limit.effect(one.values[0])])
        assert residuals.acts(model, limit.ports) == pytest.approx(samples * run.dt)
        assert _acts_long_enough(residuals, one, 0) == long_enough


def test_coordinates_about_zero_cost_nothing():
    every = {c.name: c for c in library(3, ["wrench", "joint"], "emulated")}
    none = np.zeros(0)

    def price(name, values, std):
        effects = ((every[name],), (np.array(values),))
        return Fit(*effects, 0.0, (np.array(std),), none, none, none, none).price(0, 1000)

    one, choice = np.log(1000), 2 * np.log(3)  # of three coordinates
    std = (1e-5, 1e-5, 1e-5)
    assert price("sensor/rotation", (1e-5, 2e-3, 1e-5), std) == pytest.approx(one + choice)
    assert price("sensor/rotation", (1e-3, 2e-3, 1e-5), std) == pytest.approx(2 * one + choice)
    assert price("sensor/rotation", (1e-3, 2e-3, 1e-4), std) == pytest.approx(3 * one)
    assert price("sensor/rotation", (0, 0, 0), std) == pytest.approx(one + choice)
    gear = price("joint/elasticity at joint 1", (1e-4, 0), (1e-5, 1e-5))
    assert gear == pytest.approx(2 * one)


def test_an_error_of_the_vehicle_needs_no_guard_where_the_computer_moves_it():
    limits = Thresholds()
    residuals = types.SimpleNamespace(size=17000)

    def needed(name, port, mode):
        every = library(3, ["wrench", port], mode)
        one = next(c for c in every if c.name == name)
        f = types.SimpleNamespace(
            candidates=(one,), price=lambda i, size: one.price * np.log(size)
        )
        return _required_gain(residuals, NullLaw(len(every)), limits, f, 0)

    emulated = ("admittance", "emulated")
    assert needed("payload/mass", *emulated) > limits.gain
    assert needed("base/extra_mode at y", *emulated) > limits.gain
    assert 12 < needed("base/stiffness", *emulated) < 20
    assert needed("base/stiffness", "base", "ideal") > limits.gain  # by a measured wrench


def test_what_sets_in_beside_another_gear_needs_half_of_what_that_explains(monkeypatch):
    every = {c.name: c for c in library(3, ["joint"], "ideal")}
    residuals = types.SimpleNamespace(size=17000)

    def of(*names):
        found = tuple(every[n] for n in names)
        deviance = 5000.0 - 1000.0 * len(found)
        return types.SimpleNamespace(
            candidates=found, deviance=deviance, price=lambda i, size: 10.0
        )

    def reduced(residuals, f, i):
        return of(*(c.name for j, c in enumerate(f.candidates) if j != i))

    monkeypatch.setattr(model_selection, "_without", reduced)

    def needed(first, second):
        f = of(f"joint/{first}", f"joint/{second}")
        return _required_gain(residuals, NullLaw(len(every)), Thresholds(), f, 1)

    assert needed("backlash at joint 3", "backlash at joint 2") == pytest.approx(500)
    assert needed("elasticity at joint 2", "backlash at joint 2") == pytest.approx(500)
    assert needed("backlash at joint 3", "viscous at joint 2") == pytest.approx(100)
    assert needed("elasticity at joint 3", "backlash at joint 2") < 50  # gears of two joints


def test_a_log_without_torques_says_what_it_cannot_tell(plain):
    bare = []
    for log in plain:
        meta = {k: v for k, v in log.meta.items() if k != "controller"}
        bare.append(dataclasses.replace(log, tau=None, meta=meta))
    found = told(None, bare, lambda c: c.kind in KINDS)
    assert found.untestable == {"joint": ("tau",), "servo": ("tau", "controller")}


def test_numbers_in_another_unit_are_asked_about(plain):
    log = plain[0]
    system = System.from_dict(log.meta["system"])
    with pytest.raises(ParameterError, match=r"run: q reaches .*is it in degrees\?"):
        require_plausible(dataclasses.replace(log, q=np.rad2deg(log.q)), system, "run")
    with pytest.raises(ParameterError, match=r"y reaches .*millimetres"):
        require_plausible(dataclasses.replace(log, y=1e5 * log.y), system, "run")
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
