"""The emulated mode: the machine that moves the arm as the vehicle would, tick by tick."""

import pickle
import re

import numpy as np
import pytest
from scipy.integrate import quad

from tests.arms import six_joint_arm
from ves_gym._util.params import ParameterError
from ves_gym.effects import GravityDelay, SensorDrift, SensorNoise
from ves_gym.engine.mjcf import TO_Y
from ves_gym.hardware.leg_servo import FILTERED, leg_clock
from ves_gym.hardware.platform import PoseServo
from ves_gym.hardware.stewart import VES
from ves_gym.mechanics.arm_files import pinocchio_model
from ves_gym.mechanics.arm_library import PUMA_560, get_arm
from ves_gym.mechanics.dynamics import inverse_dynamics
from ves_gym.mechanics.gravity import GRAVITY, GravityModel, gravity_vector
from ves_gym.mechanics.link import diagonal
from ves_gym.mechanics.spatial import rate_matrix
from ves_gym.mechanics.vehicle import BENT_THESIS, DECOUPLED, FREE_FLOATING, MatrixVehicle
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.emulator_settings import EmulatorSettings
from ves_gym.system.system import System

POSE = np.array([0.01, 0.02, -0.03, 0.1, -0.2, 0.3])
ANGLES = np.array([0.3, -0.2, 0.5])
NOISE = (
    SensorNoise(force=(0.5,) * 3, moment=(0.3,) * 3),
    SensorDrift(force=(0.3,) * 3, moment=(0.2,) * 3, time=5.0),
)


@pytest.fixture(autouse=True)
def _engine_log_elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # the engine writes MUJOCO_LOG.TXT where it is told to warn


def emulated(*, vehicle=DECOUPLED, effects=(), drive="motor", arm=PUMA_560, **options):
    """A system in the laboratory; other options are the emulator's."""
    return System(
        mode="emulated",
        vehicle=vehicle,
        effects=effects,
        drive=drive,
        arm=arm,
        emulator=EmulatorSettings(**options),
    )


def same(a, b, rows=slice(None)):
    """Bitwise equality of two tuples of arrays (states, readings)."""
    return all(x[rows].tobytes() == y[rows].tobytes() for x, y in zip(a, b, strict=True))


def all_of(sim, rows=slice(None)):
    return [part[rows] for part in (*sim.state, *sim.readings)]


def hold(sim, q):
    shape = (sim.n, sim.joints)
    return sim.servo_command(np.broadcast_to(q, shape), np.zeros(shape))


def swing(sim, periods, start=0):
    """A motion of all joints by the servo, or by their accelerations if prescribed."""
    for k in range(start, start + periods):
        phase = 2 * np.pi * k / 80 * np.array([0.7, 1.1, 1.3]) + np.arange(sim.n)[:, None]
        if sim.system.drive == "prescribed":
            sim.step(0.8 * np.sin(phase))
        else:
            sim.step(sim.servo_command(0.3 * np.sin(phase), np.zeros((sim.n, 3))))


# -------------------------------------------------------------------- the platform


@pytest.mark.parametrize("drive", ["motor", "prescribed"])
def test_the_engines_platform_is_where_the_follower_is(drive):
    """Four seconds of a swinging arm on the bent beam, three runs at once.

    The engine integrates accelerations; what that and the arm's reaction leave is taken
    out every period. Tolerance: 1e-9 m against motions of centimetres.
    """
    sim = Simulator(emulated(vehicle=BENT_THESIS, drive=drive), 3)
    off = rate = 0.0
    for k in range(320):
        swing(sim, 1, k)
        memory, state = sim.emulation_loop.memory, sim.state
        off = max(off, np.abs(state.y - memory["platform.y"]).max())
        rate = max(rate, np.abs(state.yd - memory["platform.yd"]).max())
    assert np.abs(state.y).max() > 1e-3
    assert off < 1e-9
    assert rate < 1e-7


