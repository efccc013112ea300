"""The independent generator: its stated machines, its energy, its sizes, its files."""

import json
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from benchmarks.independent_trial import (
    arm,
    base,
    cases,
    catalogue,
    compare,
    machine,
    measurement,
    write,
)
from benchmarks.independent_trial.machine import PERIOD, Plant
from benchmarks.independent_trial.motions import Motion, chirp, moves, multisine

EXAMPLE = json.loads(Path(__file__).with_name("independent_trial_example.json").read_text())
QUICK = ["Coulomb friction", "gear ripple", "measurement delay", "sensor drift", "hose drag"]


@pytest.mark.parametrize("system", cases.SPACE + cases.LAB)
def test_a_stated_machine_moves_as_the_packages_example(system):
    """Within 0.05 noise levels, and the wrench within 0.1, at a row of its noise-free run."""
    command, row = EXAMPLE[f"command_{system[:4]}"], EXAMPLE[system]
    q, v = (np.array(command[k]) for k in "qv")
    t = np.arange(len(q)) * PERIOD
    run = compare.replay(system, t, q, v, duration=np.inf)
    for name, x in run.sampled().items():
        std = measurement.sigma(name, x.shape[1], q.shape[1])
        levels = np.abs(x[row["row"]] - row[name]) / std
        assert levels.max() < (0.1 if name in ("w", "wg") else 0.05), name


def still(q: np.ndarray, end: float) -> Motion:
    t = np.array([0.0, end])
    return Motion.through(t, np.stack([q, q]), np.zeros((2, len(q))), np.zeros((2, len(q))))


@pytest.mark.parametrize("system", cases.SPACE)
def test_energy_stays_in_an_undamped_machine(system, monkeypatch):
    """Base and servo springs, no damping: kinetic and strain energy stay to 1e-5.

    At a quarter of the step: at the whole one Runge-Kutta itself damps modes of 700 rad/s.
    """
    monkeypatch.setattr(machine, "STEPS", 40)
    monkeypatch.setattr(machine, "H", PERIOD / 40)
    m = cases.stated(system)
    m.base.D, m.kd = 0 * m.base.D, 0 * m.kd
    plant, n = Plant(m, m, []), m.arm.n
    q0 = 0.4 * np.cos(np.arange(n))
    push = np.array([0.02, -0.01, 0.005, 0.01, 0.02, -0.01])
    run = plant.run(still(q0, 1.0), 40, dY=push)
    Y, q = ca.SX.sym("Y", 6), ca.SX.sym("q", n)
    E = ca.diagcat(arm.twist_map(Y), ca.SX.eye(n))
    H = ca.Function("H", [Y, q], [E.T @ arm.inertia(m.arm, arm.pose(m.arm, q)) @ E])

    def energy(k):
        rate, pose = np.r_[run.yd[k], run.ud[k]], np.r_[run.y[k], run.u[k]]
        moving, e = np.r_[run.yd[k], run.v[k]], run.q[k] - q0
        kinetic = moving @ np.array(H(run.y[k], run.q[k])) @ moving + rate @ m.base.M @ rate
        return 0.5 * (kinetic + pose @ m.base.K @ pose + e @ (m.kp * e))

    levels = [energy(k) for k in range(0, len(run.y), 100)]
    assert np.ptp(levels) < 1e-5 * levels[0]


def test_the_beam_has_the_published_stiffness():
    """Thesis Appendix A.4 without its misprints, 8 + 8 m tube of 180 mm."""
    K = base.flange_stiffness(cases.description("puma_bent_ideal")["vehicle"])
    expected = [15027, 4432, 15027, 230084, 448904, 68012]
    np.testing.assert_allclose(np.diag(K), expected, rtol=1e-4)


