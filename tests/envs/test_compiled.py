"""A compiled control period gives the numbers of the NumPy text that it was made from."""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest

import ves_gym as vg
from ves_gym.envs.batch import Batch
from ves_gym.envs.build import build_task
from ves_gym.simulation.emulation_loop import EmulationLoop

N = 11  # a whole block of lanes and a part of another
CLOSE = 1e-11  # measured: 1e-12 of a reward, where the reference is led to its goal at the end

# numbers with the energy after an end: of near-equal modes rounding chooses the axes, which
# the perturbation by damping is 1e-6 sensitive to
CLOSED = 1e-5
OF_TAILS = ("reward", "reward/tail", "energy/E_mean", "energy/E_int", "tail", "total")

TASKS = [
    ("rest_to_rest", "guided", 165),
    ("reach", "joint_velocity", 40),
    ("reach", "pd_target", 40),
    ("reach", "torque", 120),
    ("reach_goal", "acceleration", 325),
    ("track", "acceleration", 485),
    ("damp", "torque", 60),
    ("damp", "pd_gains", 60),
    ("lqr", "torque", 60),
    ("free_flyer", "acceleration", 60),
    ("pose_reach", "acceleration", 60),
    ("payload_transfer", "acceleration", 60),
    ("servicer_capture", "acceleration", 60),
    ("berthing_contact", "acceleration", 60),
]
LABORATORY = {"mode": "emulated", "laboratory": "nominal"}


def pair(task, n=N):
    """The same episodes compiled and in NumPy, at their beginnings."""
    batches = Batch(task, n, backend="kernel"), Batch(task, n, backend="kernel", compiled=False)
    assert not batches[1].compiled
    for batch in batches:
        batch.seed(np.arange(n), 5, np.arange(n))
        batch.reset(np.arange(n))
    return batches


def require_alike(ours, theirs, name=""):
    """Numbers to rounding; what is true, whole, its type and its shape exactly."""
    assert ours.dtype == theirs.dtype and ours.shape == theirs.shape
    if ours.dtype.kind == "f":
        close = CLOSED if name in OF_TAILS else CLOSE
        np.testing.assert_allclose(ours, theirs, rtol=close, atol=close)
    else:
        np.testing.assert_array_equal(ours, theirs)


def require_same_steps(batches, periods, reach=1.2):
    """Random actions, some out of bounds, episodes begun anew where they end."""
    rng, over, ends = np.random.default_rng(0), None, 0
    for _ in range(periods):
        action = rng.uniform(-reach, reach, (batches[0].n, batches[0].width))
        ours, theirs = (batch.step(action, over) for batch in batches)
        for name, a, b in zip(("reward", "", ""), ours[:3], theirs[:3], strict=True):
            require_alike(a, b, name)
        assert list(ours[3]) == list(theirs[3])
        for name, value in ours[3].items():
            require_alike(value, theirs[3][name], name)
        if over is not None:
            for batch in batches:
                batch.reset(np.flatnonzero(over))
        seen, expected = (batch.observe() for batch in batches)
        assert seen.dtype == np.float32 and seen.flags.c_contiguous
        np.testing.assert_allclose(seen, expected, rtol=0, atol=1e-6)  # of single precision
        ended = ours[1] | ours[2]
        over, ends = (ended, ends + ended.sum()) if ended.any() else (None, ends)
    for part in ("scene", "episodes"):
        ours, theirs = (vars(getattr(batch, part)) for batch in batches)
        for name, value in ours.items():
            require_alike(value, theirs[name], name)
    return ends


@pytest.mark.parametrize(("task", "control", "periods"), TASKS)
def test_compiled_steps_are_those_of_numpy(task, control, periods):
    """Observation, reward and its terms, info, ends of episodes, scene: every shipped task."""
    batches = pair(build_task(task, control=control))
    assert batches[0].compiled
    ends = require_same_steps(batches, periods)
    assert periods < 100 or ends >= 1


