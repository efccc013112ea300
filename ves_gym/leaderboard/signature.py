"""Signatures of bundles: an Ed25519 key of OpenSSH signs the bytes of the manifest.

The file beside the manifest is a signature as `ssh-keygen -Y sign` writes it (SSHSIG, OpenSSH's
PROTOCOL.sshsig), in the namespace `ves_gym-bundle`: what was signed for git or anything else is
none of a bundle. The manifest names every other file by its digest, so all of the bundle is
signed.

Here the format is read, so that each fault has its name; the arithmetic is that of the program
`ssh-keygen` (docs/decisions/0024-ssh-keygen-signs.md), which is handed the signature written
anew from what was read: both see the same.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from ves_gym._util.params import ParameterError
from ves_gym.leaderboard.archive import MANIFEST, SIGNATURE, add_member, read_members
from ves_gym.leaderboard.bundle import read_manifest
from ves_gym.leaderboard.errors import BundleError, Code

NAMESPACE = "ves_gym-bundle"
_PROGRAM = "ssh-keygen"
_KIND = b"ssh-ed25519"
_HASHES = (b"sha256", b"sha512")
_BEGIN, _END = "-----BEGIN SSH SIGNATURE-----", "-----END SSH SIGNATURE-----"
_COLUMNS = 70  # of base64, as OpenSSH writes it
_SECONDS = 60  # for the program, where nobody has to type a passphrase


def sign_bundle(path: str | os.PathLike[str], key: str | os.PathLike[str]) -> str:
    """Sign a bundle and put the signature into it; one that it had before is replaced.

    Args:
        path: folder or .zip file.
        key: private Ed25519 key as `ssh-keygen -t ed25519` makes it, or the public one of a key
            that an agent holds.

    Returns:
        The key's fingerprint.

    Raises:
        ParameterError: no such bundle or key, a key of another kind, no author to sign for.
        BundleError: the bundle's manifest is none.
    """
    members = read_members(path)
    if MANIFEST not in members:
        raise BundleError(Code.MISSING_MEMBER, f"there is no {MANIFEST}")
    if not read_manifest(members[MANIFEST])["author"]:
        raise ParameterError(
            f"{path}: the bundle has no author to whom the key would belong:"
            " make it with `run --author NAME`"
        )
    signature = sign(members[MANIFEST], key)
    fingerprint = signer(members[MANIFEST], signature)
    add_member(path, members, SIGNATURE, signature)
    return fingerprint


def sign(data: bytes, key: str | os.PathLike[str]) -> bytes:
    """Return the signature of some bytes.

    Raises:
        ParameterError: the file is no private key that can be used, or not an Ed25519 key.
    """
    if not Path(key).is_file():
        raise ParameterError(f"{key}: no such key file; `ssh-keygen -t ed25519` makes one")
    interactive = (
        sys.stdin is not None and sys.stdin.isatty()
    )  # then it can ask for a passphrase
    done = _run(
        "-Y", "sign", "-q", "-f", str(key), "-n", NAMESPACE, data=data, interactive=interactive
    )
    if done.returncode:
        output = done.stderr.decode("utf-8", "replace")
        if "passphrase" in output:
            raise ParameterError(
                f"{key}: the key has a passphrase, and none or a wrong one was typed: sign in a"
                " terminal, or add the key to ssh-agent and give its public file"
            )
        raise ParameterError(f"{key}: cannot sign: {_last(output)}")
    try:
        _read(done.stdout)
    except BundleError as error:
        raise ParameterError(f"{key}: {error.why}") from None
    return done.stdout


def signer(data: bytes, signature: bytes) -> str:
    """Return the fingerprint of the key that signed some bytes.

    Raises:
        BundleError: BAD_SIGNATURE.
        ParameterError: the program that checks signatures is missing or does not work.
    """
    blob, public = _read(signature)
    fingerprint = _fingerprint(public)
    with tempfile.TemporaryDirectory(prefix="ves_gym-") as folder:
        file = Path(folder) / "signature"
        file.write_bytes(_armoured(blob))
        done = _run("-Y", "check-novalidate", "-n", NAMESPACE, "-s", str(file), data=data)
    output = done.stdout.decode("utf-8", "replace")
    if done.returncode == 0 and output.split()[-1:] == [fingerprint]:
        return fingerprint
    if output.startswith("Could not verify"):
        raise _bad(f"{SIGNATURE} is not by {fingerprint}, or of another {MANIFEST}")
    reason = _last(output + done.stderr.decode("utf-8", "replace"))
    raise ParameterError(f"{_PROGRAM} cannot check signatures (OpenSSH 8.2 or newer): {reason}")


def _read(signature: bytes) -> tuple[bytes, bytes]:
    """Bytes of the signature and of the public key, of what can be a bundle's signature."""
    try:
        lines = signature.decode("ascii").strip().splitlines()
        if len(lines) < 3 or (lines[0], lines[-1]) != (_BEGIN, _END):
            raise ValueError(f"expected {_BEGIN} ... {_END}")
        blob = base64.b64decode("".join(lines[1:-1]), validate=True)
        if blob[:10] != b"SSHSIG\0\0\0\1":
            raise ValueError("expected SSHSIG, version 1")
        public, namespace, reserved, digest, signed = _strings(blob[10:], 5)
        kind, *_ = _strings(public)
    except (ValueError, binascii.Error) as error:
        raise _bad(f"{SIGNATURE} is no signature of OpenSSH: {error}") from None
    if kind != _KIND:
        printable = kind[:40].decode("ascii", "replace")
        raise _bad(
            f"a key of type {printable!a}; those of type {_KIND.decode()} can sign bundles"
        )
    if namespace != NAMESPACE.encode():
        printable = namespace[:40].decode("utf-8", "replace")
        raise _bad(f"{SIGNATURE} was made for {printable!a}, not for {NAMESPACE!r}")
    if (
        reserved
        or digest not in _HASHES
        or _sizes(public) != [11, 32]
        or _sizes(signed)
        != [
            11,
            64,
        ]
    ):
        raise _bad(f"{SIGNATURE} is no signature by a key of type {_KIND.decode()}")
    return blob, public


