"""Agreement with `ves-gym simulate`: the same description, the same motion, no noise.

The simulator is asked through its command line only. Differences are root mean squares of each
channel, in units of the noise that the cases have.
"""

import csv
import os
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import tomli_w

from benchmarks.trial import laboratory, machines, space
from benchmarks.trial.arm import Array, Table
from benchmarks.trial.cases import noise_std
from benchmarks.trial.hidden import Hidden
from benchmarks.trial.motions import Quintics

CHANNELS = ("q", "v", "tau", "y", "y_cmd", "w", "wg")
MODES = (("ideal", "pose"), ("emulated", "pose"), ("emulated", "legs"))
"""Mode and platform."""
MOVING, RESTING = 1.0, 0.6  # s
GOALS = {"puma560": (60, 40, -30), "iiwa14": (40, 30, -30, 40, 30, -30, 40)}  # deg, from zero


def read_log(path: Path) -> dict[str, Array]:
    """Read a log's time and channels from its CSV."""
    with path.open(newline="") as file:
        rows = list(csv.reader(file))
    data = np.array(rows[1:], float)
    out = {"t": data[:, 0]}
    for channel in CHANNELS:
        at = [i for i, name in enumerate(rows[0]) if name.rpartition("_")[0] == channel]
        if at:
            out[channel] = data[:, at]
    return out


def simulated(described: Table, arm: str) -> dict[str, Array]:
    """Return the log of `ves-gym simulate` of one straight motion, with feed-forward torque.

    Args:
        described: the machine, the content of a `system.toml`.
        arm: of `machines.SERVOS`.
    """
    servo = machines.SERVOS[arm]
    options = {
        "gains": "/".join(",".join(map(str, row)) for row in (servo.kp, servo.kd)),
        "start": ",".join("0" for _ in servo.kp),
        "goal": ",".join(map(str, GOALS[arm])),
        "duration": MOVING,
        "settle": RESTING,
        "log": "run.csv",
    }
    if described["mode"] == "ideal":
        options["record-dt"] = described["control_dt"]
    with tempfile.TemporaryDirectory() as folder:
        system = Path(folder) / "system.toml"
        system.write_text(tomli_w.dumps(described), "utf-8")
        words = ["simulate", "--degrees", f"--system={system}", f"--out={folder}"]
        words += [f"--{name}={value}" for name, value in options.items()]
        done = subprocess.run(
            [sys.executable, "-m", "ves_gym.cli.main", *words],
            capture_output=True,
            text=True,
            env={**os.environ, "OMP_NUM_THREADS": "1"},
        )
        if done.returncode == 2:
            raise RuntimeError(f"ves-gym {' '.join(words)}: {done.stderr.strip()}")
        return read_log(Path(folder) / "run.csv")


def in_units_of_noise(vehicle: str, arm: str, mode: str, platform: str) -> dict[str, float]:
    """Return RMS differences over noise, of the worst signal of each channel.

    Args:
        vehicle: of `machines.VEHICLES`; arm: of `machines.SERVOS`.
        mode: ideal or emulated; platform: pose or legs.
    """
    described = machines.description(vehicle, arm, mode, platform, machines.PERIODS[0])
    log = simulated(described, arm)
    goal = np.deg2rad(GOALS[arm])
    motion = Quintics(np.array([0 * goal, goal]), np.array([[0.0, MOVING]]))
    servo = replace(machines.SERVOS[arm], feedforward=True)
    same, duration = (described, described, servo, motion, Hidden()), float(log["t"][-1])
    if mode == "emulated":
        run = laboratory.simulate(*same, duration=duration)
    else:
        run = space.simulate(*same, duration=duration, record_dt=described["control_dt"])
    std, out = noise_std(arm), {}
    for name in CHANNELS:
        values = getattr(run, name)
        if values is not None and name in log:
            rms = np.sqrt(np.mean((log[name] - values) ** 2, axis=0))
            out[name] = float((rms / std[name]).max())
    return out
