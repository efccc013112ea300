"""Follow a seam on a structure with the tool while the boom under the arm sways."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import ClassVar

import numpy as np

from ves_gym._util.params import Array, ParameterError, require_positive, unit
from ves_gym.envs.joints import drawn_joints, joint_box
from ves_gym.envs.paths import pursued
from ves_gym.envs.scales import motion_energy
from ves_gym.envs.task import Start, register_task
from ves_gym.envs.track import Track
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.boom import REACHING_OUT, SHUTTLE_LIKE
from ves_gym.mechanics.kinematics import dexterity, joint_positions
from ves_gym.mechanics.motion import quintic
from ves_gym.mechanics.spatial import matvec, quadratic, rotation
from ves_gym.system.system import System

# Lengths of the candidate seams, as shares of those asked for: shorter ones where none of the
# first fits (an arm that is slow for its size). The first that can be followed well counts.
_LENGTHS = np.repeat([1.0, 0.5, 0.25, 0.125], [14, 3, 2, 1])
_TRIES = len(_LENGTHS)  # per episode
_CHECKED = 33  # points along a seam at which that is looked at
_SPARE = np.deg2rad(8.0)  # between a seam and the joint limits, for what the sway asks
_STRAIGHT = 0.5  # share of seams that are lines


@lru_cache(maxsize=1)
def _on_a_boom() -> System:
    return System(vehicle=SHUTTLE_LIKE.at(REACHING_OUT), physics_dt=2.5e-3)


@register_task("seam")
@dataclass(frozen=True, kw_only=True)
class Seam(Track):
    """Follow a seam with the tool, a line or an arc fixed in space, while the boom sways.

    The arm (any: `arm=`) stands on the flange of a long flexible boom whose joints are on
    their brakes (`mechanics.boom`), the base of the system. The boom has been released: at the
    start its flange is displaced along a direction drawn uniformly over the sphere, so that
    the boom holds `energy`, and it sways on through the episode. The seam begins at the tool.
    It is `length` of the arm's reach long, and bends by up to `bend` in all or not at all;
    `rounds` counts passes along it, forth, back and so on, by the quintic law. Twenty seams
    are drawn, the last six shorter. The first counts that the arm can follow on a base at
    rest within its joint limits, at rates of at most `pace` of the joints' own, `dexterous`.

    Observation, reward, end and success are those of task `track`: solved where the root mean
    square of the tool's distance from where it was to be is within `tolerance`.
    """

    options: ClassVar[tuple[str, ...]] = ("q", "y")
    compiled: ClassVar[bool] = True
    system: System = _on_a_boom()
    rounds: int = 1
    pace: float = unit("1", default=0.6)
    dexterous: float = unit("m/rad", default=0.14)  # least `dexterity` along the seam
    length: tuple[float, float] = unit("1", default=(0.25, 0.5))  # of the arm's reach
    bend: float = unit("rad", default=np.pi / 2)
    energy: float = unit("J", default=3.0)  # strain energy of the boom at the start

    @property
    def draws(self) -> int:  # type: ignore[override]
        """See `Task`."""
        return 2 + (drawn_joints(self.system.arm) + 5) * _TRIES

    def __post_init__(self) -> None:
        super().__post_init__()
        require_positive(self, "energy")
        require_positive(self, "bend", zero=True)
        low, high = self.length
        if not 0 < low <= high:
            raise ParameterError(f"seam.length must be 0 < low <= high, got {low}, {high}")
        softest = float(np.linalg.eigvalsh(self._stiffness)[0])
        if softest <= 0:
            raise ParameterError(
                "seam needs a base that holds its place, got"
                f" {type(self.system.vehicle).__name__} with a stiffness of {softest:.3g}"
            )

    @cached_property
    def _stiffness(self) -> Array:
        return self.system.ideal().base.K

    @cached_property
    def _phase(self) -> Array:
        """(steps + 1,) rad, at the end of every period; pi per pass."""
        time = np.arange(self.steps + 1) / self.steps
        return np.asarray(np.pi * self.rounds * quintic(time), dtype=np.float64)

    def start(self, u: Array, **options: Array) -> Start:
        """See `Task`. Goal: the energy that counts as one [J], then the seam's points [m]."""
        arm, k = self.system.arm, len(u)
        y = options["y"] if "y" in options else self._released(u[:, :2])
        drawn = u[:, 2:].reshape(k, _TRIES, -1)
        low, high = joint_box(self, (0.0,), self.span)
        q = low + (high - low) * drawn[..., : arm.n]
        if "q" in options:
            q = np.broadcast_to(options["q"][:, None], q.shape)
        shape = _shapes(drawn[..., -5:], self.length, self.bend, _reach(arm))
        shape[..., 6] *= _LENGTHS
        first = joint_positions(arm, q)[..., -1, :]
        shares = np.linspace(0.0, 1.0, _CHECKED)
        points = first[..., None, :] + _points(shape, shares)
        along, lack = self._followed(q, points)
        rows = np.arange(k)
        best = lack.argmin(axis=1)
        share = (1 - np.cos(self._phase)) / 2
        tool = y[:, :3] + matvec(rotation(y), first[rows, best])  # where the boom holds it
        path = tool[:, None] + _points(shape[rows, best], share)
        plan = _between(along[rows, best], shares, share)
        stride = max(1, round(0.1 / self.system.control_dt))
        energy = motion_energy(
            self._modes, plan[:, ::stride], stride * self.system.control_dt, self.tail
        )
        goal = np.column_stack([energy + quadratic(self._stiffness, y), path.reshape(k, -1)])
        return Start(q[rows, best], goal, y=y)

    def _released(self, u: Array) -> Array:
        """(k, 6) displacements under a force at the flange, which hold `energy`."""
        up, turn = 2 * u[:, 0] - 1, 2 * np.pi * u[:, 1]
        flat = np.sqrt(1 - up**2)
        force = np.zeros((len(u), 6))
        force[:, :3] = np.column_stack([flat * np.cos(turn), flat * np.sin(turn), up])
        compliance = np.linalg.inv(self._stiffness)
        y = (force[:, None] @ compliance)[:, 0]
        scale = np.sqrt(self.energy / quadratic(self._stiffness, y))
        return np.asarray(y * scale[:, None], dtype=np.float64)

    def _followed(self, q: Array, points: Array) -> tuple[Array, Array]:
        """Joint angles along seams from q, and how far each is from one that is well followed.

        Args:
            q: (k, tries, joints) at the start [rad].
            points: (k, tries, m, 3) evenly along the seams [m].

        Returns:
            (k, tries, m, joints), and (k, tries) zero where nothing is lacking.
        """
        arm = self.system.arm
        low, high = arm.column("q_min") + _SPARE, arm.column("q_max") - _SPARE
        plan, lack = [q], np.zeros(q.shape[:2])
        for point in np.moveaxis(points, 2, 0)[1:]:
            at, gap = pursued(arm, plan[-1], point)
            plan.append(at)
            short = 1 - dexterity(arm, at) / self.dexterous
            out = np.maximum(np.maximum(low - at, at - high).max(axis=-1), 0.0)
            missed = np.linalg.norm(gap, axis=-1) / self.tolerance
            lack = np.maximum(lack, np.maximum(short, 0.0) + out + np.maximum(missed - 1, 0.0))
        along = np.stack(plan, axis=2)
        rate = np.abs(np.gradient(along, axis=2)) * (_CHECKED - 1)  # per pass
        fastest = np.abs(np.gradient(self._phase)).max() / (2 * self.system.control_dt)
        pace = (rate * fastest / (self.pace * arm.column("v_max"))).max(axis=(-2, -1))
        return along, lack + np.maximum(pace - 1, 0.0)


