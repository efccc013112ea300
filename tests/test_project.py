"""What holds for the project as a whole: packaging, versions, links, imports."""

import ast
import importlib
import re
import runpy
import subprocess
import sys
import tomllib
from importlib.util import resolve_name
from pathlib import Path

import pytest

from scripts.marks import BLOCK

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "ves_gym"
LINKS = ("envs", "planners", "baselines")

# The rooms, ground floor first. Imports point to an earlier one.
ROOMS = (
    "_util", "mechanics", "hardware", "system", "effects", "engine", "simulation", "rendering",
    "envs", "planners", "damping", "diagnosis", "baselines", "experiments", "report",
    "leaderboard", "api", "cli",  # `api` is one file, beside the commands
)  # fmt: skip
LEVEL = {room: level for level, room in enumerate(ROOMS)}

# Loaded on first use. `import mujoco` brings its renderer and the window library along.
HEAVY = {
    "casadi", "glfw", "h5py", "imageio", "llvmlite", "matplotlib", "minari", "mujoco", "OpenGL",
    "ompl", "onnx", "onnxruntime", "optuna", "pandas", "PIL", "pinocchio", "pyarrow", "pyyeti",
    "robot_descriptions", "rosbags", "stable_baselines3", "tensorboard", "torch",
    "trimesh", "warp",
}  # fmt: skip


# ------------------------------------------------------------------ packaging


def declared() -> dict:
    with open(ROOT / "pyproject.toml", "rb") as file:
        return tomllib.load(file)["project"]


def test_the_conda_recipe_asks_for_what_the_package_asks_for():
    recipe = (ROOT / "conda" / "recipe.yaml").read_text()
    assert f"version: {declared()['version']}\n" in recipe
    run = re.search(r"  run:\n(.*?)\ntests:", recipe, re.DOTALL)[1]
    asked = {
        k.strip(" -").replace(" ", "").replace("mujoco-python", "mujoco")
        for k in run.splitlines()
    }
    needs = {k for k in declared()["dependencies"] if ";" not in k}  # ompl: not everywhere
    assert asked - {"python" + declared()["requires-python"]} == needs


KNOWN_GOOD = ("constraints.txt", "constraints-run.txt", "constraints-site.txt")


def known_good(file: str) -> dict[str, tuple[str, set[str]]]:
    """Name -> version and hashes of a file of known-good versions."""
    pinned = {}
    for requirement in (ROOT / file).read_text().replace("\\\n", " ").splitlines():
        name, version = re.match(r"([\w.-]+)==([\w.+!-]+)", requirement).groups()
        pinned[name] = version, set(re.findall(r"--hash=(\S+)", requirement))
    return pinned


@pytest.mark.parametrize("file", KNOWN_GOOD)
def test_known_good_versions_carry_hashes_and_no_address(file):
    text = (ROOT / file).read_text()
    assert not re.search(r"https?:|file:|://|^-", text, re.MULTILINE)

    requirements = text.replace("\\\n", " ").splitlines()
    assert len(requirements) > 20
    for requirement in requirements:
        assert re.match(r"[\w.-]+==[\w.+!-]+[ ;]", requirement), requirement[:80]
        assert re.search(r"--hash=sha256:[0-9a-f]{64}\b", requirement), requirement[:80]


def test_what_the_benchmark_needs_is_part_of_everything():
    everything, lean, site = (known_good(file) for file in KNOWN_GOOD)
    assert lean.items() <= everything.items() and lean.items() <= site.items()
    assert not {"sphinx", "furo", "myst-parser"} & {*everything, *lean}  # `make site` only

    project = declared()
    texts = [*project["dependencies"], *project["optional-dependencies"]["report"]]
    assert {re.match(r"[\w.-]+", text)[0] for text in texts} <= lean.keys()
    assert not {"torch", "triton", "pyarrow", "pin", "imageio-ffmpeg", "mypy"} & lean.keys()


