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
import os
import tempfile
import tomllib
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ves_gym._util.params import (
    Array,
    ParameterError,
    content_hash,
    read_table,
    to_plain,
    write_text,
)
from ves_gym.diagnosis.data.measured_run import Run
from ves_gym.diagnosis.machines.causes import split
from ves_gym.diagnosis.machines.joint_changes import CarriedBody, RateError, Shaft
from ves_gym.diagnosis.machines.mjcf import MjcfMachine
from ves_gym.diagnosis.machines.mjcf_mapping import machine_of
from ves_gym.diagnosis.machines.rigid_bodies import joint_property
from ves_gym.diagnosis.output.common import (
    DescriptionFiles,
    difference,
    rename_files,
    require_same,
    unified_diff,
)
from ves_gym.system.effect import Effect

MAPPING, MODEL = "machine.toml", "model.xml"
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

    model: ET.Element | None  # changed
    table: tuple[Effect, ...]
    notes: tuple[str, ...]


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
    source = None if machine.mjcf is None else mapping.parent / table["model"]
    for name, read in ((MAPPING, mapping), (MODEL, source)):
        if read is not None and (folder / name).resolve() == read.resolve():
            raise ParameterError(f"--out {folder} would overwrite {read}: take another folder")
    changes = [e for e in split(effects) if isinstance(e, (RateError, CarriedBody, Shaft))]
    model_effects = [e for e in split(effects) if e not in changes]
    variant = machine.model(effects)
    inside = _split(source, machine, model_effects)
    beside = (
        _Split(None, tuple(model_effects), tuple(f"{_kind(e)}: in {MAPPING}" for e in effects))
        if source is None
        else _plain(source, model_effects)
    )
    last: ParameterError | None = None
    for part in (inside, beside) if inside.model is not None else (beside,):
        try:
            return _written(
                table, mapping, source, part, changes, folder, machine, variant, runs
            )
        except ParameterError as error:
            last = error
    assert last is not None
    raise last


def _written(
    table: dict[str, Any],
    mapping: Path,
    source: Path | None,
    part: _Split,
    changes: Sequence[RateError | CarriedBody | Shaft],
    folder: Path,
    machine: MjcfMachine,
    variant: Any,
    runs: Sequence[Run],
) -> DescriptionFiles:
    import tomli_w

    additions: dict[str, list[Any]] = {
        key: list(table.get(key, ())) for key in ("effect", "rate", "payload", "shaft")
    }
    additions["effect"] += map(to_plain, part.table)
    for change in changes:
        additions[_TABLES[type(change)]].append(to_plain(change))
    new = {**table, **{key: entries for key, entries in additions.items() if entries}}
    if source is not None:
        new["model"] = MODEL
    elif machine.bodies is not None:  # a URDF stays where it is
        there = (mapping.parent / table["model"]).resolve()
        new["model"] = Path(os.path.relpath(there, folder.resolve())).as_posix()
    text = tomli_w.dumps(new)
    with tempfile.TemporaryDirectory(dir=folder, prefix=".new-") as inner:
        pairs = [(Path(inner) / MAPPING, folder / MAPPING)]
        model_text = ""
        if source is not None:
            assert part.model is not None
            near = Path(inner) / MODEL  # files it names are found from where it will be
            model_text = _text(_moved(part.model, source.parent, folder))
            write_text(near, _text(_moved(part.model, source.parent, Path(inner))))
            pairs.insert(0, (near, folder / MODEL))
        write_text(pairs[-1][0], text)
        where = pairs[-1][0] if source is not None else folder / MAPPING
        reloaded = machine_of(tomllib.loads(text), where)[1]
        deviation = difference(machine, variant, reloaded, reloaded.nominal, runs)
        require_same(deviation, folder / MAPPING)
        if source is not None:
            write_text(pairs[0][0], model_text)
        rename_files(pairs)
    diff = [unified_diff(tomli_w.dumps(table), text, (mapping.name, MAPPING))]
    if source is not None:
        diff.append(unified_diff(_text(_read(source)), model_text, (source.name, MODEL)))
    files = tuple(there for _, there in reversed(pairs))
    return DescriptionFiles(
        files=files,
        digest=content_hash([new, model_text]),
        plain={"machine_file": new, "model": model_text},
        diff="\n".join(d for d in diff if d),
        difference=deviation,
        notes=part.notes,
    )


def described(mapping: Path) -> str:
    """Return the SHA-256 of a mapping file and its model."""
    table = read_table(mapping)
    source = table.get("model")
    return content_hash(
        [table, "" if source is None else _text(_read(mapping.parent / source))]
    )


# -------------------------------------------------------------------------- the model


def _plain(source: Path, effects: Sequence[Effect]) -> _Split:
    """The model as it is, all effects in the mapping file."""
    notes = tuple(f"{e.kind}: in {MAPPING}" for e in effects)
    return _Split(_read(source), tuple(effects), notes)


def _kind(effect: Any) -> str:
    """Kind of an effect, or what a change of the machine is called."""
    return getattr(effect, "kind", "") or " and ".join(
        str(getattr(e, "kind", _TABLES.get(type(e)))) for e in split([effect])
    )


def _split(source: Path | None, machine: MjcfMachine, effects: Sequence[Effect]) -> _Split:
    """The model with what it can hold."""
    if source is None or machine.mjcf is None:
        return _Split(None, tuple(effects), ())
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
                return _Split(None, tuple(effects), ())
            if add and joint is not None:
                joint.set(attribute, repr(float(base_value + add)))
    return _Split(root, tuple(remaining), tuple(notes))


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
        return Path(os.path.relpath((old / folder).resolve(), new.resolve())).as_posix()

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
