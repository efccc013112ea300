"""A plan beside the straight line: what is predicted, and what the simulator says."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ves_gym._util.params import ParameterError
from ves_gym._util.tables import table
from ves_gym.mechanics.limits import LimitCheck
from ves_gym.mechanics.vehicle import vehicle_name
from ves_gym.planners.comparison import simulate_motions
from ves_gym.planners.predicted_disturbance import predict_disturbance
from ves_gym.planners.query import Plan
from ves_gym.system.disturbance import UNITS, Disturbance
from ves_gym.system.energy import TAIL, Energies

_SHOWN = ("predicted", "simulated", "straight")


@dataclass(frozen=True, eq=False)
class PlanReport:
    """Measures of a plan; `report_plan` takes them. Without a motion there are none."""

    plan: Plan
    energies: dict[str, Energies]  # simulated, straight
    disturbances: dict[str, Disturbance]  # predicted, simulated, straight
    reference: LimitCheck | None = None
    simulated: LimitCheck | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return plain data: the plan's, and the measures."""
        plan = self.plan.to_dict()
        if self.reference is None or self.simulated is None:
            return plan
        return {
            **plan,
            **{name: one.to_dict() for name, one in self.energies.items()},
            "disturbance": {name: one.to_dict() for name, one in self.disturbances.items()},
            "frequency_weight": str(self.plan.query.weight),
            "limits": {
                "reference": self.reference.to_dict(),
                "simulated": self.simulated.to_dict(),
            },
        }

    def __str__(self) -> str:
        plan = self.plan
        if self.reference is None or self.simulated is None or plan.predicted is None:
            return f"{plan.planner}: {plan.failure} ({plan.seconds:.2f} s)"
        rows: list[tuple[str, list[float]]] = []
        for name, value in plan.predicted.to_dict().items():
            played = [getattr(self.energies[k], name) for k in _SHOWN[1:]]
            rows.append((f"{name} [J]", [value, *played]))
        for name, unit in UNITS.items():
            values = [getattr(self.disturbances[k], name) for k in _SHOWN]
            rows.append((f"{name} [{unit}]", values))
        cells = [
            [name, *(f"{v:.4g}" for v in vs), f"{vs[1] / vs[2]:.3f}" if vs[2] > 0 else "-"]
            for name, vs in rows
        ]
        head = ("measure", "predicted", "simulated", "straight line", "ratio")
        vehicle = vehicle_name(plan.query.system.vehicle)
        title = f"{plan.planner}: {plan.query.duration:g} s on {vehicle}"
        verdict = "feasible" if plan.feasible else f"NOT feasible: {plan.failure}"
        return "\n".join(
            [
                table(head, cells, title=title),
                f"E_weighted: gain {plan.query.weight}; means over the motion and {TAIL:g} s"
                " after it",
                f"planned in {plan.seconds:.2f} s; {verdict}",
                self.reference.verdict("reference"),
                self.simulated.verdict("simulated arm"),
            ]
        )


def report_plan(plan: Plan) -> PlanReport:
    """Simulate a plan beside the straight line between its ends.

    Args:
        plan: a planner's answer, with a motion or without.
    """
    if plan.motion is None:
        return PlanReport(plan, {}, {})
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
    )
