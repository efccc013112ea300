"""The Learning Method: gravity learnt by slow repetition of the motion (thesis 3.3).

Each iteration has two phases. A: the platform performs the present estimate of the base
motion while the arm performs its own, both slowed down by `slow`; what the sensor shows
then is weight alone. B: the arm moves at full speed, the recorded weight is subtracted,
and the platform moves as the vehicle would: a better estimate of the base motion.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy

from ves_gym._util.params import Array, ParameterError
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.servo import OWN_GAINS, JointServo
from ves_gym.simulation.playback import play_motions
from ves_gym.simulation.recording import Recording
from ves_gym.simulation.state import Event
from ves_gym.system.system import System


@dataclass(frozen=True)
class Iteration:
    """One round of the Learning Method."""

    y: Array  # (N, 6) base motion at full speed, on the clock of the result
    gravity: Array  # (N, 6) weight learnt in the slow phase [N, N m]
    change: Array  # (6,) largest change of y against the iteration before [m, rad]


@dataclass(frozen=True)
class Learning:
    """The outcome of the Learning Method."""

    t: Array  # (N,) s
    iterations: tuple[Iteration, ...]
    recording: Recording | None  # the last full-speed run
    aborted: Event | None = None  # a platform that would have left its workspace

    def __str__(self) -> str:
        lines = []
        for i, k in enumerate(self.iterations):
            move, turn = 1e3 * k.change[:3].max(), 1e3 * k.change[3:].max()
            lines.append(
                f"repetition {i + 1}: base motion changed by {move:.3f} mm, {turn:.3f} mrad"
            )
        if self.aborted is not None:
            lines.append(f"aborted: {self.aborted}; the last complete run remains")
        return "\n".join(lines)


def learn_gravity(
    system: System,
    motion: Motion,
    *,
    iterations: int = 9,
    slow: float = 20.0,
    settle: float = 10.0,
    servo: JointServo = OWN_GAINS,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> Learning:
    """Repeat a motion on the emulator until its base moves as in space.

    Args:
        system: mode emulated, operation microgravity. Its gravity model is not used.
        iterations: at most; the thesis needed nine.
        slow: time scale alpha of phase A, >= 1; the thesis used 20.
        settle: how long the arm rests after the motion, in full-speed time [s].
        seed: of sensor noise and drift.

    Returns:
        All iterations; those before an abort remain, the reason is in `aborted`.

    Raises:
        ParameterError: the system is not a micro-gravity emulation, slow < 1, or a number
            of iterations < 1.
    """
    lab = system.emulator_settings
    if lab.operation != "microgravity":
        raise ParameterError(
            f"the Learning Method needs operation microgravity, got {lab.operation}"
        )
    if not slow >= 1:
        raise ParameterError(f"slow must be >= 1, got {slow!r}")
    if not iterations >= 1:
        raise ParameterError(f"iterations must be >= 1, got {iterations!r}")
    position = system.replace(
        emulator=replace(lab, operation="position"),
        effects=tuple(e for e in system.effects if not e.kind.startswith("gravity/")),
    )
    slowly = motion.retimed(motion.duration * slow)

    def still(t: Array) -> Array:
        return np.zeros((len(t), 6))

    pose: Callable[[Array], Array] = still
    done: list[Iteration] = []
    clock = np.empty(0)
    last: Recording | None = None
    for i in range(iterations):

        def path(t: Array, pose: Callable[[Array], Array] = pose) -> tuple[Array, Array]:
            # rates in slow time; a second of it is 1 / slow of motion
            ahead, behind = t / slow + 1e-3, np.maximum(t / slow - 1e-3, 0.0)
            rate = (pose(ahead) - pose(behind)) / (ahead - behind)[:, None] / slow
            return pose(t / slow), rate

        weighed = play_motions(
            position,
            [slowly],
            servo=servo,
            settle=settle * slow,
            y=pose(np.zeros(1))[0],
            platform=path,
            seed=seed + 2 * i,
        )
        if weighed.events:
            return Learning(clock, tuple(done), last, weighed.events[0])
        weight = _averaged(weighed, slow)
        run = play_motions(
            system,
            [motion],
            servo=servo,
            settle=settle,
            y=pose(np.zeros(1))[0],
            gravity=weight,
            watch=True,
            seed=seed + 2 * i + 1,
        )
        if run.events:
            return Learning(clock, tuple(done), last, run.events[0])
        clock, y = run.t, run.y[0]
        before = done[-1].y if done else pose(clock)
        done.append(Iteration(y, weight(clock), np.abs(y - before).max(axis=0)))
        last, pose = run, _smooth(clock, y)
        if progress is not None:
            progress((i + 1) / iterations)
    return Learning(clock, tuple(done), last)


def _averaged(weighed: Recording, slow: float) -> Callable[[Array], Array]:
    """Weight against full-speed time; the noise of one full-speed sample averaged out."""
    k = max(1, int(slow))
    rows = len(weighed.t) // k * k
    if rows // k < 4:
        return _smooth(weighed.t / slow, weighed.w[0])
    t = weighed.t[:rows].reshape(-1, k).mean(axis=1) / slow
    return _smooth(t, weighed.w[0, :rows].reshape(-1, k, 6).mean(axis=1))


def _smooth(t: Array, values: Array) -> Callable[[Array], Array]:
    """A cubic spline through samples (N, 6), held at its ends."""
    spline = scipy.interpolate.CubicSpline(t, values)
    return lambda at: np.asarray(spline(np.clip(at, t[0], t[-1])), dtype=np.float64)
