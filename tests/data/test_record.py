"""One experiment on one time base: what is refused, its rate, gaps, parts and identity."""

import math

import numpy as np
import pytest

from greybox.data.record import Record, Recording, share_samples

TIME = np.arange(10) / 50
SIGNAL = np.sin(TIME)


def record(**more):
    return Record(TIME, {"u": SIGNAL, "theta": 2 * SIGNAL}, {"theta": "rad"}, **more)


def test_arrays_are_copied_and_read_only():
    values = SIGNAL.copy()
    made = Record(TIME, {"u": values})
    values[0] = 9.0
    assert made["u"][0] == 0
    with pytest.raises(ValueError, match="read-only"):
        made["u"][0] = 1.0
    with pytest.raises(ValueError, match="read-only"):
        made.time[0] = 1.0


@pytest.mark.parametrize(
    ("time", "signals", "words"),
    [
        ([], {}, "the record is empty"),
        ([0.0, math.nan], {}, "time is nan at index 1"),
        ([0.0, 1.0, 1.0], {}, r"time does not increase after 1.000000 s \(index 1\)"),
        ([0.0, 1.0], {"u": [1.0]}, "time has 2 values but u has 1"),
        ([0.0, 1.0], {"u": [[1.0, 2.0]]}, r"u must be one-dimensional, but has shape \(1, 2\)"),
    ],
)
def test_what_is_no_record(time, signals, words):
    with pytest.raises(ValueError, match=words):
        Record(time, signals)


def test_rate_and_duration():
    assert record().rate == pytest.approx(50)
    assert record().duration == pytest.approx(0.18)
    assert math.isnan(Record([1.0], {}).step)
    jittered = Record([0.0, 0.02, 0.04, 0.07, 0.5], {})
    assert jittered.step == np.median(np.diff(jittered.time))


def test_pieces_are_cut_at_gaps_and_put_together_give_the_record():
    step = 0.02
    shorter, time = (
        np.concatenate([np.arange(50) * step, 0.98 + gap * step + np.arange(30) * step])
        for gap in (1.48, 1.52)
    )
    assert len(Record(shorter, {}).pieces) == 1
    flown = Record(time, {"u": time**2})
    first, second = flown.pieces
    assert (len(first), len(second)) == (50, 30)
    np.testing.assert_array_equal(np.concatenate([p["u"] for p in flown.pieces]), flown["u"])
    assert [len(p) for p in Record(np.delete(np.arange(50) * step, 20), {}).pieces] == [20, 29]
    assert "in 2 pieces" in str(flown)


def test_pieces_of_a_long_record_take_no_memory_and_what_others_can_write_is_copied():
    flown = Record([0.0, 0.1, 0.2, 5.0, 5.1], {"u": np.arange(5.0)})
    assert all(np.shares_memory(piece["u"], flown["u"]) for piece in flown.pieces)
    buffer = np.arange(5.0)
    part = buffer[1:]
    part.setflags(write=False)
    kept = Record(np.arange(4.0), {"u": part})
    buffer[:] = 7.0
    np.testing.assert_array_equal(kept["u"], [1, 2, 3, 4])


def test_a_cut_keeps_its_ends():
    cut = record().between(0.02, 0.1)
    assert (cut.time[0], cut.time[-1]) == (0.02, 0.1)
    np.testing.assert_array_equal(cut["theta"], 2 * SIGNAL[1:6])
    with pytest.raises(ValueError, match=r"no sample from 5 to 6 s; it runs from 0 to 0\.18 s"):
        record().between(5, 6)


def test_the_checksum_is_that_of_names_and_numbers():
    assert record().checksum == record(name="again", source="elsewhere").checksum
    assert record().checksum != Record(TIME, {"w": SIGNAL, "theta": 2 * SIGNAL}).checksum
    assert record().checksum != record().with_signals(u=SIGNAL + 1e-15).checksum
    assert record(checksum="of the file").checksum == "of the file"


def test_signals_are_added_and_replaced():
    more = record().with_signals({"q": "rad/s"}, q=np.ones(10), u=np.zeros(10))
    assert list(more.signals) == ["u", "theta", "q"]
    assert not more["u"].any()
    assert more.units == {"theta": "rad", "q": "rad/s"}
    with pytest.raises(KeyError, match="no signal 'v'; it has u, theta"):
        record()["v"]


