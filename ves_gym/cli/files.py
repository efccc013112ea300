"""Files that commands read and write."""

from __future__ import annotations

from pathlib import Path

from ves_gym._util.optional import require
from ves_gym._util.params import ParameterError
from ves_gym.cli.flags import Flag, one_of, read
from ves_gym.planners.case import load_case
from ves_gym.report.figures import FORMATS

FORMAT = Flag("--format", "F", one_of(*FORMATS), f"of the pictures: {', '.join(FORMATS)} (png)")
PICTURES = (Flag("--no-figures", help="no pictures"), FORMAT)  # `main` draws them


def log_path(path: Path, json: str | None) -> Path:
    """Return the path of a run log that can be written there, beside the result `json`."""
    if path.suffix not in (".csv", ".parquet"):
        raise ParameterError(f"--log must end in .csv or .parquet, got {path.name!r}")
    if path.is_dir():
        raise ParameterError(f"--log must be a file to write, got the folder {str(path)!r}")
    if path.suffix == ".parquet":
        require("Parquet", "pyarrow")
    if json is not None and Path(json).resolve() in [k.resolve() for k in log_files(path)[1:]]:
        raise ParameterError(
            f"--json {json} is where the log's metadata goes; give another name"
        )
    return path


def log_files(path: Path) -> list[Path]:
    """Return the files that a run log consists of: a CSV file has its metadata beside it."""
    return [path, path.with_suffix(".json")] if path.suffix == ".csv" else [path]


def _log(value: str) -> Path:
    if Path(value).suffix not in (".toml", ".json"):
        return Path(value)
    case = load_case(value)
    if case.log is None:
        raise ParameterError(f"{value}: the case names no log")
    return Path(case.log)


log_file = read(_log)  # the name of a run log, or of a case: that of its log
