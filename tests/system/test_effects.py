"""Effects: null is nominal to the bit, anything else acts, and nothing is taken silently."""

import dataclasses
import json

import numpy as np
import pytest

from tests.effects.values import VALUES, effect, null
from ves_gym._util.params import ParameterError
from ves_gym.effects import (
    GravityScale,
    PayloadInertia,
    PlatformBandwidth,
    SensorBias,
    SensorDrift,
    SensorLag,
)
from ves_gym.hardware.leg_servo import FILTERED
from ves_gym.mechanics.vehicle import DECOUPLED
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.deviations import LoopParameters
from ves_gym.system.effect import EFFECTS, LaboratoryEffect, parameter, register_effect
from ves_gym.system.emulator_settings import EmulatorSettings
from ves_gym.system.system import System

NOMINAL = System(mode="emulated", vehicle=DECOUPLED)
POSITION = EmulatorSettings(operation="position")
PLAIN = EmulatorSettings(payload_compensation=False)
UNBRAKED = EmulatorSettings(platform=dataclasses.replace(FILTERED, K2=0.0))


# kind -> parameter -> None: one number per joint
def test_every_effect_is_entered_here():
    assert set(VALUES) == set(EFFECTS)


@pytest.mark.parametrize("described", [NOMINAL, System(vehicle=DECOUPLED)])
def test_a_system_with_effects_is_written_and_read_back(tmp_path, described):
    kinds = [kind for kind in VALUES if described.mode in EFFECTS[kind].modes]
    system = described.replace(effects=tuple(f(kind) for kind in kinds for f in (effect, null)))
    system.save(tmp_path / "system.toml")
    again = System.load(tmp_path / "system.toml")
    assert again == system
    assert again.hash == system.hash != described.hash
    assert [type(e) for e in again.effects[::2]] == [EFFECTS[kind] for kind in kinds]


def test_lists_and_arrays_are_the_same_effect():
    kind = "platform/stroke"
    for kind in ("sensor/calibration", "joint/stribeck"):
        given = EFFECTS[kind](**{k: np.array(v) for k, v in VALUES[kind].items()})
        assert given == effect(kind) and hash(given) == hash(effect(kind))
        hashes = {NOMINAL.replace(effects=(e,)).hash for e in (given, effect(kind))}
        assert len(hashes) == 1


# ------------------------------------------------------------------------- refused


@pytest.mark.parametrize("kind", VALUES)
def test_values_out_of_bounds_or_of_another_shape_are_refused(kind):
    cls = EFFECTS[kind]
    for field in dataclasses.fields(cls):
        low, high = field.metadata["bounds"]
        zero = field.metadata["null"]
        assert field.metadata["unit"] and (zero is None or low <= zero <= high)
        good = VALUES[kind][field.name]
        shape = np.shape(good)
        bad = [np.full(shape, v) for v in (low - 1e-6, high * 1.001, np.nan)]
        bad += ["1", True, np.zeros((2, *shape)), [[1.0], [1.0, 2.0]]]
        if shape:
            bad += [1.0]
        if None not in field.metadata["shape"] and shape:
            bad += [np.zeros(shape)[1:]]
        for value in bad:
            with pytest.raises(
                ParameterError, match=rf"{kind}.{field.name} must be .* in \[.*\].*, got "
            ):
                cls(**{**VALUES[kind], field.name: value})


def test_effects_of_the_laboratory_are_refused_in_space():
    bias = effect("sensor/bias")
    with pytest.raises(ParameterError, match="sensor/bias acts in mode emulated, got mode id"):
        System(effects=(bias,))
    assert NOMINAL.replace(effects=(bias,)).ideal().effects == ()


def test_parameters_have_one_number_per_joint():
    wrong = EFFECTS["joint/coulomb"](torque=(1.0, 2.0))
    with pytest.raises(ParameterError, match=r"torque must be 3 numbers, .* got 2"):
        NOMINAL.replace(effects=(wrong,))


@pytest.mark.parametrize(
    ("kind", "change", "needs"),
    [
        ("joint/drive_gain", {"drive": "prescribed"}, "drive motor"),
        ("gravity/tilt", {"emulator": POSITION}, "operation microgravity, got position"),
        ("payload/inertia", {"emulator": PLAIN}, "payload_compensation"),
        ("platform/damping", {"emulator": UNBRAKED}, "a pose servo, or legs of K2"),
    ],
)
def test_an_effect_that_would_do_nothing_is_refused(kind, change, needs):
    with pytest.raises(ParameterError, match=f"{kind} would do nothing: it needs {needs}"):
        NOMINAL.replace(effects=(effect(kind),), **change)


def test_an_arm_has_its_own_number_of_gravity_parameters():
    with pytest.raises(ParameterError, match="error must be 9 numbers for puma560, got 2"):
        NOMINAL.replace(effects=(EFFECTS["gravity/moment"](error=(0.0, 0.0)),))


