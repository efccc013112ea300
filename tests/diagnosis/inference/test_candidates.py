"""What a diagnosis may try follows from what every effect says of itself."""

import json
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
import pytest

from tests.effects.values import VALUES, effect
from ves_gym._util.params import ParameterError
from ves_gym.diagnosis.inference.cache import source_digest
from ves_gym.diagnosis.inference.candidates import left_out, library
from ves_gym.diagnosis.inference.fit import Fit
from ves_gym.diagnosis.machines.causes import FRICTION, split
from ves_gym.diagnosis.machines.drift import SlowPath
from ves_gym.diagnosis.machines.joint_library import MjcfJoint
from ves_gym.diagnosis.machines.mjcf import MjcfMachine
from ves_gym.diagnosis.machines.torque_balance import scales
from ves_gym.effects import SensorDrift
from ves_gym.mechanics.spatial import WRENCH
from ves_gym.mechanics.vehicle import BENT_THESIS, FREE_FLOATING
from ves_gym.system.candidate import Scope
from ves_gym.system.effect import (
    EFFECTS,
    LaboratoryEffect,
    TorqueEffect,
    joint_torque,
    parameter,
    register_effect,
)
from ves_gym.system.emulator_settings import EmulatorSettings
from ves_gym.system.system import System

ROOT = Path(__file__).parents[3]
PORTS = ("joint", "servo", "wrench", "gravity", "admittance", "platform")
EMULATED = System(
    vehicle=BENT_THESIS, mode="emulated", emulator=EmulatorSettings(payload_compensation=True)
)


def emulated(**options):
    return {c.name: c for c in library(3, PORTS, "emulated", ["a"], 0.4, **options)}


class Idle(LaboratoryEffect):
    """An effect of which only what it says of itself is of interest."""

    def edit(self, p):
        pass


@pytest.fixture
def registered():
    """Register effects of one's own, and forget them again."""
    mine = []

    def add(kind, cls):
        mine.append(kind)
        return register_effect(kind)(dataclass(frozen=True, kw_only=True)(cls))

    yield add
    for kind in mine:
        del EFFECTS[kind]


def test_the_library_is_that_with_which_the_sealed_sets_were_answered():
    """Reference: the library written by hand that these declarations replace, as it grew."""
    stored = json.loads((Path(__file__).parent / "library.json").read_text())
    found = emulated()
    assert stored.keys() <= found.keys()
    for name, was in stored.items():
        c = found[name]
        for field in ("ports", "names", "units", "low", "high", "factors"):
            assert list(getattr(c, field)) == was[field], (name, field)
        for field in ("sets_in", "sparse"):
            assert getattr(c, field) == was.get(field, False), (name, field)
        assert (c.within, c.price) == (was.get("within", ""), was["price"]), name
        assert (len(c.starts), len(c.blurs)) == (was["starts"], was["forms"]), name
        assert list(c.starts[0]) == was["first"], name
        np.testing.assert_allclose(np.sum(c.starts, axis=0), was["sum"], rtol=1e-9)


def test_every_registered_effect_has_a_candidate_or_a_reason():
    every = {c.kind for c in library(3, PORTS, "emulated", ["a"], system=EMULATED)}
    reasons = {
        kind: left_out(cls, Scope(3, EMULATED), PORTS, "emulated", ["a"])
        for kind, cls in EFFECTS.items()
    }
    assert every - {FRICTION} == {kind for kind, reason in reasons.items() if not reason}
    assert {kind for kind, reason in reasons.items() if reason} == {
        "base/mode",
        "base/unknown",
        "joint/curves",
        "joint/memory",
        "joint/unknown",
        "sensor/noise",
    }
    assert "noise" in reasons["sensor/noise"] and "no name" in reasons["joint/unknown"]


def test_a_candidate_at_its_starts_is_an_effect_of_its_kind():
    for c in library(3, PORTS, "emulated", ["a"], system=EMULATED):
        for start in c.starts:
            made = c.effect(np.array(start))
            kinds = {k for k, _ in c.parts} or {c.kind}
            drifts = isinstance(made, SlowPath)
            assert {"sensor/drift" if drifts else e.kind for e in split([made])} == kinds
        for part in () if drifts else split([made]):
            part.check(EMULATED)
            assert not part.is_null
        assert set(c.ports) <= set(PORTS)


