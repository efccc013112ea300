"""Materials and the cross sections of straight members."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ves_gym._util.params import (
    ParameterError,
    Vector,
    finite,
    freeze_arrays,
    require_positive,
    unit,
)


@dataclass(frozen=True, kw_only=True)
class Material:
    """An isotropic elastic material."""

    youngs_modulus: float = unit("Pa")
    shear_modulus: float = unit("Pa")
    density: float = unit("kg/m^3")
    source: str

    def __post_init__(self) -> None:
        require_positive(self, "youngs_modulus", "shear_modulus", "density")

    @property
    def poisson(self) -> float:
        """Poisson's ratio E / 2G - 1 [1]."""
        return self.youngs_modulus / (2 * self.shear_modulus) - 1


ALUMINIUM = Material(
    youngs_modulus=72e9, shear_modulus=27e9, density=2.8e3, source="thesis App. A.2"
)


@dataclass(frozen=True, kw_only=True)
class Section:
    """A cross section by its numbers, in principal axes; the member runs along local x.

    `shear_y`, `shear_z`: share of the area that carries shear (Timoshenko); without them
    the member does not shear (Euler-Bernoulli). `up`: direction near which local z lies.
    """

    kind: ClassVar[str] = "section"
    area: float = unit("m^2")
    second_y: float = unit("m^4")  # int z^2 dA: resists bending along z
    second_z: float = unit("m^4")  # int y^2 dA: resists bending along y
    torsion: float = unit("m^4")  # Saint-Venant's
    shear_y: float | None = unit("1", default=None)
    shear_z: float | None = unit("1", default=None)
    fibre: float | None = unit("m", default=None)  # from the axis to the outermost fibre
    up: Vector | None = unit("1", default=None)

    def __post_init__(self) -> None:
        freeze_arrays(self)
        require_positive(self, "area", "second_y", "second_z", "torsion")
        for name in ("shear_y", "shear_z", "fibre"):
            if getattr(self, name) is not None:
                require_positive(self, name)
        if (self.shear_y is None) != (self.shear_z is None):
            raise ParameterError(
                "Section needs both shear_y and shear_z or neither, got"
                f" {self.shear_y} and {self.shear_z}"
            )
        if self.up is not None and not np.linalg.norm(finite(self.up, (3,), "Section.up")):
            raise ParameterError("Section.up must not be zero")

    def of(self, material: Material) -> Section:
        """Return the section itself; a `Tube` becomes one with its material's shear."""
        return self


@dataclass(frozen=True, kw_only=True)
class Tube:
    """A round tube. With `shear` it also shears (Timoshenko, Cowper's coefficient)."""

    kind: ClassVar[str] = "tube"
    outer_diameter: float = unit("m")
    wall: float = unit("m")
    shear: bool = False

    def __post_init__(self) -> None:
        require_positive(self, "outer_diameter", "wall")
        if 2 * self.wall >= self.outer_diameter:
            raise ParameterError(
                f"Tube.wall must be < half the outer diameter {self.outer_diameter} m,"
                f" got {self.wall} m"
            )

    def of(self, material: Material) -> Section:
        """Return the section's numbers; the shear coefficient depends on Poisson's ratio."""
        outer, inner = self.outer_diameter, self.outer_diameter - 2 * self.wall
        second = np.pi / 64 * (outer**4 - inner**4)
        share = cowper(inner / outer, material.poisson) if self.shear else None
        return Section(
            area=np.pi / 4 * (outer**2 - inner**2),
            second_y=second,
            second_z=second,
            torsion=2 * second,
            shear_y=share,
            shear_z=share,
            fibre=outer / 2,
        )


def cowper(ratio: float, poisson: float) -> float:
    """Return the shear coefficient of a round tube [1] (Cowper, J. Appl. Mech. 33, 1966).

    Args:
        ratio: inner over outer diameter [1].
        poisson: Poisson's ratio [1].
    """
    even, cross = (1 + ratio**2) ** 2, ratio**2
    return 6 * (1 + poisson) * even / ((7 + 6 * poisson) * even + (20 + 12 * poisson) * cross)
