"""A system as an FMU, run by FMPy beside the simulator."""

import dataclasses
import itertools
import shutil
import warnings
import zipfile
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.fmi3 import FMU3Slave
from fmpy.model_description import read_build_description
from fmpy.validation import validate_fmu

import ves_gym as vg
from tests.effects.values import VALUES
from tests.three_links import BALANCED, robot
from ves_gym.hardware.leg_servo import LEG_SERVOS, leg_clock
from ves_gym.mechanics.servo import OWN_GAINS
from ves_gym.simulation import fmu as module
from ves_gym.simulation.loop_linearisation import EmulationWarning
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.energy import base_energy

needs_compiler = pytest.mark.skipif(
    not any(map(shutil.which, ("cc", "gcc", "clang"))), reason="needs a C compiler"
)
MOTION = vg.Motion.straight([0, 0, 0], [1.0, 0.5, -0.5], 2.0)


class Slave:
    """An FMU in FMPy, its variables by name without their number."""

    def __init__(self, path):
        self.about = fmpy.read_model_description(path)
        self.refs = {}
        for variable in self.about.modelVariables:
            name = variable.name.partition("[")[0]
            self.refs.setdefault(name, []).append(variable.valueReference)
        self.folder = fmpy.extract(path)
        self.said = []
        self.fmu = FMU3Slave(
            guid=self.about.guid,
            unzipDirectory=self.folder,
            modelIdentifier=self.about.coSimulation.modelIdentifier,
            instanceName="here",
        )
        self.fmu.instantiate()

    def set(self, **values):
        for name, numbers in values.items():
            refs = self.refs[name]
            self.fmu.setFloat64(refs, np.broadcast_to(numbers, len(refs)).tolist())

    def get(self, name):
        return np.array(self.fmu.getFloat64(self.refs[name]))

    def begin(self, **values):
        self.set(**values)
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()

    def row(self):
        outputs = [
            k.valueReference for k in self.about.modelVariables if k.causality == "output"
        ]
        return np.array(self.fmu.getFloat64(outputs))

    def play(self, t, dt, q, v):
        rows = []
        for now, angles, rates in zip(t, q, v, strict=True):
            self.set(q_cmd=angles, v_cmd=rates)
            self.fmu.doStep(now, dt)
            rows.append(self.row())
        return np.array(rows)

    def close(self):
        self.fmu.terminate()
        self.fmu.freeInstance()
        shutil.rmtree(self.folder)


@pytest.fixture(scope="module")
def bent(tmp_path_factory):
    return vg.export(vg.System(), tmp_path_factory.mktemp("fmu") / "bent.fmu")


@pytest.fixture
def slave(bent):
    out = Slave(bent)
    yield out
    out.close()


def simulated(system, angles, rates, servo=None, **start):
    """Outputs of the simulator after each control period; in space but for wrenches."""
    servo = None if servo is None else vg.JointServo(**{k: tuple(x) for k, x in servo.items()})
    sim, rows = Simulator(system, servo=servo or OWN_GAINS), []
    sim.reset(**start)
    for q, v in zip(angles, rates, strict=True):
        command = sim.servo_command(q[None], v[None])
        state = sim.step(command)
        tau, ydd = sim.evaluate(command)
        parts = state.q, state.v, tau, state.y, state.yd, ydd
        energy = base_energy(system, state.q, state.y, state.yd, sim.base_modes)
        told = []
        if system.mode == "emulated":
            seen = sim.readings
            told = [*seen.wrench[0], *(seen.wrench - seen.gravity)[0], *seen.y_cmd[0]]
            told += [float(sim.emulation_loop.frozen[0])]
        energies = (float(k[0]) for k in energy)
        rows.append([*np.hstack([k[0] for k in parts]), *told, *energies])
    return np.array(rows)


def without_wrench(rows):
    """Columns as `simulated` has them: strain and kinetic energy are its last two."""
    return np.delete(rows, [*range(rows.shape[1] - 9, rows.shape[1] - 2)], axis=1)


@needs_compiler
def test_the_bent_beam_under_a_puma_is_the_simulators(slave):
    """Reference: `Simulator`, held commands, 5 s. Tolerance: rounding."""
    system = vg.System()
    dt = system.control_dt
    t = dt * np.arange(round(5 / dt))
    _, q, v, _ = MOTION.at(t)
    slave.begin()
    rows = without_wrench(slave.play(t, dt, q, v))
    expected = simulated(system, q, v)
    scale = np.abs(expected).max(axis=0)
    assert (np.abs(rows - expected).max(axis=0) < 1e-10 * scale).all()


