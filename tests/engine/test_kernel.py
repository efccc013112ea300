"""The compiled kernel: generated arithmetic, the cache of machine code, the traced graphs."""

import dataclasses
import os
import stat
import subprocess
import sys
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from ves_gym._util.params import ParameterError
from ves_gym.engine.backends.base import BackendWarning
from ves_gym.engine.backends.kernel import stepper
from ves_gym.engine.kernel import build, numbers, trace
from ves_gym.engine.kernel.compiled_function import CompiledFunction
from ves_gym.mechanics.arm_library import PUMA_560
from ves_gym.mechanics.link import matrix
from ves_gym.mechanics.vehicle import (
    BENT_THESIS,
    DECOUPLED,
    FREE_FLOATING,
    FREE_FLYING,
    MatrixVehicle,
)
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.emulator_settings import EmulatorSettings
from ves_gym.system.system import System

ROOT = Path(__file__).parents[2]

# ------------------------------------------------------------------ generated arithmetic


def apply(graph, *inputs):
    """Compiled value of graph(x_1, x_2, ...) at arrays of numbers: 1-D arrays in, one out."""
    x = ca.SX.sym("x", len(inputs))
    function = ca.Function("f", [x], [graph(*ca.vertsplit(x))])
    return CompiledFunction(None, lambda: function)(np.stack(inputs, axis=1))[:, 0]


def ulps(found, wanted):
    """Largest difference in units of the last place of the wanted values."""
    return float((np.abs(found - wanted) / np.spacing(np.abs(wanted))).max())


def relative(found, wanted):
    return float((np.abs(found - wanted) / np.abs(wanted)).max())


def angles():
    """Angles up to 1e5, many of them next to multiples of a quarter turn."""
    rng = np.random.default_rng(0)
    near = rng.integers(-60000, 60000, 4000) * (np.pi / 2)
    near = near + rng.choice([0.0, 1e-12, -1e-9, 1e-5], 4000)
    wide = rng.uniform(-1, 1, 8000) * 10.0 ** rng.uniform(-8, 5, 8000)
    return np.concatenate([near, wide, [0.0, np.pi, -np.pi, 1e5, -1e5]])


@pytest.mark.parametrize("kind", ["sin", "cos"])
def test_sine_and_cosine(kind):
    """Against NumPy's: 2 units of the last place; where the value is below 1e-9, absolute."""
    x = angles()
    found, wanted = apply(getattr(ca, kind), x), getattr(np, kind)(x)
    large = np.abs(wanted) > 1e-9
    assert ulps(found[large], wanted[large]) <= 2
    assert np.abs(found - wanted).max() <= 3e-16
    assert (np.abs(found) <= 1).all()


@pytest.mark.parametrize("kind", ["sin", "cos", "exp", "tanh", "sqrt", "fabs"])
def test_what_is_not_a_number_comes_through(kind):
    """Each in its own lane. NaNs of any payload: its bits must not act as a number."""
    payload = np.array([0x7FF8000000000001, 0xFFF8000000ABCDEF], np.uint64).view(float)
    x = np.array([1.0, np.nan, 0.5, payload[0], 0.25, payload[1], 2.0, -np.nan])
    found = apply(getattr(ca, kind), x)
    assert np.isnan(found[1::2]).all()
    np.testing.assert_allclose(found[::2], getattr(np, kind)(x[::2]), rtol=1e-14)


def test_angles_without_end_have_no_sine():
    with np.errstate(invalid="ignore"):
        for kind in (ca.sin, ca.cos):
            assert np.isnan(apply(kind, np.array([np.inf, -np.inf]))).all()


def test_exponential():
    rng = np.random.default_rng(1)
    x = np.concatenate([rng.uniform(-708, 709, 20000), rng.uniform(-1, 1, 5000), [0.0, 709.0]])
    assert relative(apply(ca.exp, x), np.exp(x)) <= 1e-15
    ends = np.array([-708.1, -1e4, -np.inf, 709.1, 1e300, np.inf, 0.0, -1e-320])
    np.testing.assert_array_equal(
        apply(ca.exp, ends), [0.0, 0.0, 0.0, np.inf, np.inf, np.inf, 1.0, 1.0]
    )


