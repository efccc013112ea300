"""The wiring list of an emulated system: which blocks its loop has, in which order."""

from __future__ import annotations

from typing import Any, NamedTuple

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
from ves_gym.simulation.blocks.platform import (
    CommandLine,
    ComputingDelay,
    EngineInput,
    LegSensors,
    LegServos,
    PosePlatform,
    Safety,
)
from ves_gym.simulation.blocks.sensing import (
    ArmInertia,
    ForceSensorBlock,
    GravityEstimate,
    PayloadCompensation,
)
from ves_gym.simulation.blocks.wiring import Wiring
from ves_gym.system.deviations import LoopParameters
from ves_gym.system.system import System

_WATCHED = ("reading", "weight", "y_measured", "command", "command_sent", "frozen")


class Needs(NamedTuple):
    """Requirements of a loop's parameters on its blocks."""

    commands: int = 0  # to look back over; none where every platform hears at once
    estimates: int = 0  # of the weight to look back over
    limited: bool = False  # legs may be short or slow
    modelled: bool = False  # the compensation needs a model of a platform not as stated
    tabulated: bool = False  # the weight comes from a table

    @staticmethod
    def of(p: LoopParameters, dt: float, compensating: bool, tabulated: bool) -> Needs:
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
        """The same, and what was requested earlier but for a table: memory never shrinks."""
        fields = ("commands", "estimates", "limited", "modelled")
        return self._replace(**{k: max(getattr(self, k), getattr(earlier, k)) for k in fields})


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
        self, system: System, needs: Needs, inertia: ArmInertia | None, custom: Nonlinear | None
    ) -> None:
        spec, arm = system.emulator_settings, system.arm
        clock = system.control_dt, system.physics_dt
        legs: Legs | None = None
        if isinstance(spec.platform, LegServo):
            legs = Legs(spec.platform, spec.stewart, *clock)
        states = 0 if legs is None else legs.leg.size
        self.shape = shape = LoopShape(system.substeps + 1, arm.n, *clock, states)

        def platform_of(as_stated: bool) -> list[Any]:
            """Blocks of the platform; the first has its state."""
            if legs is not None:
                return [LegServos(legs, as_stated=as_stated), LegSensors(legs)]
            assert isinstance(spec.platform, PoseServo)
            return [PosePlatform(spec.platform, shape, as_stated=as_stated)]

        platform = platform_of(as_stated=False)
        self.platform = platform[0]
        self.sensor = ForceSensorBlock(spec.sensor, shape)
        self.estimate: GravityEstimate | None = None
        external = ["q", "y_engine", "yd_engine", "wrench", "draws"]
        line = CommandLine(spec.stewart, shape, needs.commands, needs.limited)
        before: list[Block] = [ComputingDelay(spec.delay), Safety(spec, shape), line, *platform]
        after: list[Block] = [self.sensor]
        # joints that give way to the compensated load
        moving = arm.n if system.drive == "motor" and inertia is not None else 0
        if spec.operation == "position":
            external.append("motion")
        else:
            before.insert(0, _admittance(system, shape, moving, inertia is not None, custom))
        if inertia is not None:
            external += ["kp", "kd"]
            before.insert(0, inertia)
            if needs.modelled:  # a machine as stated is its own model
                before += [ModelOf(block) for block in platform_of(as_stated=True)]
            before.append(
                PayloadCompensation(shape, moving, spec.sensor.cutoff, needs.modelled)
            )
        if spec.operation == "microgravity":
            self.estimate = GravityEstimate(arm, shape, needs.estimates, needs.tabulated)
            after.append(self.estimate)
        else:
            external.append("weight")
        if needs.tabulated:
            external.append("table")
        before.append(EngineInput(shape))
        watched = [k for k in _WATCHED if k not in external]
        self.wiring = Wiring(before, after, external, watched)


def _admittance(
    system: System, shape: LoopShape, moving: int, coupled: bool, custom: Nonlinear | None
) -> Block:
    base, spec = system.actual.base, system.emulator_settings
    nonlinear = base.body is not None or custom is not None
    if coupled:
        lag = spec.lag(shape.control_dt)
        return CoupledAdmittance(shape, base.m, moving, lag, nonlinear, custom)
    if nonlinear:
        return NonlinearAdmittance(shape, custom)
    return LinearAdmittance(shape, base.m)
