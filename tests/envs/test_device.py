"""`DeviceVectorEnv` against `VesVectorEnv`: the same episodes, on a GPU where there is one."""

import numpy as np
import pytest

from ves_gym._util.optional import installed
from ves_gym._util.params import ParameterError
from ves_gym.envs.vector import VesVectorEnv

if not (installed("warp") and installed("torch")):
    pytest.skip("warp-lang or torch is not installed", allow_module_level=True)

import torch

from ves_gym.envs.device import DeviceVectorEnv

N = 6
DEVICE = "cuda" if torch.cuda.is_available() else "cpu"
ROUNDED = 5e-7  # an observation rounds to float32, by one unit of which two devices may differ
SAME = 0.0 if DEVICE == "cpu" else ROUNDED
CASES = {
    "rest_to_rest": {"duration": 0.5},
    "reach": {"duration": 1.0},
    "reach_goal": {"duration": 1.0},
    "track": {"duration": 2.0, "rounds": 1},
    "damp": {"duration": 1.0},
    "free_flyer": {"duration": 1.0},
    "lqr": {"duration": 1.0},
    "pose_reach": {"duration": 1.0},
}


def pair(task, precision="float64", **settings):
    """The same task on the device, and in NumPy and the kernel."""
    ours = DeviceVectorEnv(N, task, device=DEVICE, starts=12, precision=precision, **settings)
    theirs = VesVectorEnv(N, task, autoreset_mode="SameStep", threads=1, **settings)
    if theirs.task.tail:
        theirs.batch.free_decay.exact = True  # as on the device
    return ours, theirs


def on_host(told):
    """What a step tells, as tensors of the host; its dictionary too."""
    *tensors, info = told
    return *(k.cpu() for k in tensors), {
        k: v.cpu() if torch.is_tensor(v) else v for k, v in info.items()
    }


def compare(ours, theirs, tolerance=1e-9, seed=5):
    """Two episodes and a bit under the same actions, some out of bounds; how many ended."""
    seen, _ = ours.reset(seed=seed)
    wanted, _ = theirs.reset(seed=seed)
    np.testing.assert_allclose(seen.cpu(), wanted, rtol=0, atol=SAME)
    rng, ended = np.random.default_rng(0), 0
    for k in range(2 * ours.task.steps + 5):
        action = rng.uniform(-1.3, 1.3, (N, ours.single_action_space.shape[0]))
        if k > ours.task.steps:
            action[:2] = 1.0  # pushes on, to a joint limit if there is time
        seen, reward, *over, info = on_host(ours.step(torch.from_numpy(action).to(DEVICE)))
        wanted, reference, *ends, known = theirs.step(action)
        np.testing.assert_allclose(seen, wanted, rtol=0, atol=max(tolerance, ROUNDED))
        np.testing.assert_allclose(reward, reference, rtol=tolerance, atol=tolerance)
        np.testing.assert_array_equal(over, ends)
        np.testing.assert_array_equal(info["success"], known["success"])
        if "final_obs" in known:
            rows = known["_final_obs"]
            np.testing.assert_array_equal(info["_final_obs"], rows)
            final = info["final_obs"][rows], known["final_obs"][rows]
            np.testing.assert_allclose(*final, rtol=0, atol=max(tolerance, ROUNDED))
            energies = (k["energy/E_mean"][rows] for k in (info, known))
            np.testing.assert_allclose(*energies, rtol=max(tolerance, 1e-8))
            ended += rows.sum()
    return ended


def test_episodes_are_those_of_the_vector_environment():
    """Ends, beginnings, energies after the deadline: rest to rest, two episodes."""
    ours, theirs = pair("rest_to_rest", **CASES["rest_to_rest"])
    assert compare(ours, theirs) >= 2 * N
    first, _ = ours.reset(seed=5)
    again, _ = theirs.reset(seed=5)
    np.testing.assert_allclose(first.cpu(), again, rtol=0, atol=SAME)


@pytest.mark.slow
@pytest.mark.parametrize("task", [k for k in CASES if k != "rest_to_rest"])
def test_every_ideal_task(task):
    assert compare(*pair(task, **CASES[task])) >= 2 * N


