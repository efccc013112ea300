"""Write docs/environments from the code: `python scripts/generate.py`.

Of README.md only the lists between its marks.
tests/envs/test_pages.py compares.
"""

from __future__ import annotations

import collections
import dataclasses
import functools
import inspect
import re
import sys
import textwrap
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from ves_gym._util.params import Array, ParameterError
from ves_gym.baselines.policy import released
from ves_gym.baselines.registry import REFERENCES
from ves_gym.envs.base_control import BaseControl
from ves_gym.envs.build import build_task
from ves_gym.envs.control import CONTROLS, Control
from ves_gym.envs.env import VesEnv
from ves_gym.envs.registration import IDS
from ves_gym.envs.task import Task
from ves_gym.mechanics.vehicle import VEHICLES

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from scripts.marks import filled  # noqa: E402 - run as a file, the root is not on the path

DOCS = ROOT / "docs"
PLACE = DOCS / "environments"

_JETS = 6  # numbers of an action that are the jets' wrench

SHARED_INFO = {
    "randomized/...": "also of reset: parameters drawn for this episode",
    "reward/...": "terms of the reward",
    "success": "whether the episode would count as solved if it ended here",
    "success_once": "whether it would have at any time",
    "clipped": "actions of this episode that were out of [-1, 1]",
    "diverged": "whether the numbers ran away",
    "stopped": "whether a safety stop of the laboratory froze the platform",
    "dump": "with the argument `dump`: run log of an episode that diverged",
    "energy/E_mean": "at the end: mean energy E of the base over episode and tail [J]",
    "energy/E_res": "at the end: E at the end [J]",
    "energy/E_peak": "at the end: largest E during the episode [J]",
    "energy/E_strain_peak": "at the end: largest strain energy of the base [J]",
    "energy/E_int": "at the end: time integral of the strain energy, tail included [J s]",
    "energy_residual": "at the end, in space, on the kernel: energy that the engine has"
    " gained or lost, over the largest E or a twentieth of what the drives moved to and fro",
    "energy_trusted": "at the end: whether that is below 1 %; a shorter `physics_dt` helps",
}
OWN_INFO = {
    "base/propellant": "satellites with jets or wheels: what jets have used so far [kg]",
    "base/wheel_momentum": "momentum that each reaction wheel stores [N m s]",
    "base/range": "a base on springs that has left the range in which it is linear: how far"
    " it is, as a share of that range",
    "capture/carried": "whether the target is carried",
    "capture/lost": "at the end: energy that the latch took [J]",
    "capture/momentum": "at the end: linear and angular momentum (6) of arm, base and target,"
    " about the inertial origin [kg m/s, kg m^2/s]",
    "capture/energy": "at the end: their kinetic energy, that of the wheels included [J]",
}
COMMON = ("base_control", "context", "tail")  # settings of every task, in README.md


def pages() -> dict[str, str]:
    """File name -> text of every page."""
    out = {f"{name}.md": _page(name) for name in IDS}
    return {"README.md": _index(), **out}


# --------------------------------------------------------------------------- pieces


def _env(name: str, emulated: bool = False, **settings: Any) -> VesEnv:
    env = gym.make(f"ves/{name}{'Emulated' * emulated}-v0", **settings).unwrapped
    assert isinstance(env, VesEnv)
    return env


def _list(rows: Iterable[Sequence[object]]) -> str:
    """Return a list, name and what it says; a phone's width breaks its lines."""
    return "\n".join(f"- {name}: {what}" if what else f"- {name}" for name, what in rows)


def _number(value: Any) -> str:
    """A number, or those of a vector, as short as four digits allow."""
    if isinstance(value, (tuple, list, np.ndarray)):
        values = [_number(k) for k in value]
        return values[0] if len(set(values)) == 1 else "(" + ", ".join(values) + ")"
    return f"{float(value):.4g}"


def _first_line(text: str | None) -> str:
    return inspect.cleandoc(text or "").split("\n\n")[0].replace("\n", " ")


