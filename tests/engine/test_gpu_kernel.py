"""The kernel as Warp code: generated arithmetic, and the `Backend` methods on the CPU device.

tests/claims/test_gpu_kernel_gives_the_same_answers.py holds whole runs to the kernel's.
"""

import casadi as ca
import numpy as np
import pytest

from tests.arms import heavier
from tests.engine.test_kernel import NUMBERS, ONE, TWO
from ves_gym._util.optional import installed
from ves_gym._util.params import ParameterError
from ves_gym.engine.backends.base import BackendWarning
from ves_gym.engine.backends.kernel import stepper
from ves_gym.engine.kernel.compiled_function import CompiledFunction
from ves_gym.engine.kernel.scalar import statements
from ves_gym.mechanics.vehicle import BENT_THESIS
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.system import System

warp_needed = pytest.mark.skipif(not installed("warp"), reason="warp-lang is not installed")
pytestmark = pytest.mark.filterwarnings("ignore:backend gpu-kernel:UserWarning")

CURVES = {
    kind: (getattr(ca, kind), getattr(np, kind)) for kind in ("sin", "cos", "exp", "tanh")
}


def evaluate(operations, real, *inputs):
    """Rows of values of the operations at arrays of numbers, in one compilation."""
    from ves_gym.engine.kernel import warp_code

    wp = warp_code.load_warp()
    x, p = ca.SX.sym("x", len(inputs)), ca.SX.sym("p")
    values = ca.vertcat(*(graph(*ca.vertsplit(x)) for graph, _ in operations.values()))
    graph = ca.Function("many", [x, p], [values])
    kernel = CompiledFunction(None, lambda: graph).gpu(real, shared=(1,))
    number, n = getattr(wp, real), len(inputs[0])
    points = wp.array(np.array(inputs), dtype=number, device="cpu")
    out = wp.zeros((len(operations), n), dtype=number, device="cpu")
    none = wp.zeros((1, 1), dtype=number, device="cpu")
    warp_code.launch_graph(kernel, [points, none, out], wp.get_device("cpu"))
    return dict(zip(operations, out.numpy(), strict=True))


@warp_needed
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_operations_are_those_of_numpy():
    """Infinities, NaN, signed zeros and the smallest number included: exactly."""
    first, second = (k.ravel() for k in np.meshgrid(NUMBERS, NUMBERS))
    found = evaluate(TWO, "float64", first, second)
    for kind, (_, reference) in TWO.items():
        np.testing.assert_array_equal(found[kind], reference(first, second), kind)
    x = np.concatenate([NUMBERS, np.random.default_rng(3).normal(size=100)])
    found = evaluate(ONE | CURVES, "float64", x)
    for kind, (_, reference) in ONE.items():
        np.testing.assert_array_equal(found[kind], np.asarray(reference(x), float), kind)
    for kind, (_, reference) in CURVES.items():
        np.testing.assert_allclose(found[kind], reference(x), rtol=4e-16, err_msg=kind)


def test_an_operation_without_code_is_refused():
    x = ca.SX.sym("x")
    graph = ca.Function("f", [x], [ca.asin(x)])
    with pytest.raises(ParameterError, match=r"cannot compile operation .*it knows .*tanh"):
        statements(graph, lambda which, row: "x", "v")


# ------------------------------------------------------------------- as a backend


def pair(system, n=5, **options):
    """The same simulations on both engines."""
    sims = [Simulator(system, n, backend=k, **options) for k in ("gpu-kernel", "kernel")]
    q = np.random.default_rng(0).uniform(-0.5, 0.5, (n, sims[0].joints))
    for sim in sims:
        sim.reset(q=q, y=0.01, yd=-0.02)
    return sims


def same(sims, tolerance=1e-12):
    for ours, theirs in zip(*(sim.state for sim in sims), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=tolerance)


@warp_needed
def test_commands_held_and_linear_one_by_one_and_in_sequence():
    sims = pair(System(vehicle=BENT_THESIS))
    rng = np.random.default_rng(1)
    for k in range(6):
        start, end, more = rng.normal(0, 30, (3, 5, 3))
        walk = np.cumsum(rng.normal(0, 3, (5, 17, 3)), axis=1)
        for sim in sims:
            sim.step(start, until=end if k % 2 else None)
            sim.play(walk)
        same(sims)
        for ours, theirs in zip(*(sim.evaluate(more) for sim in sims), strict=True):
            np.testing.assert_allclose(ours, theirs, rtol=1e-11, atol=1e-11)
    gpu = sims[0]
    assert gpu.backend_name == "gpu-kernel"
    snapshot, ends = gpu.snapshot(), []
    for _ in range(2):  # bit for bit
        gpu.restore(snapshot)
        for k in range(3):
            gpu.step(start + k)
        ends.append(gpu.state)
    for first, again in zip(*ends, strict=True):
        np.testing.assert_array_equal(first, again)


@warp_needed
def test_simulations_with_numbers_of_their_own_do_not_meet():
    """Other masses and gains, some reset, one that diverges: the neighbours run on alike."""
    system = System(vehicle=BENT_THESIS)
    sims = pair(system, on_divergence="mark")
    heavy = [heavier(system, share) for share in (1.1, 0.8)]
    for sim in sims:
        sim.assign(heavy, [1, 3])
        sim.set_gains([500.0] * 3, [20.0] * 3, ids=[2])
        sim.step(40.0)
        sim.reset(q=0.3, ids=[4])
        sim.step(-20.0)
        state = sim.state
        sim.backend.write(np.array([0]), np.zeros(1), np.full((1, 9), np.nan), np.zeros((1, 9)))
        for _ in range(3):
            sim.step(10.0)
        assert sim.diverged.tolist() == [True, False, False, False, False]
        assert np.isfinite(state.q).all()
    for ours, theirs in zip(*(sim.state for sim in sims), strict=True):
        np.testing.assert_allclose(ours[1:], theirs[1:], rtol=0, atol=1e-12)


@warp_needed
def test_without_a_gpu_that_is_said():
    from ves_gym.engine.kernel.warp_code import load_warp

    if load_warp().is_cuda_available():
        pytest.skip("there is a GPU")
    with pytest.warns(
        BackendWarning, match="gpu-kernel finds no GPU .* backend kernel is faster"
    ):
        Simulator(System(vehicle=BENT_THESIS), backend="gpu-kernel")


@pytest.mark.skipif(installed("warp"), reason="warp-lang is installed")
def test_what_is_missing_is_said():
    with pytest.raises(ParameterError, match=r"gpu-kernel needs the package warp-lang: .*gpu"):
        Simulator(System(vehicle=BENT_THESIS), backend="gpu-kernel")


@warp_needed
@pytest.mark.parametrize("real", ["float64", "float32"])
def test_the_text_compiles_for_a_gpu(real, tmp_path):
    """To machine code of an H100 or H200: NVRTC needs no driver."""
    from ves_gym.engine.kernel.warp_code import load_warp

    wp = load_warp()
    system = System(vehicle=BENT_THESIS, mode="emulated")
    module = stepper(system).gpu_steps(real, record=False).module
    try:
        files = wp.compile_aot_module(module, arch=90, use_ptx=False, module_dir=tmp_path)
    except RuntimeError as error:
        pytest.skip(f"this Warp compiles for no GPU: {error}")
    assert [path.suffix for path in files] == [".cubin"]
    assert files[0].stat().st_size > 20_000
