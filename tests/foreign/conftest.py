"""Others' programs as judges, each in an environment of its own: `make test-foreign`.

A test writes physical data (arrays, a URDF), runs a script beside it with the program's own
interpreter, which imports nothing of this package, and compares what comes back. Without the
environment a test is skipped, by `make test-foreign` failed.
"""

import os
import subprocess
from pathlib import Path

import numpy as np
import pytest

HERE = Path(__file__).parent
PLACE = HERE.parents[1] / ".venv-foreign"


@pytest.fixture
def foreign(tmp_path):
    """Return a function that runs `SCRIPT.py` by a program's interpreter: arrays in, out."""

    def run(program, script, **arrays):
        python = PLACE / program / "bin" / "python"
        if not python.exists():
            refuse = pytest.fail if os.environ.get("VES_GYM_FOREIGN") else pytest.skip
            refuse(f"{program} is not there: make test-foreign installs it")
        given, answer = tmp_path / f"{script}-in.npz", tmp_path / f"{script}-out.npz"
        np.savez(given, **arrays)
        command = [str(python), "-P", str(HERE / f"{script}.py"), str(given), str(answer)]
        clean = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
        done = subprocess.run(command, capture_output=True, text=True, env=clean)
        assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
        with np.load(answer) as out:
            return dict(out)

    return run


def difference(theirs, ours):
    """Largest difference, relative to the largest entry of ours."""
    return float(np.abs(theirs - ours).max() / np.abs(ours).max())
