"""The next experiment: the motion within the machine's limits that holds rivals apart best.

Sequences of moves and rests, finite Fourier series (Swevers et al. 1997) and the motions at
hand are played in simulation by the machine that the diagnosis thinks most probable; those that
break a limit of joints or platform go. The others are ranked by the deviance that they are
expected to hold between the rivals (`inference/separation.py`), or by the information on what
the runs at hand could not show; the best are blended and bent, and at the end the winner is
played by every rival.
"""

from __future__ import annotations

import copy
import dataclasses
import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ves_gym._util.params import Array, ParameterError, to_plain
from ves_gym.diagnosis.constants import ALIKE, POWER
from ves_gym.diagnosis.data.measured_run import Run, run_of
from ves_gym.diagnosis.diagnose import NAMING_VERDICTS, NOTHING, WEAK, Diagnosis
from ves_gym.diagnosis.excitation import drawn_motion, drawn_series, within_limits
from ves_gym.diagnosis.inference.candidates import Candidate
from ves_gym.diagnosis.inference.separation import (
    LinearHypothesis,
    hypothesis,
    rival_hypotheses,
    separations,
    visibility,
)
from ves_gym.diagnosis.inference.whitened_residuals import WhitenedResiduals
from ves_gym.diagnosis.machines.drift import SlowPath
from ves_gym.diagnosis.machines.system import SystemMachine
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.servo import OWN_GAINS
from ves_gym.simulation.machines import Divergence
from ves_gym.simulation.playback import play_motions
from ves_gym.simulation.recording import Recording
from ves_gym.system.system import System

_SHORTEST, _LONGEST = 4.0, 20.0  # s
_MARGIN = 0.95  # of every limit, as simulated
_RIVALS = 4
_PARENTS, _CHILDREN = 3, 4
_BEND = 0.12  # rad, of a control point in a bent motion
_MOST_FAINT = 8


@dataclass(frozen=True, eq=False)
class NextMotion:
    """A motion to run on the machine, and what it is expected to show."""

    motion: Motion
    between: tuple[str, ...]  # rivals, the most probable first; or what could not be shown
    sigma: tuple[tuple[float, ...], ...]  # standard deviations between each two; or of each
    at_hand: float  # least that the best of the motions at hand is worth, run once more
    least: float  # least of this motion
    limits: dict[str, float]  # largest share of each limit, as simulated
    tried: int  # motions
    separates: bool  # rivals; else it shows what is faint

    @property
    def sentence(self) -> str:
        """The run to make, and the reason, in words."""
        m = f"a motion of {self.motion.duration:.3g} s within the limits"
        if not self.separates:
            return (
                f"{m} would show {', '.join(self.between)}, at their usual size, by"
                f" {self.least:.1f} standard deviations and more (the best of the motions at"
                f" hand, once more: {self.at_hand:.1f})."
            )
        decides = "decides" if self.least >= POWER else "helps to decide"
        return (
            f"{m} {decides} between {', '.join(self.between)}: any two answers are expected"
            f" {self.least:.1f} standard deviations apart and more after one run (after the"
            f" best of the motions at hand, once more: {self.at_hand:.1f})."
        )

    def table(self, dt: float) -> str:
        """Return the motion as CSV: time [s], angles [rad], rates [rad/s], every dt [s]."""
        s = self.motion.at(np.arange(math.ceil(self.motion.duration / dt - 1e-9) + 1) * dt)
        names = [f"{k}_{i + 1}" for k in ("q_cmd", "v_cmd") for i in range(self.motion.n)]
        rows = np.column_stack([s.t, s.q, s.v]).tolist()
        body = (",".join(f"{x:.9g}" for x in row) for row in rows)
        return "\n".join([",".join(["t", *names]), *body]) + "\n"

    def to_dict(self) -> dict[str, Any]:
        """Return plain data."""
        numbers = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}
        duration = numbers.pop("motion").duration
        return {**to_plain(numbers), "duration": duration, "sentence": self.sentence}


@dataclass(frozen=True, eq=False)
class _Played:
    """A motion as one machine would run it."""

    motion: Motion
    run: Run
    limits: dict[str, float]


