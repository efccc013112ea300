"""One motion on the compiled kernel and on MuJoCo."""

import numpy as np

from ves_gym.simulation.playback import play_motions


def require_alike(system, motion):
    """The log of the kernel, after every quantity has been found the same on MuJoCo.

    To 1e-9; to 1e-7 in mode emulated, where MuJoCo's platform yields a little.
    """
    ideal = system.mode == "ideal"
    every, share = (system.physics_dt, 1e-9) if ideal else (system.control_dt, 1e-7)
    logs = [
        play_motions(system, [motion], settle=0.5, record_dt=every, backend=name).log(0)
        for name in ("kernel", "mujoco")
    ]
    for name in ("q", "v", "tau", "y", "yd", "w"):
        a, b = (getattr(log, name) for log in logs)
        assert np.abs(a - b).max() <= share * max(1.0, np.abs(a).max()), name
    return logs[0]
