"""Put the arm on a finite-element model: M and K from a NASTRAN punch file."""

from pathlib import Path

import numpy as np

import ves_gym as vg
from ves_gym.mechanics import FlexibleBase, read_structure

mast = read_structure(Path(__file__).with_name("mast.pch"), interface=4, units="m-kg-s")
line = [[0.0, 0.0, -4.0], [0.0, 0.0, -2.0], [0.0, 0.0, 0.0]]  # m, nodes 2 to 4, to draw it
reduced = mast.reduced(modes=4, centreline=np.array(line), nodes=(2, 3, 4), diameter=0.12)
base = FlexibleBase(structure=reduced, modes=4, damping_ratio=0.02, source="examples/mast.pch")
base.save("mast.toml")

system = vg.System(vehicle=vg.get_vehicle("mast.toml"))
frequencies = vg.planners.modes(system, np.zeros(3)).omega / 2 / np.pi
print("modes with the joints locked [Hz]:", frequencies.round(2))
motion = vg.Motion.straight(np.zeros(3), np.deg2rad([60.0, 40.0, -30.0]), 1.0)
log = vg.simulate(motion, system, settle=2.0)
print("largest way of the flange [mm]:", (1e3 * np.abs(log.y[:, :3]).max(axis=0)).round(1))
assert log.u is not None  # this base has modes of its own
print("largest internal modes [kg^(1/2) m]:", np.abs(log.u).max(axis=0).round(4))
