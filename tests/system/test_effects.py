"""Effects: null is nominal to the bit, anything else acts, and nothing is taken silently."""

import dataclasses
import json

import numpy as np
import pytest

from tests.effects.values import VALUES, effect, null
from ves_gym._util.params import ParameterError
from ves_gym.effects import (
    LABORATORY_ERRORS,
    GravityScale,
    PayloadInertia,
    PlatformBandwidth,
    SensorBias,
    SensorDrift,
    SensorLag,
    SensorNoise,
)
from ves_gym.hardware.leg_servo import FILTERED
from ves_gym.mechanics.vehicle import DECOUPLED
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.deviations import LoopParameters
from ves_gym.system.effect import EFFECTS, LaboratoryEffect, parameter, register
from ves_gym.system.emulator_settings import EmulatorSettings
from ves_gym.system.system import System

NOMINAL = System(mode="emulated", vehicle=DECOUPLED)
# kind -> parameter -> None: one number per joint
SHAPES = {
    kind: {
        f.name: None if None in f.metadata["shape"] else 0
        for f in dataclasses.fields(cls)
        if f.name not in cls.free_length
    }
    for kind, cls in EFFECTS.items()
}


def run(system, seed=3):
    """Everything seen in thirty periods of a swinging arm, two simulations."""
    sim = Simulator(system, 2, seed=seed)
    out = []
    for k in range(30):
        phase = 2 * np.pi * k / 40 + np.array([[0.0, 1.0, 2.0], [2.0, 0.0, 1.0]])
        state = sim.step(sim.servo_command(0.2 * np.sin(phase), np.zeros((2, 3))))
        out += [*state, *sim.readings]
    return out


def test_every_effect_is_entered_here():
    assert set(VALUES) == set(EFFECTS)


@pytest.mark.parametrize("suffix", ["toml", "json"])
def test_a_system_with_effects_is_written_and_read_back(suffix, tmp_path):
    system = NOMINAL.replace(effects=tuple(f(kind) for kind in VALUES for f in (effect, null)))
    system.save(tmp_path / f"system.{suffix}")
    again = System.load(tmp_path / f"system.{suffix}")
    assert again == system
    assert again.hash == system.hash != NOMINAL.hash
    assert [type(e) for e in again.effects[::2]] == [EFFECTS[kind] for kind in VALUES]


@pytest.mark.parametrize("kind", VALUES)
def test_lists_and_arrays_are_the_same_effect(kind):
    given = {
        k: np.array(v) if isinstance(v, tuple) else np.float64(v)
        for k, v in VALUES[kind].items()
    }
    assert EFFECTS[kind](**given) == effect(kind)
    assert hash(EFFECTS[kind](**given)) == hash(effect(kind))
    system = NOMINAL.replace(effects=(EFFECTS[kind](**given),))
    assert system.hash == NOMINAL.replace(effects=(effect(kind),)).hash


@pytest.mark.parametrize("kind", VALUES)
def test_every_parameter_has_a_unit_and_a_null_within_bounds(kind):
    for field in dataclasses.fields(EFFECTS[kind]):
        low, high = field.metadata["bounds"]
        assert low < high
        assert field.metadata["unit"]
        zero = field.metadata["null"]
        assert zero is None or low <= zero <= high
    assert kind in str(effect(kind))
    assert EFFECTS[kind].__doc__


# ------------------------------------------------------------------------- refused


@pytest.mark.parametrize("kind", VALUES)
def test_values_out_of_bounds_or_of_another_shape_are_refused(kind):
    cls = EFFECTS[kind]
    for field in dataclasses.fields(cls):
        low, high = field.metadata["bounds"]
        good = VALUES[kind][field.name]
        shape = np.shape(good)
        bad = [np.full(shape, v) for v in (low - 1e-6, high * 1.001, np.nan, np.inf)]
        bad += ["1", None, True, np.zeros((2, *shape)), [[1.0], [1.0, 2.0]]]
        if shape:
            bad += [1.0]
        if None not in field.metadata["shape"] and shape:
            bad += [np.zeros(shape)[1:]]
        for value in bad:
            with pytest.raises(
                ParameterError, match=rf"{kind}.{field.name} must be .* in \[.*\].*, got "
            ):
                cls(**{**VALUES[kind], field.name: value})


@pytest.mark.parametrize("kind", [k for k in VALUES if not EFFECTS[k].modes[1:]])
def test_effects_of_the_laboratory_are_refused_in_space(kind):
    with pytest.raises(
        ParameterError, match=f"effect {kind} acts in mode emulated, got mode id"
    ):
        System(effects=(effect(kind),))
    system = NOMINAL.replace(effects=(effect(kind),))
    assert system.ideal().effects == ()


