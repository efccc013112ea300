"""Stability known before the run: against closed forms, and against what then happens."""

import dataclasses
import warnings

import numpy as np
import pytest
import scipy.linalg

from ves_gym._util.params import ParameterError
from ves_gym.effects import LABORATORY_ERRORS
from ves_gym.hardware.force_sensor import ForceSensor
from ves_gym.hardware.leg_servo import FILTERED, leg_clock
from ves_gym.hardware.platform import PoseServo
from ves_gym.mechanics.arm_library import PUMA_560
from ves_gym.mechanics.dynamics import inertia
from ves_gym.mechanics.link import diagonal
from ves_gym.mechanics.vehicle import (
    BENT_THESIS,
    DECOUPLED,
    FREE_FLOATING,
    MatrixVehicle,
)
from ves_gym.simulation.loop_linearisation import EmulationWarning
from ves_gym.simulation.simulator import Simulator
from ves_gym.simulation.stability import check_emulation, largest_stable, linearise
from ves_gym.system.emulator_settings import EmulatorSettings
from ves_gym.system.system import System

# three translations of a tonne each, rotations that hardly move: three modes of one axis
AXES = MatrixVehicle(
    M=diagonal(1e3, 1e3, 1e3, 1e7, 1e7, 1e7),
    D=diagonal(100, 200, 300, 1e7, 1e7, 1e7),
    K=diagonal(2e3, 6e3, 2e4, 1e9, 1e9, 1e9),
)


def plain(vehicle=BENT_THESIS, bandwidth=8.0, *, dt=12.5e-3, cutoff=20.0, **options):
    """The loop of the thesis: no payload compensation."""
    return System(
        mode="emulated",
        vehicle=vehicle,
        control_dt=dt,
        physics_dt=dt / 10,
        emulator=EmulatorSettings(
            payload_compensation=False,
            platform=PoseServo(bandwidth=bandwidth),
            sensor=ForceSensor(cutoff=cutoff),
        ),
        **options,
    )


def radius_of(system, q=0.0):
    return linearise(system, q).spectral_radius


def slow_modes(system):
    """The three translations' modes, slowest first."""
    check = check_emulation(system, search=False)
    assert check.stable
    return check.modes[:3]


# --------------------------------------------------------------------- closed forms


def test_the_loops_lag_damps_slow_modes_by_the_closed_form():
    """The arm's inertia m_a felt a time L late takes m_a w^2 L y' from a mode of mass M:
    added damping ratio m_a / (M + m_a) w L / 2, with L = `EmulatorSettings.lag`.

    Joints prescribed. Tolerance: next order in w L, up to 10 % at 0.7 Hz (w L = 0.1).
    """
    system = plain(AXES, drive="prescribed")
    L, ma = system.emulator_settings.lag(system.control_dt), PUMA_560.mass
    total = 1e3 + ma
    for mode, k, d in zip(slow_modes(system), (2e3, 6e3, 2e4), (100, 200, 300), strict=True):
        w = np.sqrt(k / total)
        assert mode.frequency == pytest.approx(w / 2 / np.pi, rel=1e-3)
        assert mode.damping == pytest.approx(d / (2 * total * w), rel=1e-2)
        added = mode.emulated_damping - mode.damping
        assert added == pytest.approx(ma / total * w * L / 2, rel=max(0.05, 2 * w * L))


def test_the_stated_lag_is_the_sum_of_its_parts():
    """sqrt(2) / w of a 20 Hz filter, half a period's hold, and of the platform."""
    dt = 12.5e-3
    usual = np.sqrt(2) / (2 * np.pi * 20) + dt / 2
    slow = EmulatorSettings(platform=PoseServo(rate_feedforward=False))
    assert EmulatorSettings().lag(dt) == pytest.approx(usual)
    assert EmulatorSettings(delay=3).lag(dt) == pytest.approx(usual + 2 * dt)
    assert slow.lag(dt) == pytest.approx(usual + dt / 2 + 1.4 / (16 * np.pi))


def test_compensation_leaves_the_modes_as_they_are():
    """Arm and vehicle integrated together: the poles are the ideal ones at once.

    Tolerance: the trapezoidal rule, (w dt)^2 / 12 = 2e-4 of the fastest of the three.
    """
    system = System(mode="emulated", vehicle=AXES, drive="prescribed")
    for mode in slow_modes(system):
        assert mode.emulated_frequency == pytest.approx(mode.frequency, rel=1e-3)
        assert mode.emulated_damping == pytest.approx(mode.damping, abs=1e-4)


def test_the_payload_ratio_is_the_arm_over_the_vehicle():
    check = check_emulation(plain(AXES), search=False)
    assert check.payload_ratio == pytest.approx(PUMA_560.mass / 1e3, rel=1e-2)
    H = inertia(PUMA_560, np.array([0.1, 0.5, -0.3]))[:6, :6]
    want = scipy.linalg.eigvals(np.linalg.solve(BENT_THESIS.base_model().M, H)).real.max()
    got = check_emulation(
        System(vehicle=BENT_THESIS, mode="emulated"), [0.1, 0.5, -0.3], search=False
    )
    assert got.payload_ratio == pytest.approx(want, rel=1e-9)


# --------------------------------------------------------------- the thesis's limit


def growth(system, periods):
    """Amplitude of a tiny disturbance over a run of an actual simulation.

    It stays far below the safety limits and the engine's own rounding is 1e-12 m.
    """
    sim = Simulator(system, warn_at=None)
    sim.reset(yd=[1e-6, -1e-6, 1e-6, 1e-6, 1e-6, -1e-6])
    start = np.zeros((1, 3))
    sizes = []
    for _ in range(periods):
        state = sim.step(sim.servo_command(start, start))
        sizes.append(np.linalg.norm(np.r_[state.y[0], state.yd[0]]))
    assert sim.events == []
    return np.array(sizes)


