"""How well the diagnosis works: cases with hidden effects, answers, scores."""

from typing import TYPE_CHECKING

from ves_gym._util.lazy import lazily as _lazily

if TYPE_CHECKING:
    from ves_gym.diagnosis.benchmark.blind.cases import Runner as Runner
    from ves_gym.diagnosis.benchmark.blind.cases import root_seed as root_seed
    from ves_gym.diagnosis.benchmark.blind.machine import controller as controller
    from ves_gym.diagnosis.benchmark.blind.machine import nominal as nominal
    from ves_gym.diagnosis.benchmark.blind.write import read_labels as read_labels
    from ves_gym.diagnosis.benchmark.blind.write import seal as seal
    from ves_gym.diagnosis.benchmark.blind.write import write_set as write_set

__all__ = ["Runner", "controller", "nominal", "read_labels", "root_seed", "seal", "write_set"]

_HOMES = {
    "Runner": "blind.cases",
    "controller": "blind.machine",
    "nominal": "blind.machine",
    "read_labels": "blind.write",
    "root_seed": "blind.cases",
    "seal": "blind.write",
    "write_set": "blind.write",
}
__getattr__, __dir__ = _lazily(__name__, _HOMES)