@pytest.mark.parametrize("settings", [{}, {"mode": "emulated", "laboratory": "nominal"}])
def test_latches_close_and_open_as_in_numpy(settings):
    """A payload put into the grip is carried, and berthed where the tool has stayed."""
    batches = pair(build_task("payload_transfer", hold=0.1, **settings), 3)
    for batch in batches:
        cargo, lane = batch.sim.payload, np.array([1])
        cargo.change(lane, position=batch.scene.tool[lane] + np.array([0.0, 0.0, 0.15]))
        batch.scene.goal[1, 3:6] = batch.scene.tool[1]
        batch.set_state(batch.get_state())  # goals are no step's
    carried = []
    for _ in range(12):
        ours, theirs = (batch.step(np.zeros((3, 3))) for batch in batches)
        carried.append(batches[0].sim.payload.carried.tolist())
        assert batches[1].sim.payload.carried.tolist() == carried[-1]
        for name, value in ours[3].items():
            require_alike(value, theirs[3][name], name)
        for name in ("payload", "memory", "q", "y"):
            require_alike(*(getattr(batch.scene, name) for batch in batches))
    assert carried[0] == [False, True, False] and carried[-1] == [False] * 3
    told = [[event.kind for event in batch.sim.payload.events] for batch in batches]
    assert told == [["grasp", "release"]] * 2


def test_a_base_that_may_tumble_and_jets_that_are_searched_stay_in_numpy():
    """Charts, and forces of jets that have no opposites, are no formulas."""
    task = build_task("servicer_capture")
    jets = task.system.vehicle.jets[1:]
    odd = replace(task.system, vehicle=replace(task.system.vehicle, jets=jets))
    assert Batch(task, 1).compiled
    assert not Batch(replace(task, tumbled=1.0), 1).compiled
    assert not Batch(replace(task, system=odd), 1).compiled


EFFECTS = {"joint/viscous": {"damping": ([0.0] * 3, [4.0] * 3)}}


@pytest.mark.parametrize(
    ("task", "settings"),
    [
        ("rest_to_rest", LABORATORY),
        ("track", LABORATORY),
        ("damp", LABORATORY),
        ("reach", {"randomize": {"payload/mass": {"mass": (0.0, 5.0)}, **EFFECTS}}),
    ],
)
def test_in_the_laboratory_and_with_random_effects_too(task, settings):
    batches = pair(build_task(task, **settings), 3)
    assert batches[0].compiled
    require_same_steps(batches, 25)


@pytest.mark.parametrize("settings", [{}, LABORATORY], ids=["ideal", "emulated"])
def test_nothing_of_a_period_is_left_to_python(settings, monkeypatch):
    """The engine, and in the laboratory the loop's blocks, run within one program."""

    def forbidden(*args, **others):
        raise AssertionError("stepped from Python")

    batch = pair(build_task("reach", **settings), 2)[0]
    monkeypatch.setattr(batch.sim, "step", forbidden)
    monkeypatch.setattr(EmulationLoop, "_run", forbidden)
    for _ in range(3):
        batch.step(np.zeros((2, 3)))
    assert batch.sim.state.time == pytest.approx(3 * batch.dt)


def test_a_safety_stop_is_told_as_numpy_tells_it():
    """Ends the episode, stops that platform alone, and leaves an event with its reason."""
    batches = pair(build_task("rest_to_rest", **LABORATORY), 3)
    for k in range(5):
        if k == 2:
            for batch in batches:
                batch.sim.reset(q=batch.sim.state.q[1], y=[0, 0, 2.0, 0, 0, 0], ids=[1])
        ours, theirs = (batch.step(np.zeros((3, 3)))[3] for batch in batches)
        for name in ("stopped", "reward/failure"):
            require_alike(ours[name], theirs[name])
        assert ours["stopped"].tolist() == [False, k >= 2, False]
    assert batches[0].sim.events == batches[1].sim.events
    assert len(batches[0].sim.events) == 1


