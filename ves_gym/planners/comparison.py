"""Planners side by side on one query, and one plan beside the straight line, simulated."""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from ves_gym._util.params import Array, ParameterError, write_result
from ves_gym._util.tables import table
from ves_gym._util.views import Viewable
from ves_gym.mechanics.limits import LimitCheck
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.vehicle import vehicle_name
from ves_gym.planners.bounds import NO_MORE
from ves_gym.planners.execution_check import executed_violation
from ves_gym.planners.linear_response import predict_disturbance
from ves_gym.planners.query import Plan, Planner, Query, solve
from ves_gym.simulation.playback import play_motions
from ves_gym.simulation.recording import Recording
from ves_gym.system.disturbance import Disturbance
from ves_gym.system.energy import TAIL, Energies, base_energy

SCHEMA = "ves-compare/1"
_RECORD = 12.5e-3  # s between records of a simulation


@dataclass(frozen=True, eq=False)
class ComparisonRow:
    """One planner's answer to the query."""

    planner: str
    seconds: float  # planning time
    failure: str | None  # why there is no motion, or what it breaks as commanded or played
    predicted: dict[str, float] | None = None  # E_mean, E_res, E_peak [J]
    simulated: Energies | None = None  # None: no motion, or the run was stopped
    ratio: float | None = None  # simulated E_mean over that of the straight line
    energy: Array | None = None  # (N,) E of the base [J]
    reference_breaks: str | None = None  # limits that the motion breaks, asked for or not
    arm_breaks: str | None = None  # limits that the simulated arm breaks
    bound_breaks: str | None = None  # bounds of the planner that the simulated base passes
    disturbance: Disturbance | None = None  # simulated

    @property
    def feasible(self) -> bool:
        """True where there is a motion that the arm plays as the query asks."""
        return self.failure is None

    @property
    def cells(self) -> tuple[str, ...]:
        """The row as text, see `Comparison.table`."""
        moved = self.disturbance
        notes = ["simulated arm NOT inside the limits"] if self.arm_breaks else []
        notes += [f"bound NOT kept: {self.bound_breaks}"] if self.bound_breaks else []
        return (
            self.planner,
            "-" if self.predicted is None else f"{self.predicted['E_mean']:.4g} J",
            "-" if self.simulated is None else f"{self.simulated.E_mean:.4g} J",
            "-" if self.ratio is None else f"{self.ratio:.3f}",
            "-" if moved is None else f"{moved.acceleration_peak:.3g} m/s^2",
            "-" if moved is None else f"{1e3 * moved.tip_peak:.3g} mm",
            f"{self.seconds:.2f} s",
            self.failure or "; ".join(notes),
        )

    def to_dict(self) -> dict[str, Any]:
        """Return plain data."""
        return {
            **vars(self),
            "simulated": self.simulated and self.simulated.to_dict(),
            "energy": None if self.energy is None else self.energy.tolist(),
            "disturbance": self.disturbance and self.disturbance.to_dict(),
        }


