"""`diagnose`: from logs to a verdict.

locate (where do description and data disagree) -> name (what is missing there) -> add (a
description with it) -> verify (on runs that nothing before has touched).
"""

from __future__ import annotations

import dataclasses
import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy.stats

from ves_gym._util.params import Array, ParameterError, to_plain, write_result
from ves_gym._util.views import Viewable
from ves_gym.diagnosis.data.measured_run import Run, with_shared_colour
from ves_gym.diagnosis.data.quality import Fault, faults
from ves_gym.diagnosis.inference.cache import AnswerCache, CachedResiduals
from ves_gym.diagnosis.inference.candidates import Candidate
from ves_gym.diagnosis.inference.dependence import Dependence, dependences
from ves_gym.diagnosis.inference.earned import drop_beaten_by_splines
from ves_gym.diagnosis.inference.explanations import (
    Experiment,
    RankedCandidate,
    classes,
    experiments,
    likeness,
    ranked,
    residual_over_time,
)
from ves_gym.diagnosis.inference.fit import Fit
from ves_gym.diagnosis.inference.held_back import (
    CLEAR,
    drop_refuted_by_holdout,
    gaps,
    unexplained_there,
)
from ves_gym.diagnosis.inference.held_back import Gap as Gap
from ves_gym.diagnosis.inference.model_selection import (
    Rival,
    Selection,
    Thresholds,
    allowed,
    drop_unidentified,
    is_computed,
    select,
    unexplained,
)
from ves_gym.diagnosis.inference.reliability import (
    COMPUTED,
    DOUBT,
    gain,
    reliability,
    strain,
    without,
)
from ves_gym.diagnosis.inference.signatures import Signatures
from ves_gym.diagnosis.inference.slow_noise import slow_noise
from ves_gym.diagnosis.inference.steadiness import drop_nonstationary
from ves_gym.diagnosis.inference.tolerance_scale import (
    ToleranceExcess,
    errors_told,
    selected_with_tolerances,
)
from ves_gym.diagnosis.inference.tolerance_scale import sentence as wider
from ves_gym.diagnosis.inference.unknown import (
    LIBRARY,
    NONE_OF_THESE,
    beliefs,
    doubting,
    evidence,
    unnamed,
)
from ves_gym.diagnosis.inference.unknown import NOTHING as DESCRIBED
from ves_gym.diagnosis.inference.whitened_residuals import Wander, WhitenedResiduals
from ves_gym.diagnosis.machines.base import Machine, untestable
from ves_gym.diagnosis.machines.causes import split
from ves_gym.diagnosis.machines.drift import SlowPath
from ves_gym.effects import BaseUnknown, JointMemory
from ves_gym.system.system import System

NOTHING, NAMED, ONE_OF = "nothing missing", "named", "one of"
MORE, UNKNOWN, WEAK = "named, more remains", "not in the library", "excitation too weak"
NAMING_VERDICTS = (NAMED, ONE_OF, MORE)  # verdicts that give names
VERDICTS = (NOTHING, NAMED, ONE_OF, MORE, UNKNOWN, WEAK)

# What any motion of a joint that is worth the name shows; where it does not, others may hide.
_BASIC = ("joint/coulomb", "joint/viscous", "joint/drive_gain", "joint/rotor_inertia")
_LOGGED = {"weight": "wg"}  # a run's own name of a signal -> that in the log
WIDE = 1.645  # standard deviations to either side of a 90 % interval
_CLEAR = 1.5  # stated standard deviations from zero; they are twice those of a perfect fit
_COMPARED = 10  # candidates whose likeness is told
_FEW = 3  # names that may need a tolerance far off: descriptions state them too narrow
_CHANCE = 1e-4  # of any tolerance of an exact description lying farther off

Progress = Callable[[float, str], None]


