"""The studio of an arm from somebody's own URDF."""

import pytest

from tests.report.studio_page import ready
from tests.urdf_arms import six_joint_urdf
from ves_gym.cli.main import main


@pytest.mark.parametrize("armature", [0.0, 1.0], ids=["no rotors", "with friction"])
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
