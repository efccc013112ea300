"""n machines of one system in an engine, and the protocol of what acts beside the engine."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from ves_gym._util.params import Array, Index, Mask, object_rows
from ves_gym.engine.backends.base import MEANINGLESS, Backend
from ves_gym.mechanics import attitude
from ves_gym.mechanics.base_model import BaseModel
from ves_gym.mechanics.spatial import AXES, SINGULAR, matvec, rate_matrix, twist, twist_rate
from ves_gym.simulation.state import State
from ves_gym.system.effect import ArmEffect, BaseEffect
from ves_gym.system.effect_rows import EffectRows
from ves_gym.system.system import System

LEAVE = np.pi / 4  # rad, |phi_y| in the chart
Source = System | tuple[EffectRows, int]  # of an assigned system: itself, or a row of effects


class Divergence(ArithmeticError):
    """A simulation left the meaningful range; `ids` lists all of them."""

    def __init__(self, message: str, ids: Index) -> None:
        super().__init__(message)
        self.ids = ids


def _nothing() -> None:
    """Install nothing."""


@dataclass(slots=True)
class ControlPeriod:
    """A control period of n machines, or a part of it, as it passes through all parts."""

    commands: Array  # (n, k + 1, joints), linear over each of k physics steps
    running: Index | None  # which machines move on, None for all
    begins: bool  # it starts here
    ends: bool  # it is over after these steps
    base_wrench: Array | None = None  # (n, 6) asked of the jets [N, N m]
    wheel_torque: Array | None = None  # (n, w) asked of the wheels' motors [N m]
    platform: Array | None = None  # (n, 12) pose and rate to follow, position control
    recentred: Index | None = None  # machines whose chart is another now
    acceleration: Array | None = None  # (n, k + 1, 6) of the platform, mode emulated
    wrench: Array | None = None  # (n, k + 1, 6) of the arm on it [N, N m]

    @property
    def steps(self) -> int:
        """Number of physics steps."""
        return int(self.commands.shape[1]) - 1


class Part:
    """Part that acts beside the engine: before and after its steps, period by period.

    All that a part remembers is in arrays (n, ...), the leading axis its simulations.
    """

    name: ClassVar[str]  # in the tree of arrays
    arrays: ClassVar[tuple[str, ...]] = ()  # attributes that are its memory
    periodic: bool = True  # acts at every control period, not only when it is asked
    written: bool = True  # its memory is another than a program last took over

    def reset(self, machines: Machines, ids: Index, start: State) -> None:
        """Begin anew in some simulations.

        Args:
            machines: all of them, with the engine at its start.
            ids: (k,) which.
            start: of these k.
        """

    def before(self, machines: Machines, period: ControlPeriod) -> None:
        """Act before the engine's steps."""

    def after(self, machines: Machines, period: ControlPeriod) -> None:
        """Act after the engine's steps."""

    def before_evaluation(self, machines: Machines) -> None:
        """Set in the engine what acts at this instant."""

    def prepare(
        self, machines: Machines, ids: Index, systems: Sequence[System]
    ) -> Callable[[], None]:
        """Check systems of their own for some simulations; the result installs them."""
        return _nothing

    def prepare_effects(
        self, machines: Machines, ids: Index, rows: EffectRows
    ) -> Callable[[], None]:
        """Check effects for some simulations; the result installs them.

        Args:
            machines: all of them.
            ids: (k,) which.
            rows: k rows.
        """
        return _nothing

    def rows_of(self, ids: Index) -> dict[str, Array]:
        """All that simulations (k,) have from their assignment and reset, for `begin_with`."""
        return {name: getattr(self, name)[ids] for name in self.arrays}

    def begin_with(self, ids: Index, rows: Mapping[str, Array]) -> None:
        """Begin simulations (k,) as others have begun that have not been stepped since.

        Args:
            ids: which.
            rows: of `rows_of`, of a simulator of the same system.
        """
        for name, values in rows.items():
            getattr(self, name)[ids] = values
        self.written = True

    def get_state(self) -> dict[str, Array]:
        """Copies of all arrays needed to continue exactly from here."""
        return {name: getattr(self, name).copy() for name in self.arrays}

    def set_state(self, state: Mapping[str, Array]) -> None:
        """Return to a state handed out by `get_state`."""
        for name in self.arrays:
            getattr(self, name)[:] = state[name]
        self.written = True


