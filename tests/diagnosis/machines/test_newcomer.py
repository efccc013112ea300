"""A log of another engine, described by `diagnose --describe` with no number changed."""

import json

import mujoco
import numpy as np
import pytest

from tests.diagnosis.machines import rigid_arm
from ves_gym.cli.main import main

VISCOUS, COULOMB = 3.0, 0.4  # hidden: N m s/rad at the second joint, N m at the third
NOISE = (2e-5, 1e-3, 0.05)  # rad, rad/s, N m
STEP, EVERY = 5e-4, 8  # s; steps a row of the log
HEADER = "time_s;" + ";".join(
    f"j{i} {what}"
    for what in ("angle [rad]", "speed [rad/s]", "torque [Nm]")
    for i in (1, 2, 3)
)


def log_of_mujoco(seed, path, seconds=20.0):
    """Write a run under a PD law; MuJoCo's dry friction gives way a little before it slides."""
    model = rigid_arm.mjcf()
    model.opt.timestep = STEP
    model.dof_damping[1], model.dof_frictionloss[2] = VISCOUS, COULOMB
    data, rng, rows = mujoco.MjData(model), np.random.default_rng(seed), []
    size, phase = rng.uniform(0.1, 0.3, (3, 4)), rng.uniform(0, 6, (3, 4))
    w = 2 * np.pi * np.array([0.15, 0.31, 0.52, 0.9])

    def asked(t):
        angle = w * t + phase
        return (size * np.sin(angle)).sum(1), (size * w * np.cos(angle)).sum(1)

    data.qpos[:], data.qvel[:] = asked(0.0)
    for k in range(int(seconds / STEP)):
        q, v = asked(k * STEP)
        tau = (400, 400, 150) * (q - data.qpos) + (30, 30, 10) * (v - data.qvel)
        data.qfrc_applied[:] = tau + data.qfrc_bias
        if k % EVERY == 0:
            exact = (data.qpos, data.qvel, data.qfrc_applied)
            read = [x + s * rng.standard_normal(3) for x, s in zip(exact, NOISE, strict=True)]
            rows.append(np.r_[k * STEP, np.concatenate(read)])
        mujoco.mj_step(model, data)
    np.savetxt(path, rows, delimiter=";", header=HEADER, comments="", fmt="%.8g")


@pytest.mark.slow
def test_dry_friction_of_another_engine_is_named_and_nothing_beside_it(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "arm.urdf").write_text(rigid_arm.urdf())
    runs = [f"run-{k}.csv" for k in (1, 2, 3)]
    for k, name in enumerate(runs):
        log_of_mujoco(k, tmp_path / name)
    main(["diagnose", runs[0], "--describe", "--model", "arm.urdf"])
    main(["diagnose", *runs, "--machine", "out/diagnose/mapping.toml"])
    found = json.loads((tmp_path / "out/diagnose/diagnosis.json").read_text())
    named = {e["name"]: e["value"] for e in found["effects"]}
    assert found["verdict"] == "named"
    assert set(named) == {"joint/viscous at shoulder", "joint/coulomb at elbow"}, found[
        "sentence"
    ]
    assert named["joint/viscous at shoulder"]["damping"] == pytest.approx(VISCOUS, rel=0.05)
    assert named["joint/coulomb at elbow"]["torque"] == pytest.approx(COULOMB, rel=0.1)
