"""What may be hidden in a machine. Every law has one size s; s -> 0 takes it away.

Laws are richer than their textbook names: friction has bristles (LuGre: Canudas de Wit and
others, IEEE T-AC 40(3), 1995; several, Maxwell slip: Al-Bender and others, IEEE T-AC 50(11),
2005), gears harden, lose motion and damp on contact (Hunt and Crossley, J. Appl. Mech.
42, 1975), limits fall as motors heat up. README.md has the formulas in one table.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
from scipy.linalg import eigh

from benchmarks.independent_trial import arm as rigid
from benchmarks.independent_trial.arm import SX
from benchmarks.independent_trial.machine import PERIOD, H

Array = np.ndarray


@dataclass
class Effect:
    """One hidden effect at joint or axis `where`, from 0; `law` holds its other numbers."""

    kind: str = ""
    where: int = 0
    law: dict[str, Any] = field(default_factory=dict)
    start: float = 1.0  # a first guess of the size
    unit: str = ""
    gears: tuple[int, ...] = ()
    delays = False

    def change(self, machine: Any, s: SX) -> None:
        """Alter the true machine in place."""

    def states(self, n: int) -> int:
        return 0

    def rest(self, n: int, q0: Array) -> Any:
        return np.zeros(self.states(n))

    def tick_states(self, n: int) -> int:
        return 0

    def measured(self, c: SimpleNamespace, s: SX, z: SX, q: SX, v: SX) -> tuple[SX, SX]:
        """What the drive gets of joint angles and rates (n,)."""
        return q, v

    def drive(self, c: SimpleNamespace, s: SX, z: SX, tau: SX) -> SX:
        """What the motor delivers (n,) of what it is told."""
        return tau

    def flow(self, c: SimpleNamespace, s: SX, z: SX) -> tuple[SX, SX, SX]:
        """Torque beside the motor's (n,), force on the base (6,), z'."""
        return ca.SX.zeros(c.n), ca.SX.zeros(6), ca.SX.zeros(self.states(c.n))

    def gear(self, c: SimpleNamespace, s: SX, z: SX) -> dict[int, SX]:
        """Torque through the gear of joint j."""
        return {}

    def order(self, c: SimpleNamespace, s: SX, order: SX, slope: SX) -> tuple[SX, SX]:
        """The platform's command and its rate (6,) at this instant."""
        return order, slope

    def sense(self, c: SimpleNamespace, s: SX, z: SX, w: SX) -> tuple[SX, SX]:
        """The laboratory's reading (6,) of the filtered wrench; the new tick state."""
        return w, z

    def command_time(self, t: Array, s: float) -> Array:
        """Times (T, n) whose command the drives follow at times t."""
        return t

    def disturb(self, t: Array, s: float, machine: Any, rng: Any) -> Array:
        """Force on the base (T, 6) from outside."""
        return np.zeros((len(t), 6))

    def record(self, rows: dict[str, Array], t: Array, s: float, rng: Any) -> None:
        """Alter recorded channels in place."""


def at(n: int, j: int, value: SX) -> SX:
    out = ca.SX.zeros(n)
    out[j] = value
    return out


def size_of(x: SX, tiny: float = 1e-6) -> SX:
    return ca.sqrt(x * x + tiny * tiny)


# --- joints ----------------------------------------------------------------------------------


class Friction(Effect):
    """-s F(v, z), bristles z_k' = v - |v| z_k / (g(v) b_k), F = sum of w_k z_k / b_k."""

    def states(self, n: int) -> int:
        return len(self.law["bristles"]) + 1

    def level(self, c: SimpleNamespace, v: SX, dwell: SX) -> SX:
        law = self.law
        g = 1 + law.get("stick", 0.0) * ca.exp(-((v / law.get("fade", 0.05)) ** 2))
        if "uneven" in law:
            g = g * (1 + law["uneven"] * ca.tanh(v / 2e-3))
        if "load" in law:
            g = g * (law.get("idle", 0.0) + size_of(c.tau[self.where], 0.05))
        if "dwell" in law:
            g = g * ca.log(1 + ca.fmax(dwell, 0) / law["dwell"])
        return g

    def flow(self, c: SimpleNamespace, s: SX, z: SX) -> tuple[SX, SX, SX]:
        v = c.motor_v[self.where]
        speed, g = size_of(v), self.level(c, v, z[-1])
        b, w = self.law["bristles"], self.law["weights"]
        rates = [v - speed * z[k] / b[k] for k in range(len(b))]
        force = sum(w[k] * z[k] / b[k] for k in range(len(b)))
        dwell = 1 - speed * z[-1] / self.law.get("forget", 0.02)
        dz = ca.vertcat(*rates, dwell)
        return at(c.n, self.where, -s * g * force), ca.SX.zeros(6), dz


