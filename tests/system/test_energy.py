"""Energy measures on made-up runs with known answers, and on logs."""

import dataclasses
import math

import numpy as np
import pytest

from ves_gym._util.params import ParameterError
from ves_gym.mechanics.arm_library import PUMA_560
from ves_gym.mechanics.dynamics import inertia
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.spatial import twist
from ves_gym.mechanics.vehicle import BENT_THESIS, DECOUPLED, FREE_FLOATING
from ves_gym.simulation.playback import play_motions
from ves_gym.system.energy import (
    TAIL,
    base_energy,
    base_rate,
    energies,
    log_energies,
    motion_end,
)
from ves_gym.system.energy_balance import EnergyBalance
from ves_gym.system.runlog import RunLog
from ves_gym.system.system import System

SYSTEM = System(vehicle=DECOUPLED)
K1, D1 = 1500.0, 500.0  # N/m, N s/m along x
M1 = 500.0 + PUMA_560.mass


def made_up(t, x, xd=None):
    """One run along x with the arm at rest: q, y, yd."""
    y, yd = np.zeros((1, len(t), 6)), np.zeros((1, len(t), 6))
    y[0, :, 0] = x
    yd[0, :, 0] = 0.0 if xd is None else xd
    return np.zeros((1, len(t), 3)), y, yd


# ------------------------------------------------------------------------ measures


def test_constant_energy():
    """Strain 1/2 k x^2 + kinetic 1/2 m xd^2, both held: every measure in closed form."""
    t = np.linspace(0, 12, 2401)
    one = energies(SYSTEM, t, *made_up(t, 0.1, 0.2), duration=2.0)[0]
    strain, kinetic = K1 * 0.1**2 / 2, M1 * 0.2**2 / 2
    for name in ("E_mean", "E_res", "E_peak"):
        assert getattr(one, name) == pytest.approx(strain + kinetic, rel=1e-12)
    assert one.E_strain_peak == pytest.approx(strain)
    assert one.E_int == pytest.approx(strain * 12)
    assert one.W_port == pytest.approx(D1 * 0.2**2 * 12)  # stored at both ends alike
    assert one.t_5 == math.inf
    assert one.to_dict()["t_5"] is None
    assert one.to_dict()["E_mean"] == one.E_mean


def test_decaying_energy():
    """E = E0 exp(-2 t / tau). Tolerance: trapezoid rule, (dt / tau)^2 / 3 = 3e-6."""
    tau, x0, dt = 1.6, 0.05, 5e-3
    t = np.arange(0, 12 + dt / 2, dt)
    one = energies(SYSTEM, t, *made_up(t, x0 * np.exp(-t / tau)), duration=2.0)[0]
    E0 = K1 * x0**2 / 2
    assert one.E_peak == one.E_strain_peak == pytest.approx(E0)
    assert one.E_res == pytest.approx(E0 * np.exp(-4 / tau))
    area = E0 * tau / 2 * (1 - np.exp(-24 / tau))
    assert one.E_int == pytest.approx(area, rel=1e-5)
    assert one.E_mean == pytest.approx(area / 12, rel=1e-5)
    settled = -tau / 2 * np.log(0.05)
    assert settled <= one.t_5 <= settled + dt
    assert one.W_port == pytest.approx(-E0, rel=1e-3)  # leaves the vehicle (no rates given)


def test_energy_after_the_tail_does_not_count_in_the_mean():
    t = np.linspace(0, 20, 4001)
    x = np.where(t <= 12.0, 0.1, 0.5)
    one = energies(SYSTEM, t, *made_up(t, x), duration=2.0)[0]
    assert one.E_mean == pytest.approx(K1 * 0.1**2 / 2, rel=1e-12)
    assert one.E_peak == pytest.approx(K1 * 0.5**2 / 2)
    shorter = energies(SYSTEM, t, *made_up(t, x), duration=2.0, tail=3.0)[0]
    assert shorter.E_mean == pytest.approx(K1 * 0.1**2 / 2, rel=1e-12)


def test_each_run_of_a_stack_has_its_own_energies():
    t = np.linspace(0, 12, 241)
    parts = [made_up(t, a * np.cos(t), -a * np.sin(t)) for a in (0.1, 0.2, 0.3)]
    stack = [np.concatenate(p) for p in zip(*parts, strict=True)]
    many = energies(SYSTEM, t, *stack, duration=2.0)
    assert many == [energies(SYSTEM, t, *p, duration=2.0)[0] for p in parts]
    assert many[2].E_mean == pytest.approx(9 * many[0].E_mean)


