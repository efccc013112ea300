"""Bookkeeping of episodes: one text, run in NumPy and compiled (`envs/compiled.py`)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Any, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import Array, Index, Mask, ParameterError
from ves_gym.envs.task import Scene, Start, Task
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.system import System

AT_ONCE = 64  # beginnings: a call costs as much as ten of them
_LEAST = 1e-9  # of a goal's reward, that a failure always shows


@dataclass
class Episodes:
    """Counters and running sums of n episodes. Leading axis n."""

    root: npt.NDArray[np.uint64]  # seed of the sequence of episodes
    index: npt.NDArray[np.int64]  # which of that seed's simulations
    number: npt.NDArray[np.int64]  # which episode, from 0
    steps: npt.NDArray[np.int64]  # control periods so far
    clipped: npt.NDArray[np.int64]  # actions that were out of bounds
    once: Mask  # success at any time
    total: Array  # return so far
    cost: Array  # of the periods so far
    missing: Array  # (n, 2) `Task.missing` after the first period, and now
    sums: Array  # (n, 2) integrals of E and of the strain energy [J s]
    peaks: Array  # (n, 2) their peaks [J]

    def rows(self, ids: Index) -> Episodes:
        """A copy of some simulations, of (k,) indices."""
        return Episodes(**{f.name: getattr(self, f.name)[ids] for f in fields(self)})


class EpisodeBatch(Protocol):
    """n episodes in lockstep (`Batch`), for those that watch them."""

    n: int
    task: Task
    system: System
    sim: Simulator
    drawn: dict[str, Array]

    @property
    def scene(self) -> Scene: ...

    @property
    def episodes(self) -> Episodes: ...


class Verdict(NamedTuple):
    """Reward and verdict of a period."""

    terms: dict[str, Array]  # (n,) of the reward
    reward: Array  # (n,) their sum
    solved: Mask  # (n,)


def goal_width(task: Task) -> int:
    """Return the size of a task's goal; what `fields` and `start` give is checked.

    Raises:
        ParameterError: shapes or names that are not as `Task` says.
    """
    names = [f.name for f in task.fields()]
    _require(task, "number of different names of fields", len(set(names)), len(names))
    for f in task.fields():
        _require(task, f"dimensions of the scale of field {f.name}", np.ndim(f.scale), 1)
    start = task.start(np.zeros((2, task.draws)))
    _require(task, "answer of start", type(start), Start)
    _require(task, "q of start(u) for two episodes", np.shape(start.q), (2, task.system.arm.n))
    _require(task, "goal of start(u) for two episodes", np.shape(start.goal)[:-1], (2,))
    return int(np.shape(start.goal)[1])


def require_answers(task: Task, s: Scene, dt: float) -> None:
    """Refuse a task whose formulas give other shapes than `Task` says.

    Args:
        task: what the episodes ask.
        s: two simulations, written.
        dt: period [s].

    Raises:
        ParameterError: what the formula gave, and what was expected.
    """
    with np.errstate(all="ignore"):  # zeros are no scene
        s.energies = s.energies + 1.0  # costs are of something
        parts = task.observe(s)
        task.remember(s, dt)
        terms = task.costs(s, dt, np.zeros(2, bool))
        verdicts = {"success": task.success(s), "failed": task.failed(s)}
    _require(task, "number of arrays of observe", len(parts), len(task.fields()))
    for f, value in zip(task.fields(), parts, strict=True):
        where = f"shape of {f.name} in observe, of two simulations"
        _require(task, where, np.shape(value), (2, f.size))
    _require(task, "answer of costs", type(terms), dict)
    for name, value in terms.items():
        where = f"shape of {name!r} in costs, of two simulations"
        _require(task, where, np.shape(value), (2,))
        below = int((np.asarray(value) < 0).sum())
        _require(task, f"number of {name!r} in costs below 0", below, 0)
    for name, verdict in verdicts.items():
        got = np.shape(verdict), str(np.asarray(verdict).dtype)
        _require(task, f"shape and type of {name}, of two simulations", got, ((2,), "bool"))


def _require(task: Task, what: str, got: object, expected: object) -> None:
    if got != expected:
        plain = [k.__name__ if isinstance(k, type) else k for k in (expected, got)]
        raise ParameterError(f"task {task.kind}: {what} must be {plain[0]}, got {plain[1]}")


def bounded(e: Episodes, actions: Array) -> Array:
    """Return actions within their bounds, those outside counted.

    Args:
        e: of the episodes, written.
        actions: (n, width).
    """
    e.clipped += (np.abs(actions) > 1.0).any(axis=1)
    return np.clip(actions, -1.0, 1.0)


def count(task: Task, s: Scene, e: Episodes, before: Array, dt: float) -> None:
    """Bring memory and sums up to date at the end of a period.

    Args:
        task: what the episodes ask.
        s, e: written.
        before: (n, 2) energies at the period's start [J].
        dt: period [s].
    """
    e.steps += 1
    task.remember(s, dt)
    e.sums += (before + s.energies) * (dt / 2)
    np.maximum(e.peaks, s.energies, out=e.peaks)


def endings(task: Task, s: Scene, e: Episodes, lost: Mask, over: Mask) -> tuple[Mask, Mask]:
    """Episodes (n,) that are at their deadline, and those that fail now.

    Args:
        task, s, e: as in `count`.
        lost: (n,) failed whatever the task says.
        over: (n,) simulations that wait for their next episode.
    """
    last, failed = e.steps >= task.steps, lost | task.failed(s)
    return last & ~over, failed & ~over


def judge(
    task: Task,
    s: Scene,
    e: Episodes,
    dt: float,
    last: Mask,
    failed: Mask,
    over: Mask,
    diverged: Mask,
) -> Verdict:
    """Reward and success of a period.

    J is what an episode has cost (`Task.costs`) and what is missing now (`Task.missing`).
    Where it ends it has been paid

        solved 1 / (1 + J), unsolved -J / (1 + J), failed -1:

    less cost is more return, any solved episode returns more than any that is not, and no end
    before the deadline is worth more than going on. Before, it has been paid what it would be
    if it ended now, but that what was missing at first is taken off evenly over the episode: a
    potential, which shows a learner at once what a step is worth and leaves what is best as it
    was (Ng, Harada & Russell 1999). Of goal variants, whose reward is that of their goals, a
    period costs what `costs` says, and a failure as much as reaching nothing.

    Args:
        task, s, e, dt: as in `count`.
        last, failed, over: (n,) of `endings`.
        diverged: (n,) simulations whose numbers may be none.
    """
    solved = task.success(s) & ~failed & ~over
    costs = task.costs(s, dt, last & ~failed)
    for name, cost in costs.items():
        costs[name] = np.where(over | _meaningless(cost, diverged), 0.0, cost)
    if task.goal_fields is None:
        terms = _payments(task, s, e, costs, solved, diverged)
        terms = {name: np.where(over, 0.0, paid) for name, paid in terms.items()}
        paid = e.total + sum(terms.values())
        terms["failure"] = np.where(failed, -1.0 - paid, 0.0)
    else:
        terms = {name: -cost for name, cost in costs.items()}
        lost = task.steps + _LEAST + e.total - sum(costs.values())
        terms["failure"] = np.where(failed, -lost, 0.0)
    first, *others = terms.values()
    reward = sum(others, start=first)  # in the order of the terms
    e.once |= solved
    e.total += reward
    return Verdict(terms, reward, solved)


def _payments(
    task: Task, s: Scene, e: Episodes, costs: dict[str, Array], solved: Mask, diverged: Mask
) -> dict[str, Array]:
    """Terms (n,) of the reward but for failure; brings cost and missing up to date.

    Args:
        costs: (n,) of the period, by name.
        task, s, e, solved, diverged: as in `judge`.
    """
    missing, before = task.missing(s), _paid(task, e, e.steps - 1)
    if missing is not None:
        missing = np.where(_meaningless(missing, diverged), e.missing[:, 1], missing)
        first = np.where(e.steps == 1, missing, e.missing[:, 0])
        e.missing = np.stack([first, missing], axis=1)
    approached, spent = _paid(task, e, e.steps), sum(costs.values())
    J = e.cost + e.missing[:, 1]
    share = 1.0 / ((1.0 + J) * (1.0 + J + spent))
    terms = {name: -cost * share for name, cost in costs.items()}
    if missing is not None:
        terms["missing"] = approached - before
    was = np.where(e.total - before > 0.5, 1.0, 0.0)  # solved in the period before
    terms["success"] = np.where(solved, 1.0, 0.0) - was
    e.cost = e.cost + spent
    return terms


def _paid(task: Task, e: Episodes, steps: Index) -> Array:
    """(n,) what episodes have been paid after a number (n,) of periods, success apart."""
    first, present = e.missing[:, 0], e.missing[:, 1]
    going = 1.0 - steps / task.steps
    return 1.0 / (1.0 + e.cost + present) - 1.0 + going * first / (1.0 + first)


def _meaningless(value: Array, diverged: Mask) -> Mask:
    return diverged & ~(np.abs(value) < np.inf)  # a NaN is not


def ended_energies(
    mean: Array, residual: Array, peak: Array, strain_peak: Array, strain: Array, ended: Mask
) -> dict[str, Any]:
    """Return energies (n,) of episodes that have ended as entries of an info.

    Args:
        mean: of E over episode and tail [J].
        residual: E at the end [J].
        peak, strain_peak: largest E and strain energy [J].
        strain: integral of the strain energy over episode and tail [J s].
        ended: (n,) their mask.
    """
    energies = {
        "E_mean": mean, "E_res": residual, "E_peak": peak, "E_strain_peak": strain_peak,
        "E_int": strain,
    }  # fmt: skip
    info: dict[str, Any] = {}
    for name, energy in energies.items():
        info[f"energy/{name}"], info[f"_energy/{name}"] = energy, ended
    return info


def scaled_observation(task: Task, s: Scene, scale: Array) -> Array:
    """(n, observations) in the fields' scales, clipped; what is not a number becomes 0.

    Args:
        task, s: whose.
        scale: (observations,) of all fields one after another.
    """
    values = np.concatenate(task.observe(s), axis=1) / scale
    values = np.minimum(np.maximum(values, -task.CLIP), task.CLIP)
    return np.where(np.abs(values) <= task.CLIP, values, 0.0)


class Beginnings:
    """Initial values of the simulations' following episodes.

    Random numbers are those of an episode's seed, index and number, so that it begins alike
    whatever else is drawn. Where one simulation ends after another, the beginnings of others
    are drawn together with its own.

    Args:
        task: what the episodes ask.
        n: number of simulations.
        extra: uniform numbers per episode beside the task's.
        complete: (k beginnings, of which simulations) -> all that is needed of them,
            (k, ...) by name.
    """

    def __init__(
        self,
        task: Task,
        n: int,
        extra: int,
        complete: Callable[[Start, Index], dict[str, Array]],
    ) -> None:
        self.task, self.n, self.complete = task, n, complete
        self.uniform = np.empty((n, task.draws + extra))
        self.generators: list[np.random.Generator | None] = [None] * n
        self._ready = np.zeros(n, bool)
        self._rows: dict[str, Array] = {}

    def forget(self, ids: Index) -> None:
        """Draw the next episodes of some simulations anew."""
        self._ready[ids] = False

    def take(
        self, ids: Index, e: Episodes, options: Mapping[str, Array] | None = None
    ) -> dict[str, Array]:
        """Return what the episodes (k,) begin with; it is theirs once.

        Args:
            ids: simulations, k of them.
            e: counters; `number` is that of the episode before.
            options: chosen instead of drawn, see `Task.start`.
        """
        if options:
            self._ready[ids] = False
            self._draw(ids, e)
            return self.complete(self._start(ids, options), ids)
        late = ids[~self._ready[ids]]
        if len(late):
            if e.number[late].min() >= 0 and len(late) < AT_ONCE:
                self._ready[ids] = True  # not to be drawn twice
                others = np.flatnonzero(~self._ready)[: AT_ONCE - len(late)]
                self._ready[late] = False
                late = np.concatenate([late, others])
            self._draw(late, e)
            rows = self.complete(self._start(late, {}), late)
            for name, values in rows.items():
                if name not in self._rows:
                    self._rows[name] = np.zeros((self.n, *values.shape[1:]), values.dtype)
                self._rows[name][late] = values
            self._ready[late] = True
        self._ready[ids] = False
        return {name: values[ids] for name, values in self._rows.items()}

    def _draw(self, ids: Index, e: Episodes) -> None:
        """Uniform numbers of the next episodes, and the generators that go on from there."""
        keys = np.stack([k[ids].astype(np.uint64) for k in (e.root, e.index, e.number + 1)], 1)
        # words are what NumPy makes of such numbers, more slowly
        words = keys.astype(np.uint32) if (keys < 2**32).all() else keys.tolist()
        for i, key in zip(ids.tolist(), words, strict=True):
            generator = np.random.Generator(np.random.PCG64(np.random.SeedSequence(key)))
            generator.random(out=self.uniform[i])
            self.generators[i] = generator

    def _start(self, ids: Index, options: Mapping[str, Array]) -> Start:
        return self.task.start(self.uniform[ids, : self.task.draws], **options)
