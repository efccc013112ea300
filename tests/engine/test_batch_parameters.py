"""`Simulator.assign`: simulations of one batch with systems of their own.

Compared with the same simulation in a batch of that system alone: bit for bit on the kernel,
to rounding on MuJoCo, whose model of M, D, K is laid out another way once arms differ.
"""

import dataclasses
import pickle
import warnings
from dataclasses import replace

import numpy as np
import pytest

from tests.effects.values import VALUES
from ves_gym._util.params import ParameterError
from ves_gym.effects import (
    GravityMass,
    JointCoulomb,
    JointViscous,
    PlatformBandwidth,
    PlatformStroke,
    SensorBias,
    SensorDrift,
    SensorNoise,
)
from ves_gym.hardware.leg_servo import LOW_GAINS, leg_clock
from ves_gym.hardware.platform import PoseServo
from ves_gym.mechanics.arm_library import PUMA_560
from ves_gym.mechanics.link import Inertial, diagonal, matrix
from ves_gym.mechanics.servo import PPED_GAINS, JointServo
from ves_gym.mechanics.vehicle import (
    BENT_THESIS,
    DECOUPLED,
    FREE_FLOATING,
    FREE_FLYING,
    MatrixVehicle,
)
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.effect import (
    EFFECTS,
    DelayEffect,
    Effect,
    TorqueEffect,
    parameter,
    register_effect,
)
from ves_gym.system.emulator_settings import EmulatorSettings
from ves_gym.system.system import System

BACKENDS = ["kernel", "mujoco"]
IDEAL = System(vehicle=BENT_THESIS)
NOMINAL = System(vehicle=BENT_THESIS, mode="emulated")
# MuJoCo: 100 physics steps of sums in another order
CLOSE = {"rtol": 1e-7, "atol": 1e-9}


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # the engine writes a log where a simulation diverges


# ------------------------------------------------------------------- systems, drawn


def draw_effect(kind: str, rng: np.random.Generator) -> Effect:
    """An effect with a share of its typical values."""
    share = rng.uniform(0.5, 1.0)
    return EFFECTS[kind](**{k: (share * np.array(v)).tolist() for k, v in VALUES[kind].items()})


def with_effects(system: System, seed: int) -> System:
    """All registered effects of this mode at once, at values drawn."""
    rng, every = np.random.default_rng(seed), sorted(EFFECTS)
    effects = [draw_effect(k, rng) for k in every if system.mode in EFFECTS[k].modes]
    return system.replace(effects=tuple(effects))


def on_time(system: System) -> System:
    """Without the effects that delay commands and measurements."""
    return system.replace(
        effects=tuple(e for e in system.effects if not isinstance(e, DelayEffect))
    )


def other_body(body: Inertial, rng: np.random.Generator) -> Inertial:
    size = rng.uniform(0.9, 1.1)
    return Inertial(
        mass=body.mass * size,
        com=tuple((np.array(body.com) * rng.uniform(0.9, 1.1, 3)).tolist()),
        inertia=matrix(np.array(body.inertia) * size),
    )


def other_arm(seed: int):
    """The PUMA with other masses, centres, rotors and torque limits."""
    rng = np.random.default_rng(seed)
    links = tuple(
        replace(
            link,
            inertial=other_body(link.inertial, rng),
            rotor_inertia=link.rotor_inertia * rng.uniform(0.8, 1.2),
            tau_max=link.tau_max * rng.uniform(0.5, 1.0),
        )
        for link in PUMA_560.links
    )
    return replace(PUMA_560, base=other_body(PUMA_560.base, rng), links=links)


def other_vehicle(vehicle, seed: int) -> MatrixVehicle:
    rng, base = np.random.default_rng(seed), vehicle.base_model()
    scaled = (matrix(m * rng.uniform(0.8, 1.25)) for m in (base.M, base.D, base.K))
    return MatrixVehicle(**dict(zip("MDK", scaled, strict=True)))