def test_a_run_shorter_than_motion_and_tail_is_refused():
    t = np.linspace(0, 11.9, 120)
    with pytest.raises(ParameterError, match=r"10 s after it \(12 s\), got a run of 11.9 s"):
        energies(SYSTEM, t, *made_up(t, 0.1), duration=2.0)
    assert energies(SYSTEM, t, *made_up(t, 0.1), duration=2.0, tail=9.9)[0].E_mean > 0


def test_base_energy_takes_the_mass_of_the_arm_where_it_is():
    q, yd = np.array([0.4, -0.3, 0.8]), np.array([0.1, -0.2, 0.3, 0.2, 0.1, -0.1])
    y = np.array([0.01, 0.02, -0.01, 0.03, -0.02, 0.01])
    found = base_energy(SYSTEM, q, y, yd)
    v = twist(y, yd)
    kinetic = 0.5 * yd @ SYSTEM.base.M @ yd + 0.5 * v @ inertia(PUMA_560, q)[:6, :6] @ v
    assert found.kinetic == pytest.approx(kinetic, rel=1e-12)
    assert found.strain == pytest.approx(0.5 * y @ SYSTEM.base.K @ y, rel=1e-12)
    assert found.total == found.strain + found.kinetic
    floating = base_energy(System(vehicle=FREE_FLOATING), q, y, yd)
    assert floating.strain == 0
    body = FREE_FLOATING.body.spatial() + inertia(PUMA_560, q)[:6, :6]
    assert floating.kinetic == pytest.approx(0.5 * v @ body @ v, rel=1e-12)


# ----------------------------------------------------------------------------- logs

DURATION = 1.5


@pytest.fixture(scope="module")
def run():
    motion = Motion.straight([0.3, -0.4, 0.5], [0.9, 0.1, -0.3], DURATION)
    return play_motions(System(vehicle=BENT_THESIS), [motion], settle=TAIL, record_dt=2.5e-3)


@pytest.fixture(scope="module")
def measured(run):
    return energies(run.system, run.t, run.q, run.y, run.yd, duration=DURATION)[0]


def test_a_saved_log_has_the_energies_of_the_recording(run, measured, tmp_path):
    run.log(0, note="a test").save(tmp_path / "run.csv")
    log = RunLog.load(tmp_path / "run.csv")
    assert log_energies(log) == measured
    assert log.meta["note"] == "a test"
    assert log.meta["system"] == run.system.to_dict()
    account = EnergyBalance.of(log)
    assert len(account.residual) == len(run.t)
    assert account.work[0] == account.kinetic[0] == account.residual[0] == 0
    total = account.kinetic + account.strain + account.dissipated + account.residual
    np.testing.assert_allclose(total, account.work, atol=1e-12)
    assert account.relative < 0.01


def test_rates_are_differentiated_where_a_log_has_none(run, measured):
    """Second-order differences at 2.5 ms: 1e-3 of the energies."""
    log = dataclasses.replace(run.log(0), yd=None)
    again = log_energies(log)
    for name in ("E_mean", "E_res", "E_peak", "W_port"):
        assert getattr(again, name) == pytest.approx(getattr(measured, name), rel=2e-3)
    assert again.E_strain_peak == measured.E_strain_peak
    assert base_rate(log).shape == (len(log), 6)
    assert base_rate(run.log(0)) is run.log(0).yd or (base_rate(run.log(0)) == run.yd[0]).all()


def test_the_end_of_the_motion_is_told_or_found(run):
    log = run.log(0)
    assert motion_end(log) == DURATION
    meta = {k: v for k, v in log.meta.items() if k != "duration"}
    found = motion_end(dataclasses.replace(log, meta=meta))
    assert DURATION - 0.02 <= found <= DURATION  # the quintic's end is slow
    still = dataclasses.replace(log, meta=meta, v_cmd=0 * log.v_cmd)
    assert motion_end(still) == 0.0


def test_what_a_log_lacks_is_named(run):
    log = run.log(0)
    with pytest.raises(ParameterError, match="needs the columns tau, yd"):
        EnergyBalance.of(dataclasses.replace(log, tau=None, yd=None))
    bare = dataclasses.replace(log, meta={"format": "ves-run/1"})
    for measure in (log_energies, EnergyBalance.of):
        with pytest.raises(ParameterError, match="needs the entry `system`"):
            measure(bare)
    wrong = dataclasses.replace(log, meta={**log.meta, "system": {"mode": "dream"}})
    with pytest.raises(ParameterError, match=r"log metadata: system\.mode|System\.mode"):
        log_energies(wrong)
