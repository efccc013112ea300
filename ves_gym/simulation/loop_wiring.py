"""The wiring list of an emulated system: which blocks its loop has, in which order."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ves_gym.hardware.admittance import Nonlinear
from ves_gym.hardware.leg_servo import Legs, LegServo
from ves_gym.hardware.platform import PoseServo
from ves_gym.simulation.blocks.admittance import (
    CoupledAdmittance,
    LinearAdmittance,
    NonlinearAdmittance,
)
from ves_gym.simulation.blocks.block import Block, LoopShape, ModelOf
from ves_gym.simulation.blocks.force_sensor import ForceSensorBlock
from ves_gym.simulation.blocks.gravity_estimate import GravityEstimate
from ves_gym.simulation.blocks.payload_compensation import ArmInertia, PayloadCompensation
from ves_gym.simulation.blocks.platform import (
    CommandLine,
    ComputingDelay,
    EngineInput,
    LegSensors,
    LegServos,
    PosePlatform,
    Safety,
)
from ves_gym.simulation.blocks.wiring import Wiring
from ves_gym.system.deviations import LoopParameters
from ves_gym.system.system import System

_WATCHED = ("reading", "weight", "y_measured", "command", "command_sent", "frozen")


@dataclass(frozen=True)
class Needs:
    """Requirements of a loop's parameters on its blocks."""

    commands: int = 0  # to look back over; none where every platform hears at once
    estimates: int = 0  # of the weight to look back over
    limited: bool = False  # legs may be short or slow
    modelled: bool = False  # the compensation needs a model of a platform not as stated
    tabulated: bool = False  # the weight comes from a table

    @staticmethod
    def of(p: LoopParameters, dt: float, *, compensating: bool, tabulated: bool) -> Needs:
        """Return what parameters ask for.

        Args:
            p: of all simulations.
            dt: control period [s].
            compensating: the payload is compensated.
            tabulated: the weight comes from a table.
        """
        delay = float(p.platform_delay.max())
        return Needs(
            commands=_periods(delay, dt) if delay > 0 else 0,
            estimates=_periods(float(p.gravity_delay.max()), dt),
            limited=bool((p.platform_travel > 0).any() or (p.platform_speed > 0).any()),
            modelled=compensating and not p.as_stated,
            tabulated=tabulated,
        )

    def joined(self, earlier: Needs) -> Needs:
        """The same, and what was asked for earlier but for a table: memory never shrinks."""
        return Needs(
            commands=max(self.commands, earlier.commands),
            estimates=max(self.estimates, earlier.estimates),
            limited=self.limited or earlier.limited,
            modelled=self.modelled or earlier.modelled,
            tabulated=self.tabulated,
        )


def _periods(age: float, dt: float) -> int:
    """Number of values remembered to look back by an age [s]."""
    return int(np.ceil(age / dt - 1e-9)) + 1


class LoopParts:
    """Blocks of a system's emulation loop, and the wires between them.

    Args:
        system: an emulated one.
        needs: of the simulations' parameters.
        inertia: of the arm, where the payload is compensated.
        custom: g(X, W) in place of the system's vehicle.
    """

    def __init__(
        self,
        system: System,
        needs: Needs,
        inertia: ArmInertia | None,
        custom: Nonlinear | None,
    ) -> None:
        spec = system.emulator_settings
        clock = system.control_dt, system.physics_dt
        self._system, self._inertia, self._custom = system, inertia, custom
        self._legs: Legs | None = None
        if isinstance(spec.platform, LegServo):
            self._legs = Legs(spec.platform, spec.stewart, *clock)
        states = 0 if self._legs is None else self._legs.leg.size
        self.shape = LoopShape(system.substeps + 1, system.arm.n, *clock, states)
        # joints that give way to the compensated load
        self._moving = system.arm.n if system.drive == "motor" and inertia is not None else 0
        platform = self._platform(as_stated=False)
        self.platform = platform[0]  # has its state
        self.sensor = ForceSensorBlock(spec.sensor, self.shape)
        self.estimate: GravityEstimate | None = None
        if spec.operation == "microgravity":
            self.estimate = GravityEstimate(
                system.arm, self.shape, needs.estimates, needs.tabulated
            )
        before, after = self._before(needs, platform), self._after()
        external = self._external(needs)
        watched = [k for k in _WATCHED if k not in external]
        self.wiring = Wiring(before, after, external, watched)

    def _before(self, needs: Needs, platform: list[Any]) -> list[Block]:
        """From the present readings to what the engine's platform is given."""
        spec, shape = self._system.emulator_settings, self.shape
        out: list[Block] = [] if self._inertia is None else [self._inertia]
        if spec.operation != "position":
            out.append(self._admittance())
        out += [
            ComputingDelay(spec.delay),
            Safety(spec, shape),
            CommandLine(spec.stewart, shape, needs.commands, needs.limited),
            *platform,
        ]
        if self._inertia is not None:
            if needs.modelled:  # a machine as stated is its own model
                out += [ModelOf(block) for block in self._platform(as_stated=True)]
            cutoff = spec.sensor.cutoff
            out.append(PayloadCompensation(shape, self._moving, cutoff, needs.modelled))
        return [*out, EngineInput(shape)]

    def _after(self) -> list[Block]:
        """From the engine's wrench to the next readings."""
        return [self.sensor] if self.estimate is None else [self.sensor, self.estimate]

    def _external(self, needs: Needs) -> list[str]:
        """Signals that come from outside the loop."""
        out = ["q", "y_engine", "yd_engine", "wrench", "draws"]
        if self._inertia is not None:
            out += ["kp", "kd"]
        if self._system.emulator_settings.operation == "position":
            out.append("motion")
        if needs.tabulated:
            out.append("table")
        if self.estimate is None:
            out.append("weight")
        return out

    def _admittance(self) -> Block:
        base, spec = self._system.actual.base, self._system.emulator_settings
        carried = base.m
        nonlinear = base.body is not None or self._custom is not None
        if self._inertia is not None:
            lag = spec.lag(self.shape.control_dt)
            return CoupledAdmittance(
                self.shape, carried, self._moving, lag, nonlinear, self._custom
            )
        if nonlinear:
            return NonlinearAdmittance(self.shape, self._custom)
        return LinearAdmittance(self.shape, carried)

    def _platform(self, *, as_stated: bool) -> list[Any]:
        """Blocks of the platform; the first has its state."""
        if self._legs is not None:
            return [LegServos(self._legs, as_stated=as_stated), LegSensors(self._legs)]
        servo = self._system.emulator_settings.platform
        assert isinstance(servo, PoseServo)
        return [PosePlatform(servo, self.shape, as_stated=as_stated)]
