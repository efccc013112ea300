"""Controllers and policies side by side on the same episodes of an environment."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ves_gym._util.own import require_interface
from ves_gym._util.params import ParameterError, require_one_of, write_result
from ves_gym._util.statistics import Estimate
from ves_gym._util.suggest import did_you_mean
from ves_gym._util.tables import table
from ves_gym._util.views import Viewable
from ves_gym.baselines.controllers import Controller
from ves_gym.baselines.evaluate import (
    ENERGIES,
    Evaluation,
    beats,
    evaluate,
    plain,
    pool,
    ratio,
    ratio_or_none,
)
from ves_gym.baselines.policy import load_policy, released, versions
from ves_gym.baselines.registry import CONTROLLERS, get_controller

SCHEMA = "ves-evaluate/1"
Lineup = list[tuple[str, Sequence[Controller]]]  # label, a controller or a policy per seed


@dataclass(frozen=True, eq=False, repr=False)
class ControllerComparison(Viewable):
    """Evaluations on the same episodes; iterates over them, in the order of the request."""

    evaluations: tuple[Evaluation, ...]

    def __iter__(self) -> Iterator[Evaluation]:
        return iter(self.evaluations)

    def __len__(self) -> int:
        """Return the number of controllers."""
        return len(self.evaluations)

    def __getitem__(self, name: str) -> Evaluation:
        named = {evaluation.name: evaluation for evaluation in self.evaluations}
        require_one_of("controller", name, named)
        return named[name]

    def ratio(self, controller: str, reference: str, measure: str = "E_mean") -> Estimate:
        """Return the median over the episodes of an energy over the reference's."""
        return ratio(self[controller], self[reference], measure)

    @property
    def best(self) -> Evaluation:
        """Evaluation with the largest interquartile mean return."""
        return max(self.evaluations, key=lambda e: e.iqm)

    @property
    def table(self) -> str:
        """Rows as text: return, success, failures, energies and their ratio to the first's."""
        first, rows = self.evaluations[0], []
        for evaluation in self.evaluations:
            s = evaluation.summary()
            ratios = {name: ratio_or_none(evaluation, first, name) for name in ENERGIES}
            rows.append(
                (
                    evaluation.name,
                    _interval(s["return"]["iqm"], ".3f"),
                    _interval(s["success"], ".0%"),
                    s["failed"],
                    _value(s["E_mean"]["median"], ".3g"),
                    _interval(ratios["E_mean"], ".3f"),
                    _value(ratios["E_peak"], ".3f"),
                    _value(ratios["E_int"], ".3f"),
                )
            )
        head = ("controller", "return", "success", "failed", "E_mean\n[J]", "ratio", "E_peak",
                "E_int")  # fmt: skip
        seeds = [row["seed"] for row in first.rows]
        title = f"{first.id}, {len(set(seeds))} episodes from seed {min(seeds)}"
        return (
            table(head, rows, title=title, width=80)
            + "\nreturn: interquartile mean; E_mean: median; ratio, E_peak, E_int: medians of\n"
            f"E_mean, E_peak, E_int over {first.name}'s in the same episode; in brackets 95 %\n"
            "intervals."
        )

    def __str__(self) -> str:
        lines = [self.table]
        for a in self.evaluations:
            worse = [b.name for b in self.evaluations if beats(a, b)]
            if worse:
                lines.append(f"{a.name} beats {', '.join(worse)} (return, intervals apart)")
        return "\n".join(lines)

    def __repr__(self) -> str:
        first = self.evaluations[0]
        scores = ", ".join(f"{e.name} {e.iqm:.3f}" for e in self.evaluations)
        episodes = len(first.rows)
        return f"<ControllerComparison: {first.id}, {episodes} episodes; return {scores}>"

    def to_dict(self) -> dict[str, Any]:
        """Return plain data, schema ves-evaluate/1, as `ves-gym evaluate --json` writes it.

        `beats` lists the pairs whose intervals of the interquartile mean return are apart;
        `ratios` are medians of energies over the first controller's, episode by episode.
        """
        first = self.evaluations[0]
        pairs = [(a, b) for a in self for b in self]
        out: dict[str, Any] = plain(
            {
                "schema": SCHEMA,
                "id": first.id,
                "versions": versions(),
                "controllers": [e.to_dict() for e in self],
                "ratios": {
                    e.name: {name: ratio_or_none(e, first, name) for name in ENERGIES}
                    for e in self
                },
                "beats": [[a.name, b.name] for a, b in pairs if beats(a, b)],
            }
        )
        return out

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write as JSON, completely or not at all."""
        write_result(path, self.to_dict())


def _interval(e: Estimate | None, form: str) -> str:
    if e is None or not math.isfinite(e.value):
        return "-"
    return f"{e.value:{form}}\n({e.low:{form}} to {e.high:{form}})"


def _value(e: Estimate | None, form: str) -> str:
    return "-" if e is None or not math.isfinite(e.value) else format(e.value, form)


def compare_controllers(
    id: str,
    lineup: Lineup,
    *,
    progress: Callable[[str, float], None] = lambda name, done: None,
    **options: Any,
) -> ControllerComparison:
    """Evaluate each of a line-up on the same episodes; `options` are those of `evaluate`."""

    def evaluated(label: str, group: Sequence[Controller], k: int) -> Evaluation:
        def step(done: float) -> None:
            progress(label, (k + done) / len(group))

        return evaluate(group[k], id, progress=step, **options)

    return ControllerComparison(
        tuple(
            pool([evaluated(label, group, k) for k in range(len(group))], label)
            for label, group in lineup
        )
    )


def line_up(id: str, chosen: Sequence[str | Path | Controller], seed: int = 0) -> Lineup:
    """Turn names, files and controllers into labelled groups of controllers.

    Args:
        id: of the environment.
        chosen: names of built-in controllers, files of policies, folders that `train` made
            (its seeds as one), names of released policies, "released" for all of them, or
            controllers; none at all stands for zero, random and the released policies.
        seed: of controllers that draw.

    Raises:
        ParameterError: an unknown name, no such policy, or two of one label.
    """
    entries: list[str | Path | Controller] = []
    for entry in chosen or ("zero", "random", *released(id)):
        entries += (released(id) or [entry]) if entry == "released" else [entry]
    out: Lineup = []
    for entry in entries:
        if not isinstance(entry, (str, os.PathLike)):
            methods = {"reset": ("env", "ids"), "act": ("env", "observation")}
            require_interface("controller", entry, ("name",), **methods)
            out.append((entry.name, [entry]))
        elif str(entry) in CONTROLLERS:
            out.append((str(entry), [get_controller(str(entry), seed)]))
        else:
            files = policy_files(entry, id)
            policies = [load_policy(file) for file in files]
            label = str(policies[0].about.get("algorithm", policies[0].name))
            label += f" x {len(files)}" if len(files) > 1 else ""
            out.append((label if label not in [n for n, _ in out] else str(entry), policies))
    labels = [label for label, _ in out]
    if len(set(labels)) < len(labels):
        raise ParameterError(f"controllers must differ, got {', '.join(labels)}")
    return out


def policy_files(text: str | os.PathLike[str], id: str, base: Path = Path()) -> list[Path]:
    """Return the .json files that a text stands for; paths start from `base`.

    Raises:
        ParameterError: it is no file, no folder of `train`, and neither the name of a released
            policy of the environment nor "released" for all of them.
    """
    policies, word = released(id), str(text)
    named = list(policies.values()) if word == "released" else [policies.get(word)]
    path = base / text
    if path.is_dir():
        files = sorted(path.glob("seed-*/best.json")) or sorted(path.glob("best.json"))
        if not files:
            runs = sorted({str(p.parents[1]) for p in path.glob("*/seed-*/best.json")})
            raise ParameterError(
                f"{path}: no seed-*/best.json in it; give a run of ves-gym train"
                + (f": {', '.join(runs)}" if runs else "")
            )
        return files
    if path.suffix or path.exists():
        return [path]
    if saved := [file for file in named if file is not None]:
        return saved
    policy = isinstance(text, Path)  # a name alone may be a controller's, too
    names = [*policies] if policy else [*CONTROLLERS, *policies]
    known = (
        f", or one of {', '.join(names)} in {id}" if names else f"; {id} has no released one"
    )
    raise ParameterError(
        f"{'policy' if policy else 'controller'} must be a file or folder of policies{known},"
        f" got {word!r}{did_you_mean(word, names)}"
    )
