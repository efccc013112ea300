"""Dependence of an unnamed residual: smooth curves over angle, speed, load and time compete.

A curve is twelve linear B-splines of one quantity, added to one channel of a port. Its
numbers are fitted on some runs, and it counts by what it explains on runs held back: a curve
through noise explains nothing there. No law of the library is asked, so what has no name still
gets a place and a cause to look for.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from ves_gym._util.params import Array
from ves_gym.diagnosis.data.measured_run import Run
from ves_gym.diagnosis.inference.fit import Fit, fit_residual
from ves_gym.diagnosis.inference.variance_groups import deviance
from ves_gym.diagnosis.inference.whitened_residuals import WhitenedResiduals
from ves_gym.diagnosis.machines.base import WRENCH, Port
from ves_gym.mechanics.spatial import AXES

_SPLINES, _DEGREE = 12, 1
_CHANNELS = 4  # with the most unexplained
_RIDGE = 1e-6
LEAST = 30.0  # deviance that a curve must explain on runs held back

Quantity = Callable[[Run], Array]


@dataclass(frozen=True)
class Dependence:
    """A curve over one quantity that explains part of a channel's residual."""

    port: str
    channel: str
    on: str  # the quantity
    gain: float  # deviance explained on the runs fitted
    held_back: float  # on those held back
    share: float  # of the channel's gap above noise that it removes there

    @property
    def sentence(self) -> str:
        """In words."""
        return (
            f"at port {self.port}, {self.channel}, it depends on the {self.on}, which explains"
            f" {100 * self.share:.0f} % of it on runs held back"
        )


def dependences(
    residuals: WhitenedResiduals, last: WhitenedResiduals, fit: Fit
) -> tuple[Dependence, ...]:
    """Return curves that explain what a fit leaves on runs held back, the best first.

    Args:
        residuals: of the runs fitted.
        last: of the runs held back.
        fit: whose residual is looked at.
    """
    remainders = [fit_residual(r, fit, r is residuals) for r in (residuals, last)]
    channels = [
        (port, i, _unexplained(residuals, port.name, i, remainders[0]))
        for port in residuals.ports
        for i in range(len(port.channels))
    ]
    channels.sort(key=lambda c: -c[2])
    curves = []
    for port, i, size in channels[:_CHANNELS]:
        if size > LEAST:
            for on, quantity in _quantities(residuals, port, i, (*residuals.runs, *last.runs)):
                curves.append(_curve((residuals, last), remainders, port, i, on, quantity))
    good = [d for d in curves if d.held_back > LEAST]
    return tuple(sorted(good, key=lambda d: -d.held_back))


def _quantities(
    residuals: WhitenedResiduals, port: Port, i: int, runs: Sequence[Run]
) -> Iterator[tuple[str, Quantity]]:
    """Yield what the residual of a channel may depend on, as far as all runs have it."""
    logged = {k for k in ("q", "tau", "y", "w") if all(k in run for run in runs)}
    width = runs[0]["q"].shape[-1] if "q" in logged else 0
    at_joints = set(port.channels).isdisjoint(AXES + WRENCH) and width == len(port.channels)
    if at_joints:
        yield f"angle of joint {i + 1}", lambda run: run.joints.x[:, i]
        yield f"speed of joint {i + 1}", lambda run: run.joints.v[:, i]
    machine = residuals.machine

    def as_described(signal: str) -> Quantity:  # what is measured contains what is unexplained
        def quantity(run: Run) -> Array:
            unexplained = machine.residuals(run, [machine.nominal], [port.name])[port.name][0]
            return np.asarray(run[signal][:, i] - unexplained[:, i])

        return quantity

    if at_joints and "tau" in logged:
        yield f"load of joint {i + 1}", as_described("tau")
    if port.channels in (AXES, WRENCH) and "y" in logged:
        yield f"pose coordinate {i + 1}", lambda run: run.base.x[:, i]
        yield f"rate of pose coordinate {i + 1}", lambda run: run.base.v[:, i]
    if port.channels == WRENCH and "w" in logged:
        yield f"load {port.channels[i]}", as_described("w")
    for j in range(0 if at_joints else width):
        yield f"angle of joint {j + 1}", lambda run, j=j: run.joints.x[:, j]  # type: ignore[misc]
    yield "time elapsed", lambda run: np.asarray(run.dt * np.arange(run.length), float)


def _curve(
    both: Sequence[WhitenedResiduals],
    remainders: Sequence[Array],
    port: Port,
    channel: int,
    on: str,
    quantity: Quantity,
) -> Dependence:
    """Fit a curve on the first runs and judge it by the second."""
    samples = np.concatenate([quantity(run) for run in both[0].runs])
    knots = np.quantile(samples, np.linspace(0, 1, _SPLINES - _DEGREE + 1))
    # what rests gives equal ones
    knots = knots + 1e-9 * np.ptp(samples) * np.arange(len(knots))
    ends = [knots[0]] * _DEGREE, [knots[-1]] * _DEGREE
    t = np.concatenate([ends[0], knots, ends[1]])
    x: Array = np.zeros(_SPLINES)
    gains, share = [], 0.0
    for r, z in zip(both, remainders, strict=True):
        columns = _columns(r, port, channel, quantity, t)
        start = r.part(port.name).start
        groups = [g for g in r.groups if (g.port, g.channel) == (port.name, channel)]
        rows = [slice(g.part.start - start, g.part.stop - start) for g in groups]
        n = np.array([g.n for g in groups], float)
        before = np.array([np.mean(z[g.part] ** 2) for g in groups])
        if r is both[0]:
            A = _RIDGE * np.eye(_SPLINES)
            b = np.zeros(_SPLINES)
            for g, row, size in zip(groups, rows, before, strict=True):
                A += columns[row].T @ columns[row] / max(size, 1.0)
                b -= columns[row].T @ z[g.part] / max(size, 1.0)
            x = np.asarray(np.linalg.solve(A + _RIDGE * np.diag(np.diag(A)), b), float)
        after = np.array(
            [
                np.mean((z[g.part] + columns[k] @ x) ** 2)
                for g, k in zip(groups, rows, strict=True)
            ]
        )
        gains.append(deviance(n, before) - deviance(n, after))
        gap = max(float(n @ before / n.sum()) - 1, 1e-9)
        share = 1 - max(float(n @ after / n.sum()) - 1, 0.0) / gap
    return Dependence(port.name, port.channels[channel], on, gains[0], gains[1], share)


def _columns(
    r: WhitenedResiduals, port: Port, channel: int, quantity: Quantity, t: Array
) -> Array:
    """Return (n, splines): what each spline in a channel adds to a port's whitened residual."""
    by_run = []
    for run in r.runs:
        x = np.clip(quantity(run), t[0], t[-1])
        basis = scipy.interpolate.BSpline.design_matrix(x, t, _DEGREE).toarray()
        out = np.zeros((_SPLINES, run.length, len(port.channels)))
        out[:, :, channel] = basis.T
        by_run.append(out)
    return r.whitened(port.name, by_run).T


def _unexplained(r: WhitenedResiduals, port: str, channel: int, z: Array) -> float:
    """Return the deviance above that of noise in a channel."""
    groups = [g for g in r.groups if (g.port, g.channel) == (port, channel)]
    return float(sum(g.n * np.log(max(float(np.mean(z[g.part] ** 2)), 1.0)) for g in groups))
