"""Spectra of manoeuvres in files."""

import numpy as np
import pytest

import greybox as gb
from greybox.data import read_spectrum, write_spectrum


@pytest.fixture
def spectrum():
    """Two inputs and names that a table or HDF5 would take for something else."""
    omega = 2 * np.pi / 7.3 * np.arange(2, 9)
    random = np.random.default_rng(0)
    a, b, c = random.standard_normal((3, 7)) + 1j * random.standard_normal((3, 7))
    return gb.data.TransientSpectrum(
        omega,
        {"da": a, 'stick, "left"/2': b},
        {"p": c},
        7.3,
        0.02,
        {"da": 0.1 / 3},
        units={"da": "rad", "p": "rad/s"},
        name="2-1-1 no. 3",
        source="flight.BIN",
        stretch=gb.data.Stretch("ab12", 3.0, 10.3),
    )


def test_a_spectrum_survives_its_file(spectrum, tmp_path):
    """To the last digit, with all that it knows."""
    path = tmp_path / "spectrum.csv"
    write_spectrum(spectrum, path)
    read = read_spectrum(path)
    assert read.checksum == spectrum.checksum
    assert list(read.signals) == list(spectrum.signals)
    for name in ("units", "name", "source", "stretch", "duration", "step"):
        assert getattr(read, name) == getattr(spectrum, name), name
    assert read.change("da") == spectrum.change("da")


def test_what_is_no_spectrum_is_refused(spectrum, tmp_path):
    """A response, a damaged file, a missing one."""
    path = tmp_path / "spectrum.csv"
    with pytest.raises(FileNotFoundError):
        read_spectrum(path)
    gb.data.write_response(gb.FrequencyResponse([1.0], [1.0]), path)
    with pytest.raises(ValueError, match=r"is not a( greybox)? transient spectrum"):
        read_spectrum(path)
    write_spectrum(spectrum, path)
    path.write_bytes(path.read_bytes().replace(b"duration", b"duratoin", 1)[:-40])
    with pytest.raises(ValueError, match="damaged"):
        read_spectrum(path)
