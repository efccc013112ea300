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

from ves_gym._util.params import Array, ParameterError, to_plain, write_result
from ves_gym._util.views import Viewable
from ves_gym.diagnosis.constants import ALIKE, CLEAR, EXCESS, POWER, TEMPERATURE
from ves_gym.diagnosis.data.measured_run import MEASURED, Run, with_shared_colour
from ves_gym.diagnosis.data.quality import Fault, faults
from ves_gym.diagnosis.inference.cache import AnswerCache, CachedResiduals
from ves_gym.diagnosis.inference.candidates import Candidate
from ves_gym.diagnosis.inference.explanations import (
    RankedCandidate,
    classes,
    experiments,
    likeness,
    ranked,
    residual_over_time,
)
from ves_gym.diagnosis.inference.fit import Fit, fit, fit_residual
from ves_gym.diagnosis.inference.held_back import Gap as Gap
from ves_gym.diagnosis.inference.held_back import excess, gaps
from ves_gym.diagnosis.inference.hypotheses import Hypothesis, beliefs, table, with_excess
from ves_gym.diagnosis.inference.model_selection import (
    Rival,
    Selection,
    cost,
    pruned,
    select,
    without,
)
from ves_gym.diagnosis.inference.signatures import Signatures
from ves_gym.diagnosis.inference.slow_noise import slow_noise
from ves_gym.diagnosis.inference.tolerance_scale import (
    ToleranceExcess,
    errors_told,
    likeliest_scale,
    scale_price,
)
from ves_gym.diagnosis.inference.tolerance_scale import sentence as wider
from ves_gym.diagnosis.inference.whitened_residuals import Wander, WhitenedResiduals
from ves_gym.diagnosis.machines.base import Machine, untestable
from ves_gym.diagnosis.machines.causes import split
from ves_gym.diagnosis.machines.drift import SlowPath
from ves_gym.effects import BaseUnknown, JointMemory
from ves_gym.system.system import System

NOTHING, NAMED, ONE_OF = "nothing missing", "named", "one of"
MORE, UNKNOWN, WEAK = "named, more remains", "not in the library", "excitation too weak"
NAMING_VERDICTS = (NAMED, ONE_OF, MORE)  # verdicts that give names

# What any motion of a joint that is worth the name shows; where it does not, others may hide.
_BASIC = ("joint/coulomb", "joint/viscous", "joint/drive_gain", "joint/rotor_inertia")
_LOGGED = {"weight": "wg"}  # a run's own name of a signal -> that in the log
WIDE = 1.645  # standard deviations to either side of a 90 % interval
_COMPARED = 10  # candidates whose likeness is told

Progress = Callable[[float, str], None]


