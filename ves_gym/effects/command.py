"""Joint commands on their way to the drives."""

from __future__ import annotations

from dataclasses import dataclass

from ves_gym.system.deviations import Delays
from ves_gym.system.effect import DelayEffect, parameter, register


@register("command/delay")
@dataclass(frozen=True, kw_only=True)
class CommandDelay(DelayEffect):
    """The drives get the joint commands `delay` later than they are sent.

    Between two physics steps commands are linear; before the first one they are that one.
    The log shows the command sent, and the torque by what has arrived (derived here).
    """

    modes = ("ideal", "emulated")
    port = "joint"
    shows = ("servo",)
    delay: float = parameter("s", bounds=(0.0, 0.1), start=5e-3)

    def wire(self, delays: Delays) -> None:
        """Add to the delay of all simulations."""
        delays.command = delays.command + self.delay
