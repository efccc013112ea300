"""The arm driven joint by joint from a keyboard while its base reacts (thesis App. E).

Keys move the reference that the joint servos follow, as an environment's control
`acceleration` does; everything else is a batch of one.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, NamedTuple

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import Array, Mask, ParameterError, Vector, unit
from ves_gym.envs.batch import Batch
from ves_gym.envs.control import Acceleration
from ves_gym.envs.recording import Recorder, Renderer
from ves_gym.envs.task import Field, Scene, Start, Task
from ves_gym.system.runlog import RunLog
from ves_gym.system.system import System

UP, DOWN = "qwertyui", "asdfghjk"  # per joint; held, it moves
SPEEDS = (0.02, 0.05, 0.1, 0.2, 0.4, 0.7, 1.0)  # of the joints' largest rates
_FIRST = 3  # of SPEEDS at the start
_BRISK = 0.2  # of the arm's largest accelerations
_TAP = 0.1  # s that a key of a script is held
_LONG = 86400.0  # s: nobody drives longer
_ALL = np.zeros(1, np.intp)


@dataclass(frozen=True, kw_only=True)
class _Driven(Task):
    """An episode without a goal or an end."""

    kind: ClassVar[str] = "teleoperation"
    draws: ClassVar[int] = 0
    home: Vector = unit("rad")

    def start(self, u: Array, **options: Array) -> Start:
        return Start(np.tile(self.home, (len(u), 1)), np.zeros((len(u), 0)))

    def fields(self) -> tuple[Field, ...]:
        return (Field("joint_angle", "rad", np.full(self.system.arm.n, np.pi), "joint angles"),)

    def observe(self, s: Scene) -> tuple[Array, ...]:
        return (s.q,)

    def costs(self, s: Scene, dt: float, last: Mask) -> dict[str, Array]:
        return {}

    def success(self, s: Scene) -> Mask:
        return np.zeros(len(s.q), bool)


class Press(NamedTuple):
    """A key of a script."""

    time: float  # s since the script's start
    key: str
    hold: float = _TAP  # s


class Teleop:
    """An arm under an operator's keys.

    Args:
        system: either mode.
        start: joint angles [rad]; zero by default.
        seed: of sensor noise and drift.
        record: keep what happens, for `log`.
    """

    def __init__(
        self, system: System, *, start: npt.ArrayLike = 0.0, seed: int = 0, record: bool = False
    ) -> None:
        arm = system.arm
        if arm.n > len(UP):
            raise ParameterError(f"keys move up to {len(UP)} joints, {arm.name} has {arm.n}")
        home = np.broadcast_to(np.asarray(start, float), arm.n)
        arm.require_within_limits(home, "start")
        dt = system.control_dt
        self._fast, self._brisk = arm.column("v_max"), _BRISK * arm.column("a_max")
        self.task = _Driven(
            system=system,
            control=Acceleration(a_max=tuple(self._brisk.tolist())),
            duration=round(_LONG / dt) * dt,
            tail=0.0,
            home=tuple(home.tolist()),
        )
        self.batch = Batch(self.task, 1, threads=1)
        if record:
            self.batch.recorder = Recorder(self.batch)
        self.batch.seed(_ALL, seed, 0)
        self.batch.reset(_ALL)
        self.pressed: set[str] = set()
        self.pace, self.done = _FIRST, False

    # -------------------------------------------------------------------- keys

    def keys(self) -> dict[str, str]:
        """Function of each key, in words."""
        out: dict[str, str] = {}
        for i in range(self.task.system.arm.n):
            out |= {UP[i]: f"joint {i + 1} +", DOWN[i]: f"joint {i + 1} -"}
        out |= {"+": "faster (also =)", "-": "slower"}
        if self.task.system.mode == "emulated":
            out |= {"z": "zero the force sensor", "p": "panic button: freeze the platform"}
        return out | {"x": "start again", "escape": "quit"}

    def press(self, key: str) -> None:
        """A key goes down; one without a meaning does nothing."""
        key = "+" if key == "=" else key
        if key not in self.keys():
            return
        if key in UP + DOWN:
            self.pressed.add(key)
        elif key in "+-":
            self.pace += 1 if key == "+" else -1
            self.pace = min(max(self.pace, 0), len(SPEEDS) - 1)
        elif key == "z":
            self.batch.sim.zero_sensor()
        elif key == "p":
            self.batch.sim.freeze()
        elif key == "x":
            self.batch.reset(_ALL)
        else:
            self.done = True

    def release(self, key: str) -> None:
        """A key comes up."""
        self.pressed.discard(key)

    # -------------------------------------------------------------------- time

    def step(self) -> None:
        """One control period under the keys that are held."""
        s, dt = self.batch.scene, self.batch.dt
        n = self.task.system.arm.n
        way = np.array([(UP[i] in self.pressed) - (DOWN[i] in self.pressed) for i in range(n)])
        wish = SPEEDS[self.pace] * self._fast * way
        rate = s.ref[:, 1] + s.ref[:, 2] * (dt / 2)  # if the acceleration ran to zero
        self.batch.step(np.clip((wish - rate) / (self._brisk * dt), -1.0, 1.0))

    def drive(self, renderer: Renderer) -> None:
        """Follow the keys of a window, in real time, until a key or the window ends it."""
        while renderer.open and not (self.done or self.diverged):
            for key, down in renderer.show(self.batch, tuple(self.readings())):
                (self.press if down else self.release)(key)
            self.step()

    def play(
        self,
        script: Iterable[Press],
        seconds: float,
        on_period: Callable[[float], None] = lambda time: None,
    ) -> None:
        """Press the keys of a script, as fast as it goes, until its end or a key that quits.

        Args:
            each: called after every period with the time since the script's start [s].
        """
        dt = self.batch.dt
        due: list[tuple[float, int, str]] = []  # when, 0 up or 1 down, what
        for press in script:
            due += [(press.time, 1, press.key), (press.time + press.hold, 0, press.key)]
        due.sort()
        for k in range(math.ceil(seconds / dt - 1e-9)):
            while due and due[0][0] <= k * dt + 1e-9:
                _, down, key = due.pop(0)
                (self.press if down else self.release)(key)
            if self.done or self.diverged:
                return
            self.step()
            on_period((k + 1) * dt)

    @property
    def diverged(self) -> bool:
        """True if there is nothing to drive any more."""
        return bool(self.batch.sim.diverged[0])

    # ---------------------------------------------------------------- readings

    def readings(self) -> list[str]:
        """Return state and, in mode emulated, measured and estimated wrench, in words."""
        s, sim = self.batch.scene, self.batch.sim
        angles = " ".join(f"{a:6.1f}" for a in np.rad2deg(s.q[0]))
        move = 1e3 * np.linalg.norm(s.y[0, :3])
        pace = f"{100 * SPEEDS[self.pace]:.0f} %"
        lines = [f"q {angles} deg  base {move:.1f} mm  speed {pace}"]
        if sim.emulation_loop is not None:
            readings = sim.readings
            for name, w in (
                ("measured ", readings.wrench[0]),
                ("estimated", readings.gravity[0]),
            ):
                w = w.round(1) + 0.0  # no -0.0
                force, moment = (" ".join(f"{k:7.1f}" for k in part) for part in np.split(w, 2))
                lines.append(f"{name} {force} N {moment} N m")
            lines += [str(event) for event in sim.events]
        return lines

    def log(self, note: str = "teleoperation") -> RunLog:
        """Return the record since the start, or since it was started anew."""
        if self.batch.recorder is None:
            raise ParameterError("nothing was recorded: Teleop(record=True)")
        return self.batch.recorder.log(0, note)


def read_script(lines: Iterable[str], names: Iterable[str], name: str) -> list[Press]:
    """Keys from lines `TIME KEY [SECONDS]`: held so long, else tapped; # begins a comment.

    Args:
        known: keys that there are.
        name: of the file, for errors.

    Raises:
        ParameterError: a line that is none of this, with its number.
    """
    out, keys = [], [*names, "="]
    for number, line in enumerate(lines, 1):
        words = line.partition("#")[0].split()
        if not words:
            continue
        try:
            time, hold = float(words[0]), float(words[2]) if len(words) == 3 else _TAP
            good = len(words) in (2, 3) and math.isfinite(time + hold) and time >= 0 < hold
        except ValueError:
            good = False
        if not good:
            raise ParameterError(
                f"{name}, line {number}: expected TIME KEY [SECONDS] like 0.5 q 1, got"
                f" {line.strip()!r}"
            )
        if words[1] not in keys:
            raise ParameterError(
                f"{name}, line {number}: key must be one of {' '.join(names)}, got {words[1]!r}"
            )
        out.append(Press(time, words[1], hold))
    return out


def load_script(path: str | os.PathLike[str], names: Iterable[str]) -> list[Press]:
    """`read_script` of a file."""
    return read_script(Path(path).read_text(encoding="utf-8").splitlines(), names, str(path))