def test_a_recording_finds_signals_by_message_and_by_bare_name():
    log = Recording({"IMU[0]": record(), "IMU[1]": Record(TIME, {"gyro": SIGNAL})}, "flight.bin")
    assert log["IMU"] is log["IMU[0]"]
    assert log.locate("IMU[1].gyro") == (log["IMU[1]"], "gyro")
    assert log.locate("gyro") == (log["IMU[1]"], "gyro")
    assert (len(log), list(log)) == (2, ["IMU[0]", "IMU[1]"])
    with pytest.raises(
        KeyError, match=r"flight.bin has no message 'ATT'; it has IMU\[0\], IMU\[1\]"
    ):
        log["ATT"]
    with pytest.raises(KeyError, match="there is no signal 'GYRO', but gyro: write MESSAGE"):
        log.locate("GYRO")
    both = Recording({"A": record(), "B": record()})
    with pytest.raises(KeyError, match=r"several messages have the signal 'u', A, B: .* A\.u\."):
        both.locate("u")


def test_how_signals_run_between_samples_stays_with_them():
    time = np.concatenate([np.arange(5.0), np.arange(20.0, 25.0)])
    made = Record(time, {"u": time, "y": -time}, hold={"u": math.inf, "y": 0})
    cuts = (made.between(1, 3), made.rows(np.arange(3)), *made.pieces, made.with_signals(z=time))
    assert len(made.pieces) == 2
    assert all(cut.hold == {"u": math.inf, "y": 0.0} for cut in (made, *cuts))
    frame = made.to_pandas().drop(columns="u")
    assert Record.from_pandas(frame).hold == {"y": 0.0}


def test_wrong_names_in_a_record_are_not_dropped_silently():
    with pytest.raises(
        ValueError, match=r"^hold names 'U', which is not a signal; the record has u"
    ):
        Record([0.0, 1.0], {"u": [1.0, 2.0]}, hold={"U": math.inf})
    with pytest.raises(TypeError, match=r"^hold is inf: give \{name"):
        Record([0.0, 1.0], {"u": [1.0, 2.0]}, hold=math.inf)
    numbered = Record([0.0, 1.0], {1: [1.0, 2.0]}, units={1: "m"}, hold={1: math.inf})
    assert ([*numbered.signals], numbered.units, numbered.hold) == (
        ["1"],
        {"1": "m"},
        {"1": math.inf},
    )


@pytest.mark.parametrize("hold", [-0.1, math.nan, "held", True, None])
def test_a_hold_is_a_time(hold):
    with pytest.raises(
        ValueError, match=r"hold gives 'u' the value .*: give math.inf for a signal that is held"
    ):
        Record(np.arange(3.0), {"u": np.arange(3.0)}, hold={"u": hold})


def test_records_share_samples_where_their_times_overlap_in_one_file():
    time = np.arange(100) / 10
    flight = Record(time, {"u": np.sin(time), "y": np.cos(time)}, checksum="of the file")
    first, second = flight.between(0, 4), flight.between(5, 9)
    assert share_samples(flight, first)
    assert share_samples(first, flight)
    assert not share_samples(first, second)
    assert not share_samples(second, first)
    assert share_samples(first, flight.between(4, 5))
    assert share_samples(flight.between(4, 5), first)
    apart = flight.rows(np.r_[0:20, 60:100])  # what is in its gap is not in it
    assert not share_samples(apart, flight.between(3, 5))
    assert not share_samples(flight.between(3, 5), apart)
    assert share_samples(apart, flight.between(1, 3))
    assert share_samples(flight.between(5, 7), apart)


def test_records_of_other_files_share_samples_where_their_values_are_equal():
    time = np.arange(100) / 10
    random = np.random.default_rng(0)
    one = Record(time, {"u": np.sin(time), "y": random.normal(size=100)})
    more = one.between(2, 8).with_signals(z=np.zeros(61))
    assert more.checksum != one.checksum
    assert share_samples(one, more)
    assert share_samples(more, one)
    another = Record(
        time, {"u": np.sin(time), "y": random.normal(size=100)}
    )  # the same input, flown again
    assert not share_samples(one, another)
    assert not share_samples(one, Record(time, {"z": np.zeros(100)}))
    assert not share_samples(one, Record(time + 50, {"u": np.sin(time)}))