def _strings(data: bytes, count: int | None = None) -> list[bytes]:
    """The strings that some bytes are, each with its length in four bytes before it."""
    out = []
    while data:
        size = int.from_bytes(data[:4])
        if len(data) < 4 + size:
            raise ValueError("cut short")
        out.append(data[4 : 4 + size])
        data = data[4 + size :]
    if not out or (count is not None and len(out) != count):
        raise ValueError(f"expected {count or 'some'} parts, got {len(out)}")
    return out


def _sizes(data: bytes) -> list[int]:
    try:
        return [len(part) for part in _strings(data)]
    except ValueError:
        return []


def _fingerprint(public: bytes) -> str:
    """As `ssh-keygen -l` writes it."""
    hashed = base64.b64encode(hashlib.sha256(public).digest()).decode()
    return f"SHA256:{hashed.rstrip('=')}"


def _armoured(blob: bytes) -> bytes:
    text = base64.b64encode(blob).decode()
    lines = [text[k : k + _COLUMNS] for k in range(0, len(text), _COLUMNS)]
    return "\n".join([_BEGIN, *lines, _END, ""]).encode()


def _run(
    *words: str, data: bytes, interactive: bool = False
) -> subprocess.CompletedProcess[bytes]:
    program = shutil.which(_PROGRAM)
    if program is None:
        raise ParameterError(
            f"signatures need the program {_PROGRAM}, of OpenSSH 8.2 or newer: install OpenSSH"
        )
    # where nobody can be asked, a window for a passphrase would wait for ever
    quiet = () if interactive else ("DISPLAY", "WAYLAND_DISPLAY", "SSH_ASKPASS")
    environment = {k: v for k, v in os.environ.items() if k not in quiet}
    try:
        return subprocess.run(
            [program, *words],
            input=data,
            capture_output=True,
            env={**environment, "LC_ALL": "C"},
            start_new_session=not interactive,
            timeout=None if interactive else _SECONDS,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise ParameterError(f"{program} does not run: {error}") from None


def _last(text: str) -> str:
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return lines[-1][:200] if lines else "it says nothing"


def _bad(why: str) -> BundleError:
    return BundleError(Code.BAD_SIGNATURE, why)
