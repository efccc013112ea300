"""Physics and environment steps a second on a GPU, n = 1,024 to 65,536, and PPO fed from them.

`python -m benchmarks.gpu` on a machine with a GPU: our kernel against MuJoCo Warp where
it is installed (`pip install mujoco-warp`), on a base of one body, and alone on `bent` with
its internal modes. Without a GPU it says so and runs few simulations on Warp's CPU device,
against the kernel.
"""

from __future__ import annotations

import argparse
import importlib
import json
import math
import time
import warnings
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.device_ppo import Progress, train
from ves_gym._util.mujoco_loader import mujoco
from ves_gym._util.optional import installed, lacking
from ves_gym.engine.backends import make_backend
from ves_gym.engine.backends.base import BackendWarning
from ves_gym.engine.backends.mujoco import compile_model
from ves_gym.engine.kernel.warp_code import load_warp
from ves_gym.engine.mjcf import TO_Y
from ves_gym.envs.device import DeviceVectorEnv
from ves_gym.mechanics.vehicle import BENT_THESIS
from ves_gym.system.system import System

SIZES = (1_024, 4_096, 16_384, 65_536)
FEW = (64, 256)  # without a GPU
PERIODS = 20  # control periods that are timed at once
RUNS = 5
STIFFNESS, DAMPING = 1000.0, 30.0  # of the joints' servos [N m/rad], [N m s/rad]
FIRST = 10  # periods whose copies are counted


