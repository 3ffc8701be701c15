"""Clocks: which long steps are lost rows, and which belong to a schedule or to rounded stamps."""

import numpy as np
import pytest

import greybox as gb


def kind(time, **signals):
    return gb.Record(time, signals or {"u": np.zeros(len(time))}).clock.kind


def cuts(record, inputs=("u",)):
    """The last row of every stretch but the last one."""
    return [int(rows[-1]) for rows in record.stretches(inputs)[:-1]]


def moving(count, seed=0):
    """An input that takes another value at each sample."""
    return np.random.default_rng(seed).normal(size=count)


@pytest.mark.parametrize(("rate", "quantum"), [(75, 0.01), (90, 0.01), (800, 1e-3), (714, 1e-3)])
@pytest.mark.parametrize("rounding", [np.round, np.floor])
def test_coarse_stamps_are_those_of_a_uniform_clock(rate, quantum, rounding):
    exact = np.arange(2000) / rate
    time = rounding(exact / quantum + 1e-9) * quantum
    record = gb.Record(time, {"u": moving(2000)})
    assert record.clock.kind == "rounded"
    assert record.rate == pytest.approx(rate, rel=1e-3)
    assert len(record.pieces) == 1
    assert not cuts(record)
    # A hole is a hole in coarse stamps too.
    there = np.delete(np.arange(2000), np.arange(900, 960))
    assert cuts(gb.Record(time[there], {"u": moving(2000)[there]})) == [899]


@pytest.mark.parametrize("ticks", [1.044, 1.0383, 1.3, 1.74, 1.93])
def test_short_records_show_coarse_stamps(ticks):
    """A clock of 150 samples whose step is so many ticks; four of its steps are unlike the others."""
    for offset in np.arange(0, 1, 0.1):
        time = np.round(ticks * np.arange(150) + offset)
        record = gb.Record(time, {"u": moving(150)})
        assert record.clock.kind == "rounded", offset
        # The first and the last of the stamps are rounded.
        assert record.step == pytest.approx(ticks, abs=1 / 149)
        assert not cuts(record)


@pytest.mark.parametrize("steps", [[1, 1, 1, 2, 3], [1, 1, 1, 2, 3, 5], [1, 1, 2], [1, 2]], ids=str)
@pytest.mark.parametrize("count", [20, 60, 200])
def test_whole_steps_in_random_order_are_no_coarse_stamps(steps, count):
    """Times of a schedule that were taken for stamps were moved by more than a step."""
    random = np.random.default_rng(count)
    kinds = [kind(np.cumsum(random.choice(steps, count)).astype(float)) for _ in range(300)]
    assert kinds.count("rounded") <= 6  # one in a hundred by chance


@pytest.mark.parametrize("every", [7, 10, 26])
def test_signals_tell_coarse_stamps_from_rows_that_are_lost_at_equal_intervals(every):
    """Both clocks have the same stamps: every so many steps of one tick, one of two."""
    rows = np.flatnonzero(np.arange(400) % every != every - 1)
    time = 0.01 * rows
    uniform = 0.01 * np.arange(rows.size)
    for moments, expected in ((time, "regular"), (uniform, "rounded")):
        y = np.sin(3 * moments) + 0.002 * moving(rows.size)
        record = gb.Record(time, {"u": moving(rows.size, 1), "y": y})
        assert record.clock.kind == expected
        lost = np.sum(np.diff(rows) > 1) if expected == "regular" else 0
        assert abs(len(cuts(record)) - lost) <= 1  # one is too near to an end
    # Without a smooth signal, nothing speaks for lost rows.
    assert not cuts(gb.Record(time, {"u": moving(rows.size)}))


@pytest.mark.parametrize(
    "time",
    [
        [0, 15, 30, 45, 60, 90, 120, 180],
        [*range(11), 20, 30, 40, 50, 60],
        [1, 2, 3, 4, 5, 7],
        [0, 2, 3, 4],
        [0, 0.5, 1, 2, 4, 8, 24, 48],
        np.r_[np.arange(1000) / 100, 10 + np.arange(450) / 50],
        np.r_[np.arange(300) / 100, 3 + np.arange(100) / 40, 5.5 + np.arange(300) / 100],
        np.arange(600) / 100 + np.random.default_rng(1).uniform(-3e-3, 3e-3, 600),
        np.cumsum(np.random.default_rng(2).exponential(size=500)),
        np.geomspace(1e-6, 1e3, 60),
    ],
    ids=[
        "lab",
        "two rates in a lab",
        "days",
        "four",
        "doubling",
        "100 to 50 Hz",
        "and back",
        "jitter",
        "random",
        "kinetics",
    ],
)
def test_schedules_and_changes_of_rate_have_no_holes(time):
    record = gb.Record(np.array(time, dtype=float), {"u": moving(len(time))})
    assert not cuts(record)
    assert len(record.pieces) == 1