def with_bodies(system: System, seed: int) -> System:
    return system.replace(
        arm=other_arm(seed), vehicle=other_vehicle(system.vehicle, seed + 100)
    )


# ------------------------------------------------------------------------ what is compared


def simulator(system: System, n: int, **options) -> Simulator:
    options = {"on_divergence": "mark", "warn_at": None, **options}
    return Simulator(system, n, **options)


def start(i: int) -> dict[str, np.ndarray]:
    rng = np.random.default_rng([7, i])
    return {
        "q": rng.uniform(-1, 1, 3),
        "v": rng.uniform(-0.2, 0.2, 3),
        "y": rng.uniform(-0.01, 0.01, 6),
        "yd": rng.uniform(-0.01, 0.01, 6),
    }


def put(sim: Simulator, which) -> None:
    """Simulations at their own starts, all random generators at theirs."""
    sim.seed(5)  # construction draws noise, where the system has some
    rows = [start(i) for i in which]
    sim.reset(**{k: np.array([row[k] for row in rows]) for k in rows[0]}, ids=list(which))


def advance(sim: Simulator, periods: int = 6) -> list[np.ndarray]:
    """Everything that is seen: held commands and played ones in turn."""
    out, k = [], sim.system.substeps
    for j in range(periods):
        nodes = np.stack(
            [np.random.default_rng([9, i, j]).uniform(-8, 8, (k + 1, 3)) for i in range(sim.n)]
        )
        if j % 2:
            sim.play(nodes)
        else:
            sim.step(nodes[:, 0])
        out += [*sim.state, *sim.evaluate(nodes[:, 0])]
        if sim.emulation_loop is not None:
            out += [*sim.readings]
    return [*out, sim.diverged.copy()]


def alone(system: System, i: int, **options) -> list[np.ndarray]:
    """Simulation i where all have this system."""
    sim = simulator(system, i + 1, **options)
    put(sim, range(i + 1))
    return [part[i] for part in advance(sim)]


def require_same(
    got: list[np.ndarray], wanted: list[np.ndarray], backend: str, close: dict = CLOSE
) -> None:
    for a, b in zip(got, wanted, strict=True):
        if backend == "kernel":
            assert a.tobytes() == b.tobytes()
        else:
            np.testing.assert_allclose(a, b, **close)


def check(
    template: System, systems, backend: str, ids=None, n: int | None = None, **options
) -> Simulator:
    """Assigned simulations are as alone, the others as before."""
    n = len(systems) if n is None else n
    ids = list(range(n)) if ids is None else ids
    sim, twin = (simulator(template, n, backend=backend, **options) for _ in range(2))
    sim.assign(systems, ids)
    put(sim, range(n))
    put(twin, range(n))
    found, plain = advance(sim), advance(twin)
    # MuJoCo rounds the torque of prescribed joints
    close = {"rtol": 1e-5, "atol": 1e-5} if template.drive == "prescribed" else CLOSE
    changed = [a[ids].tobytes() != b[ids].tobytes() for a, b in zip(found, plain, strict=True)]
    assert any(changed)  # the comparison is not blind
    for i in range(n):
        rows = [part[i] for part in found]
        if i in ids:
            other = alone(systems[ids.index(i)], i, backend=backend, **options)
            require_same(rows, other, backend, close)
        else:
            assert all(
                a.tobytes() == part[i].tobytes() for a, part in zip(rows, plain, strict=True)
            )
    return sim


# --------------------------------------------------------------------- as in one alone


@pytest.mark.parametrize(("system", "backend"), [(IDEAL, "mujoco"), (NOMINAL, "kernel")])
def test_every_registered_effect_at_once(system, backend):
    template = with_effects(system, 0)
    assert len(template.effects) >= (3 if system is IDEAL else 17)
    check(template, [with_effects(system, k) for k in (1, 2)], backend, ids=[3, 1], n=4)