@dataclass(frozen=True, eq=False, repr=False)
class Comparison(Viewable):
    """Planners on one query; iterates over its rows, in the order of the request."""

    name: str  # of the query
    duration: float  # of the motions [s]
    t: Array  # (N,) s, clock of the energies
    rows: tuple[ComparisonRow, ...]
    straight: Energies | None  # of the straight line
    plans: tuple[Plan, ...] = ()  # empty in one that was read from a file

    def __iter__(self) -> Iterator[ComparisonRow]:
        return iter(self.rows)

    def __len__(self) -> int:
        """Return the number of planners."""
        return len(self.rows)

    def __getitem__(self, planner: str) -> ComparisonRow:
        for row in self.rows:
            if row.planner == planner:
                return row
        names = ", ".join(row.planner for row in self.rows)
        raise ParameterError(f"planner must be one of {names}, got {planner!r}")

    @property
    def best(self) -> ComparisonRow | None:
        """Row of the feasible motion with the least simulated `E_mean`; None without one."""
        able = [row for row in self.rows if row.feasible and row.simulated is not None]
        return min(able, key=lambda row: row.simulated.E_mean, default=None)  # type: ignore[union-attr]

    @property
    def table(self) -> str:
        """Rows as aligned text: `E_mean` predicted and simulated, ratio, base and tool, time.

        peak: largest acceleration of the arm's mount; tip: largest error of the tool.
        """
        head = ("planner", "predicted", "simulated", "ratio", "peak", "tip", "planned in", "")
        return table(head, [row.cells for row in self.rows], left=(0, len(head) - 1))

    def __str__(self) -> str:
        return self.table

    def __repr__(self) -> str:
        best = self.best
        text = "none feasible" if best is None else f"best {best.planner}"
        if best is not None and best.ratio is not None:
            text += f", E_mean {best.ratio:.3f} of the straight line's"
        return f"<Comparison: {len(self)} planners on {self.name}; {text}>"

    def to_dict(self) -> dict[str, Any]:
        """Return plain data."""
        return {
            "schema": SCHEMA,
            "name": self.name,
            "duration": self.duration,
            "t": self.t.tolist(),
            "rows": [row.to_dict() for row in self.rows],
            "straight": self.straight and self.straight.to_dict(),
        }

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write as JSON, completely or not at all; plans are saved on their own."""
        write_result(path, self.to_dict())


def compare_planners(query: Query, planners: Sequence[Planner], *, seed: int = 0) -> Comparison:
    """Plan a query with each planner and simulate the motions in lockstep.

    Raises:
        ParameterError: no planner, or two of one name.
    """
    names = [planner.name for planner in planners]
    if not names or len(set(names)) < len(names):
        raise ParameterError(
            f"planners must be one or more of different names, got {', '.join(names) or 'none'}"
        )
    plans = [solve(planner, query, seed) for planner in planners]
    motions = [plan.motion for plan in plans if plan.found]
    run = simulate_motions(query, motions)
    energies = measured(run)
    straight = energies[-1]
    rows: list[ComparisonRow] = []
    played = itertools.count()
    for plan in plans:
        values: dict[str, Any] = {"failure": plan.failure}
        if plan.found and plan.reference:
            i = next(played)  # its run
            values["predicted"] = plan.predicted.to_dict()
            values["failure"] = plan.failure or executed_violation(plan.query, run, i)
            values["reference_breaks"] = plan.reference.reasons
            values["arm_breaks"] = run.limit_check(i, v_max=query.v_max).reasons
            if (simulated := energies[i]) is not None:
                values["simulated"] = simulated
                if straight is not None and straight.E_mean > 0:
                    values["ratio"] = simulated.E_mean / straight.E_mean
                motion = run.q[i], run.y[i], run.yd[i], run.internal(i)
                values["energy"] = base_energy(query.system, *motion).total
                moved = run.disturbance(i, weight=query.weight)
                values["disturbance"] = moved
                if straight is not None:
                    of = run.disturbance(len(motions), weight=query.weight)
                    values["bound_breaks"] = _bound_breaks(plan, moved, of)
        rows.append(ComparisonRow(plan.planner, plan.seconds, **values))
    name = query.name or query.ends_in_words
    return Comparison(name, query.duration, run.t, tuple(rows), straight, tuple(plans))


def simulate_motions(query: Query, motions: Sequence[Motion]) -> Recording:
    """Simulate motions of a query, long enough for `E_mean`, and the straight line last."""
    dt = query.system.physics_dt
    return play_motions(
        query.system,
        [*motions, query.straight],
        servo=query.servo,
        settle=TAIL,
        record_dt=max(1, round(_RECORD / dt)) * dt,
        watch=True,
    )


def measured(run: Recording) -> list[Energies | None]:
    """Energies of each run; None for one that a safety stop ended."""
    stopped = {event.simulation for event in run.events}
    complete = [i for i in range(len(run.q)) if i not in stopped]
    measured = run.energies(complete, as_it_is=True) if complete else []
    energies = dict(zip(complete, measured, strict=True))
    return [energies.get(i) for i in range(len(run.q))]


_SHOWN = ("predicted", "simulated", "straight")


@dataclass(frozen=True, eq=False)
class PlanReport:
    """Measures of a plan; `report_plan` takes them. Without a motion there are none."""

    plan: Plan
    energies: dict[str, Energies]  # simulated, straight
    disturbances: dict[str, Disturbance]  # predicted, simulated, straight
    reference: LimitCheck | None = None
    simulated: LimitCheck | None = None
    failure: str | None = None  # why there is no motion, or what it breaks when it is played
    bound_breaks: str | None = None  # bounds of the planner that the simulated base passes

    def to_dict(self) -> dict[str, Any]:
        """Return plain data: the plan's, and the measures."""
        plan = self.plan.to_dict()
        if self.reference is None or self.simulated is None:
            return plan
        return {
            **plan,
            "feasible": self.failure is None,
            "failure": self.failure,
            "bound_breaks": self.bound_breaks,
            **{name: part.to_dict() for name, part in self.energies.items()},
            "disturbance": {name: part.to_dict() for name, part in self.disturbances.items()},
            "frequency_weight": str(self.plan.query.weight),
            "limits": {
                "reference": self.reference.to_dict(),
                "simulated": self.simulated.to_dict(),
            },
        }

    def __str__(self) -> str:
        plan = self.plan
        if self.reference is None or self.simulated is None:
            return f"{plan.planner}: {plan.failure} (after {plan.seconds:.2f} s of planning)"
        rows: list[tuple[str, list[float]]] = []
        for name, value in plan.predicted.to_dict().items():
            played = (getattr(self.energies[k], name) for k in _SHOWN[1:])
            rows.append((f"{name} [J]", [value, *played]))
        for name, unit in Disturbance.units().items():
            values = [getattr(self.disturbances[k], name) for k in _SHOWN]
            rows.append((f"{name} [{unit}]", values))
        cells = [
            [name, *(f"{v:.4g}" for v in vs), f"{vs[1] / vs[2]:.3f}" if vs[2] > 0 else "-"]
            for name, vs in rows
        ]
        head = ("measure", "predicted", "simulated", "straight line", "ratio")
        vehicle = vehicle_name(plan.query.system.vehicle)
        title = f"{plan.planner}: {plan.query.duration:g} s on {vehicle}"
        verdict = "feasible" if self.failure is None else f"NOT feasible: {self.failure}"
        return "\n".join(
            [
                table(head, cells, title=title),
                f"E_weighted: gain {plan.query.weight}; means over the motion and {TAIL:g} s"
                " after it",
                f"planned in {plan.seconds:.2f} s; {verdict}",
                *([f"bound NOT kept: {self.bound_breaks}"] if self.bound_breaks else []),
                *(f"not in the plan: {note}" for note in plan.notes),
                self.reference.verdict("reference"),
                self.simulated.verdict("simulated arm"),
            ]
        )


