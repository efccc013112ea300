# mypy: warn-unused-ignores, strict-equality
# pyright: reportUnnecessaryTypeIgnoreComment=true
"""What mypy and pyright see of the front door; `make check` reads it, nothing runs it.

An `ignore` that ignores nothing is an error: what it stands at must be one.
"""

import ves_gym as vg

plan = vg.plan([0, 0, 0], [1.0, 0.5, -0.5], duration=2.0)
log: vg.RunLog = vg.simulate(plan.motion)
E_mean: float = plan.predicted.E_mean + vg.energy(log).E_mean
vg.simulat(plan.motion)  # type: ignore[attr-defined]
vg.planners.predic()  # type: ignore[attr-defined]