@dataclass(frozen=True)
class Explanation:
    """An effect that the data ask for, and the candidates that could stand in its place."""

    candidate: Candidate
    values: Array  # (k,)
    std: Array  # (k,)
    gain: float  # deviance that it explains beside the others
    strain: float  # of the description beside all names, see `reliability.strain`
    reliability: float  # share of names with such evidence that are right
    probability: float
    rivals: tuple[Rival, ...]  # those that do about as well, itself first

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds that these data cannot distinguish."""
        return tuple(dict.fromkeys(r.candidate.kind for r in self.rivals))


@dataclass(frozen=True, eq=False, repr=False)
class Diagnosis(Viewable):
    """Verdict on a machine: what its description lacks, and how sure that is."""

    verdict: str
    explanations: tuple[Explanation, ...]
    gaps: tuple[Gap, ...]  # on the runs that were fitted
    final: tuple[Gap, ...]  # on the runs held back
    untestable: dict[str, tuple[str, ...]]
    weak: tuple[str, ...]  # candidates that these data could not show
    faults: tuple[Fault, ...]  # of the recording
    remaining: float  # deviance above that of noise, after
    selection: Selection
    residuals: WhitenedResiduals
    signatures: Signatures
    limits: Thresholds = field(default_factory=Thresholds)
    seconds: dict[str, float] = field(default_factory=dict)
    depends: tuple[Dependence, ...] = ()  # of what has no name, the best curve first
    beliefs: dict[str, float] = field(default_factory=dict)  # of all hypotheses; their sum is 1
    unnamed: Fit | None = None  # regression of what has no name, where one holds
    tolerances: float = 1.0  # most probable size of the description's errors, in those stated
    withheld: tuple[Explanation, ...] = ()  # names that are not right often enough

    def __repr__(self) -> str:
        return f"<Diagnosis: {self.sentence}>"

    @property
    def effects(self) -> tuple[Any, ...]:
        """Effects that a better description has beside those described."""
        return added(self)

    @property
    def system(self) -> System:
        """Better description: the system with what was missing; as described without a name.

        Raises:
            ParameterError: the machine is no `System`.
        """
        machine = self.residuals.machine
        better = getattr(machine.model(self.effects), "system", None)
        if better is None:
            raise ParameterError(
                f"{machine.name} is no System: `effects` are what its description lacks"
            )
        system: System = better
        return system

    def to_dict(self) -> dict[str, Any]:
        """Return plain data; a number that is not known is None."""
        return plain(self)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write verdict and numbers as JSON; `system.save` writes the better description."""
        write_result(path, self.to_dict())

    @property
    def chance(self) -> float:
        """Chance that the best of all that was looked at gains as much from noise alone."""
        first = self.selection.first
        return 1.0 if first is None else self.selection.law.chance(first[1], first[0])

    @property
    def off(self) -> tuple[ToleranceExcess, ...]:
        """Errors of the description that are larger than it says."""
        if self.tolerances == 1.0:
            return ()
        chosen = self.selection.fit if self.explanations else self.selection.null
        return errors_told(chosen, self.residuals, self.tolerances)

    @property
    def sentence(self) -> str:
        """The verdict in one sentence, and how far off the description is."""
        return self._verdict_in_words + wider(self.tolerances, self.off)

    @property
    def _verdict_in_words(self) -> str:
        names = " and ".join(_named(f) for f in self.explanations)
        why = "".join(f"; {f.sentence}" for f in self.faults)
        withheld = [f"{f.candidate.name} ({100 * f.reliability:.0f} %)" for f in self.withheld]
        doubt = (
            " Not named, as of names with such evidence too few are right:"
            f" {_abbreviated(withheld)}."
        )
        doubt = doubt if withheld else ""
        if self.verdict == NOTHING:
            return (
                "Nothing is missing: description and data agree within noise and tolerances."
                f"{doubt}"
            )
        if self.verdict == WEAK:
            begin = "There is a disagreement" if self.explanations else "No disagreement"
            return (
                f"{begin}, but these runs cannot show {_abbreviated(self.weak)}: the excitation"
                f" is too weak.{doubt}"
            )
        if self.verdict == UNKNOWN:
            on = "".join(f"; {d.sentence}" for d in self.depends[:1])
            if self.unnamed is not None:
                on += _written(self.unnamed.candidates)
            return f"Something is missing, and it is not in the library{why}{on}.{doubt}"
        if self.verdict == MORE:
            return f"Missing: {names}; more remains that is not in the library{why}.{doubt}"
        return f"Missing: {names}.{doubt}"


