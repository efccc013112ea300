"""The platform on six leg servos at work: what they remember over a control period."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import Array
from ves_gym.hardware.leg_servo import ACCELERATION, ROD, SPEED, Leg, LegServo, whole_steps
from ves_gym.hardware.stewart import Stewart

_NEAR = 1e-6  # [m] error of a length that one more step of Newton's method makes rounding
_FROM_AFAR = 3  # steps from the pose to that of bent, quantised legs


class Legs:
    """The platform on its six leg servos: what carries their state over a control period.

    Every control period begins with a leg sample, so no simulation carries a clock. States
    are (n, s, 6): `s` numbers of each leg, of n simulations that share nothing.
    """

    def __init__(
        self, servo: LegServo, stewart: Stewart, control_dt: float, physics_dt: float
    ) -> None:
        """Settle the clocks.

        Raises:
            ParameterError: control_dt is no whole number of leg periods, or the leg period
                no whole number of physics steps (to 1e-9).
        """
        period = 1 / servo.rate
        self.samples = whole_steps("control_dt", control_dt, period)
        steps = whole_steps("physics_dt", physics_dt, period, divides=True)
        extension = (stewart.home_lengths.mean() - stewart.length_min) / (
            stewart.length_max - stewart.length_min
        )
        self.servo, self.stewart = servo, stewart
        self.leg = Leg(servo, float(extension), steps)

    def at_rest(self, y: npt.ArrayLike) -> Array:
        """State (n, s, 6) of legs at rest at poses (n, 6), which they are commanded."""
        return np.moveaxis(self.leg.steady_state(self.stewart.leg_lengths(y)), 0, 1)

    def advance(
        self,
        state: Array,
        pose: Array,
        y_cmd: Array,
        gain: Array | float = 1.0,
        brake: Array | float = 1.0,
    ) -> tuple[Array, Array, Array, Array, Array]:
        """Follow a pose that is held for one period of the leg controller.

        The legs are sent lengths only (thesis 2.4.2): the commanded rate is not used.

        Args:
            state: (n, s, 6) of the legs.
            pose: (n, 6) of the platform [m, rad].
            y_cmd: (n, 6) commanded pose [m, rad].
            gain, brake: (n, 1) of the servos over those stated, see `Leg.sample`.

        Returns:
            State and pose at the end, and Y, Y', Y'' (n, steps, 6) at the starts of the
            physics steps. NaN where the legs hold no platform (`stewart.forward`).
        """
        leg, stewart, h = self.leg, self.stewart, 1 / (self.servo.rate * self.leg.steps)
        x, y, path = np.moveaxis(state, 1, 0).copy(), pose, []
        u = leg.sample(x, stewart.leg_lengths(y_cmd), gain, brake)
        for _ in range(leg.steps):
            yd, ydd = stewart.motion(y, x[SPEED], x[ACCELERATION])
            path.append((y, yd, ydd))
            leg.drift(x, u)
            # where this motion leads, then Newton's method
            y, _ = stewart.step_to(y + h * yd + h * h / 2 * ydd, x[ROD])
            y = self._settled(y, x[ROD])
        at, rate, acceleration = zip(*path, strict=True)
        over = [np.stack(part, axis=1) for part in (at, rate, acceleration)]
        return np.moveaxis(x, 0, 1), y, over[0], over[1], over[2]

    def motion(self, state: Array, pose: Array) -> tuple[Array, Array]:
        """Return Y' and Y'' (n, 6) of the platform.

        Args:
            state, pose: see `advance`.
        """
        return self.stewart.motion(pose, state[:, SPEED], state[:, ACCELERATION])

    def present(self, state: Array, pose: Array) -> tuple[Array, Array]:
        """Return pose and rate (n, 6) that the legs have now.

        Args:
            state, pose: see `advance`.
        """
        y = self.stewart.forward(state[:, ROD], pose)
        return y, self.motion(state, y)[0]

    def measured(self, state: Array, pose: Array) -> Array:
        """Return the pose (n, 6) by forward kinematics of the measured lengths.

        Args:
            state, pose: see `advance`.

        Returns:
            NaN as `advance`.
        """
        lengths = self.leg.measure(np.moveaxis(state, 1, 0))
        y = pose
        for _ in range(_FROM_AFAR):
            y, _ = self.stewart.step_to(y, lengths)
        return self._settled(y, lengths)

    def _settled(self, y: Array, lengths: Array) -> Array:
        """A last step of Newton's method (n, 6); NaN where it is not the last one."""
        better, error = self.stewart.step_to(y, lengths)
        found = (error <= _NEAR)[:, None]
        return np.where(found, better, np.nan)