def test_a_page_says_what_has_wheels_where():
    """Rows and columns are those that `make platforms` asks about, no cell is made up."""
    script = runpy.run_path(str(ROOT / "scripts" / "platforms.py"))
    table = dict(BLOCK.findall(script["PAGE"].read_text("utf-8")))[script["MARK"]].strip()
    head, _, *rows = [
        [k.strip() for k in row.strip("|").split("|")] for row in table.split("\n")
    ]
    assert head[1:] == list(script["PLATFORMS"])
    assert [row[0] for row in rows] == list(script["WHAT"])
    pythons = script["PYTHONS"]
    spans = {script["span"](list(pythons[i:j])) for i in range(4) for j in range(i, 5)}
    assert {cell for row in rows for cell in row[1:]} <= spans
    for what in script["WHAT"].values():
        assert script["requirements"](what)


@pytest.mark.parametrize("name", LINKS)
def test_top_level_link_points_to_the_subpackage(name):
    link = ROOT / name
    assert link.is_symlink(), f"{name} must be a link to ves_gym/{name}"
    assert link.readlink() == Path("ves_gym") / name
    assert link.is_dir(), f"{name} points to nothing"


# -------------------------------------------------------------------- imports


def test_import_stays_light():
    code = "import sys, ves_gym; print(*{name.partition('.')[0] for name in sys.modules})"
    result = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    )
    loaded = result.stdout.split()
    assert "ves_gym" in loaded
    assert not HEAVY & set(loaded)


def test_gymnasium_alone_knows_no_id_of_ours():
    """docs/install.md says so: since 1.0 Gymnasium has no plug-ins that it would load."""
    code = "import gymnasium, sys; print('ves_gym' in sys.modules)\ngymnasium.spec('ves/X-v0')"
    result = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True
    )
    assert result.stdout == "False\n"
    assert "NamespaceNotFound: Namespace ves not found." in result.stderr