def _named(explanation: Explanation) -> str:
    if len(explanation.kinds) > 1:
        names = ", ".join(dict.fromkeys(r.candidate.name for r in explanation.rivals))
        return f"one of {{{names}}}"
    c = explanation.candidate
    path = c.effect(explanation.values)
    if isinstance(path, SlowPath):
        return f"{c.name} (root mean square {path.size:.3g} {c.units[0]})"
    certain = np.abs(explanation.values) > _CLEAR * explanation.std
    if not (c.sparse and certain.any()):  # of coordinates those that are not about zero
        certain = np.ones(c.k, bool)
    values = ", ".join(
        f"{name} {value:.4g}{'' if unit == '1' else ' ' + unit}"
        for name, value, unit, clear in zip(
            c.names, explanation.values, c.units, certain, strict=True
        )
        if clear
    )
    return f"{c.name} ({values})"


def _written(candidates: Sequence[Candidate]) -> str:
    """What is written without a name, in words."""
    bases = ", ".join(c.slot for c in candidates if c.kind == BaseUnknown.kind)
    at = [c for c in candidates if c.kind != BaseUnknown.kind]
    joints = ", ".join(dict.fromkeys(c.slot for c in at))
    past = any(c.kind == JointMemory.kind for c in at)
    of = "angles, rates and how it has moved before" if past else "angles and rates"
    on = f"; what is at {joints} is written as a torque without a name, of {of}" if at else ""
    if bases:
        on += f"; what is at the base along {bases} is written as a spring and a damper more"
    return on


def _abbreviated(names: Sequence[str]) -> str:
    listed = ", ".join(names[:3])
    return listed + (f" and {len(names) - 3} more" if len(names) > 3 else "")


