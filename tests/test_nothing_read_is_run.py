"""Names in files of data stand for what is registered: nothing in a file is imported or run."""

import json
import shutil
import sys

import pytest

from ves_gym._util.params import ParameterError, from_plain
from ves_gym.baselines.config import TrainConfig, released_configs
from ves_gym.baselines.dataset import Recipe, make_dataset
from ves_gym.baselines.evaluate import evaluate
from ves_gym.baselines.policy import RELEASED, load_policy
from ves_gym.baselines.registry import get_controller
from ves_gym.baselines.train import train
from ves_gym.diagnosis import read_machine
from ves_gym.envs.build import build_task
from ves_gym.experiments.spec import Spec, units_of
from ves_gym.planners.registry import get_planner
from ves_gym.system.system import System

REACH = "ves/PumaReach-v0"
# modules of Python that nothing here uses: one that is loaded was named by a file
MODULES = ("this", "antigravity", "turtledemo")
NAMES = ("{}:s", "{}:anything.else", "{}")


def evaluation(**changes):
    table = {"envs": [REACH], "policies": ["hold"], "episodes": 1} | changes
    return units_of(from_plain(Spec, {"evaluate": [table]}))


def training(**changes):
    config = released_configs()[0].to_dict() | changes
    return train(from_plain(TrainConfig, config), 0, "nowhere")


def recipe(**changes):
    table = {"id": "ves/X-v0/a-v0", "env": REACH, "behaviours": ["hold"], "episodes": 1}
    return make_dataset(from_plain(Recipe, table | {"seed": 0} | changes, "recipe"))


def policy(tmp_path, **about):
    """A released policy whose file says other things of itself."""
    file = next(RELEASED.glob("PumaDamp/*.json"))
    for part in (file, file.with_suffix(".safetensors")):
        shutil.copy(part, tmp_path)
    copy = tmp_path / file.name
    plain = json.loads(copy.read_text())
    plain["about"] |= about
    copy.write_text(json.dumps(plain))
    return evaluate(load_policy(copy), "ves/PumaDamp-v0", episodes=1)


def mapping(tmp_path, name):
    """A mapping file that names a machine to diagnose."""
    file = tmp_path / "mapping.json"
    about = {"schema": "ves-residual/1", "machine": name, "name": "mine", "signals": {}}
    file.write_text(json.dumps(about))
    return read_machine(file)


WAYS = {
    "a machine to diagnose": mapping,
    "a sweep's settings": lambda tmp_path, name: evaluation(settings={"task": name}),
    "a sweep's environment": lambda tmp_path, name: evaluation(envs=[f"{name}/X-v0"]),
    "a sweep's policy": lambda tmp_path, name: evaluation(policies=[name]),
    "a configuration's settings": lambda tmp_path, name: training(settings={"task": name}),
    "a configuration's environment": lambda tmp_path, name: training(env=f"{name}/X-v0"),
    "a planner": lambda tmp_path, name: get_planner(name),
    "a recipe's environment": lambda tmp_path, name: recipe(env=f"{name}/X-v0"),
    "a recipe's behaviour": lambda tmp_path, name: recipe(behaviours=[name]),
    "a system": lambda tmp_path, name: System.from_dict({"vehicle": {"kind": name}}, "system"),
    "a controller": lambda tmp_path, name: get_controller(name),
    "a task": lambda tmp_path, name: build_task(name),
    "a control": lambda tmp_path, name: build_task("reach", control=name),
    "an effect": lambda tmp_path, name: build_task("reach", effects=[{"kind": name}]),
    "a policy's goal": lambda tmp_path, name: policy(tmp_path, settings={"control": name}),
}


@pytest.mark.parametrize("way", WAYS)
def test_a_name_in_data_imports_nothing(way, tmp_path, monkeypatch):
    """Claim: a hundred names of code in sweeps, configurations, recipes, policies and settings
    import nothing; each is refused with what was received."""
    monkeypatch.chdir(tmp_path)
    loaded = set(sys.modules)
    for name in NAMES:
        for module in MODULES:
            with pytest.raises(ParameterError):
                WAYS[way](tmp_path, name.format(module))
    assert not {k.split(".")[0] for k in set(sys.modules) - loaded} & set(MODULES)
