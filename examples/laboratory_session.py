"""A session at the laboratory machine, as the thesis's handbook has it (Appendix E).

calibrate -> zero the sensor -> compare measured and estimated wrench -> run a motion ->
record -> reset.
"""

from dataclasses import replace

import numpy as np

import ves_gym as vg
from ves_gym.effects import LABORATORY_ERRORS, SensorBias, SensorCalibration

# The machine as it is: noise, drift, a zero nobody set, and 1 % of cross-talk.
cross_talk = np.random.default_rng(0).normal(0, 0.01, (6, 6)).tolist()
machine = vg.System(
    mode="emulated",
    effects=(
        *LABORATORY_ERRORS,
        SensorBias(force=(4.0, -2.0, 7.0), moment=(1.0, 0.5, -0.5)),
        SensorCalibration(error=tuple(map(tuple, cross_talk))),
    ),
)
check = vg.check_emulation(machine, search=False)
print(f"stable: {check.stable}; slowest mode {check.modes[0].emulated_frequency:.3f} Hz")

# Calibrate: 47 poses, gravity model and sensor matrix.
q, y = vg.simulation.calibration_poses(machine.arm, 47)
poses = vg.simulation.weigh_poses(machine, q, y)
assert poses.w is not None  # the force sensor is part of the laboratory
found = vg.simulation.fit_gravity(machine.arm, poses.q, poses.y, poses.w)
lab = machine.emulator_settings
calibrated = machine.replace(
    emulator=replace(
        lab,
        gravity=found.model,
        sensor=lab.sensor.calibrated(found.C, found.offset),
        zero_at_start=True,
    )
)
print(f"weight {found.model.mass * 9.81:.1f} N, residual {max(found.rms[:3]):.2f} N rms")

# Zero the sensor and look at measured against estimated wrench.
sim = vg.Simulator(calibrated)
sim.reset(q=[0.0, 0.4, -0.8])
now = sim.readings
print("measured ", now.wrench[0].round(2))
print("estimated", now.gravity[0].round(2))

# Run a spline motion, record, reset (every run starts at home, with the sensor zeroed).
motion = vg.Motion.straight(np.zeros(3), np.deg2rad([60, 40, -30]), 2.0)
for name, system in (("laboratory", calibrated), ("in space", machine.ideal())):
    log = vg.simulate(motion, system, record_dt=system.control_dt)
    print(f"{name:10s} E_mean {vg.energy(log).E_mean:.4f} J, {len(log)} records")
