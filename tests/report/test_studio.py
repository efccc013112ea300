"""The studio's own dynamics against Python's and Pinocchio's, and its energies."""

import json

import numpy as np
import pytest

from tests.report.studio_page import open_page, ready
from tests.urdf_arms import six_joint_urdf
from ves_gym._util.params import ParameterError
from ves_gym.cli.main import main
from ves_gym.mechanics.arm_library import get_arm
from ves_gym.mechanics.dynamics import inertia
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.vehicle import get_vehicle
from ves_gym.planners.coupling import band_limited, coupling_matrix, modes
from ves_gym.planners.query import Query
from ves_gym.report.notebook import Studio
from ves_gym.report.studio import machine_data, playable, render_studio, studio_data
from ves_gym.system.system import System


def query(vehicle="bent", arm="puma560", duration=2.0):
    system = System(arm=get_arm(arm), vehicle=get_vehicle(vehicle))
    low, high = system.arm.column("q_min"), system.arm.column("q_max")
    start = np.clip(np.full(system.arm.n, 0.1), low, high)
    goal = np.clip(start + 0.5, low, high)
    return Query(system=system, start=tuple(start), goal=tuple(goal), duration=duration)


@pytest.fixture(scope="module")
def data():
    asked = query()
    return studio_data(asked, [(np.array(asked.start) + asked.goal) / 2 - 0.3])


def evaluate(browser, expression, **values):
    """An expression of the page's functions (`s`) at numbers of Python's."""
    plain = {name: np.asarray(v).tolist() for name, v in values.items()}
    names = ", ".join(plain)
    return browser.do(f"(({{{names}}}, s) => {expression})({json.dumps(plain)}, vesStudio)")


@pytest.mark.parametrize("arm", ["puma560", "ur5e", "canadarm2"])
def test_inverse_dynamics_and_inertia_are_pinocchio_s(browser, data, arm, tmp_path):
    pin = pytest.importorskip("pinocchio")
    model = get_arm(arm).to_pinocchio()
    model.gravity = pin.Motion.Zero()
    rng = np.random.default_rng(3)
    machine = machine_data(playable(query(arm=arm).system))
    open_page(browser, {**data, "machine": machine, **ends(machine)}, tmp_path)
    for _ in range(3):
        q, v, a = rng.uniform(-1, 1, (3, model.nq))
        found = evaluate(
            browser, "s.inverseDynamics(s.data.machine.arm, q, v, a)", q=q, v=v, a=a
        )
        theirs = pin.rnea(model, model.createData(), q, v, a)
        scale = np.abs(theirs).max()
        assert np.abs(found["tau"] - theirs).max() < 1e-9 * scale
        H = evaluate(browser, "[...s.inertiaMatrix(s.data.machine.arm, q)]", q=q)
        ours = inertia(get_arm(arm), q)
        np.testing.assert_allclose(
            np.reshape(H, ours.shape), ours, rtol=0, atol=1e-9 * ours.max()
        )


def ends(machine):
    """A start and a goal of any arm, and no references, which are of another."""
    n = len(machine["arm"]["links"])
    ends = {"start": [0.1] * n, "goal": [0.4] * n, "via": []}
    return {**ends, "references": []}


def test_energies_in_the_page_are_the_simulator_s(browser, data, tmp_path):
    open_page(browser, data, tmp_path)
    ready(browser)
    assert len(data["references"]) >= 4
    worst = 0.0
    for reference in data["references"]:
        run = browser.do(
            f"(({{E_mean, E_peak}}) => ({{E_mean, E_peak}}))(vesStudio.simulateMotion("
            f"vesStudio.data.machine, {json.dumps(reference['motion'])}))"
        )
        for name in ("E_mean", "E_peak"):
            worst = max(worst, abs(run[name] / reference[name] - 1))
    print(f"largest difference {100 * worst:.2f} %")
    assert worst < 0.01
    said = browser.do("document.getElementById('truth').textContent")
    assert float(said.removesuffix(" %")) == pytest.approx(100 * worst, abs=0.011)
    assert browser.do("document.querySelectorAll('#references tr').length") == len(
        data["references"]
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("vehicle", "arm", "duration"),
    [
        ("bent-thesis", "puma560", 1.5), ("straight-vertical", "puma560", 2.0),
        ("straight-horizontal", "puma560", 2.0), ("free-floating", "puma560", 2.0),
        ("bent", "ur5e", 3.0), ("bent", "iiwa14", 2.0),
        ("bent", "puma560", 1.0), ("bent", "puma560", 4.0),
    ],
)  # fmt: skip
def test_energies_of_other_machines_are_the_simulator_s(
    browser, tmp_path, vehicle, arm, duration
):
    data = studio_data(query(vehicle, arm, duration))
    open_page(browser, data, tmp_path)
    ready(browser)
    assert len(data["references"]) >= 4
    said = browser.do("document.getElementById('truth').textContent")
    print(f"{arm} on {vehicle}, {duration:g} s: {said} of {len(data['references'])} motions")
    assert float(said.removesuffix(" %")) < 1.0


