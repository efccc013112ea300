"""From a machine's description (`System.to_dict()`, plain data) to the numbers of a plant."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy

from ves_gym._util.params import Array, ParameterError
from ves_gym.diagnosis.benchmark.blind.beam import BaseMatrices, base_of
from ves_gym.diagnosis.benchmark.blind.mechanics import BodyParameters
from ves_gym.diagnosis.benchmark.blind.plant import BlindPlant

NEVER = 1e9  # of a limit that is not met
BRISTLE_LENGTH = 8e-4  # rad over which a joint's friction builds up


def bodies_of(arm: dict[str, Any]) -> BodyParameters:
    """Return geometry and masses of an arm description."""
    links = arm["links"]
    parts = [arm["base"], *(link["inertial"] for link in links)]
    return BodyParameters(
        dh=np.array([[link[k] for k in ("d", "a", "alpha", "offset")] for link in links]),
        mass=np.array([part["mass"] for part in parts], float),
        com=np.array([part["com"] for part in parts], float),
        inertia=np.array([part["inertia"] for part in parts], float),
    )


def plant_of(
    description: dict[str, Any], controller: dict[str, Any]
) -> tuple[BlindPlant, BaseMatrices]:
    """Return the healthy machine, and the base behind its admittance.

    Args:
        description: mode emulated, without payload compensation and joint balance, a pose
            servo under the platform, a beam as vehicle, three joints.
        controller: `kp` and `kd` of the joint servo.
    """
    lab = description.get("emulator") or {}
    required = {
        "mode": (description["mode"], "emulated"),
        "operation": (lab.get("operation"), "microgravity"),
        "payload_compensation": (lab.get("payload_compensation"), False),
        "joint_balance": (lab.get("joint_balance"), False),
        "platform.kind": (lab.get("platform", {}).get("kind"), "pose"),
        "vehicle.kind": (description["vehicle"]["kind"], "beam"),
        "joints": (len(description["arm"]["links"]), 3),
        "effects": (len(description["effects"]), 0),
    }
    for name, (actual, expected) in required.items():
        if actual != expected:
            raise ParameterError(f"generator: {name} must be {expected!r}, got {actual!r}")
    bodies, links = bodies_of(description["arm"]), description["arm"]["links"]
    base = base_of(description["vehicle"])
    phi, gamma = sampled(base, description["control_dt"])
    servo, sensor = lab["platform"], lab["sensor"]
    legs = leg_matrix(lab["stewart"])
    frame = sensor_frame(np.asarray(sensor["offset"], float))
    fine = [sensor["force_resolution"]] * 3 + [sensor["moment_resolution"]] * 3
    friction = np.zeros((3, 8))
    friction[:, 2], friction[:, 7] = 0.1, BRISTLE_LENGTH
    limit = np.array([link["tau_max"] for link in links])
    plant = BlindPlant(
        bodies=bodies,
        rotor=np.array([link["rotor_inertia"] for link in links]),
        kp=np.asarray(controller["kp"], float),
        kd=np.asarray(controller["kd"], float),
        gain=np.ones(3),
        limit=limit,
        ceiling=np.full(3, NEVER),
        stiffness=np.zeros(3),
        loss=np.zeros(3),
        gap=np.zeros(3),
        friction=friction,
        ripple=np.zeros((3, 3)),
        hose=np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0]),
        filter=2 * np.pi * sensor["cutoff"],
        to_signal=frame,
        to_wrench=np.linalg.solve(frame, np.asarray(sensor["calibration"], float)),
        offset=-np.asarray(sensor["zero"], float),
        creep=np.zeros(6),
        creep_time=20.0,
        pickup=np.zeros(6),
        mains=np.zeros(2),
        resolution=np.asarray(fine, float),
        encoder=np.zeros(3),
        zero=np.zeros(3),
        age=0.0,
        servo=np.array(
            [
                2 * np.pi * servo["bandwidth"],
                servo["damping_ratio"],
                float(servo["rate_feedforward"]),
            ]
        ),
        late=0.0,
        legs=legs,
        stroke=np.full(6, NEVER),
        drag=np.zeros(6),
        floor=np.zeros((0, 5)),
        rock=np.zeros(3),
        estimate=bodies,
        surplus=0.0,
        tilt=np.zeros(3),
        scale=1.0,
        phi=phi,
        gamma=gamma,
        delay=int(lab["delay"]),
    )
    return plant, base


def sampled(base: BaseMatrices, dt: float) -> tuple[Array, Array]:
    """Sample the base exactly over one period under a held wrench.

    Args:
        base: z coordinates.
        dt: period [s].

    Returns:
        Phi (2z, 2z) and Gamma (2z, 6).
    """
    size = len(base.M)
    generator = np.zeros((2 * size + 6, 2 * size + 6))
    generator[:size, size : 2 * size] = np.eye(size)
    force = np.eye(size, 6)
    generator[size : 2 * size] = np.linalg.solve(base.M, np.hstack([-base.K, -base.D, force]))
    step = scipy.linalg.expm(generator * dt)
    return (
        np.ascontiguousarray(step[: 2 * size, : 2 * size]),
        np.ascontiguousarray(step[: 2 * size, 2 * size :]),
    )


def leg_matrix(stewart: dict[str, Any]) -> Array:
    """Return (6, 6) change of leg lengths per small pose about home."""
    top = np.asarray(stewart["top"], float)
    home = np.array([0.0, 0.0, stewart["home_height"]])
    legs = top + home - np.asarray(stewart["base"], float)
    along = legs / np.linalg.norm(legs, axis=1)[:, None]
    return np.hstack([along, np.cross(top, along)])


def leg_lengths(stewart: dict[str, Any], y: Array) -> Array:
    """Return (N, 6) leg lengths [m].

    Args:
        stewart: description of the platform.
        y: (N, 6) poses [m, rad].
    """
    top, base = np.asarray(stewart["top"], float), np.asarray(stewart["base"], float)
    turn = scipy.spatial.transform.Rotation.from_euler("xyz", y[:, 3:]).as_matrix()
    joints = np.einsum("nij,kj->nki", turn, top) + y[:, None, :3]
    home = np.array([0.0, 0.0, stewart["home_height"]])
    return np.asarray(np.linalg.norm(joints + home - base, axis=-1))


def sensor_frame(offset: Array) -> Array:
    """Return (6, 6) wrench in platform axes -> the sensor's, turned by pi about x (App. D)."""
    turn = np.diag([1.0, -1.0, -1.0])
    x, y, z = offset
    lever = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0.0]])
    out = np.zeros((6, 6))
    out[:3, :3] = out[3:, 3:] = turn
    out[3:, :3] = -turn @ lever
    return out
