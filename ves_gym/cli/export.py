"""`ves-gym export`: a run, or a machine, for the tools of others."""

from __future__ import annotations

from pathlib import Path

import ves_gym.api as vg
from ves_gym.cli.flags import LOG, Answer, Context
from ves_gym.cli.machine import MACHINE
from ves_gym.cli.simulate import GAINS
from ves_gym.mechanics.servo import JointServo
from ves_gym.system.runlog import RunLog


def mcap(at: Context, log: Path) -> Answer:
    """A run log as ROS 2 messages in MCAP, for PlotJuggler, Foxglove and ros2 bag."""
    recorded = RunLog.load(log)
    path = at.folder("out/export") / f"{log.stem}.mcap"
    vg.export(recorded, path)
    plain = {"schema": "ves-export/1", "digest": recorded.digest, "file": str(path)}
    return Answer(text=str(recorded), plain=plain, files=[path])


def fmu(at: Context, *, gains: JointServo | None = None) -> Answer:
    """Arm, base, laboratory as an FMU (FMI 3.0 co-simulation), for Simulink, Modelica, FMPy."""
    system = at.case.system
    path = at.folder("out/export") / "system.fmu"
    vg.export(system, path, servo=gains or at.case.servo)
    plain = {"schema": "ves-export/1", "system": system.hash, "file": str(path)}
    return Answer(text=str(system), plain=plain, files=[path])


TABLE = {
    "export mcap": (mcap, (LOG,)),
    "export fmu": (fmu, (GAINS, *MACHINE)),
}  # fmt: skip