@pytest.mark.slow
@pytest.mark.parametrize(
    ("task", "settings"),
    [
        ("damp", {"control": "pd_gains", "duration": 1.0}),
        ("reach", {"control": "torque", "duration": 0.5}),
        ("rest_to_rest", {"system": {"drive": "prescribed"}, "duration": 0.5}),
        (
            "rest_to_rest",
            {
                "effects": [
                    {"kind": "joint/viscous", "damping": [3.0, 3.0, 3.0]},
                    {"kind": "payload/mass", "mass": 2.0},
                ],
                "duration": 0.5,
            },
        ),
    ],
)
def test_controls_drives_and_effects(task, settings):
    assert compare(*pair(task, **settings)) >= 2 * N


@pytest.mark.slow
def test_single_precision():
    assert compare(*pair("rest_to_rest", "float32", duration=0.5), tolerance=2e-3) >= 2 * N


def test_tensors_are_the_device_s_memory():
    """No copy between Warp and torch; what was handed out is the caller's."""
    env = DeviceVectorEnv(3, "rest_to_rest", device=DEVICE, starts=3, duration=0.5)
    rows = env.rows
    assert rows.view(rows.simulations.x).data_ptr() == rows.simulations.x.ptr
    first, _ = env.reset(seed=1)
    kept = first.clone()
    seen, reward, *_ = env.step(torch.ones((3, 3), device=DEVICE))
    after = seen.clone(), reward.clone()
    env.step(torch.ones((3, 3), device=DEVICE))
    assert torch.equal(first, kept)
    assert torch.equal(seen, after[0])
    assert torch.equal(reward, after[1])


def test_beginnings_go_round():
    """With one each, simulation i then begins as i + 1 did, and in the end as at first."""
    env = DeviceVectorEnv(3, "rest_to_rest", device=DEVICE, starts=1, duration=0.5)
    first, _ = env.reset(seed=1)
    second, _ = env.reset()
    assert torch.equal(second, first.roll(-1, 0))
    env.reset()
    assert torch.equal(env.reset()[0], first)
    assert not torch.equal(env.reset(seed=2)[0], first)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"mode": "emulated"}, "needs mode ideal, got emulated"),
        ({"randomize": {"payload/mass": {"mass": [0.1, 1.0]}}}, "no randomised effects"),
        ({"precision": "float16"}, "precision must be float64 or float32, got 'float16'"),
        ({"effects": [{"kind": "command/delay", "delay": 0.02}]}, "no delays of the joints"),
        ({"task": "payload_transfer"}, "no payloads, contact, wheels or jets"),
        ({"task": "servicer_capture"}, "no payloads, contact, wheels or jets"),
        ({"starts": 0}, "starts must be a whole number >= 1, got 0"),
        ({"spam": 1}, "unexpected keyword argument 'spam'"),
    ],
)
def test_what_it_cannot_do_is_refused(settings, message):
    with pytest.raises(ParameterError, match=message):
        DeviceVectorEnv(2, **{"task": "rest_to_rest", "device": DEVICE, **settings})


def test_misuse_is_refused():
    env = DeviceVectorEnv(2, "rest_to_rest", device=DEVICE, starts=2, duration=0.5)
    with pytest.raises(Exception, match="call reset before step"):
        env.step(torch.zeros((2, 3), device=DEVICE))
    env.reset(seed=0)
    with pytest.raises(ParameterError, match=r"actions must have shape \(2, 3\), got \(2, 4\)"):
        env.step(torch.zeros((2, 4), device=DEVICE))
    with pytest.raises(ParameterError, match="no options"):
        env.reset(options={"q": 0})


@pytest.mark.slow
def test_a_policy_learns_on_the_device():
    """PPO on BeamLQR, 100,000 steps: the mean cost falls to less than half."""
    from benchmarks.device_ppo import Settings, train

    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # small matrices: more threads wait for each other
    try:
        settings = {"starts": 4, "precision": "float32", "duration": 1.0}
        env = DeviceVectorEnv(64, "lqr", device=DEVICE, **settings)
        _, progress = train(env, 40, settings=Settings(horizon=40))
    finally:
        torch.set_num_threads(threads)
    returns = [k for k in progress.returns if np.isfinite(k)]  # episodes of two horizons
    assert returns[-1] > 0.5 * returns[0]
    assert progress.steps == 40 * 40 * 64
