"""Payloads of n simulations: free in space, or carried by the tool since its latch closed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import Array, Index, Mask, ParameterError
from ves_gym.engine.kernel.compiled_function import CompiledFunction, Piece, lanes, unlane
from ves_gym.engine.kernel.maps import system_function
from ves_gym.engine.kernel.numbers import parameters
from ves_gym.mechanics.attitude import conjugate, from_angles, from_matrix, rotate
from ves_gym.mechanics.kinematics import ToolState
from ves_gym.mechanics.latch import (
    BODY,
    NUMBERS,
    LatchTarget,
    ToolMotion,
    body_momentum,
    directions_of,
    flown,
    free_mass,
    inelastic,
    named,
    target,
    to_point,
    tool_in_space,
    tool_motion,
)
from ves_gym.mechanics.payload import Payload, numbers_of, with_body
from ves_gym.mechanics.spatial import matvec, quadratic, rate_matrix
from ves_gym.simulation.machines import ControlPeriod, Machines, NotingPart
from ves_gym.simulation.state import State, simulation_ids
from ves_gym.simulation.tool_contact import PayloadState, ToolContact
from ves_gym.system.system import System

_TURN = 3.2e-3  # rad, the most that a free body turns in a step: 1e-13 rad of error


@lru_cache(maxsize=1)
def _flight() -> CompiledFunction:
    return CompiledFunction.of("free flight", flown, sum(BODY.values()), 3, 9, 1, in_place=True)


def flight(bodies: Array, com: Array, inertia: Array, steps: Array) -> list[Piece]:
    """Return steps of free flight as pieces, in place, on rows of lanes (see `fly`)."""
    every = (steps[:, k : k + 1] for k in range(steps.shape[1]))
    return [_flight().piece(bodies, com, inertia, step, bodies) for step in every]


def fly(bodies: Array, com: Array, inertia: Array, steps: Array) -> Array:
    """Return free payloads (n, `BODY`) after steps (n, k) [s], see `latch.flown`."""
    n = len(bodies)
    rows, *others = (lanes(part.reshape(n, -1)) for part in (bodies, com, inertia, steps))
    for piece in flight(rows, *others):
        piece(0, len(rows))
    return unlane(rows, n)


class Capture(NamedTuple):
    """Closing or opening of a latch. Vectors in inertial axes, linear part first."""

    simulation: int
    time: float  # s
    kind: str  # "grasp", "touch" (only some directions closed) or "release"
    impulse: tuple[float, ...] = (0.0,) * 6  # on the payload at the tool [N s, N m s]
    lost: float = 0.0  # energy [J]
    twist: tuple[float, ...] = (0.0,) * 6  # of the tool against the fixture before
    before: tuple[tuple[float, ...], ...] = ()  # Y', q', the payload's twist and u' before
    tau: tuple[float, ...] = ()  # of the drives before [N m], where a recording has asked

    def to_dict(self) -> dict[str, Any]:
        """Plain data, as a run log's metadata hold it."""
        names = ("yd", "v", "payload", "ud", "tau")
        before = (*(self.before or ((),) * 4), self.tau)
        return {
            "time": self.time,
            "kind": self.kind,
            "impulse": list(self.impulse),
            "lost": self.lost,
            "twist": list(self.twist),
            "before": dict(zip(names, map(list, before), strict=True)),
        }


