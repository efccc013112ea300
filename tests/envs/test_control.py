"""What an action does to the motion that the joints follow."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from ves_gym._util.params import ParameterError
from ves_gym.envs.batch import Batch
from ves_gym.envs.build import build_task
from ves_gym.envs.control import (
    Acceleration,
    Gains,
    Guided,
    JointVelocity,
    Target,
    ToolVelocity,
    Torque,
    get_control,
)
from ves_gym.mechanics.arm_library import PUMA_560
from ves_gym.mechanics.kinematics import joint_positions
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.servo import OWN_GAINS, PPED_GAINS
from ves_gym.mechanics.vehicle import BENT_THESIS, VEHICLES
from ves_gym.planners.benchmark import run_benchmark
from ves_gym.planners.query import Query
from ves_gym.planners.suites import Suite
from ves_gym.system.system import System

PRESCRIBED = System(vehicle=BENT_THESIS, drive="prescribed", physics_dt=2.5e-3)
DT = PRESCRIBED.control_dt
Q_MIN, Q_MAX = PUMA_560.column("q_min"), PUMA_560.column("q_max")
V_MAX, A_MAX = PUMA_560.column("v_max"), PUMA_560.column("a_max")


def begun(n=8, seed=0, **settings):
    """n episodes at their beginning."""
    batch = Batch(build_task("rest_to_rest", **settings), n)
    everyone = np.arange(n)
    batch.seed(everyone, seed, everyone)
    batch.reset(everyone)
    return batch


def at_rest(q):
    """What a control moves on, n arms at rest at q (n, joints)."""
    ref = np.stack([q, 0 * q, 0 * q], axis=1)
    return SimpleNamespace(time=np.zeros(len(q)), q=q, v=0 * q, ref=ref, goal=q)


# -------------------------------------------------------------------------- guided


@pytest.mark.parametrize("duration", [0.5, 2.0])
def test_guided_zero_is_the_straight_motion(duration):
    """Reference against `Motion.straight`, angle, rate and acceleration at every period."""
    batch = begun(duration=duration)
    start, goal = batch.scene.q.copy(), batch.scene.goal[:, :3].copy()
    motions = [Motion.straight(a, b, duration) for a, b in zip(start, goal, strict=True)]
    for k in range(batch.task.steps + 1):
        expected = [m.at([k * DT]) for m in motions]
        expected = np.stack([[m.q[0], m.v[0], m.a[0]] for m in expected])
        np.testing.assert_allclose(batch.scene.ref, expected, rtol=0, atol=1e-9)
        if k < batch.task.steps:
            batch.step(np.zeros((8, 3)))


@pytest.mark.parametrize("vehicle", ["bent"])
def test_guided_zero_leaves_the_energy_of_the_planning_benchmark(vehicle):
    """E_mean and E_peak of the same queries in reach100's own code, within 1 %."""
    batch = begun(vehicle=vehicle)
    start, goal = batch.scene.q.copy(), batch.scene.goal[:, :3].copy()
    for _ in range(batch.task.steps):
        *_, info = batch.step(np.zeros((8, 3)))
    queries = tuple(
        (
            vehicle,
            Query(
                system=System(vehicle=VEHICLES[vehicle]),
                start=tuple(a),
                goal=tuple(b),
                duration=2.0,
                servo=OWN_GAINS,  # an environment knows no motion beforehand
                name=f"{i}",
            ),
        )
        for i, (a, b) in enumerate(zip(start.tolist(), goal.tolist(), strict=True))
    )
    rows = run_benchmark(
        Suite(name="mine", queries=queries, planners=("straight",)), workers=1
    )["rows"]
    for name in ("E_mean", "E_peak", "E_res"):
        expected = np.array([row[name] for row in rows])
        error = np.abs(info[f"energy/{name}"] / expected - 1)
        print(f"{name}: largest deviation {error.max():.1e}")
        assert error.max() <= 0.01


@pytest.mark.parametrize("duration", [0.025, 0.05, 0.5])
@pytest.mark.parametrize("kind", ["uniform", "bang-bang", "always"])
def test_guided_arrives_whatever_the_actions(kind, duration):
    batch = begun(duration=duration)
    noise = np.random.default_rng(1)
    for _ in range(batch.task.steps):
        action = noise.uniform(-1, 1, (8, 3)) if kind != "always" else np.ones((8, 3))
        batch.step(np.sign(action) if kind == "bang-bang" else action)
    q, v, a = batch.scene.ref.swapaxes(0, 1)
    np.testing.assert_allclose(q, batch.scene.goal[:, :3], rtol=0, atol=1e-9)
    np.testing.assert_allclose(v, 0, atol=1e-9)
    np.testing.assert_allclose(a, 0, atol=1e-8)


