"""`TrainingResult`: the policies that a training made, and how they were learned."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ves_gym._util.tables import table
from ves_gym._util.views import Viewable
from ves_gym.baselines.config import TrainConfig
from ves_gym.baselines.policy import Policy, load_policy

SCHEMA = "ves-train/1"


@dataclass(frozen=True, eq=False, repr=False)
class TrainingResult(Viewable):
    """One training run per seed; files are under `folder`/seed-N."""

    config: TrainConfig
    folder: Path
    curves: Mapping[int, list[dict[str, Any]]]  # seed -> rows of its learning curve

    @property
    def policies(self) -> dict[int, Policy]:
        """Best policy of each seed."""
        return {seed: load_policy(self._best(seed)) for seed in self.curves}

    @property
    def best(self) -> Policy:
        """Policy of the seed with the largest return on the validation episodes."""
        returns = {s: max(row["return"] for row in rows) for s, rows in self.curves.items()}
        return load_policy(self._best(max(returns, key=lambda seed: returns[seed])))

    def _best(self, seed: int) -> Path:
        return self.folder / f"seed-{seed}" / "best.json"

    def __repr__(self) -> str:
        returns = [max(row["return"] for row in rows) for rows in self.curves.values()]
        return (
            f"<TrainingResult: {self.config.env}, {self.config.label},"
            f" {len(returns)} seed(s), best return {max(returns):.3f}; {self.folder}>"
        )

    def __str__(self) -> str:
        rows, runs = [], [self._run(seed) for seed in self.curves]
        for r in runs:
            best = r["best"]
            interval = f"({best['return_low']:.2f} to {best['return_high']:.2f})"
            rows.append(
                (
                    r["seed"],
                    f"{r['steps']:,}",
                    f"{r['seconds']:.0f}",
                    f"{r['steps_per_second']:,}",
                    f"{r['share_stepping']:.0%}",
                    f"{best['return']:.3f} {interval}",
                    f"{best['success']:.0%}",
                    *(_number(best[name]) for name in ("E_mean_ratio", "E_int_ratio")),
                )
            )
        head = ("seed", "steps", "s", "steps/s", "env", "return", "success", "E_mean/0",
                "E_int/0")  # fmt: skip
        title = f"{self.config.env}, {self.config.label}: best policy of each seed"
        return "\n".join(
            [
                table(head, rows, title=title, left=()),
                "Mean return with its 95 % interval on the validation episodes; env: share of"
                " the time in\nenv.step; E/0: median of the energy over that of the zero"
                " action.",
                *(r["policy"] for r in runs),
            ]
        )

    def to_dict(self) -> dict[str, Any]:
        """Return plain data, schema ves-train/1, as `ves-gym train --json` writes it."""
        runs = [self._run(seed) for seed in self.curves]
        return {"schema": SCHEMA, "config": self.config.to_dict(), "runs": runs}

    def _run(self, seed: int) -> dict[str, Any]:
        rows = self.curves[seed]
        last = rows[-1]
        return {
            "seed": seed,
            "policy": str(self._best(seed)),
            "steps": last["steps"],
            "seconds": last["seconds"],
            "steps_per_second": round(last["steps"] / last["seconds"]),
            "share_stepping": round(last["seconds_stepping"] / last["seconds"], 3),
            "best": max(rows, key=lambda row: row["return"]),
            "last": last,
        }


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"
