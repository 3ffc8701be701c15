import hashlib

import h5py
import pytest

from greybox.files.sealed_files import BLOCK, open_sealed, write_sealed


@pytest.fixture
def sealed(tmp_path):
    path = tmp_path / "a.h5"

    def fill(file):
        file["x"] = [1.0, 2.0]

    write_sealed(path, "fit", fill)
    return path


def test_it_is_an_ordinary_hdf5_file_behind_a_block_with_its_checksum(sealed):
    raw = sealed.read_bytes()
    assert hashlib.sha256(raw[BLOCK:]).hexdigest().encode() in raw[:BLOCK]
    with h5py.File(sealed) as file:
        assert file["x"][1] == 2
    with open_sealed(sealed, "fit") as file:
        assert file["x"][()].tolist() == [1, 2]


@pytest.mark.parametrize("offset", [60, BLOCK, BLOCK + 700, -1])
def test_one_changed_bit_is_found(sealed, offset):
    raw = bytearray(sealed.read_bytes())
    raw[offset] ^= 1
    sealed.write_bytes(raw)
    with (
        pytest.raises(ValueError, match="is damaged or was changed since it was saved"),
        open_sealed(sealed, "fit"),
    ):
        pass


def test_truncated_files_other_kinds_and_missing_ones(sealed, tmp_path):
    with pytest.raises(ValueError, match="is not a greybox record"), open_sealed(sealed, "record"):
        pass
    with (
        pytest.raises(FileNotFoundError, match="there is no file"),
        open_sealed(tmp_path / "b.h5", "fit"),
    ):
        pass
    sealed.write_bytes(sealed.read_bytes()[:-10])
    with pytest.raises(ValueError, match="is damaged"), open_sealed(sealed, "fit"):
        pass


def test_what_is_missing_inside_is_said_as_damage(sealed):
    with (
        pytest.raises(ValueError, match="is not a greybox fit or is damaged"),
        open_sealed(sealed, "fit") as file,
    ):
        file["y"][()]
