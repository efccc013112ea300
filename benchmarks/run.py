"""`make bench`: every timing of docs/claims.md in one run, as ratios."""

from __future__ import annotations

import argparse
import itertools
import json
import os
import platform
from dataclasses import asdict
from pathlib import Path

from benchmarks import environments, kernel, resets, startup, training
from benchmarks.coupling import COUNT, coupling_against_loop
from benchmarks.laboratory import SYSTEMS, emulated_against_ideal
from benchmarks.simulator import simulator_against_batch, steps_per_second
from benchmarks.sweep import overhead


def main() -> None:
    """Measure, print, and write JSON when asked."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    args = parser.parse_args()
    print(
        f"{platform.machine()}, {os.cpu_count()} processors, Python {platform.python_version()}"
    )
    results = {}
    for n in (1, 256):
        pair = simulator_against_batch(n)
        results[f"simulator_n{n}"] = asdict(pair)
        print(
            f"Simulator n = {n:<4} {pair.ratio:5.2f} of bare batch physics"
            f" ({pair.low:.2f}-{pair.high:.2f}), {steps_per_second(n, pair):,.0f} steps/s"
        )
    for backend, n, name in itertools.product(("mujoco", "kernel"), (1, 256), SYSTEMS):
        pair = emulated_against_ideal(name, n, backend)
        kind = name.replace(", ", "_").replace(" ", "_")
        results[f"emulated_{kind}_{backend}_n{n}"] = asdict(pair)
        print(
            f"emulated n = {n:<4} {pair.ratio:5.2f} of ideal mode"
            f" ({pair.low:.2f}-{pair.high:.2f}), {name}, {backend}"
        )
    for n, threads in ((256, 1), (256, 2)):
        pair = kernel.bare_physics(n, threads)
        results[f"kernel_n{n}_threads{threads}"] = asdict(pair)
        print(
            f"kernel n = {n:<4}   {pair.ratio:5.1f} x bare batch physics of MuJoCo,"
            f" {threads} thread(s) ({pair.low:.1f}-{pair.high:.1f}),"
            f" {kernel.steps_per_second(n, pair.ours):,.0f} steps/s"
        )
    for n in (1, 256):
        pair = kernel.simulator(n)
        results[f"kernel_simulator_n{n}"] = asdict(pair)
        print(
            f"kernel n = {n:<4}   {pair.ratio:5.1f} x MuJoCo under Simulator.step"
            f" ({pair.low:.1f}-{pair.high:.1f}),"
            f" {kernel.steps_per_second(n, pair.ours):,.0f} steps/s"
        )
    pair = kernel.emulated(256)
    results["kernel_emulated_n256"] = asdict(pair)
    print(
        f"kernel n = 256    {pair.ratio:5.1f} x MuJoCo under Simulator.step, emulated"
        f" ({pair.low:.1f}-{pair.high:.1f})"
    )
    first = kernel.first_simulator()
    results["kernel_first"] = first
    print(
        f"kernel, first     {first['cold']:.2f} s compiled,"
        f" {first['cached']:.3f} s from the cache"
    )
    cost = {p: kernel.sensitivities(p) for p in (1, 8, 16)}
    results["kernel_sensitivities"] = cost
    words = ", ".join(f"{value:.1f} rollouts for p = {p}" for p, value in cost.items())
    print(f"kernel, derivatives along p parameters: {words}")
    pair = coupling_against_loop()
    results["coupling"] = asdict(pair)
    print(
        f"Q(q)             {pair.ratio:5.1f} x a loop over pin.crba"
        f" ({pair.low:.1f}-{pair.high:.1f}), {COUNT / pair.ours:,.0f} Q/s"
    )
    results["environments"] = environments.report()
    results["resets"] = resets.report(list(resets.ROWS))
    results["training"] = training.report()
    results["startup"] = startup.report()
    swept = overhead()
    results["sweep"] = asdict(swept) | {"efficiency": swept.efficiency}
    print(
        f"sweep            {swept.efficiency:5.3f} of ideal: {swept.jobs} jobs of 1 s on"
        f" {swept.workers} workers"
    )
    if args.json:
        args.json.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
