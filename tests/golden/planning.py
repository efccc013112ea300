"""Planners, maps, gains, checks and derivatives: what is computed about a system."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import ves_gym as vg
from tests.golden.probe import Probe, motion
from tests.golden.simulations import system

# One of each kind: a beam of few modes, one of finite elements, matrices, a free body, and
# an arm of six joints.
MACHINES = {
    "bent-thesis": {"vehicle": "bent-thesis"},
    "bent": {"vehicle": "bent"},
    "decoupled": {"vehicle": "decoupled"},
    "free-floating": {"vehicle": "free-floating"},
    "ur5e": {"vehicle": "bent", "arm": "ur5e"},
}
START = [0.3, 0.5, -1.0, 0.2, 0.3, 0.1]  # rad
GOAL = [1.0, 0.9, -0.6, -0.2, 0.5, 0.4]
EXACT = ("straight", "smooth-jerk", "shaped-zv", "shaped-zvd", "bad-path", "reaction-null")
SOUGHT = ("hotspot-q", "hotspot-qt", "direct", "damp", "refined", "refined-long")
CAREFUL = ("robust", "robust-worst")  # on two machines: half a minute with six joints
DRAWN = ("ompl-q", "ompl-qt", "ompl-time")
# Searches end where their steps are small: of the motion found more digits than these depend
# on rounding, of its energy, which is least there, on fewer.
SEARCH = 1e-5
# Among hot spots the way that is shortest depends on rounding: 4 % between processors.
SPOTS = 0.1
OBSTACLES = """
clearance = 0.02
[[obstacles]]
kind = "sphere"
centre = [0.55, 0.75, 0.95]
radius = 0.12
[[obstacles]]
kind = "box"
centre = [0.2, -0.9, 0.5]
size = [0.3, 0.2, 0.4]
"""


def planned(planner: str, machine: str, **options: Any) -> Callable[[], dict[str, Any]]:
    """Return a measurement: one query by one planner."""

    def measure() -> dict[str, Any]:
        on = system(**MACHINES[machine])
        n = on.arm.n
        return found(
            vg.plan(START[:n], GOAL[:n], planner=planner, system=on, seed=3, **options)
        )

    return measure


def found(plan: vg.Plan) -> dict[str, Any]:
    """Return the motion that a planner found, and its energies; or why there is none."""
    out: dict[str, Any] = {"failed": plan.failure is not None}
    if plan.found:
        out["duration"] = float(plan.motion.duration)
        quarters = plan.motion.duration * np.array([0.25, 0.5, 0.75, 1.0])
        out["path"] = plan.motion.at(quarters).q
        out["energies"] = {k: float(v) for k, v in plan.predicted.to_dict().items()}
    return out


def on_queries() -> dict[str, Probe]:
    """Every planner on every kind of machine."""
    out = {}
    for machine in MACHINES:
        for planner in (*EXACT, *SOUGHT, *DRAWN):
            loose = SPOTS if planner.startswith("hotspot") else SEARCH
            if machine == "ur5e" and planner == "refined-long":
                continue
            out[f"{planner} on {machine}"] = Probe(
                planned(planner, machine),
                slow=planner in ("hotspot-qt", "refined-long")
                or (planner, machine) == ("hotspot-q", "ur5e"),
                **({} if planner in EXACT else {"relative": loose}),
            )
    for machine in ("bent-thesis", "free-floating"):
        for planner in CAREFUL:
            out[f"{planner} on {machine}"] = Probe(
                planned(planner, machine), relative=SEARCH, slow=True
            )
    return out


def asked_otherwise() -> dict[str, Probe]:
    """Queries with more to them than two ends."""

    def among(planner: str) -> dict[str, Any]:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "obstacles.toml"
            path.write_text(OBSTACLES, encoding="utf-8")
            return planned(planner, "bent-thesis", surroundings=path)()

    def to_a_tool() -> dict[str, Any]:
        from ves_gym.mechanics.kinematics import ToolPose

        on = system(vehicle="bent-thesis")
        goal = ToolPose(position=(0.5, 0.6, 0.9))
        return found(vg.plan(START[:3], goal, planner="direct", system=on))

    def compared() -> dict[str, Any]:
        query = vg.plan(START[:3], GOAL[:3], planner="straight", duration=1.5).query
        rows = vg.compare(query, ["straight", "direct"]).to_dict()["rows"]
        return {row["planner"]: [row["predicted"], row["simulated"]] for row in rows}

    fast = {"v_max": [0.6] * 3, "a_max": [2.0] * 3}
    return {
        "direct among obstacles": Probe(lambda: among("direct"), relative=SEARCH),
        "straight among obstacles": Probe(lambda: among("straight")),
        "ompl-time among obstacles": Probe(lambda: among("ompl-time"), relative=SEARCH),
        "direct within limits": Probe(planned("direct", "bent", **fast), relative=SEARCH),
        "calm on bent": Probe(planned("calm", "bent"), relative=SEARCH),
        "calm, less of the peak": Probe(
            planned("calm", "bent-thesis", bounds={"acceleration_peak": 0.8}), relative=SEARCH
        ),
        "direct to a tool's place": Probe(to_a_tool, relative=SEARCH),
        "planners compared": Probe(compared, relative=SEARCH),
    }


def maps() -> dict[str, Probe]:
    """Coupling: its matrix, its modes, and maps of two joints."""

    def coupling(machine: str, **options: Any) -> dict[str, Any]:
        found = vg.coupling_map(system(**MACHINES[machine]), points=7, **options)
        step = slice(None, None, 3)
        return {k: getattr(found, k)[step, step] for k in ("least", "most")}

    def matrices(machine: str) -> dict[str, Any]:
        on = system(**MACHINES[machine])
        q = START[: on.arm.n]
        out = {"coupling": vg.planners.coupling_matrix(on, q)}
        return out | {"omega": vg.planners.modes(on, q).omega}

    def base(vehicle: str) -> dict[str, Any]:
        """What a vehicle is made of: its matrices, the modes inside it included."""
        model = system(vehicle=vehicle).base
        full = model.full()
        return {name: np.diag(part) for name, part in zip("MDK", full, strict=True)} | {
            f"all of {name}": float(np.abs(part).sum())
            for name, part in zip("MDK", full, strict=True)
        }

    beams = ("bent", "straight-vertical", "straight-horizontal", "bent-thesis", "decoupled")
    return {
        **{f"coupling map of {k}": Probe(lambda k=k: coupling(k)) for k in MACHINES},
        "coupling map at 2 s": Probe(lambda: coupling("bent", joints=(2, 3), duration=2.0)),
        "coupling map, others least": Probe(
            lambda: coupling("ur5e", joints=(2, 3), others="least"), relative=SEARCH, slow=True
        ),
        **{f"coupling at a pose, {k}": Probe(lambda k=k: matrices(k)) for k in MACHINES},
        **{f"matrices of {k}": Probe(lambda k=k: base(k)) for k in beams},
    }


def gains() -> dict[str, Probe]:
    """Joint gains that take vibration out of the base, and where they do it best."""

    def tuned(objective: str, full: bool = False, vehicle: str = "bent") -> dict[str, Any]:
        from ves_gym.damping.plant import THESIS_DISPLACEMENT, GainMatrices, analyse, plant_at
        from ves_gym.damping.tuning import tune

        plant = plant_at(system(vehicle=vehicle), np.array([0.8, 0.2, -0.1]))
        best = tune(plant, objective, y=THESIS_DISPLACEMENT, full=full, starts=4, seed=2)
        # the gains themselves differ by percents between processors: the least is flat
        given = GainMatrices.of(vg.JointServo(kp=(3000.0,) * 3, kd=(300.0,) * 3))
        damping = analyse(plant, given, THESIS_DISPLACEMENT)
        energies = {k: float(getattr(damping, k)) for k in ("E_int", "worst", "estimator")}
        return {"value": float(best.value), "given": energies}

    def mapped() -> dict[str, Any]:
        from ves_gym.damping.configurations import damping_map

        on, at = system(vehicle="bent-thesis"), np.array([0.5, 0.0, 0.0])
        out = damping_map(on, (1, 2), at, points=3)
        return {k: getattr(out, k) for k in ("coupling", "estimated", "tuned")}

    about = {"value": 1e-3}  # of the least that was found: a search stops where it is flat
    return {
        "gains by strain": Probe(lambda: tuned("strain"), loose=about),
        "gains by estimator": Probe(lambda: tuned("estimator"), loose=about),
        "gains by worst": Probe(lambda: tuned("worst", vehicle="decoupled"), loose=about),
        # of nine gains instead of six the search ends elsewhere when rounding changes
        "full gains": Probe(
            lambda: tuned("strain", full=True), loose={"value": 1e-2}, slow=True
        ),
        # few starts a point: 1.6e-3 between processors with AVX-512 and those with AVX2
        "damping map": Probe(mapped, loose={"tuned": 5e-3}),
    }


def laboratories() -> dict[str, Probe]:
    """Emulations judged before they run; gravity calibrated and learnt; excitation."""

    def judged(**table: Any) -> dict[str, Any]:
        check = vg.check_emulation(system(mode="emulated", **table), 0.3)
        names = ("spectral_radius", "payload_ratio", "max_bandwidth", "lag", "growth")
        out = {k: getattr(check, k) for k in names}
        # a free base's eigenvalues are a double 1: rounding splits them by its square root
        out["growth"] = round(check.growth, 5)
        out["modes"] = [
            [k.frequency, k.damping, k.emulated_frequency, k.emulated_damping]
            for k in check.modes
        ]
        return {**out, "stable": check.stable}

    def calibrated(arm: str) -> dict[str, Any]:
        on = system(arm=arm, mode="emulated", effects=[NOISE])
        q, y = vg.simulation.calibration_poses(on.arm, 30, seed=4)
        weighed = vg.simulation.weigh_poses(on, q, y, seconds=0.2, seed=4)
        fit = vg.simulation.fit_gravity(on.arm, weighed.q, weighed.y, weighed.w)
        model = {"mass": float(fit.model.mass), "P": list(fit.model.P)}
        return {"readings": weighed.w[::10], **model, "offset": list(fit.offset), "C": fit.C}

    def learnt() -> dict[str, Any]:
        on = system(vehicle="bent-thesis", mode="emulated")
        out = vg.simulation.learn_gravity(
            on, motion(on.arm), iterations=2, slow=4.0, settle=0.5
        )
        return {"y": [k.y[:: max(1, len(k.y) // 4)] for k in out.iterations]}

    def exciting(arm: str) -> dict[str, Any]:
        motions = vg.excitation(2, system(arm=arm), duration=6.0, seed=5)
        return {"q": [m.at(np.linspace(0, 6.0, 7)[1:-1]).q for m in motions]}

    legs = {"platform": {"kind": "legs", "rate": 800.0, "K1": 12e3, "K2": 18e3}}
    return {
        **{
            f"emulation of {k}": Probe(
                lambda k=k: judged(vehicle=k), relative=1e-6, slow=k == "free-floating"
            )
            for k in ("bent", "bent-thesis", "decoupled", "free-floating")
        },
        "emulation by legs": Probe(
            lambda: judged(vehicle="bent-thesis", emulator=legs), relative=1e-6, slow=True
        ),
        "gravity of puma560": Probe(lambda: calibrated("puma560")),
        "gravity of ur5e": Probe(lambda: calibrated("ur5e")),
        "gravity learnt": Probe(learnt),
        **{f"excitation of {k}": Probe(lambda k=k: exciting(k)) for k in ("puma560", "ur5e")},
    }


NOISE = {"kind": "sensor/noise", "force": [1.0, 0.5, 2.0], "moment": [0.1] * 3}


def derivatives() -> dict[str, Probe]:
    """Rollouts and their derivatives along parameters, commands and starts."""
    cases: dict[str, tuple[dict[str, Any], tuple[str, ...]]] = {
        "bent-thesis": (MACHINES["bent-thesis"], ("K11", "D55", "M33", "link2.mass", "kp1")),
        "bent": (MACHINES["bent"], ("link2.mass", "link3.com1", "kd3")),
        "free-floating": (MACHINES["free-floating"], ("satellite.mass", "satellite.I33")),
        "friction": (
            {
                "vehicle": "bent-thesis",
                "effects": [
                    {
                        "kind": "joint/stribeck",
                        "coulomb": [3.0, 4.0, 2.0],
                        "stiction": [6.0, 8.0, 4.0],
                        "fade_speed": 0.3,
                    }
                ],
            },
            ("joint/stribeck#1.coulomb2", "joint/stribeck#1.stiction1"),
        ),
    }

    def along(table: dict[str, Any], wrt: tuple[str, ...]) -> dict[str, Any]:
        on = system(**table)
        servo = vg.JointServo(kp=(3000.0, 2000.0, 1000.0), kd=(300.0, 200.0, 100.0))
        way = motion(on.arm)
        samples = way.at(np.arange(401) * on.physics_dt)
        # what the drives are told: where their springs pull, rates with the dampers' share
        command = samples.q + samples.v * np.array(servo.kd) / np.array(servo.kp)
        size = 6 + on.arm.n + on.base.m
        x0 = np.zeros((1, 2 * size))
        x0[0, 6 : 6 + on.arm.n] = way.start
        push = np.ones((1, 401, 1, on.arm.n)) * 1e-2
        out = vg.rollout_gradients(on, command[None], x0=x0, wrt=wrt, along=push, servo=servo)
        slopes = {"x": out.x[0], "dx": list(out.dx[0]), "denergy": out.denergy[0]}
        return {"energy": float(out.energy[0]), **slopes}

    return {
        f"derivatives, {k}": Probe(
            lambda table=table, wrt=wrt: along(table, wrt), slow=k == "bent"
        )
        for k, (table, wrt) in cases.items()
    }


def probes() -> dict[str, Probe]:
    """Return all of them by name."""
    return {
        **on_queries(),
        **asked_otherwise(),
        **maps(),
        **gains(),
        **laboratories(),
        **derivatives(),
    }