def test_a_cantilever_has_its_textbook_frequency():
    """First bending mode of a bare clamped tube: 3.51602 sqrt(EI / rho A) / L^2."""
    table = cases.description("iiwa14_straight_ideal")["vehicle"]
    K, M = base.assemble(table)
    area, I, _ = base.tube(0.07, 0.006)
    first = 3.51602 * np.sqrt(72e9 * I / (2800 * area)) / 12.0**2
    w2 = np.linalg.eigvals(np.linalg.solve(M, K)).real
    assert np.sqrt(w2.min()) == pytest.approx(first, rel=1e-4)


slow = [n for n in catalogue.LIBRARY | catalogue.OUTSIDE if n not in QUICK]


@pytest.mark.parametrize(
    "name", [*QUICK, *(pytest.param(n, marks=pytest.mark.slow) for n in slow)]
)
def test_an_effect_moves_the_log_by_its_multiple(name):
    second = len(name) % 2 == 1
    place = (catalogue.LIBRARY | catalogue.OUTSIDE)[name][1][0]
    known = cases.stated({"space": cases.SPACE[0], "lab": cases.LAB[0]}[place])
    rng = np.random.default_rng(3)
    effect = catalogue.make(name, rng, known, second)
    path, rows = multisine(rng, known.arm.limits, 6.0), 500
    without = Plant(known, known, []).run(path, rows).sampled()
    plant = Plant(known, known, [effect])
    size = cases.sized(plant, path, without, 10.0, 1)
    there = cases.rows_without_noise(plant, path, rows, [size], 1)
    near = 0.15 if name == "packet loss" else 0.05  # whole rows are lost
    assert max(cases.gap(there, without).values()) == pytest.approx(10.0, rel=near)
    if not effect.gears:  # a gear without compliance is no gear, and stiffer than the step
        hardly = cases.rows_without_noise(plant, path, rows, [size / 1000], 1)
        assert max(cases.gap(hardly, without).values()) < 0.2


def test_noise_is_as_loud_as_stated_and_coloured():
    x = measurement.noise(np.random.default_rng(0), 40_000, np.array([2.0]))[:, 0]
    assert x.std() == pytest.approx(2.0, rel=0.1)
    slow_part = x.reshape(-1, 40).mean(axis=1).std()
    assert slow_part > 3 * 2.0 / np.sqrt(40)  # white noise would average out


def test_a_motion_keeps_its_limits_and_rests_first():
    limits = cases.stated(cases.SPACE[0]).arm.limits
    for shape in (multisine, moves, chirp):
        motion = shape(np.random.default_rng(1), limits, 10.0)
        t = np.arange(0, 10, 0.01)
        q, v, a = motion(np.tile(t[:, None], 3))
        assert np.all(np.abs(v) <= limits["v_max"]) and np.all(np.abs(a) <= limits["a_max"])
        assert np.all(q >= limits["q_min"]) and np.all(q <= limits["q_max"])
        assert np.all(v[t < 2.0] == 0)


def test_a_case_is_the_same_when_written_again(tmp_path, monkeypatch):
    monkeypatch.setattr(cases, "length_of", lambda rng: 400)
    case = cases.Case("null", [], cases.LAB[0], 0.0, 1.0, (1, 2, 3), "first")
    for folder in ("a", "b"):
        write.write(tmp_path / folder, {"first-001": case})
    a, b = (tmp_path / k / "truth" / "hashes.txt" for k in "ab")
    assert a.read_text() == b.read_text()
    names = {line.split("  ")[1] for line in a.read_text().splitlines()}
    assert {"cases/first-001/held_back.csv", "truth/first-001.json"} <= names


def test_the_plan_has_every_effect_and_tells_nothing_by_its_order():
    plan = cases.plan("first", 1)
    assert {n for c in plan for n in c.names} >= set(catalogue.LIBRARY | catalogue.OUTSIDE)
    assert plan != cases.plan("second", 1) and plan == cases.plan("first", 1)
    assert [c.kind for c in plan] != sorted(c.kind for c in plan)


def test_nothing_of_the_judged_package_is_imported():
    for path in Path(cases.__file__).parent.glob("*.py"):
        assert (
            "import ves_gym" not in path.read_text() and "from ves_gym" not in path.read_text()
        )
