"""What does a 95 kg carriage without friction lack of the EMPS axis?

    python examples/emps/diagnose.py DATA_EMPS.mat DATA_EMPS_PULSES.mat

Fits the first file, opens the second once, and says by how much the force is wrong there.
"""

import argparse
import itertools
from pathlib import Path
from typing import Any

import numpy as np

import ves_gym as vg
from ves_gym.effects import JointCoulomb, JointTorqueOffset, JointViscous

MAPPING = Path(__file__).with_name("emps.toml")


def force_error(machine: vg.MjcfMachine, run: Any, variant: vg.diagnosis.MjcfVariant) -> float:
    """Size of the force that is not explained over that of the force, up to the run's band."""
    left = machine.residuals(run, [variant], ["joint"])["joint"][0]
    spectra = (run.window.spectrum(x) for x in (left, run["tau"]))
    wrong, whole = (float(np.linalg.norm(x)) for x in spectra)
    return wrong / whole


def main() -> None:
    """Read, diagnose, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("fitted", help="DATA_EMPS.mat")
    parser.add_argument("final", help="DATA_EMPS_PULSES.mat, held back")
    args = parser.parse_args()
    machine, load = vg.diagnosis.read_machine(MAPPING)
    runs = [load(args.fitted), load(args.final)]
    found = vg.diagnose(runs, machine, final=1, most=5, as_logged=True)
    print(found.sentence)
    better = machine.model(found.effects)
    r = machine.joints[0].radius
    published = machine.model(
        [
            JointCoulomb(torque=(20.39 * r,)),
            JointViscous(damping=(203.5 * r**2,)),
            JointTorqueOffset(torque=(3.165 * r,)),
        ]
    )
    print("force error, up to: described, published, found")
    for path, band in itertools.product((args.fitted, args.final), (12.0, 20.0, 30.0, 40.0)):
        run = vg.diagnosis.read_machine(MAPPING, band)[1](path)
        errors = [force_error(machine, run, m) for m in (machine.nominal, published, better)]
        print(f"{run.name} {band:g} Hz:", ", ".join(f"{100 * e:.2f} %" for e in errors))


if __name__ == "__main__":
    main()
