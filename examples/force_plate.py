"""An arm on a base that gives way, over a force plate: a machine of one's own.

The plate reads the rate of momentum of all that stands on it, less its weight; springs and
dampers without mass between plate and base carry the same. No motor torque is needed. What is
here is all that a machine takes; a mapping file (docs/own_machine.md) names it after

    ves-gym diagnose run.csv --import force_plate.py --machine plate.toml
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

import ves_gym as vg
from ves_gym.diagnosis import (
    Parameter,
    Port,
    ResidualMachine,
    Run,
    register_machine,
    run_of_signals,
)
from ves_gym.mechanics import inverse_dynamics

Array = npt.NDArray[np.float64]
Values = Mapping[str, Any]
Six = tuple[float, ...]
READINGS = ("F_x", "F_y", "F_z", "M_x", "M_y", "M_z")
AXES = ("x", "y", "z", "phi_x", "phi_y", "phi_z")
UNITS = ("N",) * 3 + ("N m",) * 3
NOTHING = vg.Inertial(mass=0.0, com=(0.0,) * 3, inertia=((0.0,) * 3,) * 3)
# bodies of 1 kg whose ten numbers span all that a payload may have
PLACES = np.vstack([np.zeros(3), np.eye(3), -np.eye(3), 1 - np.eye(3)])
POINTS = [replace(NOTHING, mass=1.0, com=tuple(place)) for place in PLACES.tolist()]


def only(arm: vg.Arm, body: int, inertial: vg.Inertial | None = None) -> vg.Arm:
    """The arm with one of its bodies alone, base first, or with another in its place."""
    bodies = [arm.base, *(link.inertial for link in arm.links)]
    bodies = [(inertial or b) if i == body else NOTHING for i, b in enumerate(bodies)]
    links = [replace(link, inertial=b) for link, b in zip(arm.links, bodies[1:], strict=True)]
    return replace(arm, base=bodies[0], links=tuple(links))


def turned(y: Array) -> Rotation:
    """Rotation of the base by its pose (T, 6), Z-Y-X angles."""
    return Rotation.from_euler("ZYX", y[:, :2:-1])


def about_the_world(y: Array, force: Array, moment: Array) -> Array:
    """Wrench (T, 6) about the world's origin of one about the base's, world axes."""
    return np.hstack([force, moment + np.cross(y[:, :3], force)])


def needed(arm: vg.Arm, run: Run) -> Array:
    """Wrench (T, 6) that the measured motion takes, world origin and axes."""
    y = run.base.x
    fall = turned(y).inv().apply([0.0, 0.0, -9.80665])
    _, exerted = inverse_dynamics(arm, *run.joints, fall, base=run.base)
    return about_the_world(y, *(turned(y).apply(x) for x in np.split(-exerted, 2, axis=1)))


def sprung(p: Values, run: Run) -> Array:
    """Wrench (T, 6) of springs and dampers on the base, world origin and axes."""
    y, yd, _ = run.base
    later, sooner = (y + h * yd for h in (1e-6, -1e-6))
    place, after, before = (
        np.hstack([x[:, :3], turned(x).as_rotvec()]) for x in (y, later, sooner)
    )
    rate = (after - before) / 2e-6
    force, moment = np.split(-(p["stiffness"] * place + p["damping"] * rate), 2, axis=1)
    return np.asarray(about_the_world(y, force, moment) + p["rest"])


def moving(p: Values, run: Run, arm: vg.Arm) -> Array:
    """Wrench (T, 6) that the motion of base, links and payload takes."""

    def loads() -> Array:
        links = [needed(only(arm, i), run) for i in range(arm.n + 1)]
        return np.stack(links + [needed(only(arm, arm.n, point), run) for point in POINTS])

    payload = np.linalg.solve(NUMBERS.T, [p["mass"], *p["moment"], *p["inertia"]])
    return np.tensordot(
        [*p["scale"], *payload], run.derived(("loads", arm), ("q", "y"), loads), 1
    )


def force_plate(arm: vg.Arm, stiffness: Six = (), damping: Six = ()) -> ResidualMachine:
    """Port `plate` (joints, base -> reading), with springs also `mount` (base -> reading).

    Runs have `q` (T, n), `y` (T, 6) pose of the base from its unloaded place in Z-Y-X angles,
    and `plate` (T, 6) readings about that place, on the base, world axes.
    """

    def residual(p: Values, run: Run) -> dict[str, Array]:
        def less(wrench: Array) -> Array:
            return np.asarray(run["plate"] - p["gain"] * wrench - p["bias"])

        out = {"plate": less(moving(p, run, arm))}
        return {**out, "mount": less(sprung(p, run))} if stiffness else out

    def port(name: str, of: str, needs: tuple[str, ...]) -> Port:
        title = f"reading of the plate less what {of}"
        return Port(name, title, READINGS, UNITS, needs, signal="plate")

    ports: tuple[Port, ...] = (port("plate", "the motion above it takes", ("q", "y", "plate")),)
    parameters = {**payload_of(arm), **plate_sensor()}
    if stiffness:
        ports += (port("mount", "springs and dampers give", ("y", "plate")),)
        parameters |= mount_of(stiffness, damping)
    return ResidualMachine("force plate", residual, ports, parameters)


def plate_sensor() -> dict[str, Parameter]:
    """Zeros of the plate and gains of its axes."""
    usual, zero = (2.0,) * 3 + (0.2,) * 3, (0.1,) * 3 + (0.01,) * 3
    six = partial(Parameter, entries=READINGS, low=-1e4, high=1e4)
    return {
        "bias": six(unit=UNITS, nominal=(0.0,) * 6, usual=usual, tolerance=zero),
        "gain": six(unit="1", nominal=(1.0,) * 6, usual=0.02, tolerance=0.002, each=True),
    }


def payload_of(arm: vg.Arm) -> dict[str, Parameter]:
    """What a payload may have, and how well the bodies are known."""
    payload = partial(Parameter, cause="payload", ports=("plate",))
    axes = ("xx", "xy", "yy", "xz", "yz", "zz")
    return {
        "mass": payload(unit="kg", usual=1.0, low=0.0, high=50.0),
        "moment": payload(unit="kg m", nominal=(0.0,) * 3, usual=0.1, entries=tuple("xyz")),
        "inertia": payload(unit="kg m^2", nominal=(0.0,) * 6, usual=0.02, entries=axes),
        "scale": Parameter(
            unit="1",
            nominal=(1.0,) * (arm.n + 1),
            usual=0.05,
            tolerance=0.006,
            low=0.0,
            entries=("base", *(f"link {i + 1}" for i in range(arm.n))),
            each=True,
            ports=("plate",),
        ),
    }


def mount_of(stiffness: Six, damping: Six) -> dict[str, Parameter]:
    """Springs and dampers along the axes, and what they carry in the pose that counts as 0."""
    mount = partial(Parameter, ports=("mount",))
    each = partial(mount, entries=AXES, each=True, low=0.0)
    K, D = np.array(stiffness), np.array(damping)
    return {
        "stiffness": each(
            unit=("N/m",) * 3 + ("N m/rad",) * 3,
            nominal=tuple(K),
            usual=tuple(0.05 * K),
            tolerance=tuple(0.002 * K),
        ),
        "damping": each(
            unit=("N s/m",) * 3 + ("N m s/rad",) * 3,
            nominal=tuple(D),
            usual=tuple(0.1 * D),
        ),
        "rest": mount(
            unit=UNITS,
            nominal=(0.0,) * 6,
            usual=1e3,
            entries=READINGS,
            per_run=True,
        ),
    }


@register_machine("force plate")
@dataclass(frozen=True)
class ForcePlate:
    """Keys of `[description]`: a URDF or MJCF whose root is the base, springs and dampers."""

    model: str
    stiffness: tuple[float, ...] = ()  # (6,) N/m, N m/rad
    damping: tuple[float, ...] = ()

    def machine(self, folder: Path) -> ResidualMachine:
        """The machine; the model is found from the mapping file's folder."""
        arm = vg.Arm.from_file(folder / self.model)
        return force_plate(arm, self.stiffness, self.damping)


