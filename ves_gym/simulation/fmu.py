"""A system as an FMU: co-simulation by FMI 3.0, in C that needs no Python.

The equations are the kernel's graphs, written as C by CasADi; `fmu.c` is the standard's
interface around them. Whoever has a C compiler gets a binary for the machine at hand beside the
sources; other machines compile these (`sources/buildDescription.xml`).
"""

from __future__ import annotations

import hashlib
import math
import os
import platform
import shutil
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from ves_gym._util.params import Array, ParameterError, toml, write_bytes
from ves_gym._util.version import __version__
from ves_gym.engine.backends.base import MEANINGLESS
from ves_gym.engine.kernel.numbers import model_of, parameters
from ves_gym.engine.kernel.symbolic import Traced, column, symbols, traced
from ves_gym.mechanics.equations import base_energy
from ves_gym.mechanics.servo import OWN_GAINS, JointServo
from ves_gym.mechanics.vehicle import has_jets, orbit_of
from ves_gym.simulation.fmu_loop import LoopGraphs
from ves_gym.simulation.playback import base_wrench
from ves_gym.simulation.stable_step import require_stable_step
from ves_gym.system.effect import DelayEffect
from ves_gym.system.runlog_files import AXES
from ves_gym.system.system import System

if TYPE_CHECKING:
    import casadi

MODEL = "ves_gym"  # name of the binary, and of functions in it
_TEXT = Path(__file__).with_suffix(".c")
_FLAGS = ("-std=c99", "-O1", "-shared", "-fPIC", "-fvisibility=hidden")
_STEEPEST = math.cos(math.radians(89.0))  # of phi_y: no step jumps from there over 90 deg
_UNITS = {  # exponents of SI's base units, as FMI has them
    "1": {},
    "s": {"s": 1}, "m": {"m": 1}, "rad": {"rad": 1}, "m/s": {"m": 1, "s": -1},
    "rad/s": {"rad": 1, "s": -1}, "m/s2": {"m": 1, "s": -2}, "rad/s2": {"rad": 1, "s": -2},
    "N": {"kg": 1, "m": 1, "s": -2}, "N.m": {"kg": 1, "m": 2, "s": -2},
    "J": {"kg": 1, "m": 2, "s": -2}, "N.m/rad": {"kg": 1, "m": 2, "s": -2, "rad": -1},
    "N.m.s/rad": {"kg": 1, "m": 2, "s": -1, "rad": -1}, "N/m": {"kg": 1, "s": -2},
    "N.s/m": {"kg": 1, "s": -1},
}  # fmt: skip


_VARIABILITY = {"parameter": "fixed", "local": "constant"}


class Variable(NamedTuple):
    """One number that the FMU takes or gives; its value reference is its place."""

    name: str  # q[1]
    causality: str  # independent, input, parameter, local, output
    unit: str
    about: str
    start: float | None = None  # of what is not calculated


def write_fmu(
    path: str | os.PathLike[str], system: System, servo: JointServo = OWN_GAINS
) -> bool:
    """Write a system as an FMU, completely or not at all.

    Inputs, held through each communication step: joint references `q_cmd`, `v_cmd` and torque
    `tau_cmd` on top of the servo (a prescribed drive: accelerations `a_cmd`). Parameters: gains
    `kp`, `kd`, the start, `physics_dt`. Outputs: `q`, `v`, `tau`, base pose `y`, rate `yd` and
    acceleration `ydd`, wrench `w` of the arm on the base, `E`, `E_strain`, `E_kinetic`. In the
    laboratory `w` is the force sensor's, beside `wg`, `y_cmd` and `frozen`; it starts at the
    arm's home, and a communication step is a whole number of control periods.

    Args:
        path: ends in .fmu.
        system: without payload, contact, wheels, jets and delays of joints; in mode emulated
            under micro-gravity, its sensor without noise.
        servo: gains that the parameters `kp`, `kd` begin with.

    Returns:
        Whether a compiler was there: without one the FMU holds sources alone.

    Raises:
        ParameterError: another suffix, a system that an FMU has no words for, or gains too fast
            for its physics step.
        RuntimeError: the compiler refuses the text.
    """
    path = Path(path)
    if path.suffix != ".fmu":
        raise ParameterError(f"{path}: expected a .fmu name")
    model = FmuModel(system, _gains(system, servo))
    sources = model.sources()
    with tempfile.TemporaryDirectory(prefix="ves-fmu-") as folder:
        binary = _compiled(sources, Path(folder))
        file = Path(folder) / "model.fmu"
        with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("modelDescription.xml", model.description())
            for name, text in sources.items():
                archive.writestr(f"sources/{name}", text)
            archive.writestr("sources/buildDescription.xml", _build_description())
            archive.writestr("resources/system.toml", toml(system.to_dict()))
            if binary is not None:
                folder_of = "-".join(_platform())
                archive.write(binary, f"binaries/{folder_of}/{binary.name}")
        write_bytes(path, file.read_bytes())
    return binary is not None