def _comment(cls: type, field: str) -> str:
    """The comment behind a field's definition, in the class that defines it."""
    for owner in cls.__mro__:
        if field in inspect.get_annotations(owner):
            found = re.search(
                rf"^    {field}: .*?  # (.*)$", inspect.getsource(owner), re.MULTILINE
            )
            return found.group(1) if found else ""
    return ""


def _default(value: Any) -> str:
    if value is None:
        return "none"
    if isinstance(value, BaseControl):
        return "`{}`"
    if isinstance(value, (str, bool)):
        return str(value)
    return _number(value)


def _setting(control: Control, field: dataclasses.Field[Any]) -> str:
    value, unit = getattr(control, field.name), field.metadata["unit"]
    if value is None:
        return f"`{field.name}` = {_comment(type(control), field.name) or 'none'}"
    return f"`{field.name}` = {_number(value)}{'' if unit == '1' else ' ' + unit}"


def _tasks() -> Iterable[Task]:
    return (_env(name).task for name in IDS)


@functools.cache
def _shared_fields() -> dict[str, str]:
    """Return name and meaning of the observation's entries that most tasks have."""
    count = collections.Counter((f.name, f.what) for task in _tasks() for f in task.fields())
    return {name: what for (name, what), n in count.items() if 2 * n > len(IDS)}


def _observation(task: Task) -> str:
    rows, at = [], 0
    for field in task.fields():
        last = at + field.size - 1
        entries = str(at) if field.size == 1 else f"{at}-{last}"
        unit = "" if field.unit == "1" else f" [{field.unit}]"
        rows.append(
            (
                f"{entries} `{field.name}`{unit} / {_scale(field.scale)}",
                "" if _shared_fields().get(field.name) == field.what else field.what,
            )
        )
        at += field.size
    return _list(rows)


def _scale(value: Array) -> str:
    """A number, three, or from the least to the most of more."""
    least, most = np.min(value), np.max(value)
    return f"{least:.3g} to {most:.3g}" if len(value) > 3 and least < most else _number(value)


def _values(control: Control, other: Control | None = None) -> str:
    """Return the settings of a control, or those in which it differs from another one."""
    fields = dataclasses.fields(control)
    return ", ".join(
        _setting(control, f)
        for f in fields
        if other is None or getattr(control, f.name) != getattr(other, f.name)
    )


def _controls(task: Task) -> str:
    """Return the controls of a task, and the settings in which they differ from README.md's."""
    names, settings = {}, []
    for kind in CONTROLS:
        try:
            control = build_task(task, control=kind).control
        except ParameterError:
            continue
        if kind == task.control.kind:
            control = task.control
        if control != CONTROLS[kind]():
            settings.append((f"`{kind}`", _values(control, CONTROLS[kind]())))
        names[f"`{kind}`" + " (default)" * (kind == task.control.kind)] = control.width(
            task.system.arm
        )
    sizes = [
        (", ".join(name for name, width in names.items() if width == size), f"{size} numbers")
        for size in dict.fromkeys(names.values())
    ]
    return _list((*sizes, *settings)) + _beside(task)


def _beside(task: Task) -> str:
    """What an action holds beside the joints' numbers."""
    base = task.base_control
    if base is None:
        return ""
    scale, jets = base.scale(task.system), _JETS * base.jets
    wheels = len(scale) - jets
    rows = [
        ("wheels", wheels, f"torque of each wheel's motor, 1 is {_number(scale[:wheels])} N m")
    ]
    most = f"{_number(scale[wheels:][:3])} N, {_number(scale[wheels:][3:])} N m"
    what = "force and moment about the centre of mass of the satellite's body, made by pulses"
    rows.append(("jets", jets, f"{what}, 1 is {most}"))
    return (
        "\n\nBehind them, with `base_control` ([wheels and jets"
        "](../spacecraft.md#wheels-and-jets-as-actions)):\n\n"
        + _list((f"{name}, {size} numbers", what) for name, size, what in rows if size)
    )