@dataclass(frozen=True, eq=False)
class _Ranked:
    worth: float
    least: float
    played: _Played
    table: Array


def next_motion(
    diagnosis: Diagnosis,
    *,
    pool: int = 8,
    rounds: int = 2,
    seed: int = 0,
    progress: Callable[[float], None] = lambda done: None,
) -> NextMotion | None:
    """Design the motion that decides what a diagnosis leaves open.

    Args:
        diagnosis: of a `System`.
        pool: motions drawn of each family.
        rounds: of refinement.
        seed: of the draws.
        progress: called with the fraction done.

    Returns:
        The motion; None where nothing is open: no rivals, and nothing too weak.

    Raises:
        ParameterError: the machine is no `System`, or no motion keeps its limits.
    """
    search = _search_of(diagnosis)
    if search is None:
        return None
    rng = np.random.default_rng(seed)
    arm, duration = search.system.arm, search.duration
    hand = search.at_hand()
    drawn = [m(arm, duration, rng) for _ in range(pool) for m in (drawn_motion, drawn_series)]
    brisk = pool // 2 if search.faint else 0  # rivals are of what shows already
    drawn += [drawn_motion(arm, duration, rng, brisk=True) for _ in range(brisk)]
    total, done = len(hand) + len(drawn) + rounds * _CHILDREN + 1, itertools.count(1)

    def advance() -> None:
        progress(next(done) / total)

    repeated = search.ranked(hand, advance, strict=False)
    search.allow_again(repeated)
    options = [r for r in repeated if search.allowed(r.played)]
    options += search.ranked(drawn, advance)
    if not options:
        raise ParameterError(
            f"no motion of {duration:g} s keeps {_MARGIN:g} of the limits of the machine"
        )
    for _ in range(rounds):
        options.sort(key=lambda r: -r.worth)
        children = (_child(arm, options[:_PARENTS], rng) for _ in range(_CHILDREN))
        options += search.ranked([c for c in children if c is not None], advance)
    best = max(options, key=lambda r: r.worth)
    return search.result(best, repeated, len(options))


