"""Record or check: `python -m tests.golden record|check NAME...`, see the package."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence

from tests.golden.stored import ROOMS, every_probe, judge, measure, probes, stored, write


def chosen(words: Sequence[str]) -> list[str]:
    """Return the names of probes that are asked for: by name, part of one, room, or "all"."""
    names = every_probe()
    if "all" in words:
        return list(names)
    return [
        name
        for name, (room, _) in names.items()
        if any(word == room or word in name for word in words)
    ]


def record(names: Sequence[str]) -> None:
    """Store what the probes measure now; those that are gone lose their results."""
    for room in ROOMS:
        results = dict(stored(room))
        for name in (k for k in names if k in probes(room)):
            begun = time.process_time()
            results[name] = measure(probes(room)[name])
            print(f"{time.process_time() - begun:6.1f} s {name}", flush=True)
            write(room, results)
        if results:
            write(room, results)


def check(names: Sequence[str]) -> int:
    """Print the largest difference of every probe; return how many are not permitted."""
    refused, largest = 0, 0.0
    for name in names:
        room, probe = every_probe()[name]
        begun = time.process_time()
        deviation = judge(probe, stored(room)[name], measure(probe))
        refused += not deviation.permitted
        largest = max(largest, deviation.size)
        verdict = "" if deviation.permitted else "  DIFFERS"
        taken = time.process_time() - begun
        print(
            f"{deviation.size:8.1e} {taken:5.1f} s {name} {deviation.where}{verdict}",
            flush=True,
        )
    print(f"{len(names)} probes, {refused} differ, largest {largest:.1e}")
    return refused


def main(words: Sequence[str]) -> int:
    """See the module's docstring."""
    if not words or words[0] not in ("record", "check"):
        print(__doc__, file=sys.stderr)
        return 2
    names = chosen(words[1:] or ["all"])
    if words[0] == "check":
        return int(check(names) > 0)
    record(names)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