def test_hyperbolic_tangent():
    rng = np.random.default_rng(2)
    sizes = 10.0 ** rng.uniform(-300, 2, 20000)
    x = np.concatenate([sizes, -sizes, rng.uniform(-0.1, 0.1, 5000), [0.05, -0.05]])
    found = apply(ca.tanh, x)
    assert relative(found, np.tanh(x)) <= 1e-15
    assert (np.abs(found) <= 1).all()
    ends = np.array([0.0, -0.0, 400.0, -400.0, 1e300, np.inf, -np.inf])
    limits = apply(ca.tanh, ends)
    np.testing.assert_array_equal(limits, [0, 0, 1, -1, 1, 1, -1])
    assert np.signbit(limits[1])


NUMBERS = np.array([-np.inf, -2.5, -1.0, -0.0, 0.0, 1.0, 2.5, np.inf, np.nan, 5e-324])
A, B = (k.ravel() for k in np.meshgrid(NUMBERS, NUMBERS))

TWO = {
    "+": (lambda a, b: a + b, np.add),
    "-": (lambda a, b: a - b, np.subtract),
    "*": (lambda a, b: a * b, np.multiply),
    "/": (lambda a, b: a / b, np.divide),
    "fmin": (ca.fmin, np.minimum),  # NumPy's minimum, as ours, hands NaN on
    "fmax": (ca.fmax, np.maximum),
    "<": (lambda a, b: a < b, np.less),
    "<=": (lambda a, b: a <= b, np.less_equal),
    ">": (lambda a, b: a > b, np.greater),
    ">=": (lambda a, b: a >= b, np.greater_equal),
    "==": (lambda a, b: a == b, np.equal),
    "!=": (lambda a, b: a != b, np.not_equal),
    "and": (
        lambda a, b: ca.logic_and(a > 0, b > 0),
        lambda a, b: np.logical_and(a > 0, b > 0),
    ),
    "if_else": (
        lambda a, b: ca.if_else(a > b, a, b),
        lambda a, b: np.where(a > b, a, b),
    ),
    "clipped": (
        lambda a, b: ca.fmin(ca.fmax(a, -b), b),
        lambda a, b: np.minimum(np.maximum(a, -b), b),
    ),
}
ONE = {
    "neg": (lambda a: -a, np.negative),
    "square": (lambda a: a * a, np.square),
    "twice": (lambda a: a + a, lambda a: a + a),
    "inverse": (lambda a: 1 / a, lambda a: 1 / a),
    "sqrt": (ca.sqrt, np.sqrt),
    "fabs": (ca.fabs, np.abs),
    "sign": (ca.sign, lambda a: np.where(a == 0, a, np.sign(a))),  # zero keeps its own
    "not": (lambda a: ca.logic_not(a > 0), lambda a: ~(a > 0)),
}


@pytest.mark.parametrize("kind", TWO)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_operations_of_two(kind):
    """Every pair of numbers, infinities, NaN and the smallest: exactly NumPy's answer."""
    graph, reference = TWO[kind]
    np.testing.assert_array_equal(apply(graph, A, B), reference(A, B))


@pytest.mark.parametrize("kind", ONE)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_operations_of_one(kind):
    graph, reference = ONE[kind]
    x = np.concatenate([NUMBERS, np.random.default_rng(3).normal(size=100)])
    found, wanted = apply(graph, x), np.asarray(reference(x), float)
    np.testing.assert_array_equal(found, wanted)
    known = ~np.isnan(x)
    np.testing.assert_array_equal(np.signbit(found[known]), np.signbit(wanted[known]))


def test_constants_are_exact():
    for value in (0.1, 1 / 3, 1e-308, 5e-324, -1.7976931348623157e308):
        np.testing.assert_array_equal(apply(lambda x, k=value: x * 0 + k, np.ones(2)), value)


@pytest.mark.parametrize("kind", ["asin", "atan2", "sinh", "log1p"])
def test_an_operation_without_code_is_refused(kind):
    two = kind == "atan2"
    graph = getattr(ca, kind)
    with pytest.raises(ParameterError, match=r"cannot compile operation .*it knows .*tanh"):
        apply(graph, *[np.zeros(2)] * (1 + two))


# ------------------------------------------------------------------------------- traces


def full(scale=1.0):
    """A vehicle that couples every pair of coordinates."""
    root = np.random.default_rng(0).normal(size=(6, 6))
    M, D, K = (matrix(scale * s * (root @ root.T + np.eye(6))) for s in (80.0, 60.0, 900.0))
    return MatrixVehicle(M=M, D=D, K=K, source="test")


