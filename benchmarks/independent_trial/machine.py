"""The machine: arm on a flexible base in weightlessness, or on the laboratory's platform.

One state vector, one function per control period, run by CasADi's `mapaccum`. `Plant` is built
from two machines: `known`, what controllers, feed-forward, gravity estimate and payload model
believe, and `true`, what is there. A hidden effect has a size `s`, an input of the compiled
function, so that one graph serves every size and s = 0 is the machine without it.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np
from scipy.linalg import expm

from benchmarks.independent_trial import arm as rigid
from benchmarks.independent_trial.arm import SX, Arm
from benchmarks.independent_trial.base import Base, read

if TYPE_CHECKING:
    from benchmarks.independent_trial.effects import Effect
    from benchmarks.independent_trial.motions import Motion

PERIOD, STEPS = 0.0125, 10  # s between readings and log rows; Runge-Kutta steps in it
H = PERIOD / STEPS


@dataclass
class Laboratory:
    """Platform servo and sensor filter of each of the six axes, gravity's tilt."""

    omega: Any  # (6,) rad/s
    ratio: Any  # (6,)
    cutoff: Any  # (6,) rad/s, Butterworth
    gain: Any  # (6, 6) reading per wrench
    tilt: Any  # (2,) rad about x and y

    @staticmethod
    def read(table: dict[str, Any]) -> Laboratory:
        platform = table["platform"]
        return Laboratory(
            omega=np.full(6, 2 * np.pi * platform["bandwidth"]),
            ratio=np.full(6, platform["damping_ratio"]),
            cutoff=np.full(6, 2 * np.pi * table["sensor"]["cutoff"]),
            gain=np.eye(6),
            tilt=np.zeros(2),
        )


@dataclass
class Machine:
    """Numbers of one machine; `lab` is None in weightlessness."""

    arm: Arm
    base: Base
    lab: Laboratory | None
    kp: Any
    kd: Any
    drive: Any  # (n,) torque delivered per torque commanded

    @staticmethod
    def read(system: dict[str, Any], kp: list[float], kd: list[float]) -> Machine:
        lab = Laboratory.read(system["emulator"]) if system["mode"] == "emulated" else None
        arm = Arm.read(system["arm"])
        base = read(system["vehicle"])
        return Machine(arm, base, lab, np.array(kp), np.array(kd), np.ones(arm.n))

    def copy(self) -> Machine:
        return copy.deepcopy(self)


def gravity(arm: Arm, p: rigid.Pose, phi: SX, tilt: Any) -> SX:
    """Wrench (6,) of the arm's weight at the platform's origin, in its axes."""
    mass = sum(p.masses)
    first = sum((m * c for m, c in zip(p.masses, p.centres, strict=True)), ca.SX.zeros(3))
    down = rigid.rotation(ca.vertcat(tilt[0], tilt[1], 0)) @ ca.SX([0, 0, -rigid.GRAVITY])
    g = rigid.rotation(phi).T @ down
    return ca.vertcat(mass * g, rigid.cross(first, g))


class Layout:
    """Names for pieces of one vector."""

    def __init__(self, **sizes: int) -> None:
        self.at, start = {}, 0
        for name, size in sizes.items():
            self.at[name] = slice(start, start + size)
            start += size
        self.size = start

    def split(self, x: SX) -> SimpleNamespace:
        return SimpleNamespace(**{k: x[s] for k, s in self.at.items()})

    def join(self, **parts: SX) -> SX:
        return ca.vertcat(*(ca.reshape(ca.SX(parts[k]), -1, 1) for k in self.at))


