"""What one run did: energies, their account and limits, beside the same motion in space."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ves_gym._util.tables import table
from ves_gym.mechanics.flexible_base import FlexibleBase, Polyline, as_an_impulse_finds
from ves_gym.mechanics.latch import base_jump
from ves_gym.mechanics.limits import LimitCheck, check_limits, check_reference, limits_of
from ves_gym.mechanics.linear_range import range_sentence
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.vehicle import vehicle_name
from ves_gym.simulation.energy_account import TRUSTED
from ves_gym.simulation.state import Event
from ves_gym.system.energy import TAIL, Energies, log_energies
from ves_gym.system.energy_balance import EnergyBalance
from ves_gym.system.runlog import RunLog
from ves_gym.system.system import System

SCHEMA = "ves-simulate/1"
_APART = 0.01  # by which a flange may start otherwise than with all that its modes leave out
_MEANING = {
    "E_mean": "mean of the base energy over the motion and {tail:g} s after it (the score)",
    "E_res": "at the end of the motion",
    "E_peak": "largest",
    "E_strain_peak": "largest strain energy",
    "E_int": "time integral of the strain energy",
    "W_port": "work through the base port",
    "t_5": "until it stays below 5 % of its peak",
}


@dataclass(frozen=True, eq=False)
class RunSummary:
    """Measures of a run log; `summarise` takes them."""

    system: System
    motion: Motion
    log: RunLog
    tail: float  # s after the motion that E_mean covers
    energies: Energies | None  # None of a run that a safety stop ended
    energies_in_space: Energies | None  # None unless it was emulated beside a run in space
    # largest distance from where the base is in space, over its largest
    base_error: float | None
    ledger: float | None  # relative residual of the log's energy account, mode ideal
    account: float | None  # of that kept at every physics step of the motion, where it was
    reference: LimitCheck
    simulated: LimitCheck

    @property
    def stop(self) -> Event | None:
        """The safety stop that ended the run."""
        stops = self.log.meta.get("events", [])
        return Event(0, **stops[0]) if stops else None

    @property
    def trusted(self) -> bool:
        """False where energy came from nowhere; True too where there is no account."""
        return self._residual < TRUSTED

    @property
    def _residual(self) -> float:
        """The larger of the accounts that can be believed."""
        close = float(self.log.t[1] - self.log.t[0]) <= 1.5 * self.system.physics_dt
        return max(self.account or 0.0, (close and self.ledger) or 0.0)

    @property
    def warnings(self) -> list[str]:
        """A sentence per limit that is broken, and one where the result can't be trusted."""
        out = self.reference.sentences("reference") + self.simulated.sentences("simulated arm")
        if not self.trusted:
            out.append(
                f"the energy account is open by {self._residual:.2g} of the work through the"
                f" base, at most {TRUSTED:g}: do not trust this run; a smaller --physics-dt"
                " closes it"
            )
        sentence = range_sentence(self.system.vehicle, self.log.y)
        return [*out, *filter(None, [sentence, *map(self._stiff_at, self._grasps)])]

    @property
    def _grasps(self) -> list[dict[str, Any]]:
        return [k for k in self.log.meta.get("captures", []) if k["kind"] == "grasp"]

    def _stiff_at(self, grasp: dict[str, Any]) -> str | None:
        """Say where the base has too few modes to take the impulse of a latch."""
        system, vehicle = self.system, self.system.vehicle
        if system.mode != "ideal" or not isinstance(vehicle, FlexibleBase):
            return None
        k = int(np.searchsorted(self.log.t, grasp["time"] - 1e-9))
        at = self.log.y[k], self.log.q[k], np.array(grasp["impulse"])
        bare, full = (
            1e3
            * float(
                np.linalg.norm(
                    base_jump(system.arm, base, *at, system.prescribed_coordinates)[:3]
                )
            )
            for base in (system.base, as_an_impulse_finds(vehicle).base_model())
        )
        if abs(bare - full) <= _APART * full:
            return None
        drawn = isinstance(vehicle.structure, Polyline)
        remedy = "the vehicle's residual = true" if drawn else "all modes of the structure"
        return (
            f"the latch at {grasp['time']:g} s sets the flange off at {bare:.3g} mm/s, the"
            f" whole structure would at {full:.3g}: what rings in its first hundredths of a"
            f" second needs {remedy}"
        )

    @property
    def propellant(self) -> float | None:
        """Return the propellant that a satellite's jets have used [kg]."""
        return None if self.log.propellant is None else float(self.log.propellant[-1, 0])

    def to_dict(self) -> dict[str, Any]:
        """Return plain data; what is infinite or unknown is None."""
        out: dict[str, Any] = {
            "schema": SCHEMA,
            "digest": self.log.digest,
            "system": self.system.hash,
            "mode": self.system.mode,
            "duration": self.motion.duration,
            "tail": self.tail,
            "energies": _plain(self.energies),
            "ledger_residual": self.ledger,
            "energy_residual": self.account,
            "trusted": self.trusted,
            "propellant": self.propellant,
            "limits": {
                "reference": self.reference.to_dict(),
                "simulated": self.simulated.to_dict(),
            },
            "warnings": self.warnings,
        }
        if self.system.mode == "emulated":
            stop = self.stop
            out["energies_in_space"] = _plain(self.energies_in_space)
            out["base_error"] = self.base_error
            out["stopped"] = stop and {"time": stop.time, "reason": stop.reason}
        if "captures" in self.log.meta:
            out["captures"] = self.log.meta["captures"]
        return out

    def __str__(self) -> str:
        lines = []
        for event in self.log.meta.get("captures", []):
            lost = f", {event['lost']:.4g} J lost" if event["kind"] == "grasp" else ""
            lines.append(f"{event['kind']} at {event['time']:g} s{lost}")
        if self.energies is not None:
            lines.append(self._table(self.energies))
        lines.append(
            f"{self.reference.brief('reference')}; {self.simulated.brief('simulated arm')}"
        )
        if self.base_error is not None:
            lines.append(
                f"base position off by {100 * self.base_error:.1f} % of its largest"
                " displacement in space"
            )
        return "\n".join(lines)

    def _table(self, measured: Energies) -> str:
        system, log, space = self.system, self.log, self.energies_in_space
        head = ["measure", "value", "unit", "meaning"]
        if space is not None:
            head[1:2] = ["laboratory", "in space"]
        rows: list[list[str] | None] = []
        beside = {} if space is None else space.to_dict()
        for name, value in measured.to_dict().items():
            cells = [_text(value)] + ([_text(beside[name])] if beside else [])
            meaning = _MEANING[name].format(tail=round(self.tail, 6))
            rows.append([name, *cells, measured.units()[name], meaning])
        if system.mode == "ideal":
            every = 1e3 * float(log.t[1] - log.t[0])
            what = f"relative residual of the energy account, records every {every:g} ms"
            residual = "-" if self.ledger is None else f"{self.ledger:.1e}"
            rows += [None, ["ledger", residual, "1", what]]
        if self.propellant is not None:
            used = "that the satellite's jets have used"
            rows.append(["propellant", _text(self.propellant), "kg", used])
        title = (
            f"{system.arm.name} on {vehicle_name(system.vehicle)}, {self.motion.duration:g} s"
        )
        return table(head, rows, title=title, left=(0, len(head) - 2, len(head) - 1))