# what a motor at its limit does not show, and what a small command does not reach
SOFT = JointServo(kp=(20.0,) * 3, kd=(5.0,) * 3)
LATE = ("command/delay", "joint/measurement_delay", "joint/velocity_lag")
OPTIONS = {k: {"servo": SOFT} for k in LATE}
DRAWN = {"platform/stroke": [PlatformStroke(travel=k, speed=k) for k in (0.99, 0.999)]}


@pytest.mark.parametrize("kind", sorted(EFFECTS))
def test_each_effect_by_itself(kind):
    """Another value in one simulation on the kernel, none in the template's others."""
    plain = System(vehicle=BENT_THESIS, mode=EFFECTS[kind].modes[-1])
    drawn = DRAWN.get(kind) or [draw_effect(kind, np.random.default_rng(k)) for k in range(2)]
    a, b = (plain.replace(effects=(effect,)) for effect in drawn)
    check(a, [b], "kernel", ids=[1], n=3, **OPTIONS.get(kind, {}))


def satellite(seed: int):
    body = other_body(FREE_FLOATING.body, np.random.default_rng(seed))
    return replace(FREE_FLOATING, body=body)


def viscous(*damping: float) -> System:
    return IDEAL.replace(effects=(JointViscous(damping=damping),))


def on_legs() -> tuple[System, System]:
    control, physics = leg_clock(LOW_GAINS)
    legs = EmulatorSettings(platform=LOW_GAINS)
    system = NOMINAL.replace(emulator=legs, control_dt=control, physics_dt=physics)
    one, other = (
        (SensorBias(force=force), GravityMass(error=error))
        for force, error in (((1.0, 2.0, 3.0), 0.3), ((3.0, 2.0, 1.0), -0.3))
    )
    return system.replace(effects=one), system.replace(effects=other, arm=other_arm(1))


SETTINGS = {
    "bent": {},
    "decoupled": {"vehicle": DECOUPLED},
    "emulated, decoupled": {"vehicle": DECOUPLED, "mode": "emulated"},
    "prescribed": {"drive": "prescribed", "integrator": "implicitfast"},
    "implicit": {"integrator": "implicitfast"},
    "euler": {"integrator": "euler"},
    "emulated, prescribed": {"mode": "emulated", "drive": "prescribed"},
    "uncompensated": EmulatorSettings(payload_compensation=False),
    "admittance": EmulatorSettings(operation="admittance", zero_at_start=True),
    "position": EmulatorSettings(operation="position"),
    "late": EmulatorSettings(delay=2, joint_balance=False),
}
CASES = {}  # a simulator's system, and those assigned to others of its simulations
for _name, _options in SETTINGS.items():
    if isinstance(_options, EmulatorSettings):
        _options = {"mode": "emulated", "emulator": _options}
    _own = System(**{"vehicle": BENT_THESIS, **_options})
    _other = other_vehicle(_own.vehicle, 5)
    CASES[_name] = _own, with_bodies(_own, 3), _own.replace(vehicle=_other)
for _mode in ("ideal", "emulated"):
    _own = System(mode=_mode, vehicle=FREE_FLOATING)
    CASES[f"satellite, {_mode}"] = _own, *(_own.replace(vehicle=satellite(k)) for k in (0, 1))
CASES["on legs"] = on_legs()
# only what the kernel compiles has structural zeros
_kinds = ["sensor/bias", "sensor/lag", "sensor/noise", "gravity/delay", "platform/bandwidth"]
_none, _some = (
    NOMINAL.replace(effects=tuple(make(k) for k in _kinds))
    for make in (lambda k: EFFECTS[k](), lambda k: draw_effect(k, np.random.default_rng(3)))
)
CASES |= {"nothing there": (_some, _none), "nothing here": (_none, _some)}
# zero where the template has a number is a number: x + 0 v = x
CASES["a law of zero"] = viscous(2.0, 1.0, 3.0), viscous(0.0, 1.0, 0.0), viscous(0.0, 0.0, 0.0)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("name", CASES)
def test_arms_vehicles_and_settings(name, backend):
    template, *systems = CASES[name]
    check(template, systems, backend, ids=[2, 0][: len(systems)], n=3)