@pytest.mark.parametrize("delay", [0, 3])
def test_a_given_motion_is_followed_after_the_delay(delay):
    """Position control: a 0.2 Hz sway of 2 cm and 0.02 rad.

    Tolerance 1e-3 of it: a servo with rate feed-forward lags accelerations by their
    (0.2 Hz / 8 Hz)^2 = 6e-4.
    """
    sim = Simulator(emulated(operation="position", delay=delay))
    w, dt = 2 * np.pi * 0.2, sim.system.control_dt

    def path(t):
        wave = np.array([w * np.sin(w * t), w**2 * np.cos(w * t)]) / w
        return np.concatenate([0.02 * wave[0] * np.ones(6), 0.02 * wave[1] * np.ones(6)])

    start = path(-delay * dt)
    sim.reset(y=start[:6], yd=start[6:])
    # what was commanded before the start is still on its way
    if delay:
        queue = np.stack([path((k - delay) * dt) for k in range(delay)])
        sim.emulation_loop.memory["computing_delay.queue"] = queue[None]
    worst = 0.0
    for k in range(400):
        state = sim.step(0.0, platform=path(k * dt)[None])
        want = path((k + 1 - delay) * dt)
        worst = max(worst, np.abs(state.y[0] - want[:6]).max())
    assert worst < 1e-3 * 0.02
    assert sim.events == []


def test_a_pose_alone_is_a_motion_without_rate_and_none_is_no_motion():
    sims = [Simulator(emulated(operation="position"), 2) for _ in range(3)]
    pose = 1e-4 * np.arange(12.0).reshape(2, 6)
    for _ in range(5):
        sims[0].step(0.0, platform=pose)
        sims[1].step(0.0, platform=np.hstack([pose, 0 * pose]))
        sims[2].play(np.zeros((2, 11, 3)), platform=np.hstack([pose, 0 * pose])[:, None])
    assert same(all_of(sims[0]), all_of(sims[1]))
    assert same(all_of(sims[0]), all_of(sims[2]))
    for _ in range(100):
        sims[0].step(0.0)
    np.testing.assert_allclose(sims[0].state.y, pose, rtol=0, atol=1e-9)


# -------------------------------------------------------------------- the wrench


def rnea(arm, y, yd, ydd, q, v, a):
    """Wrench of the arm on a moving base under gravity, by Pinocchio."""
    pin = pytest.importorskip("pinocchio")
    model = pinocchio_model(arm, DECOUPLED.base_model())
    model.gravity.linear[:] = [0.0, 0.0, -GRAVITY]
    data = model.createData()
    force = pin.rnea(
        model, data, *(np.concatenate([b[TO_Y], j]) for b, j in ((y, q), (yd, v), (ydd, a)))
    )
    return -np.linalg.solve(rate_matrix(y).T, force[:6][TO_Y])


