"""Motions in, records out: on one clock, exact at the ends, with the wrench that acts."""

import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid

from ves_gym._util.params import ParameterError
from ves_gym.mechanics.arm_library import get_arm
from ves_gym.mechanics.dynamics import inverse_dynamics
from ves_gym.mechanics.link import diagonal
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.servo import HIGH_GAINS, OWN_GAINS, OWN_SERVO, JointServo
from ves_gym.mechanics.spatial import matvec, rotation, twist
from ves_gym.mechanics.vehicle import BENT, BENT_THESIS, FREE_FLOATING, SERVICER, MatrixVehicle
from ves_gym.simulation.machines import Divergence
from ves_gym.simulation.playback import play_motions
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.effect import EFFECTS
from ves_gym.system.energy_balance import EnergyBalance
from ves_gym.system.runlog import RunLog
from ves_gym.system.system import System

MOTION = Motion.through([[0.3, -0.4, 0.5], [0.8, 0.0, 0.0], [0.9, 0.1, -0.3]], 1.0)
OTHER = Motion.straight([0.0, 0.0, 0.0], [-0.5, 0.3, 0.2], 1.0)


def rigid(stiffness=1e9, **options):
    """A base that hardly moves: 1e9 N/m under a tonne, damped."""
    vehicle = MatrixVehicle(
        M=diagonal(*[1e3] * 6), D=diagonal(*[1e6] * 6), K=diagonal(*[stiffness] * 6)
    )
    step = 2e-4
    return System(vehicle=vehicle, physics_dt=step, control_dt=10 * step, **options)


# -------------------------------------------------------------------------- records


def test_records_of_a_stack():
    run = play_motions(
        System(vehicle=BENT_THESIS), [MOTION, OTHER, MOTION], settle=0.5, record_dt=5e-3
    )
    np.testing.assert_allclose(run.t, 5e-3 * np.arange(301), rtol=1e-9, atol=0)
    for name in ("q_cmd", "v_cmd", "q", "v", "tau", "y", "yd", "w"):
        values = getattr(run, name)
        assert values.shape == (3, 301, 6 if name in ("y", "yd", "w") else 3)
        assert (values[0] == values[2]).all()  # the same motion twice
        assert np.isfinite(values).all()
    np.testing.assert_array_equal(run.q_cmd[1], OTHER.at(run.t).q)
    np.testing.assert_array_equal(run.v_cmd[1], OTHER.at(run.t).v)
    assert (run.q[:, 0] == [MOTION.start, OTHER.start, MOTION.start]).all()
    assert (run.y[:, 0] == 0).all()
    assert run.duration == 1.0


def test_a_record_lies_on_the_run_whatever_its_period():
    """Records every 1.25, 12.5 and 25 ms: the same run, to rounding."""
    fine, default, coarse = (
        play_motions(System(vehicle=BENT_THESIS), [MOTION], settle=0.1, record_dt=dt)
        for dt in (1.25e-3, None, 25e-3)
    )
    for name in ("q", "v", "y", "yd"):
        a, b, c = (getattr(run, name) for run in (fine, default, coarse))
        np.testing.assert_allclose(a[:, ::10], b, rtol=0, atol=1e-13)
        np.testing.assert_allclose(a[:, ::20], c, rtol=0, atol=1e-13)
    np.testing.assert_allclose(fine.w[:, ::20], coarse.w, atol=1e-9)


# --------------------------------------------------------------------------- wrench


def test_on_a_rigid_base_the_wrench_is_that_of_inverse_dynamics():
    """w is found from the base's motion, inverse dynamics from the arm's: no shared formula.

    Tolerance: the base of 1e9 N/m gives way by a micrometre; 1e-3 of the largest wrench
    covers what its own vibration takes. The start is at rest and smooth.
    """
    run = play_motions(rigid(drive="prescribed"), [MOTION, OTHER], settle=0.2, record_dt=2e-3)
    assert np.abs(run.y).max() < 1e-6
    for i, motion in enumerate((MOTION, OTHER)):
        s = motion.at(run.t)
        tau, wrench = inverse_dynamics(run.system.arm, s.q, s.v, s.a)
        for found, want in ((run.w[i], wrench), (run.tau[i], tau)):
            scale = np.abs(want).max()
            assert scale > 10
            np.testing.assert_allclose(found, want, atol=1e-3 * scale)