def test_noise_in_one_draws_nothing_from_its_neighbours():
    """Draws of each are those it makes alone: a reset's spread after a noisy run shows it."""
    quiet = NOMINAL.replace(effects=(SensorNoise(), SensorDrift()))
    loud = NOMINAL.replace(
        effects=(SensorNoise(force=(1.0,) * 3), SensorDrift(moment=(0.5,) * 3, time=5.0))
    )
    for template, system in ((quiet, loud), (loud, quiet)):
        sim, twin, other = (simulator(k, 3) for k in (template, template, system))
        sim.assign([system], [1])
        ends = []
        for each in (sim, twin, other):
            put(each, range(3))
            advance(each)
            ends.append(each.reset(spread={"q": 0.1}).q)
        assert (ends[0][[0, 2]] == ends[1][[0, 2]]).all()
        assert (ends[0][1] == ends[2][1]).all()
        assert (ends[1] != ends[2]).any()


# ------------------------------------------------------------------------ life of an assignment


@pytest.mark.parametrize(("system", "backend"), [(IDEAL, "mujoco"), (NOMINAL, "kernel")])
def test_again_and_back(system, backend):
    """A second assignment replaces the first; the template's own system ends it."""
    template = with_effects(system, 0)
    sim, twin = (simulator(template, 3, backend=backend) for _ in range(2))
    first = with_bodies(with_effects(template, 1), 1)
    second = first.replace(effects=with_effects(template, 2).effects)
    for each in (first, second):
        sim.assign([each, each], [0, 2])
        assert sim.systems == (each, template, each)
        put(sim, range(3))
        found = advance(sim)
        assert np.isfinite(found[3]).all()
    require_same([k[0] for k in found], alone(second, 0, backend=backend), backend)
    sim.assign([template] * 3)
    assert sim.systems == (template,) * 3
    for each in (sim, twin):
        put(each, range(3))
    require_same(advance(sim), advance(twin), backend)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("system", [IDEAL, NOMINAL], ids=["ideal", "emulated"])
def test_state_gains_and_memory_stay(system, backend):
    """Servo torque, too; but for a servo that sees older joints than before."""
    template = on_time(with_effects(system, 0))
    sim = simulator(template, 3, backend=backend)
    sim.set_gains(PPED_GAINS.kp, PPED_GAINS.kd, ids=[1])
    put(sim, range(3))
    sim.step(3.0)

    def seen():
        return [*sim.state, *(sim.readings if sim.emulation_loop else ())]

    before, gains = seen(), sim.evaluate(0.0)[0]
    sim.assign([with_bodies(on_time(with_effects(template, 1)), 1)], [1])
    require_same(seen(), before, "kernel")
    limited = np.abs(gains[1]) > 0.4 * PUMA_560.column("tau_max")
    assert (sim.evaluate(0.0)[0][[0, 2]] == gains[[0, 2]]).all()
    assert (sim.evaluate(0.0)[0][1] == gains[1])[~limited].all()
    sim.step(3.0)  # goes on without a reset
    assert np.isfinite(sim.state.q).all()


@pytest.mark.parametrize(
    ("system", "backend", "fresh"), [(IDEAL, "mujoco", False), (NOMINAL, "kernel", True)]
)
def test_a_snapshot_carries_the_assignment(system, backend, fresh):
    template = with_effects(system, 0)
    sim = simulator(template, 4, backend=backend)
    put(sim, range(4))
    plain, expected = sim.snapshot(), advance(sim)
    sim.assign([with_effects(template, 1), with_bodies(template, 2)], [1, 3])
    put(sim, range(4))
    advance(sim)
    kept = pickle.loads(pickle.dumps(sim.snapshot()))
    ahead = advance(sim)
    sim.assign([template, with_effects(template, 9)], [1, 0])
    other = simulator(template, 4, backend=backend, seed=8) if fresh else sim
    other.restore(kept)
    assert other.systems == (template, *(kept.assigned.get(i, template) for i in (1, 2, 3)))
    require_same(advance(other), ahead, "kernel")
    other.restore(plain)  # without an assignment it ends one
    assert other.systems == (template,) * 4
    require_same(advance(other), expected, backend)


