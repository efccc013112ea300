"""A name of a joint's law is earned if no curve explains clearly more on runs held back.

Whatever acts at a joint looks like some law of the library: a magnet that catches it like a
ripple, a cable like a ripple beside friction, a drive that gets warm like one that is weak. The
name says more than that: that the torque has the law's shape over angle, direction, rate and
time. So curves of no shape compete with it: splines of the joint's angle, of its angle times
the direction it turns, of its rate, and of the time elapsed times the torque that its motion
takes, all beside the names, which may be retuned. Their sizes are those of the largest marginal
likelihood on the runs fitted; what they explain is counted on the run held back, where free
numbers gain nothing by being many.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import scipy

from ves_gym._util.params import Array
from ves_gym.diagnosis.data.measured_run import Run
from ves_gym.diagnosis.inference.fit import Fit, fit_residual, linearised
from ves_gym.diagnosis.inference.held_back import likeliness, losses
from ves_gym.diagnosis.inference.model_selection import (
    Selection,
    reduced_fit,
    reduced_selection,
)
from ves_gym.diagnosis.inference.prior_sizes import likeliest_sizes
from ves_gym.diagnosis.inference.variance_groups import (
    InnerProducts,
    products,
    solve,
)
from ves_gym.diagnosis.inference.whitened_residuals import WhitenedResiduals
from ves_gym.diagnosis.machines.base import Machine

_ANGLE, _DIRECTION, _RATE, _TIME = 30, 12, 16, 6  # splines
_CREEP = 0.01  # rad/s over which a joint's direction changes
_SIZES = (
    0.0,
    0.03,
    0.1,
    0.3,
    1.0,
    3.0,
    10.0,
)  # of curves, a priori [N m]; of a share of torque
_ROUNDS = 2
LEAST = 20.0  # deviance that curves must explain beyond a name: exp(-10) by chance
BEYOND = 0.5  # of what the names of the joint explain there


def drop_beaten_by_splines(
    selection: Selection, residuals: WhitenedResiduals, last: WhitenedResiduals
) -> tuple[Selection, tuple[str, ...]]:
    """Return the selection less joint names that are not earned, and those names.

    If no name is left by that, the selection stays as it is: the best the library can do.

    Args:
        selection: found on the runs fitted.
        residuals: of those.
        last: of the runs held back.
    """
    poor = _unearned(selection.fit, residuals, last)
    names = tuple(selection.fit.candidates[i].name for i in poor)
    if len(poor) < len(selection.fit.candidates):
        for i in reversed(poor):
            step = f"{selection.fit.candidates[i].name}: not earned, curves explain more"
            selection = reduced_selection(residuals, selection, i, step)
    return selection, names


def _unearned(f: Fit, residuals: WhitenedResiduals, last: WhitenedResiduals) -> tuple[int, ...]:
    """Return places of names at joints where curves explain clearly more than they do."""
    system = getattr(residuals.machine, "system", None)
    if system is None or system.drive != "motor":
        return ()
    if "joint" not in {p.name for p in residuals.ports}:
        return ()
    poor: list[int] = []
    for joint in range(system.arm.n):
        slot = f"joint {joint + 1}"
        mine = [i for i, c in enumerate(f.candidates) if c.slot == slot and "joint" in c.ports]
        if not mine:
            continue
        named = losses(last, reduced_fit(residuals, f, mine), f)
        beyond = explained_beyond(f, joint, residuals, last)
        if beyond > max(LEAST, BEYOND * named):
            poor += mine
    return tuple(sorted(poor))


def explained_beyond(
    f: Fit, joint: int, residuals: WhitenedResiduals, last: WhitenedResiduals
) -> float:
    """Return the deviance of runs held back that curves at a joint explain beyond a fit.

    Args:
        f: of the runs fitted.
        joint: from 0.
        residuals: of the runs fitted.
        last: of the runs held back.
    """
    curves = _Curves(residuals, joint)
    parts, p = curves.columns(residuals), len(residuals.nuisances)
    inner = products(residuals, f.residual, np.hstack([*parts, f.tangents]))
    widths = [x.shape[1] for x in parts]
    x, freedom = np.zeros(0), f.size
    for _ in range(_ROUNDS):  # what curves explain gives more weight to its groups
        sizes = likeliest_sizes(inner, freedom, widths, p, _SIZES)
        if not any(sizes):
            return 0.0
        scale = np.concatenate([np.full(w, s) for w, s in zip(widths, sizes, strict=True)])
        every = np.concatenate([np.ones(p), scale, np.ones(f.tangents.shape[1])])
        solution = solve(_scaled(inner, every), p + len(scale) + len(f.forms))
        x, freedom = every * solution.x, solution.size
    z, tangents = linearised(last, f.candidates, f.values)
    moved = z + np.hstack([*curves.columns(last), tangents]) @ x[p:]
    before = fit_residual(last, f, False)
    after = last.less_nuisances(moved, x[:p], False)
    return likeliness(last, before) - likeliness(last, after)


class _Curves:
    """Splines of what a joint does, as torques at it; their knots are those of some runs.

    Args:
        residuals: of the runs whose range they cover.
        joint: from 0.
    """

    def __init__(self, residuals: WhitenedResiduals, joint: int) -> None:
        self._joint, runs = joint, residuals.runs
        self._angles, self._rates = (
            (min(float(x.min()) for x in samples), max(float(x.max()) for x in samples))
            for samples in (
                [run.joints.x[:, joint] for run in runs],
                [run.joints.v[:, joint] for run in runs],
            )
        )
        self._times = 0.0, max(run.dt * run.length for run in runs)

    def columns(self, r: WhitenedResiduals) -> list[Array]:
        """Return (N, n) of each kind of curve: what its splines add to whitened residuals."""
        by_run = [list(self._of(run, r.machine)) for run in r.runs]
        width = len(next(p for p in r.ports if p.name == "joint").channels)
        out = []
        for parts in zip(*by_run, strict=True):
            torques = []
            for x in parts:
                torque = np.zeros((x.shape[1], x.shape[0], width))
                torque[:, :, self._joint] = x.T
                torques.append(torque)
            column = np.zeros((r.length, parts[0].shape[1]))
            column[r.part("joint")] = r.whitened("joint", torques).T
            out.append(column)
        return out

    def _of(self, run: Run, machine: Machine) -> Iterator[Array]:
        """Yield (T, n) splines of each kind along a run."""
        # the torque logged has the noise of the residual, which it would explain
        unexplained = machine.residuals(run, [machine.nominal], ["joint"])["joint"][0]
        needed = (run["tau"] - unexplained)[:, [self._joint]]
        q, v = run.joints.x[:, self._joint], run.joints.v[:, self._joint]
        t = np.asarray(run.dt * np.arange(run.length), float)
        way = np.tanh(v / _CREEP)[:, None]
        yield _splines(q, self._angles, _ANGLE)
        yield way * _splines(q, self._angles, _DIRECTION)
        yield _splines(v, self._rates, _RATE)
        yield needed * _splines(t, self._times, _TIME)


def _splines(x: Array, ends: tuple[float, float], n: int) -> Array:
    """Return (T, n) linear B-splines over a range, level beyond its ends."""
    knots = np.linspace(ends[0], ends[1] + 1e-9, n)
    t = np.concatenate([knots[:1], knots, knots[-1:]])
    inside = np.clip(x, knots[0], knots[-1])
    return np.asarray(scipy.interpolate.BSpline.design_matrix(inside, t, 1).toarray(), float)


def _scaled(inner: InnerProducts, scale: Array) -> InnerProducts:
    """Return products of the columns times numbers."""
    square = np.outer(scale, scale)
    noise_xz, noise_xx = inner.noise_xz, inner.noise_xx
    return InnerProducts(
        inner.n,
        inner.zz,
        inner.xz * scale,
        inner.xx * square,
        inner.noise,
        None if noise_xz is None else noise_xz * scale,
        None if noise_xx is None else noise_xx * square,
        inner.most,
        inner.least,
    )