def test_what_is_wired_anew_goes_on_in_numpy():
    """A table in place of the gravity model: no program has it."""
    batches = pair(build_task("rest_to_rest", **LABORATORY), 3)
    for k in range(6):
        if k == 3:
            weight = batches[1].sim.readings.gravity
            for batch in batches:
                batch.sim.use_gravity(weight[:, None])
        for batch in batches:
            batch.step(np.full((3, 3), 0.2))
        assert batches[0].compiled == (k < 3)
    for name in ("q", "y", "energies", "memory"):
        require_alike(*(getattr(batch.scene, name) for batch in batches))
    assert batches[0].episodes.steps.tolist() == [6] * 3


def test_one_that_diverges_fails_alone():
    """The others' numbers do not change by a bit."""
    task = build_task("reach")
    batches, calm = pair(task), pair(task)[0]
    rng = np.random.default_rng(1)
    for k in range(6):
        action = rng.uniform(-1, 1, (N, 3))
        if k == 3:
            for batch in batches:
                state = batch.sim.state
                batch.sim.reset(q=state.q[4], v=3e9, y=state.y[4], ids=[4])
        ours, theirs = (batch.step(action) for batch in batches)
        alone, others = calm.step(action), np.arange(N) != 4
        np.testing.assert_array_equal(ours[0][others], alone[0][others])
        np.testing.assert_array_equal(batches[0].observe()[others], calm.observe()[others])
        assert np.isfinite(ours[0]).all() and np.isfinite(batches[0].observe()).all()
        for a, b in zip(ours[:3], theirs[:3], strict=True):
            require_alike(a, b)
        for name in ("diverged", "success", "reward/failure"):
            require_alike(ours[3][name], theirs[3][name])
        assert ours[3]["diverged"][4] == (k >= 3) and not ours[3]["diverged"][others].any()


# --------------------------------------------------------------------- a user's task


@dataclass(frozen=True, kw_only=True)
class Calm(vg.envs.RestToRest):
    """No word about being a formula."""

    kind: ClassVar[str] = "calm"

    def costs(self, s, dt, last):
        """Energy alone."""
        return {"energy": s.energy}


@dataclass(frozen=True, kw_only=True)
class Formula(Calm):
    """A formula by its own word."""

    kind: ClassVar[str] = "formula"
    compiled: ClassVar[bool] = True

    def costs(self, s, dt, last):
        """Energy, and where the tool is."""
        far = np.linalg.norm(s.tool, axis=1)
        return {"energy": s.energy, "far": np.where(far > 0.5, far, np.tanh(far.clip(0, 1)))}


@dataclass(frozen=True, kw_only=True)
class Branching(Formula):
    """Its text needs numbers to go on."""

    kind: ClassVar[str] = "branching"
    compiled: ClassVar[bool] = True

    def costs(self, s, dt, last):
        """Another formula where any base moves."""
        return {"energy": s.energy if s.energy.max() > 1e-3 else np.zeros(len(s.q))}


@dataclass(frozen=True, kw_only=True)
class Crowd(Formula):
    """A simulation's reward depends on its neighbours."""

    kind: ClassVar[str] = "crowd"
    compiled: ClassVar[bool] = True

    def costs(self, s, dt, last):
        """Energy in that of the first."""
        return {"energy": s.energy + s.energy[::-1]}


@pytest.mark.parametrize(("cls", "compiled"), [(Calm, False), (Formula, True)])
def test_a_users_task_is_compiled_when_it_says_so(cls, compiled):
    """Otherwise it runs in NumPy as it always has."""
    batches = pair(cls())
    assert batches[0].compiled == compiled
    require_same_steps(batches, 20)


@pytest.mark.parametrize(
    ("cls", "where"),
    [
        (Branching, r"test_compiled.py:\d+, `return .*max\(\) > 1e-3.*maximum over everything"),
        (Crowd, "test_compiled.py: a simulation's numbers depend on those of others"),
    ],
)
def test_a_task_that_is_no_formula_is_told_where(cls, where):
    """No slow path that nobody asked for."""
    with pytest.raises(vg.ParameterError, match=where):
        pair(cls())