SYSTEMS = {
    "bent-thesis": System(vehicle=BENT_THESIS),
    "decoupled": System(vehicle=DECOUPLED),
    "full": System(vehicle=full()),
    "satellite": System(vehicle=FREE_FLOATING),
    "prescribed": System(vehicle=BENT_THESIS, drive="prescribed"),
    "implicit": System(vehicle=BENT_THESIS, integrator="implicitfast"),
    "emulated": System(vehicle=BENT_THESIS, mode="emulated"),
    "own weight": System(
        vehicle=BENT_THESIS, mode="emulated", emulator=EmulatorSettings(joint_balance=False)
    ),
}


@pytest.mark.parametrize("name", SYSTEMS)
def test_parameters_are_those_of_the_graph(name):
    names, values = numbers.parameters(SYSTEMS[name])
    graphs = trace.equations(SYSTEMS[name])
    assert names == graphs.names
    assert len(set(names)) == len(names) == len(values) == graphs.motion.size1_in(2)
    p, base = dict(zip(names, values, strict=True)), SYSTEMS[name].base
    assert p["link2.mass"] == PUMA_560.links[1].inertial.mass and p["kp1"] == p["kd1"] == 0.0
    if name == "full":
        assert all(p[f"K{i + 1}{j + 1}"] == base.K[i, j] for i in range(6) for j in range(i, 6))


def test_structural_zeros_vanish():
    names, _ = numbers.parameters(System(vehicle=DECOUPLED))
    assert [k for k in names if k[0] == "K"] == [f"K{i}{i}" for i in range(1, 7)]
    satellite, _ = numbers.parameters(System(vehicle=FREE_FLOATING))
    assert not [k for k in satellite if k[0] in "MDK" and k[1:].isdigit()]
    assert "satellite.mass" in satellite
    assert "satellite.com1" not in satellite  # it is zero
    size = {k: trace.equations(s).motion.n_instructions() for k, s in SYSTEMS.items()}
    assert size["satellite"] < size["decoupled"] < size["full"]
    assert size["own weight"] < size["emulated"]  # the balance is not for nothing


def test_derivatives_along_one_and_along_many_are_the_same():
    """Few directions are differentiated one by one, many by the derivative of the state."""
    names = ("K11", "link2.mass", "D55", "base.mass", "kp1")
    one, many = (
        trace._tangents(System(vehicle=BENT_THESIS), names, 1, whole).motion
        for whole in (False, True)
    )
    rng = np.random.default_rng(0)
    x, u = 0.1 * rng.standard_normal(one.size1_in(0)), rng.standard_normal(one.size1_in(1))
    p = numbers.parameters(System(vehicle=BENT_THESIS))[1]
    expected = one(x, u, p).full()
    np.testing.assert_allclose(many(x, u, p).full(), expected, rtol=1e-10, atol=1e-9)


# -------------------------------------------------------------------------------- cache


@pytest.fixture
def compilations(monkeypatch):
    """How often the compiler runs."""
    calls, real = [], build.compile_text

    def counted(text):
        calls.append(text)
        return real(text)

    monkeypatch.setattr(build, "compile_text", counted)
    return calls


SMALL = System(vehicle=DECOUPLED, drive="prescribed", integrator="euler")


def stepped(system=SMALL):
    """State after a step, compiled or loaded anew."""
    build._functions.clear()
    state = Simulator(system, 2, backend="kernel").step([1.0, -2.0, 0.5])
    return b"".join(part.tobytes() for part in state)


def test_what_is_in_the_cache_is_not_compiled_again(empty_store, compilations):
    first = stepped()
    assert len(compilations) == 1
    (file,) = empty_store.iterdir()
    before = file.stat().st_mtime_ns
    assert stepped() == first
    assert len(compilations) == 1
    assert file.stat().st_mtime_ns == before
    if os.name == "posix":
        assert stat.S_IMODE(file.stat().st_mode) & 0o600 == 0o600


BROKEN = {
    "truncated": lambda data: data[:-1],
    "a bit flipped": lambda data: data[:-100] + bytes([data[-100] ^ 1]) + data[-99:],
    "another format": lambda data: b"ves-code/0\n" + data[11:],
    # whole, and what another processor's file is called
    "another name": lambda data: build._mark("0" * 32, data[43:]) + data[43:],
}


