"""An effect of the generator and the library's effect of that name mean the same.

Both act on the same motion of the same healthy machine; compared is what they change. The
truth is richer than the library, so the two agree closely for plain numbers and loosely for
friction and gears. A wrong sign, unit or axis would miss by more than 1.
"""

import numpy as np
import pytest

pytest.importorskip("numba")

from ves_gym._util.params import from_plain
from ves_gym.diagnosis.benchmark.blind.beam import base_of
from ves_gym.diagnosis.benchmark.blind.effects import CONTACT, LIBRARY, drawn
from ves_gym.diagnosis.benchmark.blind.excitation import draw
from ves_gym.diagnosis.benchmark.blind.magnitude import SCALE
from ves_gym.diagnosis.benchmark.blind.simulate import CHANNELS, silent
from ves_gym.effects import EFFECTS
from ves_gym.system.effect import Effect

SAMPLES = 601
RANDOM = "sensor/drift"  # drawn anew in every run: there is nothing to compare
# measured at most 0.53, of Stribeck's friction in v; what is not named, 1e-2
LOOSE = {
    "joint/coulomb": 0.35,
    "joint/stribeck": 0.65,
    "joint/asymmetry": 0.4,
    "joint/load_friction": 0.55,
    "joint/elasticity": 0.05,
    "joint/backlash": 0.4,
    "platform/stroke": 0.8,
}
# what `library_record` reads from the simulator's state, where the effect is not seen
UNSEEN = {
    "joint/measurement_delay": ("q", "v"),
    "joint/backlash": ("v", "tau", "w", "wg"),  # they ring with the contact, ours is softer
}
GEARS = ("joint/elasticity", "joint/backlash")  # joint 1: no weight winds it up at the start
STRONG = {"platform/stroke": 0.985}  # so that it acts on this motion


def library_effect(effect):
    """The library's effect with the values of a label."""
    kind, j = effect.kind, effect.slot
    p = effect.truth.parameters(effect.magnitude, effect.constants)

    def at(size, value):
        return [value if i == j else 0.0 for i in range(size)]

    if kind == "sensor/bias":
        p = {"force": at(6, p["offset"])[:3], "moment": at(6, p["offset"])[3:]}
    elif kind == "sensor/calibration":
        error = np.zeros((6, 6))
        error[j, j - j % 3 + (j % 3 + p["from"]) % 3] = p["error"]
        p = {"error": error.tolist()}
    elif kind in ("sensor/rotation", "gravity/tilt", "payload/com"):
        p = {k: at(3, value) for k, value in p.items()}
    elif kind == "base/amplitude_damping":
        p = {"coefficient": at(6, p["coefficient"])}
    elif kind == "base/extra_mode":
        p["direction"] = at(3, 1.0)
    elif kind == "joint/ripple":
        p = {k: at(3, value) if k == "amplitude" else [value] * 3 for k, value in p.items()}
    elif kind.startswith("joint/") and kind != "joint/measurement_delay":
        p = {k: value if k == "fade_speed" else at(3, value) for k, value in p.items()}
    if kind == "joint/asymmetry":
        p["viscous"] = [0.0] * 3
    if kind == "joint/backlash":
        p |= {"compliance": 1 / CONTACT}
    if kind == "platform/stroke":
        p["speed"] = 0.0
    return from_plain(Effect, {"kind": kind, **p})


@pytest.fixture(scope="module")
def healthy(runner, description, library_record):
    """Motion, setup without inner modes of the beam, both healthy records."""
    motion = draw("multisine", runner.limits, np.random.default_rng(4))
    setup = runner.nominal._replace(base=base_of(description["vehicle"], 0))
    ours = runner.records(setup, [motion], [silent(SAMPLES)])[0]
    return motion, setup, ours, library_record(motion, ours[0], SAMPLES)


@pytest.mark.slow
@pytest.mark.parametrize("kind", [k for k in LIBRARY if k in EFFECTS and k != RANDOM])
def test_effect_does_what_the_library_says(runner, healthy, library_record, kind):
    motion, setup, ours, theirs = healthy
    effect = drawn(kind, np.random.default_rng(2))[0]
    if kind in GEARS:
        effect = effect._replace(slot=0)
    effect = effect._replace(magnitude=STRONG.get(kind, effect.magnitude))
    changed = runner.records(effect.applied(setup), [motion], [silent(SAMPLES)])[0]
    said = library_record(motion, changed[0], SAMPLES, [library_effect(effect)])
    change = {
        name: [(k - m)[:, where] / SCALE[name] for k, m in ((changed, ours), (said, theirs))]
        for name, where in CHANNELS.items()
        if name not in UNSEEN.get(kind, ())
    }
    name = max(change, key=lambda k: (change[k][0] ** 2).mean())
    a, b = change[name]
    miss = np.sqrt(((a - b) ** 2).sum() / (a**2).sum())
    assert miss < LOOSE.get(kind, 0.03), f"{name}: {miss:.3f}"