def test_what_would_do_nothing_in_a_system_is_no_candidate():
    free = System(mode="emulated", vehicle=FREE_FLOATING)
    found = {c.kind for c in library(3, PORTS, "emulated", ["a"], system=free)}
    assert not {"base/stiffness", "base/damping"} & found
    assert "base/virtual_mass" in found
    reason = left_out(EFFECTS["base/stiffness"], Scope(3, free), PORTS, "emulated")
    assert "needs a vehicle with stiffness" in reason


def test_what_repeats_says_how_often_it_has():
    travel = (2 * np.pi / 10, 0.0, 1.0)
    found = {c.name: c for c in library(3, ["joint"], "ideal", travel=travel)}
    ripple = found["joint/ripple at joint 1"]
    assert ripple.periods(np.array([1.0, 0.0, 12.0])) == pytest.approx(1.2)
    assert {c.kind for c in found.values() if c.periods} == {"joint/ripple"}
    assert not any(c.periods for c in library(3, ["joint"], "ideal"))  # travel not known


def test_a_drift_is_a_course_and_its_size_the_effect():
    c = emulated()["sensor/drift at M_y"]
    assert c.k == 8 and c.price == 8
    path = c.effect(2.0 * np.eye(8)[0])
    assert path == SlowPath(4, (("a", (2.0, *(0.0,) * 7)),))
    assert path.effect == SensorDrift(moment=(0.0, 2.0, 0.0))


def test_a_plain_effect_per_joint_needs_no_more_than_its_parameters(registered):
    class Sponge(TorqueEffect):
        modes = ("ideal", "emulated")
        port = "joint"
        push: tuple[float, ...] = parameter("N m", bounds=(0.0, 40.0), shape=(None,))
        speed: tuple[float, ...] = parameter(
            "rad/s", bounds=(0.01, 1.0), null=None, shape=(None,)
        )
        share: float = parameter("1", bounds=(0.0, 1.0), null=None, default=0.5)

        def law(self, q, v, tau):
            return -self.push * np.tanh(v / self.speed) * self.share

    cls = registered("joint/sponge", Sponge)
    own = [c for c in library(3, ["joint"], "ideal") if c.kind == "joint/sponge"]
    assert [c.slot for c in own] == ["joint 1", "joint 2", "joint 3"]
    c = own[1]
    assert c.names == ("push", "speed")  # a shape with a default stays there
    assert c.factors == (0,) and c.ports == ("joint",) and not c.sparse
    assert c.starts[0][0] == 2.0 and len(c.starts) == 12
    assert all(0.01 < s[1] < 1.0 for s in c.starts)
    rest = c.starts[0][1]
    assert c.effect(np.array([3.0, 0.2])) == cls(push=(0, 3, 0), speed=(rest, 0.2, rest))


def test_shapes_say_the_places(registered):
    class Vector(Idle):
        port = "wrench"
        shift: tuple[float, ...] = parameter("m", bounds=(-0.1, 0.1), shape=(3,))

    class Six(Idle):
        port = "platform"
        lost: tuple[float, ...] = parameter("m, rad", bounds=(-1.0, 1.0), shape=(6,))

    class Matrix(Idle):
        port = "wrench"
        mixed: tuple = parameter("1", bounds=(-1.0, 1.0), shape=(6, 6))

    class Factor(Idle):
        port = "gravity"
        gain: float = parameter("1", bounds=(0.5, 2.0), null=1.0)
        tilt: tuple[float, ...] = parameter("rad", bounds=(-0.1, 0.1), shape=(3,))

    registered("own/vector", Vector)
    registered("own/six", Six)
    registered("own/matrix", Matrix)
    factor = registered("own/factor", Factor)
    found = emulated()
    vector = found["own/vector"]
    assert vector.names == ("x", "y", "z") and vector.sparse and vector.price == 1
    turned = found["own/six at phi_y"]
    assert turned.units == ("rad",) and turned.effect(np.ones(1)).lost == (0, 0, 0, 0, 1, 0)
    row = found["own/matrix at M_x"]
    assert row.names == WRENCH and row.sparse
    assert np.array(row.effect(np.full(6, 0.1)).mixed)[3] == pytest.approx(0.1)
    both = found["own/factor"]
    assert both.names == ("gain - 1", "tilt_x", "tilt_y", "tilt_z") and not both.sparse
    assert (both.low[0], both.high[0]) == (-0.5, 1.0)
    assert both.effect(np.array([0.2, 0, 0.05, 0])) == factor(gain=1.2, tilt=(0, 0.05, 0))
    assert both.effect(np.zeros(4)).is_null


