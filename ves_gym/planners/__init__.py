"""Planners: paths between two arm configurations that disturb the base least."""

from typing import TYPE_CHECKING

from ves_gym._util.lazy import lazily as _lazily

if TYPE_CHECKING:
    from ves_gym.planners.coupling import coupling_matrix as coupling_matrix
    from ves_gym.planners.coupling import modes as modes

__all__ = ["coupling_matrix", "modes"]

_HOMES = {"coupling_matrix": "coupling", "modes": "coupling"}
__getattr__, __dir__ = _lazily(__name__, _HOMES)
