"""Keys: a name that was signed for is its key's, and no attack on that gets an entry in.

The signatures are OpenSSH's, made by its program; faults are put into their bytes here.
"""

import base64
import shutil
import subprocess
import zipfile

import pytest

from tests.leaderboard.bundles import POLICY, Bundle
from ves_gym._util.params import ParameterError
from ves_gym.leaderboard import signature
from ves_gym.leaderboard.archive import LIMITS, MANIFEST, SIGNATURE, read_members
from ves_gym.leaderboard.entry import check_entry
from ves_gym.leaderboard.errors import BundleError, Code
from ves_gym.leaderboard.journal import JournalError, append, check, read
from ves_gym.leaderboard.record import made_record
from ves_gym.leaderboard.run import make_bundle
from ves_gym.leaderboard.signature import NAMESPACE, sign, sign_bundle, signer
from ves_gym.leaderboard.verify import verify

pytestmark = pytest.mark.skipif(
    shutil.which("ssh-keygen") is None, reason="OpenSSH is not installed"
)

DATA = b"a manifest\n"


def keygen(*words, **options):
    done = subprocess.run(["ssh-keygen", *map(str, words)], capture_output=True, **options)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def keys(tmp_path_factory):
    """Files of two Ed25519 keys, of one with a passphrase, and of other kinds."""
    folder = tmp_path_factory.mktemp("keys")
    kinds = {
        "mine": ("ed25519", ""),
        "theirs": ("ed25519", ""),
        "locked": ("ed25519", "a secret"),
        "rsa": ("rsa", ""),
        "ecdsa": ("ecdsa", ""),
    }
    for name, (kind, passphrase) in kinds.items():
        bits = ("-b", 2048) if kind == "rsa" else ()
        keygen("-q", "-t", kind, *bits, "-N", passphrase, "-C", "", "-f", folder / name)
    return {name: folder / name for name in kinds}


def fingerprint(key):
    """As OpenSSH computes it."""
    return keygen("-l", "-f", key).decode().split()[1]


def refusal(data, signed):
    with pytest.raises(BundleError) as refused:
        signer(data, signed)
    assert refused.value.code is Code.BAD_SIGNATURE
    return refused.value.why


# -------------------------------------------------------------------------- the format


def test_openssh_accepts_what_is_signed_and_the_key_is_the_one_it_names(keys, tmp_path):
    signed = sign(DATA, keys["mine"])
    assert len(signed) < LIMITS[SIGNATURE]
    assert signer(DATA, signed) == fingerprint(keys["mine"])
    allowed, file = tmp_path / "allowed", tmp_path / "m.sig"
    allowed.write_text(f"me {keys['mine'].with_suffix('.pub').read_text()}")
    file.write_bytes(signed)
    said = keygen("-Y", "verify", "-f", allowed, "-I", "me", "-n", NAMESPACE, "-s", file,
                  input=DATA)  # fmt: skip
    assert fingerprint(keys["mine"]) in said.decode()


def test_signed_by_the_program_alone(keys):
    """No part of this project is needed to sign; either hash of the format is good."""
    for name in ("sha256", "sha512"):
        signed = keygen("-Y", "sign", "-q", "-f", keys["mine"], "-n", NAMESPACE,
                        "-O", f"hashalg={name}", input=DATA)  # fmt: skip
        assert signer(DATA, signed) == fingerprint(keys["mine"])


def test_every_fault_of_a_signature_has_its_name(keys):
    signed = sign(DATA, keys["mine"])
    blob = base64.b64decode(b"".join(signed.split(b"\n")[1:-2]))
    assert "is not by SHA256:" in refusal(DATA + b" ", signed)
    for at in (50, len(blob) - 1):  # of the public key, of the signature itself
        changed = bytearray(blob)
        changed[at] ^= 1
        assert "is not by SHA256:" in refusal(DATA, signature._armoured(bytes(changed)))
    other = keygen("-Y", "sign", "-q", "-f", keys["mine"], "-n", "git", input=DATA)
    assert "made for 'git', not for 'ves_gym-bundle'" in refusal(DATA, other)
    for kind in ("rsa", "ecdsa"):
        signed_so = keygen("-Y", "sign", "-q", "-f", keys[kind], "-n", NAMESPACE, input=DATA)
        assert "a key of type" in (why := refusal(DATA, signed_so)) and "ssh-ed25519" in why
    for bad in (
        b"",
        b"\xff\xfe",
        b"x" * 4000,
        signed[:-30],
        signed.replace(b"\n", b"\n*", 2),
        signature._armoured(b"SSHSIG"),
        signature._armoured(blob[:-1]),
        signature._armoured(blob + b"\0"),
        signature._armoured(blob[:9] + b"\2" + blob[10:]),
        signature._armoured(blob[:10] + b"\xff" * (len(blob) - 10)),
    ):
        assert "no signature of OpenSSH" in refusal(DATA, bad)


