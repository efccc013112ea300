"""Take the energy out of a disturbed base by moving the arm."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from ves_gym._util.params import Array, Mask, ParameterError, Vector, unit
from ves_gym.envs.arm_task import ArmTask, directions, rate_fields, rates, wide
from ves_gym.envs.control import Control, Torque
from ves_gym.envs.scales import released_energy
from ves_gym.envs.task import Field, Scene, Start, register_task
from ves_gym.mechanics.dynamics import inertia
from ves_gym.mechanics.modes import natural_modes
from ves_gym.mechanics.servo import PPED_GAINS
from ves_gym.mechanics.spatial import quadratic


@register_task("damp")
class Damp(ArmTask):
    """The base is displaced and released, the arm at rest; damp it by moving the arm.

    In thesis 4.3.2 Y(0) is 0.1 m along x, y and z, 82 J in the bent beam's springs. Here the
    direction is drawn, uniform over the sphere, and the displacement stores `energy`. On the
    bent beam 25 J are 0.06 m along x or z and 0.11 m along y. The joints start anywhere in
    `home` +- `span`, about the thesis's (45, 0, 0) deg.

    Control: `torque` on top of the joint damping of the PPED gains (eq. 4.5b); `pd_gains`, the
    servos' gains about the start, which is the thesis's means; or `acceleration`. The base is
    observed in its modes with the arm at home, each with its energy: from these a policy learns
    faster than from pose and rate.

    Cost: `energy` is the time integral of the strain energy over that with the joints locked
    where they start (closed form, `released_energy`). `astray` counts joints further than
    `room` from home. Solved: the integral is at most `saving` times that of locked joints.

    Measured on `bent-thesis`, 512 starts of seed 0, over the integral with servos at the high
    gains (eq. 4.6): PPED gains 0.99, random gains 0.90, no torque 1.01, one LQR feedback for
    all starts, saturated, 0.60. Along y the arm acts little on the slow modes: single starts
    range from 0.4 to 0.9.
    """

    options: ClassVar[tuple[str, ...]] = ("q", "y")
    compiled: ClassVar[bool] = True
    rows: ClassVar[int] = 1
    more: ClassVar[int] = 2
    controls: ClassVar[tuple[str, ...]] = ("torque", "pd_gains", "acceleration")
    positive: ClassVar[tuple[str, ...]] = ("energy", "saving")
    not_negative: ClassVar[tuple[str, ...]] = ("astray",)
    memory: ClassVar[int] = 1  # J s, integral of the strain energy
    control: Control = Torque(fraction=0.5, damping=PPED_GAINS.kd)
    duration: float = unit("s", default=8.0)
    tail: float = unit("s", default=0.0)
    energy: float = unit("J", default=25.0)  # strain energy at the start
    home: Vector = unit("rad", default=tuple(np.deg2rad([45.0, 0.0, 0.0]).tolist()))
    span: Vector = unit("rad", default=tuple(np.deg2rad([30.0, 30.0, 30.0]).tolist()))
    room: Vector = unit("rad", default=tuple(np.deg2rad([60.0, 60.0, 60.0]).tolist()))
    astray: float = unit("1/(rad s)", default=0.2)
    saving: float = unit("1", default=0.65)  # most of the locked arm's integral

    def __post_init__(self) -> None:
        super().__post_init__()
        softest = float(np.linalg.eigvalsh(self._stiffness)[0])
        if softest <= 0:
            raise ParameterError(
                f"damp needs a vehicle with a positive definite stiffness, got"
                f" {type(self.system.vehicle).__name__} with an eigenvalue {softest:.3g}"
            )

    @cached_property
    def _stiffness(self) -> Array:
        return self.system.ideal().base.K

    @cached_property
    def _modes(self) -> tuple[Array, Array]:
        """Y and Y' (6,) -> root of strain and of kinetic energy of every mode, arm at home."""
        M, _, K = self.system.ideal().base.condensed()  # draws start with modes that follow
        Mt = M + inertia(self.system.arm, self.middle)[:6, :6]
        omega, shapes = natural_modes(K, Mt)
        return Mt @ shapes * omega / np.sqrt(2), Mt @ shapes / np.sqrt(2)

    @cached_property
    def _room(self) -> Array:
        return wide(self.room, self.system.arm)

    def check_options(
        self, options: Mapping[str, Any] | None, extra: tuple[str, ...], rows: int | None = None
    ) -> dict[str, Any]:
        """See `Task`. y must strain the base."""
        out = super().check_options(options, extra, rows)
        for y in np.atleast_2d(out.get("y", np.empty((0, 6)))):
            if not quadratic(self._stiffness, y) > 0:
                raise ParameterError(f"options['y'] must strain the base, got {y.tolist()}")
        return out

    def start(self, u: Array, **options: Array) -> Start:
        """See `Task`. Goal: joint angles at the start (joints), and the integral of the strain
        energy with the joints locked [J s].
        """
        n = self.system.arm.n
        low, high = self.box
        q = options.get("q", low + (high - low) * u[:, 2 : 2 + n])
        y = options.get("y", self._released(u[:, :2]))
        locked = released_energy(self.system.ideal(), q, y, self.duration)
        return Start(q, np.column_stack([q, locked]), y=y)

    def remember(self, s: Scene, dt: float) -> None:
        s.memory[:, 0] += dt * s.strain

    def _released(self, u: Array) -> Array:
        """(k, 6) displacements that hold `energy`, directions uniform over the sphere."""
        y = np.concatenate([directions(u), np.zeros((len(u), 3))], axis=1)
        return np.asarray(
            y * np.sqrt(self.energy / quadratic(self._stiffness, y))[:, None], dtype=np.float64
        )

    def fields(self) -> tuple[Field, ...]:
        root, energies = np.full(6, np.sqrt(self.energy)), np.full(6, self.energy)
        parts = (
            Field("joint_angle", "rad", self._room, "joint angles less `home`"),
            *rate_fields(self.control, self.system.arm),
            Field("mode_shift", "J^0.5", root / 2, "base modes: signed root of strain energy"),
            Field("mode_rate", "J^0.5", root / 2, "base modes: signed root of kinetic energy"),
            Field("mode_energy", "J", energies / 4, "base modes: energy"),
            self.time_left,
        )
        if self.control.level != "gains":
            return parts
        return *parts, Field("stretch", "rad", self._room / 6, "joint angles less where held")

    def observe(self, s: Scene) -> tuple[Array, ...]:
        to_shift, to_rate = self._modes
        # row by row: in the product of all rows at once BLAS rounds by their number
        shift, rate = (s.y_seen[:, None] @ to_shift)[:, 0], (s.yd_seen[:, None] @ to_rate)[:, 0]
        away, energy = s.q - self.middle, shift**2 + rate**2
        parts = (away, *rates(self.control, s), shift, rate, energy, self.left(s))
        if self.control.level != "gains":
            return parts
        return *parts, s.q - s.goal[:, : self.system.arm.n]

    def costs(self, s: Scene, dt: float, last: Mask) -> dict[str, Array]:
        beyond = np.maximum(np.abs(s.q - self.middle) - self._room, 0.0).sum(axis=1)
        return {
            "energy": s.strain * dt / s.goal[:, self.system.arm.n],
            "astray": self.astray * dt * beyond,
        }

    def success(self, s: Scene) -> Mask:
        """The base has as little energy over the whole episode as `saving` asks."""
        over: Mask = s.time > self.duration - self.system.control_dt / 2
        return over & (s.memory[:, 0] <= self.saving * s.goal[:, self.system.arm.n])