@pytest.mark.parametrize("kind", [k for k in VALUES if None in SHAPES[k].values()])
def test_parameters_have_one_number_per_joint(kind):
    for name, shape in SHAPES[kind].items():
        if shape is None:
            two = VALUES[kind][name][:2]
            wrong = EFFECTS[kind](**{**VALUES[kind], name: two})
            with pytest.raises(ParameterError, match=rf"{name} must be 3 numbers, .* got 2"):
                NOMINAL.replace(effects=(wrong,))


@pytest.mark.parametrize("kind", [k for k in VALUES if EFFECTS[k].needs_motor])
def test_motors_are_needed(kind):
    with pytest.raises(ParameterError, match=f"{kind} would do nothing: it needs drive motor"):
        NOMINAL.replace(drive="prescribed", effects=(effect(kind),))


@pytest.mark.parametrize("kind", [k for k in VALUES if k.startswith("gravity/")])
@pytest.mark.parametrize("operation", ["admittance", "position"])
def test_gravity_effects_need_an_estimate(kind, operation):
    with pytest.raises(
        ParameterError,
        match=f"{kind} would do nothing: it needs operation microgravity, got {operation}",
    ):
        NOMINAL.replace(effects=(effect(kind),), emulator=EmulatorSettings(operation=operation))


def test_an_effect_that_would_do_nothing_is_refused():
    with pytest.raises(ParameterError, match="payload/inertia would do nothing: it needs payl"):
        NOMINAL.replace(
            effects=(PayloadInertia(error=0.1),),
            emulator=EmulatorSettings(payload_compensation=False),
        )
    with pytest.raises(ParameterError, match="error must be 9 numbers for puma560, got 2"):
        NOMINAL.replace(effects=(EFFECTS["gravity/moment"](error=(0.0, 0.0)),))
    legs = EmulatorSettings(platform=dataclasses.replace(FILTERED, K2=0.0))
    with pytest.raises(
        ParameterError, match=r"platform/damping would do nothing: .* legs of K2"
    ):
        NOMINAL.replace(effects=(effect("platform/damping"),), emulator=legs)


def test_unknown_effects_are_refused_by_name():
    plain = json.loads(json.dumps(NOMINAL.replace(effects=(SensorBias(),)).to_dict()))
    plain["effects"][0]["kind"] = "sensor/x"
    with pytest.raises(ParameterError, match=r"effects\[0\].*sensor/x"):
        System.from_dict(plain)
    plain["effects"][0] = {"kind": "sensor/bias", "forces": [0, 0, 0]}
    with pytest.raises(ParameterError, match="unknown key 'forces'; known: force, moment"):
        System.from_dict(plain)
    with pytest.raises(
        ParameterError, match=r"System.effects must hold effects, got 'sensor/b"
    ):
        NOMINAL.replace(effects=("sensor/bias",))


def test_a_registered_name_cannot_be_taken_again():
    before = dict(EFFECTS)
    with pytest.raises(
        ParameterError, match="effect 'sensor/bias' is already registered by SensorBias"
    ):

        @register("sensor/bias")
        @dataclasses.dataclass(frozen=True, kw_only=True)
        class Another(LaboratoryEffect):
            port = "wrench"
            size: float = parameter("N", bounds=(0.0, 1.0))

            def edit(self, p):
                pass

    assert before == EFFECTS
    assert SensorBias.kind == "sensor/bias"


def test_an_effect_of_ones_own_acts(monkeypatch):
    """A new effect is one class: its bias shows in the reading."""
    monkeypatch.setattr("ves_gym.system.effect.EFFECTS", EFFECTS)
    kind = "sensor/test_only"
    try:

        @register(kind)
        @dataclasses.dataclass(frozen=True, kw_only=True)
        class Lifted(LaboratoryEffect):
            port = "wrench"
            force: float = parameter("N", bounds=(0.0, 10.0))

            def edit(self, p):
                p.sensor.bias[:, 2] += self.force

        system = NOMINAL.replace(effects=(Lifted(force=5.0),))
        assert System.from_dict(system.to_dict()) == system
        a, b = (Simulator(s).readings.wrench[0] for s in (system, NOMINAL))
        assert (a - b)[2] == pytest.approx(-5.0)  # the sensor's z points down
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


def test_the_nominal_error_budget_runs():
    system = NOMINAL.replace(effects=LABORATORY_ERRORS)
    assert {type(e) for e in system.effects} == {SensorNoise, SensorDrift}
    got, again, other = run(system), run(system), run(system, seed=4)
    assert all(a.tobytes() == b.tobytes() for a, b in zip(got, again, strict=True))
    assert (got[-4] != other[-4]).any()
