"""Files that are damaged: what every reader makes of them. Seeded, so that a fault comes again.

    python -m tests.fuzz [--count 20000] [--seed 0] [--only urdf,mat]

A good file of each kind is damaged a little, over and over: bytes, numbers, names and whole
parts are changed, left out, put twice or moved. A reader may take what comes out, or refuse it
in one sentence (`ParameterError`, `RunLogError`); any other error is a fault, and so are 12 s.
"""

from __future__ import annotations

import argparse
import hashlib
import io
import random
import re
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import scipy.io
import scipy.sparse

import ves_gym as vg
from tests import ros_logs
from ves_gym._util.optional import lacking
from ves_gym._util.params import ParameterError, write_table
from ves_gym._util.recordings import read_columns
from ves_gym.baselines import read_episodes
from ves_gym.baselines.checkpoint import load_state, save_state
from ves_gym.baselines.config import CONFIGS, read_config
from ves_gym.baselines.dataset import Recipe, make_dataset
from ves_gym.baselines.minari_files import PACKAGES, write_dataset
from ves_gym.baselines.policy import RELEASED, load_policy
from ves_gym.experiments.spec import read_spec
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.arm_library import get_arm
from ves_gym.mechanics.matrix_files import read_matrices
from ves_gym.mechanics.meshes import read_mesh
from ves_gym.planners.case import Case, load_case
from ves_gym.planners.obstacles import read_surroundings
from ves_gym.system.runlog import RunLog, RunLogError
from ves_gym.system.system import System

LIMIT = 12.0  # s
Damage = Callable[[bytes, random.Random], bytes]
Kind = tuple[list[Path], Callable[[Path], Any]]  # files that are damaged, reader of the first

_NUMBERS = (
    b"0",
    b"-1",
    b"nan",
    b"inf",
    b"1e308",
    b"-1e-320",
    b"4294967296",
    b"1e",
    b"0x1",
    b"",
)
_TOKEN = re.compile(rb"[A-Za-z_]+|-?\d+\.?\d*(?:[eE][+-]?\d+)?|\s+|.", re.DOTALL)


def _bytes(data: bytes, rng: random.Random) -> bytes:
    out = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 8))):
        out[rng.randrange(len(out))] = rng.choice((0, 10, 34, 60, 127, 255, rng.randrange(256)))
    return bytes(out)


def _cut(data: bytes, rng: random.Random) -> bytes:
    return data[: rng.randrange(len(data))]


def _moved(data: bytes, rng: random.Random) -> bytes:
    a, b, c = sorted(rng.randrange(len(data)) for _ in range(3))
    part = data[a:b]
    return rng.choice(
        (data[:a] + data[b:], data[:b] + part + data[b:], data[:c] + part + data[c:])
    )


def _number(data: bytes, rng: random.Random) -> bytes:
    found = list(re.finditer(rb"-?\d+\.?\d*(?:[eE][+-]?\d+)?", data))
    if not found:
        return _bytes(data, rng)
    for one in sorted(
        rng.sample(found, min(len(found), rng.choice((1, 2)))), key=lambda m: -m.start()
    ):
        data = data[: one.start()] + rng.choice(_NUMBERS) + data[one.end() :]
    return data


def _words(data: bytes, rng: random.Random) -> bytes:
    words = _TOKEN.findall(data)
    at, other = rng.randrange(len(words)), rng.randrange(len(words))
    if rng.random() < 0.5:
        words[at] = words[other]
    else:
        words[at : at + rng.choice((1, 2, 5))] = []
    return b"".join(words)


def _integers(data: bytes, rng: random.Random) -> bytes:
    """Sizes and offsets of binary files."""
    at = rng.randrange(max(1, min(len(data) - 8, 4096)))
    value = rng.choice((0, 1, 0x7FFFFFFF, 0xFFFFFFFF, 1 << 20, 1 << 31, rng.randrange(1 << 32)))
    return data[:at] + value.to_bytes(4, rng.choice(("little", "big"))) + data[at + 4 :]


DAMAGES: tuple[Damage, ...] = (_bytes, _cut, _moved, _number, _words, _integers)


