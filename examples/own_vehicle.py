"""Put the arm on a structure of one's own: M, D, K from a TOML file."""

from pathlib import Path

import numpy as np

import ves_gym as vg

system = vg.System(vehicle=vg.get_vehicle(Path(__file__).with_name("truss.toml")))
q = np.deg2rad([45.0, 0.0, 0.0])
frequencies = vg.planners.modes(system, q).omega / 2 / np.pi
print("base modes with the joints locked [Hz]:", frequencies.round(2))
print("coupling matrix Q(q) [J/rad^2]:")
print(vg.planners.coupling_matrix(system, q).round(3))
