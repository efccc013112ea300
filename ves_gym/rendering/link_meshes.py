"""Meshes that an arm is drawn with, from the files that its own file named."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ves_gym._util.params import ParameterError
from ves_gym.mechanics.link import MeshFile
from ves_gym.mechanics.meshes import Mesh, read_mesh


def meshes_of(files: Sequence[MeshFile] | None) -> list[Mesh]:
    """Return the meshes of a body in its own frame [m], without files that cannot be read.

    A run may be seen on another machine than that it was made on: what has none is drawn with
    its capsules.
    """
    out = []
    for file in files or ():
        try:
            points, faces = read_mesh(Path(file.file))
        except ParameterError:
            continue
        if len(faces):
            mirrored = np.prod(file.scale) < 0
            out.append(Mesh(file.points_at(points), faces[:, ::-1] if mirrored else faces))
    return out
