"""A cache of what the machine's parts answered, so that a diagnosis that was interrupted
resumes: fits and signatures then ask nothing twice.

One file per question, named by the SHA-256 of the question: a checksum and an array, no
code. A file that is damaged counts as absent.
"""

from __future__ import annotations

import contextlib
import hashlib
import inspect
import io
import shutil
import zlib
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from ves_gym._util.params import Array, canonical_json, content_hash
from ves_gym.diagnosis.data.measured_run import Run
from ves_gym.diagnosis.inference.whitened_residuals import Wander, WhitenedResiduals
from ves_gym.diagnosis.machines.base import Machine
from ves_gym.system.effect import EFFECTS

FOLDER = "unfinished"
# subpackages that say what an answer is
_SOURCES = (
    "_util",
    "mechanics",
    "hardware",
    "system",
    "effects",
    "engine",
    "simulation",
    "diagnosis",
)


class AnswerCache:
    """Answers of one diagnosis, in a folder of their own.

    Args:
        folder: where results go; answers lie in `unfinished/` there until it is done.
        about: plain data that tells this diagnosis from others.
    """

    def __init__(self, folder: Path, about: Any) -> None:
        mark = content_hash([about, source_digest()])
        self.folder = folder / FOLDER / mark[:16]
        self.n_restored = len(list(self.folder.glob("*.bin")))  # answers there from before

    def get(self, key: str) -> Array | None:
        """The answer to a question, if it is there and whole."""
        try:
            data = (self.folder / f"{key}.bin").read_bytes()
        except OSError:
            return None
        if len(data) < 4 or zlib.crc32(data[4:]) != int.from_bytes(data[:4], "little"):
            return None
        return np.asarray(np.load(io.BytesIO(data[4:]), allow_pickle=False))

    def put(self, key: str, answer: Array) -> None:
        """Write an answer (array) under its key; half of a file counts as none."""
        buffer = io.BytesIO()
        np.save(buffer, answer, allow_pickle=False)
        data = buffer.getvalue()
        self.folder.mkdir(parents=True, exist_ok=True)
        (self.folder / f"{key}.bin").write_bytes(zlib.crc32(data).to_bytes(4, "little") + data)

    def done(self) -> None:
        """Delete the answers: all results are written elsewhere."""
        shutil.rmtree(self.folder, ignore_errors=True)
        with contextlib.suppress(OSError):  # another diagnosis is unfinished there
            self.folder.parent.rmdir()


class CachedResiduals(WhitenedResiduals):
    """Whitened residuals whose questions to the machine are answered once."""

    def __init__(
        self,
        machine: Machine,
        runs: Sequence[Run],
        seed: int,
        cache: AnswerCache,
        slow: Mapping[str, Wander] | None = None,
    ) -> None:
        self._cache = cache
        self._name = content_hash(
            [
                seed,
                [digest_of(run) for run in runs],
                {k: (w.share, w.memory) for k, w in (slow or {}).items()},
            ]
        )
        super().__init__(machine, runs, seed, slow)

    def at_port(self, port: str, models: Sequence[Any]) -> Array:
        """Return as `WhitenedResiduals.at_port`, from the cache where it is there."""
        about = ("residual", port, f"{self.scale!r}", *map(canonical_json, models))
        return self._once(about, lambda: WhitenedResiduals.at_port(self, port, models))

    def _once(self, about: Sequence[str], compute: Callable[[], Array]) -> Array:
        key = hashlib.sha256("\n".join((self._name, *about)).encode()).hexdigest()
        answer = self._cache.get(key)
        if answer is None:
            answer = compute()
            self._cache.put(key, answer)
        return answer


def digest_of(run: Run) -> str:
    """Return the SHA-256 of a run's signals, noise and jitter."""
    sha = hashlib.sha256(repr((run.dt, run.band, sorted(run.jitter.items()))).encode())
    for name, x in run.signals.items():
        noise = run.noise[name]
        sha.update(name.encode())
        for part in (x, noise.std, noise.correlation):
            sha.update(np.ascontiguousarray(part, "<f8").tobytes())
    return sha.hexdigest()


@cache
def source_digest() -> str:
    """Return the SHA-256 of the code that answers: any edit of it makes answers anew."""
    sha = hashlib.sha256()
    paths: list[Path] = []
    for name in _SOURCES:
        package = Path(str(files("ves_gym"))) / name
        paths += sorted(package.rglob("*.py"))
    user_defined = [
        cls for cls in EFFECTS.values() if not cls.__module__.startswith("ves_gym.")
    ]
    with contextlib.suppress(OSError, TypeError):  # of an effect typed in a console
        paths += sorted({Path(inspect.getfile(cls)) for cls in user_defined})
    for path in paths:
        sha.update(path.read_bytes())
    return sha.hexdigest()