def diagnose(
    machine: Machine,
    runs: Sequence[Run],
    final: Sequence[Run] = (),
    *,
    candidates: Sequence[Candidate],
    limits: Thresholds | None = None,
    progress: Progress = lambda done, what: None,
    seed: int = 0,
    cache: AnswerCache | None = None,
) -> Diagnosis:
    """Find the ports where machine and runs disagree, and name the effects that are missing.

    Args:
        machine: the description, as parts that each run alone on measured input.
        runs: to fit.
        final: runs held back; they are opened once, after everything is decided.
        candidates: the library.
        limits: thresholds of the verdict; by default those of the sealed benchmark.
        progress: called with the fraction done and the stage.
        seed: of the noise draws.
        cache: answers of the machine on disk, so that an interrupted diagnosis resumes.

    Returns:
        The verdict, the effects that explain the gap, and all that it rests on.
    """
    stated = limits or Thresholds()
    clock = [time.perf_counter()]
    seconds: dict[str, float] = {}

    def lap(name: str) -> None:
        clock.append(time.perf_counter())
        seconds[name] = clock[-1] - clock[-2]

    progress(0.0, "residuals")
    runs, final = with_shared_colour(runs, runs), with_shared_colour(final, runs)

    def whitened(slow: Mapping[str, Wander]) -> WhitenedResiduals:
        if cache is None:
            return WhitenedResiduals(machine, runs, seed, slow)
        return CachedResiduals(machine, runs, seed, cache, slow)

    residuals = whitened({})
    slow = slow_noise(residuals)
    if slow:
        residuals = whitened(slow)
    lap("locate")
    signatures = Signatures(
        residuals, candidates, lambda done: progress(0.1 + 0.5 * done, "signatures")
    )
    lap("screen")
    judged = selected_with_tolerances(
        residuals,
        signatures,
        lambda r, s: select(r, s, stated, lambda text: progress(0.7, text)),
        lambda k: (
            bool(k.fit.candidates)
            or unexplained(k.fit, residuals, stated.imperfect)
            > allowed(k.fit, residuals, stated)
        ),
    )
    selection, residuals, signatures = (
        judged.selection,
        judged.residuals,
        judged.signatures,
    )
    # what errors far off leave of a linear law grows with their square
    square = judged.factor**2
    limits = dataclasses.replace(
        stated, remains=stated.remains * square, sensed=stated.sensed * square
    )
    lap("name")
    progress(0.9, "runs held back")
    last = None
    if final:
        last = WhitenedResiduals(machine, final, seed + 1, slow).with_tolerances(judged.factor)
    before_gate = selection.fit.deviance
    selection = drop_nonstationary(selection, residuals)
    if last is not None:
        selection = drop_refuted_by_holdout(selection, residuals, last)
    selection = drop_unidentified(selection, residuals)
    # deviance that withdrawn names had explained on the runs fitted
    doubted = selection.fit.deviance - before_gate
    unearned: tuple[str, ...] = ()  # names that curves of no shape beat
    if last is not None:
        selection, unearned = drop_beaten_by_splines(selection, residuals, last)
    explained = [
        _explanation(selection, i, residuals, limits) for i in range(len(selection.rivals))
    ]
    trust = [f.reliability for f in explained]
    doubtful = [i for i, p in enumerate(trust) if p < DOUBT]
    withheld = tuple(
        dataclasses.replace(explained[i], probability=explained[i].probability * trust[i])
        for i in doubtful
    )
    before_doubt = selection.fit.deviance
    selection = without(selection, residuals, doubtful, trust)
    doubted += selection.fit.deviance - before_doubt
    reliable = [f for f in explained if f.reliability >= DOUBT]
    explanations = tuple(
        dataclasses.replace(f, values=x, std=limits.spread * std)
        for f, x, std in zip(reliable, selection.fit.values, selection.fit.std, strict=True)
    )
    remaining = unexplained(selection.fit, residuals, limits.imperfect)
    limits = dataclasses.replace(limits, remains=allowed(selection.fit, residuals, limits))
    tested = {p.name for p in residuals.ports}
    faint = [
        c
        for i, c in enumerate(signatures.candidates)
        if c.kind in _BASIC
        and tested & set(c.ports)
        and _is_faint(signatures, i, selection.fit.size, limits)
    ]
    weak = tuple(c.name for c in faint)
    hidden = any(f.candidate.slot in _motionless_joints(faint) for f in explanations)
    faulty = tuple(f for f in faults(runs) if not _described(f, machine, runs))
    gained = selection.null.deviance - selection.fit.deviance
    share = remaining / max(remaining + gained, 1e-9)
    verdict = _verdict(explanations, remaining, share, bool(weak), hidden, limits)
    if (verdict == MORE or len(explanations) > _FEW) and _is_strained(selection.fit):
        verdict = UNKNOWN
    if unearned and verdict != UNKNOWN:
        earned = any(f.candidate.name not in unearned for f in explanations)
        verdict = MORE if earned else UNKNOWN
    if faulty:
        verdict = _verdict_despite_faults(verdict, faulty, explanations, machine)
    chosen = selection.fit if verdict in NAMING_VERDICTS else selection.null
    after: tuple[Gap, ...] = ()
    if last is not None:
        after = gaps(last, chosen, selection.null, False)
        much = verdict == MORE and remaining > limits.unexplained_named  # not but a tone beside
        if much and _remaining_share(after) > limits.held_back:  # names that do not hold
            verdict, chosen = UNKNOWN, selection.null
            after = gaps(last, chosen, selection.null, False)
        there = unexplained_there(last, chosen, limits.imperfect)
        silent = verdict in (NOTHING, WEAK) and not explanations
        if silent and (there > stated.remains or doubted > CLEAR):
            verdict, remaining = UNKNOWN, max(remaining, there)
    depends: tuple[Dependence, ...] = ()
    regressed: Fit | None = None
    if last is not None and verdict == UNKNOWN:
        depends = dependences(residuals, last, selection.null)
        regressed = unnamed(residuals, last, selection.null)
        if regressed is not None:
            chosen = regressed
            after = gaps(last, chosen, selection.null, False)
    before = gaps(residuals, chosen, selection.null)
    decided = {UNKNOWN: NONE_OF_THESE, NOTHING: DESCRIBED, WEAK: None}.get(verdict, LIBRARY)
    believed = beliefs(selection, *evidence(selection, remaining, limits), decided, limits)
    library = 1 - believed[DESCRIBED] - believed[NONE_OF_THESE]
    explanations = tuple(
        dataclasses.replace(f, probability=f.probability * library * f.reliability)
        for f in explanations
    )
    doubted_most = min((f.reliability for f in explanations or withheld), default=1.0)
    believed = doubting(believed, doubted_most)
    lap("verify")
    return Diagnosis(
        verdict=verdict,
        explanations=explanations,
        gaps=before,
        final=after,
        untestable=untestable(machine, runs),
        weak=weak,
        faults=faulty,
        remaining=remaining,
        selection=selection,
        residuals=residuals,
        signatures=signatures,
        limits=limits,
        seconds=seconds,
        depends=depends,
        beliefs=believed,
        unnamed=regressed,
        tolerances=judged.factor,
        withheld=withheld,
    )