@pytest.mark.parametrize("how", BROKEN)
def test_a_broken_file_is_made_anew(how, empty_store, compilations):
    first = stepped()
    (file,) = empty_store.iterdir()
    good = file.read_bytes()
    file.write_bytes(BROKEN[how](good))
    assert stepped() == first
    assert len(compilations) == 2
    assert file.read_bytes() == good
    stepped()
    assert len(compilations) == 2


@pytest.mark.skipif(os.name != "posix", reason="owners and modes are POSIX's")
@pytest.mark.parametrize("what", ["folder", "file"])
@pytest.mark.parametrize("fault", ["others write", "another's"])
def test_code_that_others_could_have_put_there_is_not_run(
    what, fault, empty_store, compilations, monkeypatch
):
    """Claim: a folder or file of the cache that others can write to, or that belongs to another
    user, is compiled anew, and a folder is named; one of one's own is 0700, its files 0600.
    """
    first = stepped()
    (file,) = empty_store.iterdir()
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    at, private = (empty_store if what == "folder" else file), build._is_private
    if fault == "others write":
        at.chmod(0o777)
    else:
        which = at.stat().st_ino
        monkeypatch.setattr(
            build, "_is_private", lambda about: about.st_ino != which and private(about)
        )
    build._warn_of.cache_clear()
    if what == "folder":
        with pytest.warns(RuntimeWarning, match="chmod 700"):
            assert stepped() == first
    else:
        assert stepped() == first
    assert len(compilations) == 2


@pytest.mark.skipif(os.name != "posix", reason="modes are POSIX's")
def test_the_cache_is_the_users_alone(tmp_path, monkeypatch):
    monkeypatch.setenv("VES_GYM_CACHE", str(tmp_path / "new"))
    monkeypatch.setattr(build, "_functions", {})
    stepped()
    assert stat.S_IMODE((tmp_path / "new").stat().st_mode) == 0o700


def test_a_cache_that_cannot_be_written_does_not_matter(tmp_path, monkeypatch, compilations):
    """A file stands where the folder should be: so it is for root too."""
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setattr(build, "_functions", {})
    monkeypatch.setenv("VES_GYM_CACHE", str(tmp_path / "file" / "cache"))
    first = stepped()
    assert stepped() == first
    assert len(compilations) == 2
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_where_the_cache_is(monkeypatch, tmp_path):
    monkeypatch.setenv("VES_GYM_CACHE", str(tmp_path))
    assert build.cache_folder() == tmp_path
    monkeypatch.delenv("VES_GYM_CACHE")
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert build.cache_folder() == tmp_path / "ves_gym"
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert build.cache_folder() == tmp_path / ".cache" / "ves_gym"
    monkeypatch.setattr(sys, "platform", "darwin")
    assert build.cache_folder() == tmp_path / "Library" / "Caches" / "ves_gym"


