"""Motions played on every vehicle, arm, laboratory and effect."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

import ves_gym as vg
from tests.effects.values import VALUES
from tests.golden.probe import SHOWN, Probe, motion, told

BEAMS = (
    "bent",
    "straight-vertical",
    "straight-horizontal",
    "bent-thesis",
    "straight-vertical-thesis",
    "straight-horizontal-thesis",
    "decoupled",
)
BODIES = ("free-floating", "free-flying")
SERVICERS = ("servicer", "servicer-flexible")
ENGINES = ("kernel", "mujoco")
FEWER = ("q", "y", "tau", "wg")
CALMER = {"platform/delay": {"delay": 0.005}}  # the typical one makes the loop unstable
LIVELY = 0.8  # rad, a motion that reaches limits of torque and stroke
CLIENT = {
    "inertial": {
        "mass": 40.0,
        "com": [0.02, -0.03, 0.05],
        "inertia": [[2.0, 0.1, 0.05], [0.1, 2.6, -0.04], [0.05, -0.04, 1.7]],
    },
    "grip": {"position": [0.2, 0.1, 0.0]},
    "position": [0.3, -0.2, 0.4],
    "angles": [0.4, -0.2, 1.1],
    "velocity": [0.05, 0.02, -0.1],
    "spin": [0.3, -0.5, 0.4],
    "latch_distance": 5.0,  # wherever the tool happens to be
}
# What the laboratory is made of, each part otherwise than usual.
LABORATORIES: dict[str, dict[str, Any]] = {
    "admittance": {"operation": "admittance", "zero_at_start": True},
    "uncompensated": {"admittance_form": "beam", "payload_compensation": False, "delay": 0},
    "no delay": {"delay": 0},
    "delay 2": {"delay": 2},
    "leg servo": {"platform": {"kind": "legs", "rate": 800.0, "K1": 12e3, "K2": 18e3}},
    "slow platform": {
        "platform": {"kind": "pose", "bandwidth": 4.0, "rate_feedforward": False}
    },
    "coarse sensor": {"sensor": {"cutoff": 12.0, "force_resolution": 0.5}},
    "unbalanced": {"joint_balance": False},
    "safety stop": {"force_max": 922.0},
}


def system(**table: Any) -> vg.System:
    """Return a system from plain data, as its file would have it."""
    return vg.System.from_dict(table)


# takes the base to stand still; None: that which plays a plan
STILL = vg.JointServo(kp=(), kd=(), source="the arm's own")


def played(
    described: Callable[[], vg.System],
    rows: int = 2,
    way: float = 0.2,
    names: Sequence[str] = SHOWN,
    **options: Any,
) -> Callable[[], dict[str, Any]]:
    """Return a measurement: a calm motion on a system, records 25 ms apart."""

    def measure() -> dict[str, Any]:
        on = described()
        settings = {"settle": 0.25, "record_dt": 0.025, "servo": STILL, **options}
        log = vg.simulate(motion(on.arm, size=way), on, **settings)
        return told(log, rows, names=names)

    return measure


def on_vehicles() -> dict[str, Probe]:
    """Every vehicle of the library in space and in the laboratory, by both engines."""
    cases = [(name, "ideal") for name in (*BEAMS, *BODIES, *SERVICERS)]
    cases += [(name, "emulated") for name in (*BEAMS, *BODIES)]
    return {
        f"{mode} {name} by {engine}": Probe(
            played(
                lambda name=name, mode=mode: system(vehicle=name, mode=mode),
                rows=2 if engine == "kernel" else 1,
                backend=engine,
            )
        )
        for name, mode in cases
        for engine in ENGINES
    }


def with_arms() -> dict[str, Probe]:
    """Every arm of the library."""
    cases = [("puma560-wrist", "bent"), ("ur5e", "bent"), ("iiwa14", "bent-thesis")]
    out = {}
    for arm, vehicle in cases:
        for mode in ("ideal", "emulated"):
            out[f"{mode} {vehicle} with {arm}"] = Probe(
                played(
                    lambda arm=arm, vehicle=vehicle, mode=mode: system(
                        arm=arm, vehicle=vehicle, mode=mode
                    )
                )
            )
    out["ideal servicer with canadarm2"] = Probe(
        played(lambda: system(arm="canadarm2", vehicle="servicer"), way=0.05)
    )
    out["ideal boom with puma560"] = Probe(played(on_a_boom))
    return out


def on_a_boom() -> vg.System:
    """An arm on the braked boom."""
    return vg.System(vehicle=vg.mechanics.get_boom("shuttle-like").at([0.3, -0.4, 0.9]))


def otherwise() -> dict[str, Probe]:
    """Drives, integrators, clocks, and starts that are not at rest."""
    beam = "bent-thesis"
    turning = [0.02, 0, 0, 0.05, 0.1, 0.03]
    moving = {"y": [0.02, -0.01, 0.01, 0.01, -0.02, 0.01], "yd": [0.1, 0.0, -0.05, 0, 0.02, 0]}
    cases: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
        "prescribed drive": ({"vehicle": beam, "drive": "prescribed"}, {}),
        "prescribed drive emulated": ({"drive": "prescribed", "mode": "emulated"}, {}),
        "euler": ({"vehicle": beam, "integrator": "euler"}, {}),
        "implicitfast": ({"vehicle": beam, "integrator": "implicitfast"}, {}),
        "physics at 2.5 ms": ({"physics_dt": 2.5e-3}, {}),
        "loop at 200 Hz": ({"mode": "emulated", "control_dt": 5e-3}, {}),
        "from a swinging base": ({}, moving),
        "from a swinging base emulated": ({"mode": "emulated"}, {"y": moving["y"]}),
        "tumbling": ({"vehicle": "free-floating"}, {"yd": TUMBLING, "settle": 2.0}),
        "servicer tumbling": ({"vehicle": "servicer-flexible"}, {"yd": turning}),
        "foreseen base": ({"vehicle": beam}, {"servo": None}),
        "foreseen base, moving": ({"vehicle": "servicer"}, {"servo": None, **moving}),
        "foreseen base emulated": ({"mode": "emulated"}, {"servo": None}),
        "weak servo": ({}, {"servo": vg.JointServo(kp=(1200.0,) * 3, kd=(90.0,) * 3)}),
    }  # fmt: skip
    out = {
        name: Probe(played(lambda table=table: system(**table), **options))
        for name, (table, options) in cases.items()
    }
    out["tumbling by mujoco"] = Probe(
        played(
            lambda: system(vehicle="free-floating"),
            yd=TUMBLING,
            settle=2.0,
            backend="mujoco",
            rows=1,
        )
    )
    return out


TOOL_AT_START = np.array([0.8649, 0.1455, 0.90044])  # m, of the motion
TOWARDS = np.array([-0.27, 0.96, 0.0])  # the way that it goes
TUMBLING = [0.1, 0.0, 0.0, 0.2, 1.5, 0.1]  # through where Z-Y-X angles end


def payloads() -> dict[str, Probe]:
    """A free body that is grasped, carried and let go; and one that is pushed."""
    out = {}
    cases = [("free-floating", "ideal"), ("bent", "ideal"), ("servicer", "ideal")]
    cases.append(("bent", "emulated"))
    for vehicle, mode in cases:
        for engine in ENGINES:
            still = {"velocity": [0.0] * 3, "spin": [0.0] * 3} if mode == "emulated" else {}
            table = {"vehicle": vehicle, "mode": mode, "payload": CLIENT | still}
            out[f"latch on {vehicle} {mode} by {engine}"] = Probe(
                played(
                    lambda table=table: system(**table),
                    latch=[(0.2, "grasp"), (0.6, "release")],
                    backend=engine,
                    rows=2 if engine == "kernel" else 1,
                )
            )
    for on in ("payload", "base", "space"):
        out[f"contact with {on}"] = Probe(lambda on=on: touched(on))
    return out


def touched(on: str) -> dict[str, Any]:
    """A pad at the tool that starts just clear of a ball, and meets it on its way."""
    arm = vg.PUMA_560
    ball = {"form": "sphere", "size": [0.05]}
    place = (TOOL_AT_START + 0.107 * TOWARDS).tolist()
    if on == "payload":
        body = {"mass": 20.0, "com": [0.0] * 3, "inertia": np.diag([0.5] * 3).tolist()}
        payload = {"inertial": body, "position": place}
    else:
        payload, ball = None, {**ball, "place": {"position": place}}
    law = {"stiffness": 2e4, "damping": 80.0, "friction": 0.2, "tangential_damping": 200.0}
    contact = {"tool": [{"form": "sphere", "size": [0.05]}], "target": [ball], "on": on, **law}
    table = {"vehicle": "free-floating", "contact": contact}
    described = system(**table) if payload is None else system(**table, payload=payload)
    log = vg.simulate(motion(arm), described, servo=STILL, settle=0.25, record_dt=0.025)
    return {**told(log), "pushed": float(np.abs(log.contact).max())}


def driven() -> dict[str, Probe]:
    """A platform that follows a given motion, and laboratories otherwise than usual."""

    def follow(t: Any) -> tuple[Any, Any]:
        t = np.asarray(t)[:, None]
        way = np.array([0.02, -0.01, 0.015, 0.01, 0.02, -0.01])
        return way * t**2 * (3 - 2 * t), way * 6 * t * (1 - t)

    out = {
        "platform by a given motion": Probe(
            played(
                lambda: system(mode="emulated", emulator={"operation": "position"}),
                platform=follow,
            )
        )
    }
    for name, settings in LABORATORIES.items():
        out[f"laboratory: {name}"] = Probe(
            played(
                lambda settings=settings: system(
                    vehicle="bent-thesis", mode="emulated", emulator=settings
                )
            )
        )
    return out


def with_effects() -> dict[str, Probe]:
    """Every effect of the library at a typical value, in each mode that it acts in."""
    out = {}
    for kind, values in (VALUES | CALMER).items():
        effect = {"kind": kind} | {k: np.asarray(v).tolist() for k, v in values.items()}
        for mode in vg.effects.EFFECTS[kind].modes:
            table = {"vehicle": "bent-thesis", "mode": mode, "effects": [effect]}
            out[f"{kind} {mode}"] = Probe(
                played(lambda table=table: system(**table), names=FEWER, way=LIVELY, seed=5)
            )
    return out


def probes() -> dict[str, Probe]:
    """Return all of them by name."""
    return {
        **on_vehicles(),
        **with_arms(),
        **otherwise(),
        **payloads(),
        **driven(),
        **with_effects(),
    }
