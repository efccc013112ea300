"""Disturbance measures against MuJoCo's sensors, scipy's linear simulation, closed forms."""

import dataclasses
import math

import mujoco
import numpy as np
import pytest
import scipy.signal

from ves_gym._util.params import ParameterError
from ves_gym.engine.backends.mujoco import model_spec
from ves_gym.engine.mjcf import TO_Y
from ves_gym.mechanics.arm_library import PUMA_560
from ves_gym.mechanics.link import Mount
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.vehicle import BENT_THESIS, get_vehicle
from ves_gym.simulation.playback import play_motions
from ves_gym.system.disturbance import (
    mount_acceleration,
    mount_displacement,
    mount_of,
    tool_error,
)
from ves_gym.system.frequency_weight import FAST, FrequencyWeight
from ves_gym.system.system import System

MOUNT = Mount(position=(0.3, -0.2, 0.5), angles=(0.0, 0.0, 0.0))
ARM = dataclasses.replace(PUMA_560, mount=MOUNT)
MOTION = Motion.straight([-0.7, -0.3, 0.2], [1.0, 0.7, -0.5], 1.0)


TAIL = 0.8  # s


@pytest.fixture(scope="module", params=["beside", "bent"])
def runs(request):
    """One motion of 1 s, watched and recorded every 12.5 ms, and every step."""
    if request.param == "beside":
        system = System(vehicle=BENT_THESIS, arm=ARM)
    else:
        system = System(vehicle=get_vehicle(request.param))
    return [
        play_motions(
            system, [MOTION], settle=TAIL, record_dt=dt, watch=dt > 2e-3, backend="mujoco"
        )
        for dt in (12.5e-3, 1.25e-3)
    ]


def test_acceleration_and_tool_are_those_of_mujocos_sensors(runs):
    """Sensors of MuJoCo's frames, its model run directly from the recorded states.

    An accelerometer there is in the site's axes; tolerance of two engines' rounding.
    """
    run = runs[0]
    system, m = run.system, run.system.base.m
    model = sensed(system)
    data, order = mujoco.MjData(model), np.r_[TO_Y, 6 : 9 + m]
    linear, angular = (
        part[0] for part in mount_acceleration(system.arm, run.y, run.yd, run.ydd)
    )
    moved = tool_error(system.arm, run.q, run.q, run.y)[0]
    for k in range(0, 96, 5):
        internal = [np.zeros(0)] * 2 if run.u is None else [run.u[0, k], run.ud[0, k]]
        data.qpos[order] = np.r_[run.y[0, k], run.q[0, k], internal[0]]
        data.qvel[order] = np.r_[run.yd[0, k], run.v[0, k], internal[1]]
        data.act[:] = run.tau[0, k]
        mujoco.mj_forward(model, data)
        felt = data.sensor("acceleration").data, data.sensor("angular").data
        turn = data.body("platform").xmat.reshape(3, 3)
        tool = data.site("tool").xpos.copy()
        np.testing.assert_allclose(linear[k], turn @ felt[0], atol=1e-9)
        np.testing.assert_allclose(turn @ angular[k], felt[1], atol=1e-9)
        data.qpos[order[:6]] = 0.0
        mujoco.mj_kinematics(model, data)
        np.testing.assert_allclose(moved[k], tool - data.site("tool").xpos, atol=1e-12)


def sensed(system):
    """The compiled model with an accelerometer and an angular one at the arm's mount."""
    spec = model_spec(system)
    platform = spec.body("platform")
    platform.add_site(name="at_mount", pos=mount_of(system.arm).tolist())
    for name, kind in (
        ("acceleration", mujoco.mjtSensor.mjSENS_ACCELEROMETER),
        ("angular", mujoco.mjtSensor.mjSENS_FRAMEANGACC),
    ):
        spec.add_sensor(
            name=name, type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname="at_mount"
        )
    return spec.compile()