def test_without_a_home_nothing_is_kept(monkeypatch):
    def none(*_):
        raise RuntimeError("Could not determine home directory.")

    for name in ("VES_GYM_CACHE", "XDG_CACHE_HOME", "HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(build.Path, "home", none)
    assert build._own_folder() is None


def links(**changes):
    """The PUMA with its second link changed."""
    every = list(PUMA_560.links)
    every[1] = dataclasses.replace(every[1], **changes)
    return dataclasses.replace(PUMA_560, links=tuple(every))


SECOND = PUMA_560.links[1]
HEAVIER = dataclasses.replace(SECOND.inertial, mass=20.0)


def changed(**options):
    return System(**{"vehicle": BENT_THESIS, **options})


VALUES = {  # the same code
    "mass": changed(arm=links(inertial=HEAVIER)),
    "rotor": changed(arm=links(rotor_inertia=3.3)),
    "limit": changed(arm=links(tau_max=11.0, q_max=1.0)),
    "beam": changed(vehicle=dataclasses.replace(BENT_THESIS, outer_diameter=0.2)),
    "step": changed(physics_dt=6.25e-4, control_dt=25e-3),
    "name": changed(arm=dataclasses.replace(PUMA_560, name="other")),
}
STRUCTURES = {  # other code
    "length": changed(arm=links(a=0.5)),
    "twist": changed(arm=links(alpha=0.1)),
    "offset": changed(arm=links(offset=0.1)),
    "no rotor": changed(arm=links(rotor_inertia=0.0)),
    "joints": changed(arm=dataclasses.replace(PUMA_560, links=PUMA_560.links[:2])),
    "vehicle": changed(vehicle=DECOUPLED),
    "satellite": changed(vehicle=FREE_FLOATING),
    "euler": changed(integrator="euler"),
    "implicitfast": changed(integrator="implicitfast"),
    "its step": changed(integrator="implicitfast", physics_dt=6.25e-4),
    "emulated": SYSTEMS["emulated"],
    "unbalanced": SYSTEMS["own weight"],
}


@pytest.mark.parametrize("name", VALUES)
def test_values_are_no_structure(name):
    assert numbers.structure(VALUES[name]) == numbers.structure(System(vehicle=BENT_THESIS))
    assert stepper(VALUES[name]).digest == stepper(System(vehicle=BENT_THESIS)).digest


def test_structures_differ():
    keys = {name: numbers.structure(system) for name, system in STRUCTURES.items()}
    keys["here"] = numbers.structure(System(vehicle=BENT_THESIS))
    assert len(set(keys.values())) == len(keys)


_SCRIPT = """
import sys
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.system import System
from ves_gym.mechanics.vehicle import DECOUPLED
sim = Simulator(System(vehicle=DECOUPLED, drive="prescribed", integrator="euler"), 2)
state = sim.step([1.0, -2.0, 0.5])
sys.stdout.write(sim.backend_name + b"".join(part.tobytes() for part in state).hex())
"""


@pytest.mark.slow
@pytest.mark.parametrize("count", [50])
def test_processes_that_start_together_share_an_empty_cache(count, empty_store):
    """All give the same answer, and one whole file is left."""
    environment = {**os.environ, "VES_GYM_CACHE": str(empty_store), "OMP_NUM_THREADS": "1"}
    started = [
        subprocess.Popen(
            [sys.executable, "-W", "error", "-c", _SCRIPT],
            cwd=ROOT,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        for _ in range(count)
    ]
    found = [process.communicate() for process in started]
    assert all(process.returncode == 0 for process in started), found
    assert {out for out, _ in found} == {"kernel" + stepped().hex()}
    (file,) = empty_store.iterdir()
    assert build._read(file) is not None


# ----------------------------------------------------------------------------- fallback


def test_without_a_compiler_mujoco_runs_and_says_so(no_compiler):
    with pytest.warns(BackendWarning, match=r"no code for this machine\); MuJoCo runs") as seen:
        sim = Simulator(System(vehicle=BENT_THESIS))
    assert sim.backend_name == "mujoco"
    assert len(seen) == 1
    with pytest.raises(ParameterError, match=r"backend kernel: .*RuntimeError: no code"):
        Simulator(System(vehicle=BENT_THESIS), backend="kernel")


def test_without_llvmlite_mujoco_runs_and_says_so(empty_store, monkeypatch):
    monkeypatch.setitem(sys.modules, "llvmlite", None)
    monkeypatch.setitem(sys.modules, "llvmlite.binding", None)
    with pytest.warns(BackendWarning, match="llvmlite"):
        assert Simulator(System(vehicle=BENT_THESIS)).backend_name == "mujoco"


def test_a_snapshot_of_another_engine_is_refused():
    ours, other = (
        Simulator(System(vehicle=BENT_THESIS), backend=k) for k in ("kernel", "mujoco")
    )
    with pytest.raises(
        ParameterError, match=r"on backend mujoco, this is .* on backend kernel"
    ):
        ours.restore(other.snapshot())


# ------------------------------------------------------------------- what is reported


def test_jets_act_in_their_period_only():
    """What `evaluate` says after a push is what it says in the same state without one."""
    sim, fresh = (Simulator(System(vehicle=FREE_FLYING), backend="kernel") for _ in range(2))
    state = sim.step(1.0, base_wrench=[[50.0, 0, 0, 0, 9.0, 0]])
    fresh.reset(q=state.q, v=state.v, y=state.y, yd=state.yd)
    for a, b in zip(sim.evaluate(0.0), fresh.evaluate(0.0), strict=True):
        np.testing.assert_array_equal(a, b)


def test_importing_the_package_brings_no_compiler():
    code = (
        "import sys, ves_gym, ves_gym.simulation.simulator, ves_gym.simulation.playback;"
        "print(*{name.partition('.')[0] for name in sys.modules})"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert not {"casadi", "llvmlite"} & set(result.stdout.split())
