"""Overlays of a diagnosis: residuals before and after, over time and frequency."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy

from ves_gym._util.params import Array
from ves_gym.diagnosis.inference.model_selection import Selection
from ves_gym.diagnosis.inference.whitened_residuals import VarianceGroup, WhitenedResiduals

_SHOWN = 2  # channels in overlays
_LOUD = 2.0  # mean square of a range of frequencies that is more than noise
_FILTER = 4  # order of the low-pass that overlays go through


def overlays(selection: Selection, residuals: WhitenedResiduals) -> list[dict[str, Any]]:
    """Return residuals of the channel whose gap falls most and, of the others, of that with the
    largest gap, each over the run that shows it most.

    Args:
        selection: the answer.
        residuals: that it was fitted to.

    Returns:
        Per channel: port, channel, unit, run; t [s], before, after: the residual under the
        description and the better one, up to `top` [Hz], where the gap is; f [Hz],
        noise_before, noise_after: its spectrum in standard deviations of noise, tolerances
        taken off.
    """
    null, fit = selection.null, selection.fit
    adjusted = [f.residual + residuals.slopes @ f.nuisances for f in (null, fit)]
    gap: dict[tuple[str, int], list[VarianceGroup]] = {}
    for group in residuals.groups:
        gap.setdefault((group.port, group.channel), []).append(group)

    def size(groups: list[VarianceGroup], z: Array) -> float:
        return float(np.mean(np.concatenate([z[g.part] for g in groups]) ** 2))

    largest = sorted(gap, key=lambda k: -size(gap[k], adjusted[0]))
    first = max(largest, key=lambda k: size(gap[k], adjusted[0]) - size(gap[k], adjusted[1]))
    channels = [first, *(k for k in largest if k != first)][:_SHOWN]

    models = [residuals.machine.nominal, residuals.machine.model(fit.effects)]
    out = []
    for name, channel in channels:
        groups = gap[name, channel]
        power_by_run = [
            sum(float(adjusted[0][g.runs[i]] @ adjusted[0][g.runs[i]]) for g in groups)
            for i in range(len(residuals.runs))
        ]
        i = int(np.argmax(power_by_run))
        run = residuals.runs[i]
        port = next(p for p in residuals.ports if p.name == name)
        x = residuals.machine.residuals(run, models, [name])[name][..., channel]
        loud = [g.high for g in groups if size([g], adjusted[0]) > _LOUD]
        top = max(loud, default=run.band)  # above it is nothing but noise, and much of it
        low = scipy.signal.butter(_FILTER, top, fs=1 / run.dt, output="sos")
        skip = run.window.skip
        inner = scipy.signal.sosfiltfilt(low, x, axis=-1)[:, skip : run.length - skip]
        t = (skip + np.arange(inner.shape[1])) * run.dt
        spectra = [np.concatenate([_power(z[g.runs[i]]) for g in groups]) for z in adjusted]
        out.append(
            {
                "port": name,
                "channel": port.channels[channel],
                "unit": port.units[channel],
                "run": run.name,
                "top": top,
                "t": t.tolist(),
                "before": inner[0].tolist(),
                "after": inner[1].tolist(),
                "f": run.window.frequencies[: len(spectra[0])].tolist(),
                "noise_before": np.sqrt(spectra[0]).tolist(),
                "noise_after": np.sqrt(spectra[1]).tolist(),
            }
        )
    return out


def _power(z: Array) -> Array:
    """(K,) mean square per frequency of numbers (2 K,): real parts, then imaginary ones."""
    return np.asarray((z.reshape(2, -1) ** 2).mean(axis=0))