def _gains(system: System, servo: JointServo) -> JointServo:
    """Check a system, and return gains for its joints."""
    base, effects = system.base, system.effects
    wheels = any(part.kind == "wheel" for part in base.carried)
    lacking = {
        f"integrator {system.integrator} (rk4 alone)": system.integrator != "rk4",
        "a payload": system.payload is not None,
        "contact": system.contact is not None,
        "jets": system.mode == "ideal" and has_jets(system.vehicle),
        "an orbit": orbit_of(system.vehicle) is not None,
        "reaction wheels": system.mode == "ideal" and wheels,
        "delays": any(isinstance(effect, DelayEffect) for effect in effects),
    }
    if missing := [what for what, there in lacking.items() if there]:
        raise ParameterError(f"an FMU has no words for {', '.join(missing)}")
    none = (0.0,) * system.arm.n
    if system.drive == "motor":
        servo = servo.for_arm(system.arm, system.vehicle)
    else:
        servo = JointServo(kp=none, kd=none)
    require_stable_step(system.actual, servo)
    return servo


@dataclass(frozen=True)
class FmuModel:
    """Variables and graphs of a system."""

    system: System
    servo: JointServo

    @cached_property
    def loop(self) -> LoopGraphs | None:
        """The emulation loop, None in space."""
        if self.system.mode == "ideal":
            return None
        return LoopGraphs(self.system, self.servo)

    # ------------------------------------------------------------------- variables

    @cached_property
    def variables(self) -> tuple[Variable, ...]:
        """All, in the order of their value references."""
        return (
            Variable("time", "independent", "s", "simulated time"),
            *self._inputs(),
            *self._parameters(),
            *self._outputs(),
        )

    def count(self, *causality: str) -> int:
        """Number of variables of some kinds."""
        return sum(k.causality in causality for k in self.variables)

    def _per_joint(
        self, name: str, causality: str, unit: str, about: str, start: Any = None
    ) -> Iterator[Variable]:
        """Yield a variable per joint; joints that slide have m and N for rad and N m."""
        arm = self.system.arm
        starts = [None] * arm.n if start is None else np.broadcast_to(start, arm.n).tolist()
        for i, value in enumerate(starts):
            axis_unit = unit
            if i in arm.sliding:
                axis_unit = unit.replace("N.m", "N").replace("rad", "m")
            yield Variable(f"{name}[{i + 1}]", causality, axis_unit, f"{about} {i + 1}", value)

    def _per_axis(
        self, name: str, causality: str, units: tuple[str, str], about: str, start: Any = None
    ) -> Iterator[Variable]:
        for i, axis in enumerate(AXES):
            text = f"{about} {axis}"
            yield Variable(f"{name}[{i + 1}]", causality, units[i // 3], text, start)

    def _inputs(self) -> Iterator[Variable]:
        home = self.system.arm.home
        if self.system.drive == "motor":
            yield from self._per_joint("q_cmd", "input", "rad", "reference of joint", home)
            yield from self._per_joint("v_cmd", "input", "rad/s", "reference rate of joint", 0)
            yield from self._per_joint("tau_cmd", "input", "N.m", "torque on top, joint", 0)
        else:
            yield from self._per_joint("a_cmd", "input", "rad/s2", "acceleration of joint", 0)

    def _parameters(self) -> Iterator[Variable]:
        kind, home = "parameter", self.system.arm.home
        if self.system.drive == "motor":
            kp, kd = self.servo.kp, self.servo.kd
            yield from self._per_joint("kp", kind, "N.m/rad", "servo stiffness, joint", kp)
            yield from self._per_joint("kd", kind, "N.m.s/rad", "servo damping, joint", kd)
        if self.loop is not None:
            about = "control period; communication steps are multiples of it"
            yield Variable("control_dt", "local", "s", about, self.system.control_dt)
            return
        yield from self._per_joint("q_start", kind, "rad", "first angle of joint", home)
        yield from self._per_joint("v_start", kind, "rad/s", "first rate of joint", 0)
        yield from self._per_axis("y_start", kind, ("m", "rad"), "first base pose", 0.0)
        rates = ("m/s", "rad/s")
        yield from self._per_axis("yd_start", kind, rates, "first rate of base pose", 0.0)
        dt = self.system.physics_dt
        about = "integration step, at most what it is here; communication steps are multiples"
        yield Variable("physics_dt", kind, "s", about, dt)

    def _outputs(self) -> Iterator[Variable]:
        kind = "output"
        yield from self._per_joint("q", kind, "rad", "angle of joint")
        yield from self._per_joint("v", kind, "rad/s", "rate of joint")
        yield from self._per_joint("tau", kind, "N.m", "drive torque of joint")
        yield from self._per_axis("y", kind, ("m", "rad"), "base pose (Z-Y-X angles)")
        yield from self._per_axis("yd", kind, ("m/s", "rad/s"), "rate of base pose")
        yield from self._per_axis("ydd", kind, ("m/s2", "rad/s2"), "acceleration of base pose")
        about = "wrench of the arm on the base, platform axes,"
        if self.loop is not None:
            about = "wrench that the force sensor reports,"
        yield from self._per_axis("w", kind, ("N", "N.m"), about)
        if self.loop is not None:
            about = "the same less the estimated weight,"
            yield from self._per_axis("wg", kind, ("N", "N.m"), about)
            yield from self._per_axis("y_cmd", kind, ("m", "rad"), "pose that is commanded")
            yield Variable("frozen", kind, "1", "1 once a safety stop holds the platform")
        yield Variable("E", kind, "J", "base energy")
        yield Variable("E_strain", kind, "J", "of it strain energy")
        yield Variable("E_kinetic", kind, "J", "of it kinetic energy")

    # ---------------------------------------------------------------------- graphs

    def graphs(self) -> list[casadi.Function]:
        """`start`, `slope`, `observe`, each of a state or start, of inputs, and of gains; in
        the laboratory inputs begin with Y'' of the platform, and the loop has its halves."""
        import casadi as ca

        from ves_gym.engine.kernel.trace import equations

        actual, n, loop = self.system.actual, self.system.arm.n, self.loop
        motor, graph = self.system.drive == "motor", equations(actual)
        u, g = symbols("u", ((3 if motor else 1) * n,)), symbols("g", (2 * n * motor,))
        size = 2 * graph.order
        x = symbols("x", (size if loop is None else loop.first.size,))
        push = np.zeros(6) if loop is None else symbols("push", (6,))
        command = g[:n] * u[:n] + g[n:] * u[n : 2 * n] + u[2 * n :] if motor else u
        engine, gains, p = x[:size], column(g), column(self._p(g))

        def observed(acceleration: Array) -> list[Array]:
            """z'', drive torque and, in the laboratory, the arm's wrench."""
            inputs = column(engine), column(acceleration, command), p
            out = ca.vertsplit(graph.observe(*inputs)[1])
            row = traced(out, (len(out),))
            return [row[: 6 + n], row[6 + n : 6 + 2 * n], row[6 + 2 * n :]]

        inputs = column(u) if loop is None else column(push, u)
        slope = graph.motion(column(engine), column(push, command), p)
        moved = np.zeros(6) if loop is None else x[-6:]
        zdd, tau, _ = observed(moved)
        out = self._observed(x, zdd, tau)
        graphs = [
            self._start(g),
            ca.Function("slope", [column(engine), inputs, gains], [ca.cse(slope)]),
            ca.Function("observe", [column(x), column(u), gains], [ca.cse(out)]),
        ]
        if loop is None:
            return graphs
        wrench = column(observed(push)[2])
        arguments = [column(engine), inputs, gains]
        graphs.append(ca.Function("felt", arguments, [ca.cse(wrench)]))
        return [*graphs, loop.before(g), loop.after(g)]

    def _p(self, g: Traced) -> Traced:
        """Numbers of the system, its gains as symbols."""
        names, values = parameters(self.system.actual)
        p = traced(values.tolist(), values.shape)
        if len(g):
            first = names.index("kp1")
            p[first : first + len(g)] = g
        return p

    def _start(self, g: Traced) -> casadi.Function:
        """State of a start (q, v, y, yd): nothing deflected, modes at rest on the base."""
        import casadi as ca

        if self.loop is not None:
            nothing = ca.SX(0, 1)
            return ca.Function(
                "start", [nothing, nothing, column(g)], [column(self.loop.first)]
            )
        actual, n = self.system.actual, self.system.arm.n
        s = symbols("s", (2 * n + 12,))
        q, v, y, yd = s[:n], s[n : 2 * n], s[2 * n : 2 * n + 6], s[2 * n + 6 :]
        still = np.zeros(len(actual.arm.geared) + actual.arm.bends + len(actual.base.carried))
        C = actual.base.coupling
        x = [part for a, b in ((y, q), (yd, v)) for part in (a, b, still, a @ C)]
        return ca.Function("start", [column(s), ca.SX(0, 1), column(g)], [column(*x)])

    def _observed(self, x: Traced, zdd: Array, tau: Array) -> casadi.SX:
        """Outputs in their order."""
        system, n, loop = self.system, self.system.arm.n, self.loop
        size, gears = 6 + n, len(system.actual.arm.geared)
        order = (len(x) if loop is None else loop.engine) // 2
        z, h = x[:size], x[size:order]
        zd, hd = x[order : order + size], x[order + size : 2 * order]
        rows = z[:6], zd[:6], zdd[:6]
        readings: list[Array]
        if loop is None:
            modes = slice(gears, gears + system.arm.bends + system.base.hidden)
            u, ud = h[modes], hd[modes]
            readings = [self._wrench(rows, h, hd)]
        else:
            u, ud = loop.modes(x)
            readings = list(loop.seen(x).values())
        E, strain = base_energy(model_of(system.ideal()), z, zd, u, ud)
        return column(z[6:], zd[6:], tau, *rows, *readings, E, strain, E - strain)

    def _wrench(self, rows: tuple[Array, ...], h: Array, hd: Array) -> Array:
        """Of the arm on a base (6,) that moves by `rows`, with what is hidden."""
        carried = len(self.system.base.carried)
        y, yd, ydd = (k[None] for k in rows)
        hidden = (h[None], hd[None]) if len(h) else None
        jets = (np.zeros((1, carried)), np.zeros((1, 6))) if carried else None
        out: Array = base_wrench(self.system, y, yd, ydd, hidden, jets)[0]
        return out

    # ----------------------------------------------------------------------- files

    def sources(self) -> dict[str, str]:
        """Text of the C files by name."""
        import casadi as ca

        generator = ca.CodeGenerator("equations", {"indent": 1})
        for graph in self.graphs():
            generator.add(graph)
        equations = generator.dump()
        return {"fmu.c": _TEXT.read_text(), "equations.c": equations, "model.h": self._header()}

    def _header(self) -> str:
        system, loop, n = self.system, self.loop, self.system.arm.n
        arm, base = system.actual.arm, system.actual.base
        state = 2 * (6 + n + len(arm.geared) + arm.bends + len(base.carried) + base.m)
        if loop is not None:
            state = loop.engine
        starts = [0.0 if k.start is None else float(k.start) for k in self.variables]
        numbers = {
            "EMULATED": int(loop is not None),
            "NE": state,
            "NX": state if loop is None else loop.first.size,
            "NI": self.count("input") + (0 if loop is None else 6),
            "NODES": system.substeps + 1,
            "NU": self.count("input"),
            "NG": 2 * n if system.drive == "motor" else 0,
            "NS": 2 * n + 12 if loop is None else 0,
            "NY": self.count("output"),
            "FREE": int(base.body is not None and loop is None),
            "LONGEST": repr(system.physics_dt if loop is None else system.control_dt),
            "MEANINGLESS": repr(MEANINGLESS),
            "STEEPEST": repr(_STEEPEST),
            "TOKEN": f'"{self.token}"',
            "DEFAULT_VALUES": "{" + ", ".join(map(repr, starts)) + "}",
        }
        return "".join(f"#define {name} {value}\n" for name, value in numbers.items())

    @cached_property
    def token(self) -> str:
        """Digest of system, servo and version: what one description and its binary share."""
        what = f"{__version__} {self.system.hash} {self.servo.kp} {self.servo.kd}"
        return "{" + hashlib.sha256(what.encode()).hexdigest()[:32] + "}"

    def description(self) -> bytes:
        """modelDescription.xml."""
        system = self.system
        root = Element("fmiModelDescription", {
            "fmiVersion": "3.0", "modelName": f"{system.arm.name} on its base",
            "instantiationToken": self.token, "generationTool": f"ves_gym {__version__}",
            "variableNamingConvention": "structured",
            "description": f"system {system.hash[:12]}, mode {system.mode}",
        })  # fmt: skip
        SubElement(root, "CoSimulation", {
            "modelIdentifier": MODEL, "canHandleVariableCommunicationStepSize": "true",
            "canGetAndSetFMUState": "true", "canSerializeFMUState": "true",
        })  # fmt: skip
        units = SubElement(root, "UnitDefinitions")
        for name in dict.fromkeys(k.unit for k in self.variables):
            base = {k: str(v) for k, v in _UNITS[name].items()}
            SubElement(SubElement(units, "Unit", name=name), "BaseUnit", base)
        categories = SubElement(root, "LogCategories")
        SubElement(categories, "Category", name="logStatusError")
        step = repr(system.control_dt)
        SubElement(root, "DefaultExperiment", startTime="0.0", stopTime="5.0", stepSize=step)
        listed, structure = SubElement(root, "ModelVariables"), Element("ModelStructure")
        for place, variable in enumerate(self.variables):
            SubElement(listed, "Float64", _attributes(place, variable))
        outputs = [i for i, k in enumerate(self.variables) if k.causality == "output"]
        for kind in ("Output", "InitialUnknown"):
            for i in outputs:
                SubElement(structure, kind, valueReference=str(i))
        root.append(structure)
        ElementTree.indent(root)
        return bytes(ElementTree.tostring(root, encoding="utf-8", xml_declaration=True))


def _attributes(place: int, variable: Variable) -> dict[str, str]:
    kind = variable.causality
    out = {
        "name": variable.name, "valueReference": str(place), "causality": kind,
        "variability": _VARIABILITY.get(kind, "continuous"),
        "description": variable.about, "unit": variable.unit,
    }  # fmt: skip
    if kind == "parameter":
        out["initial"] = "exact"
    elif kind == "output":
        out["initial"] = "calculated"
    if variable.start is not None:
        out["start"] = repr(float(variable.start))
    return out


# ---------------------------------------------------------------------------- compiling


def _platform() -> tuple[str, str]:
    """Processor and system by the standard's names."""
    names = {"amd64": "x86_64", "arm64": "aarch64"}
    machine = platform.machine().lower()
    return names.get(machine, machine), {"win32": "windows"}.get(sys.platform, sys.platform)


def _compiled(sources: dict[str, str], folder: Path) -> Path | None:
    """A shared library of the sources; None without a compiler."""
    compiler = next(filter(None, map(shutil.which, ("cc", "gcc", "clang"))), None)
    if compiler is None:
        return None
    for name, text in sources.items():
        (folder / name).write_text(text)
    suffix = {"darwin": ".dylib", "win32": ".dll"}.get(sys.platform, ".so")
    binary = folder / f"{MODEL}{suffix}"
    units = [str(folder / name) for name in sources if name.endswith(".c")]
    done = subprocess.run(
        [compiler, *_FLAGS, *units, "-lm", "-o", str(binary)], capture_output=True, text=True
    )
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["no word of why"])[0]
        raise RuntimeError(f"{compiler} does not compile the FMU: {last}")
    return binary


def _build_description() -> bytes:
    root = Element("fmiBuildDescription", fmiVersion="3.0")
    build = SubElement(root, "BuildConfiguration", modelIdentifier=MODEL)
    files = SubElement(build, "SourceFileSet", language="C99")
    for name in ("fmu.c", "equations.c"):
        SubElement(files, "SourceFile", name=name)
    return bytes(ElementTree.tostring(root, encoding="utf-8", xml_declaration=True))
