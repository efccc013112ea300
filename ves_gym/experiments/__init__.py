"""Many runs: units, specifications, sweeps, executors, searches."""

from typing import TYPE_CHECKING

from ves_gym._util.lazy import lazily as _lazily

if TYPE_CHECKING:
    from ves_gym.experiments.spec import Evaluations as Evaluations
    from ves_gym.experiments.spec import Spec as Spec
    from ves_gym.experiments.sweep import merge as merge
    from ves_gym.experiments.sweep import sweep as sweep_units

__all__ = ["Evaluations", "Spec", "merge", "sweep_units"]

_HOMES = {"Evaluations": "spec", "Spec": "spec", "merge": "sweep", "sweep_units": "sweep:sweep"}
_lazily(__name__, _HOMES)
