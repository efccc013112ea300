"""Agreement with `ves-gym simulate`: the same description, the same motion, no noise.

The simulator is asked through its command line only. Differences are root mean squares of each
channel, in units of the noise that the cases have.
"""

import csv
import os
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from benchmarks.trial2 import laboratory, machines, space
from benchmarks.trial2.arm import Array
from benchmarks.trial2.hidden import Hidden
from benchmarks.trial2.motions import Quintics
from benchmarks.trial2.servo import Servo
from benchmarks.trial2.space import Run

CHANNELS = ("q", "v", "tau", "y", "y_cmd", "w", "wg")


def read_log(path: Path) -> dict[str, Array]:
    """Read a log's channels from its CSV."""
    with path.open(newline="") as file:
        rows = list(csv.reader(file))
    data = np.array(rows[1:], float)
    out: dict[str, Array] = {}
    for channel in ("t", "q_cmd", "v_cmd", "yd", *CHANNELS):
        at = [i for i, name in enumerate(rows[0]) if name.rpartition("_")[0] == channel]
        if channel == "t":
            at = [0]
        if at:
            out[channel] = data[:, at].squeeze() if channel == "t" else data[:, at]
    return out


def command_line(*args: str) -> None:
    """Run `ves-gym` with arguments; what it says shows only where it fails."""
    program = [str(Path(sys.executable).with_name("ves-gym")), *args]
    done = subprocess.run(
        program, capture_output=True, text=True, env={**os.environ, "OMP_NUM_THREADS": "1"}
    )
    if done.returncode == 2:
        raise RuntimeError(f"{' '.join(program)}: {done.stderr.strip()}")


def compare(
    system: Path,
    goal_deg: list[float],
    kp: list[float],
    kd: list[float],
    *,
    duration: float = 1.5,
    settle: float = 1.5,
    feedforward: bool = True,
    record_dt: float = 0.0125,
) -> tuple[dict[str, Array], Run]:
    """Return the simulator's log and this generator's run of one straight motion.

    Args:
        system: description, `.toml`.
        goal_deg: of the joints, from zero [deg].
        kp, kd: gains of the servo.
        duration, settle: of the motion, and after it [s].
        feedforward: with feed-forward torque.
        record_dt: between samples [s].
    """
    description: dict[str, Any] = tomllib.loads(system.read_text("utf-8"))
    with tempfile.TemporaryDirectory() as folder:
        gains = "/".join(",".join(str(g) for g in row) for row in (kp, kd))
        options = [] if feedforward else ["--no-feedforward"]
        if description["mode"] == "ideal":
            options += ["--record-dt", str(record_dt)]
        command_line(
            "simulate", "--system", str(system), "--degrees", "--gains", gains, *options,
            "--start=" + ",".join("0" for _ in goal_deg),
            "--goal=" + ",".join(str(g) for g in goal_deg),
            "--duration", str(duration), "--settle", str(settle),
            "--log", "run.csv", "--out", folder,
        )  # fmt: skip
        log = read_log(Path(folder) / "run.csv")
    goal = np.deg2rad(goal_deg)
    motion = Quintics(np.array([0 * goal, goal]), np.array([[0.0, duration]]))
    servo, length = (
        Servo(np.array(kp, float), np.array(kd, float), feedforward),
        float(log["t"][-1]),
    )
    if description["mode"] == "emulated":
        run = laboratory.simulate(
            description, description, servo, motion, Hidden(), duration=length
        )
    else:
        run = space.simulate(
            description,
            description,
            servo,
            motion,
            Hidden(),
            duration=length,
            record_dt=record_dt,
        )
    return log, run


def in_units_of_noise(vehicle: str, arm: str, mode: str, platform: str) -> dict[str, float]:
    """RMS differences over noise, worst signal of each channel; 1 s of motion, 0.6 s of rest.

    Args:
        vehicle: of `machines.VEHICLES`; arm: of `machines.SERVOS`.
        mode: ideal or emulated; platform: pose or legs.
    """
    described = machines.description(vehicle, arm, mode, platform, machines.PERIODS[0])
    servo, std = machines.SERVOS[arm], machines.NOISE[arm]
    noise = {**std, "y_cmd": std["y"], "wg": std["w"]}
    goal = (
        [60.0, 40.0, -30.0]
        if len(servo.kp) == 3
        else [40.0, 30.0, -30.0, 40.0, 30.0, -30.0, 40.0]
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "system.toml"
        path.write_text(tomli_w.dumps(described), "utf-8")
        log, run = compare(
            path, goal, servo.kp.tolist(), servo.kd.tolist(), duration=1.0, settle=0.6,
            record_dt=machines.PERIODS[0],
        )  # fmt: skip
    out = {}
    for name in CHANNELS:
        values = getattr(run, name)
        if values is not None and name in log:
            rms = np.sqrt(np.mean((log[name] - values) ** 2, axis=0))
            out[name] = float((rms / np.asarray(noise[name])).max())
    return out