@pytest.mark.parametrize(
    ("arm", "balance"),
    [(PUMA_560, True), (PUMA_560, False), (six_joint_arm(), True)],
    ids=["puma", "unbalanced", "wrist"],
)
def test_the_engines_wrench_is_that_of_newton_and_euler(arm, balance):
    """At rest in a tilted pose, and in full motion: MuJoCo's sensor against our inverse
    dynamics, our gravity model and Pinocchio's.

    Joints are prescribed: a motor would give way. Tolerance: 1e-4 N of 1e3 N.
    """
    n = arm.n
    rng = np.random.default_rng(0)
    q = np.resize(ANGLES, n)
    still = emulated(arm=arm, drive="prescribed", operation="position", joint_balance=balance)
    sim = Simulator(still, 2)
    sim.reset(q=q, y=POSE)
    felt = sim.backend.step_on_platform(np.zeros((2, 11, n)), np.zeros((2, 11, 6)), None)
    gravity = tuple(gravity_vector(POSE).tolist())
    by_statics = GravityModel.of(arm).wrench(arm, q, POSE)
    by_dynamics = inverse_dynamics(arm, q, 0 * q, 0 * q, gravity)[1]
    zero = np.zeros(6)
    for want in (by_statics, by_dynamics, rnea(arm, POSE, zero, zero, q, 0 * q, 0 * q)):
        assert np.abs(want).max() > 300
        np.testing.assert_allclose(felt, np.tile(want, (2, 11, 1)), rtol=0, atol=1e-4)

    v, a = rng.normal(size=(2, n)), rng.normal(size=(2, 2, n)) * 2
    yd, ydd = rng.normal(size=(2, 6)) * 0.3, rng.normal(size=(2, 2, 6))
    ids = np.arange(2)
    for _ in range(2):  # accelerations that change over the step
        z, zd = np.tile(np.r_[POSE, q], (2, 1)), np.hstack([yd, v])
        sim.backend.write(ids, np.zeros(2), z, zd)
        felt = sim.backend.step_on_platform(a, ydd, None)
        _, later, later_rate = sim.backend.read()
        for i in range(2):
            first = rnea(arm, POSE, yd[i], ydd[i, 0], q, v[i], a[i, 0])
            z, zd = later[i], later_rate[i]
            last = rnea(arm, z[:6], zd[:6], ydd[i, 1], z[6:], zd[6:], a[i, 1])
            assert np.abs(first - by_statics).max() > 10
            np.testing.assert_allclose(felt[i, 0], first, rtol=0, atol=1e-3)
            np.testing.assert_allclose(felt[i, -1], last, rtol=0, atol=1e-3)
        a, ydd = a[:, ::-1], ydd[:, ::-1]


# -------------------------------------------------------------------- operations

# heavy, stiff and well damped: settles within a second
FIRM = MatrixVehicle(
    M=diagonal(500, 500, 500, 250, 250, 250),
    D=diagonal(*[1.4e4] * 3, *[1e4] * 3),
    K=diagonal(*[1e5] * 6),
)


@pytest.mark.parametrize("compensation", [True, False])
def test_under_admittance_control_the_vehicle_sags_under_the_weight(compensation):
    """Thesis 2.2: the weight included, K Y = weight on the tilted platform.

    Tolerance: what is left of the approach after two seconds.
    """
    system = emulated(vehicle=FIRM, operation="admittance", payload_compensation=compensation)
    sim = Simulator(system)
    sim.reset(q=ANGLES)
    for _ in range(240):
        state = sim.step(hold(sim, ANGLES))
    y = state.y[0]
    weight = GravityModel.of(PUMA_560).wrench(PUMA_560, state.q[0], y)
    sag = np.linalg.solve(system.base.K, rate_matrix(y).T @ weight)
    assert sag[2] < -0.009  # 919 N on 1e5 N/m
    np.testing.assert_allclose(y, sag, rtol=0, atol=1e-6)
    assert (sim.readings.gravity == 0).all()


def test_a_zeroed_sensor_feels_changes_only():
    """App. E step 9: with the zero set at the start the vehicle stays where it was put."""
    sim = Simulator(emulated(vehicle=FIRM, operation="admittance", zero_at_start=True), 2)
    sim.reset(q=ANGLES)
    np.testing.assert_allclose(sim.readings.wrench, 0, atol=1e-9)
    for _ in range(80):
        sim.step(hold(sim, ANGLES))
    np.testing.assert_allclose(sim.state.y, 0, atol=1e-9)
    # zeroing later, one simulation only, in another place
    sag = Simulator(emulated(vehicle=FIRM, operation="admittance"), 2)
    sag.reset(q=ANGLES)
    sag.zero_sensor([1])
    for _ in range(80):
        sag.step(hold(sag, ANGLES))
    assert sag.state.y[0, 2] < -5e-3
    np.testing.assert_allclose(sag.state.y[1], 0, atol=1e-9)


