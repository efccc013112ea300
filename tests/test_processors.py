"""`make test-processors`: what it switches off, and what all independence rests on."""

import os
import subprocess
import sys

import numpy as np
import pytest

from tests.processors import SETS, main, switches, switches_of_this_machine
from ves_gym.mechanics.spatial import matvec

DISPATCH = ("X86_V3", "X86_V4", "AVX512_ICL", "AVX512_SPR")  # NumPy 2.4's
OLD = ("SSE42", "AVX", "F16C", "FMA3", "AVX2", "AVX512F", "AVX512_SKX")  # NumPy 2.0's
NEHALEM = {"SSE42": True}
HASWELL = {**NEHALEM, "FMA3": True, "AVX2": True, "X86_V3": True, "X86_V4": False}
SKYLAKE = {**HASWELL, "X86_V4": True, "AVX512F": True, "AVX512_SKX": True}
LLVM = {"avx": True, "avx2": True, "fma": True, "fma4": False, "avx512f": True}


@pytest.mark.parametrize(
    ("dispatch", "features", "expected"),
    [
        (DISPATCH, SKYLAKE, ["X86_V4", "X86_V3 X86_V4"]),
        (OLD, SKYLAKE, ["AVX512F AVX512_SKX", "FMA3 AVX2 AVX512F AVX512_SKX"]),
        (DISPATCH, HASWELL, [None, "X86_V3"]),
        (DISPATCH, NEHALEM, [None, None]),
    ],
    ids=["wide", "wide, older NumPy", "AVX2 only", "neither"],
)
def test_only_what_the_processor_has_is_switched_off(dispatch, features, expected):
    """NumPy warns of what it cannot disable, and a warning is an error here."""
    sets = [switches(k, dispatch, features, LLVM) for k in SETS]
    assert [k.get("NPY_DISABLE_CPU_FEATURES") for k in sets] == expected
    assert [k["VES_GYM_FEATURES"] for k in sets] == ["-avx512f", "-avx2,-avx512f,-fma"]
    blas = None if features is NEHALEM else "Haswell"  # whose code it could not run
    assert [k.get("OPENBLAS_CORETYPE") for k in sets] == [blas, "Nehalem"]


def test_an_unknown_set_is_refused(capsys):
    assert main(["no-avx"]) == main([]) == 2
    assert "must be one of no-avx512, no-avx2, got no-avx\n" in capsys.readouterr().err


@pytest.mark.parametrize("name", SETS)
def test_the_switches_act(name):
    """In a process of its own: NumPy, both OpenBLAS libraries and the kernel do without."""
    code = """
import warnings
warnings.simplefilter("error")
import scipy.linalg
import threadpoolctl
from numpy._core._multiarray_umath import __cpu_dispatch__, __cpu_features__
from ves_gym.leaderboard.fingerprint import simd
pools = [k["architecture"] for k in threadpoolctl.threadpool_info() if "architecture" in k]
print(" ".join(k for k in __cpu_dispatch__ if __cpu_features__[k]))
print(" ".join(pools))
print(simd())
"""
    changed = switches_of_this_machine(name)
    if not changed:
        pytest.skip("not an x86 processor: there is nothing to switch off")
    reply = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, **changed},
        capture_output=True,
        text=True,
    )
    assert reply.returncode == 0, reply.stderr
    numpy, pools, kernel = (k.split() for k in reply.stdout.splitlines())
    gone = {"no-avx512": ("avx512", "x86_v4"), "no-avx2": ("avx512", "x86_v", "avx2", "fma")}
    for each in numpy + kernel[1:]:
        assert not each.lower().startswith(gone[name])
    if "OPENBLAS_CORETYPE" in changed:
        assert set(pools) <= {changed["OPENBLAS_CORETYPE"]}


# ------------------------------------------------------- what all independence rests on

FUNCTIONS = ["sin", "cos", "tan", "arcsin", "arccos", "arctan", "sinh", "cosh", "tanh", "exp"]
FUNCTIONS += ["log", "sqrt", "fabs", "square"]
PAIRS = ["add", "multiply", "divide", "arctan2", "hypot", "power", "fmin", "fmax"]


@pytest.mark.bits
@pytest.mark.parametrize("name", FUNCTIONS + PAIRS)
def test_functions_round_alike_in_every_place(name):
    """Whole vectors and remainders, contiguous and strided: laws need not go one by one."""
    rng = np.random.default_rng(0)
    x = np.r_[rng.uniform(-1, 1, 500), rng.normal(size=500) * 10 ** rng.uniform(-9, 9, 500)]
    function = getattr(np, name)
    if name in PAIRS:
        pair = getattr(np, name)
        function = lambda k: pair(np.abs(k), 0.7)  # noqa: E731
    spaced = np.zeros((len(x), 3))
    spaced[:, 1] = x
    with np.errstate(all="ignore"):
        full = function(x)
        assert function(spaced[:, 1]).tobytes() == full.tobytes()
        for size in (1, 2, 3, 5, 7, 8, 9, 17):
            parts = [function(x[k : k + size]) for k in range(0, len(x), size)]
            assert np.concatenate(parts).tobytes() == full.tobytes()


@pytest.mark.bits
@pytest.mark.parametrize("size", [2, 3, 5, 6, 9, 12])
def test_stacked_products_are_alike_in_every_place(size):
    """Products of matrices with vectors and solutions, one simulation at a time inside.

    Not so (n, k) @ (k, m), all simulations in one product: there BLAS rounds by n.
    """
    rng = np.random.default_rng(size)
    A, B = rng.normal(size=(2, 19, size, size))
    x = rng.normal(size=(19, size))
    operations = (
        lambda A, B, x: A @ B,
        lambda A, B, x: A @ B[:1],
        lambda A, B, x: matvec(A, x),
        lambda A, B, x: np.swapaxes(A, -1, -2) @ x[..., None],
        lambda A, B, x: np.linalg.solve(A, x[..., None]),
        lambda A, B, x: np.linalg.inv(A),
        lambda A, B, x: np.linalg.eigh(A + np.swapaxes(A, -1, -2)).eigenvectors,
    )
    for k, operation in enumerate(operations):
        full = operation(A, B, x)
        for first, last in ((0, 1), (4, 5), (3, 8), (2, 19)):
            # B[:1] stands for a matrix that all simulations share
            part = operation(A[first:last], B if k == 1 else B[first:last], x[first:last])
            assert part.tobytes() == full[first:last].tobytes(), k
