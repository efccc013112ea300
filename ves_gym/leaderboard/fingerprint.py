"""Hashes and words of what a result depends on: environment, system, packages, machine."""

from __future__ import annotations

import hashlib
import platform
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import gymnasium as gym

from ves_gym._util.params import content_hash
from ves_gym._util.version import __version__
from ves_gym.envs.build import build_task
from ves_gym.system.system import System

_PACKAGES = ("numpy", "scipy", "mujoco", "llvmlite", "gymnasium", "ompl", "casadi")


# Hashes, of environment and of system, that are one and the same: the stiffness of a
# MacroMicro's base comes from LAPACK, whose last bits are those of OpenBLAS's code for a
# processor (SkylakeX, Haswell and Zen, Sandybridge, Nehalem, Prescott), off by 1e-14 of it.
_ALIKE = (
    """a748341f9ae70edb5285a82d860841f530da445568407d53a30448c5b693bc0d
    bedcbb23ea760f6f03ca13c2a348273cc35ab81d7f58acdb1b91effff57cf62f
    d97092f6564307c78a17a90a20e0c51fff781aa6c382e02c92a018ed672de16f
    33d535149af9edf9abcd4a95f7bea32edad4f8431a6a65d478f1bc3be3edb454
    aa1769be13a35b951b2abab1e3d98c6e20c18807e911c0ec73e2cf0597fb1a2f""",
    """aab79178bfc79cb8440434683651ae0b77775e5806cb04f1e8f175be9b9677dd
    f34840fa7e19754d3e5493922ffaaac1a44e9a47bc2c29197ed4595e3230f817
    ee7e5172db831e19c0dbb3f950bf68109dcac6f717f6dd97575decb9d9a2b79c
    f2a8de013ded01c396341cdcafc69fe593b21323cf235a83b51e037c0b15fecd
    3f302ffcd101f70702b319e1ba974bcc13fe756c5a61f1023ba2f265d2a62578""",
    """2123b0338253c00603e3fbf7c986b010cd6aabc977c9ba6e47ea16f532ca7a99
    b08b179a85a280b4d1750d36054ba96f02c85b05fc34bcf95124174615f76fa9
    b690392730c0996ac50a57aa5ce8bad5e44759339dd8401b59890bbcf668cb8d
    3102ee012f5f3c97f2da179db078762503b0f06eb33fd1fd70739b177a711d36
    90de33986ebbbf67d404343d7c64eaa3190b56680e0566818ff7cf72855b6f14""",
    """a1d9246729ff1f32f3c58c304098e46ec2efb079bea34db7e18432224c3f52d1
    59e9dbedf207a296fa45dcb339b943b9b4fe504f2a6c8897538466b9e355733b
    1870a978644f66961026fdac8a2c613277105ea26f13eaa76acf9d429cf77f0b
    9098fa7183a6cdc1efd464467317f735d5fcea57883be839974d59db473ed45a
    8f4ad91a9727c3719c1e27212b11686d5794baeebcc5f94bc705197d95db41f7""",
)
_FIRST = {h: group.split()[0] for group in _ALIKE for h in group.split()}


def processor_free(hash: str) -> str:
    """Return the hash that stands for all that differ from one by the processor alone."""
    return _FIRST.get(hash, hash)


@cache
def model_xml(system: System) -> str:
    """SHA-256 of the system's MuJoCo model as MJCF.

    The text depends on MuJoCo's version as well as on the system.
    """
    from ves_gym.engine.backends.mujoco import model_spec

    spec = model_spec(system)
    spec.compile()
    return hashlib.sha256(spec.to_xml().encode()).hexdigest()


def environment(id: str) -> dict[str, Any]:
    """Id, version and content hash of a registered environment with its task and settings."""
    spec = gym.spec(id)
    settings = {k: v for k, v in spec.kwargs.items() if k != "goal"}
    task = build_task(**settings)
    described = {"task": task.to_dict(), "goal": bool(spec.kwargs.get("goal", False))}
    return {"id": id, "version": spec.version, "spec": content_hash(described)}


def package_versions() -> dict[str, str]:
    """Return the installed versions on which a result depends."""
    out = {"ves_gym": __version__, "python": platform.python_version()}
    for name in _PACKAGES:
        try:
            out[name] = version(name)
        except PackageNotFoundError:
            continue
    return out


@cache
def cpu_model() -> str:
    """The processor in words."""
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()[:200]
    except (OSError, UnicodeDecodeError):
        pass
    return (platform.processor() or platform.machine())[:200]


@cache
def simd() -> str:
    """The processor's instruction sets, as the engine is compiled for them."""
    from ves_gym.engine.kernel.build import machine

    name, _, features = machine().partition(" ")[2].partition(" ")
    have = sorted(k[1:] for k in features.split(",") if k.startswith("+"))
    without = sorted(k[1:] for k in features.split(",") if k.startswith("-"))
    vector = [k for k in have if k.startswith(("avx", "fma", "sse", "neon", "sve", "vsx"))]
    vector = [k for k in vector if k not in without]
    return f"{name} {' '.join(vector)}".strip()