class NotingPart(Part):
    """A part that notes what happens: in `history` a tuple of events for each simulation."""

    history: Any

    def forget(self, ids: Index) -> None:
        """Nothing has happened to some simulations."""
        for i in ids.tolist():
            self.history[i] = ()

    def note(self, event: Any) -> None:
        """Take note of an event, that says its simulation and time."""
        self.history[event.simulation] = (*self.history[event.simulation], event)

    @property
    def events(self) -> list[Any]:
        """Return the events since the resets, in the order of the times."""
        every = [e._replace(simulation=i) for i, es in enumerate(self.history) for e in es]
        return sorted(every, key=lambda event: event.time)


class Machines(Part):
    """Arms on their bases in the engine: state in space, servo gains, systems of their own.

    Args:
        system: of all, unless another is assigned.
        n: how many.
        backend: the engine.
    """

    name = "machines"
    arrays = ("kp", "kd", "diverged")

    def __init__(self, system: System, n: int, backend: Backend) -> None:
        self.system, self.n, self.joints, self.backend = system, n, system.arm.n, backend
        self.charts = Charts(n, free=system.mode == "ideal" and is_free(system.actual.base))
        self.kp, self.kd = np.zeros((2, n, self.joints))
        self.diverged = np.zeros(n, bool)
        self.steps = 0  # physics steps of the present control period, of all
        # angles and rates as controller and log see them
        self.measured_of: Callable[[Array, Array], tuple[Array, Array]] = lambda q, v: (q, v)
        self._sources: dict[int, Source] = {}
        self._last_state: State | None = None
        carried = system.base.carried if system.mode == "ideal" else ()
        self.carried = len(carried)
        wheels = getattr(system.vehicle, "wheels", None) or ()
        self.wheels = len(wheels) if carried else 0

    # ------------------------------------------------------------------ state

    @property
    def state(self) -> State:
        """A copy of the present state, in inertial axes."""
        time, z, zd = self.backend.read()
        y, yd = self.charts.outside(z[:, :6], zd[:, :6])
        return State(time, y, yd, z[:, 6:], zd[:, 6:])

    def rows(self, ids: Index) -> tuple[State, Array]:
        """Return the state of simulations (k,), inertial axes, and the twists of their bases.

        (k, 6), in the bases' own axes, whatever frame their angles are in.
        """
        time, z, zd = self.backend.read()
        pose, rate = self.charts.outside(z[:, :6], zd[:, :6])
        angles, rates = z[ids, 6:], zd[ids, 6:]
        moving = twist(z[ids, :6], zd[ids, :6])
        return State(time[ids], pose[ids], rate[ids], angles, rates), moving

    @property
    def last_state(self) -> State:
        """State after the last step or reset."""
        if self._last_state is None:
            self._last_state = self.state
        return self._last_state

    def changed(self) -> None:
        """Take note that the engine's state is another than `last_state`."""
        self._last_state = None

    def acceleration(self, ydd: Array) -> Array:
        """Return Y'' (n, 6) of the inertial poses, of `ydd` in the charts."""
        if not self.charts.elsewhere.any():
            return ydd
        _, z, zd = self.backend.read()
        return self.charts.acceleration(z[:, :6], zd[:, :6], ydd)

    @property
    def wheel_speed(self) -> Array:
        """(n, w) speeds of the reaction wheels against the satellite [rad/s]."""
        arm = self.system.actual.arm
        first = len(arm.geared) + arm.bends
        return self.backend.internal_state()[1][:, first : first + self.wheels]

    @property
    def running(self) -> Index | None:
        """Simulations that have not diverged, None for all."""
        return np.flatnonzero(~self.diverged) if self.diverged.any() else None

    # ------------------------------------------------------------- divergence

    @property
    def tumbled(self) -> Mask:
        """(n,) satellites whose attitude reached the end of its angles, phi_y = 90 deg."""
        _, z, _ = self.backend.read()  # in its chart, where it has one
        # or beyond: a step may jump over it
        return (self.system.base.body is not None) & (np.cos(z[:, 4]) < SINGULAR)

    def describe_divergence(self, i: int) -> str:
        """Name simulation i, time and the worst coordinate while it was finite."""
        last, (time, z, zd) = self.last_state, (part[i] for part in self.backend.read())
        which = f"simulation {i} of {self.n} diverged at t = {time:.4f} s: "
        if self.tumbled[i]:
            return which + f"phi_y = {np.rad2deg(z[4]):.1f} deg, Z-Y-X angles end at 90 deg"
        if not (np.abs([z, zd]) < MEANINGLESS).all():  # soon every coordinate is
            z, zd = np.r_[last.y[i], last.q[i]], np.r_[last.yd[i], last.v[i]]
        size = np.maximum(np.abs(z), np.abs(zd))
        names = [*AXES, *(f"joint {k + 1}" for k in range(self.joints))]
        worst = int(size.argmax())
        return which + f"{names[worst]} = {z[worst]:.3g} moving at {zd[worst]:.3g}"

    # ---------------------------------------------------------------- systems

    @property
    def assigned(self) -> dict[int, System]:
        """Systems of their own by simulation; one that is not there has the simulator's."""
        return {
            i: source if isinstance(source, System) else source[0].system(source[1])
            for i, source in self._sources.items()
        }

    @property
    def systems(self) -> tuple[System, ...]:
        """The n systems in force."""
        assigned = self.assigned
        return tuple(assigned.get(i, self.system) for i in range(self.n))

    def sources(self, ids: Index) -> list[Source]:
        """Sources of the systems of some simulations, of those that have one of their own."""
        sources = (self._sources.get(i) for i in ids.tolist())
        return [source for source in sources if source is not None]

    def note(self, ids: Index, sources: Sequence[Source]) -> None:
        """Take note of where the systems of some simulations come from."""
        for i, source in zip(ids.tolist(), sources, strict=True):
            self._sources[i] = source
            if source is self.system:
                del self._sources[i]

    def bodies(self, i: int) -> System:
        """Simulation i's system, or one with the same arm and vehicle where that is at hand."""
        source = self._sources.get(i, self.system)
        if isinstance(source, System):
            return source
        rows, row = source
        return rows.system(row) if rows.varied((ArmEffect, BaseEffect)) else self.system

    def alike(self, ids: Index) -> list[tuple[System, Index]]:
        """Systems as they really are, with the rows of ids that share arm and vehicle."""
        if not self._sources:
            return [(self.system.actual, np.arange(len(ids)))]
        groups: dict[tuple[int, int], tuple[System, list[int]]] = {}
        for row, i in enumerate(ids.tolist()):
            actual = self.bodies(i).actual
            key = id(actual.arm), id(actual.vehicle)
            groups.setdefault(key, (actual, []))[1].append(row)
        return [(system, np.array(rows)) for system, rows in groups.values()]

    def set_gains(self, ids: Index, kp: Array, kd: Array) -> None:
        """Set servo gains (k, joints) of simulations `ids` [N m/rad], [N m s/rad]."""
        self.kp[ids], self.kd[ids] = kp, kd
        self.backend.set_gains(ids, kp, kd)

    def rows_of(self, ids: Index) -> dict[str, Array]:
        sources = [self._sources.get(i, self.system) for i in ids.tolist()]
        return {"kp": self.kp[ids], "kd": self.kd[ids], "source": object_rows(sources)}

    def begin_with(self, ids: Index, rows: Mapping[str, Array]) -> None:
        self.diverged[ids] = False
        if rows:
            self.kp[ids], self.kd[ids] = rows["kp"], rows["kd"]
            self.note(ids, rows["source"].tolist())
        self.changed()

    def get_state(self) -> dict[str, Array]:
        return super().get_state() | {"steps": np.full(self.n, float(self.steps))}

    def set_state(self, state: Mapping[str, Array]) -> None:
        super().set_state(state)
        self.steps = int(state["steps"][0])
        if self.system.drive == "motor":
            self.set_gains(np.arange(self.n), self.kp, self.kd)


