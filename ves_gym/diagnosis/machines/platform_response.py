"""The platform's blocks, run alone on measured commands."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import scipy

from ves_gym._util.params import Array
from ves_gym.hardware.leg_servo import Legs
from ves_gym.hardware.platform import PoseServo
from ves_gym.simulation.blocks.block import Block, LoopShape
from ves_gym.simulation.blocks.compiled_loop import CompiledLoop
from ves_gym.simulation.blocks.platform import CommandLine, LegSensors, LegServos, PosePlatform
from ves_gym.simulation.blocks.wiring import NamedArrays, Wiring
from ves_gym.system.deviations import LoopParameters
from ves_gym.system.system import System


def loop_shape(system: System) -> LoopShape:
    """Return the sizes of a system's loop, without legs."""
    return LoopShape(system.substeps + 1, system.arm.n, system.control_dt, system.physics_dt)


def platform_response(
    system: System, p: LoopParameters, command: Array, y: Array, yd: Array
) -> Array:
    """Return where platforms are that receive given commands.

    That is what a log holds. Legs read something else, by the bending of their rods: 0.5 % of
    a swing at 2.4 Hz.

    Args:
        system: whose platform, as described.
        p: parameters of n loops.
        command: (n, T, 12) pose and rate at the start of each control period; the first one
            has been followed.
        y, yd: (n, 6) pose [m, rad] and rate at the end of that first period.

    Returns:
        (n, T, 6) poses at the ends of the periods [m, rad], the first of them `y`.
    """
    settings = system.emulator_settings
    command = within_reach(system, p, command, y, yd)
    servo = settings.platform
    if isinstance(servo, PoseServo):
        block = PosePlatform(servo, loop_shape(system))
        out = _poses(block, block.response(p), command[:, 1:], y, yd)
        return np.concatenate([y[:, None], out], axis=1)
    platforms = Platforms(system, p, y, yd)
    poses = [y, *(platforms.advance(part)["y"][:, -1] for part in command.swapaxes(0, 1)[1:])]
    return np.stack(poses, axis=1)


class Platforms:
    """The platform's blocks, compiled, with n memories, from poses and rates (n, 6) on."""

    def __init__(self, system: System, p: LoopParameters, y: Array, yd: Array) -> None:
        settings, shape = system.emulator_settings, loop_shape(system)
        blocks: list[Block]
        if isinstance(settings.platform, PoseServo):
            first: PosePlatform | LegServos = PosePlatform(settings.platform, shape)
            blocks = [first]
        else:
            clock = system.control_dt, system.physics_dt
            legs = Legs(settings.platform, settings.stewart, *clock)
            shape = replace(shape, leg_states=legs.leg.size)
            first = LegServos(legs)
            blocks = [first, LegSensors(legs)]
        self.shape = shape
        wiring = Wiring(blocks, [], ["command_received"])
        self._x = NamedArrays(wiring.everything(shape), len(y), lanes=True)
        memory, _ = first.start({}, {"X": np.concatenate([y, yd], axis=-1)})
        for name, values in memory.items():
            self._x[f"{first.name}.{name}"] = values
        nothing: Any = None  # of arms and vehicles: these blocks ask for none
        self._code = CompiledLoop(wiring, self._x)
        self._code.load({k.name: k.parameters(p, nothing) for k in blocks})

    def advance(self, command: Array) -> dict[str, Array]:
        """Return the signals of a control period (y, yd, ydd at its nodes, y_measured).

        Args:
            command: (n, 12) received.
        """
        self._code("before", {"command_received": command})
        return {name: self._code.signal(name) for name in ("y", "yd", "ydd", "y_measured")}


def within_reach(
    system: System, p: LoopParameters, command: Array, y: Array, yd: Array
) -> Array:
    """Return the commands of `platform_response` held back where legs are short or slow.

    Args:
        system, p, command, y, yd: see there.

    Returns:
        (n, T, 12).
    """
    queue = CommandLine(system.emulator_settings.stewart, loop_shape(system), 0, True)
    travel, speed = p.platform_travel, p.platform_speed
    if not (travel.any() or speed.any()):
        return command
    command, dt = command.copy(), queue.shape.control_dt
    for i in np.flatnonzero((travel > 0) & (speed == 0)):  # each sample for itself
        wished = command[i, :, :6].copy()
        command[i, :, :6] = queue.shortened(wished, np.full(len(wished), travel[i]))
        late = np.flatnonzero((command[i, 1:, :6] != wished[1:]).any(axis=1)) + 1
        command[i, late, 6:] = (command[i, late, :6] - command[i, late - 1, :6]) / dt
    slow = np.flatnonzero(speed > 0)
    numbers = {"travel": travel[slow], "speed": speed[slow]}
    last = np.concatenate([y, yd], axis=-1)[slow]
    for t in range(command.shape[1]) if len(slow) else ():
        last = queue.within_reach(numbers, command[slow, t], last)
        command[slow, t] = last
    return command


def _poses(block: PosePlatform, response: Array, command: Array, y: Array, yd: Array) -> Array:
    """Poses (n, N, 6) at the ends of N periods, as N steps of the block, at once.

    The error's two-number recursion z+ = A z + d is, for its first number, one of second
    order.
    """
    y_cmd, rate = command[..., :6], command[..., 6:]
    if not block.servo.rate_feedforward:
        rate = np.zeros_like(rate)
    A = response[:, -1, :2]  # (n, 2, 2) of the error over a period
    ahead = np.stack([y_cmd + rate * block.nodes[-1], rate], axis=2)  # (n, N, 2, 6)
    drive = ahead - np.einsum("nij,nkjc->nkic", A, np.stack([y_cmd, rate], axis=2))
    forced = drive[:, :, 0].copy()
    forced[:, 1:] += A[:, 0, 1, None, None] * drive[:, :-1, 1]
    forced[:, 1:] -= A[:, 1, 1, None, None] * drive[:, :-1, 0]
    det: Array = np.linalg.det(A)
    forced[:, 0] += A[:, 0, 0, None] * y + A[:, 0, 1, None] * yd
    forced[:, 1:2] -= (det[:, None] * y)[:, None]
    out: Array = np.empty(forced.shape)
    for i, a in enumerate(A):
        poles = [1.0, -a[0, 0] - a[1, 1], det[i]]
        out[i] = scipy.signal.lfilter([1.0], poles, forced[i], axis=0)
    return out
