"""The learner: it computes what Stable-Baselines3 computes."""

import gymnasium as gym
import numpy as np
import pytest

from ves_gym.baselines.action_repeat import ActionRepeat
from ves_gym.baselines.controllers import Zero
from ves_gym.baselines.learner import Imitation, ImitationConfig
from ves_gym.baselines.perceptron import ActorCritic
from ves_gym.baselines.ppo import PPO, Experience, ObservationStack, Settings, flat

SHORT = {"duration": 0.5, "tail": 0.5}  # 40 periods


def decisions(id="ves/PumaReach-v0", n=4, seed=0, settings=SHORT, **choices):
    env = gym.make_vec(id, num_envs=n, autoreset_mode="SameStep", threads=1, **settings)
    env.reset(seed=seed)
    return ActionRepeat(env.unwrapped, **choices)


def learner(
    env, frames=1, layers=(16, 16), seed=0, activation="tanh", privileged=False, **settings
):
    rng = np.random.default_rng(seed)
    size, batch = flat(env.observe()).shape[1], env.env.batch
    beside = batch.privileged().shape[1] if privileged else 0
    sizes = (size * frames, *layers, batch.width)
    agent = ActorCritic(sizes, activation, -0.5, rng, beside)
    parts = env, agent, ObservationStack(size, frames), Settings(**settings), rng
    return PPO(*parts, privileged=privileged)


# ------------------------------------------------------------ Stable-Baselines3


def numbers(model):
    """All that a model of Stable-Baselines3 learns, in the order of `ActorCritic.numbers`."""
    p, out = model.policy, [model.policy.log_std]
    for trunk, head in (
        (p.mlp_extractor.policy_net, p.action_net),
        (p.mlp_extractor.value_net, p.value_net),
    ):
        for layer in (trunk[0], trunk[2], head):
            out += [layer.weight.T, layer.bias]
    return np.concatenate([k.detach().numpy().ravel() for k in out])


