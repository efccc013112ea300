"""The grounds of a verdict, for people to check: the map of the gap, the candidates side by
side, those that these runs cannot distinguish, and the runs that separate them best.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from ves_gym._util.params import Array, Index
from ves_gym.diagnosis.constants import POWER, TEMPERATURE
from ves_gym.diagnosis.inference.candidates import Candidate
from ves_gym.diagnosis.inference.fit import Fit, evaluate_residuals, fit
from ves_gym.diagnosis.inference.intervals import stretches
from ves_gym.diagnosis.inference.model_selection import Selection
from ves_gym.diagnosis.inference.null_law import NullLaw
from ves_gym.diagnosis.inference.signatures import Signatures
from ves_gym.diagnosis.inference.variance_groups import products, solve
from ves_gym.diagnosis.inference.whitened_residuals import WhitenedResiduals

ALIKE = 0.95  # likeness above which two candidates are one class on these runs
_LEAST = 1.0  # gain in deviance below which a candidate is not worth a line


@dataclass(frozen=True)
class RankedCandidate:
    """A candidate alone on the residual of the description, with the numbers of its linear
    score."""

    index: int  # in the library
    candidate: Candidate
    values: Array  # (k,)
    screen: float | None  # gain in deviance by the linear score; None if too low to be scored
    gain: float  # by the model itself with these numbers
    error: float | None  # standard error of the gain, from run to run; None for a single run
    chance: float  # that the best of the library gains as much from noise


@dataclass(frozen=True)
class Separation:
    """Likeness and distance of two candidates in one run, or at one port."""

    where: str
    likeness: float  # 0 to 1: how well the second imitates the first
    sigma: float  # by which the first, at its usual size, stands out of the best imitation


@dataclass(frozen=True)
class Experiment:
    """Measurements that would distinguish two candidates."""

    between: tuple[str, str]
    runs: tuple[Separation, ...]
    ports: tuple[Separation, ...]
    untested: tuple[str, ...]  # ports at which only one of the two acts, which no log can show

    @property
    def sentence(self) -> str:
        """Advice: the run and port to measure at, and how often."""
        first, second = self.between
        best = max(self.runs, key=lambda a: a.sigma)
        port = max(self.ports, key=lambda a: a.sigma).where
        text = (
            f"{first} or {second}: of the runs at hand {best.where} tells them apart best, at"
            f" port {port} (likeness {best.likeness:.3f}: at its usual size the first stands"
            f" {best.sigma:.1f} standard deviations out of the best imitation by the second)"
        )
        if best.sigma >= POWER:
            text += "; record more runs like it."
        elif best.sigma > 0.1:
            needed = math.ceil((POWER / best.sigma) ** 2)
            text += f"; about {needed} such runs would make it {POWER:g}, or a stronger motion."
        else:
            text += "; no number of such runs will: another motion is needed."
        if self.untested:
            text += (
                f" Only one of them acts at port {', '.join(self.untested)}: log its signals."
            )
        return text


def ranked(
    signatures: Signatures,
    null: Fit,
    law: NullLaw,
    chosen: Sequence[str] = (),
    most: int = 12,
) -> list[RankedCandidate]:
    """Rank the candidates that score best alone, less the cost of their numbers.

    Args:
        signatures: of the library.
        null: fit of the description as it is.
        law: of the best gain of the library from noise.
        chosen: names to rank however they score.
        most: at the most this many others.
    """
    residuals = signatures.residuals
    scores = signatures.scores(null.residual, null.tangents, null.size)
    screened = [s for s in scores if np.isfinite(s.deviance)]
    price = float(np.log(residuals.size))
    screened.sort(key=lambda s: s.deviance + signatures.candidates[s.candidate].price * price)
    selected = [
        s
        for rank, s in enumerate(screened)
        if (rank < most and null.deviance - s.deviance > _LEAST)
        or signatures.candidates[s.candidate].name in chosen
    ]
    unscored = [s for s in scores if not np.isfinite(s.deviance)]
    selected += [s for s in unscored if signatures.candidates[s.candidate].name in chosen]
    none = np.zeros((residuals.length, 0))
    adjusted = null.residual + residuals.slopes @ null.nuisances
    base = _by_run(residuals, adjusted, null.size)
    out = []
    for s in selected:
        candidate = signatures.candidates[s.candidate]
        scored = bool(np.isfinite(s.deviance))
        values = s.values if scored else fit(residuals, [candidate], [s.values]).values[0]
        z = evaluate_residuals(residuals, [candidate], [[values]])[0]
        solution = solve(products(residuals, z, none), len(residuals.nuisances))
        gain = null.deviance - solution.deviance
        by_run = base - _by_run(residuals, z + residuals.slopes @ solution.x, solution.size)
        error = float(np.sqrt(len(by_run)) * by_run.std(ddof=1)) if len(by_run) > 1 else None
        out.append(
            RankedCandidate(
                index=s.candidate,
                candidate=candidate,
                values=values,
                screen=null.deviance - s.deviance if scored else None,
                gain=gain,
                error=error,
                chance=law.chance(gain / TEMPERATURE, candidate),
            )
        )
    return out


def _by_run(residuals: WhitenedResiduals, z: Array, size: Array) -> Array:
    """Return (R,) deviance of each run under the sizes (G,) of the groups."""
    out = np.zeros(len(residuals.runs))
    for group, v in zip(residuals.groups, np.maximum(size, 1.0), strict=True):
        for i, part in enumerate(group.runs):
            out[i] += (part.stop - part.start) * np.log(v) + z[part] @ z[part] / v
    return out


def likeness(signatures: Signatures, indices: Sequence[int]) -> Array:
    """Return how well the candidate of a column imitates that of a row.

    Args:
        signatures: of the library.
        indices: n candidates.

    Returns:
        (n, n), 0 to 1.
    """
    return np.array([[signatures.likeness(i, j) for j in indices] for i in indices]).reshape(
        2 * (len(indices),)
    )


def classes(names: Sequence[str], alike: Array) -> list[list[str]]:
    """Group names that these runs cannot distinguish: each imitates the other, or both a third.

    Args:
        names: n candidates.
        alike: (n, n) likeness.

    Returns:
        Classes of two members and more.
    """
    if not names:
        return []
    linked = np.minimum(alike, alike.T) > ALIKE
    count, label = scipy.sparse.csgraph.connected_components(linked, directed=False)
    every = [[n for n, k in zip(names, label, strict=True) if k == c] for c in range(count)]
    return [c for c in every if len(c) > 1]


def experiments(
    signatures: Signatures, selection: Selection, alike: float, untestable: Sequence[str]
) -> list[Experiment]:
    """Propose measurements that separate kinds which explain a gap equally well.

    Args:
        signatures: of the library.
        selection: the answer with its rivals.
        alike: difference in cost below which two candidates are one class.
        untestable: ports whose signals the logs lack.
    """
    residuals = signatures.residuals
    index = {c.name: i for i, c in enumerate(signatures.candidates)}
    runs = [
        (run.name, _within(signatures, np.r_[*(g.runs[i] for g in residuals.groups)]))
        for i, run in enumerate(residuals.runs)
    ]
    ports = [
        (p.name, _within(signatures, np.r_[residuals.part(p.name)])) for p in residuals.ports
    ]
    out = []
    for rivals in selection.rivals:
        first, kinds = rivals[0].candidate, {rivals[0].candidate.kind}
        for rival in rivals[1:]:
            second = rival.candidate
            if rival.cost - rivals[0].cost >= alike or second.kind in kinds:
                continue
            kinds.add(second.kind)
            i, j = index[first.name], index[second.name]
            only = set(first.ports) ^ set(second.ports)
            out.append(
                Experiment(
                    (first.name, second.name),
                    tuple(_separation(name, part, i, j) for name, part in runs),
                    tuple(_separation(name, part, i, j) for name, part in ports),
                    tuple(p for p in untestable if p in only),
                )
            )
    return out


def _within(signatures: Signatures, rows: Index) -> Signatures:
    """Return the signatures as some rows of the residuals alone would have them."""
    J = signatures.residuals.slopes[rows]
    S = signatures.columns[rows].astype(float)
    inside = J.T @ J + np.eye(J.shape[1])
    out = copy.copy(signatures)
    out.rows = rows
    out.inner = S.T @ S - S.T @ J @ np.linalg.solve(inside, J.T @ S)
    return out


def _separation(where: str, signatures: Signatures, i: int, j: int) -> Separation:
    alike = signatures.likeness(i, j)
    return Separation(where, alike, signatures.visible(i) * math.sqrt(1 - alike**2))


def residual_over_time(
    residuals: WhitenedResiduals, null: Fit, fit: Fit | None
) -> list[dict[str, Any]]:
    """Return the mean square of every channel of every run over the time elapsed.

    Args:
        residuals: that were fitted.
        null: fit of the description as it is.
        fit: of the better description; None where there is none.

    Returns:
        Per channel and run: port, channel, run; step [s] of the stretches; before, after: mean
        square in each, in variances of noise, tolerances taken off.
    """
    adjusted = [f.residual + residuals.slopes @ f.nuisances for f in (null, fit or null)]
    out = []
    for port in residuals.ports:
        for i, channel in enumerate(port.channels):
            groups = [g for g in residuals.groups if (g.port, g.channel) == (port.name, i)]
            before, after = (stretches(residuals, groups, z) for z in adjusted)
            for k, run in enumerate(residuals.runs):
                a, b = before[k], after[k]
                n = sum(g.runs[k].stop - g.runs[k].start for g in groups) / len(a)
                out.append(
                    {
                        "port": port.name,
                        "channel": channel,
                        "run": run.name,
                        "step": (run.length - 2 * run.window.skip) * run.dt / len(a),
                        "before": (a / n).tolist(),
                        "after": (b / n).tolist(),
                    }
                )
    return out
