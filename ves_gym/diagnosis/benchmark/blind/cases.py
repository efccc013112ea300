"""The 600 cases: which machine has which effect, and the six runs it is asked to make.

A case is a pure function of the set's secret and its index. Indices are shuffled by the
same secret, so that a case's number says nothing about what is in it.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from ves_gym._util.params import Array, ParameterError
from ves_gym.diagnosis.benchmark.blind import excitation
from ves_gym.diagnosis.benchmark.blind.description import leg_lengths
from ves_gym.diagnosis.benchmark.blind.effects import (
    LIBRARY,
    OUTSIDE,
    TRIES,
    TRUTHS,
    HiddenEffect,
    drawn,
)
from ves_gym.diagnosis.benchmark.blind.excitation import KINDS, ExcitationMotion
from ves_gym.diagnosis.benchmark.blind.magnitude import gap, search
from ves_gym.diagnosis.benchmark.blind.noise import converted, digital, draw_noise, stamps
from ves_gym.diagnosis.benchmark.blind.setup import (
    LARGE,
    MachineSetup,
    nominal_setup,
    with_nuisance,
)
from ves_gym.diagnosis.benchmark.blind.simulate import (
    SEARCH_STEP,
    NoiseSamples,
    samples_of,
    silent,
    simulate,
)

RUNS = 6
FINAL = 2  # of them, the last, held back
RATIOS = (1.5, 3.0, 10.0)
SEEDS = 4
# two and three library kinds that stand for one effect of the published table
SHARED = {
    "delay": ("command/delay", "joint/measurement_delay"),
    "damping": ("base/damping", "base/amplitude_damping"),
    "gravity": ("gravity/mass", "gravity/tilt", "gravity/scale"),
}
WEAK_KINDS = ("joint/viscous", "joint/coulomb", "joint/rotor_inertia", "joint/ripple")
BARELY = 5e-4  # of a motion's size, left to a joint that barely moves
RUNAWAY = 200.0  # gap over noise of effects that upset the loop
DEVELOPMENT = "development"


class CasePlan(NamedTuple):
    """A case before its machine is drawn."""

    category: str  # single, null, outside, pair or weak
    kinds: tuple[str, ...]
    ratios: tuple[float, ...]  # wanted gap over noise, one per effect
    variant: str = ""


class BlindCase(NamedTuple):
    """A machine and its runs, and the truth about it."""

    number: int  # its index in the set
    plan: CasePlan
    effects: tuple[HiddenEffect, ...]
    reached: tuple[float, ...]  # gap over noise of each effect alone
    t: list[Array]
    records: list[Array]
    motions: list[ExcitationMotion]


def table_effects() -> list[tuple[str, ...]]:
    """Return the 27 effects of the table; kinds that share one row take turns."""
    shared = {kind: group for group in SHARED.values() for kind in group}
    rows: list[tuple[str, ...]] = []
    for kind in LIBRARY:
        row = shared.get(kind, (kind,))
        if row not in rows:
            rows.append(row)
    return rows


@lru_cache(maxsize=1)
def mix() -> tuple[CasePlan, ...]:
    """Return all 600 plans in order: 324 single, 120 null, 60 outside, 84 pairs, 12 weak."""
    plans = []
    for row in table_effects():
        for k in range(len(RATIOS) * SEEDS):
            plans.append(CasePlan("single", (row[k % len(row)],), (RATIOS[k // SEEDS],)))
    plans += [CasePlan("null", (), (), "large" if k % 2 else "usual") for k in range(120)]
    for k in range(60):
        plans.append(CasePlan("outside", (OUTSIDE[k % 6],), (3.0 if k < 30 else 10.0,)))
    plans += _pairs(84)
    for k in range(12):
        plans.append(CasePlan("weak", (WEAK_KINDS[k % 4],), (3.0,)))
    return tuple(plans)


def _pairs(count: int) -> list[CasePlan]:
    """Return plans of two effects each; half of the pairs enter at the same port."""
    rng = np.random.default_rng(27)
    ports = {kind: TRUTHS[kind].port for kind in LIBRARY}
    chosen: set[frozenset[str]] = set()
    plans: list[CasePlan] = []
    while len(plans) < count:
        same = len(plans) % 2 == 0
        a, b = (str(k) for k in rng.choice(LIBRARY, 2, replace=False))
        if (ports[a] == ports[b]) != same or frozenset((a, b)) in chosen:
            continue
        if any({a, b} <= set(group) for group in SHARED.values()):
            continue
        chosen.add(frozenset((a, b)))
        ratios = tuple(float(r) for r in rng.choice((3.0, 10.0), 2))
        plans.append(CasePlan("pair", (a, b), ratios, "same port" if same else "two ports"))
    return plans


def root_seed(set_name: str, salt: str = "") -> int:
    """Return the 128-bit seed of a set.

    Args:
        set_name: the development set needs no salt, others are secret.
        salt: secret of a sealed set.

    Raises:
        ParameterError: a secret that is too short.
    """
    if set_name != DEVELOPMENT and len(salt) < 16:
        raise ParameterError(
            f"set {set_name!r} needs a secret salt of at least 16 characters, got {len(salt)}"
        )
    return int.from_bytes(hashlib.sha256(f"{set_name}\n{salt}".encode()).digest()[:16], "big")


def order_of(root: int) -> list[int]:
    """Return a set's shuffle: for every case the place of its plan in the mix."""
    order: list[int] = np.random.default_rng((root, 0)).permutation(len(mix())).tolist()
    return order


