"""Regulation by exact derivatives: they are right, and the energy falls to a plan's."""

from __future__ import annotations

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from ves_gym._util.params import ParameterError
from ves_gym.baselines.evaluate import evaluate, make_vector
from ves_gym.baselines.ilqr import Ilqr, costs, derivatives, play
from ves_gym.baselines.registry import get_controller

REST = "ves/PumaRestToRest-v0"
BEAM = "bent-thesis"  # without internal modes: fewer numbers to compile


def test_derivatives_and_costs_are_those_of_the_environment() -> None:
    """Claim: A and B carry a change of one action through 30 periods as the environment does,
    and the quadratic costs are its reward.

    Reference: differences of the environment's own motion, step 1e-4 of an action's range; its
    return. Tolerance: 1e-5 of the largest change; 2 % (the tail is of a linear motion).
    """
    env = make_vector(REST, 1, AutoresetMode.DISABLED, threads=1, vehicle=BEAM)
    env.reset(seed=3)
    controller = Ilqr()
    controller.reset(env, np.arange(1))
    model, motion = controller._model, controller._motion[0]
    u = np.random.default_rng(0).uniform(-0.1, 0.1, motion.u.shape)
    still, step = np.zeros_like(u), 1e-4
    ends = []
    for change in (0.0, step):
        u[30, 1] += change
        model.fan_out(env, 0)
        cost, x, _ = play(model, motion._replace(u=u), still)
        ends.append((cost[0], x[:, 0]))
    motion = motion._replace(x=ends[0][1], u=u)
    A, B = derivatives(model, motion)
    expected = (ends[1][1] - ends[0][1]) / step
    found = B[30, :, 1]
    for k in range(31, 61):
        np.testing.assert_allclose(found, expected[k], atol=1e-5 * np.abs(expected[k]).max())
        found = A[k] @ found
    weights, tail = costs(model, motion)
    x = motion.x
    energy = np.einsum("ki,kij,kj->", x[1:], weights, x[1:]) / 2
    end = x[-1] @ tail @ x[-1] / 2
    assert energy + end == pytest.approx(ends[0][0], rel=0.02)


def test_the_energy_falls() -> None:
    """Claim: eight iterations arrive, with at most 0.7 of the straight line's energy.

    Reference: the straight line in the same episode. The condensed beam, without `saving`:
    it is the harder one (0.27 for a plan), and quick to compile.
    """
    found, straight = (
        evaluate(k, REST, episodes=1, threads=1, vehicle=BEAM, saving=None)
        for k in (Ilqr(first=8, later=0), get_controller("straight"))
    )
    assert found.rows[0]["success"]
    assert found.rows[0]["E_mean"] < 0.7 * straight.rows[0]["E_mean"]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ilqr", "mppi"])
def test_on_the_machine_as_described(name: str) -> None:
    """Claim: through the environment's interface, 20 episodes: success in 19, mean E_mean
    of at most 0.35 of the straight line's.

    Reference: the straight line in the same episodes.
    """
    found, straight = (
        evaluate(get_controller(k), REST, episodes=20, seed=20_000, threads=1)
        for k in (name, "straight")
    )
    pairs = zip(found.rows, straight.rows, strict=True)
    assert sum(k["success"] for k in found.rows) >= 19
    assert np.mean([a["E_mean"] / b["E_mean"] for a, b in pairs]) <= 0.35


def test_what_it_cannot_do_is_refused() -> None:
    env = make_vector(REST, 1, AutoresetMode.DISABLED, threads=1, control="acceleration")
    env.reset(seed=0)
    with pytest.raises(ParameterError, match="through control guided"):
        Ilqr().reset(env, np.arange(1))
    with pytest.raises(ParameterError, match="first >= 1"):
        Ilqr(first=0)