def test_on_a_satellite_the_wrench_is_what_accelerates_it():
    """Linear momentum of the satellite = integral of the force, in inertial axes.

    Tolerance: trapezoid rule at 1.25 ms.
    """
    run = play_motions(System(vehicle=FREE_FLOATING), [MOTION], settle=0.0, record_dt=1.25e-3)
    y, yd, R = run.y[0], run.yd[0], rotation(run.y[0])
    force = matvec(R, run.w[0, :, :3])
    impulse = cumulative_trapezoid(force, run.t, axis=0, initial=0)
    spin = twist(y, yd)[:, 3:]
    momentum = 500 * (yd[:, :3] + matvec(R, np.cross(spin, FREE_FLOATING.body.com)))
    assert np.abs(momentum).max() > 1.0
    np.testing.assert_allclose(impulse, momentum, atol=1e-4 * np.abs(momentum).max())


# ------------------------------------------------------------------------------ logs


def test_a_run_becomes_a_log_that_repeats_it(tmp_path):
    run = play_motions(System(vehicle=BENT_THESIS), [MOTION, OTHER], settle=0.2, y=0.001)
    run.log(1, note="second").save(tmp_path / "run.csv")
    log = RunLog.load(tmp_path / "run.csv")
    for name in ("q_cmd", "v_cmd", "q", "v", "tau", "y", "yd", "w"):
        np.testing.assert_array_equal(getattr(log, name), getattr(run, name)[1])
    assert log.meta["duration"] == 1.0
    assert log.meta["controller"]["kp"] == list(HIGH_GAINS.kp)
    initial = log.meta["initial"]
    assert initial["q"] == list(OTHER.start)
    assert initial["y"] == [0.001] * 6
    # everything needed to run it again is in the log
    system = System.from_dict(log.meta["system"])
    assert system == run.system
    sim = Simulator(system)
    assert (sim.reset(**initial).y == 0.001).all()


# ---------------------------------------------------------------------------- errors


@pytest.mark.parametrize(
    ("motions", "options", "message"),
    [
        ([], {}, "need at least one motion to play, got none"),
        ([MOTION, OTHER.retimed(2.0)], {}, r"share one duration, got \[1.0, 2.0\]"),
        ([Motion.straight([0, 0], [1, 1], 1.0)], {}, "puma560 needs 3 joints, got 2"),
        ([MOTION], {"record_dt": 2e-3}, "record_dt must be a whole number of physics steps"),
        ([MOTION], {"record_dt": np.inf}, "record_dt must be a whole number"),
        ([MOTION], {"settle": np.nan}, "settle must be >= 0 s"),
        ([MOTION], {"yd": np.nan}, "yd must be finite"),
        ([MOTION], {"servo": JointServo(kp=(1.0,), kd=(1.0,))}, "gains for 3 joints, got 1"),
    ],
)
def test_what_cannot_be_played_is_refused(motions, options, message):
    with pytest.raises(ParameterError, match=message):
        play_motions(System(vehicle=BENT_THESIS), motions, **options)