def _explanation(
    selection: Selection, i: int, residuals: WhitenedResiduals, limits: Thresholds
) -> Explanation:
    rivals = selection.rivals[i]
    near = tuple(r for r in rivals if r.cost - rivals[0].cost < limits.alike)
    first = rivals[0]
    p = sum(r.probability for r in rivals if r.candidate.kind == first.candidate.kind)
    std = limits.spread * selection.fit.std[i]
    gained = gain(residuals, selection.fit, i)
    strained = strain(residuals, selection.fit)
    trust = COMPUTED if is_computed(first.candidate) else reliability(gained, strained)
    values = selection.fit.values[i]
    return Explanation(first.candidate, values, std, gained, strained, trust, p, near)


def _verdict(
    explanations: Sequence[Explanation],
    remaining: float,
    share: float,
    weak: bool,
    hidden: bool,
    limits: Thresholds,
) -> str:
    if hidden:
        return WEAK
    if remaining > limits.remains and (not explanations or share > limits.explained):
        return UNKNOWN
    if not explanations:
        return WEAK if weak else NOTHING
    if remaining > limits.unexplained_named:
        return MORE
    return ONE_OF if any(len(f.kinds) > 1 for f in explanations) else NAMED


def _is_strained(f: Fit) -> bool:
    """Return True if a tolerance is farther off than chance would have it.

    Names that leave more, or many names, that need that beside them imitate something else.
    """
    chance = scipy.stats.norm.isf(_CHANCE / (2 * len(f.nuisances)))
    return bool((np.abs(f.nuisances) > chance).any())


def _is_faint(signatures: Signatures, i: int, size: Array, limits: Thresholds) -> bool:
    """Return True if candidate i, of its usual size, would not show in these runs."""
    return max(signatures.visible(i), signatures.visible_above(i, size)) < limits.power


def _motionless_joints(faint: Sequence[Candidate]) -> set[str]:
    """Return joints that barely move: several of the basic effects could not show there."""
    places = [c.slot for c in faint]
    return {place for place in places if places.count(place) > 1}


def _described(fault: Fault, machine: Machine, runs: Sequence[Run]) -> bool:
    """Return True for a tone at which the machine as described rings.

    A mode that hardly moves one signal may stand out of another alone.
    """
    ringing = fault.kind == "tone" and fault.frequency is not None
    return ringing and machine.rings(runs, float(fault.frequency or 0.0))


def _verdict_despite_faults(
    verdict: str, faulty: Sequence[Fault], explanations: Sequence[Explanation], machine: Machine
) -> str:
    """The verdict where the recording has faults: names, if what tells them is in order.

    A tone beyond the band spoils nothing; samples that are lost do. An effect that is named
    may be what makes a loop ring.
    """
    lost = {f.signal for f in faulty if f.kind == "repeats"}
    spoilt = {p.name for p in machine.ports if lost & set(p.needs)}
    if not explanations or any(spoilt & set(f.candidate.ports) for f in explanations):
        return UNKNOWN
    return MORE if verdict in NAMING_VERDICTS and not all(f.shared for f in faulty) else verdict


