"""Share of a gap that torques written without a name remove on runs held back.

    python -m benchmarks.unnamed --kinds hose_drag dwell_stiction --each 3 --out /tmp/unnamed

Cases outside the library, of the blind benchmark's development set. The library is not asked:
every case is taken for one that is not in it.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from ves_gym.diagnosis.benchmark.blind.cases import mix, order_of, root_seed
from ves_gym.diagnosis.benchmark.run import make_case
from ves_gym.diagnosis.benchmark.score import removed_gap
from ves_gym.diagnosis.inference.fit import fit
from ves_gym.diagnosis.inference.held_back import gaps
from ves_gym.diagnosis.inference.unknown import unnamed
from ves_gym.diagnosis.inference.whitened_residuals import WhitenedResiduals
from ves_gym.diagnosis.inputs import system_inputs


def cases(kinds: list[str], each: int) -> list[tuple[int, str]]:
    """Index and kind of the first cases of each kind."""
    plans = mix()
    of: dict[str, list[int]] = {}
    for index, k in enumerate(order_of(root_seed("development"))):
        if plans[k].category == "outside":
            of.setdefault(plans[k].kinds[0].removeprefix("outside/"), []).append(index)
    return [(i, kind) for kind in kinds or sorted(of) for i in of[kind][:each]]


def main() -> None:
    """Make cases, fit what is unnamed in each, and print the gap before and after."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kinds", nargs="*", default=[], help="default: all")
    parser.add_argument("--each", type=int, default=2)
    parser.add_argument("--out", default="out/unnamed")
    args = parser.parse_args()
    shares: dict[str, list[float]] = {}
    for index, kind in cases(args.kinds, args.each):
        folder = Path(args.out) / "logs" / f"case-{index:03d}"
        if not folder.exists():
            make_case(args.out, root_seed("development"), index)
        inputs = system_inputs([str(folder)])
        residuals = WhitenedResiduals(inputs.machine, inputs.runs)
        last = WhitenedResiduals(inputs.machine, inputs.final, 1)
        null = fit(residuals, (), ())
        found = unnamed(residuals, last, null)
        final = gaps(last, found or null, null, False)
        worst = max(final, key=lambda g: g.before)
        removed = removed_gap([(g.port, g.channel, g.before, g.after) for g in final])
        joints = [] if found is None else [c.name for c in found.candidates]
        print(
            f"{index} {kind}: {worst.port}/{worst.channel} {worst.before:.2f} to"
            f" {worst.after:.2f}, written at {', '.join(joints) or 'no joint'}",
            flush=True,
        )
        if removed is not None:
            shares.setdefault(kind, []).append(removed)
    for kind, values in shares.items():
        print(f"{kind}: median {np.median(values):.2f} of {len(values)}")
    every = [x for values in shares.values() for x in values]
    if every:
        print(f"all: median {np.median(every):.2f} of {len(every)} that are off by 2 x noise")


if __name__ == "__main__":
    main()