def test_an_effect_whose_places_do_not_fit_is_left_out_with_the_reason(registered):
    class Odd(Idle):
        port = "wrench"
        places = "joint"
        table: tuple = parameter("1", bounds=(0.0, 1.0), shape=(2, 2))

    cls = registered("own/odd", Odd)
    assert "own/odd" not in {c.kind for c in emulated().values()}
    reason = left_out(cls, Scope(3), PORTS)
    assert "places `joint` must be one number or one per joint, got shapes (2, 2)" in reason
    with pytest.raises(ParameterError):
        list(cls.candidates(Scope(3)))


@pytest.mark.parametrize(
    ("values", "std", "edge"),
    [
        ([0.003, 0.0, -0.1], [1e-5, 1e-5, 5.0], False),  # no turn about the vertical tells
        ([0.1, 0.0, 0.0], [1e-5, 1e-5, 5.0], True),
    ],
)
def test_an_axis_about_which_the_runs_say_nothing_is_no_edge(values, std, edge):
    tilt = emulated()["gravity/tilt"]
    none = np.zeros((0, 0))
    found = Fit((tilt,), (np.array(values),), 0.0, (np.array(std),), none, none, none, none)
    assert found.on_bound(0) == edge


def test_a_law_of_one_s_own_is_tried_on_any_machine_in_mjcf(registered):
    class Spring(TorqueEffect):
        modes = ("ideal", "emulated")
        port = "joint"
        stiffness: tuple[float, ...] = parameter("N m/rad", bounds=(0.0, 50.0), shape=(None,))

        def law(self, q, v, tau):
            return -self.stiffness * q

    registered("own/spring", Spring)
    body = "<body><joint name='hip'/><geom size='0.1'/></body>"
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{body}</worldbody></mujoco>")
    found = {c.name: c for c in MjcfMachine("leg", [MjcfJoint("hip")], model).candidates()}
    assert found["own/spring at hip"].ports == ("joint",)
    assert not {"joint/torque_limit", "joint/elasticity", "payload/mass"} & {
        c.kind for c in found.values()
    }


def test_laws_that_change_with_the_torque_are_found_by_asking(registered):
    class Worn(TorqueEffect):
        modes = ("ideal", "emulated")
        port = "joint"
        share: float = parameter("1", bounds=(0.0, 0.5))

        def law(self, q, v, tau):
            return -self.share * tau

    before = source_digest.__wrapped__()
    worn = registered("own/worn", Worn)
    assert source_digest.__wrapped__() != before  # answers of an edited file are asked anew
    at_all = {kind for kind in VALUES if scales(effect(kind))}
    assert at_all == {"joint/drive_gain", "joint/load_friction"}
    assert scales(worn(share=0.1))
    assert not scales(worn())


@pytest.mark.parametrize("cycles", [10.0, 400.0])
def test_a_ripple_may_have_a_second_harmonic(cycles):
    """Of either phase: any ripple sin(2 c q + a) is a sum of the two forms."""
    ripple = EFFECTS["joint/ripple"](
        amplitude=(2.0, 0.0, 0.0), cycles=(cycles, 1.0, 1.0), phase=(3.0, 0.0, 0.0)
    )
    q = np.linspace(-1.0, 1.0, 9)[:, None] * np.ones(3)
    still = np.zeros_like(q)
    sine, cosine = (
        joint_torque([form(ripple)], q, still, still, np.ones(3))[:, 0] for form in ripple.forms
    )
    twice = min(2 * cycles, 500.0)  # the most that a ripple can have
    angle = twice * q[:, 0] + 6.0
    np.testing.assert_allclose(np.abs(sine), np.abs(2.0 * np.sin(angle)), atol=1e-9)
    np.testing.assert_allclose(sine**2 + cosine**2, 4.0, atol=1e-9)
