"""One motion on the compiled kernel and on MuJoCo."""

import numpy as np

from ves_gym.simulation.playback import play_motions


def require_alike(system, motion):
    """The log of the kernel, after every quantity has been found the same on MuJoCo (1e-9)."""
    logs = [
        play_motions(
            system, [motion], settle=0.5, record_dt=system.physics_dt, backend=name
        ).log(0)
        for name in ("kernel", "mujoco")
    ]
    for name in ("q", "v", "tau", "y", "yd", "w"):
        a, b = (getattr(log, name) for log in logs)
        assert np.abs(a - b).max() <= 1e-9 * max(1.0, np.abs(a).max()), name
    return logs[0]
