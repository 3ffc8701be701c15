"""From messages to records: joined, on one clock, one record per instance."""

from dataclasses import replace

import numpy as np
import pytest

from greybox.data.logs.readers.messages import Messages, bare, on_one_clock, records


def messages(name="ATT", order=(0, 1, 2), time=(0.0, 1.0, 2.0), instance="", **columns):
    order = np.array(order)
    columns = columns or {"x": np.arange(order.size) * 1.0}
    return Messages(
        name, order, None if time is None else np.array(time), columns, instance=instance
    )


def test_instances_are_left_out_of_requested_names():
    assert bare(None) is None
    assert bare(["IMU[0]", "ATT", "IMU[1]"]) == ("IMU", "ATT")


def test_one_clock_for_all_messages_of_a_log():
    """A restart between the messages of one kind is seen in those of the other."""
    n = 200
    fast = messages(
        "IMU", order=np.arange(n), time=np.concatenate([np.arange(100.0), np.arange(100.0)]) + 5
    )
    slow = messages("GPS", order=(n,), time=(105.0,))
    (fast, slow), (finding,) = on_one_clock([fast, slow])
    assert np.all(np.diff(fast.time) > 0)
    assert slow.time[0] > fast.time[-1]
    assert "the clock restarted at 104.0 s" in finding


def test_a_record_for_every_instance_and_none_without_time_or_numbers():
    imu = messages(
        "IMU",
        order=range(4),
        time=(0, 0, 1, 1),
        instance="I",
        I=np.array([0, 1, 0, 1.0]),
        g=np.arange(4.0),
    )
    timeless = messages("VER", time=None)
    empty = Messages("MSG", np.arange(1), np.zeros(1), {}, {"text": ["hello"]})
    never = messages("BAD", time=(np.nan,) * 3)
    found, findings = records([imu, timeless, empty, never], "a.bin", "abc")
    assert list(found) == ["IMU[0]", "IMU[1]"]
    np.testing.assert_array_equal(found["IMU[1]"]["g"], [1, 3])
    assert list(found["IMU[0]"].signals) == ["g"]
    assert (found["IMU[0]"].source, found["IMU[0]"].checksum) == ("a.bin", "abc")
    assert findings == (
        "VER: its 3 messages have no time and were left out.",
        "BAD: none of its 3 messages has a plausible time; it was left out.",
    )


def test_dropped_samples_are_counted_with_the_reason():
    found, findings = records(
        [messages(order=range(5), time=(0.0, 1.0, np.nan, 1.0, 2.0))], "a.bin", "abc"
    )
    np.testing.assert_array_equal(found["ATT"].time, [0, 1, 2])
    assert findings == (
        "ATT: 2 of 5 samples dropped: 1 with implausible times, 1 whose time does not increase.",
    )


def test_samples_out_of_order_are_to_be_sorted():
    time = np.random.default_rng(0).permutation(40) / 10
    _, (finding, *_) = records([messages(order=range(40), time=time)], "a.csv", "abc")
    assert finding.endswith(
        "whose time does not increase; save each run, or each device, in a file of its own."
    )


def test_records_of_instances_keep_units_holds_and_texts_apart():
    """By number and by name, in order; a single value of an instance is one too."""
    n = 6
    group = Messages(
        "BAT",
        np.arange(n),
        np.arange(n) / 10,
        {"I": np.array([2.0, 0, 2, 0, 2, 0.5]), "V": np.arange(n) * 1.5},
        {},
        {"V": "V"},
        "I",
        {"V": 0.25},
    )
    found, findings = records([group], "a.bin", "abc")
    assert [*found] == ["BAT[0]", "BAT[0.5]", "BAT[2]"]
    assert [record["V"].tolist() for record in found.values()] == [[1.5, 4.5], [7.5], [0, 3, 6]]
    assert [record.time.tolist() for record in found.values()] == [[0.1, 0.3], [0.5], [0, 0.2, 0.4]]
    assert {(record.units["V"], record.hold["V"]) for record in found.values()} == {("V", 0.25)}
    assert findings == ()
    named = replace(group, columns={"V": group.columns["V"]}, texts={"I": list("baabca")})
    found, _ = records([named], "a.bin", "abc")
    assert {name: record["V"].tolist() for name, record in found.items()} == {
        "BAT[a]": [1.5, 3, 7.5], "BAT[b]": [0, 4.5], "BAT[c]": [6],
    }  # fmt: skip


def test_gaps_and_dropped_samples_of_a_record_are_said_once():
    time = np.arange(60) / 10
    time[30:] += 2
    holed = Messages("ATT", np.arange(60), time, {"x": time})
    _, findings = records([holed], "a.bin", "abc")
    assert findings == ("ATT: 1 gap, the longest 2.1 s at 2.9 s.",)
    back = replace(
        holed, time=np.where(np.arange(60) == 10, np.nan, np.where(np.arange(60) == 20, 0.5, time))
    )
    _, findings = records([back], "a.bin", "abc")
    assert (
        findings[0]
        == "ATT: 2 of 60 samples dropped: 1 with implausible times, 1 whose time does not increase."
    )


@pytest.mark.parametrize(("number", "lines"), [(1, 1), (3, 3), (4, 1)])
def test_gaps_of_many_messages_are_one_line(number, lines):
    time = np.r_[0:5:0.1, 8:12:0.1]
    groups = [Messages(f"M{k}", np.arange(time.size), time, {"x": time}) for k in range(number)]
    _, findings = records(groups, "a.bin", "abc")
    assert len(findings) == lines
    assert "the longest 3.1 s at 4.9 s" in findings[0]


def test_a_message_at_irregular_times_has_no_gaps():
    time = np.cumsum(np.where(np.arange(60) % 10 == 0, 5.0, 0.1))
    _, findings = records([Messages("EV", np.arange(60), time, {"x": time})], "a.bin", "abc")
    assert findings == ()
