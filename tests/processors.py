"""Compare bits as on a processor that can do less: `python -m tests.processors no-avx512`.

NumPy, OpenBLAS and the compiled kernel choose their code by the processor; so do glibc's
functions, torch and MKL. Each has a switch of its own, set here before any of them loads.
Only what this processor has is switched off: NumPy warns about the rest, and here warnings
are errors. On a processor without AVX-512 the set `no-avx512` therefore is what it is anyway,
on one without AVX2 and FMA both are, and on one that is not x86 nothing is switched.
"""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path

SETS = ("no-avx512", "no-avx2")
# Names in NumPy (2.4 has groups, 2.0 single sets) and LLVM begin with these.
_NUMPY = {"no-avx512": ("AVX512", "X86_V4")}
_NUMPY["no-avx2"] = (*_NUMPY["no-avx512"], "AVX2", "FMA3", "X86_V3")
_LLVM = {"no-avx512": ("avx512", "avx10")}
_LLVM["no-avx2"] = (*_LLVM["no-avx512"], "avx2", "fma")
_GLIBC = {"no-avx512": ("AVX512F", "AVX512VL", "AVX512BW", "AVX512DQ", "AVX512CD")}
_GLIBC["no-avx2"] = (*_GLIBC["no-avx512"], "AVX2", "FMA")
# The processor whose code OpenBLAS takes, and what it needs by NumPy's names.
_BLAS = {"no-avx512": ("Haswell", ("AVX2", "FMA3")), "no-avx2": ("Nehalem", ("SSE42",))}
_TORCH = {"no-avx512": "avx2", "no-avx2": "default"}
_MKL = {"no-avx512": "AVX2", "no-avx2": "SSE4_2"}


def switches(
    name: str, dispatch: Iterable[str], numpy: Mapping[str, bool], llvm: Mapping[str, bool]
) -> dict[str, str]:
    """Return the environment variables of a feature set on an x86 processor.

    Args:
        name: one of SETS.
        dispatch: names by which this NumPy chooses its code.
        numpy: the processor's features by NumPy's names.
        llvm: the same by LLVM's.
    """
    out = {
        "GLIBC_TUNABLES": "glibc.cpu.hwcaps=" + ",".join(f"-{k}" for k in _GLIBC[name]),
        "ATEN_CPU_CAPABILITY": _TORCH[name],
        "MKL_ENABLE_INSTRUCTIONS": _MKL[name],
    }
    groups = [k for k in dispatch if numpy.get(k) and k.startswith(_NUMPY[name])]
    if groups:
        out["NPY_DISABLE_CPU_FEATURES"] = " ".join(groups)
    features = sorted(k for k in llvm if llvm[k] and k.startswith(_LLVM[name]))
    if features:
        out["VES_GYM_FEATURES"] = ",".join(f"-{k}" for k in features)
    core, needs = _BLAS[name]
    if all(numpy.get(k) for k in needs):
        out["OPENBLAS_CORETYPE"] = core
    return out


def switches_of_this_machine(name: str) -> dict[str, str]:
    """Return the environment variables of a feature set; none where it is not x86."""
    import llvmlite.binding as llvm
    from numpy._core._multiarray_umath import __cpu_dispatch__, __cpu_features__

    if platform.machine().lower() not in ("x86_64", "amd64"):
        return {}
    # what is switched off already reads as if the processor had it not
    off = os.environ.get("NPY_DISABLE_CPU_FEATURES", "").split()
    features = {**__cpu_features__, **dict.fromkeys(off, True)}
    return switches(name, __cpu_dispatch__, features, llvm.get_host_cpu_features())


def marked_files() -> list[str]:
    """Return the test files that carry the mark `bits`: to collect all others takes long."""
    folder = Path(__file__).parent
    files = sorted(folder.rglob("test_*.py"))
    return [os.fspath(k) for k in files if "pytest.mark.bits" in k.read_text(encoding="utf-8")]


def main(arguments: list[str]) -> int:
    """Run the tests that compare bits; return pytest's exit status.

    Args:
        arguments: the name of a set, then options for pytest; files among them stand for all.
    """
    if not arguments or arguments[0] not in SETS:
        value = arguments[0] if arguments else "none"
        print(f"feature set must be one of {', '.join(SETS)}, got {value}", file=sys.stderr)
        return 2
    name, *options = arguments
    changed = switches_of_this_machine(name)
    words = " ".join(f"{k}={v!r}" for k, v in changed.items())
    print(f"{name}: {words or 'nothing to switch off'}", flush=True)
    chosen = any(Path(k.partition("::")[0]).exists() for k in options)
    files = [] if chosen else marked_files()
    command = [sys.executable, "-m", "pytest", "-m", "bits and not slow", *options, *files]
    return subprocess.run(command, env={**os.environ, **changed}).returncode


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