def test_other_records_share_samples_where_values_at_the_same_times_are_the_same():
    """Half of them at least, in every signal that both have; a few are the same by chance."""
    time = np.arange(20.0)
    one = Record(time, {"u": np.sin(time), "y": np.cos(time)})
    assert share_samples(one, Record(time[5:], {"y": np.cos(time[5:]), "w": time[5:]}))
    assert not share_samples(one, Record(time, {"y": np.cos(time) + 0.5}))
    assert not share_samples(one, Record(time, {"y": np.cos(time), "u": np.sin(time) + 1e-9}))
    assert not share_samples(one, Record(time + 0.5, {"y": np.cos(time)}))
    assert not share_samples(one, Record(time, {"w": np.cos(time)}))
    lost = one.with_signals(y=np.where(time < 10, np.nan, np.cos(time)))
    assert share_samples(lost, Record(time, {"y": lost["y"]}))
    some = np.where(np.arange(20) < 3, np.cos(time), 7.0)
    assert not share_samples(one, Record(time, {"y": some}))
    assert not share_samples(one, Record(time, {"y": np.cos(time)}, has_time=False))


@pytest.mark.parametrize("count", range(2, 9))
def test_the_step_is_the_median_interval(count):
    time = np.cumsum(np.random.default_rng(count).uniform(0.1, 1, count))
    record = Record(time, {"x": time})
    assert record.step == pytest.approx(np.median(np.diff(time)), rel=1e-12)
    assert record.rate == pytest.approx(1 / np.median(np.diff(time)))
    assert record.duration == pytest.approx(time[-1] - time[0])


def test_rows_are_shared_by_number_in_one_file_and_by_value_in_others():
    rows = Record(np.arange(6.0), {"x": np.arange(6.0)}, has_time=False, checksum="of the file")
    assert share_samples(rows.rows(np.arange(4)), rows.rows(np.arange(3, 6)))
    assert not share_samples(rows.rows(np.arange(3)), rows.rows(np.arange(3, 6)))
    assert not share_samples(
        rows, Record(np.arange(6.0), {"x": np.arange(6.0) + 1}, has_time=False)
    )
    assert share_samples(rows, Record(np.arange(6.0), {"x": np.arange(6.0)}, has_time=False))


def test_what_a_record_says_of_itself():
    time = np.r_[2.0:3.0:0.25, 5.0:6.5:0.25]
    flown = Record(
        time,
        {"u": np.arange(10.0), "y": [1.0, np.nan, np.inf, *np.arange(7.0)]},
        {"u": "m"},
        "flight",
    )
    assert str(flown) == "flight: 10 samples at 4 Hz, 4.2 s from 2.0 s in 2 pieces: u (m), y"
    assert repr(flown) == f"<Record {flown}>"
    assert [len(rows) for rows in flown.independent_pieces] == [4, 6]
    assert np.concatenate(flown.independent_pieces).tolist() == list(range(10))
    rows = Record(None, {"x": np.arange(3.0)})
    assert str(rows) == "record: 3 rows without a time: x"
    assert repr(rows) == f"<Record {rows}>"
    assert (rows.step, rows.rate, rows.has_time, len(rows.pieces)) == (1.0, 1.0, False, 1)
    assert [one.tolist() for one in rows.independent_pieces] == [[0], [1], [2]]
    assert rows.time.tolist() == [0, 1, 2]
    with pytest.raises(
        ValueError, match="between needs samples in time, and the record has rows without a time"
    ):
        rows.between(0, 1)
    with pytest.raises(ValueError, match=r"^x has 3 values but y has 2: they must match"):
        Record(None, {"x": np.arange(3.0), "y": np.arange(2.0)})


def test_a_cut_that_has_no_sample_says_what_there_is():
    with pytest.raises(
        ValueError, match=r"^the record has no sample from 7 to 9 s; it runs from 2 to 6 s: "
    ):
        Record([2.0, 4.0, 6.0], {}).between(7, 9)
    with pytest.raises(ValueError, match=r"from 6 to 2 s; .* the earlier first"):
        Record([2.0, 4.0, 6.0], {}).between(6, 2)
    assert len(Record([2.0, 4.0, 6.0], {}).between(2, 4)) == 2


@pytest.mark.parametrize(("equal", "shared"), [(10, False), (11, True)])
def test_more_than_half_of_the_samples_must_be_equal(equal, shared):
    time = np.arange(20.0)
    values = np.where(time < equal, np.sin(time), 7.0)
    assert share_samples(Record(time, {"u": np.sin(time)}), Record(time, {"u": values})) is shared


def test_a_recording_says_what_it_has():
    log = Recording(
        {"A[0]": Record([0.0, 1.0], {"x": [1.0, 2.0]}), "B": Record(None, {"y": [1.0]})}, "a.bin"
    )
    assert repr(log) == "<Recording 'a.bin', 2 messages, A[0], B>"
    assert (len(log), [*log], log["A"] is log["A[0]"]) == (2, ["A[0]", "B"], True)
    with pytest.raises(KeyError, match=r"a\.bin has no message 'C'; it has A\[0\], B\."):
        log["C"]
    with pytest.raises(KeyError, match=r"no signal 'z', but x and y: .*columns=\{'z': \.\.\.\}"):
        log.locate("z")


