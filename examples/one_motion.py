"""Play one motion on the bent beam, read the energy it leaves in the base, save the run."""

from pathlib import Path

import numpy as np

import ves_gym as vg

system = vg.System()  # PUMA 560 on the bent beam, zero gravity
motion = vg.Motion.straight(np.zeros(3), np.deg2rad([60, 40, -30]), duration=2.0)
log = vg.simulate(motion, system)

print(vg.energy(log))
print(vg.EnergyBalance.of(log))
log.save(Path("out") / "one_motion.csv")