def _settings(task: Task) -> str:
    rows = []
    for field in dataclasses.fields(task):
        value = getattr(task, field.name)
        if field.name in ("system", "control", "randomize"):
            continue
        if field.name in COMMON and value == field.default:  # README.md has it
            continue
        unit = field.metadata.get("unit", "1")
        note = "" if field.name in COMMON else _comment(type(task), field.name)
        rows.append(
            (f"`{field.name}` = {_default(value)}{'' if unit == '1' else ' ' + unit}", note)
        )
    return _list(rows)


def _info(env: VesEnv, fail: str) -> str:
    """Return the terms of the reward, failures, and what `info` has beside every task's."""
    _, begin = env.reset(seed=0)
    while True:
        *_, terminated, truncated, end = env.step(np.zeros(env.action_space.shape))
        if terminated or truncated:
            break
    keys = {re.sub("^(randomized|reward)/.*", r"\1/...", key) for key in (*begin, *end)}
    unknown = keys - set(SHARED_INFO) - set(OWN_INFO)
    assert not unknown, f"say in OWN_INFO what these are: {unknown}"
    own = [(f"`{k}`", v) for k, v in OWN_INFO.items() if k in keys]
    names = [k.removeprefix("reward/") for k in end if k.startswith("reward/")]
    terms = ", ".join(f"`{k}`" for k in names)
    table = "\n\n" + _list(own) if own else ""
    return (
        f"Terms of `reward/`: {terms}.{_objectives(env, tuple(names))}{fail}"
        f"{' `info` also has:' if own else ''}{table}"
    )


def _objectives(env: VesEnv, terms: tuple[str, ...]) -> str:
    """Return which terms make an objective of `reward="vector"`; goal variants have none."""
    if env.goal:
        return ""
    energetic = [f"`{k}`" for k in terms if k in env.task.energetic]
    return f" Objective `energy`: {' + '.join(energetic) or '0'}."


def _system(task: Task) -> str:
    system = task.system
    vehicle = next((f"`{k}`" for k, v in VEHICLES.items() if v == system.vehicle), "its own")
    return (
        f"arm {system.arm.name}, vehicle {vehicle}, drive {system.drive},"
        f" {system.integrator} at {system.physics_dt * 1e3:g} ms,"
        f" {task.steps} control periods of {system.control_dt * 1e3:g} ms"
    )


def _ranges(task: Task) -> list[tuple[str, str]]:
    return [
        (f"`{label}`", law) for label, _, law in (str(r).partition(" ") for r in task.randomize)
    ]


def _calibrated(ranges: list[tuple[str, str]]) -> list[tuple[str, str]]:
    """Return those that depend on the arm: errors of one calibration."""
    mark = ", together with others of calibration"
    return [(name, law.removesuffix(mark)) for name, law in ranges if law.endswith(mark)]


def _laboratory(task: Task) -> str:
    """Return what every laboratory id has: effects, and ranges that no arm changes."""
    ranges = _ranges(task)
    of_arm = {name for name, _ in _calibrated(ranges)}
    effects = [f"`{e.kind}`" for e in task.system.effects]
    return _list(
        [("effects", ", ".join(effects)), *(row for row in ranges if row[0] not in of_arm)]
    )


def _calibrations() -> str:
    """Return the errors of each arm's calibration, as deviations."""
    rows: dict[str, str] = {}
    for name, entry in IDS.items():
        if entry.emulated is not None:
            task = _env(name, emulated=True).task
            laws = (f"{k} {law.partition('+- ')[2]}" for k, law in _calibrated(_ranges(task)))
            row = ", ".join(laws)
            arm = task.system.arm.name
            assert rows.setdefault(arm, row) == row, f"calibrations of {arm} differ"
    return _list(rows.items())