class _Search:
    """Plays candidates for the next motion and judges them."""

    def __init__(
        self,
        diagnosis: Diagnosis,
        rivals: Sequence[LinearHypothesis],
        faint: Sequence[Candidate],
        beside: Sequence[Candidate] = (),
    ) -> None:
        machine = diagnosis.residuals.machine
        if not isinstance(machine, SystemMachine):
            raise ParameterError(
                f"{machine.name} is no System: its next motion cannot be simulated"
            )
        self.rivals, self.faint, self.beside = rivals, faint, beside
        effects = [c for h in rivals for c in h.fit.candidates]
        ports = {p for c in (*effects, *faint, *beside) for p in c.ports}
        self.machine = copy.copy(machine)  # nothing shows at the other ports
        self.machine.ports = tuple(p for p in diagnosis.residuals.ports if p.name in ports)
        self.runs = diagnosis.residuals.runs
        self.system = machine.system
        spans = [(run.length - 1) * run.dt for run in self.runs]
        self.duration = float(np.clip(np.median(spans), _SHORTEST, _LONGEST))
        self._old = diagnosis.residuals
        self._most: dict[str, float] = {}  # share of a limit that is allowed, if not _MARGIN
        self._covered = self._reach([run.signals for run in self.runs])

    def at_hand(self) -> list[Motion]:
        """Return what the runs at hand were told, cut or held to the duration."""
        out = []
        for run in (r for r in self.runs if "q_cmd" in r):
            t = np.arange(run.length) * run.dt
            at = np.linspace(0.0, self.duration, round(40 * self.duration) + 1)
            q = np.stack([np.interp(at, t, x) for x in run["q_cmd"].T], axis=1)
            out.append(Motion.fit(q, self.duration, controls=round(8 * self.duration)))
        return out

    def ranked(
        self, motions: Sequence[Motion], advance: Callable[[], None], strict: bool = True
    ) -> list[_Ranked]:
        """Return motions as the most probable rival runs them, with what they are worth.

        Where `strict` those that break a limit are left out.
        """
        out = []
        for played in self.played(self.rivals[0], motions):
            if not strict or self.allowed(played):
                out.append(self._judged(played))
            advance()
        return out

    def allowed(self, played: _Played) -> bool:
        """Return True for a motion that keeps the limits."""
        return all(x <= self._most.get(k, _MARGIN) for k, x in played.limits.items())

    def allow_again(self, hand: Sequence[_Ranked]) -> None:
        """Let a motion come as close to a limit as every one at hand did.

        A drive that is weaker than said is at its limit in any motion.
        """
        for kind in hand[0].played.limits if hand else ():
            least = min(r.played.limits[kind] for r in hand)
            self._most[kind] = max(_MARGIN, least)

    def played(self, truth: LinearHypothesis, motions: Sequence[Motion]) -> list[_Played]:
        """Return the runs of a machine with a hypothesis in it; none of a safety stop."""
        model = self.machine.model(
            [e.effect if isinstance(e, SlowPath) else e for e in truth.fit.effects]
        )
        effects = tuple(e for e in model.system.effects if e.kind != "sensor/noise")
        system = model.system.replace(effects=effects)
        out = []
        for group in _lockstep(system, motions, self.runs[0]):
            stopped = {event.simulation for event in group[1].events}
            for i, motion in enumerate(group[0]):
                if i not in stopped:
                    run = self._run(group[1], i)
                    out.append(_Played(motion, run, _shares(system, group[1], i, run)))
        return out

    def _run(self, recording: Recording, i: int) -> Run:
        """Return a simulated run with the noise of those at hand."""
        like = self.runs[0]
        run = run_of(recording.log(i), "next", like.band)
        signals = {k: x for k, x in run.signals.items() if k in like.signals}
        meta = {**run.meta, **{k: like.meta[k] for k in ("controller",) if k in like.meta}}
        return dataclasses.replace(
            run, signals=signals, noise=like.noise, meta=meta, repeats={}
        )

    def _judged(self, played: _Played) -> _Ranked:
        new = WhitenedResiduals(self.machine, [played.run], self._old.seed, self._old.slow)
        if self.faint:
            every = (*self.faint, *self.beside)
            table = visibility(new, self.rivals[0], every)
            worth = float(np.linalg.slogdet(np.eye(len(table)) + table)[1])
            table = table[: len(self.faint), : len(self.faint)]
            farther = np.maximum(self._reach([played.run.signals]) / self._covered, 1.0)
            worth += 2 * float(np.log(farther).sum())  # of squares, as the information is
            sigma = np.sqrt(np.maximum(np.diag(table), 0.0))
            return _Ranked(worth, float(sigma.min()), played, sigma[None])
        table = np.maximum(separations(new, self.rivals), 0.0)
        pairs = ~np.eye(len(table), dtype=bool)
        worth = float(np.log1p(table[pairs]).mean())
        return _Ranked(worth, math.sqrt(table[pairs].min()), played, np.sqrt(table))

    def _reach(self, runs: Sequence[Mapping[str, Array]]) -> Array:
        """Return what is asked of each joint [N m], and of each leg of a platform [m].

        A limit shows in no motion that stays below it, whatever its size is thought to be.
        """
        n = self.system.arm.n
        most = [np.abs(np.reshape(s["tau"], (-1, n))).max(axis=0) for s in runs if "tau" in s]
        out = [np.max(most, axis=0)] if most else []
        commands = [np.reshape(s["y_cmd"], (-1, 6)) for s in runs if "y_cmd" in s]
        if self.system.mode == "emulated" and commands:
            stewart = self.system.emulator_settings.stewart
            lengths = stewart.leg_lengths(np.concatenate(commands))
            out.append(np.abs(lengths - stewart.home_lengths).max(axis=0))
        return np.maximum(np.concatenate([*out, np.zeros(0)]), 1e-9)

    def result(self, best: _Ranked, hand: Sequence[_Ranked], tried: int) -> NextMotion:
        """Return the best motion, played by every rival."""
        table, limits = best.table, dict(best.played.limits)
        for b, rival in enumerate(self.rivals[1:], 1):
            for played in self.played(rival, [best.played.motion]):
                table[b] = self._judged(played).table[b]
                limits = {k: max(x, played.limits[k]) for k, x in limits.items()}
        pairs = table[0] if self.faint else table[~np.eye(len(table), dtype=bool)]
        names = [c.name for c in self.faint] or [h.name for h in self.rivals]
        return NextMotion(
            motion=best.played.motion,
            between=tuple(names),
            sigma=tuple(tuple(row) for row in table.tolist()),
            at_hand=max((r.least for r in hand), default=0.0),
            least=float(pairs.min()),
            limits=limits,
            tried=tried,
            separates=not self.faint,
        )