def kinds(root: Path) -> dict[str, Kind]:
    """Good files of every kind that is read, small ones, and their readers."""
    out: dict[str, Kind] = {}

    def file(name: str, data: bytes | str) -> Path:
        path = root / name
        path.write_bytes(data if isinstance(data, bytes) else data.encode())
        return path

    arm = get_arm("ur5e")
    arm.to_urdf(root / "a.urdf")
    arm.to_mjcf(root / "a.xml")
    out["urdf"] = [root / "a.urdf"], Arm.from_file
    out["mjcf"] = [root / "a.xml"], Arm.from_file
    write_table(root / "arm.toml", get_arm("puma560"))
    out["arm"] = [root / "arm.toml"], get_arm
    System().save(root / "system.toml")
    out["system"] = [root / "system.toml"], System.load
    eye = scipy.sparse.csc_array(np.diag(np.arange(1.0, 8.0)))
    buffer = io.BytesIO()
    scipy.io.mmwrite(buffer, eye, symmetry="symmetric")
    out["mtx"] = [file("K.mtx", buffer.getvalue())], read_matrices
    np.savez(root / "K.npz", K=eye.toarray(), M=eye.toarray())
    out["npz"] = [root / "K.npz"], read_matrices
    out["sti"] = (
        [file("K.sti", "".join(f"{k} {k} {k}.5\n" for k in range(1, 8)))],
        read_matrices,
    )
    entries = "".join(
        f"DMIG*   K       {k:16d}{1:16d}\n*       {k:16d}{1:16d}{k + 0.5:16.9E}\n"
        for k in range(1, 8)
    )
    out["pch"] = (
        [file("K.pch", f"DMIG    K       0       6       2       0\n{entries}")],
        read_matrices,
    )
    scipy.io.savemat(root / "log.mat", {"q1": np.linspace(0, 1, 40), "dq1": np.ones((40, 1))})
    out["mat"] = [root / "log.mat"], read_columns
    rows = "".join(f"{k * 0.01:.2f},{k}.5,{k * 2}.25\n" for k in range(30))
    out["csv"] = [file("log.csv", "t,q1,tau1\n" + rows)], read_columns
    if not lacking("", "rosbags"):
        t = 0.01 * np.arange(30)
        for storage, kind in (("MCAP", "mcap"), ("SQLITE3", "db3")):
            series = ros_logs.joints("/joint_states", t, "ab", np.stack([t, t], 1))
            written = ros_logs.write(root / kind, series, storage=storage)
            out[kind] = [written], read_columns
    scipy.io.hb_write(root / "K.hb", scipy.sparse.csc_matrix(eye))
    out["hb"] = [root / "K.hb"], read_matrices
    corners = b"vertex 0 0 1\nvertex 1 0 0\nvertex 0 1 0\n"
    facet = b"facet normal 0 0 1\nouter loop\n" + corners + b"endloop\nendfacet\n"
    stl = b"solid m\n" + facet * 3 + b"endsolid m\n"
    out["stl"] = [file("m.stl", stl)], read_mesh
    binary = (
        bytes(80) + (2).to_bytes(4, "little") + np.arange(24, dtype="<f4").tobytes() + bytes(4)
    )
    out["stl-binary"] = [file("b.stl", binary)], read_mesh
    out["obj"] = [file("m.obj", "v 0 0 1\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")], read_mesh
    head = b"ply\nformat binary_little_endian 1.0\nelement vertex 3\n"
    head += b"".join(b"property float %c\n" % k for k in b"xyz") + b"end_header\n"
    out["ply"] = [file("m.ply", head + np.arange(9, dtype="<f4").tobytes())], read_mesh
    out["dae"] = [file("m.dae", _DAE)], read_mesh
    plan = vg.plan([0, 0, 0], [0.2, 0.1, -0.1], duration=1.0, planner="straight")
    Case(query=plan.query, motion=plan.motion).save(root / "case.toml")
    out["case"] = [root / "case.toml"], load_case
    log = vg.simulate(plan.motion, record_dt=0.05)
    log.save(root / "run.csv")
    out["runlog-csv"] = [root / "run.csv", root / "run.json"], RunLog.load
    if not lacking("", "pyarrow"):
        log.save(root / "run.parquet")
        out["runlog-parquet"] = [root / "run.parquet"], RunLog.load
    config = next(iter(sorted(CONFIGS.glob("*.toml"))))
    out["config"] = [file("config.toml", config.read_bytes())], read_config
    out["spec"] = [file("sweep.toml", _SWEEP)], read_spec
    policy = next(RELEASED.glob("PumaDamp/*.json"))
    files = [
        file("p.json", policy.read_bytes()),
        file("p.safetensors", policy.with_suffix(".safetensors").read_bytes()),
    ]
    out["policy"] = files, load_policy
    save_state(root / "c.safetensors", {"a": np.arange(6.0), "b": [System(), (1, "x")]})
    out["checkpoint"] = [root / "c.safetensors"], load_state
    out["obstacles"] = [file("o.toml", _OBSTACLES)], read_surroundings
    if not any(lacking("", name) for name in PACKAGES):
        about: dict[str, Any] = {"id": "ves/X-v0/a-v0", "env": "ves/PumaDamp-v0", "seed": 0}
        recipe = Recipe(**about, behaviours=("random",), episodes=1)
        made = write_dataset(make_dataset(recipe), root) / "data"
        parts = [made / "main_data.hdf5", made / "metadata.json"]
        out["dataset"] = parts, lambda path: read_episodes(path.parent)
    return out


