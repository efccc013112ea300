"""Planners: paths between two arm configurations that disturb the base least."""

from typing import TYPE_CHECKING

from ves_gym._util.lazy import lazily as _lazily

if TYPE_CHECKING:
    from ves_gym.planners.coupling import coupling_matrix as coupling_matrix
    from ves_gym.planners.coupling import modes as modes
    from ves_gym.planners.prediction import predict as predict

__all__ = ["coupling_matrix", "modes", "predict"]

_HOMES = {"coupling_matrix": "coupling", "modes": "coupling", "predict": "prediction"}
_lazily(__name__, _HOMES)
