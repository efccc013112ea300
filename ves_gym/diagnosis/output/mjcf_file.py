"""Effects into the files of a machine of joints: what MJCF can hold goes into the model, the
rest, and all that a machine in URDF lacks, into the mapping file.

    joint/viscous        damping
    joint/coulomb        frictionloss
    joint/rotor_inertia  armature
    joint/drive_gain     gear of the joint's motors; in the mapping file, too, because the
                         force logged is not what acts
"""

from __future__ import annotations

import copy
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ves_gym._util.params import Array, ParameterError, content_hash, read_table, to_plain
from ves_gym.diagnosis.data.measured_run import Run
from ves_gym.diagnosis.machines.causes import split
from ves_gym.diagnosis.machines.joint_changes import CarriedBody, RateError, Shaft
from ves_gym.diagnosis.machines.mjcf import MjcfMachine
from ves_gym.diagnosis.machines.mjcf_mapping import machine_of
from ves_gym.diagnosis.machines.rigid_bodies import joint_property
from ves_gym.diagnosis.output.common import DescriptionFiles
from ves_gym.diagnosis.output.mapping_file import MAPPING, MODEL, path_from, write_mapping
from ves_gym.system.effect import Effect

_MJCF_ATTRIBUTES = {  # effect -> (its numbers, attribute of a joint, power of a slide's radius)
    "joint/viscous": ("damping", "damping", -2),
    "joint/coulomb": ("torque", "frictionloss", -1),
    "joint/rotor_inertia": ("added", "armature", -2),
}
_TABLES: dict[type, str] = {RateError: "rate", CarriedBody: "payload", Shaft: "shaft"}
_FOLDERS = ("assetdir", "meshdir", "texturedir")


@dataclass(frozen=True)
class _Split:
    """Effects by the file that holds them."""

    model: ET.Element | None  # changed; None: there is no MJCF
    table: Sequence[Effect]
    notes: Sequence[str]


def write_machine(
    mapping: Path,
    machine: MjcfMachine,
    effects: Sequence[Any],
    folder: Path,
    runs: Sequence[Run],
) -> DescriptionFiles:
    """Write the machine of a mapping file with effects: `machine.toml` and `model.xml`.

    Both are read back, and every port is played again on the runs, before they get their
    names. If the model with changed joints does not play identically (a joint that sets
    `springdamper`, for example), all effects go into the mapping file.

    Raises:
        ParameterError: the folder holds the files that are read; what is read back differs.
    """
    table = read_table(mapping)
    source = mapping.parent / table["model"] if machine.mjcf else None
    changes = [e for e in split(effects) if type(e) in _TABLES]
    laws = [e for e in split(effects) if type(e) not in _TABLES]
    notes = [f"{_kind(e)}: in {MAPPING}" for e in effects]
    parts = [_Split(None if source is None else _read(source), laws, notes)]
    if source is not None and (inside := _split(source, machine, laws)):
        parts.insert(0, inside)
    for part in parts:
        additions = {key: list(table.get(key, ())) for key in ("effect", *_TABLES.values())}
        additions["effect"] += map(to_plain, part.table)
        for change in changes:
            additions[_TABLES[type(change)]].append(to_plain(change))
        new = {**table, **{key: entries for key, entries in additions.items() if entries}}
        model = None
        if source is not None and part.model is not None:
            new["model"] = MODEL
            moved = _text(_moved(part.model, source.parent, folder))
            model = source, _text(_read(source)), moved
        elif machine.bodies is not None:  # a URDF stays where it is
            new["model"] = path_from(folder, mapping.parent / table["model"])
        try:
            return write_mapping(
                mapping, new, machine_of, machine, effects, folder, runs, part.notes, model
            )
        except ParameterError:
            if part is parts[-1]:
                raise
    raise AssertionError("no part")


def described(mapping: Path) -> str:
    """Return the SHA-256 of a mapping file and its model."""
    table = read_table(mapping)
    source = table.get("model")
    return content_hash(
        [table, "" if source is None else _text(_read(mapping.parent / source))]
    )


# -------------------------------------------------------------------------- the model


def _kind(effect: Any) -> str:
    """Kind of an effect, or what a change of the machine is called."""
    return getattr(effect, "kind", "") or " and ".join(
        str(getattr(e, "kind", _TABLES.get(type(e)))) for e in split([effect])
    )