def test_ids_in_any_order_as_a_mask_or_none():
    template = with_effects(IDEAL, 0)
    systems = [with_effects(IDEAL, k) for k in (1, 2)]
    a, b = simulator(template, 3), simulator(template, 3)
    a.assign(systems, [2, 0])
    b.assign(systems[::-1], np.array([True, False, True]))
    assert a.systems == b.systems == (systems[1], template, systems[0])
    a.assign([], [])
    assert a.systems == b.systems
    a.assign([*systems, template])
    assert a.systems == (*systems, template)


# ------------------------------------------------------------------------------ refusals

VISCOUS = viscous(1.0, 0.0, 2.0)
LONG = replace(PUMA_560, links=(*PUMA_560.links[:2], replace(PUMA_560.links[2], a=0.7)))
UNALIKE = [  # own system, what is other in the one given, what is said
    (IDEAL, {"mode": "emulated"}, "mode must be the simulator's 'ideal', got 'emulated'"),
    (IDEAL, {"drive": "prescribed"}, "drive must be the simulator's 'motor'"),
    (IDEAL, {"physics_dt": 6.25e-4}, "physics_dt must be the simulator's 0.00125"),
    (
        IDEAL,
        {"arm": replace(PUMA_560, links=PUMA_560.links[:2])},
        "number of joints must be the simulator's 3, got 2",
    ),
    (IDEAL, {"arm": LONG}, "a of link 3 must be the simulator's .*, got 0.7"),
    (IDEAL, {"effects": VISCOUS.effects}, "kinds of effects .* none, got joint/viscous"),
    (IDEAL, {"vehicle": FREE_FLYING}, "vehicle's kind must .* no body, got a body"),
    (
        IDEAL.replace(vehicle=FREE_FLYING),
        {"vehicle": FREE_FLOATING},
        "thrusters must be the simulator's True, got False",
    ),
    (
        NOMINAL,
        {"emulator": EmulatorSettings(delay=2)},
        "emulator.delay must be the simulator's 1, got 2",
    ),
    (
        NOMINAL,
        {"emulator": EmulatorSettings(platform=PoseServo(bandwidth=5.0))},
        "emulator.platform must be",
    ),
    (
        VISCOUS,
        {"effects": viscous(1.0, 3.0, 2.0).effects},
        r"joint/viscous#1.damping2 is 3 but 0 in the .*: give the simulator a system in which",
    ),
    (
        IDEAL.replace(vehicle=DECOUPLED),
        {"vehicle": BENT_THESIS},
        r"system of simulation 1: [MDK]\d\d is .* but 0 in the simulator's own",
    ),
]


@pytest.mark.parametrize(("own", "changes", "message"), UNALIKE)
def test_what_may_not_differ_is_named_and_nothing_is_assigned(own, changes, message):
    sim, twin = simulator(own, 2), simulator(own, 2)
    with pytest.raises(ParameterError, match=message):
        sim.assign([own.replace(arm=other_arm(0)), own.replace(**changes)])
    assert sim.systems == (own, own)
    for each in (sim, twin):
        put(each, range(2))
    require_same(advance(sim, 2), advance(twin, 2), "kernel")


def test_an_emulator_equal_in_value_is_alike():
    sim = simulator(NOMINAL, 1)
    sim.assign([NOMINAL.replace(emulator=EmulatorSettings())])
    sim.assign([System.from_dict(NOMINAL.to_dict())])