# ------------------------------------------------------- batches, snapshots, resets

KINDS = {
    "compensated": {},
    "plain satellite": {
        "vehicle": FREE_FLOATING,
        "payload_compensation": False,
        "platform": PoseServo(bandwidth=2.0),
    },
    "prescribed": {"drive": "prescribed"},
    "zeroed, late": {"zero_at_start": True, "delay": 3},
}


def noisy(kind, **options):
    # an estimate that is late makes a satellite, which nothing pulls back, tumble slowly
    late = () if "satellite" in kind else (GravityDelay(delay=0.02),)
    return emulated(effects=(*NOISE, *late), **{**KINDS[kind], **options})


def legs_system(**options):
    control, physics = leg_clock(FILTERED)
    base = emulated(platform=FILTERED, **options)
    return base.replace(control_dt=control, physics_dt=physics)


@pytest.mark.parametrize("kind", [*KINDS, "legs"])
def test_a_snapshot_continues_bitwise(kind):
    """In the middle of a run, in the same simulator and, pickled, in a new one."""
    system = legs_system(effects=NOISE) if kind == "legs" else noisy(kind)
    sim = Simulator(system, 2, seed=1)
    swing(sim, 10)
    text = pickle.dumps(sim.snapshot())
    swing(sim, 15, 10)
    want = all_of(sim)
    other = Simulator(system, 2, seed=99)
    swing(other, 3)
    for target in (sim, other):
        target.restore(pickle.loads(text))
        swing(target, 15, 10)
        assert same(all_of(target), want)


def test_a_snapshot_keeps_events_and_the_rows_of_a_gravity_table():
    sim = Simulator(emulated(force_max=925.0, drive="prescribed"), 2)
    table = np.arange(20)[:, None] * np.ones(6) * 1e-3 + sim.readings.gravity[0]
    sim.use_gravity(np.tile(table, (2, 1, 1)))
    for _ in range(4):
        sim.step([[0.0, 0, 0], [0.0, 20.0, 0]])
    assert len(sim.events) == 1
    kept = pickle.loads(pickle.dumps(sim.snapshot()))
    events, want = sim.events, []
    for _ in range(3):
        sim.step(0.0)
        want.append(all_of(sim))
    sim.use_gravity(None)
    sim.reset()
    assert sim.events == []
    sim.restore(kept)
    assert sim.events == events
    for parts in want:
        sim.step(0.0)
        assert same(all_of(sim), parts)


@pytest.mark.parametrize("kind", [*KINDS, "legs"])
def test_a_partial_reset_touches_only_the_named_simulations(kind):
    system = legs_system(effects=NOISE) if kind == "legs" else noisy(kind)
    sim, twin = Simulator(system, 4, seed=2), Simulator(system, 4, seed=2)
    for s in (sim, twin):
        swing(s, 8)
    sim.reset(q=ANGLES, y=0.001, ids=[1, 3])
    others = [0, 2]
    assert same(all_of(sim, others), all_of(twin, others))
    for k in range(6):
        swing(sim, 1, k)
        swing(twin, 1, k)
    assert same(all_of(sim, others), all_of(twin, others))
    assert sim.state.time[1] == pytest.approx(6 * system.control_dt)


# ------------------------------------------------------------------------ safety


def freeze(sim, *, far=None, jerk=None, periods=60):
    """Something happens to simulation 1 of two, in its third period."""
    follow, command = np.zeros((2, 6)), np.zeros((2, 3))
    for k in range(periods):
        if far is not None:
            follow[1] = far if k >= 2 else 0.0
            sim.step(command, platform=follow)
        else:
            command[1] = jerk if k == 2 else 0.0
            sim.step(command)
    return sim.events


