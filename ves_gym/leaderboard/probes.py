"""Golden episodes and motions: what the evaluator of a problem's version computes, stored.

A probe is a small fixed experiment: a short episode under fixed actions, motions that no
planner made, gains that no tuner found, answers that nobody gave. `golden/*.json` holds the
results of the present versions. An evaluator that computes others is not that version,
whatever its sources look like; one that computes the same is, though every file were edited.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np

from ves_gym._util.params import Array, ParameterError, to_plain
from ves_gym._util.threads import on_one_thread
from ves_gym.baselines.evaluate import evaluate
from ves_gym.envs.vector import VesVectorEnv
from ves_gym.leaderboard import lower_bounds, protocol
from ves_gym.leaderboard.errors import BundleError, Code
from ves_gym.leaderboard.evaluators import version_of
from ves_gym.leaderboard.npy_io import pack
from ves_gym.leaderboard.protocol import PROTOCOL, Problem, seeds_of
from ves_gym.leaderboard.solutions import played_solution
from ves_gym.leaderboard.stored_results import golden, probe_names
from ves_gym.leaderboard.tracks.base import Method
from ves_gym.mechanics.limits import limit_ratios
from ves_gym.mechanics.motion import Motion
from ves_gym.planners import execution_check

Plain = dict[str, Any]
Measure = Callable[[], Plain]

# Permitted between a stored number and one measured, over the largest of its series. Between
# AVX-512, AVX2 and neither, rounding moves what is simulated by 2e-11 at most and predicted
# energies by 2e-10 (docs/decisions/0015): episodes are calm enough that it grows no further.
RELATIVE = 1e-9
# The same where the series itself is about zero: 1e-12 m, rad, J or N m is four decimal places
# below what any sensor of the machine resolves, and 1e4 times the rounding of numbers about 1.
ABSOLUTE = 1e-12

_SALT = "not a secret, for probes"  # shows how official seeds are derived
_FIRST_SEED = 19_940_000  # what `Rehearsed` counts from; the probes of rules hold the seeds
_STEPS = 48  # control periods of a short episode
_EVERY = 4  # of them observed
_EPISODES = 3  # whole ones: lively, calm, and pushed into a joint limit
_QUERIES = 3
_BUMPS = (0.0, 0.05, 0.4, 8.0)  # rad beside the straight line; the last breaks limits
_RELEASES = 2
_CASE = 11  # a machine without effects: no search for their size
_STRIDE = 100  # samples between those stored of a case


class Deviation(NamedTuple):
    """The largest difference between stored and measured results of one probe."""

    where: str  # place in the results, "" if none differs
    size: float  # over the largest of its series; infinite where the kind or number differs
    permitted: bool


# ---------------------------------------------------------------------------- the probes


def probes_of(problem: Problem) -> dict[str, Measure]:
    """Return the probes of a problem by name; those of `stored_results.probe_names`."""
    full = Problem(problem.track, problem.base)
    id = full.environment
    experiments: dict[str, Measure] = {
        f"rules-{full.track}": lambda: rules(full),
        "queries": lambda: queries(full),
        "motions": lambda: motions(full),
        "releases": lambda: releases(full),
        "answers": answers,
        "case": case,
        "effects": effects,
    }
    if id is not None:
        experiments["episode"] = lambda: episode(id)
        experiments[f"evaluation-{full.track}"] = lambda: evaluation(full)
        experiments["solved"] = lambda: {"rows": played_solution(full)}
    return {name: experiments[name.partition("/")[2]] for name in probe_names(full)}


def rules(problem: Problem) -> Plain:
    """Return what the rules of a problem say: counts, seeds, tolerances, limits."""
    name, unit = protocol.SCORES[problem.track]
    quick = Problem(problem.track, problem.name + protocol.QUICK)
    sealed = problem.base == "blind-sealed"
    public = None if sealed else seeds_of(problem, None)
    drawn = None if problem.base == "blind-development" else seeds_of(problem, _SALT)
    return {
        "protocol": PROTOCOL[problem.track],
        "score": [name, unit],
        "kinds": list(problem.kinds()),
        "count": problem.count,
        "count of the quick one": quick.count,
        # as text: a root has up to 128 bits
        "public root": None if public is None else str(public.root),
        "official root": None if drawn is None else str(drawn.root),
        "official mark": None if drawn is None else drawn.mark,
        "tolerances": _tolerances(problem),
        "most groups": protocol.MOST_GROUPS,
    }


def _tolerances(problem: Problem) -> Plain:
    """Return the tolerances that decide about answers to a problem."""
    out: Plain = {
        "relative": protocol.RELATIVE,
        "absolute": protocol.ABSOLUTE,
        "flipped": protocol.FLIPPED,
    }
    if problem.environment is not None:
        out |= {"action": protocol.ACTION, "ledger": protocol.LEDGER_EPISODES}
    elif problem.track == "paths":
        out |= {
            "planned": protocol.PLANNED,
            "ledger": protocol.LEDGER_PATHS,
            "ripple": execution_check.RIPPLE,
            "aim": execution_check.AIM,
        }
    elif problem.track == "damping":
        out |= {"planned": protocol.PLANNED}
    if problem.environment is None:
        out["planned share"] = protocol.PLANNED_SHARE
    return out


def pattern(step: int, width: int, scale: float = 1.0) -> Array:
    """Return an action (width,) of a fixed sequence, exact in binary: no sine of any library.

    Args:
        step: control period, from 0.
        width: numbers in an action.
        scale: a power of two.
    """
    index = 7 * (step // 6) + 3 * np.arange(width)
    out: Array = scale * (index % 11 - 5) / 8
    return out


def episode(id: str) -> Plain:
    """Return observations, rewards, terms and the end of a short episode under `pattern`."""
    env = gym.make(id)
    inside: Any = env.unwrapped
    task, batch = inside.task, inside.batch
    observation, _ = env.reset(seed=19)
    out: Plain = {
        "scales": [field.scale.tolist() for field in task.fields()],
        "control period": task.system.control_dt,
        "periods": task.steps,
        "tail": task.tail,
        "goal": bool(inside.goal),
        "observed": [],
        "reward": [],
        "terms": [],
        "ended": [],
    }
    scale = np.concatenate([field.scale for field in task.fields()])
    faithful = True
    for step in range(_STEPS):
        if step % _EVERY == 0:
            # before it is rounded to single precision, of which 1e-9 cannot be asked
            exact = np.concatenate(task.observe(batch.scene), axis=1)[0]
            out["observed"].append(exact.tolist())
            if isinstance(observation, dict):
                observation = np.concatenate([observation[k] for k in sorted(observation)])
            observed = np.sort(observation)
            clipped = np.sort(np.clip(exact / scale, -task.CLIP, task.CLIP))
            faithful &= bool(np.abs(observed - clipped).max() < 1e-5)
        action = pattern(step, batch.width)
        observation, reward, terminated, truncated, info = env.step(action)
        out["reward"].append(float(reward))
        out["terms"].append([float(v) for k, v in info.items() if k.startswith("reward/")])
        out["ended"].append([bool(terminated), bool(truncated), bool(info["success"])])
        if terminated or truncated:
            break
    out["clipped"] = int(info["clipped"])
    out["shown as observed"] = faithful
    env.close()
    return out


class Rehearsed:
    """A controller that acts by `pattern`, episode by episode livelier, calmer and harder."""

    name = "rehearsed"
    privileged = False

    def reset(self, env: VesVectorEnv, ids: Any) -> None:
        """See `Controller`."""

    def act(self, env: VesVectorEnv, observation: Any) -> Array:
        """See `Controller`."""
        counters, width = env.batch.episodes, env.batch.width
        rows = []
        for step, root in zip(counters.steps.tolist(), counters.root.tolist(), strict=True):
            kind = (root - _FIRST_SEED) % _EPISODES
            if kind == 2:  # one way, until a joint is at its end
                rows.append(np.ones(width))
            else:
                rows.append(pattern(step, width, 0.125 if kind else 0.5))
        return np.stack(rows)


@dataclass(frozen=True)
class Excerpt(Problem):
    """The first few questions of a problem."""

    first: int = _EPISODES

    @property
    def count(self) -> int:
        """Number of questions."""
        return self.first


def evaluation(problem: Problem) -> Plain:
    """Return the rows of the first public episodes, whole ones, as the track computes them."""
    from ves_gym.leaderboard.tracks.registry import get_track

    excerpt = Excerpt(problem.track, problem.name)
    track: Any = get_track(problem.track)
    seeds, method = seeds_of(problem, None), Method(kind="controller", name="rehearsed")
    answers = track.run(excerpt, seeds, [Rehearsed()], method, {})
    id = problem.environment
    assert id is not None
    measured = evaluate(Rehearsed(), id, episodes=_EPISODES, seed=seeds.root)
    return {
        "seeds": track.seed_list(excerpt, seeds),
        "rows": [_named(row) for row in answers.rows],
        "returns": [row["return"] for row in measured.rows],
    }


def queries(problem: Problem) -> Plain:
    """Return the first questions of a suite, its last one, and what no motion can undercut."""
    suite = _paths().queries(problem, seeds_of(problem, None))
    chosen = [*suite[:_QUERIES], suite[-1]]
    return {
        "number": len(suite),
        "names": [q.name for q in chosen],
        "ends": [[*q.start, *q.goal] for q in chosen],
        "durations": [q.duration for q in chosen],
        "speed limits": [list(q.v_max or ()) for q in chosen],
        "obstacles": _numbers([to_plain(q.surroundings) for q in chosen]),
        "lower bounds": [
            lower_bounds.path_floor(q.system, q.ends[0], q.ends[1], q.duration) for q in chosen
        ],
    }


def motions(problem: Problem) -> Plain:
    """Return energies, predictions and verdicts of fixed motions on the first questions."""
    from ves_gym.planners.prediction import predict
    from ves_gym.planners.query import first_violation

    excerpt = Excerpt(problem.track, problem.name, _QUERIES)
    track, seeds = _paths(), seeds_of(problem, None)
    asked_queries = track.queries(excerpt, seeds)
    every = [_beside(query, bump) for bump in _BUMPS for query in asked_queries]
    method = Method(kind="planner", name="fixed", seeds=tuple(range(len(_BUMPS))))
    claimed: list[Plain] = [{"length": len(m.control)} for m in every]
    data = pack(np.concatenate([np.array(m.control) for m in every]))
    rows = track.replay(excerpt, seeds, method, claimed, data)
    pairs = list(zip(asked_queries * len(_BUMPS), every, strict=True))
    return {
        "rows": [_named(row) for row in rows],
        # near the straight line: rounding moves predictions of wilder motions by up to 2e-10
        "predicted": [
            predict(q.system, m, q.servo).to_dict() for q, m in pairs[: 2 * len(asked_queries)]
        ],
        "inside the limits": [first_violation(q, m) is None for q, m in pairs],
        "shares of the limits": [
            {k: v.tolist() for k, v in limit_ratios(q.system.arm, m).items()} for q, m in pairs
        ],
    }


def releases(problem: Problem) -> Plain:
    """Return the rows of fixed gains, full matrices among them, on the first releases."""
    from ves_gym.damping.tuning import WIDE
    from ves_gym.leaderboard.tracks.registry import get_track
    from ves_gym.mechanics.servo import HIGH_GAINS, PPED_GAINS

    excerpt = Excerpt(problem.track, problem.name, _RELEASES)
    track: Any = get_track(problem.track)
    seeds = seeds_of(problem, None)
    high, soft = (
        np.stack([np.diag(k.kp), np.diag(k.kd)]).astype(float) for k in (HIGH_GAINS, PPED_GAINS)
    )
    diagonal = np.sqrt(np.diagonal(soft, axis1=1, axis2=2))
    across = 0.125 + 0.875 * np.eye(len(soft[0]))  # of the geometric mean of two joints' gains
    coupled = diagonal[:, :, None] * across * diagonal[:, None, :]
    gains = np.stack([k for k in (high, soft, coupled) for _ in range(_RELEASES)])
    method = Method(kind="gains", name="fixed", seeds=(0, 1, 2))
    claimed: list[Plain] = [{"length": 1}] * len(gains)
    rows = track.replay(excerpt, seeds, method, claimed, pack(gains))
    system = track.system(excerpt)
    return {
        "rows": [_named(row) for row in rows],
        "bounds": [*WIDE.K, *WIDE.B],
        "gains": gains[::_RELEASES].reshape(3, -1).tolist(),
        "lower bound": lower_bounds.strain_floor(system.ideal(), 25.0, 30.0),
    }


def answers() -> Plain:
    """Return which fixed answers to fixed truths count as right."""
    from ves_gym.diagnosis.benchmark.score import ScoredCase, is_correct
    from ves_gym.leaderboard.tracks.diagnosis import VERDICTS

    viscous = {"kind": "joint/viscous", "slot": "joint 2", "value": {"coefficient": 4.0}}
    other = {"kind": "joint/coulomb", "slot": "joint 2", "value": {"torque": 3.0}}
    moved = {**viscous, "slot": "joint 1"}
    truths = {
        category: {"index": 0, "category": category, "variant": "", "effects": [
            {**k, "wanted": 3.0, "reached": 3.0} for k in chosen]}
        for category, chosen in (
            ("null", []), ("single", [viscous]), ("pair", [viscous, other]),
            ("weak", [viscous]), ("outside", [{**viscous, "kind": "outside/packet_loss"}]),
        )
    }  # fmt: skip
    cases = {"none": [], "right": [viscous], "both": [viscous, other], "joint": [moved],
             "kind": [other]}  # fmt: skip
    out: Plain = {"verdicts": list(VERDICTS)}
    for category, label in truths.items():
        out[category] = {
            f"{verdict}, {name}": _judged(is_correct, ScoredCase(label, verdict, chosen, {}))
            for verdict in VERDICTS
            for name, chosen in cases.items()
        }
    return out


def _judged(judge: Callable[[Any], bool], answer: Any) -> bool | str:
    try:
        return bool(judge(answer))
    except (KeyError, ValueError, TypeError) as error:  # what it cannot judge is a result too
        return type(error).__name__


def case() -> Plain:
    """Return samples of a generated case of the blind benchmark, with its noise."""
    from ves_gym.diagnosis.benchmark.blind.cases import plan_of, root_seed

    root = root_seed("development")
    machine = _blind_runner().case(_CASE, root)
    return {
        "plan": [plan_of(_CASE, root).category, plan_of(_CASE, root).variant],
        "times": [t[:: 4 * _STRIDE].tolist() for t in machine.t],
        "samples": [record[::_STRIDE].tolist() for record in machine.records[:2]],
        "root mean squares": [
            np.sqrt(np.mean(record**2, axis=0)).tolist() for record in machine.records
        ],
    }


def effects() -> Plain:
    """Return how far each effect of the blind benchmark moves the record of one motion."""
    from ves_gym.diagnosis.benchmark.blind.cases import plan_of, root_seed
    from ves_gym.diagnosis.benchmark.blind.effects import TRUTHS, drawn
    from ves_gym.diagnosis.benchmark.blind.excitation import KINDS, draw
    from ves_gym.diagnosis.benchmark.blind.magnitude import gaps
    from ves_gym.diagnosis.benchmark.blind.simulate import SEARCH_STEP, silent

    runner, root = _blind_runner(), root_seed("development")
    motion = draw(KINDS[0], runner.limits, np.random.default_rng(3)).scaled(np.full(3, 0.5))
    quiet = [silent(runner.samples)]
    plain = runner.records(runner.nominal, [motion], quiet, SEARCH_STEP)
    out: Plain = {"plans": [list(plan_of(k, root).kinds) for k in range(40)], "moved": {}}
    for kind in TRUTHS:
        effect = drawn(kind, np.random.default_rng(5))[0]
        changed = effect.applied(runner.nominal)
        record = runner.records(changed, [motion], quiet, SEARCH_STEP)
        moved = gaps(record, plain)
        # one series: a channel that an effect does not reach moves by rounding alone
        out["moved"][kind] = np.nan_to_num(np.concatenate(list(moved.values()))).tolist()
    return out


@cache
def _blind_runner() -> Any:
    from ves_gym.diagnosis.benchmark.blind.cases import Runner
    from ves_gym.diagnosis.benchmark.blind.machine import controller, nominal

    return Runner(nominal().to_dict(), controller())


def _paths() -> Any:
    from ves_gym.leaderboard.tracks.paths import PathTrack

    return PathTrack()


def _beside(query: Any, bump: float) -> Motion:
    """Return the motion along the straight line, its middle moved aside by `bump` [rad]."""
    start, goal = query.ends
    control = np.array([start] * 3 + [(start + goal) / 2] * 3 + [goal] * 3)
    control[4] += bump * pattern(0, len(start))
    return Motion(duration=query.duration, control=tuple(map(tuple, control.tolist())))


def _numbers(plain: Any) -> list[float]:
    """Return the numbers of plain data in their order, whatever their names."""
    if isinstance(plain, (int, float)) and not isinstance(plain, bool):
        return [float(plain)]
    parts = plain.values() if isinstance(plain, dict) else plain
    return (
        [k for part in parts for k in _numbers(part)] if isinstance(plain, (dict, list)) else []
    )


def _named(row: Mapping[str, Any]) -> Plain:
    """Return what a replay computes of a row."""
    numbers = ("score", "E_mean", "E_peak", "E_res", "E_int")
    return {
        "id": row["id"],
        "seed": row["seed"],
        **{k: row.get(k) for k in ("success", "failed", "length", *numbers)},
    }


# --------------------------------------------------------------------------- comparison


def measure(problem: Problem, name: str) -> Plain:
    """Run a probe of a problem; the result is as JSON would give it back."""
    available = probes_of(problem)
    if name not in available:
        raise ParameterError(f"probe must be one of {', '.join(available)}, got {name!r}")
    # sums over more than one thread would end in other bits every time
    with on_one_thread(), np.errstate(all="ignore"):
        out: Plain = json.loads(json.dumps(available[name](), allow_nan=False))
    return out


def compare(stored: Any, measured: Any, where: str = "") -> Deviation:
    """Return the largest difference between two results of a probe.

    A list of numbers, or of lists of numbers of one length, is a series: each of its columns
    is compared over the column's largest size. Everything else must be equal.

    Args:
        stored: plain data of `golden`.
        measured: plain data of `measure`.
        where: place of the two, for the answer.
    """
    series = _array(stored)
    if series is not None:
        other = _array(measured)
        if other is None or other.shape != series.shape:
            return Deviation(where, math.inf, False)
        size = np.abs(series).max(axis=0) if series.size else np.zeros(1)
        gap = np.abs(other - series)
        excess = gap - ABSOLUTE - RELATIVE * size
        worst = float((gap / np.where(size > 0, size, 1.0)).max()) if gap.size else 0.0
        return Deviation(where if worst else "", worst, bool((excess <= 0).all()))
    if isinstance(stored, dict) and isinstance(measured, dict):
        if missing := sorted(stored.keys() ^ measured.keys()):
            return Deviation(f"{where}.{missing[0]}".lstrip("."), math.inf, False)
        pairs = [(f"{where}.{k}".lstrip("."), stored[k], measured[k]) for k in stored]
    elif isinstance(stored, list) and isinstance(measured, list):
        if len(stored) != len(measured):
            return Deviation(where, math.inf, False)
        pairs = [
            (f"{where}[{k}]", a, b)
            for k, (a, b) in enumerate(zip(stored, measured, strict=True))
        ]
    else:
        same = type(stored) is type(measured) and stored == measured
        return Deviation("" if same else where, 0.0 if same else math.inf, same)
    parts = [compare(a, b, place) for place, a, b in pairs]
    return max(parts, key=lambda d: (not d.permitted, d.size), default=Deviation("", 0.0, True))


def _array(value: Any) -> Array | None:
    """Return numbers as an array, None where they are no numbers or of several lengths."""
    if isinstance(value, bool) or not isinstance(value, (int, float, list)):
        return None
    if isinstance(value, int):
        return None  # counts are exact
    if isinstance(value, list):
        inner = [k for part in value for k in (part if isinstance(part, list) else [part])]
        if not inner or not all(isinstance(k, float) for k in inner):
            return None
        if len({len(k) if isinstance(k, list) else -1 for k in value}) != 1:
            return None
    return np.asarray(value, dtype=np.float64)


# ------------------------------------------------------------------------------ judgement


@cache
def _once(problem: Problem, name: str) -> Plain:
    return measure(problem, name)


def first_difference(problem: Problem) -> tuple[str, Deviation] | None:
    """Return the first probe of a problem that differs from what is stored, with its name.

    A probe runs once per process.
    """
    full = Problem(problem.track, problem.base)
    for name, stored in golden(full).items():
        try:
            deviation = compare(stored, _once(full, name))
        except Exception as error:  # code that cannot even run it is another evaluator
            why = f"{type(error).__name__}: {' '.join(str(error).split())[:120]}"
            return name, Deviation(why, math.inf, False)
        if not deviation.permitted:
            return name, deviation
    return None


def require_behaviour(problem: Problem) -> None:
    """Raise a BundleError (EVALUATOR_CHANGED) where the code is not the version it says.

    The probes of the problem run once per process.
    """
    difference = first_difference(problem)
    if difference is None:
        return
    name, deviation = difference
    size = f" by {deviation.size:.3g} of its size" if math.isfinite(deviation.size) else ""
    raise BundleError(
        Code.EVALUATOR_CHANGED,
        f"probe {name}: {deviation.where} differs{size} from version {version_of(problem)} of"
        f" {problem.base}",
    )
