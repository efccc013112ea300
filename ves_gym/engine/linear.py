"""The space system linearised exactly: x' = A x + B u around rest, for gains and design.

Derivatives of the traced equations (`engine/kernel/trace.py`), compiled, at many configurations
at once. The laboratory's discrete loop is linearised in `simulation/stability.py`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np
import numpy.typing as npt
import scipy.linalg

from ves_gym._util.params import Array, ParameterError
from ves_gym.engine.kernel.compiled_function import CompiledFunction
from ves_gym.engine.kernel.maps import points
from ves_gym.engine.kernel.numbers import parameters, structure
from ves_gym.engine.kernel.trace import linearisation
from ves_gym.mechanics.servo import JointServo
from ves_gym.system.system import System


@dataclass(frozen=True, eq=False, kw_only=True)
class Linear:
    """x' = drift + A (x - x0) + B (u - u0), at one point or a batch (...) of them.

    x stacks Y, q, the arm's flexures, the base's internal modes, and the rates of all: 2 s of
    them with s = 6 + n + p + m. u (n) is the joint command: torque [N m], or acceleration
    [rad/s^2] where the drive is prescribed.
    """

    A: Array  # (..., 2 s, 2 s)
    B: Array  # (..., 2 s, n)
    drift: Array  # (..., 2 s) x' at the point: zero at an equilibrium
    x0: Array  # (..., 2 s)
    u0: Array  # (..., n)

    def discretise(self, dt: float) -> tuple[Array, Array]:
        """Sampled exactly with u held over each step of dt [s] (zero-order hold).

        Returns:
            A (..., 2 s, 2 s) and B (..., 2 s, n) with x+ = A x + B u about an equilibrium.
        """
        if not (np.isfinite(dt) and dt > 0):
            raise ParameterError(f"dt must be > 0 s and finite, got {dt}")
        size, n = self.B.shape[-2:]
        G = np.zeros((*self.A.shape[:-2], size + n, size + n))  # generator of [x, u]
        G[..., :size, :size], G[..., :size, size:] = self.A, self.B
        step = np.asarray(scipy.linalg.expm(G * dt), float)
        return step[..., :size, :size], step[..., :size, size:]


def linearise_ideal(
    system: System,
    q: npt.ArrayLike = 0.0,
    *,
    y: npt.ArrayLike = 0.0,
    servo: JointServo | None = None,
    command: npt.ArrayLike | None = None,
) -> Linear:
    """The space system (mode ideal) linearised at rest; effects that act there included.

    Args:
        q: (..., n) joint angles [rad]; leading axes of q, y and command broadcast.
        y: (..., 6) base pose [m, rad]. Off its rest position a vehicle with stiffness is
            in no equilibrium, and `Linear.drift` is not zero.
        servo: gains of the motors, held in the equations; None for bare torque.
        command: (..., n) joint command; default the one that holds q.

    Raises:
        ParameterError: mode emulated, wrong shapes, numbers that are not finite, or a servo
            of other joints or on a prescribed drive, which has none.
    """
    if system.mode != "ideal":
        raise ParameterError(
            f"linearise_ideal needs mode ideal, got {system.mode}: system.ideal() is what it"
            " emulates, core.stability.linearise the laboratory's loop"
        )
    system = system.actual
    n, bends, m = system.arm.n, system.arm.bends, system.base.m
    size = 6 + n + bends + m
    names, p = parameters(system)
    kp = np.zeros(n)
    if servo is not None:
        servo = _on_motors(system, servo)
        kp = np.array(servo.kp, float)
        p[[names.index(f"kp{i + 1}") for i in range(n)]] = kp
        p[[names.index(f"kd{i + 1}") for i in range(n)]] = servo.kd
    if command is None:
        command = kp * points((q, n, "q"))
    attached = system.base.attached(np.asarray(y, float) + np.zeros(6)) if m else 0.0
    relaxed = np.zeros(bends)
    parts = (y, 6, "y"), (q, n, "q"), (relaxed, bends, "d"), (attached, m, "u")
    at = points(*parts, (command, n, "command"))
    jacobian = _function(system)(at, p)
    batch = at.shape[:-1]
    jacobian = jacobian.reshape(*batch, 1 + 2 * size + n, size)
    slope = np.swapaxes(jacobian[..., 1:, :], -1, -2)
    A, B = np.zeros((*batch, 2 * size, 2 * size)), np.zeros((*batch, 2 * size, n))
    drift, x0 = np.zeros((2, *batch, 2 * size))
    A[..., :size, size:] = np.eye(size)
    A[..., size:, :], B[..., size:, :] = slope[..., : 2 * size], slope[..., 2 * size :]
    drift[..., size:], x0[..., :size] = jacobian[..., 0, :], at[..., :size]
    return Linear(A=A, B=B, drift=drift, x0=x0, u0=at[..., size:])


def _on_motors(system: System, servo: JointServo) -> JointServo:
    """The servo with gains for the system's arm."""
    if system.drive != "motor":
        raise ParameterError(f"a servo needs drive motor, got drive {system.drive}")
    return servo.for_arm(system.arm, system.vehicle)


@lru_cache(maxsize=16)
def _function(system: System) -> CompiledFunction:
    return CompiledFunction(
        f"linearisation {structure(system)}", partial(linearisation, system)
    )
