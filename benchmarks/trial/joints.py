"""Joints under their servo, shared by both modes: torques, gears, late or slow readings."""

import numpy as np

from benchmarks.trial.arm import Array, Table
from benchmarks.trial.hidden import Gear, Hidden
from benchmarks.trial.servo import Servo


class Joints:
    """What the joints do at an instant, given command, angles, rates and memory of laws.

    `memory` is that of the laws, then n filtered rates if rates are read through a low-pass.
    """

    def __init__(self, arm: Table, servo: Servo, hidden: Hidden, q: Array) -> None:
        self.servo, self.hidden = servo, hidden
        self.limit = np.array([link["tau_max"] for link in arm["links"]], float)
        self.start, self.parts = hidden.memory(q)
        self.gears = [
            (law, part)
            for law, part in zip(hidden.laws, self.parts, strict=True)
            if isinstance(law, Gear)
        ]
        self.lag = hidden.signals.velocity_lag
        if self.lag is not None:
            self.start = np.concatenate([self.start, np.zeros(len(q))])
        self.rotors = np.array([link["rotor_inertia"] for link in arm["links"]], float)

    def true(self, q: Array, v: Array, s: Array) -> tuple[Array, Array]:
        """Angles and rates on the encoders' side of every gear (n,)."""
        if not self.gears:
            return q, v
        q, v = q.copy(), v.copy()
        for law, part in self.gears:
            q[law.place], v[law.place] = s[part]
        return q, v

    def read(self, q: Array, v: Array, s: Array) -> tuple[Array, Array]:
        """Angles and rates (n,) as servo and log see them, but for a delay."""
        q, v = self.true(q, v, s)
        return q, (v if self.lag is None else np.where(self.lag > 0, s[len(s) - len(v) :], v))

    def asked(self, c: Array, seen: tuple[Array, Array]) -> Array:
        """Torque (n,) that the servo asks for, within the stated limits."""
        tau = c - self.servo.kp * seen[0] - self.servo.kd * seen[1]
        return np.minimum(np.maximum(tau, -self.limit), self.limit)

    def torque(
        self, t: float, c: Array, q: Array, v: Array, s: Array, seen: tuple[Array, Array] | None
    ) -> tuple[Array, Array]:
        """Return the torque on the links (n,) and the rates of the memory.

        Args:
            t: time [s].
            c: (n,) command [N m].
            q, v: (n,) angles and rates of the links.
            s: memory.
            seen: angles and rates that the servo goes by, where they are late.
        """
        ds = np.zeros(len(s))
        tau = self.asked(c, self.read(q, v, s) if seen is None else seen)
        rotor_q, rotor_v = self.true(q, v, s)
        told = tau
        for law in self.hidden.laws:
            told = law.limit(told)
        out = told
        for law, part in zip(self.hidden.laws, self.parts, strict=True):
            extra = law.joint(t, rotor_q, rotor_v, told, s[part], ds[part])
            if extra is not None:
                out = out + extra
        if self.gears:
            out = out.copy()
        for gear, part in self.gears:
            j = gear.place
            through = gear.transfer(rotor_q[j] - q[j], rotor_v[j] - v[j])
            ds[part] = rotor_v[j], (out[j] - through) / gear.rotor
            out[j] = through
        if self.lag is not None:
            n = len(v)
            slow = s[len(s) - n :]
            ds[len(s) - n :] = np.where(
                self.lag > 0, (rotor_v - slow) / np.maximum(self.lag, 1e-4), 0
            )
        return out, ds

    def links_without_rotors(self, arm: Table) -> list[Table]:
        """Links of the arm with the rotors of gears taken off."""
        places = {law.place for law, _ in self.gears}
        return [
            {**link, "rotor_inertia": 0.0} if j in places else link
            for j, link in enumerate(arm["links"])
        ]
