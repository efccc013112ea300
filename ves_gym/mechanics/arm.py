"""A serial arm, and how it comes from files and goes into them.

Another arm, or the PUMA with its wrist, is another `Arm` (a TOML, URDF or MJCF file read by
`mechanics/arm_library.py: get_arm`), not another piece of code.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Self

from ves_gym._util.params import from_plain, read_table, write_text
from ves_gym.mechanics.arm_files import mjcf_text, pinocchio_arm, urdf_text
from ves_gym.mechanics.chain import ChainChoice
from ves_gym.mechanics.mjcf_arm import read_mjcf
from ves_gym.mechanics.serial_chain import (
    Capsule,
    Gear,
    Inertial,
    Link,
    Mount,
    SerialChain,
    diagonal,
    matrix,
    skew,
)
from ves_gym.mechanics.urdf import read_urdf

if TYPE_CHECKING:
    import pinocchio

__all__ = [
    "Arm",
    "Capsule",
    "Gear",
    "Inertial",
    "Link",
    "Mount",
    "diagonal",
    "matrix",
    "read_arm",
    "skew",
]


@dataclass(frozen=True, kw_only=True)
class Arm(SerialChain):
    """A serial arm on a base link fixed to the platform top.

    The tool is the last link's frame, turned by `tool_angle` about its z.
    """

    @classmethod
    def from_urdf(
        cls,
        path: str | os.PathLike[str],
        *,
        tip: str | None = None,
        root: str | None = None,
        locked: Mapping[str, float] | None = None,
        collision: bool = True,
        check: bool = True,
        rotors: Mapping[str, float] | None = None,
    ) -> Self:
        """Read the chain of revolute joints from root to tip of a URDF file.

        Fixed joints are merged; joints off the chain stand still at zero. The root's frame
        is the platform-top frame, the tip's the tool. What a file does not give is derived,
        and `source` says so.

        Args:
            path: the file.
            tip: link that is the tool; default the last one, where there is one.
            root: link that stands on the platform; default the file's.
            locked: angles [rad] of joints that stand still, by name.
            collision: read shapes as capsules; False: capsules along the links.
            check: refuse numbers that look like g, mm or kg mm^2.
            rotors: inertia of rotors about their joints [kg m^2], by name, in place of the
                file's: what a file of links that were identified or rounded lacks.

        Raises:
            ParameterError: names the link or the joint, and what is wrong with it.
        """
        choice = ChainChoice(
            tip, root, dict(locked or {}), collision, check, dict(rotors or {})
        )
        return cls._of(read_urdf(path, choice))

    @classmethod
    def from_mjcf(
        cls,
        path: str | os.PathLike[str],
        *,
        tip: str | None = None,
        root: str | None = None,
        locked: Mapping[str, float] | None = None,
        collision: bool = True,
        check: bool = True,
        rotors: Mapping[str, float] | None = None,
    ) -> Self:
        """Read the chain of hinges from root to tip of an MJCF file, as MuJoCo compiles it.

        Args:
            path: the file.
            tip: body or site that is the tool; default the site `tool`, else the last body,
                where there is one.
            root: body that stands on the platform, whose frame is the platform-top frame;
                default the world.
            locked, collision, check, rotors: see `from_urdf`.

        Raises:
            ParameterError: names the body or the joint, and what is wrong with it.
        """
        choice = ChainChoice(
            tip, root, dict(locked or {}), collision, check, dict(rotors or {})
        )
        return cls._of(read_mjcf(path, choice))

    @classmethod
    def _of(cls, chain: SerialChain) -> Self:
        return cls(**{field.name: getattr(chain, field.name) for field in fields(chain)})

    def to_urdf(self, path: str | os.PathLike[str]) -> None:
        """Write a URDF file: `from_urdf` gives this arm back, a capsule as three shapes.

        Args:
            path: the file.

        Raises:
            ParameterError: gears that give way, for which URDF has no words.
        """
        write_text(path, urdf_text(self))

    def to_mjcf(self, path: str | os.PathLike[str]) -> None:
        """Write an MJCF file: `from_mjcf` gives this arm back.

        Args:
            path: the file.

        Raises:
            ParameterError: gears that give way.
        """
        write_text(path, mjcf_text(self))

    def to_pinocchio(self) -> pinocchio.Model:
        """Return the arm on a base that stands still in Pinocchio, its tool the frame `tool`.

        Raises:
            MissingPackageError: Pinocchio is not installed.
        """
        return pinocchio_arm(self)


def read_arm(path: str | os.PathLike[str]) -> Arm:
    """Read an arm from a TOML or JSON file that mirrors `Arm`."""
    arm: Arm = from_plain(Arm, read_table(path), str(path))
    return arm
