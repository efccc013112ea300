"""One file of a set: the labels opened, and what was answered."""

import json
from pathlib import Path
from typing import Any

SCHEMA = "ves-trial2-answers/1"
KEPT = ("kind", "slot", "gain", "strain", "reliability")  # of names withheld


def published(folder: Path, *, gaps: bool = False) -> dict[str, Any]:
    """Return labels and answers of the cases answered so far, without a gap in their numbers.

    Args:
        folder: of the set, with `labels`, `answers` and `diagnoses`.
        gaps: go on behind a gap; of cases that were picked by their labels.
    """
    labels: list[Any] = []
    answers: dict[str, Any] = {}
    for index, path in enumerate(sorted((folder / "answers").glob("*.json"))):
        if not gaps and path.stem != f"{index:03d}":
            break
        given = json.loads(path.read_text("utf-8"))
        whole = folder / "diagnoses" / path.stem / "answer.json"
        found = json.loads(whole.read_text("utf-8")) if whole.exists() else {}
        given["withheld"] = [{k: w[k] for k in KEPT} for w in found.get("withheld", [])]
        labels.append(json.loads((folder / "labels" / path.name).read_text("utf-8")))
        answers[path.stem] = given
    return {"schema": SCHEMA, "labels": labels, "answers": answers}