def test_a_run_that_diverges_is_an_error(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # the engine writes a log there
    with pytest.raises(Divergence, match="simulation 1 of 2 diverged at t = "):
        play_motions(
            System(vehicle=BENT_THESIS), [MOTION, OTHER], yd=[[0.0] * 6, [1e12] + [0.0] * 5]
        )


# ---------------------------------------------------------------------------- limits

VMAX = System(vehicle=BENT_THESIS).arm.column("v_max")
DELAYS = tuple(
    EFFECTS[kind](**{name: value})
    for kind, name, value in (
        ("joint/measurement_delay", "delay", 0.004),
        ("joint/velocity_lag", "time_constant", (0.01, 0.01, 0.01)),
        ("command/delay", "delay", 0.003),
    )
)
QUICK_TURN = Motion.straight(np.zeros(3), np.deg2rad([40.0, -25, 50]), 0.5)


@pytest.mark.parametrize(
    "system",
    [
        System(vehicle=BENT_THESIS, effects=DELAYS),
        System(vehicle=BENT_THESIS, mode="emulated", physics_dt=1.25e-3, control_dt=5e-3),
    ],
    ids=["delays", "emulated"],
)
def test_watching_the_joints_changes_no_record(system):
    dt = 25e-3
    plain, watched = (
        play_motions(system, [QUICK_TURN], settle=0.3, record_dt=dt, watch=w)
        for w in (False, True)
    )
    for name in ("q", "v", "tau", "y", "yd", "w", "wg", "y_cmd"):
        a, b = getattr(plain, name), getattr(watched, name)
        assert a is b is None or np.array_equal(a, b), name
    assert plain.watch is None and watched.watch is not None


def test_the_joints_are_watched_at_every_physics_step():
    """Records every 125 ms miss the peak; the check does not. Dense records are the truth."""
    system = System(vehicle=BENT_THESIS)
    coarse = play_motions(system, [QUICK_TURN], settle=0.3, record_dt=0.125, watch=True)
    dense = play_motions(system, [QUICK_TURN], settle=0.3, record_dt=system.physics_dt)
    here, truth = coarse.limit_check(0), dense.limit_check(0)
    assert here == truth
    velocity = next(e for e in here.extremes if e.kind == "velocity")
    assert velocity.breaks and velocity.ratio > np.abs(coarse.v[0] / VMAX).max() * 1.001
    assert (
        velocity.value
        == dense.v[0, np.searchsorted(dense.t, velocity.time - 1e-9)][velocity.joint - 1]
    )
    assert coarse.limit_check(0, v_max=(9.0,) * 3) == here and not here.inside
    tight = coarse.limit_check(0, v_max=(0.1, 9.0, 9.0)).extremes[1]
    assert tight.joint == 1 and tight.limit == 0.1  # the tighter of two limits holds
    assert "simulated arm: velocity of joint" in truth.sentences("simulated arm")[0]
    seen, recorded = coarse.closely(0), dense.closely(0)
    for name in ("t", "q", "v", "y"):
        a, b = getattr(seen, name), getattr(recorded, name)
        assert np.array_equal(a[: len(b)], b), name


def test_a_servo_that_foresees_the_base_follows_over_it(tmp_path):
    """A UR5e on a beam that yields; the log tells the torque that its commands do not."""
    system = System(arm=get_arm("ur5e"), vehicle=BENT)
    motion = Motion.straight(
        [0.0, -1.2, 1.0, 0.3, 0.5, 0.0], [0.8, -0.5, 0.2, 0.9, 0.0, 0.5], 1.0
    )
    runs = [
        play_motions(system, [motion], servo=servo, settle=1.0, record_dt=system.physics_dt)
        for servo in (OWN_SERVO, OWN_GAINS)
    ]
    off = [np.abs(run.q - run.q_cmd).max() for run in runs]
    print("joints off their commands by", off)
    assert off[0] < 5e-4 and off[1] > 20 * off[0]
    log, plain = (run.log(0) for run in runs)
    gains = log.meta["controller"]
    assert gains["moving_base"] and "moving_base" not in plain.meta["controller"]
    assert plain.tau_ff is None
    by_gains = (log.q_cmd - log.q) * gains["kp"] + (log.v_cmd - log.v) * gains["kd"]
    assert log.tau == pytest.approx(by_gains + log.tau_ff, abs=1e-6)
    log.save(tmp_path / "run.csv")
    assert RunLog.load(tmp_path / "run.csv").digest == log.digest
    assert EnergyBalance.of(log).relative < 1e-3


@pytest.mark.parametrize("vehicle", [SERVICER, FREE_FLOATING], ids=["satellite", "free"])
def test_and_over_bases_that_drift(vehicle):
    system = System(vehicle=vehicle)
    servos = OWN_SERVO, OWN_GAINS
    runs = [play_motions(system, [MOTION], servo=k, settle=0.5, yd=0.01) for k in servos]
    off = [np.abs(run.q - run.q_cmd).max() for run in runs]
    assert off[0] < 1e-4 < off[1]