def test_a_byte_changed_anywhere_is_refused(keys):
    blob = base64.b64decode(b"".join(sign(DATA, keys["mine"]).split(b"\n")[1:-2]))
    for at in range(0, len(blob), 3):
        changed = bytearray(blob)
        changed[at] ^= 1
        refusal(DATA, signature._armoured(bytes(changed)))


def test_a_signature_cut_anywhere_is_refused(keys):
    blob = base64.b64decode(b"".join(sign(DATA, keys["mine"]).split(b"\n")[1:-2]))
    for size in range(len(blob)):
        with pytest.raises(BundleError):
            signature._read(signature._armoured(blob[:size]))


@pytest.mark.parametrize(
    ("key", "why"),
    [
        ("locked", "has a passphrase"),
        ("rsa", "a key of type 'ssh-rsa'; those of type ssh-ed25519 can sign"),
        ("ecdsa", "a key of type 'ecdsa"),
    ],
)
def test_keys_that_cannot_sign(keys, key, why):
    with pytest.raises(ParameterError, match=why):
        sign(DATA, keys[key])


def test_what_is_no_key(tmp_path):
    (tmp_path / "text").write_text("no key")
    (tmp_path / "text").chmod(0o600)
    with pytest.raises(ParameterError, match="cannot sign"):
        sign(DATA, tmp_path / "text")
    for name in ("none", "."):
        with pytest.raises(ParameterError, match="no such key file"):
            sign(DATA, tmp_path / name)


def test_without_the_program(keys, monkeypatch, tmp_path):
    signed = sign(DATA, keys["mine"])
    monkeypatch.setenv("PATH", str(tmp_path))
    for call in (lambda: sign(DATA, keys["mine"]), lambda: signer(DATA, signed)):
        with pytest.raises(ParameterError, match="need the program ssh-keygen"):
            call()


def test_a_program_that_does_not_check_is_not_believed(keys, monkeypatch, tmp_path):
    """One that says yes to everything, and one too old for the question."""
    signed = sign(DATA, keys["mine"])
    fake = tmp_path / "ssh-keygen"
    monkeypatch.setenv("PATH", str(tmp_path))
    for script in ("exit 0", "echo usage >&2; exit 1"):
        fake.write_text(f"#!/bin/sh\n{script}\n")
        fake.chmod(0o755)
        with pytest.raises(ParameterError, match="cannot check signatures"):
            signer(DATA, signed)


# -------------------------------------------------------------------------- bundles


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    path = tmp_path_factory.mktemp("bundles") / "zero.zip"
    return make_bundle(path, *POLICY, "zero", author="A. Name")


@pytest.fixture
def bundle(made, tmp_path):
    """A bundle of author A. Name, not signed."""
    return shutil.copy(made, tmp_path / "b.zip")


@pytest.fixture
def folder(made, tmp_path):
    with zipfile.ZipFile(made) as archive:
        archive.extractall(tmp_path / "folder")
    return tmp_path / "folder"


def test_a_signed_bundle_says_by_whom(keys, bundle, folder):
    plain = verify(bundle)
    assert "key" not in plain.about
    for path in (bundle, folder):
        before = read_members(path)
        assert sign_bundle(path, keys["mine"]) == fingerprint(keys["mine"])
        after = read_members(path)
        assert {k: v for k, v in after.items() if k != SIGNATURE} == before
        entry = verify(path)
        assert entry.about["key"] == fingerprint(keys["mine"])
        assert (entry.rows, entry.bundle) == (plain.rows, plain.bundle)
    sign_bundle(bundle, keys["theirs"])  # another one replaces it
    assert verify(bundle).about["key"] == fingerprint(keys["theirs"])


def test_the_signature_of_another_bundle_is_refused(keys, bundle, tmp_path):
    """Pasted into a bundle of the same author with better claims."""
    sign_bundle(bundle, keys["mine"])
    forged = Bundle(bundle)
    forged.manifest["name"] = "mine is better"
    path = forged.write_manifest(tmp_path / "forged.zip")
    with pytest.raises(BundleError) as refused:
        verify(path)
    assert refused.value.code is Code.BAD_SIGNATURE


def test_a_manifest_cannot_claim_a_key_or_list_its_signature(keys, bundle, tmp_path):
    forged = Bundle(bundle)
    forged.manifest["about"]["key"] = fingerprint(keys["mine"])
    with pytest.raises(BundleError) as refused:
        verify(forged.write_manifest(tmp_path / "a.zip"))
    assert refused.value.code is Code.MALFORMED_MANIFEST
    forged = Bundle(bundle)
    forged.members[SIGNATURE] = b"x"
    path = forged.write(tmp_path / "b.zip")  # lists it among its members, with its digest
    sign_bundle(path, keys["mine"])
    with pytest.raises(BundleError) as refused:
        verify(path)
    assert refused.value.code is Code.EXTRA_MEMBER


def test_a_huge_signature_is_not_read(bundle):
    with zipfile.ZipFile(bundle, "a") as archive:
        archive.writestr(SIGNATURE, b"x" * (LIMITS[SIGNATURE] + 1))
    with pytest.raises(BundleError) as refused:
        verify(bundle)
    assert refused.value.code is Code.UNSAFE_ARCHIVE