def test_paths_maps_and_modes_are_python_s(browser, data, tmp_path):
    open_page(browser, data, tmp_path)
    asked = query()
    system, rng = asked.system, np.random.default_rng(0)
    points = np.vstack([asked.start, rng.uniform(-0.5, 0.5, (3, 3)), asked.goal])
    for way in (points, points[:3], points[:2]):
        control = evaluate(browser, "s.motionThrough(way, 2).control", way=way)
        ours = np.array(Motion.through(way, 2.0).control)
        np.testing.assert_allclose(control, ours, rtol=0, atol=1e-9)
    q = points[1]
    omega = evaluate(browser, "s.baseModes(s.data.machine, q).omega", q=q)
    np.testing.assert_allclose(omega, modes(system, q).omega, rtol=1e-7)
    raw, banded = evaluate(
        browser,
        "[null, 2].map((T) => s.couplingBlock(s.couplingCell(s.data.machine, q, [0, 2]), T))",
        q=q,
    )
    for block, Q in ((raw, coupling_matrix(system, q)), (banded, band_limited(system, q, 2.0))):
        expected = [Q[0, 0], Q[0, 2], Q[2, 2]]
        np.testing.assert_allclose(block, expected, rtol=1e-6, atol=1e-9 * Q.max())


def test_a_dragged_point_moves_energies_and_asks_no_one(browser, data, tmp_path):
    address = open_page(browser, data, tmp_path)
    before = [browser.do(f"document.getElementById('{k}-mean').textContent") for k in KINDS]
    drag(browser, "[data-point='1']", 60, 40)
    after = [browser.do(f"document.getElementById('{k}-mean').textContent") for k in KINDS]
    assert after[0] == before[0] and after[1] != before[1]
    drag(browser, "[data-point='2']", -30, 30)
    assert browser.do("document.getElementById('straight-mean').textContent") != before[0]
    assert browser.errors == []
    assert browser.requests == [address]


KINDS = ("straight", "drawn")


def drag(browser, selector, right, down):
    mouse, element = browser.page.mouse, browser.page.locator(selector).first
    element.scroll_into_view_if_needed()
    box = element.bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    mouse.move(x, y)
    mouse.down()
    mouse.move(x + right, y + down)
    mouse.up()
    browser.do("new Promise((go) => requestAnimationFrame(() => requestAnimationFrame(go)))")


def test_the_page_opens_with_a_path_that_is_far_calmer(browser, tmp_path, capsys):
    """A tenth of the straight line's energy at most, and the simulator says so too."""
    open_page(browser, Studio(planner="direct").data, tmp_path)
    ready(browser)
    assert float(browser.do("document.getElementById('ratio').textContent")[:-2]) <= 0.1
    assert browser.do("document.getElementById('drawn-beyond').hidden")
    (tmp_path / "case.toml").write_text(browser.do("vesStudio.caseOfDrawn()"))
    words = ["--json", "-", "--out", str(tmp_path)]
    assert main(["simulate", "--case", str(tmp_path / "case.toml"), *words]) == 0
    drawn = json.loads(capsys.readouterr().out)["energies"]["E_mean"]
    assert main(["simulate", "--duration", "3", *words]) == 0
    straight = json.loads(capsys.readouterr().out)["energies"]["E_mean"]
    assert drawn / straight <= 0.1


def test_machines_that_the_page_cannot_simulate_are_refused():
    for vehicle in ("servicer", "servicer-flexible"):
        with pytest.raises(
            ParameterError, match="studio simulates a rigid arm on a linear base"
        ):
            playable(System(vehicle=get_vehicle(vehicle)))
    with pytest.raises(ParameterError, match="ves-studio/1"):
        render_studio({"schema": "ves-other/1"})


@pytest.mark.parametrize("armature", [pytest.param(0.0, marks=pytest.mark.slow), 1.0])
def test_an_arm_from_a_urdf_is_simulated_as_the_simulator_does(browser, tmp_path, armature):
    """With rotors its friction counts; without, it is left out, since links are so light."""
    file, page = six_joint_urdf(tmp_path / "maker6.urdf", armature), tmp_path / "own.html"
    words = ["studio", "--arm", f"{file}#tool0", "--planner", "none", "--out", str(page)]
    assert main(words) == 0
    browser.open(page.as_uri())
    ready(browser)
    said = browser.do("document.getElementById('truth').textContent")
    count = browser.do("vesStudio.data.references.length")
    print(f"maker6 on bent, armature {armature:g} kg m^2: {said} of {count} motions")
    assert count >= 4
    assert float(said.removesuffix(" %")) < 1.0
    smooth = browser.do(
        "((m, all) => { const smooth = structuredClone({...m, linear: null});"
        " smooth.arm.links.forEach((l) => { l.damping = l.friction = 0; });"
        " return Math.max(...all.map((r) => Math.abs("
        "vesStudio.simulateMotion(smooth, r.motion).E_mean / r.E_mean - 1))); })"
        "(vesStudio.data.machine, vesStudio.data.references)"
    )
    assert (smooth > 0.02) == (armature > 0)
    assert browser.errors == []
    names = "[...document.querySelectorAll('#sliders label span')].map((e) => e.textContent)"
    assert browser.do(names)[0] == "shoulder_pan"