_DAE = """<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit meter="0.5"/></asset><library_geometries><geometry id="g"><mesh><source id="s">
<float_array id="a" count="9">0 0 1 1 0 0 0 1 0</float_array><technique_common>
<accessor source="#a" count="3" stride="3"><param name="X" type="float"/>
<param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common>
</source><vertices id="v"><input semantic="POSITION" source="#s"/></vertices>
<triangles count="1"><input semantic="VERTEX" source="#v" offset="0"/><p>0 1 2</p></triangles>
</mesh></geometry></library_geometries><library_visual_scenes><visual_scene id="w"><node>
<translate>1 0 0</translate><rotate>0 0 1 90</rotate><node><instance_geometry url="#g"/></node>
</node></visual_scene></library_visual_scenes><scene><instance_visual_scene url="#w"/></scene>
</COLLADA>"""
_SWEEP = """seconds = 10
[[evaluate]]
envs = ["PumaDamp-v0"]
policies = ["hold"]
seeds = [0, 1]
episodes = 2
"""
_OBSTACLES = """clearance = 0.05
[[obstacles]]
kind = "sphere"
centre = [0.3, 0.2, 0.1]
radius = 0.1
"""


def _signed(root: Path) -> None:
    """A policy's file that names its weights as they are now."""
    table = root / "p.json"
    digest = hashlib.sha256((root / "p.safetensors").read_bytes()).hexdigest().encode()
    table.write_bytes(re.sub(rb'"[0-9a-f]{64}"', b'"' + digest + b'"', table.read_bytes()))


def damaged(root: Path, files: list[Path], rng: random.Random) -> Path:
    """A copy of a kind's files in a folder, one of them damaged; the path of the first."""
    hit = rng.randrange(len(files))
    for k, file in enumerate(files):
        data = file.read_bytes()
        for _ in range(rng.choice((1, 1, 1, 3)) if k == hit else 0):
            data = rng.choice(DAMAGES)(data, rng) if data else data
        (root / file.name).write_bytes(data)
    if files[0].name == "p.json" and rng.random() < 0.5:
        _signed(root)
    return root / files[0].name


def faults(
    count: int, seed: int, only: list[str] | None = None
) -> Iterator[tuple[str, str, int]]:
    """Kind, what went wrong, and number of each damaged file that is no sentence."""
    with tempfile.TemporaryDirectory() as folder:
        good, bad = Path(folder) / "good", Path(folder) / "bad"
        good.mkdir(), bad.mkdir()
        every = kinds(good)
        names = [name for name in every if not only or name in only]
        for name in names:
            every[name][1](every[name][0][0])  # the good file is read
        for number in range(count):
            name = names[number % len(names)]
            files, read = every[name]
            path = damaged(bad, files, random.Random(f"{seed} {number}"))
            begin = time.monotonic()
            try:
                read(path)
            except (ParameterError, RunLogError) as error:
                if "\n" in str(error) or len(str(error)) > 2000:
                    yield name, f"no sentence: {str(error)[:200]!r}", number
            except Exception as error:
                where = traceback.extract_tb(error.__traceback__)[-1]
                at = f"{Path(where.filename).name}:{where.lineno}"
                yield name, f"{type(error).__name__}: {error} ({at})", number
            if time.monotonic() - begin > LIMIT:
                yield name, f"{time.monotonic() - begin:.0f} s", number


def main() -> None:
    """Damage, read, and tell what is no sentence."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", type=lambda text: text.split(","))
    args = parser.parse_args()
    found: Counter[tuple[str, str]] = Counter()
    for name, what, number in faults(args.count, args.seed, args.only):
        short = re.sub(r"[\d.]+", "#", what)[:90]
        if not found[name, short]:
            print(f"{number:6d} {name}: {what[:300]}", flush=True)
        found[name, short] += 1
    print(f"{args.count} files, {sum(found.values())} faults of {len(found)} kinds")


if __name__ == "__main__":
    main()