def report_plan(plan: Plan) -> PlanReport:
    """Simulate a plan beside the straight line between its ends."""
    if plan.found is None:
        return PlanReport(plan, {}, {}, failure=plan.failure)
    query = plan.query
    run = simulate_motions(query, [plan.motion])
    if run.events:
        raise ParameterError(f"the simulation beside the plan was stopped: {run.events[0]}")
    predicted = predict_disturbance(query, plan.motion)
    moved = [predicted, *(run.disturbance(i, weight=query.weight) for i in range(2))]
    return PlanReport(
        plan,
        dict(zip(_SHOWN[1:], run.energies(), strict=True)),
        dict(zip(_SHOWN, moved, strict=True)),
        plan.reference,
        run.limit_check(0, v_max=query.v_max),
        plan.failure or executed_violation(query, run, 0),
        _bound_breaks(plan, *moved[1:]),
    )


def _bound_breaks(plan: Plan, moved: Disturbance, straight: Disturbance) -> str | None:
    """Name the bounds that a simulated base passes, as shares of the straight line's."""
    measures, of = vars(moved), vars(straight)
    broken = (
        f"{name} {measures[name] / of[name]:.3f}, at most {most:g}"
        for name, most in plan.info.get("bounds", {}).items()
        if measures[name] > NO_MORE * most * of[name] > 0
    )
    return ", ".join(broken) or None