def _split(source: Path, machine: MjcfMachine, effects: Sequence[Effect]) -> _Split | None:
    """The model with what it can hold; None where it cannot hold an effect."""
    assert machine.mjcf is not None
    root = _read(source)
    joints = [_only(root, j.name) for j in machine.joints]
    radius = np.array([j.radius for j in machine.joints])
    remaining, notes = [], []
    additions: dict[str, Array] = {}
    for effect in effects:
        attribute_of = _MJCF_ATTRIBUTES.get(effect.kind)
        if attribute_of is None:
            remaining.append(effect)
            scaled = _geared(root, machine, effect) if effect.kind == "joint/drive_gain" else []
            notes.append(
                f"{effect.kind}: in {MAPPING}"
                + (f"; gear of {', '.join(scaled)} in {MODEL}" if scaled else "")
            )
            continue
        number, attribute, power = attribute_of
        value = np.array(getattr(effect, number)) * radius**power
        additions[attribute] = additions.get(attribute, np.zeros(len(radius))) + value
        notes.append(f"{effect.kind}: {attribute} in {MODEL}")
    for attribute, value in additions.items():
        present = joint_property(machine.mjcf.model, attribute)[machine.mjcf.dof]
        for joint, base_value, add in zip(joints, present, value, strict=True):
            if add and joint is None:  # named by <attach> or <replicate>
                return None
            if add and joint is not None:
                joint.set(attribute, repr(float(base_value + add)))
    return _Split(root, remaining, notes)


def _only(root: ET.Element, name: str) -> ET.Element | None:
    """The joint of a body by its name, if there is exactly one."""
    tags = ("joint", "hinge", "slide")
    bodies = root.iter("body")
    matches = [k for b in bodies for k in b if k.tag in tags and k.get("name") == name]
    return matches[0] if len(matches) == 1 else None


def _geared(root: ET.Element, machine: MjcfMachine, effect: Effect) -> list[str]:
    """Scale the gears of motors by what the drives really give; names of the joints."""
    assert machine.mjcf is not None
    every = [k for part in root.iterfind("actuator") for k in part if isinstance(k.tag, str)]
    if len(every) != machine.mjcf.model.nu:  # some are made by <replicate> or <attach>
        return []
    wrong = {j.name: e for j, e in zip(machine.joints, vars(effect)["error"], strict=True)}
    done = []
    for actuator, gear in zip(every, machine.mjcf.model.actuator_gear, strict=True):
        error = wrong.get(actuator.get("joint", ""), 0.0)
        if actuator.tag == "motor" and error:
            actuator.set("gear", " ".join(repr(float(g) * (1 + error)) for g in gear))
            done.append(actuator.get("joint", ""))
    return done


# ------------------------------------------------------------------------------- text


def _read(path: Path) -> ET.Element:
    """An MJCF file, its comments and what it includes inside."""
    parser = ET.XMLParser(target=ET.TreeBuilder(insert_comments=True))
    try:
        root = ET.parse(path, parser).getroot()
    except (OSError, ET.ParseError) as error:
        raise ParameterError(f"{path}: cannot be read: {error}") from None
    _include(root, path.parent)
    return root


def _include(element: ET.Element, folder: Path) -> None:
    k = 0
    while k < len(element):
        child = element[k]
        if child.tag == "include":
            inner = list(_read(folder / child.get("file", "")))
            element[k : k + 1] = inner
            k += len(inner)
            continue
        _include(child, folder)
        k += 1


def _moved(root: ET.Element, old: Path, new: Path) -> ET.Element:
    """The model for another folder: the files it names are found from there."""
    root = copy.deepcopy(root)
    if old.resolve() == new.resolve() or root.find(".//*[@file]") is None:
        return root

    def there(folder: str) -> str:
        if Path(folder).is_absolute():
            return folder
        return path_from(new, old / folder)

    declared = False
    for compiler in root.iter("compiler"):
        for key in _FOLDERS:
            if key in compiler.attrib:
                compiler.set(key, there(compiler.attrib[key]))
                declared = True
    if not declared:
        root.insert(0, ET.Element("compiler", {"assetdir": there(".")}))
    return root


def _text(root: ET.Element) -> str:
    return ET.tostring(root, encoding="unicode") + "\n"