class Torque(Effect):
    """A memoryless torque s f(q, v, tau, t)."""

    def flow(self, c: SimpleNamespace, s: SX, z: SX) -> tuple[SX, SX, SX]:
        f: Callable[..., SX] = self.law["f"]
        j = self.where
        value = s * f(c.motor_q[j], c.motor_v[j], c.tau[j], self.law)
        return at(c.n, j, value), ca.SX.zeros(6), ca.SX.zeros(0)


def thinning(q: SX, v: SX, tau: SX, law: dict[str, Any]) -> SX:
    return -v * (1 + (v / law["v0"]) ** 2) ** -law["power"]


def ripple(q: SX, v: SX, tau: SX, law: dict[str, Any]) -> SX:
    k, p = law["teeth"], law["phase"]
    wave = ca.sin(k * q + p) + law["second"] * ca.sin(2 * k * q + 2.1 * p)
    return wave * (1 + law["loaded"] * size_of(tau, 0.1))


class Drive(Effect):
    """tau (1 + s (1 - c (tau / tau_max)^2)): a gain that falls off as the motor saturates."""

    def drive(self, c: SimpleNamespace, s: SX, z: SX, tau: SX) -> SX:
        out, x = ca.SX(tau), tau[self.where]
        out[self.where] = x * (1 + s * (1 - self.law["fall"] * (x / self.law["top"]) ** 2))
        return out


class Thermal(Effect):
    """|tau| < top / (s (1 + c T)), T' = ((tau/top)^2 - T) / warm: cold, then hot."""

    def states(self, n: int) -> int:
        return 1

    def drive(self, c: SimpleNamespace, s: SX, z: SX, tau: SX) -> SX:
        out, j = ca.SX(tau), self.where
        limit = self.law["top"] / (s * (1 + self.law["c"] * z[0]))
        out[j] = ca.fmax(ca.fmin(tau[j], limit), -limit)
        return out

    def flow(self, c: SimpleNamespace, s: SX, z: SX) -> tuple[SX, SX, SX]:
        heat = (c.tau[self.where] / self.law["top"]) ** 2
        return ca.SX.zeros(c.n), ca.SX.zeros(6), (heat - z) / self.law["warm"]


class Gear(Effect):
    """Compliance s [rad/(N m)] that hardens: t = (d + d^3/d0^2) / s + b d', d motor - link."""

    def twist(self, c: SimpleNamespace) -> tuple[SX, SX]:
        row = 0  # one geared joint at a time
        j = self.where
        return c.x.th[row] - c.x.q[j], c.x.dth[row] - c.x.v[j]

    def gear(self, c: SimpleNamespace, s: SX, z: SX) -> dict[int, SX]:
        d, dd = self.twist(c)
        b = 2 * self.law["zeta"] * ca.sqrt(self.law["rotor"] / s)
        return {self.where: (d + (d / self.law["d0"]) ** 2 * d) / s + b * dd}


class Hysteresis(Gear):
    """The same with a Maxwell-slip element beside the spring: h t_s z, z' = dd - |dd| z / b."""

    def states(self, n: int) -> int:
        return 1

    def flow(self, c: SimpleNamespace, s: SX, z: SX) -> tuple[SX, SX, SX]:
        _, dd = self.twist(c)
        dz = dd - size_of(dd, 1e-7) * z / self.law["slip"]
        return ca.SX.zeros(c.n), ca.SX.zeros(6), dz

    def gear(self, c: SimpleNamespace, s: SX, z: SX) -> dict[int, SX]:
        ((j, spring),) = super().gear(c, s, z).items()
        return {j: spring + self.law["share"] * z[0] / s}


