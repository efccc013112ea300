"""The shipped beams against finite-element programs that no one here wrote.

    python scripts/validate_structures.py [calculix] [opensees]

Prints natural frequencies of each beam clamped at its root: bare, with 60 kg on its flange
(CalculiX 2.20, three-dimensional solids: pipes of quadratic bricks; Debian's package
calculix-ccx) and with the locked arm at q = 0 (OpenSees 3.7.1, Euler-Bernoulli frames; package
openseespy), beside those of the flexible base with its default modes. docs/validation.md
holds the tables.
"""

from __future__ import annotations

import itertools
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from ves_gym._util.params import Array
from ves_gym.mechanics.arm_library import PUMA_560
from ves_gym.mechanics.dynamics import inertia
from ves_gym.mechanics.flexible_base import Beam, FlexibleBase
from ves_gym.mechanics.modes import natural_modes
from ves_gym.mechanics.spatial import skew
from ves_gym.mechanics.vehicle import (
    BENT,
    BENT_THESIS,
    STRAIGHT_HORIZONTAL,
    STRAIGHT_HORIZONTAL_THESIS,
    STRAIGHT_VERTICAL,
    STRAIGHT_VERTICAL_THESIS,
)

BEAMS: dict[str, tuple[Beam, FlexibleBase]] = {
    "bent": (BENT_THESIS, BENT),
    "straight-vertical": (STRAIGHT_VERTICAL_THESIS, STRAIGHT_VERTICAL),
    "straight-horizontal": (STRAIGHT_HORIZONTAL_THESIS, STRAIGHT_HORIZONTAL),
}
TIP_MASS = 60.0  # kg
BAND = 20.0  # Hz
COUNT = 14  # frequencies asked for

Points = list[tuple[float, Array]]  # masses [kg] and where they are [m]


def main(names: list[str]) -> int:
    """Print a table for each program that is asked for and installed."""
    if not names or "calculix" in names:
        if shutil.which("ccx") is None:
            print("CalculiX is not installed: apt-get install calculix-ccx")
        else:
            for load in (0.0, TIP_MASS):
                added = np.diag([load] * 3 + [0.0] * 3)
                title = f"CalculiX, {load:g} kg on the flange" if load else "CalculiX, bare"
                for name, (beam, base) in BEAMS.items():
                    if name != "straight-horizontal":  # bare it is the vertical one
                        show(title, name, calculix(beam, load), ours(base, added))
    if not names or "opensees" in names:
        try:
            import openseespy.opensees  # noqa: F401
        except ImportError:
            print("OpenSees is not installed: pip install openseespy")
            return 0
        H = arm_inertia()
        for name, (beam, base) in BEAMS.items():
            show("OpenSees, bare", name, opensees(beam, []), ours(base, 0 * H))
            found = opensees(beam, point_masses(H))
            show("OpenSees, arm locked at q = 0", name, found, ours(base, H))
    return 0


def show(title: str, name: str, theirs: Array, own: Array) -> None:
    """Print frequencies below 20 Hz side by side.

    Args:
        title: program and load.
        name: of the beam.
        theirs, own: (k,) natural frequencies [Hz].
    """
    inside = theirs[theirs < BAND]
    gap = own[: len(inside)] / inside - 1
    print(f"{title}: {name}")
    print("  theirs [Hz]", *(f"{f:.4f}" for f in inside))
    print("  ours   [Hz]", *(f"{f:.4f}" for f in own[: len(inside)]))
    print(f"  largest difference {100 * np.abs(gap).max():.2f} %", flush=True)


def ours(base: FlexibleBase, added: Array) -> Array:
    """Return natural frequencies of a flexible base with more inertia at its flange [Hz].

    Args:
        base: with its modes.
        added: (6, 6) at the flange [kg, kg m, kg m^2].
    """
    M, _, K = base.base_model().full()
    M[:6, :6] += added
    return natural_modes(K, M).omega / (2 * np.pi)


def arm_inertia() -> Array:
    """Return H_b (6, 6) of the PUMA at q = 0."""
    found: Array = inertia(PUMA_560, np.zeros(PUMA_560.n))[:6, :6]
    return found


def point_masses(H: Array) -> Points:
    """Return six equal masses with a rigid body's mass, centre and moments of inertia.

    Args:
        H: (6, 6) spatial inertia at the flange.
    """
    mass, moment = float(H[0, 0]), H[3:, :3] / H[0, 0]
    centre = np.array([moment[2, 1], moment[0, 2], moment[1, 0]])
    about = H[3:, 3:] + mass * skew(centre) @ skew(centre)
    moments, axes = np.linalg.eigh(about)
    reach = np.sqrt(3 * (np.trace(about) / 2 - moments) / mass)
    return [
        (mass / 6, centre + side * reach[i] * axes[:, i]) for i in range(3) for side in (-1, 1)
    ]