def _search_of(diagnosis: Diagnosis) -> _Search | None:
    residuals, selection = diagnosis.residuals, diagnosis.selection
    if diagnosis.verdict == WEAK:
        every = [c for c in diagnosis.signatures.candidates if c.counts is None]
        faint = [c for c in every if c.name in diagnosis.weak][:_MOST_FAINT]
        beside = [c for c in every if c not in faint]  # may be missing, too, or taken for it
        return _Search(diagnosis, [hypothesis(residuals, selection.fit, "")], faint, beside)
    if diagnosis.verdict not in (NOTHING, *NAMING_VERDICTS):
        return None
    for place, explanation in enumerate(diagnosis.explanations):
        if len(explanation.kinds) > 1:
            rivals = rival_hypotheses(residuals, selection, place, ALIKE, _RIVALS)
            return _Search(diagnosis, rivals, ())
    return None


def _lockstep(
    system: System, motions: Sequence[Motion], like: Run
) -> list[tuple[Sequence[Motion], Recording]]:
    """Play motions together; one by one where one of them runs away, which then is left out."""
    if not motions:
        return []
    base = system.physics_dt if system.mode == "ideal" else system.control_dt
    step, servo = base * max(1, round(like.dt / base)), like.servo or OWN_GAINS
    try:
        recording = play_motions(system, motions, servo=servo, settle=0.0, record_dt=step)
    except Divergence:
        alone = [_lockstep(system, [m], like) for m in motions if len(motions) > 1]
        return [group for groups in alone for group in groups]
    return [(motions, recording)]


def _shares(system: System, recording: Recording, i: int, run: Run) -> dict[str, float]:
    """Return the largest share of every limit that a simulated run takes."""
    out = {e.kind: e.ratio for e in recording.limit_check(i).extremes}
    if system.mode == "emulated":
        lab, stewart = system.emulator_settings, system.emulator_settings.stewart
        out["stroke"] = SystemMachine(system).stretch([run])
        speed = np.abs(np.diff(stewart.leg_lengths(run["y_cmd"]), axis=0)).max() / run.dt
        out["leg speed"] = float(speed / stewart.speed_max)
        out["force"] = float(np.linalg.norm(run["w"][:, :3], axis=1).max() / lab.force_max)
        out["moment"] = float(np.linalg.norm(run["w"][:, 3:], axis=1).max() / lab.moment_max)
    return out


def _child(arm: Any, parents: Sequence[_Ranked], rng: np.random.Generator) -> Motion | None:
    """Return a blend of two motions, bent; None where it finds no place within the limits."""
    first, second = (parents[int(k)] for k in rng.integers(len(parents), size=2))
    motion, duration = first.played.motion, first.played.motion.duration
    t = np.linspace(0.0, duration, round(40 * duration) + 1)
    share = rng.uniform(0.0, 0.5)
    q = (1 - share) * motion.at(t).q + share * second.played.motion.at(t).q
    if rng.random() < 0.5:
        q = q.mean(axis=0) + (q - q.mean(axis=0)) * rng.uniform(0.8, 1.6, arm.n)
    bend = Motion.fit(
        np.concatenate(
            [np.zeros((1, arm.n)), rng.normal(0, _BEND, (round(duration) + 1, arm.n))]
        ),
        duration,
        controls=max(8, round(duration)),
    )
    try:
        return within_limits(arm, q + bend.at(t).q, duration)
    except ParameterError:
        return None
