"""Friction of the Staubli TX40 against the published values.

    python examples/staubli/diagnose.py ../shared/data/staubli_tx40

The folder holds the data and the URDF; `staubli.toml` says what is what. 20 s of one core.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import ves_gym as vg

# T40X_config.yaml of the same data: Coulomb (N m), viscous (N m s/rad). There tau_5 has fv5 v5
# + fvm6 v6 and tau_6 fv6 v6 + fvm6 v5, so what is of the shaft is in fv5 and fv6 once more.
PUBLISHED = {
    "coulomb": (7.14, 8.26, 6.34, 2.48, 3.03, 0.282),
    "viscous": (8.05, 5.53, 1.97, 1.11, 1.86, 0.65),
}
SHAFT = {"coulomb": 1.95, "viscous": 0.616, "inertia": 9.64e-3}


def friction(found: vg.Diagnosis) -> tuple[dict[str, NDArray[np.float64]], dict[str, float]]:
    """Return friction per joint (6,) as published, and that of the shaft."""
    joints = {key: np.zeros(6) for key in PUBLISHED}
    shaft = dict.fromkeys(SHAFT, 0.0)
    for one in found.explanations:
        for name, value in zip(one.candidate.names, one.values, strict=True):
            if one.candidate.kind == "joint/friction":
                law, _, joint = name.partition(" of joint_")
                joints[law][int(joint) - 1] += value
            if one.candidate.kind == "shaft/friction":
                shaft[name] += float(value)
    joints["viscous"][4:] += shaft["viscous"]
    return joints, shaft


def main(folder: Path) -> vg.Diagnosis:
    """Diagnose and print the table."""
    text = Path(__file__).with_name("staubli.toml").read_text(encoding="utf-8")
    with tempfile.TemporaryDirectory() as near:  # the URDF lies with the data
        mapping = Path(near) / "staubli.toml"
        where = folder.resolve().as_posix()
        mapping.write_text(text.replace('model = "', f'model = "{where}/'), encoding="utf-8")
        machine, load = vg.diagnosis.read_machine(mapping)
    found = vg.diagnose([load(folder)], machine)
    print(found.verdict, [one.candidate.name for one in found.explanations])
    joints, shaft = friction(found)
    for law, published in PUBLISHED.items():
        for i, (here, there) in enumerate(zip(joints[law], published, strict=True)):
            print(
                f"{law} joint {i + 1}: {here:.3f}, published {there} ({here / there - 1:+.1%})"
            )
    for name, there in SHAFT.items():
        here = shaft[name]
        print(f"shaft {name}: {here:.4f}, published {there} ({here / there - 1:+.1%})")
    return found


if __name__ == "__main__":
    main(Path(sys.argv[1]))
