"""The Stewart platform: six legs between floor and platform top (thesis 2.1, 2.4.2).

Y = 0 is the home pose: level, the platform-top frame `home_height` above the floor frame,
axes parallel. The thesis does not print the dimensions of the VES II; `VES` is nominal.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import (
    Array,
    Index,
    Mask,
    Matrix,
    ParameterError,
    finite,
    freeze_arrays,
    require_positive,
    unit,
)
from ves_gym.mechanics.spatial import matvec, numbers, rotation, solve, twist, twist_rate

TOLERANCE = 1e-12  # [m] leg length error at which `forward` stops: 10^4 roundings of a leg
_ITERATIONS = 20
_SINGULAR = 1e-2  # smallest singular value of the home Jacobian, lengths over joint radius


@dataclass(frozen=True, kw_only=True)
class Stewart:
    """Joint positions and limits of a platform with six legs.

    `base` in the floor frame, `top` in the platform-top frame; leg i joins row i to row i.

    Raises:
        ParameterError: wrong shapes, limits out of order, a home pose outside the limits,
            or a geometry whose legs do not hold the platform there (singular).
    """

    kind: ClassVar[str] = "stewart"
    base: Matrix = unit("m")  # (6, 3)
    top: Matrix = unit("m")  # (6, 3)
    home_height: float = unit("m")
    length_min: float = unit("m")
    length_max: float = unit("m")
    speed_max: float = unit("m/s")  # of a leg
    source: str = "user"

    def __post_init__(self) -> None:
        freeze_arrays(self)
        require_positive(self, "home_height", "length_min", "length_max", "speed_max")
        for name in ("base", "top"):
            finite(getattr(self, name), (6, 3), f"Stewart.{name}")
        if self.length_min >= self.length_max:
            raise ParameterError(
                f"Stewart.length_min must be < length_max {self.length_max} m,"
                f" got {self.length_min} m"
            )
        lengths = self.home_lengths
        if lengths.min() < self.length_min or lengths.max() > self.length_max:
            raise ParameterError(
                f"Stewart: the home pose needs leg lengths {lengths.round(4).tolist()} m,"
                f" outside {self.length_min} to {self.length_max} m"
            )
        radius = np.linalg.norm(self._top, axis=0).mean()
        scaled = self.jacobian(np.zeros(6)) / np.array([1.0] * 3 + [radius] * 3)
        least = float(np.linalg.svd(scaled, compute_uv=False)[-1])
        if not least > _SINGULAR:
            raise ParameterError(
                "Stewart: the legs do not hold the platform at home: smallest singular value"
                f" of the Jacobian {least:.3g}, need > {_SINGULAR} (joints in coinciding or"
                " parallel patterns?)"
            )

    @property
    def feet(self) -> Array:
        """(6, 3) base joints seen from the home position of the platform-top frame [m]."""
        return np.array(self.base) - [0.0, 0.0, self.home_height]

    @cached_property
    def _base(self) -> Array:
        """(3, 6) `feet`, component by component."""
        return self.feet.T

    @cached_property
    def _top(self) -> Array:
        """(3, 6) upper joints in the platform-top frame."""
        return np.array(self.top).T

    @property
    def home_lengths(self) -> Array:
        """(6,) leg lengths at Y = 0 [m]."""
        return self.leg_lengths(np.zeros(6))

    # -------------------------------------------------------------------- kinematics

    def leg_lengths(self, y: npt.ArrayLike) -> Array:
        """Inverse kinematics: (..., 6) pose -> (..., 6) lengths [m]."""
        pose = numbers(y)
        return _norm(self._legs(pose, rotation(pose))[1])

    def jacobian(self, y: npt.ArrayLike) -> Array:
        """(..., 6, 6) J with l' = J Y' [1, m/rad]."""
        pose = numbers(y)
        R = rotation(pose)
        arm, d = self._legs(pose, R)
        length = _norm(d)
        along = [c / length for c in d]
        moment = _cross(arm, along)
        J = np.zeros_like(length, shape=(*length.shape, 6))
        for i in range(3):
            J[..., i] = along[i]
        # moment times the axes of the Z-Y-X angle rates: R e_x, Rot_z e_y, e_z
        cz, sz = np.cos(pose[..., 5, None]), np.sin(pose[..., 5, None])
        J[..., 3] = _dot([R[..., i, 0, None] for i in range(3)], moment)
        J[..., 4] = cz * moment[1] - sz * moment[0]
        J[..., 5] = moment[2]
        return J

    def forward(self, lengths: npt.ArrayLike, start: npt.ArrayLike) -> Array:
        """Forward kinematics by Newton's method from a nearby pose, to `TOLERANCE`.

        Args:
            lengths: (n, 6) [m].
            start: (n, 6) poses near the answer, such as the last ones.

        Returns:
            (n, 6) poses; a row is NaN where no pose was found: the iteration met a
            singular Jacobian, made a step of more than 1 m or rad, or did not settle.
        """
        goal, pose = np.asarray(lengths, float), np.array(start, float)
        rows = np.flatnonzero(np.isfinite(pose).all(axis=-1) & np.isfinite(goal).all(axis=-1))
        solved = np.zeros(len(pose), bool)
        for _ in range(_ITERATIONS):
            error = goal[rows] - self.leg_lengths(pose[rows])
            near = np.abs(error).max(axis=-1, initial=0.0) < TOLERANCE
            solved[rows[near]] = True
            rows, error = rows[~near], error[~near]
            if not len(rows):
                break
            step = solve(self.jacobian(pose[rows]), error)
            good = np.abs(step).max(axis=-1) < 1.0  # False for NaN
            rows = rows[good]
            pose[rows] += step[good]
        pose[~solved] = np.nan
        return pose

    def step_to(self, y: Array, lengths: Array) -> tuple[Array, Array]:
        """Return a step of Newton's method towards the pose of given leg lengths.

        By the normal equations, which elimination solves in any order; their condition is
        some 10^3 at home, and the next step corrects what that costs.

        Args:
            y: (..., 6) where to start [m, rad].
            lengths: (..., 6) [m].

        Returns:
            The better pose (..., 6), and the largest error (...) of a length before [m].
        """
        error, J = lengths - self.leg_lengths(y), self.jacobian(y)
        return y + _least_squares(J, error), np.max(np.abs(error), axis=-1)

    def motion(self, y: Array, speeds: Array, accelerations: Array) -> tuple[Array, Array]:
        """Return Y' and Y'' (..., 6) of leg motions.

        l'' = J Y'' + h, with h from the curvature of the joints' paths.

        Args:
            y: (..., 6) poses [m, rad].
            speeds: (..., 6) of the legs [m/s].
            accelerations: (..., 6) of the legs [m/s^2].
        """
        J = self.jacobian(y)
        yd = _least_squares(J, speeds)
        push = accelerations - self._curvature(y, yd, speeds)
        return yd, _least_squares(J, push)

    def _curvature(self, pose: Array, yd: Array, ld: Array) -> Array:
        """(..., 6) leg accelerations h at Y'' = 0 [m/s^2]."""
        R = rotation(pose)
        _, d = self._legs(pose, R)
        length = _norm(d)
        leg = [_dot([R[..., i, k, None] for i in range(3)], d) for k in range(3)]
        v = list(np.moveaxis(twist(pose, yd), -1, 0)[..., None])
        turn = list(np.moveaxis(twist_rate(pose, yd, 0 * yd), -1, 0)[3:, ..., None])
        arm = list(self._top)
        spin = _cross(v[3:], arm)
        bend = [a + b for a, b in zip(_cross(turn, arm), _cross(v[3:], spin), strict=True)]
        speed = [v[k] + spin[k] for k in range(3)]
        return (_dot(leg, bend) + _dot(speed, speed) - ld**2) / length

    def _legs(self, pose: Array, R: Array) -> tuple[list[Array], list[Array]]:
        """Components (..., 6) of the turned upper joints R a and of the leg vectors."""
        # Element by element: a BLAS product may round differently for another batch size.
        a = self._top
        arm = [
            R[..., i, 0, None] * a[0] + R[..., i, 1, None] * a[1] + R[..., i, 2, None] * a[2]
            for i in range(3)
        ]
        return arm, [arm[i] + pose[..., i, None] - self._base[i] for i in range(3)]

    # ------------------------------------------------------------------------ limits

    def beyond(self, lengths: Array) -> tuple[Mask, Index, Array]:
        """Return the poses that need a leg beyond its end stops.

        Args:
            lengths: (..., 6) of the legs [m].

        Returns:
            Mask (...,); index 0 to 5 of the leg with the least clearance (...,); its
            length (...,) [m]. What is NaN is beyond.
        """
        excess = np.maximum(self.length_min - lengths, lengths - self.length_max)
        return _worst(excess, lengths)

    def too_fast(self, before: Array, after: Array, dt: float) -> tuple[Mask, Index, Array]:
        """Return the changes of leg lengths that are faster than `speed_max`.

        Args:
            before, after: (..., 6) leg lengths [m].
            dt: time between them [s].

        Returns:
            As `beyond`, with the speed [m/s].
        """
        speeds = np.abs(after - before) / dt
        return _worst(speeds - self.speed_max, speeds)


def _dot(a: list[Array], b: list[Array]) -> Array:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _norm(a: list[Array]) -> Array:
    return np.sqrt(_dot(a, a))


def _cross(a: list[Array], b: list[Array]) -> list[Array]:
    return [a[i - 2] * b[i - 1] - a[i - 1] * b[i - 2] for i in range(3)]


def _worst(excess: Array, values: Array) -> tuple[Mask, Index, Array]:
    leg = np.argmax(excess, axis=-1)  # NaN counts as the largest
    at = leg[..., None]
    worst = np.take_along_axis(excess, at, -1)[..., 0]
    return ~(worst <= 0), leg, np.take_along_axis(values, at, -1)[..., 0]


def _least_squares(J: Array, b: Array) -> Array:
    """x (..., 6) of J x = b."""
    turned = np.swapaxes(J, -1, -2)
    return solve(turned @ J, matvec(turned, b))


def _hexagonal() -> Stewart:
    """Joints in pairs on circles of 1 and 0.7 m, the platform level on half-extended legs.

    Base pairs lie around 0, 120, 240 deg from x, top pairs around 60, 180, 300; 20 deg between
    the joints of a pair; the upper joints 0.1 m below the platform-top frame.
    """
    spread, depth, shortest, longest = float(np.deg2rad(20)), 0.1, 1.1, 1.9
    side = np.array([1, -1] * 3)  # leg after, leg before a base pair's middle
    base_at = np.deg2rad([0, 120, 120, 240, 240, 360]) + side * spread / 2
    top_at = np.deg2rad([60, 60, 180, 180, 300, 300]) - side * spread / 2
    base, top = (
        np.stack([r * np.cos(at), r * np.sin(at), np.full(6, z)], axis=-1)
        for r, at, z in ((1.0, base_at, 0.0), (0.7, top_at, -depth))
    )
    rise = ((shortest + longest) / 2) ** 2 - float(np.sum((top - base)[0, :2] ** 2))
    return Stewart(
        base=tuple(map(tuple, base.tolist())),
        top=tuple(map(tuple, top.tolist())),
        home_height=float(np.sqrt(rise)) + depth,
        length_min=shortest,
        length_max=longest,
        speed_max=1.0,
        source="nominal, this project: the thesis prints no dimensions",
    )


VES = _hexagonal()