def starts(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates and rates (n, 9) of n simulations: base pose, joint angles."""
    start = np.random.default_rng(0).uniform(-0.1, 0.1, (4, n, 6))
    z = np.hstack([0.1 * start[0], start[1, :, :3]])
    return z, np.hstack([start[2], start[3, :, :3]])


def engine(name: str, system: System, n: int) -> Any:
    """An engine whose n simulations stand in states of their own, joints held by servos."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BackendWarning)
        backend: Any = make_backend(name, system, n, 0)
    backend.write(np.arange(n), np.zeros(n), *starts(n))
    backend.set_gains(np.arange(n), np.full((n, 3), STIFFNESS), np.full((n, 3), DAMPING))
    return backend


def ours(name: str, system: System, n: int) -> Callable[[], None]:
    """PERIODS launches of a control period, everything on the device."""
    backend = engine(name, system, n)
    simulations = backend.simulations
    u = simulations.array(np.zeros((backend._nu, n)))
    backend.step_sequence(np.zeros((n, 2, 3)), None)  # hands the parameters over

    def work() -> None:
        for _ in range(PERIODS):
            backend.advance(u, system.substeps)
        simulations.wp.synchronize_device(simulations.device)

    return work


def mujoco_warp(system: System, n: int) -> Callable[[], None]:
    """The same steps of MuJoCo Warp, a control period captured as a CUDA graph."""
    wp, package = load_warp(), importlib.import_module("mujoco_warp")
    host = compile_model(system)
    order = np.r_[TO_Y, 6 + np.arange(system.arm.n)]
    drives = slice(host.nu - system.arm.n, None)
    host.actuator_biasprm[drives, 1], host.actuator_biasprm[drives, 2] = -STIFFNESS, -DAMPING
    # there is no automatic reset to switch off
    host.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    model, data = package.put_model(host), package.make_data(host, nworld=n)
    for target, values in zip((data.qpos, data.qvel), starts(n), strict=True):
        placed = np.zeros(values.shape, np.float32)
        placed[:, order] = values
        target.assign(placed)
    for _ in range(3):
        package.step(model, data)  # compiles
    with wp.ScopedCapture() as capture:
        for _ in range(system.substeps):
            package.step(model, data)

    def work() -> None:
        for _ in range(PERIODS):
            wp.capture_launch(capture.graph)
        # by `data` the arrays live on: a graph holds no more than their addresses
        wp.synchronize_device(data.qpos.device)

    return work


def kernel(system: System, n: int) -> Callable[[], None]:
    """The same steps of the kernel on all processors."""
    backend = engine("kernel", system, n)

    pieces = backend.pieces(backend._u, 1, system.substeps)

    def work() -> None:
        for _ in range(PERIODS):
            backend._run(pieces, system.substeps)

    return work


def steps_per_second(work: Callable[[], None], system: System, n: int) -> tuple[float, float]:
    """Median of RUNS, and the seconds of the first run, which compiles."""
    begin = time.perf_counter()
    work()
    first = time.perf_counter() - begin
    times = []
    for _ in range(RUNS):
        begin = time.perf_counter()
        work()
        times.append(time.perf_counter() - begin)
    return n * PERIODS * system.substeps / float(np.median(times)), first


def environment(n: int, device: str) -> tuple[float, float]:
    """Steps a second of PumaRestToRest, and how often a step copies to the host.

    Random actions; a whole episode and more, so that ends and beginnings are in it. Copies
    are counted in the first periods, where none ends, by torch's profiler, on a GPU only;
    expected: one, the number of episodes that ended. Where some did there are two more.
    """
    env = DeviceVectorEnv(n, "rest_to_rest", device=device, starts=2)
    env.reset(seed=0)
    actions = torch.rand((n, env.single_action_space.shape[0]), device=device) * 2 - 1
    steps = env.task.steps + PERIODS
    gpu = device != "cpu"

    def work() -> None:
        for _ in range(steps):
            env.step(actions)
        if gpu:
            torch.cuda.synchronize()

    work()  # compiles and captures
    begin = time.perf_counter()
    work()
    rate = n * steps / (time.perf_counter() - begin)
    if not gpu:
        return rate, math.nan
    activities = [torch.profiler.ProfilerActivity.CUDA]
    env.reset(seed=0)
    with torch.profiler.profile(activities=activities) as profile:
        for _ in range(FIRST):
            env.step(actions)
        torch.cuda.synchronize()
    copied = sum("Memcpy DtoH" in e.name for e in profile.events()) / FIRST
    print(f"           {copied:.1f} copies to the host per step in which no episode ends")
    return rate, copied


def training(n: int, device: str, updates: int) -> Progress:
    """PPO on PumaDamp for some updates."""
    env = DeviceVectorEnv(n, "damp", device=device, starts=2, precision="float32")
    train(env, 1)  # compiles and captures
    return train(env, updates)[1]


def report(sizes: tuple[int, ...]) -> dict[str, Any]:
    """Measure and print."""
    system, whole, results = System(vehicle=BENT_THESIS), System(), {}
    wp = load_warp()
    device = wp.get_device()
    print(f"Warp {wp.config.version}, {device.name if device.is_cuda else 'CPU device'}")
    where = str(wp.device_to_torch(device))
    foreign = device.is_cuda and installed("mujoco_warp")
    if device.is_cuda and not foreign:
        print("mujoco-warp is not installed: nothing to compare with")
    for n in sizes:
        row: dict[str, float] = {}
        for name in ("gpu-kernel", "gpu-kernel-float32"):
            row[name], first = steps_per_second(ours(name, system, n), system, n)
            row[f"{name} first"] = first
        row["gpu-kernel, bent"], _ = steps_per_second(ours("gpu-kernel", whole, n), whole, n)
        if foreign:
            work = mujoco_warp(system, n)
            row["mujoco warp"], row["mujoco warp first"] = steps_per_second(work, system, n)
        if not device.is_cuda:
            row["kernel"], _ = steps_per_second(kernel(system, n), system, n)
        rates = ", ".join(f"{k} {v:,.0f}" for k, v in row.items() if "first" not in k)
        print(f"n = {n:<6} physics steps/s: {rates}")
        if foreign:
            double, single = (
                row[k] / row["mujoco warp"] for k in ("gpu-kernel", "gpu-kernel-float32")
            )
            print(
                f"           {double:.1f} x MuJoCo Warp in float64, {single:.1f} x in float32"
            )
        row["environment"], row["copies"] = environment(n, where)
        print(f"           {row['environment']:,.0f} environment steps/s (PumaRestToRest)")
        results[f"n{n}"] = row
    progress = training(sizes[-1], where, 20)
    results["ppo"] = asdict(progress)
    share = progress.stepping / progress.seconds
    print(
        f"PPO on PumaDamp, n = {sizes[-1]}: {progress.steps / progress.seconds:,.0f} steps/s,"
        f" {100 * share:.0f} % of the time in env.step"
    )
    return results


def main() -> None:
    """Measure, print, and write JSON when asked."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    args = parser.parse_args()
    missing = lacking("the benchmark", "warp")
    if missing:
        raise SystemExit(missing)
    there = load_warp().is_cuda_available()
    if not there:
        torch.set_num_threads(1)  # small matrices: more threads wait for each other
        print(f"no GPU: n = {' and '.join(map(str, FEW))} on Warp's CPU device, one thread")
    results = report(SIZES if there else FEW)
    if args.json:
        args.json.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