def test_arrays_that_nobody_can_write_to_are_kept_and_others_copied():
    frozen = np.arange(4.0)
    frozen.setflags(write=False)
    open_ = np.arange(4.0)
    part = open_[1:]
    part.setflags(write=False)  # its owner can still be written to
    kept = Record(np.arange(4.0), {"frozen": frozen, "open": open_})
    assert np.shares_memory(kept["frozen"], frozen)
    assert not np.shares_memory(kept["open"], open_)
    assert not np.shares_memory(Record(np.arange(3.0), {"x": part})["x"], open_)
    assert np.shares_memory(Record(np.arange(3.0), {"x": frozen[1:]})["x"], frozen)
    assert not kept["open"].flags.writeable


def test_names_and_texts_from_files_are_written_out():
    bad, good = "x\x1b[2J", r"x\x1b[2J"
    known = Record(
        [0.0, 1.0],
        {bad: [1, 2]},
        {bad: bad},
        bad,
        bad,
        hold={bad: 0.5},
        findings=(bad,),
    )
    assert [*known.signals] == [good]
    assert (known.units, known.name, known.source, known.findings) == (
        {good: good},
        good,
        good,
        (good,),
    )
    assert known.hold == {good: 0.5}
    log = Recording({bad: known}, bad, metadata={bad: [bad, (1.0, bad)]}, findings=(bad,))
    assert ([*log], log.source, log.metadata, log.findings) == (
        [good],
        good,
        {good: [good, (1.0, good)]},
        (good,),
    )


@pytest.mark.parametrize("unit", ["s", "ms", "us", "ns"])
def test_dates_and_time_differences_are_converted(unit):
    """Numbers of another unit would make every time constant wrong by 1000."""
    steps = (np.arange(4) * 10**9).astype("timedelta64[ns]").astype(f"timedelta64[{unit}]")
    for time in (steps, np.datetime64("2026-11-22") + steps):
        np.testing.assert_array_equal(Record(time, {"x": np.ones(4)}).time, np.arange(4))


def test_a_mask_is_a_gap():
    values = np.ma.array([1, 2, 3], mask=[False, True, False])
    np.testing.assert_array_equal(Record(np.arange(3), {"x": values})["x"], [1, np.nan, 3])
    with pytest.raises(ValueError, match="time is nan at index 1"):
        Record(values, {"x": np.ones(3)})


@pytest.mark.parametrize(
    "values", [[1j, 2.0], np.array([1, 2], dtype=object), ["1", "2"], np.zeros(2, "M8[s]")]
)
def test_what_is_no_real_number_is_refused(values):
    with pytest.raises(ValueError, match="x must be a one-dimensional array of numbers"):
        Record([0, 1], {"x": values})
    with pytest.raises(ValueError, match="x must be a one-dimensional array of numbers"):
        Record([0, 1], {"y": [1, 2]}).with_signals(x=values)


def test_signals_without_names_are_refused():
    with pytest.raises(TypeError, match=r"signals is \[1, 2\]: give \{name: values\}"):
        Record([0, 1], [1, 2])


def test_units_of_unknown_signals_are_refused():
    with pytest.raises(ValueError, match=r"units names 'thta'.*did you mean 'theta'"):
        Record([0, 1], {"theta": [1, 2]}, {"thta": "rad"})


def test_a_sensor_beyond_the_range_of_arithmetic_is_a_finding():
    for large in (1e150, np.inf):
        assert "x has values beyond 1e75" in Record([0, 1], {"x": [1, large]}).findings[0]
    assert not Record([0, 1], {"x": [1, np.nan]}).findings


@pytest.mark.parametrize("step", [5e-324, 1e-310, 1e-300, 1e-80, 1e80])
def test_steps_beyond_arithmetic_are_refused(step):
    # Their squares are zero or infinite: every matrix of a fit would be singular.
    with pytest.raises(ValueError, match=r"time has a step of .*: give times in s"):
        Record(np.arange(4) * step, {"x": np.ones(4)})
    assert len(Record(np.arange(4) * 1e-9, {"x": np.ones(4)})) == 4


def test_a_record_knows_the_names_of_its_signals():
    record = Record([0.0, 0.1], {"V": [1.0, 2.0], "p": [3.0, 4.0]})
    assert [*record] == ["V", "p"]
    assert "V" in record
    assert "v" not in record
    assert len(record) == 2
