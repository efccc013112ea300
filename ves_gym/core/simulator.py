"""`Simulator`: n copies of one System in lockstep. A single simulation is a batch of one."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ves_gym.core.backends import make_backend
from ves_gym.core.dynamics import inertia
from ves_gym.core.params import Array, Index, Mask, ParameterError
from ves_gym.core.servo import FREE, HIGH_GAINS, JointServo
from ves_gym.core.spatial import SINGULAR, matvec, rate_matrix
from ves_gym.core.system import System

_MEANINGLESS = 1e10  # m, rad and their rates; where the engine gives a state up


class Divergence(ArithmeticError):
    """A simulation left the meaningful range; `ids` lists all of them."""

    def __init__(self, message: str, ids: Index) -> None:
        super().__init__(message)
        self.ids = ids


class State(NamedTuple):
    """Where every simulation is. Leading axis = simulation."""

    time: Array  # (n,) s
    y: Array  # (n, 6) base pose [m, rad]
    yd: Array  # (n, 6) its rate
    q: Array  # (n, joints) rad
    v: Array  # (n, joints) rad/s


@dataclass(frozen=True)
class Snapshot:
    """Everything needed to continue exactly from here (`Simulator.snapshot`)."""

    system_hash: str
    backend: object
    generators: tuple[Any, ...]
    gains: tuple[Array, Array]  # kp, kd
    diverged: Mask


class Simulator:
    """n simulations of one system.

    Args:
        system: what to simulate.
        n: number of simulations, >= 1.
        servo: joint servo, or None for bare torque input; ignored by a prescribed drive.
        backend: engine, "mujoco".
        threads: threads of the engine, 0 = one per processor.
        seed: root of the per-simulation random generators; simulation i draws the same
            numbers whatever n is.
        on_divergence: "raise" a `Divergence` that names simulation, time and joint, or
            "mark" it in `diverged` and leave that simulation where it is.
    """

    def __init__(
        self,
        system: System,
        n: int = 1,
        *,
        servo: JointServo | None = HIGH_GAINS,
        backend: str = "mujoco",
        threads: int = 0,
        seed: int = 0,
        on_divergence: str = "raise",
    ) -> None:
        if not isinstance(n, (int, np.integer)) or isinstance(n, bool) or n < 1:
            raise ParameterError(f"n must be a whole number >= 1, got {n!r}")
        if on_divergence not in ("raise", "mark"):
            raise ParameterError(f"on_divergence must be raise or mark, got {on_divergence!r}")
        _require_stable_step(system)
        self.system, self.n = system, int(n)
        self.joints = system.arm.n
        self.backend = make_backend(backend, system, self.n, threads)
        self.on_divergence = on_divergence
        self.servo = servo if servo is not None else FREE
        self._kp = np.zeros((n, self.joints))
        self._kd = np.zeros((n, self.joints))
        if system.drive == "motor" and servo is not None:
            if len(servo.kp) != self.joints:
                raise ParameterError(
                    f"servo must have gains for {self.joints} joints, got {len(servo.kp)}"
                )
            self.set_gains(servo.kp, servo.kd)
        self.seed(seed)
        self.diverged = np.zeros(n, bool)
        self.reset()

    # ------------------------------------------------------------------ state

    @property
    def state(self) -> State:
        """A copy of the present state."""
        time, z, zd = self.backend.read()
        return State(time, z[:, :6], zd[:, :6], z[:, 6:], zd[:, 6:])

    def seed(self, seed: int) -> None:
        """Restart the random generators."""
        if not isinstance(seed, (int, np.integer)) or isinstance(seed, bool) or seed < 0:
            raise ParameterError(f"seed must be a whole number >= 0, got {seed!r}")
        self.generators = [
            np.random.Generator(np.random.PCG64(np.random.SeedSequence((int(seed), i))))
            for i in range(self.n)
        ]

    def reset(
        self,
        *,
        q: npt.ArrayLike = 0.0,
        v: npt.ArrayLike = 0.0,
        y: npt.ArrayLike = 0.0,
        yd: npt.ArrayLike = 0.0,
        spread: Mapping[str, npt.ArrayLike] | None = None,
        ids: npt.ArrayLike | None = None,
    ) -> State:
        """Put all or some simulations at time 0 in the given state.

        Args:
            q, v: joint angles and rates, broadcast to (k, joints).
            y, yd: base pose and its rate, broadcast to (k, 6).
            spread: standard deviation of a normal draw added to any of q, v, y, yd.
            ids: which simulations (k of them), or None for all.
        """
        index = self._ids(ids)
        values = {"q": q, "v": v, "y": y, "yd": yd}
        unknown = [key for key in spread or {} if key not in values]
        if unknown:
            raise ParameterError(f"spread: unknown key {unknown[0]!r}; known: q, v, y, yd")
        full = {}
        for name, value in values.items():
            width = self.joints if name in "qv" else 6
            full[name] = self._broadcast(value, name, (len(index), width)).copy()
            if spread and name in spread:
                scale = self._broadcast(spread[name], f"spread[{name!r}]", (len(index), width))
                for row, i in enumerate(index):
                    full[name][row] += scale[row] * self.generators[i].standard_normal(width)
        self.backend.write(
            index,
            np.zeros(len(index)),
            np.hstack([full["y"], full["q"]]),
            np.hstack([full["yd"], full["v"]]),
        )
        self.diverged[index] = False
        self._seen = self.state
        return self._seen

    def snapshot(self) -> Snapshot:
        """The complete state, random generators included; picklable."""
        return Snapshot(
            self.system.hash,
            self.backend.get_state(),
            tuple(copy.deepcopy(g.bit_generator.state) for g in self.generators),
            (self._kp.copy(), self._kd.copy()),
            self.diverged.copy(),
        )

    def restore(self, snapshot: Snapshot) -> None:
        """Return to a snapshot of the same system and the same n."""
        if snapshot.system_hash != self.system.hash or len(snapshot.diverged) != self.n:
            raise ParameterError(
                f"snapshot is of system {snapshot.system_hash[:12]} with n ="
                f" {len(snapshot.diverged)}, this is {self.system.hash[:12]} with n = {self.n}"
            )
        self.backend.set_state(snapshot.backend)
        if self.system.drive == "motor":
            self.set_gains(*snapshot.gains)
        for generator, state in zip(self.generators, snapshot.generators, strict=True):
            generator.bit_generator.state = copy.deepcopy(state)
        self.diverged = snapshot.diverged.copy()
        self._seen = self.state

    def set_gains(
        self, kp: npt.ArrayLike, kd: npt.ArrayLike, ids: npt.ArrayLike | None = None
    ) -> None:
        """Servo gains [N m/rad, N m s/rad], broadcast to (k, joints)."""
        if self.system.drive != "motor":
            raise ParameterError("a prescribed drive has no servo gains to set")
        index = self._ids(ids)
        shape = (len(index), self.joints)
        self._kp[index] = self._broadcast(kp, "kp", shape)
        self._kd[index] = self._broadcast(kd, "kd", shape)
        self.backend.set_gains(index, self._kp[index], self._kd[index])

    # ---------------------------------------------------------------- stepping

    def step(
        self,
        command: npt.ArrayLike = 0.0,
        *,
        base_wrench: npt.ArrayLike | None = None,
    ) -> State:
        """Advance one control period with the command held.

        Args:
            command: (n, joints), broadcast. Motor drive: torque [N m] on top of what the
                servo gains give around zero position and rate (see `servo_command`).
                Prescribed drive: joint acceleration [rad/s^2].
            base_wrench: (n, 6) jets' wrench in the platform frame [N, N m]; only a
                vehicle with thrusters accepts it.
        """
        torque = self._broadcast(command, "command", (self.n, self.joints))
        self.backend.step(
            torque, self._base_force(base_wrench), self.system.substeps, self._running()
        )
        self._watch()
        self._seen = self.state
        return self._seen

    def servo_command(self, q: Array, v: Array, tau: Array | float = 0.0) -> Array:
        """Command that makes the servo track q, v (n, ..., joints) with feed-forward tau."""
        middle = (slice(None), *(None,) * (np.ndim(q) - 2))
        command: Array = self._kp[middle] * q + self._kd[middle] * v + tau
        return command

    def play(self, commands: Array) -> None:
        """Advance k physics steps, the commands (n, k + 1, joints) linear over each step."""
        wanted = (
            f"commands must be numbers of shape ({self.n}, k + 1, {self.joints}), k >= 1, got"
        )
        given = _numbers(commands, wanted)
        if given.ndim != 3 or given.shape[1] < 2:
            raise ParameterError(f"{wanted} {given.shape}")
        nodes = self._broadcast(given, "commands", (self.n, given.shape[1], self.joints))
        self._seen = self.state
        self.backend.play(nodes, self._running())
        self._watch()

    def evaluate(self, command: npt.ArrayLike) -> tuple[Array, Array]:
        """Drive torque (n, joints) [N m] and base acceleration Y'' (n, 6) at this state."""
        torque, acceleration = self.backend.evaluate(
            self._broadcast(command, "command", (self.n, self.joints))
        )
        return torque, acceleration[:, :6]

    # ----------------------------------------------------------------- helpers

    def _running(self) -> Index | None:
        return np.flatnonzero(~self.diverged) if self.diverged.any() else None

    def _watch(self) -> None:
        new = (self.backend.faults() | self._tumbled()) & ~self.diverged
        if not new.any():
            return
        self.diverged |= new
        if self.on_divergence == "raise":
            raise Divergence(
                self.describe_divergence(int(np.flatnonzero(new)[0])), np.flatnonzero(new)
            )

    def _tumbled(self) -> Mask:
        """Satellites whose attitude reached the end of the Z-Y-X angles (phi_y = 90 deg)."""
        if self.system.base.body is None:
            return np.zeros(self.n, bool)
        tilt: Mask = np.cos(self.state.y[:, 4]) < SINGULAR  # or beyond: a step may jump over it
        return tilt

    def describe_divergence(self, i: int) -> str:
        """One line naming simulation, time and the worst coordinate while it was finite."""
        time, z, zd = (part[i] for part in self.backend.read())
        which = f"simulation {i} of {self.n} diverged at t = {time:.4f} s: "
        if self._tumbled()[i]:
            return which + f"phi_y = {np.rad2deg(z[4]):.1f} deg, Z-Y-X angles end at 90 deg"
        if not (np.abs([z, zd]) < _MEANINGLESS).all():  # soon every coordinate is
            seen = self._seen
            z, zd = np.r_[seen.y[i], seen.q[i]], np.r_[seen.yd[i], seen.v[i]]
        size = np.maximum(np.abs(z), np.abs(zd))
        names = [
            *"xyz",
            "phi_x",
            "phi_y",
            "phi_z",
            *(f"joint {k + 1}" for k in range(self.joints)),
        ]
        worst = int(size.argmax())
        return which + f"{names[worst]} = {z[worst]:.3g} moving at {zd[worst]:.3g}"

    def _base_force(self, wrench: npt.ArrayLike | None) -> Array | None:
        if wrench is None:
            return None
        if not getattr(self.system.vehicle, "thrusters", False):
            raise ParameterError(
                "base_wrench needs a vehicle with thrusters (free-flying), got"
                f" {type(self.system.vehicle).__name__}"
            )
        jets = self._broadcast(wrench, "base_wrench", (self.n, 6))
        return matvec(np.swapaxes(rate_matrix(self.state.y), -1, -2), jets)

    def _ids(self, ids: npt.ArrayLike | None) -> Index:
        if ids is None:
            return np.arange(self.n)
        index = np.asarray(ids)
        if index.dtype == bool and index.shape == (self.n,):
            return np.flatnonzero(index)
        whole = index.ndim == 1 and (np.issubdtype(index.dtype, np.integer) or not index.size)
        if not whole or (index < 0).any() or (index >= self.n).any():
            raise ParameterError(f"ids must be whole numbers in [0, {self.n}), got {ids!r}")
        if len(np.unique(index)) < len(index):
            raise ParameterError(f"ids must name each simulation once, got {ids!r}")
        return index.astype(np.intp)

    @staticmethod
    def _broadcast(value: npt.ArrayLike, name: str, shape: tuple[int, ...]) -> Array:
        wanted = f"{name} must be numbers of shape {shape}, got"
        given = _numbers(value, wanted)
        try:
            array = np.broadcast_to(given, shape)
        except ValueError:
            raise ParameterError(f"{wanted} {given.shape}") from None
        if not np.isfinite(array).all():
            where = np.argwhere(~np.isfinite(array))[0].tolist()
            raise ParameterError(f"{name} must be finite, got {array[tuple(where)]} at {where}")
        return array


def _numbers(value: npt.ArrayLike, wanted: str) -> Array:
    """`value` as a float64 array; text, truth values, None and ragged rows are errors."""
    try:
        given = np.asarray(value)
    except ValueError:
        raise ParameterError(f"{wanted} ragged rows") from None
    if given.dtype.kind not in "fiu":
        raise ParameterError(f"{wanted} {value!r}")
    return given.astype(np.float64)


def _require_stable_step(system: System) -> None:
    """Refuse a physics step the integrator cannot take, judged at q = 0, joints locked."""
    base = system.base
    Mt = base.mass_matrix + inertia(system.arm, np.zeros(system.arm.n))[:6, :6]
    K, D = np.linalg.solve(Mt, base.K), np.linalg.solve(Mt, base.D)
    if system.integrator != "rk4":  # the engine's other integrators take damping implicitly
        D = np.zeros((6, 6))
    poles = np.linalg.eigvals(np.block([[np.zeros((6, 6)), np.eye(6)], [-K, -D]]))

    def stable(dt: float) -> bool:
        z = poles * dt
        if system.integrator != "rk4":
            return bool(np.abs(z).max() <= 2)  # semi-implicit Euler on an oscillator
        growth = np.abs(1 + z * (1 + z / 2 * (1 + z / 3 * (1 + z / 4))))
        return bool(growth.max() <= 1 + 1e-9)

    if stable(system.physics_dt):
        return
    low, high = 0.0, system.physics_dt
    for _ in range(30):
        middle = (low + high) / 2
        low, high = (middle, high) if stable(middle) else (low, middle)
    raise ParameterError(
        f"physics_dt must be <= {low:.3g} s for the vehicle's fastest mode of"
        f" {np.abs(poles).max() / 2 / np.pi:.3g} Hz, got {system.physics_dt:g} s"
    )