def test_guided_jerk_adds_to_the_way():
    """One push of a period: the acceleration it adds, and none of it at the end."""
    pushed, calm = begun(1), begun(1)
    action = np.array([[0.5, 0.0, -1.0]])
    pushed.step(action), calm.step(0 * action)
    more = pushed.scene.ref[0] - calm.scene.ref[0]
    jerk = 400.0 * action[0]
    np.testing.assert_allclose(more, [jerk * DT**3 / 6, jerk * DT**2 / 2, jerk * DT], rtol=1e-9)


# -------------------------------------------------------------------- acceleration


@settings(max_examples=30, deadline=None)
@given(
    where=arrays(float, (1, 3), elements=st.floats(0, 1)),
    pushes=arrays(float, st.tuples(st.integers(1, 6), st.just(3)), elements=st.floats(-1, 1)),
    hold=st.integers(1, 120),
)
def test_acceleration_never_breaks_a_limit(where, pushes, hold):
    """Joint, speed and acceleration limits of the reference, for any sequence of actions."""
    s = at_rest(Q_MIN + where * (Q_MAX - Q_MIN))
    control, fine = Acceleration(), np.linspace(0, DT, 6)[1:, None]
    for push in np.repeat(pushes, hold, axis=0):
        q, v, a = s.ref[0]
        control.advance(s, push[None], PUMA_560, DT, np.zeros(1))
        jerk = (s.ref[0, 2] - a) / DT
        path = q + fine * (v + fine * (a / 2 + fine * jerk / 6))
        rate = v + fine * (a + fine * jerk / 2)
        np.testing.assert_allclose([path[-1], rate[-1]], s.ref[0, :2], atol=1e-12)
        assert (path >= Q_MIN - 1e-9).all() and (path <= Q_MAX + 1e-9).all()
        assert (np.abs(rate) <= V_MAX + 1e-9).all()
        assert (np.abs(s.ref[0, 2]) <= A_MAX + 1e-9).all()


def test_acceleration_is_what_was_asked():
    """Far from every limit: constant from the end of the first period, where it ramps up."""
    s = at_rest(np.zeros((1, 3)))
    control, action = Acceleration(a_max=(2.0, 2.0, 2.0)), np.array([[0.5, -0.5, 0.25]])
    for k in range(20):
        control.advance(s, action, PUMA_560, DT, np.zeros(1))
        np.testing.assert_allclose(s.ref[0, 2], 2.0 * action[0], rtol=1e-9)
        np.testing.assert_allclose(s.ref[0, 1], 2.0 * action[0] * (k + 0.5) * DT, rtol=1e-9)


def test_acceleration_uses_the_whole_range():
    """Full speed ahead ends at the limit, at rest, without ringing."""
    s = at_rest(np.zeros((1, 3)))
    fastest = np.zeros(3)
    for _ in range(400):
        Acceleration().advance(s, np.ones((1, 3)), PUMA_560, DT, np.zeros(1))
        fastest = np.maximum(fastest, s.ref[0, 1])
    np.testing.assert_allclose(fastest, V_MAX, rtol=1e-9)
    np.testing.assert_allclose(s.ref[0, 0], Q_MAX, atol=np.deg2rad(0.15))
    np.testing.assert_allclose(s.ref[0, 1:], 0, atol=1e-3)


# ---------------------------------------------------------------- target, torque, gains


def test_target_moves_no_faster_than_told():
    s = at_rest(np.array([[0.0, Q_MAX[1] - 1e-3, 0.0]]))
    Target(speed=0.5).advance(s, np.array([[1.0, 1.0, -0.5]]), PUMA_560, DT, np.zeros(1))
    step = 0.5 * V_MAX * DT
    np.testing.assert_allclose(s.ref[0, 0], [step[0], Q_MAX[1], -step[2] / 2], rtol=1e-12)
    np.testing.assert_allclose(s.ref[0, 1, [0, 2]], [0.5 * V_MAX[0], -0.25 * V_MAX[2]])


def test_torque_reaches_the_motors():
    """A fraction of their limits, held over the period and cut off there; joints damped."""
    most, action = PUMA_560.column("tau_max"), np.array([[1.0, -0.5, 0.0]])
    for fraction, damping in ((0.5, (0.0,) * 3), (0.1, PPED_GAINS.kd), (3.0, (0.0,) * 3)):
        control = {"kind": "torque", "fraction": fraction, "damping": list(damping)}
        batch = begun(1, control=control)
        batch.step(action)
        s = batch.scene
        np.testing.assert_allclose(s.tau, fraction * most * action, rtol=1e-12)
        expected = np.clip(s.tau - np.asarray(damping) * s.v, -most, most)
        torque = batch.sim.evaluate(s.tau)[0]
        np.testing.assert_allclose(torque, expected, rtol=1e-9, atol=1e-9)


