"""Put the arm on a structure of one's own: M, D, K from a TOML file."""

from pathlib import Path

import numpy as np

from ves_gym.mechanics.vehicle import get_vehicle
from ves_gym.planners.coupling import coupling_matrix, modes
from ves_gym.system.system import System

system = System(vehicle=get_vehicle(Path(__file__).with_name("truss.toml")))
q = np.deg2rad([45.0, 0.0, 0.0])
print("base modes with the joints locked [Hz]:", (modes(system, q).omega / 2 / np.pi).round(2))
print("coupling matrix Q(q) [J/rad^2]:")
print(coupling_matrix(system, q).round(3))