@pytest.mark.parametrize(
    ("options", "what", "reason"),
    [
        (
            {"operation": "position", "delay": 0},
            {"far": [0, 0, 0.6, 0, 0, 0]},
            r"leg 1 would be 2\.0\d\d m long, its range is 1\.100 to 1\.900 m \(outside the",
        ),
        (
            {"operation": "position", "delay": 0},
            {"far": [0.05, 0, 0, 0, 0, 0]},
            r"leg \d would move at \d\.\d\d m/s, its limit is 1 m/s",
        ),
        (
            {"operation": "position", "force_max": 930.0},
            {"jerk": [0.0, 20.0, 0.0]},
            r"force 1\d\d\d N is above the limit of 930 N",
        ),
        (
            {"operation": "position", "moment_max": 120.0},
            {"jerk": [0.0, 40.0, 0.0]},
            r"moment \d\d\d N m is above the limit of 120 N m",
        ),
    ],
    ids=["workspace", "speed", "force", "moment"],
)
def test_an_unsafe_platform_freezes_says_why_and_stands_still(options, what, reason):
    """Thesis 2.4.2. The simulation beside it goes on as if nothing had happened."""
    system = emulated(drive="prescribed", **options)
    sim, twin = Simulator(system, 2), Simulator(system, 2)
    events = freeze(sim, **what)
    assert len(events) == 1
    event = events[0]
    assert event.simulation == 1
    assert re.search(reason, event.reason)
    assert str(event) == f"platform frozen at t = {event.time:.4f} s: {event.reason}"
    dt = system.control_dt
    late = 0.0 if "far" in what else dt  # a reading is checked in the next period
    assert 2 * dt + late - 1e-9 < event.time < 8 * dt
    # it stands; commands do not matter any more
    before = sim.state.y[1].copy()
    assert np.abs(before).max() < 1e-6
    freeze(sim, far=[0, 0, 0.001, 0, 0, 0], periods=20)
    np.testing.assert_allclose(sim.state.y[1], before, rtol=0, atol=1e-9)
    np.testing.assert_allclose(sim.state.yd[1], 0, atol=1e-9)
    assert sim.events == events
    # the other is bitwise that of a pair in which nothing happened
    still = {"far": np.zeros(6)} if "far" in what else {"jerk": 0.0}
    assert freeze(twin, **still) == []
    freeze(twin, far=np.zeros(6), periods=20)
    assert same(all_of(sim, [0]), all_of(twin, [0]))
    # a reset sets it free
    sim.reset(ids=[1])
    assert sim.events == []
    moved = freeze(sim, far=[0, 0, 1e-4, 0, 0, 0], periods=40)
    assert moved == []
    assert sim.state.y[1, 2] == pytest.approx(1e-4, abs=1e-5)


def test_a_vehicle_that_goes_out_of_hand_is_frozen():
    """A moving platform too comes to rest where it is, NaN counts as unsafe."""
    fast = Simulator(emulated(vehicle=FREE_FLOATING), 2)
    fast.reset(yd=[[0.4, 0, 0, 0, 0, 0], [0.01, 0, 0, 0, 0, 0]])
    for _ in range(320):
        fast.step(hold(fast, np.zeros(3)))
    assert [e.simulation for e in fast.events] == [0]
    assert "outside the workspace" in fast.events[0].reason
    assert not VES.beyond(VES.leg_lengths(fast.readings.y_cmd))[0].any()
    assert np.abs(fast.state.yd[0]).max() < 1e-9
    assert fast.state.y[1, 0] == pytest.approx(0.04, rel=0.01)

    def broken(X, W):
        return np.full_like(X, np.nan)

    for compensation in (True, False):
        system = emulated(payload_compensation=compensation)
        sim = Simulator(system, admittance=broken)
        for _ in range(10):
            sim.step(0.0)
        assert "nan m long" in sim.events[0].reason
        assert (sim.state.y == 0).all() or np.abs(sim.state.y).max() < 1e-9


# ------------------------------------------------------------------- kinds of loop