def corners(beam: Beam) -> Array:
    """Return the beam's corners (s + 1, 3), the flange at the origin [m]."""
    return beam.nodes


def across(segment: Array) -> Array:
    """Return a unit vector square to a segment (3,)."""
    along = segment / np.linalg.norm(segment)
    helper = np.eye(3)[int(np.abs(along).argmin())]
    out = np.cross(along, helper)
    return np.asarray(out / np.linalg.norm(out))


def calculix(beam: Beam, tip_mass: float, pieces: int = 60) -> Array:
    """Return natural frequencies [Hz] by CalculiX, its B32R elements with a pipe section.

    Args:
        beam: clamped at its root.
        tip_mass: on the flange [kg].
        pieces: elements of each segment.
    """
    nodes, groups = [corners(beam)[0]], []
    for a, b in itertools.pairwise(corners(beam)):
        group = []
        for k in range(pieces):
            first = len(nodes)
            nodes += [a + (b - a) * (k + half) / pieces for half in (0.5, 1.0)]
            group.append((first, first + 1, first + 2))
        groups.append(group)
    material = beam.material
    text = ["*NODE, NSET=ALL"]
    text += [f"{i}, {x:.9g}, {y:.9g}, {z:.9g}" for i, (x, y, z) in enumerate(nodes, start=1)]
    element = itertools.count(1)
    for s, group in enumerate(groups):
        text.append(f"*ELEMENT, TYPE=B32R, ELSET=S{s}")
        text += [f"{next(element)}, {a}, {b}, {c}" for a, b, c in group]
    if tip_mass:
        text += ["*ELEMENT, TYPE=MASS, ELSET=TIP", f"{next(element)}, {len(nodes)}"]
        text += ["*MASS, ELSET=TIP", f"{tip_mass:.9g}"]
    text += ["*MATERIAL, NAME=TUBE", "*ELASTIC"]
    text += [f"{material.youngs_modulus:.9g}, {material.poisson:.9f}"]
    text += ["*DENSITY", f"{material.density:.9g}"]
    for s, segment in enumerate(beam.segments):
        side = across(np.array(segment))
        text += [
            f"*BEAM SECTION, ELSET=S{s}, MATERIAL=TUBE, SECTION=PIPE",
            f"{beam.outer_diameter / 2:.9g}, {beam.wall:.9g}",
            ", ".join(f"{k:.6g}" for k in side),
        ]
    text += ["*BOUNDARY", "1, 1, 6", "*STEP", "*FREQUENCY", f"{COUNT}", "*END STEP", ""]
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "job.inp").write_text("\n".join(text))
        environment = {**os.environ, "OMP_NUM_THREADS": "1"}
        subprocess.run(
            ["ccx", "job"],
            cwd=folder,
            check=True,
            capture_output=True,
            timeout=300,
            env=environment,
        )
        answer = Path(folder, "job.dat").read_text()
    rows = re.findall(r"^\s+\d+\s+\S+\s+\S+\s+(\S+)\s+\S+\s*$", answer, re.MULTILINE)
    return np.array([float(k) for k in rows[:COUNT]])


def opensees(beam: Beam, masses: Points, pieces: int = 20) -> Array:
    """Return natural frequencies [Hz] by OpenSees, elastic frames with consistent mass.

    Args:
        beam: clamped at its root.
        masses: joined rigidly to the flange.
        pieces: elements of each segment.
    """
    import openseespy.opensees as ops

    area, second, polar = beam.section
    E, G = beam.material.youngs_modulus, beam.material.shear_modulus
    ops.wipe()
    ops.model("basic", "-ndm", 3, "-ndf", 6)
    ops.node(1, *corners(beam)[0].tolist())
    ops.fix(1, *[1] * 6)
    last = 1
    for s, (a, b) in enumerate(itertools.pairwise(corners(beam)), start=1):
        ops.geomTransf("Linear", s, *across(b - a).tolist())
        for k in range(pieces):
            last += 1
            ops.node(last, *(a + (b - a) * (k + 1) / pieces).tolist())
            numbers = (last - 1, last - 1, last, area, E, G, polar, second, second, s)
            mass = ("-mass", beam.material.density * area, "-cMass")
            ops.element("elasticBeamColumn", *numbers, *mass)
    for i, (mass, at) in enumerate(masses, start=last + 1):
        ops.node(i, *at.tolist())
        ops.mass(i, *[mass] * 3, 0.0, 0.0, 0.0)
        ops.rigidLink("beam", last, i)
    ops.constraints("Transformation")
    ops.numberer("RCM")
    ops.system("FullGeneral")
    squares = ops.eigen("-fullGenLapack", COUNT)
    return np.sqrt(np.array(squares)) / (2 * np.pi)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
