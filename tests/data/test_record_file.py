import h5py
import numpy as np

from greybox.data.record import Record
from greybox.data.record_file import read_record, write_record


def test_a_record_comes_back_with_its_order_names_and_units(tmp_path):
    """Names may hold slashes, which HDF5 reads as paths, and the signs that stand for them."""
    time = np.cumsum(np.random.default_rng(0).uniform(0.01, 0.03, 20))
    signals = {"z/b": time**2, "a%2Fb": np.where(time < 0.2, np.nan, time), "b": -time}
    hold = {"z/b": 0.0025, "a%2Fb": np.inf}
    flown = Record(
        time,
        signals,
        {"z/b": "m/s", "b": "rad"},
        "flight",
        "log.bin",
        "abc",
        hold=hold,
        findings=("a gap",),
    )
    with h5py.File(tmp_path / "record.h5", "w") as file:
        write_record(file.create_group("record"), flown)
    with h5py.File(tmp_path / "record.h5") as file:
        back = read_record(file["record"])
    assert list(back.signals) == list(signals)
    for name in signals:
        np.testing.assert_array_equal(back[name], flown[name])
    np.testing.assert_array_equal(back.time, flown.time)
    assert back.units == flown.units
    assert back.hold == hold
    assert (back.name, back.source, back.checksum) == ("flight", "log.bin", "abc")
    assert back.findings == ()