def plan_of(index: int, root: int) -> CasePlan:
    """Return the plan that a set's shuffle puts at an index.

    Raises:
        ParameterError: no such index.
    """
    plans = mix()
    if not 0 <= index < len(plans):
        raise ParameterError(f"case must be 0 to {len(plans) - 1}, got {index}")
    return plans[order_of(root)[index]]


class Runner:
    """Simulates one nominal machine, its drawn copies and their effects."""

    def __init__(self, description: dict[str, Any], controller: dict[str, Any]) -> None:
        self.description = description
        self.nominal = nominal_setup(description, controller)
        self.limits = excitation.limits_of(description["arm"])
        self.samples = samples_of(self.nominal.dt)

    def case(self, index: int, root: int) -> BlindCase:
        """Return a case of a set, the same every time.

        Args:
            index: of the case.
            root: seed of the set.
        """
        plan = plan_of(index, root)
        seeds = np.random.SeedSequence((root, 1 + index)).spawn(5)
        machine, choice, move, disturb, clock = map(np.random.default_rng, seeds)
        factor = LARGE if plan.variant == "large" else 1.0
        setup = with_nuisance(self.nominal, machine, factor)
        motions = self.motions(move)
        effects, reached = self.effects(plan, setup, motions[:-FINAL], choice, motions[-FINAL:])
        if plan.category == "weak":
            factors = np.ones(3)
            factors[effects[0].slot] = BARELY
            motions = [motion.scaled(factors) for motion in motions]
        broken = digital(setup)
        for effect in effects:
            broken = effect.applied(broken)
        share = sum(e.magnitude for e in effects if e.kind == "outside/packet_loss")
        noises = [draw_noise(self.samples, disturb, share) for _ in motions]
        records = [converted(r) for r in self.records(broken, motions, noises)]
        t = [stamps(self.samples, setup.dt, setup.clock, clock) for _ in motions]
        return BlindCase(index, plan, effects, reached, t, records, motions)

    def motions(self, rng: np.random.Generator) -> list[ExcitationMotion]:
        """Return six runs: every kind once in the first four, two more to hold back."""
        first = rng.permutation(KINDS).tolist()
        last = rng.choice(KINDS, FINAL, replace=False).tolist()
        return [self.safe_motion(kind, rng) for kind in first + last]

    def safe_motion(self, kind: str, rng: np.random.Generator) -> ExcitationMotion:
        """Return a motion during which the healthy platform stays inside its legs' range.

        Args:
            kind: of the menu.
            rng: of the motion.

        Raises:
            ParameterError: no size of the motion is safe.
        """
        stewart = self.description["emulator"]["stewart"]
        motion = excitation.draw(kind, self.limits, rng)
        for _ in range(6):
            record = self.records(
                self.nominal, [motion], [silent(self.samples)], step=SEARCH_STEP
            )[0]
            length = leg_lengths(stewart, record[:, 9:15])
            force = np.linalg.norm(record[:, 21:24], axis=1).max()
            moment = np.linalg.norm(record[:, 24:27], axis=1).max()
            speed = np.abs(np.diff(length, axis=0)).max() / self.nominal.dt
            inside = length.min() > stewart["length_min"] and (
                length.max() < stewart["length_max"]
            )
            lab = self.description["emulator"]
            if (
                inside
                and speed < 0.8 * stewart["speed_max"]
                and force < 0.8 * lab["force_max"]
                and moment < 0.8 * lab["moment_max"]
            ):
                return motion
            motion = motion.scaled(np.full(3, 0.7))
        raise ParameterError(f"excitation: no safe size of a {kind} motion")

    def records(
        self,
        setup: MachineSetup,
        motions: Sequence[ExcitationMotion],
        noises: Sequence[NoiseSamples],
        step: float | None = None,
    ) -> list[Array]:
        """Return the record of every run, drift drawn anew for each.

        Args:
            setup: machine.
            motions, noises: of each run.
            step: of the integration [s].
        """
        plant = setup.finished()
        out = []
        for k, (motion, noise) in enumerate(zip(motions, noises, strict=True)):
            way = (1.0, -0.8, 0.6, -1.3, 1.1, -0.7)[k % RUNS]
            run = plant._replace(creep=plant.creep * way)
            options = {} if step is None else {"step": step}
            out.append(simulate(run, setup.drive, motion, noise, setup.dt, **options))
        return out

    def effects(
        self,
        plan: CasePlan,
        setup: MachineSetup,
        motions: Sequence[ExcitationMotion],
        rng: np.random.Generator,
        held_back: Sequence[ExcitationMotion] = (),
    ) -> tuple[tuple[HiddenEffect, ...], tuple[float, ...]]:
        """Return the plan's effects, sized for the gaps planned, and the gaps they reach.

        Args:
            plan: kinds and gaps.
            setup: machine.
            motions: runs that are fitted; gaps are those of these.
            rng: of the effects.
            held_back: runs in which the loop must stay stable, too.
        """
        sized, reached = [], []
        every = [*motions, *held_back]
        if plan.kinds:
            quiet = [silent(self.samples) for _ in every]
            healthy = self.records(setup, every, quiet, SEARCH_STEP)
            plain = healthy[: len(motions)]
        for kind, target in zip(plan.kinds, plan.ratios, strict=True):
            best: tuple[float, HiddenEffect, float] | None = None
            for effect in drawn(kind, rng)[:TRIES]:
                drawing = int(rng.integers(2**63))

                def measure(m: float, e: HiddenEffect = effect, seed: int = drawing) -> float:
                    return self._gap(e._replace(magnitude=m), setup, motions, plain, seed)

                m, got = search(measure, target, effect.magnitude, effect.truth.most)
                miss = abs(np.log(max(got, 1e-9) / target))
                if best is None or miss < best[0]:
                    best = (miss, effect._replace(magnitude=m), got)
                if miss < 0.14:
                    break
            assert best is not None
            sized.append(best[1])
            reached.append(best[2])
        while sized and not self._stands(sized, setup, every, healthy):
            sized = [e._replace(magnitude=0.7 * e.magnitude) for e in sized]
            reached = [self._gap(e, setup, motions, plain, 0) for e in sized]
        return tuple(sized), tuple(reached)

    def _stands(
        self,
        effects: Sequence[HiddenEffect],
        setup: MachineSetup,
        motions: Sequence[ExcitationMotion],
        plain: Sequence[Array],
    ) -> bool:
        """Return True if the loop stays stable with all effects at once."""
        for effect in effects:
            setup = effect.applied(setup)
        quiet = [silent(self.samples) for _ in motions]
        return gap(self.records(setup, motions, quiet, SEARCH_STEP), plain) < RUNAWAY

    def _gap(
        self,
        effect: HiddenEffect,
        setup: MachineSetup,
        motions: Sequence[ExcitationMotion],
        plain: Sequence[Array],
        seed: int,
    ) -> float:
        share = effect.magnitude if effect.kind == "outside/packet_loss" else 0.0
        rng = np.random.default_rng(seed)
        noises = [
            silent(self.samples)._replace(lost=draw_noise(self.samples, rng, share).lost)
            if share
            else silent(self.samples)
            for _ in motions
        ]
        return gap(self.records(effect.applied(setup), motions, noises, SEARCH_STEP), plain)