class Plant:
    """`true` under the control of what `known` says, with `effects` of sizes (k,)."""

    def __init__(self, known: Machine, true: Machine, effects: list[Effect]) -> None:
        self.known, self.effects = known, effects
        self.n, self.m = known.arm.n, known.base.modes
        self.size = ca.SX.sym("s", max(1, len(effects)))
        self.true = true.copy()
        for i, e in enumerate(effects):
            e.change(self.true, self.size[i])
        n, m = self.n, self.m
        self.geared = sorted({j for e in effects for j in e.gears})
        g = len(self.geared)
        states = {f"z{i}": e.states(n) for i, e in enumerate(effects)}
        self.x = Layout(Y=6, u=m, q=n, dY=6, du=m, v=n, th=g, dth=g, s1=6, s2=6, **states)
        self.ticks = {f"z{i}": e.tick_states(n) for i, e in enumerate(effects)}
        self.k = Layout(
            c=6, cr=6, c0=6, cr0=6, next=6, nextr=6, X=6 + m + n, V=6 + m + n,
            P=6, dP=6, d=n, dd=n, f1=6, f2=6, **self.ticks,
        )  # fmt: skip
        self.deep = 12 if any(e.delays for e in effects) else 0
        self.h = Layout(**{f"h{i}": 2 * n for i in range(self.deep)})
        self.inputs = Layout(q=n, v=n, ff=n, ext=6, t=1, tau=1)
        self.ff = rigid.feedforward(known.arm)
        self._period()

    # --- physics -----------------------------------------------------------------------------

    def _servo(self, c: SimpleNamespace) -> None:
        """Motor torque from what the drive measures: c.tau."""
        qm, vm = c.motor_q, c.motor_v
        for e, s, z in c.active:
            qm, vm = e.measured(c, s, z, qm, vm)
        tau = self.known.kp * (c.i.q - qm) + self.known.kd * (c.i.v - vm) + c.i.ff
        c.told = tau
        c.tau = self.true.drive * tau
        for e, s, z in c.active:
            c.tau = e.drive(c, s, z, c.tau)

    def _rates(self, x: SX, k: SX, hist: SX, inp: SX) -> tuple[SX, SX, SX]:
        """x', reading of the wrench (6,), told torque (n,)."""
        arm, base, lab, n = self.true.arm, self.true.base, self.true.lab, self.n
        c = SimpleNamespace(x=self.x.split(x), k=self.k.split(k), i=self.inputs.split(inp), n=n)
        c.hist = [self.h.split(hist).__dict__[f"h{i}"] for i in range(self.deep)]
        sizes = [self.size[i] for i in range(len(self.effects))]
        z = [getattr(c.x, f"z{i}") for i in range(len(self.effects))]
        c.active = list(zip(self.effects, sizes, z, strict=True))
        S = c.x
        c.motor_q, c.motor_v = self._encoder(x, "q", "th"), self._encoder(x, "v", "dth")
        self._servo(c)
        torque, extra = c.tau, ca.SX.zeros(6)
        c.mode_force = ca.SX.zeros(self.m)
        flows = {}
        for i, (e, s, zi) in enumerate(c.active):
            t, b, dz = e.flow(c, s, zi)
            torque, extra, flows[f"z{i}"] = torque + t, extra + b, dz
        links, link = copy.copy(arm), ca.SX(torque)
        links.rotor = [0 if j in self.geared else arm.rotor[j] for j in range(n)]
        ddth = ca.SX.zeros(len(self.geared))
        for e, s, zi in c.active:
            for j, through in e.gear(c, s, zi).items():
                ddth[self.geared.index(j)] = (torque[j] - through) / arm.rotor[j]
                link[j] = through
        p = rigid.pose(links, S.q)
        Hq, T = rigid.inertia(links, p), rigid.twist_map(S.Y)
        phi, dphi = S.Y[3:6], S.dY[3:6]
        turn = ca.jtimes(rigid.turn_rates(phi) @ dphi, phi, dphi)
        zero, still = ca.SX.zeros(3), ca.SX.zeros(n)
        if lab is None:
            f0, t0 = rigid.newton_euler(links, p, T @ S.dY, zero, turn, S.v, still)
            pose_, rate = ca.vertcat(S.Y, S.u), ca.vertcat(S.dY, S.du)
            held = -(ca.SX(base.D) @ rate + ca.SX(base.K) @ pose_) + ca.vertcat(
                extra + c.i.ext, c.mode_force
            )
            E = ca.diagcat(T, ca.SX.eye(n))
            A = E.T @ Hq @ E
            A[:6, :6] += base.M[:6, :6]
            acc = rigid.solve(A, ca.vertcat(held[:6] - T.T @ f0, link - t0))
            ddY, ddu, a = acc[:6], held[6:], acc[6:]
            wrench = -(Hq[:6, :6] @ T @ ddY + Hq[:6, 6:] @ a + f0)
            reading, ds1, ds2 = wrench, ca.SX.zeros(6), ca.SX.zeros(6)
        else:
            order, slope = c.k.c + c.k.cr * c.i.tau, c.k.cr
            for e, s, _ in c.active:
                order, slope = e.order(c, s, order, slope)
            ddY = lab.omega**2 * (order - S.Y) + 2 * lab.ratio * lab.omega * (slope - S.dY)
            ddY = ddY + extra + c.i.ext
            ddu = ca.SX.zeros(self.m)
            up = T @ ddY
            f0, t0 = rigid.newton_euler(links, p, T @ S.dY, up[:3], up[3:] + turn, S.v, still)
            a = rigid.solve(Hq[6:, 6:], link - t0)
            wrench = -(f0 + Hq[:6, 6:] @ a) + gravity(arm, p, phi, lab.tilt)
            ds1 = S.s2
            ds2 = lab.cutoff**2 * (wrench - S.s1) - np.sqrt(2) * lab.cutoff * S.s2
            reading = S.s1
        dx = self.x.join(
            Y=S.dY, u=S.du, q=S.v, dY=ddY, du=ddu, v=a, th=S.dth, dth=ddth,
            s1=ds1, s2=ds2, **flows,
        )  # fmt: skip
        return dx, reading, c.told

    # --- the sampled loop --------------------------------------------------------------------

    def _tick(self, x: SX, k: SX, noise: SX, t: SX) -> tuple[SX, SX, SX]:
        """One reading: new tick state, wrench, wrench less the estimated weight (thesis 2.4.2).

        The payload's inertia is known and predicted (documentation, section 11): what the
        platform's own motion adds to the reading is taken out, and the base is integrated with
        the arm on it by the trapezoidal rule, then again over the sensor's delay.
        """
        n, m, known = self.n, self.m, self.known
        lab, S, k_ = known.lab, self.x.split(x), self.k.split(k)
        w = self.true.lab.gain @ S.s1
        ticks = {}
        for i, e in enumerate(self.effects):
            z = getattr(k_, f"z{i}")
            w, ticks[f"z{i}"] = e.sense(SimpleNamespace(x=S, t=t), self.size[i], z, w)
        w = w + noise
        p = rigid.pose(known.arm, self._encoder(x, "q", "th"))
        wg = w - gravity(known.arm, p, S.Y[3:6], np.zeros(2))
        Hq = rigid.inertia(known.arm, p)
        T, here = rigid.twist_map(k_.X[:6]), rigid.twist_map(S.Y)
        force = T.T @ (wg + k_.f1)
        E = ca.diagcat(T, ca.SX.eye(n))
        carried = E.T @ Hq @ E
        base = self.true.base
        at = [*range(6), *range(6 + m, 6 + m + n)]
        M, D, K = (
            ca.SX(ca.diagcat(ca.SX(B), ca.SX.zeros(n, n))) for B in (base.M, base.D, base.K)
        )
        for a_, i in enumerate(at):
            for b_, j in enumerate(at):
                M[i, j] += carried[a_, b_]
        for j in range(n):
            D[6 + m + j, 6 + m + j], K[6 + m + j, 6 + m + j] = known.kd[j], known.kp[j]
        f = ca.vertcat(force, ca.SX.zeros(m + n))
        X, V = trapezoid(M, D, K, k_.X, k_.V, f, PERIOD)
        ahead = np.sqrt(2) / lab.cutoff[0] + PERIOD / 2
        X2, V2 = trapezoid(M, D, K, X, V, f, ahead)
        # the payload model over the coming period, under the command that now acts
        plant, filt = expected(lab.omega[0], lab.ratio[0], lab.cutoff[0])
        both = ca.horzcat(k_.P, k_.dP, k_.next, k_.nextr)
        after = both @ plant.T
        mean = (after[:, 1] - k_.dP) / PERIOD
        Hm, Hbm = Hq[6:, 6:], Hq[:6, 6:]
        shake = -Hbm.T @ here @ mean
        d, dd = trapezoid(Hm, ca.diag(known.kd), ca.diag(known.kp), k_.d, k_.dd, shake, PERIOD)
        give = Hbm @ ((dd - k_.dd) / PERIOD)
        seen = Hq[:6, :6] @ here @ (both @ filt["accel"].T) + give @ ca.DM(filt["hold"]).T
        f1 = filt["free"][0, 0] * k_.f1 + filt["free"][0, 1] * k_.f2 + seen[:, 0]
        f2 = filt["free"][1, 0] * k_.f1 + filt["free"][1, 1] * k_.f2 + seen[:, 1]
        new = self.k.join(
            c=k_.next, cr=k_.nextr, c0=k_.c, cr0=k_.cr, next=X2[:6], nextr=V2[:6], X=X, V=V,
            P=after[:, 0], dP=after[:, 1], d=d, dd=dd, f1=f1, f2=f2, **ticks,
        )  # fmt: skip
        return new, w, wg

    def _period(self) -> None:
        """Compile one control period: (x, k, hist), inputs -> next, and what rows need."""
        sx = lambda name, size: ca.SX.sym(name, size)  # noqa: E731
        x, k, hist = sx("x", self.x.size), sx("k", self.k.size), sx("h", self.h.size)
        inp, noise, t = sx("i", self.inputs.size), sx("noise", 6), sx("t", 1)
        rates = ca.Function(
            "rates", [x, k, hist, inp, self.size], [*self._rates(x, k, hist, inp)]
        )
        self.rates = rates
        X, K, HI = (
            ca.MX.sym(a, b)
            for a, b in (("x", self.x.size), ("k", self.k.size), ("h", self.h.size))
        )
        I, N, S = (
            ca.MX.sym(a, b)
            for a, b in (
                ("i", self.inputs.size * (2 * STEPS + 1)),
                ("n", 6),
                ("s", self.size.shape[0]),
            )
        )
        stage = ca.reshape(I, self.inputs.size, 2 * STEPS + 1)
        y, kk, hh = X, K, HI
        w = wg = None
        if self.true.lab is not None:
            tick = ca.Function(
                "tick", [x, k, noise, t, self.size], [*self._tick(x, k, noise, t)]
            )
            kk, w, wg = tick(X, K, N, stage[self.inputs.at["t"], 0], S)
        _, reading, told = rates(X, kk, HI, stage[:, 0], S)
        if w is None:
            w = wg = reading
        trace = [X]
        for j in range(STEPS):
            a = stage[:, 2 * j]
            if self.deep:  # newest first
                seen = [self._encoder(y, "q", "th"), self._encoder(y, "v", "dth")]
                hh = ca.vertcat(*seen, hh[: -2 * self.n])
            k1 = rates(y, kk, hh, a, S)[0]
            k2 = rates(y + H / 2 * k1, kk, hh, stage[:, 2 * j + 1], S)[0]
            k3 = rates(y + H / 2 * k2, kk, hh, stage[:, 2 * j + 1], S)[0]
            k4 = rates(y + H * k3, kk, hh, stage[:, 2 * j + 2], S)[0]
            y = y + H / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
            trace.append(y)
        rows = ca.vertcat(w, wg, kk[self.k.at["c0"]], told)
        fast = ca.horzcat(*trace[:-1])
        self.period = ca.Function(
            "period",
            [ca.vertcat(X, K, HI), I, N, S],
            [ca.vertcat(y, kk, hh), rows, ca.vec(fast)],
        )  # fmt: skip
        self.size_all = self.x.size + self.k.size + self.h.size

    def _encoder(self, x: Any, link: str, motor: str) -> Any:
        """What encoders see (n,): the motor where a gear gives way, else the link."""
        at, own = self.x.at[link].start, self.x.at[motor].start
        row = [
            own + self.geared.index(j) if j in self.geared else at + j for j in range(self.n)
        ]
        return ca.vertcat(*(x[i] for i in row))

    # --- a run -------------------------------------------------------------------------------

    def run(
        self,
        motion: Motion,
        rows: int,
        size: list[float] | None = None,
        noise: np.ndarray | None = None,
        rng: np.random.Generator | None = None,
        **start: np.ndarray,
    ) -> Run:
        """Simulate `rows` control periods from rest.

        Args:
            size: (k,) of each effect, default nought: none of them.
            noise: (rows, 6) added to the readings of the laboratory's wrench.
            rng: for effects that draw a disturbance of their own.
            start: states that do not begin at rest, as dY=(6,).
        """
        count = len(self.effects)
        s = np.zeros(max(1, count))
        s[:count] = 0.0 if size is None else size
        t = np.arange(2 * STEPS * rows + 1) * (H / 2)
        when, ext = t, np.zeros((len(t), 6))
        told = np.tile(t[:, None], self.n)
        for e, si in zip(self.effects, s, strict=False):
            told = e.command_time(told, si)
            if rng is not None:
                ext = ext + e.disturb(when, si, self.true, rng)
        q, v, a = motion(told)
        ff = np.array(self.ff.map(len(t))(q.T, v.T, a.T)).T
        loc = np.tile(np.arange(2 * STEPS + 1) * (H / 2), (rows, 1))
        stage = np.hstack([q, v, ff, ext, t[:, None]])
        pick = np.arange(rows)[:, None] * 2 * STEPS + np.arange(2 * STEPS + 1)
        I = np.concatenate([stage[pick], loc[..., None]], axis=2)  # (rows, 21, inputs)
        q0 = motion(np.zeros((1, self.n)))[0][0]
        begin = self._rest(q0)
        for name, value in start.items():
            begin[self.x.at[name]] = value
        N = np.zeros((6, rows)) if noise is None else noise.T
        S = np.tile(s[:, None], rows)
        _, out, fast = self.period.mapaccum("run", rows)(begin, I.reshape(rows, -1).T, N, S)
        out, fast = np.array(out).T, np.array(fast).T.reshape(rows * STEPS, -1)
        return Run(self, motion, rows, out, fast)

    def _rest(self, q0: np.ndarray) -> np.ndarray:
        start = np.zeros(self.size_all)
        start[self.x.at["q"]] = q0
        start[self.x.at["th"]] = q0[self.geared]
        for i in range(self.deep):
            h = self.x.size + self.k.size + 2 * self.n * i
            start[h : h + self.n] = q0
        if self.true.lab is not None:
            sym = self.true.arm
            wrench = gravity(
                sym, rigid.pose(sym, ca.SX(q0)), ca.SX.zeros(3), self.true.lab.tilt
            )
            weigh = ca.Function("weigh", [self.size], [wrench])
            start[self.x.at["s1"]] = np.array(weigh(0)).ravel()
        for i, e in enumerate(self.effects):
            start[self.x.at[f"z{i}"]] = e.rest(self.n, q0)
        return start


