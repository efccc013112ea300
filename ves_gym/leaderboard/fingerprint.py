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
# processor (SkylakeX, Haswell and Zen, Sandybridge, Nehalem, Prescott), off by 1e-14 of it; so
# do the covariances of the laboratories that Emulated-v1 draws (the last nine, on one thread).
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
    """63a99610791dbb9d2e8f3d42bf968318aeeefb630cbcc205823c25838543f061
    d7dbd307342524c5be9c683ec41a4070d3838dcfe98e7e359a01fb38e13de66e
    ca9dec2ed6ef39596fbd2c416ea503a4b0c7e5aeb53cb3a941bbd0a3dc9b67dc
    32f5a1586b0c958f4e2c9b04e3dc4a2663e18d05edd1c6a0750f7a35c41f99ca
    c59f4e252b9619c27eddb486f2fef54d2d6d0fc27c74de0640a57d4785261453""",
    """b541fcd305eb2d3674efce7cba2d9cde98b1b0382b43e6e045058ece97ae0803
    b28494eff11badcd0170198525ae7d4fc29c4736568900821380ac8a167f3875
    3ce5afe3fadb3fc54a17cd216d9b3114e4749f6ce31b11bac58f3e0d43294ebb
    4afab6677d23d54bf57b2275eff9c382a21f0684c655fd465811345f2471e9c7
    a9c5c3ef1ffadcd6dbb76ce857844be9700bcee8a95ce6c192451f14e899ccd3""",
    """d608b94b5ccf08c3b5999a7c7abdb04f12de0ab93cb4f3ebd508258dc6d31cce
    18807ccb2ad19e04f9dec60fc1e63c7051c86aa1ee147458ddcfc15d9a601fe2
    9cdf071f9bcad3d83442be6f477ebc3a7904ba43439eadb96ac9883e74ad18bb
    0095389ac4ff90c6ef59f5854e34f7531eee7fffe7b38cf35f0a9910c96680ac
    6b5977ec93ec7b28b6ea9d30f1467a8c8e24a2dd954b4f2f0c7ea56cb4113d30""",
    """08f5e1907257c2b5f7080152d1309413c05e1182e0aaf41a39a5a997e174028b
    f387297094df2230107c3a6b6555cfa75f215efb4a05537b10349e4c32d98fa8
    937079de1671a63c9e2872655e2aab7be676017160ae1d51f326d4be55cedc7e
    de66e05ee4f63a7aa0f7afc49cad38e8ab7db754c6af389fcb970a141d51f58c
    b9eb549e91ead4e1a5e829bce4918834525976be36c2ec579f646f4e2e55bde6""",
    """1cc6677fdd37e23924a4155e0f13ac2d9945a865cf0a2d08fa26d918c2b59a0d
    d0905b7a4e904d675e0e7271257c440114d22a558673f26efcf20e69ae534c75
    64d7a026e6f8d6100673c5aac7fa12a6d2f7a5d48cfac2088caff459d810ba44
    716bd530d65ecebe22d4ea66b11be88e0a6d4e5ac133a28383680b86fd49a3a8
    b2ac5bb95b524dda971b863f98a01d97608c346d6a1f58c1dee2cec7c009f7c3""",
    """3f9f7a807cd62fc5e9590cd816d6110ae62064bc5b08fd416b7012272a642d32
    a18450e34166e049a8d25cac73d41eb4e7b89f9abc9abd8afbeb8562206be0b5
    9d937e135de34a5ed3d60f3d1c5fed7a47632fdc69d22923ee6c0463dbea3fb2
    79ff1ed288dea1a41cbc1d9f8f0ed3f292b4933b1be946af80bcac00c3afafea
    ea38908abf2f5d918c812822cabfafae1ed0e80daaf0261fb31682a58764fe15""",
    """19fa675bd64f6bde1a660d8ea46a63faa667335b08cc3264e5b999c755daa745
    d71e8fd02fe5ef582dbc47b3ed097342a3fb70ceb316e546d2663c2e1d75a86a
    4378b894cfaaa7c41bef75854ba36cf586380e2b93640d270e9d6b7171658fe0
    58782c2ff03b366a080f2607d43989c9e112ca39a14340f0bfc1720a3982323d
    3cdf12c9fa2f2eebcd52785276cc08d0afaf9ba57e78542b869f3037ce59793e""",
    """22d9e849655794e8d07ea26382ed31025591e8953b8dba0b29865c5a0bb38067
    9bca98747cdc00e01d114f41c4095046509b1fd52d339656d65687e1fe8b8dcc
    0c768e4b88d81765123a9e0a1357323f7b246617efa384a04979328b677f8782
    eda04ff162230039b56cc71abd1d38c407290353e3fbdc4cd1d50c6cd69506f4
    a1f6702e06a5f503fbccab6aff2025680d2ed437da603364999a8187f441db01""",
    """ec4dd6229da3705bcba3f728b84304a5e411a4a14c54a5bd5f271114f4ad9e05
    46ea887a0f3bc12017381741b8720657fa72096de2429ef064dbecbb3218aabe
    3494e043d84aaf0c9925dee021511e5c7b573be1b5b8bb69515474fb7460955c
    8d9bb2503eb9694e98c098c27657f95ee04670d42675a044993d3730c230f9d1
    90a497fa7ea91cbcd74367a2a1d96bb58c2e57b0eeff636b815cb907c8a7d852""",
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