def test_measures_are_the_largest_and_mean_of_what_was_recorded(runs):
    """Against the arrays of every physics step as they are.

    Tolerance of records every 12.5 ms: mean accelerations 2.5 %, for fast internal modes; else
    1 %. Peaks are watched at every step.
    """
    coarse, fine = runs
    a, angular = mount_acceleration(fine.system.arm, fine.y[0], fine.yd[0], fine.ydd[0])
    moved, turned = mount_displacement(fine.system.arm, fine.y[0])
    missed = np.linalg.norm(
        tool_error(fine.system.arm, fine.q[0], fine.q_cmd[0], fine.y[0]), axis=1
    )
    end = np.searchsorted(fine.t, 1.0)

    def rms(x):
        return math.sqrt(np.trapezoid((x**2).sum(axis=-1), fine.t) / fine.t[-1])

    def most(x):
        return np.linalg.norm(x, axis=-1).max()

    expected = {
        "acceleration": rms(a),
        "acceleration_peak": most(a),
        "angular": rms(angular),
        "angular_peak": most(angular),
        "tip": rms(missed[:, None]),
        "tip_peak": missed.max(),
        "tip_end": missed[end],
        "displacement_peak": most(moved),
        "rotation_peak": turned.max(),
        "attitude_end": turned[end],
    }
    near, exact = (k.disturbance(0, tail=TAIL) for k in (coarse, fine))
    for name, value in expected.items():
        most_off = 0.025 if name in ("acceleration", "angular") else 0.01
        assert getattr(near, name) == pytest.approx(value, rel=most_off), name
        assert getattr(exact, name) == pytest.approx(value, rel=1e-9), name


# -------------------------------------------------------------------- the weight


@pytest.mark.parametrize(
    "weight",
    [FAST, FrequencyWeight.parse("0.2:0.1,1:1,8:0.3")],
    ids=str,
)
def test_the_weight_is_scipys_linear_simulation_of_its_transfer_function(weight):
    """`lsim` of H as a ratio of polynomials, in and out of position and rate."""
    t = np.linspace(0, 6, 1201)
    z = 0.02 * np.sin(2 * np.pi * 0.5 * t) + 0.01 * np.sin(2 * np.pi * 4 * t)
    zd = 2 * np.pi * (0.01 * np.cos(2 * np.pi * 0.5 * t) + 0.04 * np.cos(2 * np.pi * 4 * t))
    top, bottom = np.array([weight.gains[-1]]), np.array([1.0])
    for w, step in zip(weight.rates, weight.steps, strict=True):
        top = np.polyadd(np.polymul(top, [1, w]), step * w * bottom)
        bottom = np.polymul(bottom, [1, w])
    top = np.trim_zeros(np.where(np.abs(top) < 1e-12 * np.abs(top).max(), 0.0, top), "f")
    value, rate = weight.apply(t[1], z[:, None], zd[:, None])
    tight = {"rtol": 0, "atol": 2e-4}  # of 0.03 m; of 0.3 m/s, linear between samples
    np.testing.assert_allclose(value[:, 0], scipy.signal.lsim((top, bottom), z, t)[1], **tight)
    np.testing.assert_allclose(
        rate[:, 0], scipy.signal.lsim((top, bottom), zd, t)[1], rtol=0, atol=3e-3
    )
    gain = abs(np.polyval(top, 2j * np.pi * 3) / np.polyval(bottom, 2j * np.pi * 3))
    assert abs(weight.response(3.0)) == pytest.approx(gain, rel=1e-12)


def test_weighted_energy_of_the_whole_spectrum_is_the_energy(runs):
    run = runs[0]

    def weighted(weight):
        return run.disturbance(0, tail=TAIL, weight=weight).E_weighted

    mean = run.energies(tail=TAIL)[0].E_mean
    assert weighted(FrequencyWeight(corners=(), gains=(1.0,))) == pytest.approx(mean, rel=1e-9)
    assert 0 < weighted(FAST) < mean
    half = FrequencyWeight(corners=(), gains=(0.5,))
    assert weighted(half) == pytest.approx(mean / 4, rel=1e-2)  # rates and attitude: small


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("1", "HZ:GAIN"),
        ("1:2:3", "HZ:GAIN"),
        ("2:1,1:1", "ascend"),
        ("0:1,1:1", "> 0 Hz"),
        ("1:-1,2:1", ">= 0"),
        ("1:0,2:0", "not all zero"),
    ],
)
def test_a_weight_that_is_none_is_refused(text, why):
    with pytest.raises(ParameterError, match=why):
        FrequencyWeight.parse(text)


def test_pairs_are_gains_with_corners_between():
    weight = FrequencyWeight.parse("0.5:0,2:1")
    assert weight.corners == pytest.approx((1.0,)) and weight.gains == (0.0, 1.0)
    assert str(weight) == "0, 1 above 1 Hz"


# --------------------------------------------------------------------- the rest


def test_a_run_that_is_too_short_is_refused(runs):
    with pytest.raises(ParameterError, match=r"\(11 s\)"):
        runs[0].disturbance(0)