def _reach(arm: Arm) -> float:
    """Length of an arm beyond its first joint, stretched out [m]."""
    return float(sum(np.hypot(k.a, k.d) for k in arm.links[1:]))


def _shapes(u: Array, length: tuple[float, float], bend: float, reach: float) -> Array:
    """Seams (..., 8): direction (3) and normal (3), length [m], angle by which each bends."""
    up, turn = 2 * u[..., 0] - 1, 2 * np.pi * u[..., 1]
    flat = np.sqrt(1 - up**2)
    ahead = np.stack([flat * np.cos(turn), flat * np.sin(turn), up], axis=-1)
    level = np.stack([-np.sin(turn), np.cos(turn), np.zeros_like(turn)], axis=-1)
    upright = np.cross(ahead, level)
    roll = 2 * np.pi * u[..., 2, None]
    normal = np.cos(roll) * level + np.sin(roll) * upright
    size = reach * (length[0] + (length[1] - length[0]) * u[..., 3])
    angle = bend * np.maximum(u[..., 4] - _STRAIGHT, 0.0) / (1 - _STRAIGHT)
    return np.concatenate([ahead, normal, size[..., None], angle[..., None]], axis=-1)


def _points(shape: Array, share: Array) -> Array:
    """Points (..., m, 3) of seams (..., 8) from their starts at shares (m,) of the length."""
    ahead, normal, size, angle = np.split(shape[..., None, :], [3, 6, 7], axis=-1)
    turned = angle * share[:, None]
    along = share[:, None] * np.sinc(turned / np.pi)
    aside = share[:, None] * np.sin(turned / 2) * np.sinc(turned / (2 * np.pi))
    return np.asarray(size * (along * ahead + aside * normal), dtype=np.float64)


def _between(along: Array, shares: Array, at: Array) -> Array:
    """Joint angles (k, m, joints) at other shares of seams, linear in between."""
    place = np.interp(at, shares, np.arange(len(shares)))
    before = np.minimum(place.astype(int), len(shares) - 2)
    rest = (place - before)[:, None]
    return np.asarray((1 - rest) * along[:, before] + rest * along[:, before + 1])
