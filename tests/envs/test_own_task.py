"""A task of one's own: the example is solved, and wrong answers are refused at the door."""

import dataclasses

import gymnasium as gym
import numpy as np
import pytest

import ves_gym as vg
from examples import own_task
from examples.own_task import Letter
from tests.envs.runs import cost_of
from ves_gym.envs import Field, Start
from ves_gym.envs.task import TASKS


def test_the_example_is_solved_by_its_controller_alone():
    table = vg.evaluate(
        "examples.own_task:mine/Letter-v0", ["zero", own_task.Tracer()], episodes=20
    )
    success = {run.name: run.values("success")[0].mean() for run in table}
    assert success == {"zero": 0.0, "tracer": 1.0}


def test_the_example_is_compiled_and_gives_the_same_numbers():
    """Tolerance: rounding over a second's steps."""
    many = gym.make_vec("mine/Letter-v0", num_envs=3)
    plain = vg.envs.VesVectorEnv(3, "letter")
    plain.batch = type(plain.batch)(plain.task, 3, compiled=False)
    assert many.batch.compiled and not plain.batch.compiled
    many.reset(seed=0), plain.reset(seed=0)
    for k in range(80):
        action = np.sin(np.arange(9.0) + 0.1 * k).reshape(3, 3)
        (seen, reward, *_), (again, expected, *_) = many.step(action), plain.step(action)
    np.testing.assert_allclose(seen, again, atol=1e-6)
    np.testing.assert_allclose(reward, expected, rtol=1e-9)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (
            {"start": lambda self, u: (u, u)},
            "answer of start must be Start, got tuple",
        ),
        (
            {"start": lambda self, u: Start(q=u[:, :2], goal=u)},
            "q of start(u) for two episodes must be (2, 3), got (2, 2)",
        ),
        (
            {"start": lambda self, u: Start(q=u, goal=u[:, 0])},
            "goal of start(u) for two episodes must be (2,), got ()",
        ),
        (
            {"fields": lambda self: (Field("a", "1", 1.0, ""),)},
            "dimensions of the scale of field a must be 1, got 0",
        ),
        (
            {"fields": lambda self: (Field("a", "1", np.ones(1), ""),) * 2},
            "number of different names of fields must be 2, got 1",
        ),
        (
            {"observe": lambda self, s: Letter.observe(self, s)[:-1]},
            "number of arrays of observe must be 6, got 5",
        ),
        (
            {"observe": lambda self, s: (*Letter.observe(self, s)[:-1], s.time)},
            "shape of time in observe, of two simulations must be (2, 1), got (2,)",
        ),
        ({"costs": lambda self, s, dt, last: s.energy}, "answer of costs must be dict"),
        (
            {"costs": lambda self, s, dt, last: {"energy": 1.0}},
            "shape of 'energy' in costs, of two simulations must be (2,), got ()",
        ),
        (
            {"costs": lambda self, s, dt, last: {"energy": -s.energy}},
            "number of 'energy' in costs below 0 must be 0, got 2",
        ),
        (
            {"success": lambda self, s: s.time},
            "success, of two simulations must be ((2,), 'bool'), got ((2,), 'float64')",
        ),
    ],
)
def test_a_wrong_answer_is_one_sentence(wrong, said):
    task = dataclasses.dataclass(frozen=True, kw_only=True)(type("Wrong", (Letter,), wrong))
    with pytest.raises(vg.ParameterError) as caught:
        vg.envs.VesEnv(task())
    assert str(caught.value).startswith("task letter: ") and said in str(caught.value)


def test_a_class_that_is_no_task_is_refused():
    with pytest.raises(vg.ParameterError, match="must be a subclass of Task, got <class 'int"):
        vg.register_task("none")(int)
    with pytest.raises(vg.ParameterError, match="'none' must say `draws`"):
        vg.register_task("none")(type("Drawless", (vg.Task,), {}))
    assert "none" not in TASKS


# ------------------------------------------------------------- a cell that is run again

CELL = """
import ves_gym as vg

@vg.register_task("again")
class Again(vg.envs.RestToRest):
    def costs(self, s, dt, last):
        return {"energy": FACTOR * s.energy}

@vg.register_planner
class Again:
    name, summary = "again", "the straight line"

    def find(self, query, seed):
        return query.straight, {}

@vg.register_effect("joint/again")
class Again(vg.effects.TorqueEffect):
    pull: float = vg.parameter("N m", bounds=(0.0, 10.0))

    def law(self, q, v, tau):
        return 0 * q - FACTOR * self.pull

effect = Again(pull=1.0)
turn = vg.Motion.straight([0.0, 0.0, 0.0], [0.1, 0.1, 0.1], 0.5)
energy = vg.energy(vg.simulate(turn, vg.System(effects=[effect]))).E_mean
env = vg.envs.VesEnv("again", duration=0.25)
env.reset(seed=0)
reward = env.step([0.5, 0.5, 0.5])[1]
"""


def test_a_cell_run_again_replaces_what_it_registered():
    """And nothing compiled from what it said before is left; another module's name is taken."""
    from ves_gym.planners.registry import PLANNERS
    from ves_gym.system.effect import EFFECTS

    try:
        found = []
        for factor in ("1", "4", "1"):
            cell = {"__name__": "__main__"}
            exec(CELL.replace("FACTOR", factor), cell)
            found.append((cell["energy"], cell["reward"]))
        assert found[0] == found[2] != found[1]
        first, second = (cost_of(reward, False) for _, reward in found[:2])
        assert second == pytest.approx(4 * first, rel=1e-9)
        with pytest.raises(vg.ParameterError, match="task 'again' is already registered by"):
            exec(CELL, {"__name__": "elsewhere"})
    finally:
        for registry, name in ((TASKS, "again"), (PLANNERS, "again"), (EFFECTS, "joint/again")):
            registry.pop(name, None)