@pytest.mark.parametrize(
    ("id", "activation"), [("ves/PumaReach-v0", "tanh"), ("ves/PumaDamp-v0", "relu")]
)
def test_an_update_gives_the_weights_that_stable_baselines3_gives(id, activation, monkeypatch):
    """Reference: `PPO.train` of Stable-Baselines3, from the same weights, data and order.

    Tolerance: float32 rounding over 20 steps of Adam at a rate of 1e-3.
    """
    pytest.importorskip("stable_baselines3")
    import stable_baselines3
    import torch

    from ves_gym.baselines.sb3 import Sb3VecEnv

    k = {"n_steps": 50, "batch_size": 60, "n_epochs": 5, "gamma": 0.97, "gae_lambda": 0.9}
    k |= {"ent_coef": 0.01, "clip_range": 0.1}
    n, kinds = 6, {"tanh": torch.nn.Tanh, "relu": torch.nn.ReLU}
    venv = Sb3VecEnv(decisions(id, n).env, hold=2)
    model = stable_baselines3.PPO(
        "MlpPolicy", venv, learning_rate=1e-3, seed=3, device="cpu",
        policy_kwargs={"net_arch": [16, 16], "activation_fn": kinds[activation]}, **k,
    )  # fmt: skip
    logger = stable_baselines3.common.logger.Logger(folder=None, output_formats=[])
    model.set_logger(logger)  # else it makes a folder in the temporary one
    ours = learner(decisions(id, n, hold=2), activation=activation, **k)
    ours.agent.numbers[:] = numbers(model)
    _, callback = model._setup_learn(10**6, callback=None)
    model.collect_rollouts(model.env, callback, model.rollout_buffer, k["n_steps"])

    b = model.rollout_buffer
    over = np.zeros((k["n_steps"], n), bool)
    over[:-1] = b.episode_starts[1:].astype(bool)
    over[-1] = model._last_episode_starts
    assert over.any()
    with torch.no_grad():
        following = model.policy.predict_values(torch.as_tensor(model._last_obs))[:, 0].numpy()
    beside = np.empty((*b.observations.shape[:2], 0), np.float32)
    rollout = Experience(
        b.observations, beside, b.actions, b.log_probs, b.values, b.rewards, over, following
    )
    advantages = rollout.advantages(k["gamma"], k["gae_lambda"])
    np.testing.assert_allclose(advantages, b.advantages, rtol=1e-5, atol=1e-6)

    # theirs lie environment after environment, ours decision after decision
    count = n * k["n_steps"]
    rng = np.random.default_rng(0)
    orders = [rng.permutation(count) for _ in range(k["n_epochs"])]
    theirs = iter([o % n * k["n_steps"] + o // n for o in orders])
    monkeypatch.setattr(np.random, "permutation", lambda size: next(theirs))
    before = ours.agent.numbers.copy()
    model.train()
    ours.update(rollout, 1e-3, orders)
    gap, moved = (np.abs(ours.agent.numbers - k).max() for k in (numbers(model), before))
    print(f"{id}: apart by {gap:.1e} after moving by {moved:.1e}")
    assert gap < 1e-5 and moved > 5e-3
    logged = model.logger.name_to_value
    for name in ("approx_kl", "clip_fraction", "value_loss", "policy_gradient_loss", "std"):
        assert ours.logged[name] == pytest.approx(logged[f"train/{name}"], rel=1e-3, abs=1e-6)
    assert ours.logged["explained_variance"] == pytest.approx(
        logged["train/explained_variance"], abs=1e-5
    )


def test_the_scale_of_observations_is_their_mean_and_spread_and_changes_no_action():
    rng = np.random.default_rng(0)
    rows = (rng.standard_normal((500, 4)) * [1, 0.01, 5, 2] + [0, 3, -2, 0]).astype(np.float32)
    stack, agent = ObservationStack(4, 1), ActorCritic((4, 8, 2), "tanh", 0.0, rng)
    wanted = agent.actor(rows).copy()
    for part in np.split(rows, [100, 250]):
        agent.rescale(*stack.learn(stack.scaled(part)))
    np.testing.assert_allclose(stack.mean, rows.mean(axis=0), rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(stack.spread, np.maximum(rows.std(axis=0), 0.1), rtol=1e-4)
    np.testing.assert_allclose(agent.actor(stack.scaled(rows)), wanted, atol=2e-5)


@pytest.mark.parametrize("privileged", [False, True])
def test_rewards_are_those_of_whole_episodes_and_the_critic_may_see_more(privileged):
    """What it sees beside is there at every decision, and decides what it says."""
    env = decisions("ves/PumaReach-v0", 3, settings={"duration": 0.5})
    ours = learner(env, n_steps=40, gamma=0.5, privileged=privileged)
    endings = []
    ours.on_endings = endings.append
    rollout = ours.collect()
    (ended,) = endings
    np.testing.assert_allclose(rollout.reward.sum(axis=0), ended.total, atol=1e-5)
    assert rollout.over[-1].all() and rollout.over.sum() == 3
    beside = env.env.batch.privileged().shape[1] if privileged else 0
    assert rollout.beside.shape == (40, 3, beside)
    assert ours.agent.actor.layers[0][0].shape[0] == rollout.inputs.shape[2]
    assert ours.agent.critic.layers[0][0].shape[0] == rollout.inputs.shape[2] + beside
    if privileged:  # the return that is left falls, and the time
        assert (np.diff(rollout.beside[:, :, 0], axis=0) <= 0).all()
        assert (np.diff(rollout.beside[:, :, 1], axis=0) < 0).all()
    ours.update(rollout, 1e-3)


def test_centred_rewards_have_no_mean_and_differ_by_a_constant():
    rollouts = [
        learner(decisions("ves/PumaReach-v0", 3), n_steps=40, centre=k).collect()
        for k in (False, True)
    ]
    plain, centred = (k.reward[~k.over] for k in rollouts)
    assert np.ptp(plain - centred) < 1e-6 < abs(plain.mean())
    assert abs(centred.mean()) < 1e-6


def test_the_critic_can_learn_first():
    ours = learner(decisions(), n_steps=40, batch_size=40, critic_first=1)
    before = ours.agent.numbers.copy()
    ours.update(ours.collect(), 1e-2)
    critic = ours.agent.critic.layers[0][0].size
    same = ours.agent.numbers == before
    actor = sum(W.size + b.size for W, b in ours.agent.actor.layers) + 3
    assert same[:actor].all() and not same[actor:].any() and critic
    ours.update(ours.collect(), 1e-2)
    assert not np.isclose(ours.agent.numbers[:actor], before[:actor]).all()


# ------------------------------------------------------------------------ imitation


def test_a_policy_learns_what_a_controller_does():
    """The distance to the action that the controller takes, before and after."""
    env = decisions(
        n=16,
        settings={"duration": 1.0, "tail": 0.5, "control": "guided"},
        id="ves/PumaRestToRest-v0",
    )
    ours = learner(env, layers=(32,))

    class Wave(Zero):
        def act(self, env, observation):
            return 0.8 * np.sin(env.batch.observe()[:, :3] * 3)

    chosen = ImitationConfig(rounds=6, expert_rounds=1, batch_size=64, recall=3)
    taught = Imitation(env, ours.agent, ours.stack, Wave(), chosen, np.random.default_rng(0))
    errors = []
    while not taught.over:
        assert taught.advance() == 16 * 80
        errors.append(taught.logged["imitation_error"])
    print("root mean square error by round", np.round(errors, 3))
    assert errors[-1] < 0.4 * errors[0] and len(taught.memory) == 0


# -------------------------------------------------------------------------- training


@pytest.mark.slow
def test_it_learns_what_stable_baselines3_learns(tmp_path):
    """Same task, hyper-parameters and number of decisions: returns within the seeds' spread."""
    from benchmarks.training import returns

    ours, theirs = returns()
    print("returns", ours, theirs)
    spread = max(np.ptp(ours), np.ptp(theirs))
    assert abs(np.mean(ours) - np.mean(theirs)) < spread
