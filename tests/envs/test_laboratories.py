"""Named laboratories: data for what is drawn, on both beams, and what the policy may see."""

import warnings

import gymnasium as gym
import numpy as np
import pytest

from tests.envs.walks import SHORT, same
from ves_gym._util.params import ParameterError
from ves_gym.baselines.evaluate import evaluate
from ves_gym.baselines.registry import get_controller
from ves_gym.effects import EFFECTS, LABORATORY_ERRORS
from ves_gym.envs.batch import Batch
from ves_gym.envs.build import build_task
from ves_gym.envs.laboratories import LABORATORIES
from ves_gym.envs.registration import IDS
from ves_gym.mechanics.vehicle import BENT
from ves_gym.simulation.loop_linearisation import EmulationWarning

ID = "ves/PumaRestToRestEmulated-v0"
EMULATED = {"mode": "emulated"}


def kinds(name, **settings):
    task = build_task("rest_to_rest", mode="emulated", laboratory=name, **settings)
    return {r.effect for r in task.randomize}


def test_ids_are_those_of_the_lab():
    task = gym.make(ID).unwrapped.task
    asked = IDS["PumaRestToRest"].emulated
    assert task == build_task("rest_to_rest", mode="emulated", laboratory="lab", **asked)
    assert task.system.effects == LABORATORY_ERRORS and task.system.vehicle == BENT
    assert gym.make(ID, laboratory="hard").unwrapped.task.randomize != task.randomize


def test_effects_and_randomize_given_take_precedence():
    assert gym.make(ID, randomize={}).unwrapped.task.randomize == ()
    own = [EFFECTS["sensor/noise"](force=(1.0, 1.0, 1.0))]
    task = gym.make(ID, effects=own).unwrapped.task
    assert task.system.effects == tuple(own)
    assert "gravity/mass" in {r.effect for r in task.randomize}


def test_what_is_held_out_is_in_no_other():
    trained = kinds("nominal") | kinds("lab") | kinds("hard")
    assert kinds("lab") < kinds("hard") and not kinds("nominal")
    assert kinds("held-out") and not kinds("held-out") & trained


@pytest.mark.parametrize(
    "name",
    [
        k if k in ("lab", "hard") else pytest.param(k, marks=pytest.mark.slow)
        for k in LABORATORIES
    ],
)
def test_every_laboratory_runs_on_both_beams(name):
    """Drawn alike alone and together; nothing freezes in the first quarter of a second."""
    for vehicle in ("bent-thesis", "straight-horizontal-thesis"):
        with warnings.catch_warnings():
            warnings.simplefilter("error", EmulationWarning)
            env = gym.make_vec(ID, 3, laboratory=name, vehicle=vehicle, **SHORT)
        _, told = env.reset(seed=1)
        alone = gym.make(ID, laboratory=name, vehicle=vehicle, **SHORT)
        _, ours = alone.reset(seed=1, options={"index": 2})
        assert same({k: v[2] for k, v in told.items()}, ours)
        for _ in range(20):
            *_, info = env.step(np.zeros(env.action_space.shape))
        assert not info["stopped"].any() and not info["diverged"].any()


def test_a_laboratory_needs_an_emulation_that_subtracts_the_weight():
    with pytest.raises(ParameterError, match='did you mean "lab"'):
        build_task("rest_to_rest", mode="emulated", laboratory="labb")
    with pytest.raises(ParameterError, match=r"needs mode emulated, .*, got ideal"):
        build_task("rest_to_rest", laboratory="lab")
    with pytest.raises(ParameterError, match="context shows what randomize draws"):
        build_task("rest_to_rest", context=True)


def test_context_shows_what_was_drawn_and_only_then():
    hidden = Batch(build_task("rest_to_rest", laboratory="hard", **EMULATED), 300)
    shown = Batch(build_task("rest_to_rest", laboratory="hard", context=True, **EMULATED), 300)
    everyone = np.arange(300)
    for batch in (hidden, shown):
        batch.seed(everyone, 0, everyone)
        batch.reset(everyone)
    width = hidden.observe().shape[1]
    assert width == hidden.observations < shown.observations == shown.observe().shape[1]
    assert shown.observe()[:, :width].tobytes() == hidden.observe().tobytes()
    context = shown.observe()[:, width:]
    assert context.shape[1] == 1 + 9 + 36 + 2 + 6 + 4
    assert (context.std(axis=0) > 0.4).all() and (np.abs(context.mean(axis=0)) < 0.15).all()
    names = [field.name for field in shown.task.parts()]
    at = names.index("gravity/delay.delay") - len(names)
    low, high = 0.0, 0.025
    drawn = shown.drawn["gravity/delay.delay"][:, 0]
    np.testing.assert_allclose(context[:, at], (2 * drawn - high) / (high - low), atol=1e-6)


def test_an_unstable_corner_is_warned_of_once_per_task():
    """The straight beam with a platform that hears late: each end alone, and all together."""
    late = {"platform/delay": {"delay": (0.0, 0.0125)}}
    with pytest.warns(EmulationWarning, match="a part of the ranges: with platform/delay"):
        env = gym.make_vec(ID, 2, vehicle="straight-horizontal-thesis", randomize=late)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env.reset(seed=0)
    soft = {
        "platform/bandwidth": {"error": (-0.2, 0.2)},
        "platform/damping": {"error": (-0.2, 0.2)},
    }
    for ranges in ({k: v} for k, v in soft.items()):
        with warnings.catch_warnings():
            warnings.simplefilter("error", EmulationWarning)
            gym.make_vec(ID, 2, vehicle="straight-vertical-thesis", randomize=ranges)
    with pytest.warns(
        EmulationWarning, match=r"platform/bandwidth.*platform/damping.*together"
    ):
        gym.make_vec(ID, 2, vehicle="straight-vertical-thesis", randomize=soft)


def test_energies_in_the_laboratory_are_those_in_space():
    """Straight motions, nothing drawn: internal modes are taken where the platform is."""
    straight = get_controller("straight")
    space = evaluate(straight, "ves/PumaRestToRest-v0", episodes=5)
    laboratory = evaluate(straight, ID, episodes=5, effects=[], randomize={})
    ratio = laboratory.values("E_mean")[0] / space.values("E_mean")[0]
    print("E_mean over that in space:", np.round(ratio, 4))
    assert ratio == pytest.approx(np.ones(5), abs=0.01)