@needs_compiler
def test_the_wrench_is_that_of_a_run_log(slave):
    """Reference: the log's `w` of a base that swings under held joints."""
    y = [0.01, -0.02, 0.005, 0.01, 0.0, -0.01]
    slave.begin(y_start=y)
    gains = {name: tuple(slave.get(name)) for name in ("kp", "kd")}
    servo = vg.JointServo(**gains, feedforward=False)
    hold = vg.Motion.straight([0, 0, 0], [0, 0, 0], 0.5)
    log = vg.simulate(hold, servo=servo, settle=0.0, y=y, record_dt=vg.System().control_dt)
    wrench = [slave.get("w")]
    for t, then in itertools.pairwise(log.t):
        slave.fmu.doStep(t, then - t)
        wrench.append(slave.get("w"))
    np.testing.assert_allclose(wrench, log.w, rtol=1e-9, atol=1e-9)


@needs_compiler
@pytest.mark.parametrize("system", [
    {"arm": "ur5e", "vehicle": "straight-vertical"},
    {"vehicle": "free-floating"},
    {"vehicle": "decoupled", "effects": [{"kind": "joint/coulomb", "torque": [2, 2, 2]}]},
    {"arm": "canadarm2", "vehicle": "decoupled"},
    {"effects": [{"kind": k, **VALUES[k]} for k in ("joint/elasticity", "base/extra_mode")]},
    {"arm": "balanced.urdf#tool", "vehicle": "decoupled"},
])  # fmt: skip
def test_other_systems_are_the_simulators(system, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("balanced.urdf").write_text(robot(BALANCED))  # a joint follows another
    system = vg.System.from_dict(system)
    motion = vg.Motion.straight(system.arm.home, system.arm.home + 0.1, 0.5)
    dt = system.control_dt
    t = dt * np.arange(round(0.5 / dt))
    _, q, v, _ = motion.at(t)
    slave = Slave(vg.export(system, tmp_path / "system.fmu"))
    y = 0.0 if system.base.body is not None else [0.01, 0, 0, 0, 0.01, 0]
    slave.begin(y_start=y)
    rows = without_wrench(slave.play(t, dt, q, v))
    slave.close()
    expected = simulated(system, q, v, q=system.arm.home, y=y)
    scale = np.abs(expected).max(axis=0) + 1e-9
    assert (np.abs(rows - expected).max(axis=0) < 1e-8 * scale).all()


@needs_compiler
@pytest.mark.parametrize(
    "platform",
    [None, pytest.param("filtered", marks=pytest.mark.slow),
     pytest.param("limits", marks=pytest.mark.slow)],
)  # fmt: skip
def test_the_laboratory_is_the_simulators(platform, tmp_path):
    """Reference: `Simulator`, sensors, platform and safety stop included; other gains, too.

    Tolerance: the platform's acceleration takes rounding out of its pose, over a step squared.
    """
    effect = {"kind": "gravity/scale", **VALUES["gravity/scale"]}
    system = vg.System.from_dict({"mode": "emulated", "effects": [effect]})
    if platform == "filtered":
        servo = LEG_SERVOS["filtered"]
        control_dt, physics_dt = leg_clock(servo)
        lab = dataclasses.replace(system.emulator_settings, platform=servo)
        how = {"control_dt": control_dt, "physics_dt": physics_dt, "effects": ()}
        system = system.replace(emulator=lab, **how)
    if platform == "limits":  # a safety stop, which holds the platform
        lab = dataclasses.replace(system.emulator_settings, force_max=925.0)
        system = system.replace(emulator=lab)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", EmulationWarning)
        slave = Slave(vg.export(system, tmp_path / "system.fmu"))
        gains = {"kp": 0.7 * slave.get("kp"), "kd": 0.8 * slave.get("kd")}
        dt = system.control_dt
        t = dt * np.arange(round(2 / dt))
        _, q, v, _ = MOTION.at(t)
        slave.begin(**gains)
        rows = np.delete(slave.play(t, dt, q, v), -3, axis=1)  # without the total energy
        expected = simulated(system, q, v, servo=gains)
    slave.close()
    scale = np.abs(expected).max(axis=0) + 1e-9
    assert (np.abs(rows - expected).max(axis=0) < 1e-8 * scale).all()
    assert expected[-1, -3] == (platform == "limits")


@needs_compiler
def test_prescribed_joints_take_accelerations(tmp_path):
    system = vg.System(drive="prescribed")
    slave = Slave(vg.export(system, tmp_path / "system.fmu"))
    slave.begin(v_start=[0.1, 0, 0])
    slave.set(a_cmd=[0.2, -0.1, 0.3])
    slave.fmu.doStep(0.0, 0.5)
    np.testing.assert_allclose(slave.get("v"), [0.2, -0.05, 0.15], rtol=1e-12)
    sim = Simulator(system)
    sim.reset(v=[0.1, 0, 0])
    for _ in range(round(0.5 / system.control_dt)):
        state = sim.step([[0.2, -0.1, 0.3]])
    np.testing.assert_allclose(slave.get("y"), state.y[0], rtol=1e-9)
    tau, _ = sim.evaluate([[0.2, -0.1, 0.3]])
    np.testing.assert_allclose(slave.get("tau"), tau[0], rtol=1e-9)
    slave.close()


# ------------------------------------------------------------------------------ the standard


def test_description_and_sources_are_the_standards(bent):
    """Reference: the standard's schemas and FMPy's own checks."""
    assert validate_fmu(str(bent)) == []
    build = read_build_description(str(bent))
    assert [k.modelIdentifier for k in build] == [module.MODEL]
    with zipfile.ZipFile(bent) as archive:
        assert archive.testzip() is None
        assert {"sources/fmu.c", "sources/equations.c", "sources/model.h"} <= set(
            archive.namelist()
        )


@needs_compiler
def test_a_state_is_returned_to_and_travels_as_bytes(slave):
    t = 0.0125 * np.arange(40)
    _, q, v, _ = MOTION.at(t)
    slave.begin()
    first = slave.play(t[:20], 0.0125, q[:20], v[:20])
    state = slave.fmu.getFMUState()
    data = slave.fmu.serializeFMUState(state)
    then = slave.play(t[20:], 0.0125, q[20:], v[20:])
    slave.fmu.setFMUState(state)
    np.testing.assert_array_equal(slave.play(t[20:], 0.0125, q[20:], v[20:]), then)
    slave.fmu.freeFMUState(state)
    slave.fmu.reset()
    slave.begin()
    np.testing.assert_array_equal(slave.play(t[:20], 0.0125, q[:20], v[:20]), first)
    again = slave.fmu.deserializeFMUState(data)
    slave.fmu.setFMUState(again)
    np.testing.assert_array_equal(slave.play(t[20:], 0.0125, q[20:], v[20:]), then)
    slave.fmu.freeFMUState(again)


@needs_compiler
def test_the_physics_step_is_a_parameter(slave):
    """Order four: half the step leaves a sixteenth of the error."""

    def end(h):
        slave.fmu.reset()
        slave.begin(physics_dt=h, y_start=[0.05, 0, 0, 0, 0.02, 0])
        slave.fmu.doStep(0.0, 0.1)
        return slave.get("y")

    coarse, fine, finest = (end(h) for h in (1.25e-3, 0.625e-3, 0.3125e-3))
    ratio = np.abs(coarse - fine).max() / np.abs(fine - finest).max()
    assert 10 < ratio < 24


@needs_compiler
@pytest.mark.parametrize(
    ("values", "length", "said"),
    [
        ({"physics_dt": 2e-3}, 0.01, "physics_dt must be > 0 and <= 0.00125 s, got 0.002"),
        ({}, 1e-3, "whole number of physics steps of 0.00125 s, got 0.001 s"),
        ({"y_start": 1e11}, 0.1, "the simulation diverged"),
    ],
)
def test_what_is_wrong_is_said(slave, values, length, said, capfd):
    with pytest.raises(Exception, match=r"ERROR|Error|error"):
        slave.begin(**values)
        slave.set(q_cmd=0.5)
        slave.fmu.doStep(0.0, length)
    slave.fmu.reset()
    out, err = capfd.readouterr()
    assert said in out + err


SATELLITE = vg.get_vehicle("free-floating")
ON_ORBIT = dataclasses.replace(SATELLITE, orbit=vg.mechanics.Orbit(altitude=4e5))


@pytest.mark.parametrize(
    ("system", "said"),
    [
        ({"mode": "emulated", "emulator": {"operation": "position"}}, "operation position"),
        (
            {
                "mode": "emulated",
                "effects": [{"kind": "sensor/noise", **VALUES["sensor/noise"]}],
            },
            "noise and drift",
        ),
        ({"vehicle": "free-flying"}, "jets"),
        ({"vehicle": "servicer"}, "reaction wheels"),
        ({"integrator": "euler"}, "integrator euler"),
        (vg.System(vehicle=ON_ORBIT).to_dict(), "an orbit"),
        ({"effects": [{"kind": "command/delay", "delay": 0.01}]}, "delays"),
    ],
)
def test_what_an_fmu_has_no_words_for_is_named(system, said, tmp_path):
    with pytest.raises(vg.ParameterError, match=f"an FMU has no words for .*{said}"):
        vg.export(vg.System.from_dict(system), tmp_path / "system.fmu")
    assert not list(tmp_path.iterdir())


def test_without_a_compiler_there_are_sources(tmp_path, monkeypatch):
    monkeypatch.setattr(module.shutil, "which", lambda name: None)
    path = tmp_path / "system.fmu"
    assert not module.write_fmu(path, vg.System())
    assert validate_fmu(str(path)) == []
    with zipfile.ZipFile(path) as archive:
        assert not [k for k in archive.namelist() if k.startswith("binaries")]


@needs_compiler
def test_a_satellite_that_tumbles_is_stopped_and_said(tmp_path, capfd):
    system = vg.System.from_dict({"vehicle": "free-floating"})
    slave = Slave(vg.export(system, tmp_path / "system.fmu"))
    slave.begin(yd_start=[0, 0, 0, 0, 2.0, 0])
    with pytest.raises(Exception, match=r"ERROR|Error|error"):
        slave.fmu.doStep(0.0, 1.0)
    assert "phi_y reached 89 deg" in "".join(capfd.readouterr())
