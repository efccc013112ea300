"""Do designed experiments decide? diagnose -> design -> run -> diagnose, on hidden machines.

Development cases of the blind benchmark with one effect each. What is at hand is one run that
moves every joint by a fraction of an ordinary one, a fraction of its own per joint: in family
`weak` 2 to 30 %, effects of at least three times the noise on ordinary runs; in family `rivals`
10 to 50 %, and the effect is sized for a third of the noise in that very run, so that several
causes explain it. Where its diagnosis leaves rivals, or could not have seen a basic effect, the
next motion is designed from that diagnosis alone and run on the hidden machine, which the
simulator knows nothing of; the two runs are diagnosed. Beside it, the same with an ordinary run
of the benchmark's menu, at full size, in place of the designed one.

    python -m benchmarks.experiments --family rivals --cases 0:100 --out out/experiments
"""

from __future__ import annotations

import argparse
import dataclasses
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ves_gym._util.params import Array, canonical_json, write_text
from ves_gym.diagnosis.benchmark.blind.cases import FINAL, BlindCase, Runner, plan_of, root_seed
from ves_gym.diagnosis.benchmark.blind.excitation import ExcitationMotion, MotionSamples
from ves_gym.diagnosis.benchmark.blind.machine import controller, nominal
from ves_gym.diagnosis.benchmark.blind.noise import converted, digital, draw_noise, stamps
from ves_gym.diagnosis.benchmark.blind.setup import with_nuisance
from ves_gym.diagnosis.benchmark.blind.write import logs_of
from ves_gym.diagnosis.benchmark.labels import answer_name, label_name
from ves_gym.diagnosis.diagnose import NAMED, ONE_OF, WEAK, Diagnosis, diagnose
from ves_gym.diagnosis.inputs import system_inputs
from ves_gym.diagnosis.next_motion import NextMotion, next_motion
from ves_gym.mechanics.motion import Motion
from ves_gym.system.runlog import RunLog

WAYS = ("designed", "ordinary")
FAMILIES = {"weak": (0.02, 0.3), "rivals": (0.1, 0.5)}  # of a motion's size, joint by joint
_FAINT = 1 / 3  # gap over noise at hand, family rivals
_VISIBLE = 3.0  # gap over noise on ordinary runs from which a name is owed


class Commanded(ExcitationMotion):
    """A `Motion` as the hidden machine is told it."""

    def __new__(cls, motion: Motion) -> Commanded:
        """Wrap a motion."""
        out = super().__new__(cls, [], [], [], [])
        out.motion = motion
        return out

    motion: Motion

    def at(self, t: Array) -> MotionSamples:
        """Return position, rate and acceleration at instants t (N,), held outside."""
        s = self.motion.at(t)
        return MotionSamples(s.q, s.v, s.a)


class HiddenMachine:
    """A case of the development set that can be asked for further runs.

    Args:
        runner: of the benchmark.
        index: of the case.
        family: of `FAMILIES`.
    """

    def __init__(self, runner: Runner, index: int, family: str = "weak") -> None:
        root = root_seed("development")
        self.runner, self.plan = runner, plan_of(index, root)
        seeds = np.random.SeedSequence((root, 1 + index)).spawn(6)
        machine, choice, move, self._disturb, self._clock, more = map(
            np.random.default_rng, seeds
        )
        self.setup = with_nuisance(runner.nominal, machine)
        motions = runner.motions(move)
        low, high = np.log(FAMILIES[family])
        size = np.exp(more.uniform(low, high, 3))
        self.at_hand, self.ordinary = motions[0].scaled(size), motions[1]
        plan, judged = self.plan, motions[:-FINAL]
        if family == "rivals":
            plan, judged = plan._replace(ratios=(_FAINT,)), [self.at_hand]
        effects, self.reached = runner.effects(
            plan, self.setup, judged, choice, motions[-FINAL:]
        )
        self.truth = [label_name(e.label()) for e in effects]
        self.broken = digital(self.setup)
        for effect in effects:
            self.broken = effect.applied(self.broken)

    def run(self, motion: ExcitationMotion) -> RunLog:
        """Return the log of a run, with noise of its own."""
        r = self.runner
        noise = draw_noise(r.samples, self._disturb)
        record = converted(r.records(self.broken, [motion], [noise])[0])
        t = stamps(r.samples, self.setup.dt, self.setup.clock, self._clock)
        case = BlindCase(0, self.plan, (), (), [t], [record], [motion])
        log = logs_of(case, r.description, controller())[0]
        meta = {k: x for k, x in log.meta.items() if k != "held_back"}
        return dataclasses.replace(log, meta=meta)