def _remaining_share(gaps: Sequence[Gap]) -> float:
    """Return the part of the gap above noise that is left, all channels together."""
    before, after = (
        sum(max(getattr(g, side) ** 2 - 1, 0.0) for g in gaps) for side in ("before", "after")
    )
    return after / before if before else 0.0


def added(diagnosis: Diagnosis) -> tuple[Any, ...]:
    """Return the effects that a better description has; the course of a drift becomes its size.

    Where there is no name, the best that the library can do is not added; a torque that holds
    on the runs held back is, as `joint/unknown`.
    """
    if diagnosis.unnamed is not None:
        return diagnosis.unnamed.effects
    if diagnosis.verdict not in NAMING_VERDICTS:
        return ()
    return tuple(
        e.effect if isinstance(e, SlowPath) else e
        for e in split(diagnosis.selection.fit.effects)
    )


def plain(diagnosis: Diagnosis) -> dict[str, Any]:
    """Return the diagnosis as data for JSON; a number that is not known is None."""
    ranking = ranked(
        diagnosis.signatures,
        diagnosis.selection.null,
        diagnosis.selection.law,
        [f.candidate.name for f in diagnosis.explanations],
    )
    compared = ranking[:_COMPARED]
    names = [r.candidate.name for r in compared]
    alike = likeness(diagnosis.signatures, [r.index for r in compared])
    tried = experiments(
        diagnosis.signatures,
        diagnosis.selection,
        diagnosis.limits.alike,
        list(diagnosis.untestable),
    )
    effects = [_explanation_to_plain(f) for f in diagnosis.explanations]
    withheld = [_explanation_to_plain(f) for f in diagnosis.withheld]
    unknown = diagnosis.verdict == UNKNOWN
    return {
        "verdict": diagnosis.verdict,
        "sentence": diagnosis.sentence,
        "effects": [] if unknown else effects,
        "closest": effects if unknown else [],  # the best the library can do: no names
        "withheld": withheld,
        "ranking": [_ranked_to_plain(r, diagnosis) for r in ranking],
        "likeness": {
            "names": names,
            "matrix": alike.tolist(),
            "classes": classes(names, alike),
        },
        "experiments": [_experiment_to_plain(e) for e in tried],
        "where": _residual_map(diagnosis),
        "when": residual_over_time(
            diagnosis.residuals,
            diagnosis.selection.null,
            None if unknown else diagnosis.selection.fit,
        ),
        "null": _null_to_plain(diagnosis),
        "hypotheses": diagnosis.beliefs,
        "unknown": [] if diagnosis.unnamed is None else list(map(to_plain, diagnosis.effects)),
        "tolerances": diagnosis.tolerances,
        "off": [dataclasses.asdict(e) for e in diagnosis.off],
        "remaining": diagnosis.remaining,
        "remaining_allowed": diagnosis.limits.remains,
        "gap_before": {f"{g.port}/{g.channel}": g.before for g in diagnosis.gaps},
        "gap_after": {f"{g.port}/{g.channel}": g.after for g in diagnosis.gaps},
        "gap_intervals": _intervals(diagnosis.gaps),
        "final_intervals": _intervals(diagnosis.final),
        "worse": [
            f"{g.port}/{g.channel}" for g in diagnosis.final or diagnosis.gaps if g.worse
        ],
        "final_before": {f"{g.port}/{g.channel}": g.before for g in diagnosis.final},
        "final_after": {f"{g.port}/{g.channel}": g.after for g in diagnosis.final},
        "untestable": {
            port: [_LOGGED.get(k, k) for k in lacks]
            for port, lacks in diagnosis.untestable.items()
        },
        "depends": [
            {**dataclasses.asdict(d), "sentence": d.sentence} for d in diagnosis.depends
        ],
        "weak": list(diagnosis.weak),
        "faults": [{**dataclasses.asdict(f), "sentence": f.sentence} for f in diagnosis.faults],
        "steps": diagnosis.selection.steps,
        "seconds": diagnosis.seconds,
    }


