import math

import pytest

from greybox.data.excited_segment import Segment, checked_segments, segment_table


def test_a_segment_says_what_it_is():
    segment = Segment(1.0, 11.0, omega=2 * math.pi, axis="pitch")
    assert segment.duration == 10
    assert segment.periods == pytest.approx(10)
    assert segment.band == (segment.omega, segment.omega)
    assert segment.refused("a", "b").findings == ("a", "b")
    assert not segment.refused("a").usable
    with pytest.raises(ValueError, match=r"the segment ends at 1 s, not after its start at 1 s"):
        Segment(1.0, 1.0)
    with pytest.raises(ValueError, match="the kind of a segment is 'ramp'"):
        Segment(0.0, 1.0, "ramp")


def test_a_table_lists_segments_and_under_it_their_findings():
    table = segment_table(
        [
            Segment(1.0, 11.0, omega=2.0),
            Segment(12.0, 13.0, "sweep", band=(1, 9)).refused("aborted"),
        ]
    )
    first, second, note = table.splitlines()[2:]
    assert first.split()[:6] == [
        "1",
        "1.00",
        "11.00",
        "sine",
        "2",
        "3.18",
    ]  # periods: 10 s · 2 rad/s / 2π
    assert second.split()[4:8] == ["1", "to", "9", "-"]
    assert second.split()[-1] == "no"
    assert note == "2: aborted"
    assert segment_table(()) == "no excited segment was found"


def test_only_segments_are_segments():
    sine = Segment(0.0, 1.0)
    assert checked_segments(iter([sine])) == (sine,)
    with pytest.raises(
        TypeError, match=r"a segment is \(1, 2\): give those of gb.logs.find_segments"
    ):
        checked_segments([sine, (1, 2)])


def test_each_number_of_a_segment_stands_in_its_column():
    segments = [
        Segment(
            1.234,
            11.0,
            "sine",
            "pitch",
            2.0,
            amplitude=3.14159,
            offset=0.5,
            unit="deg",
            source="SIDS",
        ),
        Segment(20.0, 30.5, "sweep", "", band=(0.62832, 37.699), amplitude=0.06).refused(
            "one", "two"
        ),
        Segment(40.0, 41.0, "step", "roll", offset=-1e-12),
    ]
    assert segment_table(segments).splitlines() == [
        "   start s  end s  kind   axis           rad/s  periods  amplitude  offset  usable  source",
        "-  -------  -----  -----  -----  -------------  -------  ---------  ------  ------  ------",
        "1     1.23  11.00  sine   pitch              2     3.11   3.14 deg     0.5     yes  SIDS",
        "2    20.00  30.50  sweep         0.628 to 37.7        -       0.06       -      no",
        "3    40.00  41.00  step   roll          - to -        -          -      -0     yes",
        "2: one",
        "2: two",
    ]
    assert repr(segments[0]) == "<Segment sine, 1.234 to 11 s, pitch>"
    assert repr(segments[1]) == "<Segment sweep, 20 to 30.5 s, no axis, not usable>"
    assert segments[1].findings == ("one", "two")
    assert segments[0].band == (2.0, 2.0)
    assert segments[0].periods == pytest.approx((11 - 1.234) * 2 / (2 * math.pi))
    assert segments[1].periods == pytest.approx(10.5 * 0.62832 / (2 * math.pi))