@pytest.mark.parametrize(
    "name",
    [
        "PumaRestToRest",
        *(pytest.param(k, marks=pytest.mark.slow) for k in ("PoseReach", "PumaReachEmulated")),
    ],
)
def test_a_first_step_loads_little(name):
    """Of SciPy its linear algebra, whose rest takes a second; and few modules of all."""
    code = (
        "import sys, gymnasium as gym; before = set(sys.modules);"
        f"env = gym.make('ves_gym:ves/{name}-v0'); env.reset(seed=0);"
        "env.step(env.action_space.sample()); print(*(set(sys.modules) - before))"
    )
    for _ in range(2):  # the first compiles what is not in the cache yet
        result = subprocess.run(
            [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
        )
    loaded = result.stdout.split()
    heavy = {
        f"scipy.{part}" for part in ("interpolate", "optimize", "signal", "sparse", "stats")
    }
    assert not (heavy | HEAVY - {"llvmlite"}) & set(loaded)
    assert len(loaded) < 450


def imported(tree: ast.AST, package: str):
    """(line, absolute dotted name) of every import, those inside functions included."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            relative = "." * node.level + (node.module or "")
            base = resolve_name(relative, package)
            if base == "ves_gym":  # `from ves_gym import envs`
                yield from ((node.lineno, f"{base}.{alias.name}") for alias in node.names)
            else:
                yield node.lineno, base


def violations(source: str, path: str) -> list[str]:
    """Imports in one file, `path` from the root, that the import picture forbids."""
    place = path.split("/")[1]
    place = "api" if place == "api.py" else place
    if place in ("__init__.py", "__main__.py"):
        return []  # the front door may name anything; test_import_stays_light watches it
    if place not in LEVEL:
        return [f"{path}: {place} has no place in the import picture; add it to LEVEL"]

    found = []
    package = path.rpartition("/")[0].replace("/", ".")
    for line, name in imported(ast.parse(source, path), package):
        top, _, rest = name.partition(".")
        target = rest.partition(".")[0]
        if top in LINKS:
            found.append(f"{path}:{line}: imports a second copy: say ves_gym.{name}")
        elif top != "ves_gym" or target in ("", "__version__", place):
            continue
        elif target not in LEVEL:
            found.append(f"{path}:{line}: imports {name}; name the subpackage it is in")
        elif LEVEL[target] >= LEVEL[place]:
            found.append(f"{path}:{line}: {place} imports {target}, which is not below it")
    return found


FILES = sorted(path.relative_to(ROOT).as_posix() for path in PACKAGE.rglob("*.py"))


def test_imports_point_down():
    assert FILES
    found = [v for file in FILES for v in violations((ROOT / file).read_text("utf-8"), file)]
    assert not found, "\n" + "\n".join(found)


FORBIDDEN = """
mechanics/arm.py | import ves_gym.effects
mechanics/arm.py | from ves_gym import effects
mechanics/arm.py | from .. import effects
mechanics/arm.py | from ..effects.stribeck import Stribeck
mechanics/arm.py | from ves_gym import Simulator
engine/backends/mujoco.py | from ...envs import tasks
planners/direct.py | from ves_gym.report import figures
envs/tasks.py | from ves_gym.planners import coupling
rendering/live.py | from ves_gym.envs.batch import Batch
leaderboard/run.py | import ves_gym.cli.main
cli/list.py | from envs import tasks
misplaced/thing.py |
"""
ALLOWED = """
mechanics/arm.py | from ves_gym import __version__
mechanics/__init__.py | from . import spatial
engine/backends/mujoco.py | from ..mjcf import Arm
engine/backends/mujoco.py | from ves_gym.mechanics import spatial
report/figures.py | from ves_gym.planners import coupling
cli/main.py | from ves_gym import mechanics, envs
"""


@pytest.mark.parametrize(("lines", "found"), [(FORBIDDEN, 1), (ALLOWED, 0)])
def test_a_forbidden_import_is_found_inside_functions_too(lines, found):
    for line in lines.strip().splitlines():
        file, source = (part.strip() for part in line.split("|"))
        for text in (source, f"def late():\n    {source or 'pass'}"):
            assert len(violations(text, f"ves_gym/{file}")) == found, line


# ---------------------------------------------------------------------- documents

# a path of the repository, as `docs/physics.md` or, below ves_gym/, as `planners/query.py`
PATH = re.compile(r"`((?:[a-z_]+/)+[\w.-]+\.(?:py|md|toml|jsonl|json|js|css|html))`")
PLACES = ("ves_gym", "docs", "tests", "benchmarks", "examples", "scripts")


def missing_paths(text: str) -> list[str]:
    """Paths in backticks that begin with a folder of the repository and lead nowhere."""
    tops = {*PLACES, *(path.name for path in PACKAGE.iterdir() if path.is_dir())}
    paths = [path for path in PATH.findall(text) if path.partition("/")[0] in tops]
    paths = [path for path in paths if "NAME" not in path]  # which stands for any
    roots = (ROOT, PACKAGE, ROOT / "docs")
    return [path for path in paths if not any((root / path).exists() for root in roots)]


def test_pages_name_files_that_exist():
    for page in (ROOT / "README.md", *(ROOT / "docs").rglob("*.md")):
        assert not missing_paths(page.read_text("utf-8")), page


def test_a_path_that_leads_nowhere_is_seen():
    text = "`planners/query.py`, `docs/physics.md`, `planners/nowhere.py`, `out/report.html`"
    assert missing_paths(text) == ["planners/nowhere.py"]


# ----------------------------------------------------------------------- front door

# what `import ves_gym as vg` promises: a name less breaks somebody's program
PUBLIC = """
    simulate plan compare coupling_map diagnose evaluate train energy calibrate check_emulation
    render excitation export
    System Arm Link Inertial PUMA_560 Beam MatrixVehicle Satellite get_vehicle EmulatorSettings
    JointServo Motion
    Simulator State Divergence RunLog Energies EnergyBalance rollout_gradients
    effects Effect parameter register_effect
    Query Plan Planner NoPlan register_planner
    Task register_task Policy Controller load_case load_policy
    Diagnosis Candidate Case MjcfMachine make_entry verify_entry
    ParameterError
"""
DOORS = sorted(  # packages that import their names on first use
    path.relative_to(ROOT).as_posix()
    for path in PACKAGE.rglob("__init__.py")
    if "_lazily(" in path.read_text("utf-8")
)


def test_the_public_names_are_frozen():
    import ves_gym

    assert sorted(ves_gym.__all__) == sorted(PUBLIC.split())
    assert set(dir(ves_gym)) >= set(PUBLIC.split())


@pytest.mark.parametrize("path", DOORS)
def test_a_lazy_name_is_the_one_that_type_checkers_see(path):
    """What is imported under TYPE_CHECKING, what `__getattr__` finds, and `__all__` agree."""
    package = path.removesuffix("/__init__.py").replace("/", ".")
    module = importlib.import_module(package)
    tree = ast.parse((ROOT / path).read_text("utf-8"))
    (block,) = [
        node
        for node in tree.body
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
    ]
    declared = {
        alias.asname: (node.module, alias.name)
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert set(module.__all__) <= set(declared)
    for name, (home, there) in declared.items():
        known = getattr(importlib.import_module(home), there)
        assert getattr(module, name) is known, name
    with pytest.raises(AttributeError, match="no attribute 'simulte'"):
        _ = module.simulte


def test_every_public_name_has_a_docstring():
    import ves_gym

    for name in set(PUBLIC.split()) - {"PUMA_560"}:
        assert (getattr(ves_gym, name).__doc__ or "").strip(), name


def deep_imports(text: str) -> list[str]:
    """Imports that go past the doors: modules of rooms, and names that no door has."""

    rooms = {path.split("/")[-2] for path in DOORS} | {"effects", "envs"}
    doors = [*([room] for room in rooms), ["report", "notebook"]]
    out = []
    for package, names in re.findall(
        r"^[ >.]*from (ves_gym[\w.]*) import ([^#\n(]+|\([^)]*\))", text, re.MULTILINE
    ):
        door = package == "ves_gym" or package.split(".")[1:] in doors
        public = importlib.import_module(package).__all__ if door else ()
        for name in (n.split(" as ")[0].strip() for n in names.strip("() \n").split(",")):
            if name and name not in public and not (package == "ves_gym" and name in rooms):
                out.append(f"from {package} import {name}")
    found = re.findall(r"^[ >.]*import (ves_gym\.[\w.]+)", text, re.MULTILINE)
    return out + [f"import {name}" for name in found]


PAGES = [
    ROOT / "README.md",
    *(
        p
        for p in (ROOT / "docs").rglob("*.md")  # but what `make site` writes there
        if not {"decisions", "api", "notebooks"} & set(p.parts)
    ),
    *(ROOT / "docs").rglob("*.ipynb"),
    *(ROOT / "examples").rglob("*.py"),
]


def test_documentation_uses_public_paths_only():
    for page in PAGES:
        assert deep_imports(page.read_text("utf-8")) == [], page


DEEP = """
from ves_gym.system.system import System
>>> from ves_gym.leaderboard.statistics import score
from ves_gym import rendering
from ves_gym._util import params
import ves_gym.planners.query as query
from ves_gym.simulation import weigh_poses, EmulationLoop
"""
SHALLOW = """
import ves_gym as vg
from ves_gym import System, diagnosis
from ves_gym.effects import JointCoulomb
>>> from ves_gym.leaderboard import statistics as s
from ves_gym.simulation import (weigh_poses, play_motions)
"""


def test_a_deep_import_is_found():
    assert [len(deep_imports(line)) for line in DEEP.strip().splitlines()] == [1] * 6
    assert deep_imports(SHALLOW) == []


def test_benchmarks_name_what_exists():
    """Timings run by hand only: a name that has moved would not be noticed until then."""
    for path in (ROOT / "benchmarks").glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("ves_gym"):
                module = importlib.import_module(node.module)
                missing = [k.name for k in node.names if not hasattr(module, k.name)]
                assert not missing, f"{path.name}:{node.lineno}: {node.module} has no {missing}"


def test_the_page_of_claims_is_written_from_the_tests():
    script = runpy.run_path(str(ROOT / "scripts" / "claims.py"))
    said = (ROOT / "docs" / "claims.md").read_text("utf-8")
    assert said == script["page"](), "out of date: python scripts/claims.py"
