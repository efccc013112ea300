"""The same with an effect that the library lacks: the arm's weight is not as described.

    python examples/thesis_weight/own_effect.py

An effect of one's own is a class: what a fit may choose follows from its parameters.
"""

import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from diagnose import IDENTIFIED, MEASURED, reweighed, show, verdict, write_logs

import ves_gym as vg
from ves_gym.effects import ArmEffect

NAMES = ("mass", *(f"P{k}" for k in range(1, 10)))


@vg.register_effect("arm/weight")
@dataclass(frozen=True, kw_only=True)
class ArmWeight(ArmEffect):
    """Mass and minimal moment parameters of the arm differ from the description."""

    modes = ("ideal", "emulated")
    port = "wrench"
    mass: float = vg.parameter("kg", bounds=(-20.0, 20.0))
    P: tuple[float, ...] = vg.parameter("kg m", bounds=(-20.0, 20.0), shape=(9,))

    def arm(self, arm: vg.Arm) -> vg.Arm:
        """The arm that is really there."""
        return arm if self.is_null else reweighed(arm, self.mass, self.P)


def main() -> None:
    """Diagnose with it, and compare with the thesis."""
    with tempfile.TemporaryDirectory() as folder:
        files = write_logs(Path(folder), IDENTIFIED)
        found = verdict(MEASURED, files)
    show(found)
    true = np.subtract([IDENTIFIED.mass, *IDENTIFIED.P], [MEASURED.mass, *MEASURED.P])
    pairs = zip(NAMES, true, strict=True)
    print("printed in the thesis:", ", ".join(f"{name} {value:.4f}" for name, value in pairs))


if __name__ == "__main__":
    main()