def _null_to_plain(diagnosis: Diagnosis) -> dict[str, Any]:
    """Best of the library, and the chance that noise alone makes as much of it."""
    first, law = diagnosis.selection.first, diagnosis.selection.law
    name, gain = ("", 0.0) if first is None else (first[0].name, first[1])
    tried = f"{law.tests} candidates and shapes looked at"
    return {
        "p": diagnosis.chance,
        "best": name,
        "gain": gain,
        "looked_at": law.tests,
        "sentence": f"Of the library {name or 'nothing'} gains most, {gain:.3g} in deviance:"
        f" the chance that the best of {tried} gains as much from noise is"
        f" {diagnosis.chance:.2g}.",
    }


def _intervals(gaps: Sequence[Gap]) -> dict[str, dict[str, tuple[float, float]]]:
    """95 % of each gap before, after, and of their ratio."""
    return {
        f"{g.port}/{g.channel}": {
            "before": g.before_interval,
            "after": g.after_interval,
            "ratio": g.ratio_interval,
        }
        for g in gaps
    }


def _explanation_to_plain(f: Explanation) -> dict[str, Any]:
    c = f.candidate
    return {
        "kind": c.kind,
        "slot": c.slot,
        "name": c.name,
        "value": dict(zip(c.names, f.values.tolist(), strict=True)),
        "std": dict(zip(c.names, map(_finite, f.std), strict=True)),
        "interval": dict(zip(c.names, _intervals_90(f), strict=True)),  # 90 %
        "unit": dict(zip(c.names, c.units, strict=True)),
        "gain": f.gain,
        "strain": f.strain,
        "reliability": f.reliability,
        "probability": f.probability,
        "class": [r.candidate.name for r in f.rivals],
    }


def _intervals_90(f: Explanation) -> list[tuple[float, float] | None]:
    """Return 90 % intervals within the bounds; None where a number has no finite deviation."""
    out: list[tuple[float, float] | None] = []
    for x, std, low, high in zip(
        f.values.tolist(), f.std.tolist(), f.candidate.low, f.candidate.high, strict=True
    ):
        finite = np.isfinite(std)
        out.append((max(low, x - WIDE * std), min(high, x + WIDE * std)) if finite else None)
    return out


def _finite(x: float) -> float | None:
    return float(x) if np.isfinite(x) else None


def _ranked_to_plain(r: RankedCandidate, diagnosis: Diagnosis) -> dict[str, Any]:
    every = [k for rivals in diagnosis.selection.rivals for k in rivals]
    return {
        "name": r.candidate.name,
        "value": dict(zip(r.candidate.names, r.values.tolist(), strict=True)),
        "unit": dict(zip(r.candidate.names, r.candidate.units, strict=True)),
        "screen": r.screen,
        "gain": r.gain,
        "gain_error": r.error,
        "p": r.chance,
        "probability": next((k.probability for k in every if k.candidate is r.candidate), None),
        "chosen": any(f.candidate is r.candidate for f in diagnosis.explanations),
    }


def _experiment_to_plain(e: Experiment) -> dict[str, Any]:
    return {
        "between": list(e.between),
        "sentence": e.sentence,
        "runs": [dataclasses.asdict(a) for a in e.runs],
        "ports": [dataclasses.asdict(a) for a in e.ports],
        "untested": list(e.untested),
    }


def _residual_map(diagnosis: Diagnosis) -> list[dict[str, Any]]:
    """Mean square of every group, in variances of noise, before and after."""
    ports = {p.name: p for p in diagnosis.residuals.ports}
    null = fit = diagnosis.selection.null.size
    if diagnosis.verdict != UNKNOWN:
        fit = diagnosis.selection.fit.size
    return [
        {
            "port": g.port,
            "channel": ports[g.port].channels[g.channel],
            "low": g.low,
            "high": g.high,
            "before": float(before),
            "after": float(after),
        }
        for g, before, after in zip(diagnosis.residuals.groups, null, fit, strict=True)
    ]
