import hashlib

import h5py
import pytest
from sealing import seal

from greybox.data.files.sealed_files import BLOCK, read_sealed, write_sealed

TEXT = b"[1.5, 2]"


@pytest.fixture
def sealed(tmp_path):
    path = tmp_path / "a.h5"
    write_sealed(path, TEXT)
    return path


def test_it_is_an_ordinary_hdf5_file_behind_a_block_with_its_checksum(sealed):
    raw = sealed.read_bytes()
    assert hashlib.sha256(raw[BLOCK:]).hexdigest().encode() in raw[:BLOCK]
    with h5py.File(sealed) as file:
        assert file["fit"][()] == TEXT
    assert read_sealed(sealed) == TEXT


@pytest.mark.parametrize("offset", [60, BLOCK, BLOCK + 700, -1])
def test_one_changed_bit_is_found(sealed, offset):
    raw = bytearray(sealed.read_bytes())
    raw[offset] ^= 1
    sealed.write_bytes(raw)
    with pytest.raises(ValueError, match=r"is damaged or was changed|is not a greybox fit"):
        read_sealed(sealed)


def test_truncated_files_and_missing_ones(sealed, tmp_path):
    with pytest.raises(FileNotFoundError, match="there is no file"):
        read_sealed(tmp_path / "b.h5")
    sealed.write_bytes(sealed.read_bytes()[:-10])
    with pytest.raises(ValueError, match="is damaged"):
        read_sealed(sealed)


def test_nothing_but_the_text_is_read(sealed):
    """Whatever a stranger writes beside it, the HDF5 library does not see it."""
    raw = sealed.read_bytes()
    start = raw.index(TEXT)
    body = bytes(start - BLOCK) + TEXT + bytes(len(raw) - start - len(TEXT))
    sealed.write_bytes(raw[:BLOCK] + body)
    seal(sealed)
    assert read_sealed(sealed) == TEXT


@pytest.mark.parametrize("place", [b"0 99999999999999999999", b"9 3", b"99999 999999"])
def test_a_place_beyond_the_file_yields_no_more_than_the_file(sealed, place):
    raw = sealed.read_bytes()
    start = raw.index(TEXT)
    stated = f"{start} {start + len(TEXT)}".encode()
    sealed.write_bytes(raw[:BLOCK].replace(stated, place)[:BLOCK].ljust(BLOCK, b"\0") + raw[BLOCK:])
    assert len(read_sealed(sealed)) <= len(raw)