def test_the_plain_loop_on_the_bent_beam_loses_stability_near_eight_hertz():
    """DESIGN, from an independent linear study: stable to about 8 Hz, unstable at 10.

    The limit found is then tried out: simulations at 0.8 and 1.25 times it.
    """
    limit = largest_stable(plain())
    assert 6 < limit < 10
    assert radius_of(plain(bandwidth=0.98 * limit)) <= 1 + 1e-4
    assert radius_of(plain(bandwidth=1.02 * limit)) > 1 + 1e-4
    calm = growth(plain(bandwidth=0.8 * limit), 480)
    assert calm[-40:].max() < calm[:40].max()
    fast = plain(bandwidth=1.25 * limit)
    wild, radius = growth(fast, 280), radius_of(fast)
    assert wild[-1] > 20 * wild[:40].max()
    # it grows at the predicted rate; tolerance: what other modes add
    rate = np.log(wild[-40:].max() / wild[-160:-120].max()) / 120
    assert rate == pytest.approx(np.log(radius), rel=0.1)


def test_a_free_base_counts_as_stable_and_a_swinging_one_does():
    """A satellite neither grows nor decays: a double eigenvalue 1."""
    for system in (
        System(mode="emulated", vehicle=FREE_FLOATING),
        plain(FREE_FLOATING, 2.0),
        System(mode="emulated", vehicle=DECOUPLED),
    ):
        check = check_emulation(system, search=False)
        assert check.stable
        assert check.spectral_radius == pytest.approx(1, abs=1e-2)
        assert check.growth < 1e-2


# ------------------------------------------------------------------------- reports


def test_the_check_reports_what_was_found():
    check = check_emulation(plain(bandwidth=4.0))
    assert check.stable and check.growth < 0
    assert check.growth == pytest.approx(np.log(check.spectral_radius) / 12.5e-3)
    assert 6 < check.max_bandwidth < 10
    assert check.max_gain is None
    assert check.lag == pytest.approx(EmulatorSettings().lag(12.5e-3))
    frequencies = [mode.frequency for mode in check.modes]
    assert len(frequencies) >= 6 and frequencies == sorted(frequencies)
    unstable = check_emulation(plain(bandwidth=12.0), search=False)
    assert not unstable.stable and unstable.growth > 0 and unstable.max_bandwidth is None
    assert check.to_dict()["modes"][0]["frequency"] == frequencies[0]


@pytest.mark.slow
def test_legs_are_judged_by_their_gain():
    """The loop with leg servos: the gain at which it is lost lies between stable and not."""
    control, physics = leg_clock(FILTERED)
    system = System(
        mode="emulated",
        vehicle=DECOUPLED,
        control_dt=control,
        physics_dt=physics,
        drive="prescribed",
        emulator=EmulatorSettings(platform=FILTERED, payload_compensation=False),
    )

    def scaled(factor):
        lab = dataclasses.replace(system.emulator_settings, platform=FILTERED.scaled(factor))
        return system.replace(emulator=lab)

    check = check_emulation(system)
    gain = check.max_gain
    assert gain > 1 and check.max_bandwidth is None
    assert radius_of(scaled(0.95 * gain)) <= 1 + 1e-4 < radius_of(scaled(1.05 * gain))


def test_noise_and_quantisation_do_not_disturb_the_judgement():
    """The loop with them is linearised without; the map is bitwise that of a clean one."""
    clean = plain(bandwidth=4.0)
    sensor = ForceSensor(force_resolution=5.0, moment_resolution=5.0)
    lab = dataclasses.replace(clean.emulator_settings, sensor=sensor)
    tight = dataclasses.replace(clean.emulator_settings, force_max=1.0)  # nor safety limits
    changes = {"effects": LABORATORY_ERRORS}, {"emulator": lab}, {"emulator": tight}
    for change in changes:
        np.testing.assert_array_equal(linearise(clean.replace(**change)).A, linearise(clean).A)


# ------------------------------------------------------------------------ warnings


def test_an_unstable_emulation_is_a_warning_and_a_stable_one_is_not():
    unstable = plain(bandwidth=12.0)
    for _ in range(2):  # the second from memory
        with pytest.warns(EmulationWarning, match="unstable"):
            Simulator(unstable)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Simulator(unstable, warn_at=None)
        Simulator(plain(bandwidth=4.0))
        Simulator(System(vehicle=BENT_THESIS, mode="emulated"))
        position = dataclasses.replace(unstable.emulator_settings, operation="position")
        Simulator(unstable.replace(emulator=position))
        Simulator(System(vehicle=BENT_THESIS))


def test_the_place_where_it_is_judged_counts():
    """On the edge: at 7.62 Hz stable with the elbow folded, unstable with the arm up."""
    folded, up = [0.0, 1.0, -2.0], [0.0, np.pi / 2, 0.0]
    edge = plain(bandwidth=7.62)
    assert radius_of(edge, folded) <= 1 + 1e-4 < radius_of(edge, up)
    with pytest.warns(EmulationWarning):
        Simulator(edge, warn_at=up)
    Simulator(edge, warn_at=folded)


def test_what_has_no_loop_is_refused():
    position = plain().replace(emulator=EmulatorSettings(operation="position"))
    for system, q, message in (
        (System(vehicle=BENT_THESIS), 0.0, "mode ideal has no emulator"),
        (position, 0.0, "operation position has no loop"),
        (plain(), [0.0, 0.0], r"q must have shape \(3,\)"),
        (plain(), np.nan, "q must be finite"),
    ):
        with pytest.raises(ParameterError, match=message):
            check_emulation(system, q)