class Backlash(Gear):
    """Play s [rad]; on contact k p (1 + c p') with p the overlap (Hunt and Crossley)."""

    def gear(self, c: SimpleNamespace, s: SX, z: SX) -> dict[int, SX]:
        d, dd = self.twist(c)
        over = d - ca.fmax(ca.fmin(d, s / 2), -s / 2)
        k = self.law["k"]
        damp = self.law["c"] * size_of(over, 1e-9) / (size_of(over, 1e-9) + 2e-5)
        return {self.where: k * over + damp * dd}


class Change(Effect):
    """The machine has other numbers than stated: `law["to"](machine, s)`."""

    def change(self, machine: Any, s: SX) -> None:
        self.law["to"](machine, s, self.where, self.law)


def rotor(machine: Any, s: SX, j: int, law: dict[str, Any]) -> None:
    machine.arm.rotor = ca.SX(machine.arm.rotor)
    machine.arm.rotor[j] += s


def payload(machine: Any, s: SX, j: int, law: dict[str, Any]) -> None:
    """A body of mass s and radius of gyration r at p on the last link."""
    b = machine.arm.bodies[-1]
    p, com = ca.SX(law["p"]), ca.SX(b.com)
    d, share = p - com, s / (b.mass + s)
    about = ca.dot(d, d) * ca.SX.eye(3) - d @ d.T
    inertia = ca.SX(b.inertia) + b.mass * share * about + s * law["r"] ** 2 * ca.SX.eye(3)
    machine.arm.bodies[-1] = rigid.Body(b.mass + s, com + share * d, inertia)


def centre(machine: Any, s: SX, j: int, law: dict[str, Any]) -> None:
    b = machine.arm.bodies[-1]
    machine.arm.bodies[-1] = rigid.Body(b.mass, ca.SX(b.com) + s * ca.SX(law["way"]), b.inertia)


class CommandDelay(Effect):
    """Drives follow the command of s ago, each joint by its own share."""

    def command_time(self, t: Array, s: float) -> Array:
        return t - s * self.law["shares"][None, : t.shape[1]]


class EncoderDelay(Effect):
    """The servo of one joint gets q and v of s ago (lines between steps of 1.25 ms).

    The line's change over s is added to what is there now: nothing is left of it at s = 0.
    """

    delays = True

    def line(self, c: SimpleNamespace, back: SX, row: int, slope: SX) -> SX:
        """A recorded number, `back` steps before this one began; on from it where negative."""
        hats = [ca.fmax(0, 1 - ca.fabs(back - k)) for k in range(len(c.hist))]
        before = sum(w * h[row] for w, h in zip(hats, c.hist, strict=True))
        return ca.if_else(back < 0, c.hist[0][row] - back * slope, before)

    def measured(self, c: SimpleNamespace, s: SX, z: SX, q: SX, v: SX) -> tuple[SX, SX]:
        j, n = self.where, c.n
        now = (H * ca.floor(c.i.tau / H + 1e-6) - c.i.tau) / H
        q, v = ca.SX(q), ca.SX(v)
        for x, row, slope in (
            (q, j, H * c.hist[0][n + j]),
            (v, n + j, c.hist[0][n + j] - c.hist[1][n + j]),
        ):
            x[j] += self.line(c, now + s / H, row, slope) - self.line(c, now, row, slope)
        return q, v


# --- base ------------------------------------------------------------------------------------


def stiffness(machine: Any, s: SX, j: int, law: dict[str, Any]) -> None:
    machine.base.K = ca.SX(machine.base.K) * (1 + s)


def damping(machine: Any, s: SX, j: int, law: dict[str, Any]) -> None:
    machine.base.D = ca.SX(machine.base.D) * (1 + s)


def virtual_mass(machine: Any, s: SX, j: int, law: dict[str, Any]) -> None:
    M = ca.SX(machine.base.M)
    M[:3, :3], M[3:6, 3:6] = M[:3, :3] * (1 + s), M[3:6, 3:6] * (1 + law["turn"] * s)
    machine.base.M = M


def one_mode(machine: Any, s: SX, j: int, law: dict[str, Any]) -> None:
    """The frequency of mode j (arm locked at q) times 1 + s, the others as they were."""
    M, K = np.array(machine.base.M), np.array(machine.base.K)
    q = ca.SX.sym("q", machine.arm.n)
    Hq = ca.Function("H", [q], [rigid.inertia(machine.arm, rigid.pose(machine.arm, q))])
    M[:6, :6] += np.array(Hq(law["q"]))[:6, :6]
    w2, phi = eigh(K, M)
    g = M @ phi[:, j]
    machine.base.K = ca.SX(K) + ((1 + s) ** 2 - 1) * w2[j] * ca.DM(np.outer(g, g))


