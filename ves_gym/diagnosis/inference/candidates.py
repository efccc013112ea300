"""The library of effects as a diagnosis reads it: what every registered kind declares.

`library` asks each effect for its candidates (`system/candidate.py`) and keeps those whose
ports are there. What no effect can say of itself is added here: the course that a drift takes
in every run, and friction that builds up over a distance.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from ves_gym._util.params import Array, ParameterError
from ves_gym._util.suggest import did_you_mean
from ves_gym.diagnosis.machines.causes import arm_friction, split
from ves_gym.diagnosis.machines.drift import WAVES, SlowPath
from ves_gym.diagnosis.machines.presliding import FORMS
from ves_gym.system.candidate import Candidate as Candidate
from ves_gym.system.candidate import Scope
from ves_gym.system.effect import EFFECTS, PORTS, Effect
from ves_gym.system.system import System

_FAR = 100.0  # N, N m: of each wave of a drift


def library(
    n: int,
    ports: Sequence[str],
    mode: str | None = None,
    runs: Sequence[str] = (),
    stretch: float = 0.25,
    system: System | None = None,
    travel: Sequence[float] = (),
) -> tuple[Candidate, ...]:
    """Return all candidates of a machine with n joints and these ports.

    Args:
        n: joints.
        ports: names.
        mode: of a `System`; effects that do not act in it are left out.
        runs: names of the runs, each of which a drifting sensor goes through in its own way.
        stretch: how far a leg of the platform is told to go in them, in parts of its stroke.
        system: the description, where it is one; effects that do nothing in it are left out.
        travel: (n,) that each joint covers in the runs [rad]; (): not known.
    """
    scope, out = Scope(n, system, stretch, tuple(travel)), []
    for cls in sorted(EFFECTS.values(), key=lambda e: (PORTS.index(e.port), e.kind)):
        if left_out(cls, scope, ports, mode, runs):
            continue
        for i, candidate in enumerate(cls.candidates(scope)):
            if not _acts_in(candidate, system):
                continue
            active = tuple(p for p in candidate.ports if p in ports)
            if mode == "ideal" and "base" in active and "wrench" in ports:
                active += ("wrench",)  # what the base says of its pose is taken off there
            if "servo" in active and "joint" in ports:
                active += ("joint",)  # what the controller asked tells the torque there
            candidate = dataclasses.replace(candidate, ports=active)
            if cls.wanders:
                candidate = _course(candidate, i, runs)
            if cls.builds_up:
                candidate = dataclasses.replace(candidate, blurs=(*cls.forms, *FORMS))
            out.append(candidate)
    if "joint" in ports:
        causes = arm_friction([f"joint {i + 1}" for i in range(n)], builds_up=True)
        out += [c for c in causes if _acts_in(c, system)]
    return tuple(out)


def left_out(
    cls: type[Effect],
    scope: Scope,
    ports: Sequence[str],
    mode: str | None = None,
    runs: Sequence[str] = (),
) -> str:
    """Return why a kind of effect has no candidate; "" where it has.

    Args:
        cls: effect.
        scope: the machine.
        ports: of the machine.
        mode: as of `library`.
        runs: as of `library`.
    """
    if cls.hidden:
        return cls.hidden
    if mode is not None and mode not in cls.modes:
        return f"it acts in mode {', '.join(cls.modes)}"
    try:
        offered = list(cls.candidates(scope))
        if scope.system is not None and not any(_acts_in(c, scope.system) for c in offered):
            for candidate in offered[:1]:
                candidate.effect(np.array(candidate.starts[0])).check(scope.system)
    except ParameterError as error:
        return str(error)
    if not any(p in ports for c in offered for p in c.ports):
        return f"it shows at port {', '.join(cls.shows or (cls.port,))}"
    return "" if runs or not cls.wanders else "it takes a course of its own in each run"


def _acts_in(candidate: Candidate, system: System | None) -> bool:
    """Return True if the description has what a candidate acts on, such as a rotor."""
    if system is None:
        return True
    try:
        for effect in split([candidate.effect(np.array(candidate.starts[0]))]):
            effect.check(system)
    except ParameterError:
        return False
    return True


def without(candidates: Sequence[Candidate], kinds: Sequence[str]) -> tuple[Candidate, ...]:
    """Return the library less some kinds of effect.

    Raises:
        ParameterError: a kind that is not in it.
    """
    available = {c.kind for c in candidates}
    for kind in kinds:
        if kind not in available:
            raise ParameterError(
                f"no candidate {kind!r}; known: {', '.join(sorted(available))}"
                f"{did_you_mean(kind, available)}"
            )
    return tuple(c for c in candidates if c.kind not in kinds)


def _course(candidate: Candidate, channel: int, runs: Sequence[str]) -> Candidate:
    """Return the drift of one signal: in each run a level and slow cosines of its own."""
    k = WAVES * len(runs)

    def path(x: Array) -> SlowPath:
        weights = np.reshape(x, (len(runs), WAVES)).tolist()
        by_run = tuple((r, tuple(w)) for r, w in zip(runs, weights, strict=True))
        return SlowPath(channel, by_run, candidate.kind)

    return dataclasses.replace(
        candidate,
        names=tuple(f"{r} {j}" for r in runs for j in range(WAVES)),
        units=candidate.units * k,
        starts=((1.0,) * k,),
        low=(-_FAR,) * k,
        high=(_FAR,) * k,
        make=path,
        factors=tuple(range(k)),
        counts=WAVES,  # all runs drift by one law
    )