def ten_numbers(place: Array) -> list[float]:
    """Mass, moments and inertias (10,) about the frame's origin of 1 kg at a place."""
    x, y, z = place
    r = x * x + y * y + z * z
    return [1.0, x, y, z, r - x * x, -x * y, r - y * y, -x * z, -y * z, r - z * z]


NUMBERS = np.stack([ten_numbers(place) for place in PLACES])


def moved(machine: ResidualMachine, seed: int, **hidden: Any) -> Run:
    """A run of 6 s at 100 Hz of an arm on a base that is shaken, with what is hidden in it."""
    rng = np.random.default_rng(seed)
    t = 0.01 * np.arange(600)[:, None]
    joints = len(machine.parameters["scale"].entries) - 1

    def sines(n: int, size: float) -> Array:
        waves, phase = rng.uniform(0.3, 1.5, (3, 1, n)), rng.uniform(0, 6, (3, 1, n))
        return np.asarray(size * np.sin(2 * np.pi * waves * t + phase).sum(axis=0))

    signals = {"q": sines(joints, 0.4), "y": sines(6, 0.003), "plate": np.zeros((600, 6))}
    noise: dict[str, Any] = {"q": 1e-5, "y": 2e-6, "plate": [0.5] * 3 + [0.1] * 3}
    still = run_of_signals(t[:, 0], signals, f"run {seed}", meta={"noise_std": noise})
    true = {**machine.values(()), **hidden}
    signals["plate"] = -machine.residual(true, still)["plate"]
    noisy = {k: x + noise[k] * rng.standard_normal(x.shape) for k, x in signals.items()}
    return run_of_signals(t[:, 0], noisy, f"run {seed}", 8.0, {"noise_std": noise})


if __name__ == "__main__":
    plate = force_plate(vg.PUMA_560)
    runs = [moved(plate, k, mass=2.0, moment=[0.2, 0.0, 0.1]) for k in range(3)]
    found = vg.diagnose(runs, plate)
    print(found.sentence)
    print(plate.better(found.effects))