def test_unknown_effects_are_refused_by_name():
    plain = json.loads(json.dumps(NOMINAL.replace(effects=(SensorBias(),)).to_dict()))
    plain["effects"][0]["kind"] = "sensor/x"
    with pytest.raises(ParameterError, match=r"effects\[0\].*sensor/x"):
        System.from_dict(plain)
    plain["effects"][0] = {"kind": "sensor/bias", "forces": [0, 0, 0]}
    with pytest.raises(ParameterError, match="unknown key 'forces'; known: force, moment"):
        System.from_dict(plain)
    with pytest.raises(
        ParameterError, match=r"System.effects must be a tuple of Effect, got ..sensor/b"
    ):
        NOMINAL.replace(effects=("sensor/bias",))


def test_an_effect_of_ones_own_acts_and_its_name_is_taken():
    """A new effect is one class: its bias shows in the reading."""
    kind = "sensor/test_only"
    try:

        @register_effect(kind)
        class Lifted(LaboratoryEffect):
            port = "wrench"
            force: float = parameter("N", bounds=(0.0, 10.0))

            def edit(self, p):
                p.sensor.bias[:, 2] += self.force

        system = NOMINAL.replace(effects=(Lifted(force=5.0),))
        assert System.from_dict(system.to_dict()) == system
        a, b = (Simulator(s).readings.wrench[0] for s in (system, NOMINAL))
        assert (a - b)[2] == pytest.approx(-5.0)  # the sensor's z points down
        again = type("Again", (Lifted,), {})
        with pytest.raises(ParameterError, match="test_only' is already registered by Lifted"):
            register_effect(kind)(again)
        assert EFFECTS[kind] is Lifted
    finally:
        EFFECTS.pop(kind, None)


# --------------------------------------------------------------------- combinations


def edited(*effects):
    p = LoopParameters.nominal(NOMINAL.arm, NOMINAL.emulator_settings, 2)
    for one in effects:
        if isinstance(one, LaboratoryEffect):
            one.edit(p)
    return p


def same(a, b):
    """Equal parameters but for rounding."""
    for field in dataclasses.fields(LoopParameters):
        x, y = getattr(a, field.name), getattr(b, field.name)
        if field.name == "sensor":
            for part in dataclasses.fields(x):
                np.testing.assert_allclose(
                    getattr(x, part.name), getattr(y, part.name), rtol=1e-12, atol=1e-15
                )
        elif field.name != "arm":
            np.testing.assert_allclose(x, y, rtol=1e-12, atol=1e-15)
    assert a.arm == b.arm


SQUARES = ("sensor/noise", "sensor/drift")  # independent: variances add
PRODUCTS = {"gravity/scale": GravityScale, "sensor/lag": SensorLag}


EDITS = [k for k in VALUES if issubclass(EFFECTS[k], LaboratoryEffect)]


LIMITS = ("platform/stroke",)  # the tightest counts


@pytest.mark.parametrize("kind", [k for k in EDITS if k not in (*PRODUCTS, *LIMITS)])
def test_two_effects_of_one_kind_add_up(kind):
    """The same deviation twice is twice the deviation; of noise, sqrt(2) times."""
    factor = np.sqrt(2) if kind in SQUARES else 2.0
    double = {
        k: v if k == "time" else (factor * np.array(v)).tolist()
        for k, v in VALUES[kind].items()
    }
    same(edited(effect(kind), effect(kind)), edited(EFFECTS[kind](**double)))


@pytest.mark.parametrize("kind", PRODUCTS)
def test_two_relative_changes_multiply(kind):
    cls = PRODUCTS[kind]
    a, b = 0.05, -0.02
    same(edited(cls(error=a), cls(error=b)), edited(cls(error=(1 + a) * (1 + b) - 1)))


def test_effects_of_different_kinds_do_not_undo_each_other():
    """All at once, in either order: the same machine but for the two that scale."""
    kinds = [k for k in VALUES if k != "gravity/scale"]
    forward = edited(*(effect(k) for k in kinds))
    backward = edited(*(effect(k) for k in reversed(kinds)))
    same(forward, backward)
    for kind in kinds:
        alone, nothing = edited(effect(kind)), edited()
        for field in dataclasses.fields(alone.sensor):
            a, b, c = (getattr(p.sensor, field.name) for p in (alone, nothing, forward))
            if (a != b).any():
                assert (c != b).any()


def test_drifts_share_one_correlation_time():
    fast, slow = SensorDrift(force=(1.0,) * 3, time=2.0), SensorDrift(force=(1.0,) * 3)
    with pytest.raises(ParameterError, match="sensor/drift must share one time, got 2 s, 60 s"):
        NOMINAL.replace(effects=(fast, slow))
    NOMINAL.replace(effects=(fast, SensorDrift(time=9.0)))  # one of them does not drift


def test_two_platforms_cannot_add_up_to_none():
    """-60 % twice is less than no platform; nor may the arm's inertia be negative."""
    for one, name in (
        (PlatformBandwidth(error=-0.6), "bandwidth"),
        (PayloadInertia(error=-0.6), "payload_scale"),
    ):
        with pytest.raises(ParameterError, match=f"change {name} by -1.2, must be > -1"):
            Simulator(NOMINAL.replace(effects=(one, one)), warn_at=None)
