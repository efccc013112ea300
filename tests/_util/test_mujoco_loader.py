"""A broken OpenGL set-up must not keep the physics from running."""

import os
import subprocess
import sys

STEP = """
import os
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.system import System
sim = Simulator(System())
print(round(float(sim.step().time[0]), 9), os.environ["MUJOCO_GL"])
"""


def test_physics_runs_whatever_mujoco_gl_says():
    word = "nonsense"
    environment = {**os.environ, "MUJOCO_GL": word, "PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run(
        [sys.executable, "-c", STEP], env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["0.0125", word]  # the variable is left as it was
