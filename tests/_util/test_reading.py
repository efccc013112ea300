"""Files of others: nothing in them is run, and none of them brings the process down."""

import os
import signal
import sys

import numpy as np
import pytest

from ves_gym._util import reading
from ves_gym._util.params import ParameterError
from ves_gym._util.reading import DEEPEST, read_apart, read_bytes, read_xml
from ves_gym._util.recordings import read_columns
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.matrix_files import read_matrices

HEAD = "%%MatrixMarket matrix coordinate real symmetric\n"
HUGE = HEAD + "1000000000 1000000000 1\n1 1 1.0\n"
GOOD = HEAD + "2 2 2\n1 1 3.0\n2 2 4.0\n"


def crash(path):
    """A reader in C that is fed what it does not expect."""
    os.kill(os.getpid(), signal.SIGSEGV)


def matrix(folder, text, name="K.mtx"):
    file = folder / name
    file.write_text(text)
    return file


def test_a_reader_that_crashes_is_a_sentence_and_the_next_file_is_read(tmp_path):
    """Claim: what ends a reader ends no program that asked for it."""
    with pytest.raises(ParameterError, match="its reader crashed: SIGSEGV"):
        read_apart("tests._util.test_reading:crash", matrix(tmp_path, GOOD))
    good = read_matrices(matrix(tmp_path, GOOD))["K"]
    np.testing.assert_array_equal(good.values.toarray(), np.diag([3.0, 4.0]))


@pytest.mark.skipif(sys.platform != "linux", reason="the bound on memory is Linux's")
@pytest.mark.parametrize(
    ("name", "text"), [("K.mtx", HUGE), ("K.sti", "1 1 1.0\n1000000000 1000000000 1.0\n")]
)
def test_more_memory_than_a_file_can_need_is_a_sentence(tmp_path, name, text):
    with pytest.raises(ParameterError, match="cannot be read within 1024 MiB of memory"):
        read_matrices(matrix(tmp_path, text, name))


def test_a_reader_that_takes_too_long_is_ended(tmp_path, monkeypatch):
    monkeypatch.setattr(reading, "SECONDS", 0.5)
    file = tmp_path / "many.xml"
    file.write_text(
        '<mujoco><worldbody><replicate count="10000000" offset="1 0 0"><geom size="1"/>'
        "</replicate></worldbody></mujoco>"
    )
    with pytest.raises(ParameterError, match=r"did not answer within 0\.5\d* s of comp"):
        Arm.from_file(file)
    monkeypatch.undo()
    assert len(read_matrices(matrix(tmp_path, GOOD))) == 1


def test_an_archive_that_unpacks_to_more_than_it_should_is_refused(tmp_path):
    file = tmp_path / "K.npz"
    np.savez_compressed(file, K=np.zeros((12_000, 12_000)))  # 1.15 GB in 1.1 MB
    with pytest.raises(ParameterError, match="of memory"):
        read_matrices(file)


LAUGHS = "".join(f'<!ENTITY l{k} "{f"&l{k - 1};" * 10}">' for k in range(1, 10))
BAD_XML = {
    "deep": "<a>" * (DEEPEST + 1) + "</a>" * (DEEPEST + 1),
    "entities": f'<!DOCTYPE a [<!ENTITY l0 "ha">{LAUGHS}]><a>&l9;</a>',
    "a file of the machine": '<!DOCTYPE a [<!ENTITY x SYSTEM "file:///etc/hostname">]><a>&x;</a>',
    "unknown encoding": "<?xml version='1.0' encoding='no-such'?><a/>",
    "no XML": "robot",
    "empty": "",
}


@pytest.mark.parametrize("what", BAD_XML)
def test_bad_xml_is_a_sentence(what, tmp_path):
    """Claim: depth, entities that grow, entities that are files, and encodings that nobody
    knows are refused by one reader, which every file in XML goes through."""
    file = tmp_path / "arm.urdf"
    file.write_text(BAD_XML[what])
    with pytest.raises(ParameterError, match=r"levels|cannot be read as XML"):
        read_xml(file)
    with pytest.raises(ParameterError, match=r"^arm\.urdf: "):
        Arm.from_file(file)


def test_files_have_a_size_and_must_be_there(tmp_path):
    file = tmp_path / "a.csv"
    file.write_bytes(b"x" * 3_000_000)
    with pytest.raises(ParameterError, match="at most 1 MiB, got 2 MiB"):
        read_bytes(file, 1 << 20)
    for read in (read_bytes, read_xml, lambda path: read_apart("json:loads", path)):
        with pytest.raises(ParameterError, match="cannot be read: No such file"):
            read(tmp_path / "none")


def test_a_matlab_file_that_is_none_is_a_sentence(tmp_path):
    for k, data in enumerate((b"", b"MATLAB 5.0 MAT-file", bytes(200), bytes(range(256)))):
        file = tmp_path / f"{k}.mat"
        file.write_bytes(data)
        with pytest.raises(ParameterError, match=rf"{k}\.mat: cannot be read"):
            read_columns(file)
