"""Play one motion on the bent beam, read the energy it leaves in the base, save the run."""

from pathlib import Path

import numpy as np

from ves_gym.mechanics.motion import Motion
from ves_gym.simulation.playback import play_motions
from ves_gym.system.energy import EnergyBalance, log_energies
from ves_gym.system.system import System

system = System()  # PUMA 560 on the thesis's bent beam, zero gravity
motion = Motion.straight(np.zeros(3), np.deg2rad([60, 40, -30]), duration=2.0)
log = play_motions(system, [motion]).log(0)

print(log_energies(log))
print(
    f"energy ledger closes to {EnergyBalance.of(log).relative:.1e} of the work through the port"
)
log.save(Path("out") / "one_motion.csv")