class Run:
    """One simulated run: states every H seconds, rows every PERIOD. No measurement errors."""

    def __init__(self, plant: Plant, motion: Motion, rows: int, out: Any, fast: Any) -> None:
        at, n = plant.x.at, plant.n
        column = lambda k: fast[:, at[k]]  # noqa: E731
        self.rows, self.motion = rows, motion
        self.y, self.yd, self.u, self.ud = (column(k) for k in ("Y", "dY", "u", "du"))
        self.q, self.v = column("q").copy(), column("v").copy()
        self.link_q, self.link_v = column("q"), column("v")
        self.q[:, plant.geared], self.v[:, plant.geared] = column("th"), column("dth")
        self.w, self.wg, self.y_cmd = out[:, :6], out[:, 6:12], out[:, 12:18]
        self.tau = out[:, 18 : 18 + n]
        self.t = np.arange(rows) * PERIOD
        self.q_cmd, self.v_cmd, _ = motion(np.tile(self.t[:, None], n))
        self.emulated = plant.true.lab is not None

    def sampled(self) -> dict[str, np.ndarray]:
        """Channels at the rows, as they would be read without any error."""
        fast = {k: getattr(self, k)[::STEPS] for k in ("q", "v", "y", "yd")}
        slow = {k: getattr(self, k) for k in ("tau", "w")}
        if self.emulated:
            slow |= {"wg": self.wg, "y_cmd": self.y_cmd}
        return {**fast, **slow}