def test_bad_arguments():
    sim = simulator(IDEAL, 2)
    for systems, got in ((IDEAL, "one System"), ([IDEAL], "1"), ([IDEAL] * 3, "3")):
        with pytest.raises(ParameterError, match=f"systems must be a sequence of 2, got {got}"):
            sim.assign(systems)
    with pytest.raises(ParameterError, match="systems must hold Systems, got 'bent-thesis'"):
        sim.assign([IDEAL, "bent-thesis"])
    with pytest.raises(ParameterError, match="ids must"):
        sim.assign([IDEAL], [2])
    stiff = MatrixVehicle(
        M=diagonal(*[1.0] * 6), D=diagonal(*[1.0] * 6), K=diagonal(*[1e8] * 6)
    )
    sim = simulator(IDEAL.replace(vehicle=DECOUPLED), 1)
    with pytest.raises(ParameterError, match="physics_dt must be <="):
        sim.assign([IDEAL.replace(vehicle=stiff)])


def test_effects_that_add_up_to_nothing_are_refused():
    template = NOMINAL.replace(effects=(PlatformBandwidth(error=0.1),) * 2)
    sim = simulator(template, 2)
    with pytest.raises(ParameterError, match=r"change bandwidth by -1\.2, must be > -1"):
        sim.assign([NOMINAL.replace(effects=(PlatformBandwidth(error=-0.6),) * 2)], [1])
    assert sim.systems == (template, template)


def test_an_admittance_of_ones_own_has_no_vehicle_to_vary():
    def g(X, W):
        return np.concatenate([X[:, 6:], W / 500 - 2 * X[:, :6]], axis=-1)

    template = NOMINAL.replace(effects=(SensorBias(),))
    sim = simulator(template, 2, admittance=g)
    with pytest.raises(ParameterError, match="takes the place of every simulation's vehicle"):
        sim.assign([template.replace(vehicle=DECOUPLED)], [0])
    biased = template.replace(effects=(SensorBias(force=(1.0, 2.0, 3.0)),), arm=other_arm(1))
    sim.assign([biased], [1])
    put(sim, range(2))
    wanted = alone(biased, 1, admittance=g)
    require_same([part[1] for part in advance(sim)], wanted, "kernel")


# ---------------------------------------------------------------------- laws, batched


def test_a_law_that_takes_single_coefficients():
    """And not those of all joints, or simulations, at once."""
    kind = "joint/test_only"
    try:

        @register_effect(kind)
        @dataclasses.dataclass(frozen=True, kw_only=True)
        class Fourier(TorqueEffect):
            modes = ("ideal", "emulated")
            port = "joint"
            size: tuple = parameter("N m", bounds=(0.0, 10.0), shape=(3,))

            def law(self, q, v, tau):
                return self.size[0] * np.sin(q) - self.size[1] * v + self.size[2]

        template, *systems = (
            IDEAL.replace(effects=(JointCoulomb(torque=(1.0, 2.0, 3.0)), Fourier(size=k)))
            for k in ((1.0, 2.0, 3.0), (3.0, 1.0, 2.0), (0.5, 4.0, 1.0))
        )
        for backend in BACKENDS:
            check(template, systems, backend, ids=[0, 2], n=3)
    finally:
        EFFECTS.pop(kind, None)


def test_many_simulations_on_several_threads():
    template, n = with_effects(IDEAL, 0), 150
    systems = [with_effects(IDEAL, k) for k in range(n)]
    found = []
    for threads in (1, 2):
        sim = simulator(template, n, threads=threads)
        sim.assign(systems)
        put(sim, range(n))
        found.append(advance(sim, 2))
    require_same(*found, "kernel")


def test_no_warning_and_no_new_kernel(monkeypatch):
    """Nothing is compiled at an assignment."""
    template = with_effects(NOMINAL, 0)
    sim = simulator(template, 2)
    sim.assign([with_bodies(with_effects(template, 1), 1)], [0])  # loads the inertia map
    from ves_gym.engine.kernel import build

    def refuse(text):
        raise AssertionError("compiled")

    monkeypatch.setattr(build, "compile_text", refuse)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        sim.assign([with_bodies(with_effects(template, k), k) for k in (2, 3)])
        put(sim, range(2))
        sim.step(0.0)