@pytest.mark.parametrize(("compensation", "tolerance"), [(True, 0.015), (False, 0.1)])
def test_a_hardening_spring_swings_faster(compensation, tolerance):
    """A nonlinear vehicle of the user's own: M y'' + k y (1 + (y / c)^2) = W along x.

    The period of vehicle and arm together at the amplitude seen, by Duffing's integral of
    energy. Tolerance: amplitude and period are read at 80 Hz; the plain loop feels the
    arm's inertia late.
    """
    m, k, c = 500.0, 8e3, 0.03
    M = np.array([m, 1e5, 1e5, 1e5, 1e5, 1e5])

    def g(X, W):
        force = W - 1e3 * X[:, 6:] * [0, 1, 1, 1, 1, 1]
        force[:, 0] -= k * X[:, 0] * (1 + (X[:, 0] / c) ** 2)
        return np.hstack([X[:, 6:], force / M])

    system = emulated(drive="prescribed", payload_compensation=compensation)
    sim = Simulator(system, admittance=g)
    sim.reset(y=[0.04, 0, 0, 0, 0, 0])
    x = np.array([sim.step(0.0).y[0, 0] for _ in range(160)])
    down = np.flatnonzero((x[:-1] > 0) & (x[1:] <= 0))[:2]
    crossings = (down + x[down] / (x[down] - x[down + 1])) * system.control_dt
    size = np.abs(x[down[0] : down[1]]).max()
    total = m + PUMA_560.mass

    def period(a):  # x = a sin u; 2 E / k = a^2 + a^4 / (2 c^2)
        slowness = quad(
            lambda u: (1 + (1 + np.sin(u) ** 2) * (a / c) ** 2 / 2) ** -0.5, 0, np.pi / 2
        )
        return 4 * np.sqrt(total / k) * slowness[0]

    soft = 2 * np.pi * np.sqrt(total / k)
    assert period(1e-6) == pytest.approx(soft)
    assert period(size) < 0.75 * soft  # the spring does harden
    assert np.diff(crossings)[0] == pytest.approx(period(size), rel=tolerance)


# ------------------------------------------------------------- table of gravity


def test_a_gravity_table_is_read_row_by_row():
    sim = Simulator(emulated(), 2)
    model = sim.readings.gravity
    rows = np.random.default_rng(0).normal(size=(2, 3, 6))
    sim.use_gravity(rows)
    for k in (0, 1, 2, 2, 2):  # the last is held
        sim.step(0.0)
        np.testing.assert_array_equal(sim.readings.gravity, rows[:, k])
    sim.use_gravity(rows[:, :1])
    sim.reset()
    np.testing.assert_array_equal(sim.readings.gravity, rows[:, 0])
    sim.use_gravity(None)
    sim.reset()
    np.testing.assert_array_equal(sim.readings.gravity, model)


# ------------------------------------------------------------------- wrong input


def test_bad_emulators_are_refused():
    cases = [
        ({"operation": "float"}, "operation must be one of microgravity, .* got 'float'"),
        ({"admittance_form": "x"}, "admittance_form must be one of coupled, .* got 'x'"),
        ({"force_max": 0.0}, "force_max must be > 0 N, got 0.0"),
        ({"moment_max": np.nan}, "moment_max must be > 0 N m, got nan"),
    ]
    for delay in (-1, 1.0, True, "1"):
        cases.append(({"delay": delay}, f"delay must be a whole number .*got {delay!r}"))
    for options, message in cases:
        with pytest.raises(ParameterError, match=f"EmulatorSettings.{message}"):
            EmulatorSettings(**options)
    with pytest.raises(ParameterError, match="emulator belongs to mode emulated"):
        System(vehicle=BENT_THESIS, emulator=EmulatorSettings())
    with pytest.raises(ParameterError, match="decoupled admittance form needs diagonal"):
        Simulator(emulated(vehicle=BENT_THESIS, admittance_form="decoupled"))
    with pytest.raises(ParameterError, match=r"P must have 9 entries for puma560, got"):
        Simulator(emulated(gravity=GravityModel(mass=90.0, P=(1.0, 2.0))))
    with pytest.raises(ParameterError, match="without mass cannot be emulated"):
        massless = MatrixVehicle(
            M=diagonal(*[0] * 6), D=diagonal(*[0] * 6), K=diagonal(*[0] * 6)
        )
        Simulator(emulated(vehicle=massless, payload_compensation=False))
    with pytest.raises(ParameterError, match="mode ideal has no emulator"):
        _ = System(vehicle=BENT_THESIS).emulator_settings