def trapezoid(M: SX, D: SX, K: SX, x: SX, v: SX, f: SX, h: float) -> tuple[SX, SX]:
    """One step of M x'' + D x' + K x = f by the trapezoidal rule, f held."""
    start = rigid.solve(M, f - D @ v - K @ x)
    left = M * (2 / h) + D + K * (h / 2)
    new = rigid.solve(left, f + M @ (v * (2 / h) + start) - K @ (x + h / 2 * v))
    return x + h / 2 * (v + new), new


def expected(omega: float, ratio: float, cutoff: float) -> tuple[Any, dict[str, Any]]:
    """One axis over a period, as the payload model has it.

    Returns the platform (2, 4) from (Y, Y', command, its rate), and what of the Butterworth
    filter's state comes from itself, from the platform, and from a held 1. The platform's
    acceleration is taken as linear within each step H (found from the example runs: sampled
    exactly instead, the emulated base is 1e-3 of its motion away after 10 s).
    """
    accel = np.array([-(omega**2), -2 * ratio * omega, omega**2, 2 * ratio * omega])
    G = np.zeros((4, 4))
    G[0, 1], G[2, 3] = 1, 1
    G[1] = accel
    step = expm(G * H)
    F = np.zeros((4, 4))  # filter, its input, the input's slope
    F[0, 1], F[2, 3] = 1, 1
    F[1] = [-(cutoff**2), -np.sqrt(2) * cutoff, cutoff**2, 0]
    E = expm(F * H)
    state, free, seen, hold = np.eye(4), np.eye(2), np.zeros((2, 4)), np.zeros((2, 1))
    for _ in range(STEPS):
        now, state = accel @ state, step @ state
        ramp = np.stack([now, (accel @ state - now) / H])
        seen = E[:2, :2] @ seen + E[:2, 2:] @ ramp
        hold = E[:2, :2] @ hold + E[:2, [2]]
        free = E[:2, :2] @ free
    return state[:2], {"free": free, "accel": seen, "hold": hold}