def summarise(
    log: RunLog, motion: Motion, space: RunLog | None = None, *, settle: float = TAIL
) -> RunSummary:
    """Take the measures of a run.

    Args:
        log: of the run, as `simulate` records it: its metadata have its system and limits.
        motion: that was played.
        space: the same motion in space, beside an emulation.
        settle: how long the joints were held after it [s].
    """
    system = System.from_dict(log.meta["system"])
    tail, stopped = min(TAIL, settle), bool(log.meta.get("events"))
    ledger = None
    if system.mode == "ideal":
        relative = EnergyBalance.of(log).relative
        ledger = relative if math.isfinite(relative) else None
    return RunSummary(
        system=system,
        motion=motion,
        log=log,
        # a recording interval that does not divide the run ends it up to a record later
        tail=min(tail, float(log.t[-1] - log.t[0]) - motion.duration),
        energies=None if stopped else log_energies(log, tail=tail),
        energies_in_space=None if space is None else log_energies(space, tail=tail),
        base_error=None if space is None else _base_error(log, space),
        ledger=ledger,
        account=log.meta.get("energy_residual"),
        reference=_reference_check(system, motion, log),
        simulated=LimitCheck.from_dict(log.meta["limits"], system.arm.sliding),
    )


def _reference_check(system: System, motion: Motion, log: RunLog) -> LimitCheck:
    """Limits of the reference: the torque that was sent ahead, where it is known."""
    fed_forward = log.tau_ff is not None
    motor = system.drive == "motor"
    commanded = check_reference(
        system.arm, motion, limits_of(system.arm, motor=motor and not fed_forward)
    )
    if not motor or log.tau_ff is None:
        return commanded
    during = log.t <= motion.duration
    torque = {"torque": log.tau_ff[during]}
    limit = {"torque": system.arm.column("tau_max")}
    return LimitCheck(
        (*commanded.extremes, *check_limits(limit, log.t[during], torque).extremes)
    )


def _base_error(log: RunLog, space: RunLog) -> float:
    gap = np.linalg.norm((log.y - space.y[: len(log)])[:, :3], axis=1).max()
    size = np.linalg.norm(space.y[:, :3], axis=1).max()
    return float(gap / size) if size > 0 else 0.0


def _plain(energies: Energies | None) -> dict[str, float | None] | None:
    return None if energies is None else energies.to_dict()


def _text(value: float | None) -> str:
    return "-" if value is None else f"{value:.5g}"