class BaseForce(Effect):
    """A force on the base from laws with states; in weightlessness only."""


class SpeedDamping(BaseForce):
    """-s m_i |Y_i'| Y_i' along each axis, m_i about the base's own inertia."""

    def flow(self, c: SimpleNamespace, s: SX, z: SX) -> tuple[SX, SX, SX]:
        dY = c.x.dY
        force = [-s * m * size_of(dY[i], 1e-8) * dY[i] for i, m in enumerate(self.law["m"])]
        return ca.SX.zeros(c.n), ca.vertcat(*force), ca.SX.zeros(0)


class Appendage(BaseForce):
    """A mass s on a hardening, dry-damped spring: f = s w^2 (1 + (x/x0)^2) x + damping."""

    def states(self, n: int) -> int:
        return 2

    def flow(self, c: SimpleNamespace, s: SX, z: SX) -> tuple[SX, SX, SX]:
        law, way = self.law, ca.SX(self.law["way"])
        x, dx = z[0] - ca.dot(way, c.x.Y), z[1] - ca.dot(way, c.x.dY)
        pull = law["omega"] ** 2 * (1 + (x / law["x0"]) ** 2) * x
        pull = pull + 2 * law["zeta"] * law["omega"] * dx + law["dry"] * ca.tanh(dx / 1e-3)
        return ca.SX.zeros(c.n), s * pull * way, ca.vertcat(z[1], -pull)


class Rolling(BaseForce):
    """The root creeps along an axis: r' = s (F - clip(F, +-grip)), F the beam's force on it."""

    def states(self, n: int) -> int:
        return 1

    def flow(self, c: SimpleNamespace, s: SX, z: SX) -> tuple[SX, SX, SX]:
        K, j = ca.SX(self.law["K"]), self.where
        shift = K[:, j] * z[0]
        pull = ca.dot(K[j, :].T, c.x.Y[:6]) - K[j, j] * z[0]
        grip = self.law["grip"]
        slip = s * (pull - ca.fmax(ca.fmin(pull, grip), -grip))
        return ca.SX.zeros(c.n), shift, slip


class Floor(BaseForce):
    """The floor shakes: K r + D r', r of s metres r.m.s., three lines between 1 and 7 Hz."""

    def disturb(self, t: Array, s: float, machine: Any, rng: Any) -> Array:
        r, dr = np.zeros((len(t), 6)), np.zeros((len(t), 6))
        for f, way, phase in self.law["lines"]:
            w = 2 * np.pi * f
            wave = np.sqrt(2 / 3) * s * np.asarray(way)
            r += np.sin(w * t[:, None] + phase) * wave
            dr += w * np.cos(w * t[:, None] + phase) * wave
        K, D = (np.array(x)[:6, :6] for x in (self.law["K"], self.law["D"]))
        return (r @ K + dr @ D) * np.clip((t - 0.5) / 1.0, 0, 1)[:, None]


class Hose(Effect):
    """A hose over joints: s (k x + z/b), x = sum of its joints' turns, z with Dahl's law."""

    def states(self, n: int) -> int:
        return 1

    def flow(self, c: SimpleNamespace, s: SX, z: SX) -> tuple[SX, SX, SX]:
        way = ca.SX(self.law["way"])
        x, dx = ca.dot(way, c.x.q) - self.law["x0"], ca.dot(way, c.x.v)
        dz = dx - size_of(dx) * z / self.law["b"]
        pull = self.law["k"] * x * (1 + x * x) + z[0] / self.law["b"]
        return -s * pull * way, ca.SX.zeros(6), dz


# --- laboratory ------------------------------------------------------------------------------


class Reading(Effect):
    """The wrench's reading: s f(w, t)."""

    def sense(self, c: SimpleNamespace, s: SX, z: SX, w: SX) -> tuple[SX, SX]:
        return self.law["f"](w, c.t, s, self.law), z


def bias(w: SX, t: SX, s: SX, law: dict[str, Any]) -> SX:
    return w + s * ca.SX(law["way"])