def diagnosed(logs: Sequence[RunLog]) -> Diagnosis:
    """Return the diagnosis of logs, none held back."""
    inputs = system_inputs(logs, final=0)
    return diagnose(inputs.machine, inputs.runs, candidates=inputs.candidates)


def right(diagnosis: Diagnosis, truth: Sequence[Any]) -> bool:
    """Return True if just the truth is named, by kind and place, and nothing else may be it."""
    names = [
        answer_name(
            {
                "kind": f.candidate.kind,
                "slot": f.candidate.slot,
                "value": dict(zip(f.candidate.names, f.values, strict=True)),
                "std": dict(zip(f.candidate.names, f.std, strict=True)),
            }
        )
        for f in diagnosis.explanations
    ]
    return diagnosis.verdict == NAMED and names == list(truth)


def _say(text: str) -> None:
    print(text, flush=True)


def tried(machine: HiddenMachine, say: Callable[[str], None] = _say) -> dict[str, Any]:
    """Return what the first run leaves open in a case, and what one more run makes of it."""
    first = machine.run(machine.at_hand)
    before = diagnosed([first])
    out: dict[str, Any] = {
        "truth": [list(n) for n in machine.truth],
        "wanted": list(machine.plan.ratios),
        "verdict": before.verdict,
        "sentence": before.sentence,
    }
    say(f"  {machine.truth} {before.sentence}")
    if before.verdict not in (ONE_OF, WEAK):
        return out
    begin = time.perf_counter()
    design = next_motion(before)
    assert isinstance(design, NextMotion)
    out["design"] = {**design.to_dict(), "seconds": time.perf_counter() - begin}
    say(f"  {out['design']['seconds']:.0f} s: {design.sentence}")
    motions = (Commanded(design.motion), machine.ordinary)
    for way, motion in zip(WAYS, motions, strict=True):
        after = diagnosed([first, machine.run(motion)])
        out[way] = {
            "verdict": after.verdict,
            "sentence": after.sentence,
            "right": right(after, machine.truth),
        }
        say(f"  {way}: {'right' if out[way]['right'] else 'WRONG'}: {after.sentence}")
    return out


def main() -> None:
    """Try the cases, print shares."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--family", choices=sorted(FAMILIES), default="rivals")
    parser.add_argument("--cases", default="0:60", metavar="A:B")
    parser.add_argument("--out", default="out/experiments", metavar="FOLDER")
    parser.add_argument("--minutes", type=float, default=60.0, help="begin no case after that")
    args = parser.parse_args()
    first, last = map(int, args.cases.split(":"))
    runner, root = Runner(nominal().to_dict(), controller()), root_seed("development")
    begin, results = time.perf_counter(), []
    for index in range(first, last):
        plan = plan_of(index, root)
        if plan.category != "single" or (args.family == "weak" and plan.ratios[0] < _VISIBLE):
            continue
        if time.perf_counter() - begin > 60 * args.minutes:
            break
        print(f"case {index}", flush=True)
        result = {"index": index, **tried(HiddenMachine(runner, index, args.family))}
        results.append(result)
        write_text(Path(args.out) / f"case-{index:03d}.json", canonical_json(result) + "\n")
    report(results)


def report(results: Sequence[dict[str, Any]]) -> None:
    """Print the shares decided rightly by one more run."""
    for verdict in (ONE_OF, WEAK, None):
        open_ = [r for r in results if "design" in r and verdict in (None, r["verdict"])]
        print(f"{verdict or 'both'}: {len(open_)} of {len(results)} first runs")
        for way in WAYS if open_ else ():
            hits = sum(r[way]["right"] for r in open_)
            print(f"  {way}: {hits} of {len(open_)} decided rightly")


if __name__ == "__main__":
    main()