@pytest.mark.parametrize("share", [0.01, 0.1, 0.3])
def test_every_lost_row_of_a_moving_input_ends_a_stretch(share):
    """The steps of a uniform clock without some rows are longer than one: there, and only there."""
    random = np.random.default_rng(3)
    rows = np.flatnonzero(random.random(1000) >= share)
    record = gb.Record(0.01 * rows, {"u": moving(1000)[rows]})
    lost = np.flatnonzero(np.diff(rows) > 1)
    # Between two holes nobody can tell, if they have next to no single steps around them.
    assert np.isin(cuts(record), lost).all()
    assert len(cuts(record)) > 0.98 * lost.size
    assert [len(piece) for piece in record.pieces] == list(map(len, record.stretches(["u"])))


def lost_at(values, first, last):
    rows = np.delete(np.arange(len(values)), np.arange(first, last))
    return gb.Record(0.01 * rows, {"u": np.asarray(values, dtype=float)[rows]})


def test_an_input_that_rests_is_known_across_a_hole():
    time = 0.01 * np.arange(1000)
    step = np.where(np.arange(1000) < 100, 0.0, 1.0)
    assert not cuts(lost_at(step, 400, 460))
    assert not cuts(lost_at(np.zeros(1000), 400, 460))
    assert not cuts(lost_at(step, 400, 460), inputs=())
    assert cuts(lost_at(step, 90, 150)) == [89]  # the step is in the hole
    # Values of both signs that last for 15 samples may have changed twice in a hole of 60.
    command = np.repeat(np.random.default_rng(4).choice([-1.0, 1.0], 70), 15)[:1000]
    for first in range(300, 600, 15):
        assert cuts(lost_at(command, first, first + 60)) == [first - 1]
    # In a hole of one they cannot.
    at = np.flatnonzero(command[2:] == command[:-2])[20:60] + 1
    for row in at:
        assert not cuts(lost_at(command, row, row + 1))
    assert time[-1] == 9.99


def test_a_smooth_input_is_known_across_single_rows():
    """By lines, which are wrong by 0.5 % of a sine there, and by more than all of it elsewhere."""
    smooth = np.sin(0.1 * np.arange(1000)) + np.sin(0.037 * np.arange(1000))
    assert not cuts(lost_at(smooth, 500, 501))
    assert cuts(lost_at(smooth, 500, 560)) == [499]
    assert cuts(lost_at(moving(1000), 500, 501)) == [499]
    both = lost_at(smooth, 500, 501)
    assert cuts(both.with_signals(v=moving(999)), inputs=("u", "v")) == [499]


def test_what_is_stated_of_gaps_holds():
    for values, first, last in ((moving(1000), 500, 560), (np.zeros(1000), 500, 501)):
        record = lost_at(values, first, last)
        stated = {
            gaps: gb.Record(record.time, record.signals, gaps=gaps) for gaps in ("bridge", "cut")
        }
        assert not cuts(stated["bridge"])
        assert cuts(stated["cut"]) == [499]
        assert [len(stated[gaps].pieces) for gaps in stated] == [1, 2]
        # It stays with the record, and other stretches are other data.
        for one in stated.values():
            assert one.between(0, 8).gaps == one.gaps
            assert one.with_signals(v=one["u"]).gaps == one.gaps
            assert gb.Record.from_pandas(one.to_pandas()).gaps == one.gaps
            assert not one.is_same_as(record)
            assert one.checksum != record.checksum
    with pytest.raises(ValueError, match="gaps is 'fill': use 'bridge' where the inputs are known"):
        gb.Record([0.0, 1.0], {}, gaps="fill")


def test_a_long_uniform_clock_needs_no_neighbors():
    record = gb.Record(1e-3 * np.arange(200_000), {"u": np.zeros(200_000)})
    assert record.clock.kind == "uniform"
    assert record.step == pytest.approx(1e-3)


def test_reading_and_preparing_state_gaps(tmp_path):
    record = lost_at(moving(300), 100, 130)
    path = tmp_path / "table.csv"
    lines = (f"{t:.2f},{u:.6f}" for t, u in zip(record.time, record["u"], strict=True))
    path.write_text("time [s],u [N]\n" + "\n".join(lines))
    read = {gaps: gb.read(path, gaps=gaps)["table"] for gaps in ("auto", "bridge", "cut")}
    assert [len(one.stretches(["u"])) for one in read.values()] == [2, 1, 2]
    prepared = {gaps: gb.prepare(one, {"u": "u"}) for gaps, one in read.items()}
    assert [len(one) for one in prepared.values()] == [270, 300, 270]
    assert len(gb.prepare(read["auto"], {"u": "u"}, gaps="bridge")) == 300