def creep(w: SX, t: SX, s: SX, law: dict[str, Any]) -> SX:
    """Drift after loading: exponential and logarithmic creep."""
    a = 1 - ca.exp(-t / law["T"]) + law["log"] * ca.log(1 + t / law["t0"])
    return w + s * a * ca.SX(law["way"])


def cross_talk(w: SX, t: SX, s: SX, law: dict[str, Any]) -> SX:
    return w + s * (ca.SX(law["G"]) @ w)


def mounting(w: SX, t: SX, s: SX, law: dict[str, Any]) -> SX:
    R = rigid.rotation(s * ca.SX(law["axis"]))
    return ca.vertcat(R.T @ w[:3], R.T @ w[3:])


def pickup(w: SX, t: SX, s: SX, law: dict[str, Any]) -> SX:
    wave = ca.sin(2 * np.pi * 50.03 * t + law["phase"])
    return w + s * wave * ca.SX(law["way"])


class SensorLag(Effect):
    """A slow amplifier on top of the filter: time constant s, each axis by its share."""

    def tick_states(self, n: int) -> int:
        return 6

    def sense(self, c: SimpleNamespace, s: SX, z: SX, w: SX) -> tuple[SX, SX]:
        keep = ca.exp(-PERIOD / (s * ca.SX(self.law["shares"])))
        # to the ramp between readings, not to a step
        new = ca.if_else(c.t <= 0, w, keep * z + (1 - keep) * w)
        return new, new


class LoopDelay(Effect):
    """The platform's command arrives s late; past a period, the last one extended backwards."""

    def order(self, c: SimpleNamespace, s: SX, order: SX, slope: SX) -> tuple[SX, SX]:
        local = c.i.tau - s
        early = local < 0
        before = c.k.c0 + c.k.cr0 * (local + PERIOD)
        return (
            ca.if_else(early, before, c.k.c + c.k.cr * local),
            ca.if_else(early, c.k.cr0, c.k.cr),
        )


def bandwidth(machine: Any, s: SX, j: int, law: dict[str, Any]) -> None:
    machine.lab.omega = ca.SX(machine.lab.omega) * (1 - s * ca.SX(law["shares"]))


def tilt(machine: Any, s: SX, j: int, law: dict[str, Any]) -> None:
    machine.lab.tilt = ca.SX(machine.lab.tilt) + s * ca.SX(law["way"])


class RateLimit(Effect):
    """Oil runs short: above top/s along an axis the platform is braked, 300 1/s."""

    def flow(self, c: SimpleNamespace, s: SX, z: SX) -> tuple[SX, SX, SX]:
        top = ca.SX(self.law["top"]) / s
        over = c.x.dY - ca.fmax(ca.fmin(c.x.dY, top), -top)
        return ca.SX.zeros(c.n), -300 * over, ca.SX.zeros(0)


# --- the recorder ----------------------------------------------------------------------------


class PacketLoss(Effect):
    """Rows of some channels stand still for bursts of s seconds, at random times."""

    def record(self, rows: dict[str, Array], t: Array, s: float, rng: Any) -> None:
        gaps = rng.exponential(self.law["every"], 200).cumsum() + 1.0
        for name in self.law["channels"]:
            for start in gaps[gaps < t[-1]]:
                lost = np.flatnonzero((t > start) & (t < start + s))
                if len(lost):
                    rows[name][lost] = rows[name][max(lost[0] - 1, 0)]


class Hum(Effect):
    """50 Hz and its third harmonic on recorded channels, seen at the rows only."""

    def record(self, rows: dict[str, Array], t: Array, s: float, rng: Any) -> None:
        for name, way in self.law["channels"].items():
            for f, share in ((50.03, 1.0), (150.09, 0.3)):
                wave = np.sin(2 * np.pi * f * t + rng.uniform(0, 2 * np.pi))
                rows[name] = rows[name] + s * share * wave[:, None] * np.asarray(way)


class ClockStep(Effect):
    """The tracker's buffer slips by s seconds in the middle of a run."""

    def record(self, rows: dict[str, Array], t: Array, s: float, rng: Any) -> None:
        when = t[-1] * rng.uniform(0.35, 0.6)
        for name in ("y", "yd"):
            late = np.stack([np.interp(t - s, t, x) for x in rows[name].T], axis=1)
            rows[name] = np.where((t > when)[:, None], late, rows[name])
