"""One environment in every lane of another: the same continuation."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from ves_gym._util.params import ParameterError
from ves_gym.baselines.evaluate import make_vector
from ves_gym.envs.vector import VesVectorEnv

REST = "ves/PumaRestToRest-v0"
LABORATORY = "ves/PumaRestToRestEmulated-v0"
DELAYED = {"joint/measurement_delay": {"delay": [0.002, 0.004]}}


def _started(id: str, n: int, **settings: Any) -> VesVectorEnv:
    env = make_vector(id, n, AutoresetMode.DISABLED, threads=1, **settings)
    env.reset(seed=7)
    return env


def _drive(env: VesVectorEnv, actions: Any) -> list[Any]:
    """Observations, rewards and infos of a sequence of actions."""
    return [env.step(a)[:2] for a in actions]


@pytest.mark.parametrize(
    ("id", "settings"),
    [
        (REST, {}),
        (REST, {"backend": "mujoco"}),
        (LABORATORY, {"laboratory": "hard"}),
        (LABORATORY, {"randomize": DELAYED}),
        ("ves/FreeFlyerReach-v0", {}),
        ("ves/PumaTrack-v0", {}),
    ],
)
def test_a_model_of_the_same_settings_goes_on_as_the_source(
    id: str, settings: dict[str, Any]
) -> None:
    """Claim: each of five lanes goes on as environment 2 of 9 does, its drawn errors and noise
    included.

    Reference: the source itself. Tolerance: 1e-12 of the observations' scales; on one processor
    the lanes are equal to the last bit.
    """
    source, model = _started(id, 9, **settings), _started(id, 5, **settings)
    rng = np.random.default_rng(1)
    _drive(source, rng.uniform(-0.3, 0.3, (20, *source.action_space.shape)))
    observation = model.fan_out(source, 2)
    np.testing.assert_array_equal(observation, np.repeat(source._observation()[2:3], 5, 0))
    ahead = rng.uniform(-0.3, 0.3, (15, *source.action_space.shape))
    expected = _drive(source, ahead)
    for (obs, reward), (told, earned) in zip(
        expected, _drive(model, np.repeat(ahead[:, 2:3], 5, axis=1)), strict=True
    ):
        np.testing.assert_allclose(told, np.repeat(obs[2:3], 5, 0), rtol=0, atol=1e-12)
        np.testing.assert_allclose(earned, np.repeat(reward[2], 5), rtol=0, atol=1e-12)
    drawn = source.batch.randomized()
    for label, values in model.batch.randomized().items():
        np.testing.assert_array_equal(values, np.repeat(drawn[label][2:3], 5, 0))


def test_a_model_of_another_description_takes_over_what_is_measured() -> None:
    """Claim: an ideal model of a simulation in space goes on as that does, from any moment.

    Reference: the source. The model differs in a number that nothing moves (`tolerance`), so it
    is another task and is started from measurements; a base without internal modes hides
    nothing. Tolerance: 1e-9 of the observations' scales (the reset rounds).
    """
    settings: dict[str, Any] = {"vehicle": "bent-thesis"}
    source = _started(REST, 2, **settings)
    model = _started(REST, 6, tolerance=0.02, **settings)
    rng = np.random.default_rng(2)
    _drive(source, rng.uniform(-0.3, 0.3, (50, *source.action_space.shape)))
    model.fan_out(source, 1)
    ahead = rng.uniform(-0.3, 0.3, (110, *source.action_space.shape))
    expected = _drive(source, ahead)
    told = _drive(model, np.repeat(ahead[:, 1:2], 6, axis=1))
    for (obs, reward), (seen, earned) in zip(expected, told, strict=True):
        np.testing.assert_allclose(seen, np.repeat(obs[1:2], 6, 0), rtol=0, atol=1e-6)
        np.testing.assert_allclose(earned, np.repeat(reward[1], 6), rtol=0, atol=1e-9)


def test_a_model_of_the_laboratory_in_space_sees_the_base_as_measured() -> None:
    """Claim: an ideal model begins where the sensors see the base, not where it truly is."""
    source = _started(LABORATORY, 2, laboratory="hard")
    task = replace(source.task, system=source.task.system.ideal(), randomize=())
    model = VesVectorEnv(3, task)
    _drive(source, np.full((40, *source.action_space.shape), 0.3))
    model.fan_out(source, 0)
    seen = source.batch.scene
    assert np.abs(seen.yd_seen[0] - seen.yd[0]).max() > 1e-4  # the platform lags
    for name in ("y", "yd"):
        measured = np.repeat(getattr(seen, f"{name}_seen")[:1], 3, 0)
        np.testing.assert_allclose(getattr(model.batch.scene, name), measured, atol=1e-14)
    np.testing.assert_array_equal(model.batch.scene.ref, np.repeat(seen.ref[:1], 3, 0))
    assert model.batch.episodes.steps.tolist() == [40] * 3
    np.testing.assert_allclose(model.batch.scene.time, 0.5, rtol=1e-12)


def test_a_model_of_another_task_is_refused() -> None:
    """Claim: a model that cannot go on from there says why, and stays as it was."""
    source, model = _started(REST, 2), _started("ves/PumaTrack-v0", 2)
    with pytest.raises(ParameterError, match="same task, 'rest_to_rest', got 'track'"):
        model.fan_out(source)
    with pytest.raises(ParameterError, match="0 to 1, got 2"):
        model.fan_out(source, 2)
    other = _started(REST, 2, control="acceleration")
    with pytest.raises(ParameterError, match="same control"):
        other.fan_out(source)
    assert other.batch.episodes.steps.tolist() == [0, 0]