def _page(name: str) -> str:
    env = _env(name)
    task = env.task
    doc = inspect.cleandoc(type(task).__doc__ or "")
    title, _, rest = doc.partition("\n\n")
    picture = (
        f"\n![{name}](../pictures/{name}.gif)\n\n"
        + (
            "*The [released policy](../training.md).*\n"
            if released(f"ves/{name}-v0")
            else f"*The controller `{REFERENCES[name]}`.*\n"
        )
        if ((DOCS / "pictures" / f"{name}.gif").exists())
        else ""
    )
    size = sum(f.size for f in task.fields())
    options = ", ".join(f"`{k}`" for k in ("index", *task.options))
    failed = type(task).failed  # of joint limits README.md says so
    fail = "" if failed is Task.failed else f" Failed: {_sentence(failed.__doc__)}"
    goals = ""
    if task.goal_fields is not None:
        achieved, desired = task.goal_fields
        goals = (
            "\nThe observation is a dictionary: `achieved_goal` is"
            f" `{achieved}`, `desired_goal` is `{desired}`, `observation` the rest."
            " `compute_reward(achieved, desired, info)` takes any leading axes, and so do"
            " `compute_terminated` and `compute_truncated`: with goals and info of a step they"
            " return what it returned.\n"
        )
    laboratory = IDS[name].emulated is not None
    ids = [f"ves/{name}-v0", f"ves/{name}Emulated-v0"][: 1 + laboratory]
    text = f"""<!-- written by scripts/generate.py: change the code instead -->
# {", ".join(ids)}

{title}
{picture}
{rest}

{_system(task)[0].upper() + _system(task)[1:]}.{_emulated(name)} [All tasks](README.md).

## Observation

{size} numbers.
{goals}
{_observation(task)}

## Action

{_controls(task)}

## Reward and info

{_info(_env(name, emulated=laboratory, duration=0.25), fail)}

## Settings

Options of `reset`: {options}.

{_settings(task)}
"""
    return _filled(text)


def _emulated(name: str) -> str:
    """Return what differs in the laboratory."""
    text = ", ".join(f"`{k}` = {v:.4g}" for k, v in (IDS[name].emulated or {}).items())
    return f" In [the laboratory](README.md#the-laboratory): {text}." if text else ""


def _sentence(doc: str | None) -> str:
    """A docstring's first lines as the end of a sentence."""
    text = _first_line(doc)
    return text[0].lower() + text[1:]


def _filled(text: str) -> str:
    """Lines of at most 96 characters where they are prose; no more than one empty line."""
    blocks, keep = [], False
    for block in re.sub(r"\n{3,}", "\n\n", text).strip().split("\n\n"):
        keep = keep or block.startswith("```")
        prose = not keep and not block.startswith(("|", "#", "<", "!", "-", " "))
        blocks.append(_wrapped(block) if prose else block)
        if block.rstrip().endswith("```"):
            keep = False
    return "\n\n".join(blocks) + "\n"


def _wrapped(block: str) -> str:
    """A paragraph in lines; links stay in one."""
    return textwrap.fill(" ".join(block.split()), 96, break_on_hyphens=False)


def _index() -> str:
    rows = []
    for name in IDS:
        env = _env(name)
        task = env.task
        rows.append(
            (
                f"[ves/{name}-v0]({name}.md)",
                f"{_first_line(type(task).__doc__)} {task.duration:g} s.",
            )
        )
    text = (PLACE / "README.md").read_text("utf-8")
    laboratories = {
        _laboratory(_env(name, emulated=True).task)
        for name in IDS
        if IDS[name].emulated is not None
    }
    assert len(laboratories) == 1, "ranges differ from id to id: say so on their pages"
    blocks = {
        "ids": _list(rows),
        "fields": _list((f"`{k}`", v) for k, v in _shared_fields().items()),
        "controls": _list(
            (f"`{k}`", f"{_first_line(c.__doc__)} {_values(c())}.") for k, c in CONTROLS.items()
        ),
        "laboratory": laboratories.pop(),
        "calibrations": _calibrations(),
        "info": _list((f"`{k}`", v) for k, v in SHARED_INFO.items()),
    }
    return filled(text, blocks)


def main() -> None:
    """Write every page; remove those of ids that are gone."""
    wanted = pages()
    for path in PLACE.glob("*.md"):
        if path.name not in wanted:
            path.unlink()
    for name, text in wanted.items():
        (PLACE / name).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
