import math

import pytest

from greybox.data.test_segment import Segment, checked_segments, segment_table


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
    table = segment_table([Segment(1.0, 11.0, omega=2.0), Segment(12.0, 13.0, "sweep", band=(1, 9)).refused("aborted")])
    first, second, note = table.splitlines()[2:]
    assert first.split()[:6] == ["1", "1.00", "11.00", "sine", "2", "3.18"]  # periods: 10 s · 2 rad/s / 2π
    assert second.split()[4:8] == ["1", "to", "9", "-"]
    assert second.split()[-1] == "no"
    assert note == "2: aborted"
    assert segment_table(()) == "no excited segment was found"


def test_only_segments_are_segments():
    sine = Segment(0.0, 1.0)
    assert checked_segments(iter([sine])) == (sine,)
    with pytest.raises(TypeError, match=r"a segment is \(1, 2\): give those of gb.logs.find_segments"):
        checked_segments([sine, (1, 2)])