def test_what_cannot_be_signed_stays_as_it_was(keys, bundle, tmp_path):
    before = bundle.read_bytes()
    for key in ("locked", "rsa"):
        with pytest.raises(ParameterError):
            sign_bundle(bundle, keys[key])
    assert bundle.read_bytes() == before
    nobody = Bundle(bundle)
    nobody.manifest["author"] = ""
    with pytest.raises(ParameterError, match="no author"):
        sign_bundle(nobody.write_manifest(tmp_path / "nobody.zip"), keys["mine"])
    broken = Bundle(bundle)
    broken.manifest["name"] = "changed"
    with pytest.raises(BundleError, match="seal"):
        sign_bundle(broken.write_manifest(tmp_path / "broken.zip", seal=False), keys["mine"])
    nothing = tmp_path / "empty"
    nothing.mkdir()
    with pytest.raises(BundleError, match=MANIFEST):
        sign_bundle(nothing, keys["mine"])


# -------------------------------------------------------------------------- the board

MINE, THEIRS = (f"SHA256:{letter * 43}" for letter in "AB")


@pytest.fixture
def by(make_entry):
    """An entry of an author, with the key that `verify` computed."""

    def make(author, key=None, name="planner"):
        entry = make_entry(name, author=author)
        entry["about"] = {**entry["about"], **({} if key is None else {"key": key})}
        return entry

    return make


@pytest.fixture
def board(tmp_path, by):
    """A. Name has a key, B. Name has none."""
    path = tmp_path / "entries"
    for entry in (by("A. Name", MINE), by("B. Name"), by("A. Name", MINE, "another")):
        append(path, entry)
    return path


@pytest.mark.parametrize(
    ("author", "key", "why"),
    [
        ("A. Name", None, f"signs with {MINE}, and the entry is not signed"),
        ("A. Name", THEIRS, f"signs with {MINE}, and the entry is signed by {THEIRS}"),
        ("A. Nаme", THEIRS, "looks like"),  # a Cyrillic letter
        ("B. Name", THEIRS, "has 1 unsigned entries on the board"),
        ("", THEIRS, "without an author"),
    ],
)
def test_a_name_is_of_its_key_alone(board, by, author, key, why):
    before = sorted(board.iterdir())
    with pytest.raises(ParameterError) as refused:
        append(board, by(author, key, "new"))
    assert why in str(refused.value)
    assert sorted(board.iterdir()) == before


def test_names_without_a_key_stay_free(board, by):
    for entry in (by("B. Name"), by("C. Name"), by("C. Name"), by("")):
        append(board, entry)
    assert len(read(board).records) == 7


def test_the_maintainer_ties_a_name_to_a_key_once(board, by):
    append(board, by("B. Name", THEIRS), adopt=True)
    append(board, by("B. Name", THEIRS))
    for entry, adopt in (
        (by("B. Name"), False),
        (by("B. Name", MINE), True),  # not even so can a key be changed
        (by("A. Name", THEIRS), True),
        (by("C. Name"), True),  # nothing to adopt
    ):
        with pytest.raises(ParameterError):
            append(board, entry, adopt=adopt)
    assert len(read(board).records) == 5


@pytest.mark.parametrize("key", ["", "MD5:00", "SHA256:short", MINE + "=", None, 5])
def test_a_key_is_a_fingerprint(by, key):
    entry = by("A. Name")
    entry["about"]["key"] = key
    with pytest.raises(ParameterError, match=r"entry\.about\.key"):
        check_entry(entry)


@pytest.mark.parametrize("which", [0, 2])
@pytest.mark.parametrize("forged_key", [THEIRS, None])
def test_an_edited_file_of_the_board_is_named(board, which, forged_key):
    """As it is; written anew under the name that fits it; with an earlier time of entering."""
    record = read(board).records[which]
    about = {k: v for k, v in record.entry["about"].items() if k != "key"}
    if forged_key is not None:
        about["key"] = forged_key
    for entered in (record.entered, "2020-01-01T00:00:00.000000+00:00"):
        forged, data = made_record({**record.entry, "about": about}, entered)
        (board / record.name).write_bytes(data)
        assert check(board).problems[0].startswith(f"{record.name}: changed or renamed")
        (board / record.name).rename(board / forged.name)
        assert any("signs with" in problem for problem in check(board).problems)
        with pytest.raises(JournalError):
            read(board)
        (board / forged.name).rename(board / record.name)


def test_what_was_adopted_is_named_and_nothing_beside_it(board, by):
    """Unsigned entries slipped in later, with an early time, are not the signer's."""
    append(board, by("B. Name", THEIRS), adopt=True)
    forged, data = made_record(by("B. Name", name="late"), "2020-01-01T00:00:00.000000+00:00")
    (board / forged.name).write_bytes(data)
    (problem,) = check(board).problems
    assert problem.startswith(forged.name) and "the entry is not signed" in problem
