"""The described machines: vehicles, arms, platforms, servos, noise."""

import copy
import tomllib
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.trial.arm import Array
from benchmarks.trial.servo import Servo
from benchmarks.trial.structure import modal_damping

NUMBERS = tomllib.loads(Path(__file__).with_name("machines.toml").read_text("utf-8"))

ALUMINIUM = {
    "youngs_modulus": 72e9,
    "shear_modulus": 27e9,
    "density": 2800.0,
    "source": "thesis App. A.2",
}


def _matrices(M: Array, K: Array, ratio: float, source: str) -> dict[str, Any]:
    """A vehicle by its matrices."""
    D = modal_damping(M, K, ratio)
    D = (D + D.T) / 2
    return {
        "kind": "matrices",
        "M": M.tolist(),
        "D": D.tolist(),
        "K": K.tolist(),
        "source": source,
    }


def _member(vector: tuple[float, ...], diameter: float, wall: float) -> dict[str, Any]:
    """A tube of a polyline."""
    section = {"kind": "tube", "outer_diameter": diameter, "wall": wall, "shear": False}
    return {"vector": list(vector), "section": section, "material": ALUMINIUM}


def _polyline(
    members: list[dict[str, Any]], bodies: list[dict[str, Any]], modes: int
) -> dict[str, Any]:
    """A finite-element base."""
    return {
        "kind": "flexible",
        "modes": modes,
        "damping_ratio": 0.05,
        "fastest": 800.0,
        "source": "trial",
        "structure": {"kind": "polyline", "bodies": bodies, "members": members},
    }


def _satellite(mass: float, edge: float) -> dict[str, Any]:
    """A free cube with the arm on its top."""
    inertia = (mass * edge**2 / 6 * np.eye(3)).tolist()
    body = {"mass": mass, "com": [0.0, 0.0, -edge / 2], "inertia": inertia}
    return {"kind": "satellite", "thrusters": False, "source": "trial", "body": body}


def _coupled() -> dict[str, Any]:
    """A platform on springs that couple its axes, 2 to 6 Hz without the arm."""
    M = np.diag([420.0, 420.0, 420.0, 160.0, 160.0, 120.0])
    M[0, 4] = M[4, 0] = 40.0
    M[1, 3] = M[3, 1] = -40.0
    K = np.diag([9.0e4, 1.2e5, 2.4e5, 9.0e4, 1.1e5, 6.0e4])
    K[0, 4] = K[4, 0] = 2.4e4
    K[1, 3] = K[3, 1] = -3.0e4
    K[2, 5] = K[5, 2] = 8.0e3
    return _matrices(M, K, 0.04, "trial")


BOX = {
    "mass": 1400.0,
    "com": [0.0, 0.0, -0.2],
    "inertia": [[400.0, 0.0, 0.0], [0.0, 450.0, 0.0], [0.0, 0.0, 300.0]],
}

VEHICLES: dict[str, dict[str, Any]] = {
    "soft": {
        "kind": "matrices",
        "M": np.diag([500.0] * 3 + [250.0] * 3).tolist(),
        "D": np.diag([500.0] * 3 + [250.0] * 3).tolist(),
        "K": np.diag([1500.0, 2500.0, 4000.0, 1500.0, 1000.0, 2000.0]).tolist(),
        "source": "thesis Table 5-2",
    },
    "stiff": _coupled(),
    "bent": _polyline(
        [_member((-8.0, 0.0, 0.0), 0.18, 0.007), _member((0.0, 0.0, 8.0), 0.18, 0.007)], [], 5
    ),
    "mast": _polyline(
        [_member((0.0, 0.0, 3.0), 0.22, 0.008), _member((1.5, 0.0, 1.5), 0.22, 0.008)],
        [{"corner": 2, "inertial": BOX}],
        3,
    ),
    "free": _satellite(500.0, 1.5),
    "heavy-free": _satellite(2000.0, 2.0),
}
"""Six: four that the laboratory can emulate without payload compensation (`EMULATED`)."""

EMULATED = ("soft", "stiff", "mast", "heavy-free")

SERVOS = {
    "puma560": Servo(np.array([3000.0, 2000.0, 1000.0]), np.array([50.0, 40.0, 30.0])),
    "iiwa14": Servo(
        np.array([400.0, 900.0, 150.0, 300.0, 20.0, 30.0, 4.0]),
        np.array([25.0, 90.0, 8.0, 18.0, 0.4, 0.6, 0.06]),
    ),
}

NOISE = {
    "puma560": {
        "q": [1.3e-4, 2.0e-4, 2.5e-4],
        "v": [2e-3] * 3,
        "tau": [0.4, 0.4, 0.25],
        "y": [5e-5] * 3 + [2e-5] * 3,
        "w": [0.35, 0.3, 0.4, 0.3, 0.3, 0.15],
    },
    "iiwa14": {
        "q": [1e-4] * 7,
        "v": [1.5e-3] * 7,
        "tau": [0.15, 0.15, 0.1, 0.1, 0.05, 0.05, 0.02],
        "y": [5e-5] * 3 + [2e-5] * 3,
        "w": [0.2, 0.2, 0.25, 0.12, 0.12, 0.08],
    },
}

PERIODS = (0.0125, 0.01, 0.005)  # s


def description(
    vehicle: str, arm: str, mode: str, platform: str, period: float
) -> dict[str, Any]:
    """Return a machine as described, the content of a `system.toml`.

    Args:
        vehicle: of `VEHICLES`; arm: of `SERVOS`; mode: ideal or emulated.
        platform: `pose` or `legs`, whose clock sets the period.
        period: control period and, in space, time between records [s].
    """
    system: dict[str, Any] = {
        "mode": mode,
        "effects": [],
        "drive": "motor",
        "integrator": "rk4",
        "physics_dt": 0.00125,
        "control_dt": period,
        "arm": copy.deepcopy(NUMBERS["arms"][arm]),
        "vehicle": copy.deepcopy(VEHICLES[vehicle]),
    }
    if mode == "emulated":
        system["emulator"] = copy.deepcopy(NUMBERS["laboratory"])
        system["emulator"]["payload_compensation"] = False
        if platform == "legs":
            legs = copy.deepcopy(NUMBERS["legs"])
            system["emulator"]["platform"] = legs
            system["physics_dt"] = 1 / legs["rate"] / 2
            system["control_dt"] = 7 / legs["rate"]
    return system
