"""The same with an effect that the library lacks: the arm's weight is not as described.

    python examples/thesis_weight/own_effect.py

An effect of one's own is a class; a candidate says which of its numbers a fit may choose.
"""

import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from diagnose import IDENTIFIED, MEASURED, read_runs, reweighed, show, verdict, write_logs

from ves_gym._util.params import Array, Vector
from ves_gym.diagnosis.inference.candidates import Candidate
from ves_gym.mechanics.arm import Arm
from ves_gym.system.effect import ArmEffect, parameter, register

NAMES = ("mass", *(f"P{k}" for k in range(1, 10)))


@register("arm/weight")
@dataclass(frozen=True, kw_only=True)
class ArmWeight(ArmEffect):
    """Mass and minimal moment parameters of the arm differ from the description."""

    modes = ("ideal", "emulated")
    port = "wrench"
    mass: float = parameter("kg", bounds=(-20.0, 20.0))
    P: Vector = parameter("kg m", bounds=(-20.0, 20.0), shape=(9,))

    def arm(self, arm: Arm) -> Arm:
        """The arm that is really there."""
        return arm if self.is_null else reweighed(arm, self.mass, self.P)


def made(x: Array) -> ArmWeight:
    """The effect with numbers x (10,)."""
    return ArmWeight(mass=float(x[0]), P=tuple(x[1:].tolist()))


CANDIDATE = Candidate(
    kind=ArmWeight.kind,
    slot="",
    ports=("joint", "wrench"),
    names=NAMES,
    units=("kg", *("kg m",) * 9),
    starts=((1.0,) + (0.1,) * 9,),
    low=(-20.0,) * 10,
    high=(20.0,) * 10,
    make=made,
    factors=tuple(range(10)),
)


def main() -> None:
    """Diagnose with it, and compare with the thesis."""
    with tempfile.TemporaryDirectory() as folder:
        runs = read_runs(write_logs(Path(folder), IDENTIFIED))
        found = verdict(MEASURED, runs, [CANDIDATE])
    show(found)
    true = np.subtract([IDENTIFIED.mass, *IDENTIFIED.P], [MEASURED.mass, *MEASURED.P])
    pairs = zip(NAMES, true, strict=True)
    print("printed in the thesis:", ", ".join(f"{name} {value:.4f}" for name, value in pairs))


if __name__ == "__main__":
    main()
