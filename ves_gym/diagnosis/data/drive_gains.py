"""Scales of motor forces that a log has in units of its own (ampere, per cent, drive counts).

The scale is what makes the logged signal carry the load that the model takes: friction of the
joint and an offset are fitted along, so the scale rests on weight and inertia alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ves_gym._util.params import Array, ParameterError
from ves_gym._util.signals import SensorNoiseModel
from ves_gym.diagnosis.data.measured_run import Run
from ves_gym.diagnosis.machines.mjcf import MjcfMachine
from ves_gym.effects.joint_friction import CREEP

_CLEAR = 5.0  # standard deviations of a scale that the data tell


def with_drive_gains(
    machine: MjcfMachine, runs: Sequence[Run], fitted: Sequence[int]
) -> tuple[list[Run], list[str]]:
    """Return runs with forces in N m (N), and what was found in words.

    Scales of joints with `gain_unknown` are looked for in the runs `fitted`.

    Raises:
        ParameterError: a joint whose load does not show in its signal, or no model.
    """
    unknown = [i for i, joint in enumerate(machine.joints) if joint.gain_unknown]
    if not unknown:
        return list(runs), []
    if machine.bodies is None or any("tau" not in run for run in runs):
        raise ParameterError("gain_unknown needs a model and forces in every run")
    gains, notes = np.ones(len(machine.joints)), []
    for i in unknown:
        gains[i], std = _gain(machine, [runs[k] for k in fitted], i)
        joint = machine.joints[i]
        notes.append(
            f"drive gain of {joint.name}: {gains[i]:.4g} +- {std:.2g}"
            f" {'N' if joint.type == 'slide' else 'N m'} per unit logged, found in the data"
        )
    return [_scaled(run, gains) for run in runs], notes


def _gain(machine: MjcfMachine, runs: Sequence[Run], i: int) -> tuple[float, float]:
    """Return the scale of joint i, force per unit logged, and its standard deviation."""
    rows, logged = [], []
    for run in runs:
        residual = machine.residuals(run, [machine.nominal], ["joint"])["joint"][0]
        load, v = (run["tau"] - residual)[:, i], run.joints.v[:, i]
        columns = [load, v, np.tanh(v / (CREEP * machine.joints[i].radius)), np.ones(len(v))]
        spectra = run.window.spectrum(np.stack([*columns, run["tau"][:, i]], axis=1))
        both = np.concatenate([spectra.real, spectra.imag])
        rows.append(both[:, :-1])
        logged.append(both[:, -1])
    X, y = np.concatenate(rows), np.concatenate(logged)
    size = np.maximum(np.linalg.norm(X, axis=0), 1e-300)
    slope = np.linalg.lstsq(X / size, y, rcond=None)[0] / size
    misfit = y - X @ slope
    inverse = np.linalg.pinv((X / size).T @ (X / size))
    std = float(np.sqrt(misfit @ misfit / max(len(y) - 4, 1) * inverse[0, 0])) / size[0]
    if not abs(slope[0]) > _CLEAR * std:
        raise ParameterError(
            f"the drive gain of {machine.joints[i].name} cannot be told from these runs: its"
            " load does not stand out of friction; state a gain, or move it under load"
        )
    return float(1 / slope[0]), float(std / slope[0] ** 2)


def _scaled(run: Run, gains: Array) -> Run:
    noise = run.noise["tau"]
    scaled = SensorNoiseModel(noise.std * np.abs(gains), noise.correlation)
    changed = run.with_signals({"tau": run["tau"] * gains})
    return replace(changed, noise={**run.noise, "tau": scaled})