@dataclass(frozen=True)
class Explanation:
    """An effect that the data ask for, and the candidates that could stand in its place."""

    candidate: Candidate
    values: Array  # (k,)
    std: Array  # (k,)
    gain: float  # deviance that it explains beside the others
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
    remaining: float  # evidence for power beyond any noise stated that is left, see `excess`
    selection: Selection
    residuals: WhitenedResiduals
    signatures: Signatures
    table: tuple[Hypothesis, ...] = ()  # the most probable first
    seconds: dict[str, float] = field(default_factory=dict)
    tolerances: float = 1.0  # most probable size of the description's errors, in those stated

    @property
    def beliefs(self) -> dict[str, float]:
        """Probabilities of all sets of names; their sum is 1."""
        return beliefs(self.table)

    @property
    def unnamed(self) -> Fit | None:
        """The fit with laws that have no name, where the evidence asks for them."""
        first = self.table[0] if self.table else None
        return first.fit if first and first.fit is not first.named else None

    def __repr__(self) -> str:
        return f"<Diagnosis: {self.sentence}>"

    @property
    def effects(self) -> tuple[Any, ...]:
        """Effects that a better description has beside those described.

        The course of a drift becomes its size. Where there is no name, the best that the
        library can do is not added; a torque that holds on the runs held back is, as
        `joint/unknown`.
        """
        if self.verdict not in (*NAMING_VERDICTS, UNKNOWN):
            return ()
        effects = split((self.unnamed or self.selection.fit).effects)
        return tuple(e.effect if isinstance(e, SlowPath) else e for e in effects)

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
        return _to_plain(self)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write verdict and numbers as JSON; `system.save` writes the better description."""
        write_result(path, self.to_dict())

    @property
    def chance(self) -> float:
        """Chance that the best of all that was looked at gains as much from noise alone."""
        if (first := self.selection.first) is None:
            return 1.0
        return self.selection.law.chance(first[1] / TEMPERATURE, first[0])

    @property
    def off(self) -> tuple[ToleranceExcess, ...]:
        """Errors of the description that are larger than it says."""
        if self.tolerances == 1.0:
            return ()
        chosen = self.selection.fit if self.explanations else self.selection.null
        return errors_told(chosen, self.residuals, self.tolerances)

    @property
    def noise_unknown(self) -> tuple[str, ...]:
        """Measured signals of ports tested whose noise is estimated from what is compared."""
        r = self.residuals
        needed = {k for p in r.ports for k in set(p.needs) - set(p.exact)}
        stated = set(MEASURED).intersection(*(run.meta.get("noise_std", {}) for run in r.runs))
        return tuple(k for k in MEASURED if k in needed - stated)

    @property
    def sentence(self) -> str:
        """The verdict in one sentence, and how far off the description is."""
        return self._verdict_in_words + wider(self.tolerances, self.off)

    @property
    def _verdict_in_words(self) -> str:
        names = " and ".join(_named(f) for f in self.explanations)
        why = "".join(f"; {f.sentence}" for f in self.faults)
        if self.verdict == NOTHING:
            text = "Nothing is missing: description and data agree within noise and tolerances."
            if unknown := ", ".join(self.noise_unknown):
                text += (
                    f" The noise of {unknown} was estimated from these runs above the band,"
                    " where vibration counts as noise: record at rest and state it under"
                    " [noise] (mapping file, or --tolerances FILE)."
                )
            return text
        if self.verdict == WEAK:
            begin = "There is a disagreement" if self.explanations else "No disagreement"
            return (
                f"{begin}, but these runs cannot show {_abbreviated(self.weak)}: the excitation"
                " is too weak."
            )
        if self.verdict == UNKNOWN:
            on = "" if self.unnamed is None else _written(self.unnamed.candidates)
            return f"Something is missing, and it is not in the library{why}{on}."
        if self.verdict == MORE:
            return f"Missing: {names}; more remains that is not in the library{why}."
        return f"Missing: {names}."


def _named(explanation: Explanation) -> str:
    if len(explanation.kinds) > 1:
        names = ", ".join(dict.fromkeys(r.candidate.name for r in explanation.rivals))
        return f"one of {{{names}}}"
    c = explanation.candidate
    path = c.effect(explanation.values)
    if isinstance(path, SlowPath):
        return f"{c.name} (root mean square {path.size:.3g} {c.units[0]})"
    certain = TEMPERATURE**0.5 * np.abs(explanation.values) > CLEAR * explanation.std
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
    """Return the unnamed candidates in words."""
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
    most: int | None = None,
    progress: Progress = lambda done, what: None,
    seed: int = 0,
    cache: AnswerCache | None = None,
) -> Diagnosis:
    """Find the ports where machine and runs disagree, and name the effects that are missing.

    Args:
        machine: the description, as parts that each run alone on measured input.
        runs: to fit.
        final: runs held back; they are opened once, after the names are found.
        candidates: the library.
        most: names at most; None: as many as the evidence bears.
        progress: called with the fraction done and the stage.
        seed: of the noise draws.
        cache: answers of the machine on disk, so that an interrupted diagnosis resumes.

    Returns:
        The verdict, the effects that explain the gap, and all that it rests on.
    """
    clock = [time.perf_counter()]
    seconds: dict[str, float] = {}

    def lap(name: str) -> None:
        clock.append(time.perf_counter())
        seconds[name] = clock[-1] - clock[-2]

    progress(0.0, "residuals")
    runs, final = with_shared_colour(runs, runs), with_shared_colour(final, runs)
    residuals, slow = _located(machine, runs, seed, cache)
    lap("locate")
    signatures = Signatures(
        residuals, candidates, lambda done: progress(0.1 + 0.5 * done, "signatures")
    )
    lap("screen")
    naming = _named_within_tolerances(
        residuals, signatures, most, lambda text: progress(0.7, text)
    )
    lap("name")
    progress(0.9, "runs held back")
    last = None
    if final:
        last = WhitenedResiduals(machine, final, seed + 1, slow).with_tolerances(naming.scale)
    residuals, signatures = naming.residuals, naming.signatures
    rows = table(naming.selection, residuals, last, len(candidates))
    selection, best = _of_names(naming.selection, rows[0]), rows[0]
    explanations = tuple(
        _explanation(selection, i, residuals, rows) for i in range(len(selection.rivals))
    )
    # excess of the runs fitted that does not come again is noise
    judging = residuals if last is None else last
    remaining = excess(judging, fit_residual(judging, best.fit, last is None))
    faint = _faint(signatures, best.fit.size)
    faulty = tuple(f for f in faults(runs) if not _described(f, machine, runs))
    rows = with_excess(rows, remaining)
    verdict = _verdict(explanations, bool(rows[0].unnamed), faint)
    if faulty:
        verdict = _verdict_despite_faults(verdict, faulty, explanations, machine)
    fit = best.fit if verdict in (*NAMING_VERDICTS, UNKNOWN) else selection.null
    lap("verify")
    return Diagnosis(
        verdict=verdict,
        explanations=explanations,
        gaps=gaps(residuals, fit, selection.null),
        final=() if last is None else gaps(last, fit, selection.null, False),
        untestable=untestable(machine, runs),
        weak=tuple(c.name for c in faint),
        faults=faulty,
        remaining=remaining,
        selection=selection,
        residuals=residuals,
        signatures=signatures,
        table=tuple(rows),
        seconds=seconds,
        tolerances=naming.scale,
    )


def _located(
    machine: Machine, runs: Sequence[Run], seed: int, cache: AnswerCache | None
) -> tuple[WhitenedResiduals, Mapping[str, Wander]]:
    """Return residuals whitened by all of their noise, and what of it wanders."""

    def whitened(slow: Mapping[str, Wander]) -> WhitenedResiduals:
        if cache is None:
            return WhitenedResiduals(machine, runs, seed, slow)
        return CachedResiduals(machine, runs, seed, cache, slow)

    residuals = whitened({})
    slow = slow_noise(residuals)
    return (whitened(slow) if slow else residuals), slow


@dataclass(frozen=True)
class _Found:
    """Names under the more probable of two scales of the tolerances."""

    selection: Selection
    residuals: WhitenedResiduals
    signatures: Signatures
    scale: float = 1.0


def _named_within_tolerances(
    residuals: WhitenedResiduals,
    signatures: Signatures,
    most: int | None,
    report: Callable[[str], None],
) -> _Found:
    stated = _Found(select(residuals, signatures, most, report), residuals, signatures)
    scale = likeliest_scale(stated.selection.null, residuals)
    unnamed = excess(residuals, fit_residual(residuals, stated.selection.null, True))
    jitters = any(run.jitter for run in residuals.runs) and unnamed > EXCESS
    if not (stated.selection.fit.candidates or jitters) or scale == 1.0:
        return stated
    wide, library = residuals.with_tolerances(scale), len(signatures.candidates)
    named = stated.selection.fit
    price = scale_price(scale) + (wide.density - residuals.density) / TEMPERATURE
    # a search takes as long as the first: only where its names, or none, do better so
    alike = pruned(wide, fit(wide, named.candidates, named.values), library)
    least = min(cost(f, library) for f in (alike, fit(wide, (), ())))
    if least + price >= cost(named, library):
        return stated
    beside = signatures.with_tolerances(wide)
    other = _Found(select(wide, beside, most, report), wide, beside, scale)
    better = cost(other.selection.fit, library) + price < cost(named, library)
    return other if better else stated


def _of_names(selection: Selection, row: Hypothesis) -> Selection:
    """Return a selection less the names that the most probable hypothesis does without."""
    named = [i for i, c in enumerate(selection.fit.candidates) if c.name in row.names]
    rivals = tuple(selection.rivals[i] for i in named)
    return dataclasses.replace(selection, fit=row.named, rivals=rivals)


def _explanation(
    selection: Selection, i: int, residuals: WhitenedResiduals, rows: Sequence[Hypothesis]
) -> Explanation:
    rivals, fitted = selection.rivals[i], selection.fit
    candidate = fitted.candidates[i]
    near = tuple(r for r in rivals if r.cost - rivals[0].cost < ALIKE)
    of_kind = sum(r.probability for r in rivals if r.candidate.kind == candidate.kind)
    there = sum(r.probability for r in rows if candidate.name in r.names)
    gained = without(residuals, fitted, i).deviance - fitted.deviance
    std = TEMPERATURE**0.5 * fitted.std[i]
    return Explanation(candidate, fitted.values[i], std, gained, of_kind * there, near)


def _verdict(
    explanations: Sequence[Explanation], more: bool, faint: Sequence[Candidate]
) -> str:
    """Return the verdict on names and on what is missing beside them."""
    places = [c.slot for c in faint]  # several of one joint: it barely moves
    if any(places.count(f.candidate.slot) > 1 for f in explanations):
        return WEAK
    if not explanations:
        return UNKNOWN if more else WEAK if faint else NOTHING
    if more:
        return MORE
    return ONE_OF if any(len(f.kinds) > 1 for f in explanations) else NAMED


def _faint(signatures: Signatures, size: Array) -> list[Candidate]:
    """Return basic effects that these runs could not show at their usual size."""
    tested = {p.name for p in signatures.residuals.ports}
    return [
        c
        for i, c in enumerate(signatures.candidates)
        if c.kind in _BASIC
        and tested & set(c.ports)
        and max(signatures.visible(i), signatures.visible_above(i, size)) < POWER
    ]


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


def _to_plain(diagnosis: Diagnosis) -> dict[str, Any]:
    ranking = ranked(
        diagnosis.signatures,
        diagnosis.selection.null,
        diagnosis.selection.law,
        [f.candidate.name for f in diagnosis.explanations],
    )
    compared = ranking[:_COMPARED]
    names = [r.candidate.name for r in compared]
    alike = likeness(diagnosis.signatures, [r.index for r in compared])
    likened = {"names": names, "matrix": alike.tolist(), "classes": classes(names, alike)}
    tried = experiments(
        diagnosis.signatures, diagnosis.selection, ALIKE, list(diagnosis.untestable)
    )
    effects = [_explanation_to_plain(f) for f in diagnosis.explanations]
    unknown = diagnosis.verdict == UNKNOWN
    return {
        "verdict": diagnosis.verdict,
        "sentence": diagnosis.sentence,
        "effects": [] if unknown else effects,
        "closest": effects if unknown else [],  # the best the library can do: no names
        "ranking": [_ranked_to_plain(r, diagnosis) for r in ranking],
        "likeness": likened,
        "experiments": [{**dataclasses.asdict(e), "sentence": e.sentence} for e in tried],
        "where": _residual_map(diagnosis),
        "when": residual_over_time(
            diagnosis.residuals,
            diagnosis.selection.null,
            None if unknown else diagnosis.selection.fit,
        ),
        "null": _null_to_plain(diagnosis),
        "hypotheses": diagnosis.beliefs,
        "table": [_row_to_plain(row) for row in diagnosis.table],
        "unknown": [] if diagnosis.unnamed is None else list(map(to_plain, diagnosis.effects)),
        "tolerances": diagnosis.tolerances,
        "off": [dataclasses.asdict(e) for e in diagnosis.off],
        "remaining": diagnosis.remaining,
        "remaining_allowed": EXCESS,
        **_gaps_to_plain("gap", diagnosis.gaps),
        **_gaps_to_plain("final", diagnosis.final),
        "worse": [
            f"{g.port}/{g.channel}" for g in diagnosis.final or diagnosis.gaps if g.worse
        ],
        "untestable": {
            port: [_LOGGED.get(k, k) for k in lacks]
            for port, lacks in diagnosis.untestable.items()
        },
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


def _row_to_plain(row: Hypothesis) -> dict[str, Any]:
    """A row of the table; evidence is -2 log p."""
    out: dict[str, Any] = {"names": list(row.names), "unnamed": list(row.unnamed)}
    return out | {k: getattr(row, k) for k in ("fitted", "held_back", "probability")}


def _gaps_to_plain(of: str, gaps: Sequence[Gap]) -> dict[str, Any]:
    """Gap of every channel before and after, and 95 % of these and of their ratio."""
    named = {f"{g.port}/{g.channel}": g for g in gaps}
    parts = ("before", "after", "ratio")
    return {
        f"{of}_before": {k: g.before for k, g in named.items()},
        f"{of}_after": {k: g.after for k, g in named.items()},
        f"{of}_intervals": {
            k: {part: getattr(g, f"{part}_interval") for part in parts}
            for k, g in named.items()
        },
    }


def _explanation_to_plain(f: Explanation) -> dict[str, Any]:
    c = f.candidate
    return {
        "kind": c.kind,
        "slot": c.slot,
        "name": c.name,
        "value": dict(zip(c.names, f.values.tolist(), strict=True)),
        "std": dict(
            zip(c.names, (x if np.isfinite(x) else None for x in f.std.tolist()), strict=True)
        ),
        "interval": dict(zip(c.names, _intervals_90(f), strict=True)),  # 90 %
        "unit": dict(zip(c.names, c.units, strict=True)),
        "gain": f.gain,
        "probability": f.probability,
        "class": [r.candidate.name for r in f.rivals],
    }


def _intervals_90(f: Explanation) -> list[tuple[float, float] | None]:
    """Return 90 % intervals within the bounds; None where a number has no finite deviation."""
    low = np.maximum(f.candidate.low, f.values - WIDE * f.std).tolist()
    high = np.minimum(f.candidate.high, f.values + WIDE * f.std).tolist()
    ends = zip(low, high, np.isfinite(f.std), strict=True)
    return [(a, b) if finite else None for a, b, finite in ends]


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


def _residual_map(diagnosis: Diagnosis) -> list[dict[str, Any]]:
    """Mean square of every group, in variances of noise, before and after."""
    ports = {p.name: p for p in diagnosis.residuals.ports}
    null, fit = diagnosis.selection.null.size, diagnosis.selection.fit.size
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