def test_gains_span_their_ranges():
    control = Gains(kp=(10.0, 1000.0), kd=(1.0, 100.0))
    assert control.width(PUMA_560) == 6
    action = np.array([[-1.0, 0.0, 1.0, 1.0, 0.0, -1.0]])
    kp, kd = control.gains(action)
    np.testing.assert_allclose(kp, [[10, 100, 1000]])
    np.testing.assert_allclose(kd, [[100, 10, 1]])
    batch = begun(1, control=control)
    batch.step(action)
    s = batch.scene
    torque, _ = batch.sim.evaluate(s.tau)
    expected = kp * (s.ref[:, 0] - s.q) + kd * (s.ref[:, 1] - s.v)
    np.testing.assert_allclose(torque, expected, rtol=1e-6, atol=1e-6)


# ------------------------------------------------------------------------ what is refused


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: get_control("magic"), "control must be one of guided, acceleration"),
        (lambda: Guided(jerk=0.0), "Guided.jerk must be > 0"),
        (lambda: Target(speed=-1.0), "Target.speed must be > 0"),
        (lambda: JointVelocity(speed=0.0), "JointVelocity.speed must be > 0"),
        (lambda: ToolVelocity(speed=0.0), "ToolVelocity.speed must be > 0"),
        (lambda: Torque(fraction=float("nan")), "Torque.fraction must be > 0"),
        (lambda: Gains(kp=(5.0, 5.0)), "Gains.kp must be 0 < low < high"),
        (lambda: build_task("rest_to_rest", control={"kind": "guided", "jolt": 1.0}), "jolt"),
        (lambda: begun(control={"kind": "torque", "damping": [1.0, 2.0]}), "3 joints, got 2"),
        (lambda: begun(control={"kind": "acceleration", "a_max": [1.0, 2.0]}), "a_max"),
        (lambda: begun(control={"kind": "acceleration", "a_max": [0.0, 1.0, 1.0]}), "a_max"),
        *(
            (lambda k=kind: begun(control=k, system=PRESCRIBED), "drive motor, got prescribed")
            for kind in ("torque", "pd_gains", "pd_target")
        ),
    ],
)
def test_bad_settings_are_refused(make, said):
    with pytest.raises(ParameterError, match=said):
        make()


@pytest.mark.parametrize(
    # the acceleration runs linearly through a period, the guiding quintic's nearly so
    ("settings", "off"),
    [({"system": PRESCRIBED}, 1e-3), ({}, np.deg2rad(1))],
)
def test_joints_follow_the_reference(settings, off):
    batch = begun(4, saving=None, **settings)
    for _ in range(batch.task.steps):
        *_, info = batch.step(np.zeros((4, 3)))
    np.testing.assert_allclose(batch.scene.q, batch.scene.ref[:, 0], atol=off)
    assert info["success"].all()


# ------------------------------------------------------------------------ velocities


@pytest.mark.parametrize("control", [JointVelocity(), ToolVelocity()], ids=lambda c: c.kind)
def test_velocity_controls_keep_every_limit(control):
    """Angles, rates and accelerations of the reference, for random actions."""
    rng = np.random.default_rng(0)
    s = at_rest(rng.uniform(Q_MIN + 0.2, Q_MAX - 0.2, (40, 3)))
    for _ in range(400):
        action = rng.uniform(-1, 1, (40, 3)) if _ % 40 else np.sign(rng.uniform(-1, 1, (40, 3)))
        control.advance(s, action, PUMA_560, DT, np.full(40, 9.0))
        q, v, a = s.ref.swapaxes(0, 1)
        assert (q >= Q_MIN - 1e-9).all() and (q <= Q_MAX + 1e-9).all()
        assert (np.abs(v) <= V_MAX + 1e-9).all() and (np.abs(a) <= A_MAX * (1 + 1e-9)).all()


def test_joint_velocity_is_what_the_action_says():
    s = at_rest(np.zeros((1, 3)))
    action = np.array([[0.2, -0.1, 0.3]])
    for _ in range(60):
        JointVelocity(speed=0.5).advance(s, action, PUMA_560, DT, np.full(1, 9.0))
    np.testing.assert_allclose(s.ref[:, 1], 0.5 * action * V_MAX, rtol=1e-9)


def test_tool_velocity_moves_the_tool_that_way():
    """By differences of the forward kinematics; 1 % for the damping of the least squares."""
    s = at_rest(np.deg2rad([[20.0, 30.0, -80.0]]))
    control = ToolVelocity(speed=0.2, damping=0.01)
    action = np.array([[0.6, -0.3, 0.5]])
    for _ in range(30):
        before = joint_positions(PUMA_560, s.ref[:, 0])[:, -1]
        control.advance(s, action, PUMA_560, DT, np.full(1, 9.0))
    after = joint_positions(PUMA_560, s.ref[:, 0])[:, -1]
    np.testing.assert_allclose((after - before) / DT, 0.2 * action, rtol=2e-2)
