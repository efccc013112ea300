"""Self-contained pages and pictures: the report of a benchmark, the studio, figures."""

from typing import TYPE_CHECKING

from ves_gym._util.lazy import lazily as _lazily

if TYPE_CHECKING:
    from ves_gym.report.notebook import Studio as Studio
    from ves_gym.report.notebook import progress_bar as progress_bar

__all__ = ["Studio", "progress_bar"]

_HOMES = {"Studio": "notebook", "progress_bar": "notebook"}
_lazily(__name__, _HOMES)
