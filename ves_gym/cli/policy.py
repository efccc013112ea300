"""`ves-gym policy`: policies for other engines (ONNX), and their model cards."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ves_gym._util.params import ParameterError, read_table, write_text
from ves_gym.cli.flags import Answer, Flag, integer, path

SCHEMA = "ves-policy-command/1"
FOLDER = Path("out/policies")
POLICY = Flag(
    "POLICY",
    help="a .json file or a released one, such as PumaDamp/ppo; none: all released",
    many=True,
    optional=True,
)


def _names(policy: tuple[str, ...]) -> list[str]:
    from ves_gym.baselines.policy import RELEASED

    files = RELEASED.glob("*/*.json")
    released = (path.relative_to(RELEASED).with_suffix("").as_posix() for path in files)
    return list(policy) or sorted(released)


def _file(name: str, suffix: str) -> str:
    """Name of a file about a policy: PumaDamp-ppo.md."""
    return str(Path(name).with_suffix("")).strip("./").replace("/", "-") + suffix


def export(
    *, policy: tuple[str, ...] = (), onnx: bool = False, out: Path | None = None
) -> Answer:
    """Write policies as ONNX, actions compared."""
    from ves_gym.baselines.onnx_file import write_onnx
    from ves_gym.baselines.policy import load_policy

    if not onnx:
        raise ParameterError("policy export needs --onnx, the one format that it writes")
    rows: list[dict[str, Any]] = []
    for name in _names(policy):
        path = (out or FOLDER) / _file(name, ".onnx")
        gap = write_onnx(load_policy(name), path)
        rows.append({"policy": name, "path": str(path), "difference": gap})
    lines = (
        f"{r['path']}: actions within {r['difference']:.1g} of {r['policy']}" for r in rows
    )
    return Answer(text="\n".join(lines), plain={"schema": SCHEMA, "onnx": rows})


def card(
    *,
    policy: tuple[str, ...] = (),
    figures: Path | None = None,
    episodes: int = 100,
    seed: int = 0,
    out: Path | None = None,
) -> Answer:
    """Write the model cards of policies (Markdown)."""
    from ves_gym.report.policy_card import evaluation_for_card, policy_card

    rows = []
    for name in _names(policy):
        if figures is None:
            evaluation = evaluation_for_card(name, episodes, seed)
        else:
            file = figures / _file(name, ".json") if figures.is_dir() else figures
            evaluation = read_table(file)
        path = (out or FOLDER) / _file(name, ".md")
        write_text(path, policy_card(name, evaluation))
        rows.append({"policy": name, "path": str(path)})
    text = "\n".join(row["path"] for row in rows)
    return Answer(text=text, plain={"schema": SCHEMA, "cards": rows})


ACTIONS = {
    "export": (
        "write policies as ONNX, actions compared",
        (POLICY, Flag("--onnx", help="the format (the only one)")),
        export,
    ),
    "card": (
        "write the model cards of policies (Markdown)",
        (
            POLICY,
            Flag("--figures", "PATH", path,
                 "evaluation of the policy as JSON (`ves-gym evaluate --json`), or a folder"
                 " with one per policy, such as docs/training; default: evaluate it now"),
            Flag("--episodes", "N", integer(1), "of that evaluation (100)"),
        ),
        card,
    ),
}  # fmt: skip