class PayloadHandler(NotingPart):
    """The payload of every simulation of a `Simulator`, as `Simulator.payload`.

    Arrays (n, ...): `mass`, `com` and `inertia` in the payload's own axes, which an episode may
    change (`change`); `carried`; the pose in the last link's frame while it is carried.

    Args:
        machines: whose tools have the latches.
        contact: of the tools, None without one.
        modes: gives u and u' of the bases, None of bases without.
    """

    name = "payload"
    periodic = False
    arrays = (
        "carried", "mass", "com", "inertia", "position", "attitude", "velocity", "spin",
        "place", "turn", "history",
    )  # fmt: skip
    _FREE = arrays[1:8]  # what `change` may set

    def __init__(
        self,
        machines: Machines,
        contact: ToolContact | None,
        modes: Callable[[], tuple[Array, Array] | None],
    ) -> None:
        system, n = machines.system, machines.n
        system.arm.require_rigid("a payload or a latch at the tool")
        system.arm.require_driven_tool("a payload or a latch at the tool")
        self.machines, self._modes = machines, modes
        self._still = system.mode == "emulated"  # a stand holds it
        self.carried = np.zeros(n, bool)
        self.mass, self.com = np.zeros(n), np.zeros((n, 3))
        self.inertia, self.spin = np.zeros((n, 3, 3)), np.zeros((n, 3))
        self.position, self.velocity = np.zeros((n, 3)), np.zeros((n, 3))
        self.attitude = np.zeros((n, 4))
        self.place, self.turn = np.zeros((n, 3)), np.tile(np.eye(3), (n, 1, 1))
        self.history = np.full(n, None)  # of captures
        self._fastest = np.zeros(n)  # rad/s, that a free one may come to turn
        self.forget(np.arange(n))
        self.described: list[Payload] = []
        # where the tool can touch it, the engine moves it
        touchable = system.contact is not None and system.contact.on == "payload"
        self._contact = contact if touchable else None
        self._assigned(np.arange(n))

    # ------------------------------------------------------------------ state

    def prepare(
        self, machines: Machines, ids: Index, systems: Sequence[System]
    ) -> Callable[[], None]:
        """See `Part`. What is carried stays carried."""
        return lambda: self._assigned(ids)

    def _assigned(self, ids: Index) -> None:
        self.described = []
        for system in self.machines.systems:
            assert system.payload is not None
            self.described.append(system.payload)
        payloads = [self.described[i] for i in ids.tolist()]
        for i, payload in zip(ids.tolist(), payloads, strict=True):
            self.mass[i], self.com[i], self.inertia[i] = numbers_of(payload.inertial)
        self.latch_distance = np.array([k.latch_distance for k in self.described])
        self.latch_angle = np.array([k.latch_angle or np.inf for k in self.described])
        self.grip = np.array([k.grip.position for k in self.described])
        self.grip_axes = np.array([k.grip.rotation for k in self.described])
        self._refit(ids[self.carried[ids]])
        self._put(ids)

    def reset(self, machines: Machines, ids: Index, start: State) -> None:
        """See `Part`. Payloads are free at their described starts, with described numbers."""
        released = ids[self.carried[ids]]
        self.carried[ids] = False
        self._refit(released)
        of: dict[int, list[int]] = {}  # simulations by their payload
        for i in ids.tolist():
            of.setdefault(id(self.described[i]), []).append(i)
        for alike in of.values():
            payload = self.described[alike[0]]
            numbers = numbers_of(payload.inertial)
            self.mass[alike], self.com[alike], self.inertia[alike] = numbers
            self.position[alike], self.velocity[alike] = payload.position, payload.velocity
            self.attitude[alike], self.spin[alike] = from_angles(payload.angles), payload.spin
        self.forget(ids)
        self._put(ids)

    def rows(self, names: Mapping[str, int]) -> Array:
        """(n, k) numbers of all payloads side by side: those of `BODY`, or of `NUMBERS`."""
        return np.hstack([getattr(self, k).reshape(self.machines.n, -1) for k in names])

    def begin_with(self, ids: Index, rows: Mapping[str, Array]) -> None:
        """See `Part`. The engine has the last links of these."""
        super().begin_with(ids, rows)
        self._note_motion(ids)

    def before(self, machines: Machines, period: ControlPeriod) -> None:
        """See `Part`. The engine works in other frames now."""
        if self._contact is not None and period.recentred is not None:
            ids = period.recentred
            self._contact.put(ids, self._rows(ids), self.com[ids])

    def after(self, machines: Machines, period: ControlPeriod) -> None:
        """Let free payloads fly on: straight, and turning as torque-free bodies do."""
        if self._contact is not None:
            rows = np.flatnonzero(self._moves(period.running))
            if len(rows):
                moved = self._contact.bodies(rows, self.com)
                for name, part in zip(BODY, moved, strict=True):
                    getattr(self, name)[rows] = part
            return
        steps = self.steps(period.steps * machines.system.physics_dt, period.running)
        if steps.size:
            self.store(fly(self.rows(BODY), self.com, self.inertia, steps))
            self.written = True

    def change(self, ids: Index, **values: npt.ArrayLike) -> None:
        """Set numbers of free payloads: an episode's mass, say, or where they start.

        Args:
            ids: (k,) which.
            values: any of mass (k,), com, inertia, position, attitude, velocity, spin as the
                attributes have them; inertia is about the centre of mass.

        Raises:
            ParameterError: a payload that is carried, an unknown name, a wrong shape, or
                numbers that no body has.
        """
        if self.carried[ids].any():
            i = int(ids[self.carried[ids]][0])
            raise ParameterError(f"payload of simulation {i} is carried: release it first")
        new = {}
        for name, value in values.items():
            if name not in self._FREE:
                names = ", ".join(self._FREE)
                raise ParameterError(f"a payload has {names}, got {name!r}")
            shape = (len(ids), *getattr(self, name).shape[1:])
            array = np.asarray(value, float)
            if array.shape != shape or not np.isfinite(array).all():
                raise ParameterError(
                    f"payload {name} must be finite numbers of shape {shape}, got"
                    f" {array.shape}: {value!r}"
                )
            new[name] = array
        if "mass" in new and not (new["mass"] > 0).all():
            raise ParameterError(f"payload mass must be > 0 kg, got {new['mass'].min():g}")
        if "inertia" in new and not (np.linalg.eigvalsh(new["inertia"])[:, 0] > 0).all():
            raise ParameterError("payload inertia must be positive definite")
        for name, array in new.items():
            getattr(self, name)[ids] = array
        self._put(ids)

    @property
    def state(self) -> PayloadState:
        """Place and motion of the payloads, free or carried."""
        position, attitude = self.position.copy(), self.attitude.copy()
        velocity, spin = self.velocity.copy(), self.spin.copy()
        rows = np.flatnonzero(self.carried)
        if len(rows):
            t = self.target(rows)
            position[rows] = t.centre - matvec(t.turn, self.com[rows])
            attitude[rows], velocity[rows] = from_matrix(t.turn), t.velocity
            spin[rows] = matvec(np.swapaxes(t.turn, -1, -2), t.spin)
        return PayloadState(position, attitude, velocity, spin)

    def target(self, ids: Index) -> LatchTarget:
        """Return where the payloads of some simulations are, as seen from their tools."""
        names = ("position", "attitude", "velocity", "spin", *NUMBERS)
        body = {k: getattr(self, k)[ids].reshape(len(ids), -1) for k in names}
        return target(self._tool(ids), self.machines.system.arm.tool_rotation, body)

    def set_state(self, state: Mapping[str, Array]) -> None:
        changed = np.flatnonzero(self.carried | state["carried"])
        super().set_state(state)
        self._refit(changed)
        self._describe()  # the engine's state has where they are
        self._note_motion(np.arange(self.machines.n))

    def store(self, bodies: Array) -> None:
        """Take over free payloads (n, `BODY`) that have moved."""
        for name, part in named(bodies, BODY).items():
            getattr(self, name)[:] = part

    def steps(self, time: float, ids: Index | None) -> Array:
        """(n, k) steps of free flight that make up a time [s], zeros behind them.

        Args:
            time: [s].
            ids: which simulations run, None for all.
        """
        count = np.ceil(self._fastest * time / _TURN)
        count = np.maximum(count, self.velocity.any(axis=1)) * self._moves(ids)
        within = np.arange(count.max()) < count[:, None]
        return np.where(within, time / np.maximum(count, 1.0)[:, None], 0.0)

    def _moves(self, ids: Index | None) -> Mask:
        """(n,) payloads that fly freely in simulations that run."""
        running = np.zeros(self.machines.n, bool)
        running[slice(None) if ids is None else ids] = not self._still
        return running & ~self.carried

    def _note_motion(self, ids: Index) -> None:
        """Take note of how fast payloads that have been changed may come to turn."""
        # with 2 E between |w|^2 times the least and the largest moment of inertia
        J = np.linalg.eigvalsh(self.inertia[ids])
        rate = np.linalg.norm(self.spin[ids], axis=1)
        self._fastest[ids] = rate * np.sqrt(J[:, -1] / J[:, 0])
        self.written = True

    def _describe(self) -> None:
        """Set mass properties in the engine, and whether the bodies can be touched."""
        if self._contact is not None:
            ids, engine = np.arange(self.machines.n), self._contact.engine
            engine.set_body(ids, self.mass, self.com, self.inertia)
            engine.set_touching(ids, ~self.carried)

    def _put(self, ids: Index) -> None:
        """Have the engine's bodies where the payloads are, if it moves them."""
        self._note_motion(ids)
        if self._contact is not None and len(ids):
            self._describe()
            self._contact.put(ids, self._rows(ids), self.com[ids])

    # ------------------------------------------------------------------ latch

    def closes(self, ids: Index) -> Mask:
        """Return (k,) whether the latches reach the fixtures."""
        return self.target(ids).reached.astype(bool)

    def fixture(self) -> tuple[Array, Array]:
        """Return place [m] and velocity [m/s] (n, 3) of the grapple fixtures in space."""
        t = self.target(np.arange(self.machines.n))
        return t.fixture, t.fixture_velocity

    def relative(self, ids: npt.ArrayLike | None = None) -> Array:
        """Return the twist (k, 6) of the tool against the fixture, inertial axes."""
        return self.target(simulation_ids(ids, self.machines.n)).relative

    def grasp(
        self, ids: npt.ArrayLike | None = None, *, directions: object = None
    ) -> list[Capture]:
        """Close the latch: an exact inelastic impulse (`mechanics/latch.py`).

        With all directions the payload is carried from now on, as it sits. With some of them
        (names of `latch.DIRECTIONS` or columns (6, k), inertial axes) only the relative motion
        along these is taken away, and the payload stays free. A stand in the laboratory gives
        way: there the joints alone take the impulse.

        Raises:
            ParameterError: one is carried already, or out of the latch's reach; none is
                grasped then.
        """
        machines, index = self.machines, simulation_ids(ids, self.machines.n)
        if not len(index):
            return []
        self._require(index, carried=False)
        closed = directions_of(directions)
        motion, rates = self._motion(index)
        t = self.target(index)
        for k in np.flatnonzero(t.reached == 0).tolist():
            i, payload = int(index[k]), self.described[index[k]]
            raise ParameterError(
                f"simulation {i}: the latch closes within {payload.latch_distance:g} m"
                f"{_degrees(payload.latch_angle)} of the fixture, the tool is"
                f" {t.distance[k]:.4g} m{_degrees(float(t.angle[k]))} away"
            )
        M, twist, com = self._bodies(index)
        X = to_point(com, motion.place)
        prescribed = machines.system.prescribed_coordinates
        out = inelastic(motion.mass, rates, motion.J, M, twist, X, closed, prescribed)
        state = machines.state
        kind = "grasp" if closed is None else "touch"
        time, v, yd = state.time[index], state.v[index], state.yd[index]
        modes = self._modes()
        ud = np.zeros((len(index), 0)) if modes is None else modes[1][index]
        for k, i in enumerate(index.tolist()):
            before = tuple(tuple(part[k].tolist()) for part in (yd, v, twist, ud))
            impulse, relative = (
                tuple(part[k].tolist()) for part in (out.impulse, out.relative)
            )
            lost = float(out.lost[k])
            self.note(Capture(i, float(time[k]), kind, impulse, lost, relative, before))
        _, z, _ = machines.backend.read()  # whose angles may be in a frame of their own
        turned = np.linalg.solve(rate_matrix(z[index, :6]), out.rates[:, :6, None])[..., 0]
        size = 6 + machines.joints
        zd = np.concatenate([turned, out.rates[:, 6:size]], axis=1)
        machines.backend.set_rates(index, zd, out.rates[:, size:])
        if closed is None:
            link = motion.turn
            self.turn[index] = np.swapaxes(link, -1, -2) @ t.turn
            tool = motion.place
            self.place[index] = matvec(np.swapaxes(link, -1, -2), self.position[index] - tool)
            self.carried[index], self.written = True, True
            self._refit(index)
            self._describe()
        elif not self._still:
            self.velocity[index] = out.twist[:, :3]
            self.spin[index] = rotate(conjugate(self.attitude[index]), out.twist[:, 3:])
            self._put(index)
        machines.changed()
        return [self.history[i][-1] for i in index.tolist()]

    def release(self, ids: npt.ArrayLike | None = None) -> list[Capture]:
        """Open the latch: no impulse; the payload flies on as it moves.

        Raises:
            ParameterError: a payload that is not carried; none is released then.
        """
        index = simulation_ids(ids, self.machines.n)
        if not len(index):
            return []
        self._require(index, carried=True)
        state, time = self.state, self.machines.state.time
        for name in ("position", "attitude", "velocity", "spin"):
            getattr(self, name)[index] = getattr(state, name)[index]
        if self._still:
            self.velocity[index], self.spin[index] = 0.0, 0.0
        self.carried[index] = False
        self._refit(index)
        self._put(index)
        events = [Capture(i, float(time[i]), "release") for i in index.tolist()]
        for event in events:
            self.note(event)
        return events

    # ----------------------------------------------------------------- ledger

    @property
    def momentum(self) -> Array:
        """(n, 6) of arm, base and payload about the inertial origin [kg m/s, kg m^2/s]."""
        return self.ledger(np.arange(self.machines.n))[0]

    @property
    def energy(self) -> tuple[Array, Array]:
        """Kinetic energy (n,) of arm with base, and of the payload [J]."""
        _, base, payload = self.ledger(np.arange(self.machines.n))
        return base, payload

    def ledger(self, ids: Index) -> tuple[Array, Array, Array]:
        """Return `momentum` (k, 6) and the two of `energy` (k,) of some simulations."""
        base, energy = self._momenta(ids)
        M, twist, com = self._bodies(ids)
        return base + body_momentum(M, twist, com), energy, quadratic(M, twist)

    def _momenta(self, ids: Index) -> list[Array]:
        """Momentum (k, 6) and kinetic energy (k,) of arm and base as they really are."""
        machines = self.machines
        _, z, zd = (part[ids] for part in machines.backend.read())
        hidden = [part[ids] for part in machines.backend.internal_state()]

        def moved(system: System, which: Index) -> tuple[Array, ...]:
            space = system.ideal()
            flexible = len(system.arm.geared) + len(space.base.carried)
            modes = np.zeros((len(which), space.base.m))  # modes take no part
            h, hd = (np.hstack([part[which, :flexible], modes]) for part in hidden)
            numbers = parameters(space)[1]
            out = system_function("momentum", space)(z[which], zd[which], h, hd, numbers)
            return out[:, :6], out[:, 6]

        out, energy = self._of_systems(ids, moved)
        turn, place = machines.charts.turn[ids], machines.charts.place[ids]
        linear, angular = rotate(turn, out[:, :3]), rotate(turn, out[:, 3:])
        return [np.hstack([linear, angular + np.cross(place, linear)]), energy]

    def _bodies(self, ids: Index) -> tuple[Array, Array, Array]:
        """Mass matrix (k, 6, 6), twist and centre of mass of payloads in space."""
        t = self.target(ids)
        M = free_mass(self.mass[ids], self.inertia[ids], t.turn)
        return M, np.concatenate([t.velocity, t.spin], axis=1), t.centre

    # ---------------------------------------------------------------- helpers

    def _require(self, index: Index, carried: bool) -> None:
        wrong = index[self.carried[index] != carried]
        if len(wrong):
            what = "carries no payload" if carried else "carries its payload already"
            raise ParameterError(f"simulation {int(wrong[0])} {what}")

    def _rows(self, ids: Index) -> PayloadState:
        """State of some payloads."""
        return PayloadState(*(part[ids] for part in self.state))

    def _motion(self, ids: Index) -> tuple[ToolMotion, Array]:
        """Tool and rates (k, N) of some simulations, of arm and base as they really are."""
        state, base = self.machines.rows(ids)
        at, rate = (part[ids] for part in self.machines.backend.internal_state())

        def moved(system: System, which: Index) -> tuple[Array, ...]:
            flexible = slice(0, len(system.arm.geared) + len(system.base.carried))
            where = state.y[which], state.q[which], at[which, flexible]
            motion = tool_motion(system.arm, system.base, *where)
            joined = base[which], state.v[which], rate[which, flexible]
            return (*motion, np.concatenate(joined, axis=1))

        *parts, rates = self._of_systems(ids, moved)
        return ToolMotion(*parts), rates

    def _tool(self, ids: Index) -> ToolState:
        """Tools of some simulations in space, inertial axes, without any mass matrix."""
        state, base = self.machines.rows(ids)
        at, rate = (part[ids] for part in self.machines.backend.internal_state())

        def moved(system: System, which: Index) -> tuple[Array, ...]:
            q, v, geared = state.q[which], state.v[which], list(system.arm.geared)
            q[:, geared] += at[which, : len(geared)]  # the links turn further than the rotors
            v[:, geared] += rate[which, : len(geared)]
            return tool_in_space(system.arm, state.y[which], base[which], q, v)

        return ToolState(*self._of_systems(ids, moved))

    def _of_systems(
        self, ids: Index, values: Callable[[System, Index], tuple[Array, ...]]
    ) -> list[Array]:
        """Return arrays (k, ...) of simulations, computed together for equal arms and vehicles.

        Args:
            ids: (k,) which.
            values: of a system and of rows of `ids`.
        """
        groups = self.machines.alike(ids)
        if len(groups) == 1:
            return list(values(*groups[0]))
        gathered = [(rows, values(system, rows)) for system, rows in groups]
        out = [np.empty((len(ids), *part.shape[1:])) for part in gathered[0][1]]
        for rows, parts in gathered:
            for full, part in zip(out, parts, strict=True):
                full[rows] = part
        return out

    def _refit(self, ids: Index) -> None:
        """Make the engine's last links what they are with what they carry, or without."""
        if not len(ids):
            return
        k = len(ids)
        mass, com, inertia = np.zeros(k), np.zeros((k, 3)), np.zeros((k, 3, 3))
        for system, rows in self.machines.alike(ids):
            numbers = numbers_of(system.arm.links[-1].inertial)
            mass[rows], com[rows], inertia[rows] = numbers
        carries = self.carried[ids]
        which = ids[carries]
        body = self.mass[which], self.com[which], self.inertia[which]
        mass[carries], com[carries], inertia[carries] = with_body(
            mass[carries],
            com[carries],
            inertia[carries],
            *body,
            self.place[which],
            self.turn[which],
        )
        self.machines.backend.set_last_link(ids, mass, com, inertia)


def _degrees(angle: float | None) -> str:
    return "" if angle is None else f" and {np.rad2deg(angle):.3g} deg"