def is_free(base: BaseModel) -> bool:
    """True if nothing ties a base to a place: it is a body, without M, D, K, drag and modes."""
    tied = any(np.any(part) for part in (base.M, base.D, base.K))
    drag = base.drag is not None and bool(np.any(base.drag))
    return base.body is not None and base.internal is None and not (tied or drag)


class Charts(Part):
    """Frames in which n free bodies are integrated, so that they tumble through any angle.

    The equations of a body in free space are the same in every inertial frame at rest. So each
    simulation has a frame, its *chart*, in which the engine's Z-Y-X angles stay away from
    phi_y = +-90 deg: beyond `LEAVE` the chart is set where the body is, and the engine goes on
    from pose zero with its rates turned. Until then the chart is the world, and nothing is
    converted. docs/decisions/0021 says why.
    """

    name = "charts"
    arrays = ("place", "turn", "elsewhere")

    def __init__(self, n: int, free: bool) -> None:
        """`free`: nothing ties the bases to a place; else every chart stays the world."""
        self.free = self.periodic = free
        self.place = np.zeros((n, 3))  # m, of the chart's origin
        self.turn = np.tile(attitude.IDENTITY, (n, 1))  # chart axes to inertial axes
        self.elsewhere = np.zeros(n, bool)  # no longer the world

    def reset(self, machines: Machines, ids: Index, start: State) -> None:
        """See `Part`. The world is the chart."""
        self.begin_with(ids, {})

    def begin_with(self, ids: Index, rows: Mapping[str, Array]) -> None:
        self.place[ids], self.turn[ids], self.elsewhere[ids] = 0.0, attitude.IDENTITY, False

    def before(self, machines: Machines, period: ControlPeriod) -> None:
        """See `Part`. Charts go where their bodies are, of all that have turned too far."""
        if not (self.free and period.begins):
            return
        _, z, zd = machines.backend.read()
        far = (np.abs(z[:, 4]) > LEAVE) & ~machines.diverged
        if not far.any():
            return
        ids = np.flatnonzero(far)
        y = z[ids, :6]
        rates = twist(y, zd[ids, :6])  # at pose zero rates are the twist
        q = self.turn[ids]
        self.place[ids] += attitude.rotate(q, y[:, :3])
        turned = attitude.product(q, attitude.from_angles(y[:, 3:]))
        self.turn[ids] = attitude.normalised(turned)
        self.elsewhere[ids] = True
        machines.backend.set_base(ids, np.zeros((len(ids), 6)), rates)
        period.recentred = ids

    def outside(self, y: Array, yd: Array) -> tuple[Array, Array]:
        """Return inertial poses and rates.

        Args:
            y, yd: (n, 6) in the charts.

        Returns:
            (n, 6) each; rows whose chart is the world are as they were.
        """
        if not (self.free and self.elsewhere.any()):
            return y, yd
        ids = np.flatnonzero(self.elsewhere)
        y_out, yd_out = y.copy(), yd.copy()
        q, w = self.turn[ids], twist(y[ids], yd[ids])[:, 3:]
        y_out[ids, :3] = self.place[ids] + attitude.rotate(q, y[ids, :3])
        yd_out[ids, :3] = attitude.rotate(q, yd[ids, :3])
        phi = attitude.to_angles(attitude.product(q, attitude.from_angles(y[ids, 3:])))
        y_out[ids, 3:], yd_out[ids, 3:] = phi, attitude.angle_rates(phi, w)
        return y_out, yd_out

    def acceleration(self, y: Array, yd: Array, ydd: Array) -> Array:
        """Return Y'' (n, 6) of the inertial poses.

        Args:
            y, yd, ydd: (n, 6) in the charts.
        """
        ids = np.flatnonzero(self.elsewhere)
        pose, rate = (part[ids] for part in self.outside(y, yd))
        missing = twist_rate(y[ids], yd[ids], ydd[ids]) - twist_rate(
            pose, rate, np.zeros_like(rate)
        )
        out = ydd.copy()
        out[ids, :3] = matvec(attitude.to_matrix(self.turn[ids]), ydd[ids, :3])
        turn = rate_matrix(pose)[:, 3:, 3:]
        out[ids, 3:] = np.linalg.solve(turn, missing[:, 3:, None])[..., 0]
        return out
