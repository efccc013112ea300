"""The verbs of `import ves_gym as vg`: each composes what the rooms hold, and adds no physics.

SI units throughout: angles in radians, as everywhere in Python; the command line takes degrees.
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ves_gym._util.checked import checked
from ves_gym._util.params import Array, ParameterError, Vector, finite, integer
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.arm_library import PUMA_560
from ves_gym.mechanics.limits import require_positions
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.servo import OWN_GAINS, OWN_SERVO, JointServo
from ves_gym.system.energy import TAIL, Energies, log_energies
from ves_gym.system.runlog import RunLog
from ves_gym.system.system import System

if TYPE_CHECKING:
    from ves_gym.baselines.comparison import ControllerComparison
    from ves_gym.baselines.config import TrainConfig
    from ves_gym.baselines.controllers import Controller
    from ves_gym.baselines.train import TrainingResult
    from ves_gym.diagnosis.diagnose import Diagnosis
    from ves_gym.diagnosis.inference.candidates import Candidate
    from ves_gym.diagnosis.machines.mjcf import MjcfMachine
    from ves_gym.diagnosis.machines.residual import ResidualMachine
    from ves_gym.mechanics.kinematics import ToolPose
    from ves_gym.planners.case import Case
    from ves_gym.planners.comparison import Comparison
    from ves_gym.planners.coupling_map import CouplingMap
    from ves_gym.planners.obstacles import Surroundings
    from ves_gym.planners.query import Plan, Planner, Query
    from ves_gym.simulation.calibration_summary import CalibrationSummary
    from ves_gym.simulation.stability import EmulationCheck
    from ves_gym.system.frequency_weight import FrequencyWeight

    Follow = Callable[[Array], tuple[Array, Array]]  # instants (m,) -> pose and rate (m, 6)

_checked = checked("Planner", "Controller")


@_checked
def simulate(
    motion: Motion | Plan | Case,
    system: System | None = None,
    *,
    servo: JointServo | None = None,
    settle: float = TAIL,
    record_dt: float | None = None,
    y: npt.ArrayLike = 0.0,
    yd: npt.ArrayLike = 0.0,
    platform: Motion | Callable[[Array], tuple[Array, Array]] | None = None,
    latch: Sequence[tuple[float, str]] = (),
    seed: int | None = None,
    backend: str = "auto",
    note: str = "",
    progress: Callable[[float], None] | None = None,
) -> RunLog:
    """Play a motion on a system and record it, as `ves-gym simulate` does.

    Args:
        motion: a case, a plan or a motion; of a case without a motion the straight line of its
            query.
        system: what is simulated; default that of the case or plan, else `System()`.
        servo: of the joints; default that of the case or plan, else the arm's own.
        settle: how long the joints are held afterwards [s].
        record_dt: between records [s]; default the physics step, in mode emulated the
            control period.
        y, yd: base pose and rate at the start (6,) [m, rad].
        platform: what the platform follows under operation "position": a motion of 6
            coordinates, or instants (m,) [s] -> pose and rate, (m, 6) each.
        latch: when the tool's latch acts on the system's payload [s], at records: (0.5,
            "grasp"), (2.0, "release").
        seed: of sensor noise and drift; default that of the case, else 0.
        backend: engine: auto, kernel, mujoco, gpu-kernel or gpu-kernel-float32.
        note: text for the log.
        progress: called with the fraction done.

    Returns:
        The run log; a run that a safety stop ended is as long as it ran. Its metadata have what
        the joints took of their limits, looked at between the records as well.

    Raises:
        ParameterError: a motion outside the joints' range, a plan without a motion, or
            a value out of its range.
        Divergence: the simulation left the meaningful range.

    Example:
        >>> log = vg.simulate(vg.Motion.straight([0, 0, 0], [1.0, 0.5, -0.5], 2.0), settle=3)
        >>> float(log.t[-1])
        5.0
    """
    from ves_gym.simulation.playback import play_motions

    case = _case(motion, system, servo)
    system, played = case.system, case.motion
    assert played is not None
    require_positions(system.arm, played)
    default = system.physics_dt if system.mode == "ideal" else system.control_dt
    if isinstance(platform, Motion):
        if platform.n != 6:
            raise ParameterError(f"a platform has 6 coordinates, got {platform.n}")
        y, platform = platform.start, _followed(platform)
    recording = play_motions(
        system,
        [played],
        servo=case.servo,
        settle=settle,
        record_dt=default if record_dt is None else record_dt,
        y=y,
        yd=yd,
        platform=platform,
        latch=latch,
        seed=case.seed if seed is None else seed,
        backend=backend,
        watch=True,
        progress=progress,
    )
    return recording.log(0, note)


@_checked
def plan(
    start: npt.ArrayLike | None = None,
    goal: npt.ArrayLike | ToolPose | None = None,
    *,
    case: Case | None = None,
    duration: float | None = None,
    planner: str | Planner = "calm",
    system: System | None = None,
    v_max: npt.ArrayLike | None = None,
    a_max: npt.ArrayLike | None = None,
    surroundings: Surroundings | str | os.PathLike[str] | None = None,
    servo: JointServo | None = None,
    weight: FrequencyWeight | None = None,
    bounds: Mapping[str, float] | None = None,
    seed: int | None = None,
) -> Plan:
    """Find one path with one planner, as `ves-gym plan` does.

    What is not given is that of the case's query, where there is one.

    Args:
        start, goal: joint angles (n,) [rad], from rest as near to 0 as the limits allow; or as
            the goal a `mechanics.kinematics.ToolPose`: of the configurations that reach it the
            one of least predicted E_mean is chosen. Of several arms a goal of the last one's
            joints, or a tool pose, leaves the others free: they move so that the base has
            least energy, and come to rest where that takes them (planners that search among
            smooth motions: `direct`, `refined`, `damp`, `robust`; others hold them still).
        case: a query, or a system alone.
        duration: of the motion [s]; default 2.
        planner: name (`ves-gym list planners`) or planner; by default the least energy that
            shakes the base no more than the straight line does.
        system: arm and vehicle; default `System()`.
        v_max: limits of joint speed (n,) [rad/s]; default those of the arm, "none" for none.
        a_max: limits of joint acceleration (n,) [rad/s^2]; default none.
        surroundings: what not to touch, or the file that says it.
        servo: what will move the joints; default the arm's own.
        weight: filter of the measure `E_weighted`; default what is above 1 Hz.
        bounds: of `calm` on disturbance measures, as shares of the straight line's: as in
            {"acceleration_peak": 0.5}, beside the usual ones of 1; inf for none.
        seed: of planners that search; default 0.

    Returns:
        The motion with its predicted energies; or, in `failure`, why there is none or which
        limit it breaks. `case` has all of it, to be saved and played.

    Raises:
        ParameterError: no goal, an unknown planner, ends outside the joints' range, or a tool
            pose out of reach.

    Example:
        >>> plan = vg.plan([0, 0, 0], [1.0, 0.5, -0.5], duration=2.0, planner="direct")
        >>> plan.feasible
        True
    """
    from ves_gym.mechanics.kinematics import ToolPose
    from ves_gym.planners.case import Case, speed_limits, whole_goal
    from ves_gym.planners.obstacles import read_surroundings
    from ves_gym.planners.query import Query, solve
    from ves_gym.planners.registry import bounded

    case = Case() if case is None else case
    system = _system(case.system if system is None else system)
    arm = system.arm
    if isinstance(surroundings, (str, os.PathLike)):
        surroundings = read_surroundings(surroundings)
    pose = goal if isinstance(goal, ToolPose) else None
    joints: Any = goal
    free: tuple[int, ...] | None = None
    if start is None and case.query is not None:
        start = case.query.start
    if goal is not None:
        joints, free = whole_goal(arm, arm.home if start is None else start, goal)
    parts: dict[str, Any] = {
        "start": _vector(start, arm.n, "start"),
        "goal": None if pose is not None else _vector(joints, arm.n, "goal"),
        "duration": duration,
        "a_max": _vector(a_max, arm.n, "a_max"),
        "surroundings": surroundings,
        "servo": servo,
        "weight": weight,
    }
    parts = {key: value for key, value in parts.items() if value is not None}
    if goal is not None:
        parts["free_joints"] = free
    if v_max is not None:
        parts["v_max"] = speed_limits(arm, v_max)
    if case.query is not None:
        query = dataclasses.replace(case.query, system=system, **parts)
    elif goal is None:
        raise ParameterError("plan needs a goal: joint angles, a tool pose, or a case's query")
    else:
        usual: dict[str, Any] = {"duration": 2.0, "v_max": speed_limits(arm)}
        usual["start"] = tuple(arm.home.tolist())
        usual["servo"] = case.servo if arm == case.system.arm else OWN_SERVO
        parts = {**usual, **parts}
        query = Query(system=system, **{"goal": parts["start"], **parts})
    method = _planner(planner) if bounds is None else bounded(_planner(planner), bounds)
    seed = case.seed if seed is None else seed
    if pose is not None:
        from ves_gym.planners.tool_goal import solve_to_tool

        return solve_to_tool(method, query, pose, seed)
    return solve(method, query, seed)


@_checked
def compare(
    query: Query | Plan, planners: Sequence[str | Planner] | None = None, *, seed: int = 0
) -> Comparison:
    """Plan one query with several planners and simulate their motions side by side.

    Args:
        query: ends, duration and system; of a plan, its query.
        planners: names or planners; default straight, hotspot-qt, refined and calm.
        seed: of planners that search.

    Returns:
        Predicted and simulated energies, and their ratio to the straight line's.

    Raises:
        ParameterError: an unknown planner, or none.

    Example:
        >>> plan = vg.plan([0, 0, 0], [1.0, 0.5, -0.5], planner="straight")
        >>> vg.compare(plan, ["straight", "direct"]).rows[1].ratio < 0.1
        True
    """
    from ves_gym.planners.comparison import compare_planners
    from ves_gym.planners.query import Plan

    if isinstance(query, Plan):
        query = query.query
    if isinstance(planners, str):
        planners = [planners]
    names = ("straight", "hotspot-qt", "refined", "calm") if planners is None else planners
    return compare_planners(query, [_planner(name) for name in names], seed=seed)


@_checked
def coupling_map(
    system: System | None = None,
    *,
    joints: tuple[int, int] | None = None,
    duration: float | None = None,
    points: int = 61,
    others: str = "given",
    progress: Callable[[float], None] | None = None,
    **at: float,
) -> CouplingMap:
    """Sweep two joints over their range and map how strongly they couple to the base.

    Args:
        system: default `System()`.
        joints: the two that are swept, counted from 1; default the first two that `at` does
            not fix.
        duration: of the motions meant, for Q_T [s]; None: the thesis's Q.
        points: per axis.
        others: the other joints are "given", or chosen at every point for the "least" or the
            "most" coupling.
        progress: called with the fraction done.
        at: angles of the other joints [rad] by name, q1, q2, ...; default as near to
            0 as its limits allow.

    Returns:
        The map, as `ves-gym map` makes it.

    Raises:
        ParameterError: no such joint, or a value out of its range.

    Example:
        >>> vg.coupling_map(points=9, q3=0.5).joints
        (0, 1)
    """
    from ves_gym.planners.coupling_map import coupling_map as swept

    system = _system(system)
    arm, n = system.arm, system.arm.n
    fixed = arm.home
    names = [f"q{k + 1}" for k in range(n)]
    for name, value in at.items():
        if name not in names:
            raise ParameterError(
                f"coupling_map: a joint must be one of {', '.join(names)}, got {name!r}"
            )
        fixed[names.index(name)] = value
    if joints is None:
        joints = tuple(k for k, name in enumerate(names, 1) if name not in at)[:2]  # type: ignore[assignment]
        if len(joints or ()) < 2:
            raise ParameterError(
                f"coupling_map sweeps two joints, got {', '.join(at)} fixed of {n}"
            )
    how: dict[str, Any] = {"duration": duration, "points": points, "others": others}
    return swept(system, _pair(joints, n), fixed, progress=progress, **how)


@_checked
def diagnose(
    logs: RunLog | str | os.PathLike[str] | Sequence[Any],
    system: System | MjcfMachine | ResidualMachine | None = None,
    *,
    final: int | None = None,
    candidates: Sequence[Candidate] = (),
    leave_out: Sequence[str] = (),
    most: int | None = None,
    band: float | None = None,
    as_logged: bool = False,
    seed: int = 0,
    progress: Callable[[float, str], None] = lambda done, stage: None,
) -> Diagnosis:
    """Name what is missing in the description of a machine, as `ves-gym diagnose` does.

    Args:
        logs: of one machine: run logs, their files, or folders of them; of a `MjcfMachine`
            or a `diagnosis.ResidualMachine` runs, as the loader of `diagnosis.read_machine`
            gives them.
        system: the machine as described; default what the logs name.
        final: how many of the last logs to hold back and open once, at the end; default those
            that say `held_back`, else the last third.
        candidates: what is considered beside the library of effects, and in place of what it
            has of the same kinds.
        leave_out: kinds of effects that are not considered.
        most: effects to name at most; by default as many as the evidence bears.
        band: frequency up to which log and description are compared [Hz]; default 12.
        as_logged: ask no questions about units, signs and exchanged channels.
        seed: of the noise draws.
        progress: called with the fraction done and a few words.

    Returns:
        `sentence` says it, `system` is the better description.

    Raises:
        ParameterError: logs that cannot be of one machine as it stands.
    """
    from ves_gym.diagnosis.data.sanity_checks import require_as_logged
    from ves_gym.diagnosis.diagnose import diagnose as name_missing
    from ves_gym.diagnosis.inputs import machine_inputs, system_inputs

    single = isinstance(logs, (RunLog, str, os.PathLike))
    sources: list[Any] = [logs] if single else list(logs)  # type: ignore[arg-type]
    if not sources:
        raise ParameterError("diagnose needs at least one run log, got none")
    most = None if most is None else integer(most, "most", 1)
    if system is None or isinstance(system, System):
        for source in sources:
            if not isinstance(source, (RunLog, str, os.PathLike)):
                raise ParameterError(f"diagnose needs run logs or their files, got {source!r}")
        inputs = system_inputs(sources, system, final=final, leave_out=leave_out, band=band)
    elif hasattr(system, "residuals"):
        inputs = machine_inputs(system, sources, final=final, leave_out=leave_out)
    else:
        raise ParameterError(
            f"system must be a System, a MjcfMachine or a ResidualMachine, got {system!r}"
        )
    if not as_logged:
        require_as_logged(inputs.machine, inputs.runs, inputs.mistakes)
    replaced = {c.kind for c in candidates}
    library = (c for c in inputs.candidates if c.kind not in replaced)
    return name_missing(
        inputs.machine,
        inputs.runs,
        inputs.final,
        candidates=(*library, *candidates),
        most=most,
        progress=progress,
        seed=seed,
    )


@_checked
def excitation(
    n: int = 4, system: System | None = None, *, duration: float = 10.0, seed: int = 0
) -> list[Motion]:
    """Return motions whose logs show what `diagnose` asks for.

    Every joint reverses, rests, moves slowly and fast, within 0.9 of its limits.

    Args:
        n: how many; four are enough for one or two effects, a third of them held back.
        system: whose arm's limits hold; default `System()`.
        duration: of each [s].
        seed: of the draw.

    Returns:
        Motions of one duration, from rest to rest.

    Raises:
        ParameterError: n or the duration is out of range.

    Example:
        >>> len(vg.excitation(3))
        3
    """
    from ves_gym.diagnosis.excitation import excitation_motions

    arm: Arm = PUMA_560 if system is None else _system(system).arm
    return excitation_motions(n, arm, duration=duration, seed=seed)


@_checked
def evaluate(
    id: str,
    controllers: str | Path | Controller | Sequence[str | Path | Controller] = (),
    *,
    episodes: int = 100,
    seed: int = 0,
    n_envs: int | None = None,
    threads: int = 0,
    progress: Callable[[str, float], None] = lambda name, done: None,
    **settings: Any,
) -> ControllerComparison:
    """Run controllers and policies on the same episodes, as `ves-gym evaluate` does.

    Args:
        id: of the environment, such as ves/PumaDamp-v0.
        controllers: names of built-in controllers (`ves-gym list controllers`), policies, their
            files, folders that `train` made, names of released policies, or "released" for
            all of them; default zero, random and the released policies.
        episodes, seed: episode k begins with `env.reset(seed=seed + k)`.
        n_envs: how many run at once; the results do not depend on it.
        threads: of the engine, 0 = one per processor.
        progress: called with a label and the fraction done.
        settings: of the environment (`gym.make`'s); `randomize={}` turns randomisation off.

    Returns:
        An evaluation per controller; `ratio` compares two episode by episode.

    Raises:
        ParameterError: an unknown environment, controller or setting.

    Example:
        >>> compared = vg.evaluate("BeamLQR-v0", ["zero", "lqr"], episodes=2)
        >>> compared.ratio("lqr", "zero").value < 1
        True
    """
    from ves_gym.baselines.comparison import compare_controllers, line_up
    from ves_gym.baselines.evaluate import spec_of

    id = spec_of(id if "/" in id else f"ves/{id}").id
    single = isinstance(controllers, (str, os.PathLike)) or not np.iterable(controllers)
    chosen: Any = [controllers] if single else controllers
    settings |= {"n_envs": n_envs, "threads": threads, "progress": progress}
    rivals = line_up(id, chosen, seed)
    return compare_controllers(id, rivals, episodes=episodes, seed=seed, **settings)


@_checked
def train(
    config: str | os.PathLike[str] | TrainConfig,
    *,
    algorithm: str | None = None,
    imitate: str | None = None,
    steps: int | None = None,
    seeds: Sequence[int] | None = None,
    settings: Mapping[str, Any] | None = None,
    folder: str | os.PathLike[str] | None = None,
    workers: int = 1,
    resume: bool = False,
    progress: Callable[[int, float, str], None] = lambda seed, done, note: None,
    tensorboard: str | os.PathLike[str] | None = None,
) -> TrainingResult:
    """Learn policies, one per seed, as `ves-gym train` does.

    Args:
        config: an environment that a configuration comes with, a .toml file, or a
            `TrainConfig`.
        algorithm: a label, such as ppo; default the first there is.
        imitate: a controller whose actions are learned first.
        steps: in all, instead of the configuration's.
        seeds: of weights, exploration and training episodes; default the configuration's.
        settings: of the environment, beside the configuration's.
        folder: for policies, curves and checkpoints; default out/train/NAME.
        workers: seeds at once, each in a process of its own.
        resume: go on from the checkpoints in `folder`.
        progress: called with the seed, the fraction done and a few words.
        tensorboard: a folder in which TensorBoard shows the curves as they grow.

    Returns:
        Learning curves and the best policy of each seed.

    Raises:
        ParameterError: no such configuration, or `folder` holds a run and `resume` is false.

    Example:
        >>> vg.train("BeamLQR-v0", steps=4096, seeds=[0], folder="run")
        <TrainingResult: ...>
    """
    from ves_gym.baselines.config import TrainConfig, choose_config
    from ves_gym.baselines.train import TrainingResult, train_seeds

    if workers < 1:
        raise ParameterError(f"workers must be >= 1, got {workers}")
    chosen = config if isinstance(config, TrainConfig) else choose_config(config, algorithm)
    changes: dict[str, Any] = {
        "imitate": imitate,
        "total_timesteps": steps,
        "seeds": None if seeds is None else tuple(seeds),
        "settings": None if settings is None else {**chosen.settings, **settings},
    }
    changes = {name: value for name, value in changes.items() if value is not None}
    chosen = dataclasses.replace(chosen, **changes)
    where = Path("out", "train", chosen.name) if folder is None else Path(folder)
    how: dict[str, Any] = {"workers": workers, "resume": resume, "tensorboard": tensorboard}
    curves = train_seeds(chosen, where, progress=progress, **how)
    return TrainingResult(chosen, where, curves)


@_checked
def energy(log: RunLog, *, duration: float | None = None, tail: float = TAIL) -> Energies:
    """Measure the energy that a run transferred to its base.

    Args:
        log: names its system in the metadata.
        duration: of the motion [s]; default what the log says, else the last moving command.
        tail: how long after the motion `E_mean` reaches [s].

    Returns:
        `E_mean`, the primary score, and the other measures.

    Raises:
        ParameterError: the log is shorter than duration and tail, or names no system.

    Example:
        >>> motion = vg.Motion.straight([0, 0, 0], [1.0, 0.5, -0.5], 2.0)
        >>> 0.3 < vg.energy(vg.simulate(motion)).E_mean < 0.5
        True
    """
    return log_energies(log, duration=duration, tail=tail)


@_checked
def calibrate(
    log: RunLog,
    arm: Arm | None = None,
    *,
    iterations: int | None = 2,
    matrix: bool = True,
    zero: bool = True,
    check: RunLog | None = None,
    rezero: bool = False,
) -> CalibrationSummary:
    """Find gravity parameters and sensor matrix from a log of static poses, thesis 3.4.

    Args:
        log: with q, y and w, a row per pose.
        arm: default that of the log.
        iterations: turns of the matrix's estimate, None for their limit.
        matrix, zero: whether the sensor's matrix and zero are estimated.
        check: a second log, to predict.
        rezero: the sensor was zeroed anew for it.

    Returns:
        What was found beside what is described; `calibration` is what `--calibration` takes.

    Raises:
        ParameterError: a log without readings, or poses that do not determine the parameters.

    Example:
        >>> lab = vg.System(mode="emulated")
        >>> poses = vg.simulation.calibration_poses(lab.arm, 20)
        >>> result = vg.calibrate(vg.simulation.weigh_poses(lab, *poses))
    """
    from ves_gym.simulation.calibration_summary import calibrated

    return calibrated(
        log, arm, iterations=iterations, matrix=matrix, zero=zero, check=check, rezero=rezero
    )


@_checked
def check_emulation(
    system: System | None = None,
    q: npt.ArrayLike = 0.0,
    *,
    servo: JointServo | None = OWN_GAINS,
    search: bool = True,
) -> EmulationCheck:
    """Judge an emulation before it runs, as `ves-gym emulation-check` does.

    Args:
        system: in mode emulated; default `System(mode="emulated")`.
        q: joint angles (n,) [rad] at which the loop is linearised.
        servo: of the joints; None: none.
        search: also find the largest stable bandwidth of the platform.

    Returns:
        Whether it is stable, and how true: added damping, lag, payload ratio.

    Raises:
        ParameterError: the system is not emulated, or its platform is position controlled.

    Example:
        >>> vg.check_emulation(search=False).stable
        True
    """
    from ves_gym.simulation.stability import check_emulation as judged

    system = System(mode="emulated") if system is None else _system(system)
    return judged(system, finite(q, np.shape(q), "q"), servo=servo, search=search)


@_checked
def render(
    log: RunLog,
    path: str | os.PathLike[str] | None = None,
    *,
    width: int = 960,
    height: int = 480,
    fps: float = 25.0,
    speed: float = 1.0,
    magnify: float = 1.0,
    progress: Callable[[float], None] | None = None,
) -> Path | None:
    """Draw a run as a movie, or replay it in a window, as `ves-gym view` does.

    Args:
        log: names its system in the metadata.
        path: .gif or .mp4; None: a window, until it is closed.
        width, height: of the picture [px].
        fps: pictures per second.
        speed: of the run's clock.
        magnify: factor on the base's motion.
        progress: called with the fraction done.

    Returns:
        The path, None after a window.

    Raises:
        ParameterError: another suffix, or a value out of its range.
        RenderError: no OpenGL or display, or the extra `report` is not installed.

    Example:
        >>> log = vg.simulate(vg.Motion.straight([0, 0, 0], [0.5, 0, 0], 1.0), settle=0)
        >>> vg.render(log, "run.gif", width=160, height=80, fps=5).name
        'run.gif'
    """
    from ves_gym.rendering.render import View, show
    from ves_gym.rendering.render import render as draw

    view = View(width=width, height=height, fps=fps, speed=speed, magnify=magnify)
    if path is None:
        show(log, view)
        return None
    draw(log, path, view, progress)
    return Path(path)


@_checked
def export(
    what: RunLog | Mapping[str, RunLog] | System,
    path: str | os.PathLike[str],
    *,
    servo: JointServo = OWN_GAINS,
    magnify: float = 1.0,
) -> Path:
    """Write a run, or a machine, for the tools of others; the suffix says which.

    .rrd: runs by name, or one, for rerun's viewer (extra `rerun`). .mcap: a run as ROS 2
    messages (extra `mcap`). .fmu: a system as an FMU, FMI 3.0 co-simulation, compiled for this
    machine, sources beside it.

    Args:
        what: a log, logs by name (.rrd), or a system (.fmu).
        path: of the file.
        servo: .fmu: gains that its parameters begin with.
        magnify: .rrd: magnification of the drawn motion of the base.

    Returns:
        The path.

    Raises:
        ParameterError: another suffix, or something that the format has no words for.

    Example:
        >>> log = vg.simulate(vg.Motion.straight([0, 0, 0], [0.5, 0, 0], 1.0), settle=0)
        >>> vg.export(log, "run.mcap").name
        'run.mcap'
    """
    path, kind = Path(path), Path(path).suffix
    if isinstance(what, System) and kind == ".fmu":
        from ves_gym.simulation.fmu import write_fmu

        write_fmu(path, what, servo)
    elif isinstance(what, RunLog) and kind == ".mcap":
        from ves_gym.system.runlog_mcap import write_mcap

        write_mcap(path, what)
    elif isinstance(what, (RunLog, Mapping)) and kind == ".rrd":
        from ves_gym.rendering.rerun_file import write_rerun

        write_rerun(path, {"run": what} if isinstance(what, RunLog) else what, magnify)
    else:
        raise ParameterError(
            "export takes a run log to .rrd or .mcap, logs by name to .rrd, a System to .fmu;"
            f" got {type(what).__name__} and {path.name!r}"
        )
    return path


# ---------------------------------------------------------------------------- arguments


def _system(system: System | None) -> System:
    return System() if system is None else system


def _case(
    motion: Motion | Plan | Case, system: System | None, servo: JointServo | None
) -> Case:
    """Return the case to be simulated, with a motion."""
    from ves_gym.planners.case import Case
    from ves_gym.planners.query import Plan

    if isinstance(motion, Plan):
        motion = dataclasses.replace(motion.case, motion=motion.motion)
    if isinstance(motion, Motion):
        return Case(system=_system(system), motion=motion, servo=servo or OWN_SERVO)
    played = motion.motion
    if played is None:
        if motion.query is None:
            raise ParameterError("simulate needs a motion, got a case of a system alone")
        played = motion.query.straight
    return Case(
        system=motion.system if system is None else _system(system),
        motion=played,
        servo=servo or motion.servo,
        seed=motion.seed,
        log=motion.log,
    )


def _followed(platform: Motion) -> Follow:
    def follow(t: Array) -> tuple[Array, Array]:
        sample = platform.at(t)
        return sample.q, sample.v

    return follow


def _planner(planner: str | Planner) -> Planner:
    from ves_gym.planners.registry import get_planner

    if isinstance(planner, str):
        return get_planner(planner)
    if isinstance(planner, type) or not callable(getattr(planner, "find", None)):
        raise ParameterError(
            f"planner must be a name or an object with find(query, seed), got {planner!r}"
        )
    return planner


def _vector(value: npt.ArrayLike | None, n: int, name: str) -> Vector | None:
    return None if value is None else tuple(finite(value, (n,), name).tolist())


def _pair(joints: Any, n: int) -> tuple[int, int]:
    try:
        i, j = (int(k) for k in joints)
    except (TypeError, ValueError):
        i = j = 0
    if not (1 <= i <= n and 1 <= j <= n and i != j):
        raise ParameterError(
            f"joints must be two different numbers from 1 to {n}, got {joints!r}"
        )
    return i - 1, j - 1