def test_calls_that_do_not_fit_the_mode_are_refused_and_leave_no_trace():
    sim, ideal = Simulator(emulated(), 2), Simulator(System(vehicle=BENT_THESIS), 2)
    position = Simulator(emulated(operation="position"), 2)
    before, at = all_of(sim), all_of(position)
    for call, message in [
        (lambda: sim.step(0.0, base_wrench=0.0), "base_wrench needs mode ideal, got mode emul"),
        (lambda: sim.step(0.0, platform=np.zeros(6)), "position control, got microgravity"),
        (lambda: ideal.step(0.0, platform=np.zeros(6)), "platform needs mode emulated, got"),
        (lambda: ideal.use_gravity(None), "use_gravity needs mode emulated, operation micro"),
        (lambda: position.use_gravity(None), "use_gravity needs mode emulated, operation mi"),
        (lambda: ideal.zero_sensor(), "zero_sensor needs mode emulated, got mode ideal"),
        (lambda: ideal.readings, "readings need mode emulated, got mode ideal"),
        (
            lambda: Simulator(System(vehicle=BENT_THESIS), admittance=lambda X, W: X),
            "admittance needs mode emul",
        ),
        (lambda: sim.use_gravity(np.zeros((2, 0, 6))), r"table must be .*got \(2, 0, 6\)"),
        (lambda: sim.use_gravity(np.zeros((3, 6))), r"table must be .*\(2, 1, 6\), got \(3, 6"),
        (
            lambda: position.step(0.0, platform=np.zeros(5)),
            r"platform must be numbers of shape \(2, 12\), got \(5,\)",
        ),
        (lambda: position.step(0.0, platform="x"), r"platform must be numbers .*got 'x'"),
        (
            lambda: position.play(np.zeros((2, 21, 3)), platform=np.zeros((2, 3, 12))),
            r"platform must be numbers of shape \(2, 2, 12\), got \(2, 3, 12\)",
        ),
    ]:
        with pytest.raises(ParameterError, match=message):
            call()
    assert same(all_of(sim), before)
    assert same(all_of(position), at)
    assert ideal.events == []


def test_parts_of_a_control_period_cannot_be_played():
    sim = Simulator(emulated())
    before = all_of(sim)
    with pytest.raises(ParameterError, match=r"whole control periods of 10 .*, got 25 steps"):
        sim.play(np.zeros((1, 26, 3)))
    assert same(all_of(sim), before)
    sim.play(np.zeros((1, 21, 3)))
    assert sim.state.time[0] == pytest.approx(25e-3)


def test_an_arm_that_the_platform_cannot_carry_is_refused():
    """1505 kg on a machine that stops at 3000 N; one that carries them is another machine."""
    heavy = System(arm=get_arm("canadarm2"), mode="emulated")
    with pytest.raises(
        ParameterError, match=r"canadarm2 weighs 14767 N, .* = 3000 N: every run"
    ):
        Simulator(heavy, warn_at=None)
    strong = EmulatorSettings(force_max=5e4, moment_max=5e5)
    sim = Simulator(heavy.replace(emulator=strong), warn_at=None, backend="mujoco")
    assert np.isfinite(sim.step(np.zeros((1, 7))).q).all()
